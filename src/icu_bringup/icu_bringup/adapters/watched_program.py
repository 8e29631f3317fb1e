"""One program of the graph: its process, the state of its restarts, and its signs of life."""

from __future__ import annotations

import contextlib
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from icu_bringup.adapters.fork_server import ForkedProcess
from icu_common.core.processes.supervision import SIGN_OF_LIFE_S

_STARVED_SHARE = 0.5
"""Minimum share of its silence for which a thread waited for a core; the program is then late and does not hang."""
_STARVED_FACTOR = 4.0
"""Factor by which such a program may be silent longer; a program in an endless loop waits for a core as well."""
_SIGNAL, _DEBUGGER = "T", "t"
_STOPPED_S = 15.0
"""Maximum seconds for which a signal may stop a program; its last state would stay on its topics as if valid."""

Process: TypeAlias = subprocess.Popen[bytes] | ForkedProcess


@dataclass(frozen=True, slots=True, kw_only=True)
class LifeLimits:
    """Limits of a program's silence in seconds; see :class:`~icu_bringup.adapters.processes.ProcessGroup`."""

    ready_s: float
    silent_s: float


@dataclass(slots=True, kw_only=True)
class Watched:
    """One program, its process, and the state of its restarts."""

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
    rescue: list[str] = field(default_factory=list)
    """Command to start when a signal has ended the program."""
    rescues: bool = False
    """Whether it is such a command."""
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
        """Whether the program reports when it is ready and has not done so yet."""
        return self.life_pipe is not None and not self.ready

    def launched(self, life_pipe: int | None, now: float) -> None:
        """Note a start of the process."""
        self.life_pipe = life_pipe
        self.ready, self.silence_s, self.stopped_s, self.aborted_at = False, 0.0, 0.0, None
        self.waited, self.reported_late = {}, False
        self.starts.append(now)
        self.restart_at = None

    def close_pipe(self) -> None:
        """Stop waiting for signs of life."""
        if self.life_pipe is not None:
            os.close(self.life_pipe)
            self.life_pipe = None

    def problem(self, pid: int, now: float, turn_s: float, limits: LifeLimits, report: Callable[[str], None]) -> str:
        """Read the signs of life; return why the program must be aborted, empty if it lives.

        Parameters
        ----------
        pid
            Number of its process.
        now, turn_s
            Time, and the time since the last call.
        limits
            Limits of its silence.
        report
            Called with a text when the program is late for the first time.
        """
        if self._gives_sign():
            return ""
        self.silence_s += turn_s
        if self.silence_s > SIGN_OF_LIFE_S and (stopped_by := _stopped_by(pid)):
            self.stopped_s += self.silence_s if stopped_by == _SIGNAL else 0.0
            self.silence_s = 0.0  # a program that continues needs a moment for its next sign
        if self.ready and self.silence_s > SIGN_OF_LIFE_S and not self.waited:
            self.waited, self.waited_since_s = _waits_for_core(pid), self.silence_s
        if self.stopped_s > _STOPPED_S:
            return f"has been stopped by a signal for {_STOPPED_S:g} s"
        if self.ready and self.silence_s > limits.silent_s:
            if self.silence_s <= _STARVED_FACTOR * limits.silent_s and self._is_starved(pid):
                if not self.reported_late:
                    self.reported_late = True
                    report(f"is late: no sign of life for {limits.silent_s:g} s, it waits for the processor")
                return ""
            limit_s = limits.silent_s * (_STARVED_FACTOR if self.reported_late else 1.0)
            return f"hangs: no sign of life for {limit_s:g} s"
        if not self.ready and len(self.starts) > 1 and now - self.starts[-1] > limits.ready_s:
            return f"is not ready {limits.ready_s:g} s after its restart"
        return ""

    def _gives_sign(self) -> bool:
        assert self.life_pipe is not None
        with contextlib.suppress(BlockingIOError):
            if not os.read(self.life_pipe, 4096):  # the program has closed the pipe or ended
                self.close_pipe()
            self.ready, self.silence_s, self.stopped_s = True, 0.0, 0.0
            self.waited, self.reported_late = {}, False
            return True
        return False

    def _is_starved(self, pid: int) -> bool:
        """Whether a thread of a silent program has waited for a core for most of the time."""
        silent_s = self.silence_s - self.waited_since_s
        waited = _waits_for_core(pid)
        longest_s = max((waited.get(thread, 0.0) - since_s for thread, since_s in self.waited.items()), default=0.0)
        return longest_s > _STARVED_SHARE * silent_s


def _stopped_by(pid: int) -> str:
    """Return the cause of a stopped process, _SIGNAL or _DEBUGGER (proc(5)), "" if it is running."""
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
