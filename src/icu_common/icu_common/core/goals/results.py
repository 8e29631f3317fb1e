"""The answer to each goal, gesture and trajectory, as a value; ``nodes.messages`` converts it to a message."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


class Outcome(str, Enum):
    """``accepted`` is followed by exactly one of ``reached`` or ``aborted``; no other outcome follows ``rejected``."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    REACHED = "reached"
    ABORTED = "aborted"

    @property
    def final(self) -> bool:
        return self is not Outcome.ACCEPTED


class Felt(str, Enum):
    """Knowledge of a touch at its end."""

    PRESSED = "pressed"
    """There was a contact, and its effect was seen."""
    TOUCHED = "touched"
    """There was a contact; no effect was seen."""
    NOT_TOUCHED = "not_touched"
    """Nothing was touched."""
    UNKNOWN = "unknown"
    """Neither a contact nor its absence is certain."""

    def __str__(self) -> str:
        return self.value

    @property
    def contact(self) -> bool:
        """Whether there was certainly a contact."""
        return self in (Felt.PRESSED, Felt.TOUCHED)


EFFECT, EFFECT_MISSING = "effect", "effect_missing"
"""Keys of ``GoalResult.details``: the effect of a touch for people, and the code why none was seen; the latter is
absent if one was seen."""


class EffectMissing(str, Enum):
    """Why no effect of a touch was seen."""

    NONE = "none"
    """The panel was read, and nothing has changed."""
    UNREAD = "unread"
    """The panel was not read since the touch."""
    NOT_LOOKED_FOR = "not_looked_for"

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalResult:
    """One answer.

    Parameters
    ----------
    goal_id
        Identifier by which the sender recognises the answer; see docs/reference/goals.md.
    goal
        The goal as text, for people.
    reason
        Why the goal was rejected or aborted, or how it was reached in an unusual way; empty otherwise.
    error_m
        Measured distance between target and tip in metres; NaN where nothing was measured.
    duration_s
        Time since the goal was accepted, NaN in ``accepted`` and ``rejected``.
    details
        Further key and value pairs, for people and logs.
    code
        Machine-readable cause: a value of :class:`icu_common.core.processes.delays.ResultCode`, or the driver's code of
        a motion that its board's reports contradict, or the cause of a missing contact; empty for every other cause.
    touch
        Knowledge of the touch; None in an answer to a goal without a touch. A goal with a touch is
        ``reached`` only with a contact.
    """

    goal_id: str
    goal: str
    outcome: Outcome
    reason: str = ""
    error_m: float = math.nan
    duration_s: float = math.nan
    details: tuple[tuple[str, str], ...] = ()
    code: str = ""
    touch: Felt | None = None
