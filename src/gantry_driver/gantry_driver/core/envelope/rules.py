"""Comparison of a path with its allowed space, before its first byte is sent."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.envelope.plane import PanelPlane
from icu_common.core.goals.intent import Intent
from icu_common.core.reasons.message import Message

Reading = tuple[float, float, float]

SIGMAS = 3.0
"""Number of standard deviations of the plane by which a path may go deeper."""
STRAIGHT_M = 0.0002
"""Maximum sideways motion that counts as rounding: the controller's tolerance of an arrival."""
ROUNDING_M = 5e-5
"""Maximum depth that counts as rounding: a motor step, the third decimal of a line, and the rounding of the plane."""
SIDEWAYS = (Intent.TURN, Intent.DRAG)
"""Intents that move sideways in contact."""


class EnvelopeFault(str, Enum):
    """Machine-readable cause in ``GoalResult.code`` of a trajectory that leaves the allowed space."""

    NO_PANEL = "no_panel"
    """It leaves the free space while the panel's plane is unknown, or not known well enough."""
    OLD_PANEL = "old_panel"
    """It leaves the free space, and the last known plane is too old."""
    TOO_DEEP = "too_deep"
    """It goes farther beyond the panel than its intent allows."""
    TOO_LOW = "too_low"
    """It moves sideways close to the panel, and is not a drag or a turn."""
    SIDEWAYS = "sideways"
    """It moves farther sideways with an extended stylus than a correction may, and is not a drag or a turn."""

    def __str__(self) -> str:
        return self.value


_CODES = {
    EnvelopeFault.NO_PANEL: "envelope.no_panel",
    EnvelopeFault.TOO_DEEP: "envelope.too_deep",
    EnvelopeFault.TOO_LOW: "envelope.too_low",
    EnvelopeFault.SIDEWAYS: "envelope.sideways",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Breach:
    """Point where a path leaves its allowed space; values in metres, or in seconds for a plane that is too old."""

    code: EnvelopeFault
    measured: float
    limit: float
    place: Reading | None = None

    def text(self) -> str:
        """Return a text for people."""
        if self.code is EnvelopeFault.OLD_PANEL:
            return Message("envelope.old_panel", age_s=self.measured, limit_s=self.limit)
        return Message(_CODES[self.code], measured_mm=1e3 * self.measured, limit_mm=1e3 * self.limit)

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the values as pairs for ``GoalResult.details``."""
        unit = "s" if self.code is EnvelopeFault.OLD_PANEL else "m"
        place = () if self.place is None else (("reading_m", " ".join(f"{value:.5f}" for value in self.place)),)
        return ((f"measured_{unit}", f"{self.measured:.5f}"), (f"limit_{unit}", f"{self.limit:.5f}"), *place)


def depth_limit_m(plane: PanelPlane, x: float, y: float, intent: Intent, config: DriverConfig) -> float:
    """Return the maximum depth of a path beyond the face at a point, in metres.

    It is the sum of the intent's travel, the plane's uncertainty, and the rise of the plane over the correction of an
    aim. Readings are corrected by the seen error, so the ball touches slightly off the reading's position.
    """
    travel = 0.0 if intent is Intent.MOVE else config.overtravel_m
    unsure = SIGMAS * min(plane.sigma_m(x, y), config.envelope.max_sigma_m)
    return travel + unsure + math.hypot(*plane.slope) * config.envelope.correction_m + ROUNDING_M


def breach_of(path: Sequence[Reading], plane: PanelPlane | None, intent: Intent, config: DriverConfig) -> Breach | None:
    """Return the first breach of a path.

    The plane and each move are straight, so the extremes are at the ends of the moves. A stylus that is already too
    deep may only rise.

    Parameters
    ----------
    path
        Readings in m, beginning with the current one.
    plane
        Plane of the panel, None while it is unknown.
    """
    anchor: Reading | None = None
    for begin, end in itertools.pairwise(path):
        extended = max(begin[2], end[2]) > config.envelope.crossing_m + ROUNDING_M
        anchor = (anchor or begin) if extended else None
        aside = math.dist((anchor or begin)[:2], end[:2])
        if end[2] <= begin[2] and aside <= STRAIGHT_M:
            continue
        found = _far(end, aside, plane, intent, config) if extended else None
        if plane is None:
            found = _unknown(begin, end, config) or found
        else:
            found = _deep(begin, end, plane, intent, config) or found
            found = found or _low(begin, end, aside, plane, intent, config)
        if found is not None:
            return found
    return None


def _unknown(begin: Reading, end: Reading, config: DriverConfig) -> Breach | None:
    limit, place = config.envelope.free_space_m, max(begin, end, key=lambda place: place[2])
    if place[2] <= limit + ROUNDING_M:
        return None
    return Breach(code=EnvelopeFault.NO_PANEL, measured=place[2], limit=limit, place=place)


def _far(end: Reading, aside: float, plane: PanelPlane | None, intent: Intent, config: DriverConfig) -> Breach | None:
    limit = config.envelope.correction_m
    if aside <= limit or (plane is not None and intent in SIDEWAYS):
        return None
    return Breach(code=EnvelopeFault.SIDEWAYS, measured=aside, limit=limit, place=end)


def _deep(begin: Reading, end: Reading, plane: PanelPlane, intent: Intent, config: DriverConfig) -> Breach | None:
    if config.stylus.kind != "z_axis":
        return None  # it has only one extension, and its own spring limits the force
    for place in (begin, end):
        beyond, limit = place[2] - plane.contact_m(*place[:2]), depth_limit_m(plane, *place[:2], intent, config)
        if beyond > limit:
            return Breach(code=EnvelopeFault.TOO_DEEP, measured=beyond, limit=limit, place=place)
    return None


def _low(
    begin: Reading, end: Reading, aside: float, plane: PanelPlane, intent: Intent, config: DriverConfig
) -> Breach | None:
    if intent in SIDEWAYS or aside <= STRAIGHT_M:
        return None
    height, place = min((plane.contact_m(*place[:2]) - place[2], place) for place in (begin, end))
    limit = config.envelope.side_height_m
    return None if height >= limit else Breach(code=EnvelopeFault.TOO_LOW, measured=height, limit=limit, place=place)
