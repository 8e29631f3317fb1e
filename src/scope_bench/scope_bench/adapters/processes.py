"""Starts the programs of the graph, watches them, restarts what fell over, and ends the simulated hardware last."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from icu_common.core.supervision import AFTER_CRASH_VARIABLE, DEAF, READY_VARIABLE, SIGN_OF_LIFE_S
from scope_bench.adapters.fork_server import ForkedProcess, ForkServer, die_with_parent, is_forkable

_LONGEST_TURN_S = 1.0
"""No more silence is counted between two looks: bring-up may have stood still itself."""
_LAST_READS = 64
"""So often the pipe of a program that has ended, which holds as much as one or two reads, is read at most."""
_STARVED_SHARE = 0.5
"""Share of its silence for which a thread waited for a core: from here on the program is late, and does not hang."""
_STARVED_FACTOR = 4.0
"""Factor up to which such a program may be silent for longer; what spins in a loop waits for a core as well."""
_ABORT_S = 5.0
"""For what hangs to tell where (Python's faulthandler) and to end, before it is killed."""

_LADDER = ((signal.SIGINT, 0.7), (signal.SIGTERM, 0.2), (signal.SIGABRT, 0.05), (signal.SIGKILL, 0.05))
"""Signals at the end, each with its share of the time. SIGABRT lets a node print where it hangs (faulthandler)."""

Process: TypeAlias = subprocess.Popen[bytes] | ForkedProcess


@dataclass(slots=True, kw_only=True)
class Watched:
    """One program, its process, and what is known of its restarts."""

    name: str
    command: list[str]
    process: Process | None = None
    starts: list[float] = field(default_factory=list)
    restart_at: float | None = None
    gave_up: bool = False
    misconfigured: bool = False
    once: bool = False
    ends_last: bool = False
    tells_ready: bool = False
    crashed: bool = False
    life_pipe: int | None = None
    ready: bool = False
    silence_s: float = 0.0
    stopped_s: float = 0.0
    waited: dict[str, float] = field(default_factory=dict)
    """Seconds for which each thread had waited for a core when the silence began to count; empty before."""
    waited_since_s: float = 0.0
    reported_late: bool = False
    aborted_at: float | None = None

    @property
    def starting(self) -> bool:
        """Whether it could say that it is ready and has not done so."""
        return self.life_pipe is not None and not self.ready


_SIGNAL, _DEBUGGER = "T", "t"
_STOPPED_S = 15.0
"""Longest time for which a signal may stop a program; its last state would stay on its topics as if it were true."""


def _stopped_by(pid: int) -> str:
    """Return what has stopped a process, _SIGNAL or _DEBUGGER (proc(5)), "" for nothing."""
    with contextlib.suppress(OSError):
        state = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()[0]
        return state if state in (_SIGNAL, _DEBUGGER) else ""
    return ""


def _waits_for_core(pid: int) -> dict[str, float]:
    """Return for how many seconds each thread of a process has waited for a core so far (proc(5), schedstat)."""
    found = {}
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            found[path.parent.name] = int(path.read_text().split()[1]) / 1e9
    return found


class ProcessGroup:
    """The processes of one graph.

    Parameters
    ----------
    environment
        Of every process.
    on_output
        Called with (program, line) for every line that a program prints.
    on_event
        Called with (program, text) when a program ends, is restarted or given up.
    restarts
        How often a program may be restarted within ``window_s``; the delay doubles from half a second.
    ready_s
        A restarted program that could say that it is ready, and does not within this time, is aborted: shared
        memory that its predecessor held when it was killed can hang it. A first start may take as long as it needs.
    silent_s
        A program that was ready and gives no sign of life for this time is aborted, so that it tells where it is, and
        killed if that does not end it; time for which a signal or a debugger has stopped it does not count, but a
        signal may stop it for _STOPPED_S only.
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
        self._ready_s = ready_s
        self._silent_s = silent_s
        self._looked_at = time.monotonic()
        self._programs: list[Watched] = []
        self._selector = selectors.DefaultSelector()
        self._partial: dict[int, bytes] = {}
        self._forks = forks
        if forks is not None:
            os.set_blocking(forks.stdout.fileno(), False)
            self._selector.register(forks.stdout, selectors.EVENT_READ, Watched(name="starter", command=[]))

    def start(self, name: str, command: list[str], *, ends_last: bool = False, tells_ready: bool = False) -> None:
        """Start a program; one that ``ends_last`` is ended when all others are gone.

        One that ``tells_ready`` writes a byte to the file descriptor ``ICU_READY_FD`` when it is, and then each second.

        Raises
        ------
        OSError
            If the executable cannot be started.
        """
        self._start(Watched(name=name, command=command, ends_last=ends_last, tells_ready=tells_ready))

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
                start_new_session=True,  # the terminal's Ctrl-C reaches bring-up alone, which ends the others in order
                preexec_fn=die_with_parent,
            )
        if ready:
            os.close(ready[1])
            os.set_blocking(ready[0], False)
            watched.life_pipe = ready[0]
        watched.ready, watched.silence_s, watched.stopped_s, watched.aborted_at = False, 0.0, 0.0, None
        watched.waited, watched.reported_late = {}, False
        watched.starts.append(time.monotonic())
        watched.restart_at = None
        assert watched.process.stdout is not None
        os.set_blocking(watched.process.stdout.fileno(), False)
        self._selector.register(watched.process.stdout, selectors.EVENT_READ, watched)

    def watch(self, timeout_s: float) -> None:
        """Pass on output and restart what has ended, for at most ``timeout_s``."""
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
                self._look_for_life(watched, watched.life_pipe, process, now, turn_s)
            elif process is not None and watched.aborted_at is not None and now - watched.aborted_at > _ABORT_S:
                process.kill()
            if watched.restart_at is not None and now >= watched.restart_at:
                self._launch(watched)

    def _reap_orphans(self) -> None:
        """Take the exit codes of what killed programs have left behind: bring-up is its parent then (subreaper)."""
        known = {w.process.pid for w in self._programs if w.process is not None}
        if self._forks is None or 0 in known:  # 0: the server has not yet reported a program's number
            return
        known.add(self._forks.pid)
        with contextlib.suppress(ChildProcessError):
            while (ended := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None:
                if ended.si_pid in known:  # its own look takes this one
                    return
                os.waitpid(ended.si_pid, os.WNOHANG)

    def running(self) -> dict[str, int]:
        """Return the names and process numbers of what runs."""
        return {w.name: w.process.pid for w in self._programs if w.process is not None and w.process.poll() is None}

    def ready_count(self) -> int:
        """Return how many programs are ready, or run where they do not report it."""
        return sum(
            w.ready if w.tells_ready else w.process is not None and w.process.poll() is None
            for w in self._programs
            if not w.once
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

    def _look_for_life(self, watched: Watched, pipe: int, process: Process, now: float, turn_s: float) -> None:
        with contextlib.suppress(BlockingIOError):
            if not os.read(pipe, 4096):  # it has closed the pipe, or ended
                self._close_pipe(watched)
            watched.ready, watched.silence_s, watched.stopped_s = True, 0.0, 0.0
            watched.waited, watched.reported_late = {}, False
            return
        watched.silence_s += turn_s
        if watched.silence_s > SIGN_OF_LIFE_S and (stopped_by := _stopped_by(process.pid)):
            watched.stopped_s += watched.silence_s if stopped_by == _SIGNAL else 0.0
            watched.silence_s = 0.0  # a program that continues needs a moment for its next sign
        if watched.ready and watched.silence_s > SIGN_OF_LIFE_S and not watched.waited:
            watched.waited, watched.waited_since_s = _waits_for_core(process.pid), watched.silence_s
        if watched.stopped_s > _STOPPED_S:
            why = f"has been stopped by a signal for {_STOPPED_S:g} s"
        elif watched.ready and watched.silence_s > self._silent_s:
            if watched.silence_s <= _STARVED_FACTOR * self._silent_s and self._is_starved(watched, process.pid):
                if not watched.reported_late:
                    watched.reported_late = True
                    text = f"is late: no sign of life for {self._silent_s:g} s, it waits for the processor"
                    self._on_event(watched.name, text)
                return
            limit_s = self._silent_s * (_STARVED_FACTOR if watched.reported_late else 1.0)
            why = f"hangs: no sign of life for {limit_s:g} s"
        elif not watched.ready and len(watched.starts) > 1 and now - watched.starts[-1] > self._ready_s:
            why = f"is not ready {self._ready_s:g} s after its restart"
        else:
            return
        self._on_event(watched.name, f"{why}: aborted")
        self._close_pipe(watched)
        watched.aborted_at = now
        process.send_signal(signal.SIGABRT)

    @staticmethod
    def _is_starved(watched: Watched, pid: int) -> bool:
        """Whether a thread of a silent program has waited for a core for most of the time."""
        silent_s = watched.silence_s - watched.waited_since_s
        waited = _waits_for_core(pid)
        longest_s = max((waited.get(thread, 0.0) - since_s for thread, since_s in watched.waited.items()), default=0.0)
        return longest_s > _STARVED_SHARE * silent_s

    @staticmethod
    def _close_pipe(watched: Watched) -> None:
        if watched.life_pipe is not None:
            os.close(watched.life_pipe)
            watched.life_pipe = None

    def _ended(self, watched: Watched, code: int, now: float) -> None:
        watched.process = None
        self._close_pipe(watched)
        recent = [t for t in watched.starts if now - t < self._window_s]
        watched.crashed = code < 0
        why = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        if watched.once:
            self._on_event(watched.name, f"ended with {why}" if code else "done")
        elif code == 2:  # a wrong configuration stays wrong
            watched.gave_up = watched.misconfigured = True
            self._on_event(watched.name, f"ended with {why} and is not restarted: mend its configuration")
        elif len(recent) > self._restarts:
            watched.gave_up = True
            self._on_event(watched.name, f"ended with {why}, {len(recent)} times in {self._window_s:g} s: given up")
        else:
            delay = 0.5 * 2 ** max(len(recent) - 1, 0)
            watched.restart_at = now + delay
            what = "does not hear the others" if code == DEAF else f"ended with {why}"
            self._on_event(watched.name, f"{what}, restarted in {delay:g} s")

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

    def stop(self, within_s: float = 20.0) -> list[str]:
        """End everything: interrupt, and after a while terminate, abort and kill.

        What is still starting is terminated at once: there a KeyboardInterrupt prints a traceback, or ends in a
        callback of an import, which swallows it.

        First all but those that end last, so that a driver can hold its machine and lift the stylus while the board
        still answers; then those.

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
        for last in (False, True):
            killed += self._end([w for w in self._programs if w.process is not None and w.ends_last is last], within_s)
        for watched in self._programs:
            self._close_pipe(watched)
        self._read_rest()
        self._selector.close()
        return killed

    def _read_rest(self) -> None:
        """Pass on the last words, and close the pipes, which what a program has left behind may still hold."""
        for _ in range(_LAST_READS):
            for key, _ in self._selector.select(0.0):
                self._read(key)
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]

    def _end(self, waiting: list[Watched], within_s: float) -> list[str]:
        killed: list[str] = []
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
                waiting = [w for w in waiting if w.process is not None and w.process.poll() is None]
            if not waiting:
                break
        return killed
