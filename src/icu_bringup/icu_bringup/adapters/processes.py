"""Starts and watches the programs of the graph, restarts failed ones, and ends the simulated hardware last."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Mapping

from icu_bringup.adapters.fork_server import ForkServer, die_with_parent, is_forkable
from icu_bringup.adapters.watched_program import LifeLimits, Process, Watched
from icu_common.adapters.real_time import DRIVER, ask_for_real_time
from icu_common.core.processes.supervision import AFTER_CRASH_VARIABLE, DEAF, READY_VARIABLE

_LONGEST_TURN_S = 1.0
"""Maximum silence in seconds counted between two checks: bring-up itself may have been suspended."""
_LAST_READS = 64
"""Maximum number of reads from the pipe of an ended program; the pipe holds as much as one or two reads."""
_DELAY_S = 0.5
"""Seconds between a program's second end within the window and its restart; doubles with each further end."""
_ABORT_S = 5.0
"""Seconds for a hanging program to print where it hangs (Python's faulthandler) and end, before it is killed."""

_LADDER = ((signal.SIGINT, 0.7), (signal.SIGTERM, 0.2), (signal.SIGABRT, 0.05), (signal.SIGKILL, 0.05))
"""Signals at the end, each with its share of the time. SIGABRT lets a node print where it hangs (faulthandler)."""


def _begin_rescue() -> None:
    """Prepare the process of a rescue: it must not wait for busy programs, even while its interpreter starts."""
    die_with_parent()
    ask_for_real_time(DRIVER)


