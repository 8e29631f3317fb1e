"""The answer that every goal, gesture and trajectory gets, as a value; ``nodes.conversions`` makes it a message."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


class Outcome(str, Enum):
    """``accepted`` is followed by exactly one of ``reached`` or ``aborted``; ``rejected`` stands alone."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    REACHED = "reached"
    ABORTED = "aborted"

    @property
    def final(self) -> bool:
        return self is not Outcome.ACCEPTED


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalResult:
    """One answer.

    Parameters
    ----------
    goal_id
        What the asker matches on; see docs/architecture.md.
    goal
        The goal as text, for people.
    reason
        Why it was rejected or aborted, or how else it was reached than usual; empty when there is nothing to say.
    error_m
        Measured distance between target and tip in metres; NaN where nothing was measured.
    duration_s
        Time since the goal was accepted, NaN in ``accepted`` and ``rejected``.
    details
        Further key and value pairs, for people and logs.
    code
        Machine-readable cause: a value of :class:`icu_common.core.delays.ResultCode`, or the driver's code of a motion
        that its board's reports contradict; empty for every other cause.
    """

    goal_id: str
    goal: str
    outcome: Outcome
    reason: str = ""
    error_m: float = math.nan
    duration_s: float = math.nan
    details: tuple[tuple[str, str], ...] = ()
    code: str = ""
