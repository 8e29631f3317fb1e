"""Codes of goals that failed only because something was slow, and the values that belong to such a code.

A sender decides by the code whether to repeat a goal, never by the text of a reason. A result has a code only if the
same goal may succeed unchanged: the stylus has touched nothing, and no stop waits for a person.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from icu_common.core.goals.results import GoalResult
from icu_common.core.reasons.message import Message


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


_WHAT, _MEASURED, _LIMIT = "delayed", "delay_measured_s", "delay_limit_s"


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
        Measured age or duration in seconds.
    limit_s
        The limit that it exceeded, in seconds.
    """

    code: ResultCode
    what: str
    measured_s: float
    limit_s: float

    def text(self) -> str:
        """Return the delay for people."""
        return Message("goal.late_limit", what=self.what, measured_s=self.measured_s, limit_s=self.limit_s)

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the values as pairs for ``GoalResult.details``."""
        return (
            (_WHAT, self.what),
            (_MEASURED, f"{self.measured_s:.3f}"),
            (_LIMIT, f"{self.limit_s:g}"),
        )


def delay_of(result: GoalResult) -> Delay | None:
    """Return the delay that a result names, None if it has no known code or no values."""
    values = dict(result.details)
    try:
        return Delay(
            code=ResultCode(result.code),
            what=values[_WHAT],
            measured_s=float(values[_MEASURED]),
            limit_s=float(values[_LIMIT]),
        )
    except (KeyError, ValueError):
        return None


def is_delayed(result: GoalResult) -> bool:
    """Return whether slowness caused a result, whether or not the goal may be repeated."""
    return any(key == _WHAT for key, _ in result.details)


def with_load(result: GoalResult, load: str) -> GoalResult:
    """Return the result with the processor load appended to its reason; unchanged if the load is not known."""
    return replace(result, reason=Message("text.and_also", first=result.reason, second=load)) if load else result
