"""The guard's plane, and its check of each path."""

from __future__ import annotations

import math

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.core.envelope.rules import SIGMAS, Breach, EnvelopeFault, Reading, breach_of
from gantry_driver.core.grbl.trajectory_gcode import StraightMove, TrajectoryMotion, reading_m
from icu_common.core.goals.intent import Intent

JUMP_M = 0.002
"""Change of the plane within the travel, in metres, above which it is reported."""


class Envelope:
    """The space that paths may use."""

    def __init__(self) -> None:
        self._plane: PanelPlane | None = None
        self._seen_at = -math.inf

    def take(self, plane: PanelPlane, seen_at: float, config: DriverConfig) -> str:
        """Take the plane and the time of its image; return a warning for people, empty if there is none."""
        before, self._plane, self._seen_at = self._plane, plane, seen_at
        at_x, at_y, _ = plane.at_m
        sigma, limit = plane.sigma_m(at_x, at_y), config.envelope.max_sigma_m
        if sigma > limit:
            self._plane = None
            if before is None:
                return ""
            return (
                f"the panel's plane counts as unknown: its standard deviation is {1000.0 * sigma:.2f} mm (limit "
                f"{1000.0 * limit:g} mm)"
            )
        if before is None:
            return ""
        right, back, _ = config.limits_m()
        corners = [(x, y) for x in (0.0, right) for y in (0.0, back)]
        moved, allowed = max(
            (abs(plane.contact_m(x, y) - before.contact_m(x, y)), SIGMAS * (plane.sigma_m(x, y) + before.sigma_m(x, y)))
            for x, y in corners
        )
        if moved <= max(JUMP_M, allowed):
            return ""
        return f"the panel's plane has moved by up to {1000.0 * moved:.1f} mm within the travel"

    def breach(
        self, motion: TrajectoryMotion, start: Reading, intent: Intent, config: DriverConfig, now: float
    ) -> Breach | None:
        """Return the first point where a motion leaves its allowed space, None if it stays inside."""
        age_s, limit_s = now - self._seen_at, config.envelope.max_age_s
        known = self._plane if age_s <= limit_s else None
        found = breach_of(path_of(motion, start, config), known, intent, config)
        if found is not None and found.code is EnvelopeFault.NO_PANEL and self._plane is not None:
            return Breach(code=EnvelopeFault.OLD_PANEL, measured=age_s, limit=limit_s, place=found.place)
        return found


def path_of(motion: TrajectoryMotion, start: Reading, config: DriverConfig) -> list[Reading]:
    """Return the readings at the ends of a motion's parts, beginning with its start."""
    path = [start]
    for part in motion.parts:
        x, y, z = path[-1]
        if not isinstance(part, StraightMove):
            path.append((x, y, config.stylus.stroke_m if part.down else 0.0))
            continue
        to_x, to_y, to_z = reading_m(part.end_mm, False, config)
        path.append((to_x, to_y, to_z if part.axes == 3 else z))
    return path
