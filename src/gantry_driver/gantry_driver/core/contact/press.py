"""Travel of a press, and the verdict on a touch."""

from __future__ import annotations

from enum import Enum

from gantry_driver.core.contact.config import ContactConfig
from gantry_driver.core.contact.lag import Lag
from icu_common.core.goals.results import Felt

ENVELOPE_SPARE_M = 0.0001
"""Distance that a press keeps from the limit of the driver's envelope, in metres."""


class Evidence(str, Enum):
    """One kind of evidence that a touch was made."""

    LAG = "lag"
    """The ball stopped following its drive, seen by both cameras."""
    SWITCH = "switch"
    """The probe pin of the board closed."""
    EFFECT = "effect"
    """A lamp, a screen or a knob changed."""

    def __str__(self) -> str:
        return self.value


class ContactCode(str, Enum):
    """Machine-readable cause in ``GoalResult.code`` of a touch that was not felt."""

    NOT_TOUCHED = "not_touched"
    """The ball has followed its drive to the end, so there was no surface."""
    UNKNOWN = "contact_unknown"
    """Neither a contact nor its absence was seen."""
    STYLUS_OFFSET = "stylus_offset"
    """The stylus is farther off its readings than the controller corrects."""

    def __str__(self) -> str:
        return self.value


def next_extension_m(here_m: float, deepest_m: float, lag: Lag, config: ContactConfig) -> float | None:
    """Return the extension of the next step of a press, None at its end.

    A press ends when the ball has stopped, or at the deepest allowed extension.
    """
    if lag.stopped(config):
        return None
    # A ball with a small lag is already on the surface: press only the remaining travel.
    step = max(config.step_m - max(lag.lag_m, 0.0), config.lag_m)
    deeper = min(here_m + step, deepest_m)
    return deeper if deeper - here_m > 0.5 * config.lag_m else None


def verdict(
    lag: Lag | None, *, effect: bool, own_lamp: bool, switch: bool | None, config: ContactConfig
) -> tuple[Felt, tuple[Evidence, ...]]:
    """Return whether a touch was felt, and the evidence for it.

    Parameters
    ----------
    lag
        None if the ball was not measured both in the air and in contact.
    effect
        Whether an effect was seen.
    own_lamp
        Whether the effect is the lamp of the touched control itself. If the ball is hidden, it replaces the contact.
    switch
        State of the probe pin in contact, None without a switch.
    """
    found = []
    if lag is not None and lag.stopped(config):
        found.append(Evidence.LAG)
    if switch:
        found.append(Evidence.SWITCH)
    contact = bool(found)
    if effect:
        found.append(Evidence.EFFECT)
    if contact:
        return (Felt.PRESSED if effect else Felt.TOUCHED), tuple(found)
    if lag is None and switch is None and effect and own_lamp:
        return Felt.PRESSED, tuple(found)
    nothing = lag is not None and lag.free(config) and not effect
    return (Felt.NOT_TOUCHED if nothing else Felt.UNKNOWN), tuple(found)
