"""The guard's clock: the steady clock, or the simulated time that the node sends."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from icu_common.adapters.real_time import steady_s
from icu_common.adapters.steps.step_layout import BYTES_READ, BYTES_WRITTEN, LEDGER_VARIABLE, StepCounts


class GuardClock:
    """Follows the node's time if the node's clock is not the steady one.

    Without a node, or while the node hangs, the clock advances by the time of the simulation's ledger if there is one,
    else by the steady clock. So a stop completes. It never goes back, also when the next node connects.

    Parameters
    ----------
    counts
        The ledger of a simulation in steps; None outside one.
    """

    def __init__(self, counts: StepCounts | None = None) -> None:
        self._counts = counts
        self._told_s: float | None = None
        self._offset_s: float | None = None
        self._since_s = 0.0
        self._alone = False

    def __call__(self) -> float:
        """Return the time in seconds; 0 while simulated time is unknown."""
        if self._told_s is None:
            return steady_s()
        if not self._alone:
            return self._told_s
        if self._counts is not None:
            return max(self._told_s, self._counts.time_s)
        return self._told_s + steady_s() - self._since_s

    @property
    def simulated(self) -> bool:
        """Whether the node's clock is not the steady one."""
        return self._told_s is not None

    @property
    def wants_turns(self) -> bool:
        """Whether the link must poll the clock because no node sends steps."""
        return self._alone and self._counts is not None

    def begin(self, now_s: float | None) -> None:
        """Start with a node's time: None for the steady clock, 0 while the time is unknown."""
        before_s = 0.0 if self._told_s is None else self()
        self._alone, self._offset_s = False, None
        self._told_s = None if now_s is None else before_s
        self.tell(now_s or 0.0)

    def tell(self, now_s: float) -> None:
        """Set the node's new time."""
        if self._told_s is None or not now_s:
            return
        self.rejoin()
        if self._offset_s is None:
            self._offset_s = max(0.0, self._told_s - now_s)
        self._told_s = max(self._told_s, now_s + self._offset_s)

    def leave(self) -> None:
        """Continue without a node."""
        if self._told_s is not None and not self._alone:
            self._alone, self._since_s = True, steady_s()

    def rejoin(self) -> None:
        """Follow the node's time again."""
        if self._alone:
            self._told_s, self._alone, self._offset_s = self(), False, None

    def count_alone(self, read: int, written: int) -> bool:
        """Count a link's bytes in the ledger if there is no node to do it; return whether they were counted."""
        if self._alone and self._counts is not None:
            self._counts.finish(BYTES_READ, read)
            self._counts.finish(BYTES_WRITTEN, written)
        return self._alone


def counts_of_environment() -> StepCounts | None:
    """Return the ledger that the environment names, None if there is none or it cannot be opened."""
    path = os.environ.get(LEDGER_VARIABLE, "")
    with contextlib.suppress(OSError):
        return StepCounts(Path(path)) if path else None
    return None
