"""Judge from its silence whether a process hangs; no I/O and no clock.

The limit is short, and a busy computer must not exceed it. A process that waits for the processor or for a page of
memory is late, not hung. This time is excused up to a bound, also if the process runs for a moment in between. A
process that is stopped, sleeps, or runs without sending has no excuse.
"""

from __future__ import annotations

from dataclasses import dataclass

LATE_S = 0.5
"""Seconds of silence that no excuse covers: less than the maximum age of the operator's heartbeat."""
LOOK_S = 0.04
"""Seconds of silence after which the threads of the process are sampled."""
TURN_S = 0.05
"""Maximum seconds between two looks that count: the observer itself may have been delayed for longer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThreadSample:
    """State of a thread: whether it can run, its processor time, and the time it waited for the processor."""

    runnable: bool
    cpu_ns: int
    waited_ns: int = 0

    def waited_s(self, before: ThreadSample, passed_s: float) -> float:
        """Return the seconds since ``before`` in which it waited; the kernel adds a wait only when the wait ends."""
        waits_yet = self.runnable and self.cpu_ns == before.cpu_ns
        return passed_s if waits_yet else min(passed_s, (self.waited_ns - before.waited_ns) / 1e9)


class SilenceWatch:
    """Measures how long another process has been silent.

    Parameters
    ----------
    limit_s
        Maximum silence without an excuse, s; it may change.
    now
        Wall time, s.
    late_s
        Maximum silence with an excuse, s.
    """

    def __init__(self, limit_s: float, now: float, late_s: float = LATE_S) -> None:
        self.limit_s, self._late_s = limit_s, max(limit_s, late_s)
        self._looked_at = now
        self._silent_s = self._excused_s = 0.0
        self._threads: dict[int, ThreadSample] = {}

    def beat(self, now: float) -> None:
        """Note a sign of life."""
        self._looked_at, self._silent_s, self._excused_s = now, 0.0, 0.0
        self._threads = {}

    @property
    def wants_sample(self) -> bool:
        """Whether the next :meth:`look` needs the threads."""
        return self._silent_s >= LOOK_S

    @property
    def silent_s(self) -> float:
        """Seconds of silence in which the caller itself ran."""
        return self._silent_s

    def look(self, now: float, threads: dict[int, ThreadSample] | None = None) -> bool:
        """Return whether the process counts as hung.

        Parameters
        ----------
        now
            Wall time, s.
        threads
            Its threads by number; None if they were not sampled, empty if the process has ended.
        """
        passed = min(now - self._looked_at, TURN_S)
        self._looked_at = now
        self._silent_s += passed
        if threads is not None:
            known = [(thread, self._threads[n]) for n, thread in threads.items() if n in self._threads]
            self._excused_s += max((thread.waited_s(before, passed) for thread, before in known), default=0.0)
            self._threads = threads
        return self._silent_s - self._excused_s > self.limit_s or self._silent_s > self._late_s
