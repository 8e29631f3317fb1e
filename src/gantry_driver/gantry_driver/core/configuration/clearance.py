"""Height at which a path stops before it touches, so that a damaged approach ends above the panel."""

from __future__ import annotations

import math

TUBE_MM = 0.15
"""Radius of the tube around the path in which reports must lie. It covers at most two motor steps of each axis at 80
steps/mm, and a report that is read in mid-step."""
REPORT_WAY_S = 0.02
"""Duration from a position to the ``!`` at the board: report (70 bytes at 115200 baud: 6 ms), adapter, driver."""
LOOK_AHEAD_S = 0.05
"""Motion that GRBL has prepared and finishes before a hold begins: five segments of 10 ms (gnea/grbl, stepper.c)."""


def stopping_way_mm(rate_mm_min: float, acceleration_mm_s2: float, travel_mm: float, reports_hz: float) -> float:
    """Return how far below its planned end a damaged approach goes before it stops.

    A damaged line may run at the axis's maximum rate, but not faster than the axis can accelerate within the travel.
    The axis leaves the tube, the next report arrives, the driver sends the hold, and the axis slows down:
    ``tube + v * (1 / reports + way of the report + look-ahead) + v^2 / (2 * acceleration)``.

    Examples
    --------
    >>> round(stopping_way_mm(3000.0, 400.0, 60.0, 50.0), 3)
    7.775
    """
    speed = min(rate_mm_min / 60.0, math.sqrt(2.0 * acceleration_mm_s2 * travel_mm))
    unseen_s = 1.0 / reports_hz + REPORT_WAY_S + LOOK_AHEAD_S
    return TUBE_MM + speed * unseen_s + speed**2 / (2.0 * acceleration_mm_s2)