class ProcessGroup:
    """The processes of one graph.

    Parameters
    ----------
    environment
        Environment of every process.
    on_output
        Called with (program, line) for every line that a program prints.
    on_event
        Called with (program, text) when a program ends, is restarted or given up.
    restarts
        Maximum number of restarts of a program within ``window_s``; the delay doubles from half a second.
    ready_s
        Maximum seconds until a restarted program reports that it is ready; otherwise it is aborted: it can hang in
        shared memory that its killed predecessor held. A first start may take any time.
    silent_s
        Maximum seconds without a sign of life of a program that was ready. It is then aborted, so that it prints where
        it hangs, and killed if that does not end it. Time for which a signal or a debugger has stopped it does not
        count, but a signal may stop it for a limited time only.
    forks
        Server that starts the programs that report when they are ready; without it they are executed.
    """

    def __init__(
        self,
        environment: Mapping[str, str],
        on_output: Callable[[str, str], None],
        on_event: Callable[[str, str], None],
        *,
        restarts: int = 4,
        window_s: float = 60.0,
        ready_s: float = 90.0,
        silent_s: float = 8.0,
        forks: ForkServer | None = None,
    ) -> None:
        self._environment = dict(environment)
        self._on_output = on_output
        self._on_event = on_event
        self._restarts = restarts
        self._window_s = window_s
        self._limits = LifeLimits(ready_s=ready_s, silent_s=silent_s)
        self._looked_at = time.monotonic()
        self._programs: list[Watched] = []
        self._selector = selectors.DefaultSelector()
        self._partial: dict[int, bytes] = {}
        self._forks = forks
        if forks is not None:
            os.set_blocking(forks.stdout.fileno(), False)
            self._selector.register(forks.stdout, selectors.EVENT_READ, Watched(name="starter", command=[]))

    def start(
        self,
        name: str,
        command: list[str],
        *,
        ends_last: bool = False,
        tells_ready: bool = False,
        rescue: list[str] | None = None,
    ) -> None:
        """Start a program; one that ``ends_last`` is ended after all others.

        One that ``tells_ready`` writes a byte to the file descriptor ``ICU_READY_FD`` when ready, then each second.
        When a signal has ended the program, ``rescue`` is started before it is restarted: a command that ends by itself
        if there is nothing to rescue.

        Raises
        ------
        OSError
            If the executable cannot be started.
        """
        self._start(
            Watched(name=name, command=command, ends_last=ends_last, tells_ready=tells_ready, rescue=rescue or [])
        )

    def start_once(self, name: str, command: list[str]) -> None:
        """Start a program that ends by itself and is not restarted; it replaces an ended one of the same name."""
        self._programs = [w for w in self._programs if not (w.once and w.name == name and w.process is None)]
        self._start(Watched(name=name, command=command, once=True))

    def _start(self, watched: Watched) -> None:
        self._launch(watched)
        self._programs.append(watched)

    def _launch(self, watched: Watched) -> None:
        ready = os.pipe() if watched.tells_ready else ()
        extra = {AFTER_CRASH_VARIABLE: "1"} if watched.crashed else {}
        may_fork = watched.tells_ready or watched.once
        if may_fork and self._forks is not None and self._forks.runs and is_forkable(watched.command):
            watched.process = self._forks.start(watched.command, extra, ready[1] if ready else None, READY_VARIABLE)
        else:
            watched.process = subprocess.Popen(
                watched.command,
                env=self._environment | ({READY_VARIABLE: str(ready[1])} if ready else {}) | extra,
                pass_fds=ready[1:],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # the terminal's Ctrl-C reaches only bring-up, which ends the others in order
                preexec_fn=_begin_rescue if watched.rescues else die_with_parent,
            )
        if ready:
            os.close(ready[1])
            os.set_blocking(ready[0], False)
        watched.launched(ready[0] if ready else None, time.monotonic())
        assert watched.process.stdout is not None
        os.set_blocking(watched.process.stdout.fileno(), False)
        self._selector.register(watched.process.stdout, selectors.EVENT_READ, watched)

    def watch(self, timeout_s: float) -> None:
        """Forward output and restart ended programs, for at most ``timeout_s``."""
        for key, _ in self._selector.select(timeout_s):
            self._read(key)
        self._reap_orphans()
        now = time.monotonic()
        turn_s, self._looked_at = min(now - self._looked_at, _LONGEST_TURN_S), now
        for watched in list(self._programs):  # an event may start another one
            process = watched.process
            if process is not None and (code := process.poll()) is not None:
                self._ended(watched, code, now)
            elif process is not None and watched.life_pipe is not None:
                self._look_for_life(watched, process, now, turn_s)
            elif process is not None and watched.aborted_at is not None and now - watched.aborted_at > _ABORT_S:
                process.kill()
            if watched.restart_at is not None and now >= watched.restart_at:
                self._launch(watched)

    def _reap_orphans(self) -> None:
        """Collect the exit codes of children of killed programs: bring-up is then their parent (subreaper)."""
        known = {w.process.pid for w in self._programs if w.process is not None}
        if self._forks is None or 0 in known:  # 0: the server has not yet reported a program's number
            return
        known.add(self._forks.pid)
        with contextlib.suppress(ChildProcessError):
            while (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None:
                if ended.si_pid in known:  # its own check collects this one
                    return
                os.waitpid(ended.si_pid, os.WNOHANG)

    def running(self) -> dict[str, int]:
        """Return the names and process numbers of the running programs."""
        return {w.name: w.process.pid for w in self._programs if w.process is not None and w.process.poll() is None}

    def ready_count(self) -> int:
        """Return how many programs are ready, or running if they do not report it."""
        return sum(
            w.ready if w.tells_ready else w.process is not None and w.process.poll() is None
            for w in self._programs
            if not (w.once or w.rescues)
        )

    @property
    def hanging(self) -> frozenset[int]:
        """Process numbers of programs that were found blocked and have not ended yet."""
        return frozenset(
            w.process.pid
            for w in self._programs
            if w.aborted_at is not None and w.process is not None and w.process.poll() is None
        )

    @property
    def misconfigured(self) -> list[str]:
        """Names of programs that cannot run with their configuration."""
        return [w.name for w in self._programs if w.misconfigured]

    @property
    def gave_up(self) -> list[str]:
        """Names of programs that are not restarted any more."""
        return [w.name for w in self._programs if w.gave_up]

    def _look_for_life(self, watched: Watched, process: Process, now: float, turn_s: float) -> None:
        why = watched.problem(process.pid, now, turn_s, self._limits, lambda text: self._on_event(watched.name, text))
        if why:
            self._on_event(watched.name, f"{why}: aborted")
            watched.close_pipe()
            watched.aborted_at = now
            process.send_signal(signal.SIGABRT)

    def _ended(self, watched: Watched, code: int, now: float) -> None:
        watched.process = None
        watched.close_pipe()
        recent = [t for t in watched.starts if now - t < self._window_s]
        watched.crashed = code < 0
        why = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        if watched.crashed and watched.rescue:
            self._start_rescue(watched)
        if watched.rescues and not watched.crashed:
            self._programs.remove(watched)
        elif watched.once:
            self._on_event(watched.name, f"ended with {why}" if code else "done")
        elif code == 2:  # a wrong configuration stays wrong
            watched.gave_up = watched.misconfigured = True
            self._on_event(watched.name, f"ended with {why} and is not restarted: mend its configuration")
        elif len(recent) > self._restarts:
            watched.gave_up = True
            if watched.rescues:  # the next end of its program starts it again
                self._programs.remove(watched)
            self._on_event(watched.name, f"ended with {why}, {len(recent)} times in {self._window_s:g} s: given up")
        else:
            # The first restart is immediate: a killed driver may have left its stylus on the panel.
            delay = _DELAY_S * 2 ** (len(recent) - 2) if len(recent) > 1 else 0.0
            watched.restart_at = now + delay
            what = "does not hear the others" if code == DEAF else f"ended with {why}"
            self._on_event(watched.name, f"{what}, restarted {f'in {delay:g} s' if delay else 'at once'}")

    def _start_rescue(self, watched: Watched) -> None:
        """Start the program's rescue, unless one runs; a rescue that waits for its restart is restarted now."""
        name = f"rescue of {watched.name}"
        if found := next((w for w in self._programs if w.rescues and w.name == name), None):
            if found.restart_at is not None:
                found.restart_at = time.monotonic()
            return
        try:
            self._start(Watched(name=name, command=watched.rescue, rescues=True))
        except OSError as error:
            self._on_event(name, f"cannot be started: {error}")

    def _read(self, key: selectors.SelectorKey) -> None:
        assert not isinstance(key.fileobj, int)
        data = b""
        with contextlib.suppress(BlockingIOError):
            data = os.read(key.fd, 65536)
        *lines, rest = (self._partial.pop(key.fd, b"") + data).split(b"\n")
        if rest:
            self._partial[key.fd] = rest
        for line in lines:
            self._on_output(key.data.name, line.decode(errors="replace"))
        if not data:
            self._partial.pop(key.fd, None)
            self._selector.unregister(key.fileobj)
            key.fileobj.close()  # type: ignore[attr-defined]

    def stop(
        self, within_s: float = 20.0, on_ended: Callable[[str, float], None] = lambda name, after_s: None
    ) -> list[str]:
        """End everything: interrupt, and after a while terminate, abort and kill.

        ``on_ended`` is called with each program's name and the seconds from its first signal to its end.

        A program that is still starting is terminated at once: a KeyboardInterrupt would print a traceback, or be lost
        in a callback of an import.

        The order is: other programs, rescues, programs that end last. So a driver can hold its machine and lift the
        stylus while the board still answers.

        Returns
        -------
        list
            Names of programs that had to be killed.
        """
        for watched in self._programs:
            watched.restart_at = None
        if self._forks is not None:
            self._forks.stop()
        killed: list[str] = []
        for stage in (lambda w: not (w.ends_last or w.rescues), lambda w: w.rescues, lambda w: w.ends_last):
            killed += self._end([w for w in self._programs if w.process is not None and stage(w)], within_s, on_ended)
        for watched in self._programs:
            watched.close_pipe()
        self._read_rest()
        self._selector.close()
        return killed

    def _read_rest(self) -> None:
        """Forward the last output, and close the pipes, which children of a program may still hold."""
        for _ in range(_LAST_READS):
            for key, _ in self._selector.select(0.0):
                self._read(key)
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]

    def _end(self, waiting: list[Watched], within_s: float, on_ended: Callable[[str, float], None]) -> list[str]:
        killed: list[str] = []
        begin = time.monotonic()
        for number, share in _LADDER:
            for watched in waiting:
                assert watched.process is not None
                if number == signal.SIGABRT:
                    killed.append(watched.name)
                starting = number == signal.SIGINT and watched.starting
                with contextlib.suppress(ProcessLookupError):
                    watched.process.send_signal(signal.SIGTERM if starting else number)
            deadline = time.monotonic() + within_s * share
            while waiting and time.monotonic() < deadline:
                for key, _ in self._selector.select(0.05):
                    self._read(key)
                for watched in [w for w in waiting if w.process is None or w.process.poll() is not None]:
                    waiting.remove(watched)
                    on_ended(watched.name, time.monotonic() - begin)
            if not waiting:
                break
        return killed
