"""Codes of goals that failed only because something was slow, and the values that belong to such a code.

A sender decides by the code whether to repeat a goal, never by the words of a reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class ResultCode(str, Enum):
    """Machine-readable cause in ``GoalResult.code``; a result without one has the empty text."""

    STALE = "stale"
    """The receiver rejected the goal because its stamp was too old."""
    LATE_IMAGE = "late_image"
    """A look timed out because images came late, or the camera stalled for longer than the limit."""
    SLOW = "slow"
    """Another limit was exceeded only because a process was slow."""

    def __str__(self) -> str:
        return self.value


RETRYABLE = frozenset(ResultCode)
"""Codes after which the same goal may succeed unchanged. The sender still checks that nothing was touched."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Delay:
    """A limit that was exceeded because something was slow.

    Parameters
    ----------
    code
        The kind of limit.
    what
        The slow thing, as a noun phrase: ``image of the left camera``.
    measured_s
        Measured age or duration in seconds; infinite if nothing came at all.
    limit_s
        The limit that it exceeded, in seconds.
    """

    code: ResultCode
    what: str
    measured_s: float
    limit_s: float

    def text(self) -> str:
        """Return the delay for people: ``image of the left camera is late: 1.42 s (limit 1 s)``."""
        return f"{self.what} is late: {self.measured_s:.2f} s (limit {self.limit_s:g} s)"

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the values as pairs for ``GoalResult.details``."""
        return (
            ("delayed", self.what),
            ("delay_measured_s", f"{self.measured_s:.3f}"),
            ("delay_limit_s", f"{self.limit_s:g}"),
        )
