"""Readings that the acceptance test visits with the stylus retracted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from icu_common.core.geometry.geometry import Array

BESIDE_M = 0.006
"""Distance of the two stops of a backlash pair; the controller approaches the upper one from below."""
BEYOND_M = 0.005
"""Distance outside the limits of goals that the controller must reject."""
_SHARES = (1 / 3, 2 / 3)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AcceptanceStop:
    """One position: readings (2,) in metres, and whether it is a corner of the travel.

    ``from_above`` (2,) is 1 where the axis arrives from above, 0 where from below. The controller approaches every
    target from below, except at the lower limit of an axis, where there is no room below.
    """

    reading: Array
    corner: bool = False
    from_above: Array


def plan_stops(low: Array, high: Array) -> list[AcceptanceStop]:
    """Return the stops for the limits (2,) in metres: the centre, the four corners, and pairs for the backlash.

    Each stop at a lower limit follows one away from it, so that the axis arrives there from above. The next stops may
    keep that axis at its limit.
    """
    (x0, y0), (x1, y1) = low, high
    readings = [(x0 + (x1 - x0) / 2, y0 + (y1 - y0) / 2, False), (x0, y0, True), (x1, y0, True)]
    readings += [(x1, y1, True), (x0, y1, True)]
    for share in reversed(_SHARES):
        y = y0 + share * (y1 - y0)
        readings += [(x0 + BESIDE_M, y, False), (x0, y, False)]
    for share in _SHARES:
        x = x0 + share * (x1 - x0)
        readings += [(x, y0 + BESIDE_M, False), (x, y0, False)]
    return [
        AcceptanceStop(reading=np.array([x, y]), corner=corner, from_above=np.array([float(x == x0), float(y == y0)]))
        for x, y, corner in readings
    ]


def beyond(low: Array, high: Array) -> list[Array]:
    """Return readings (2,) in metres outside each of the four limits."""
    middle = (low + high) / 2
    return [
        np.array([low[0] - BEYOND_M, middle[1]]),
        np.array([high[0] + BEYOND_M, middle[1]]),
        np.array([middle[0], low[1] - BEYOND_M]),
        np.array([middle[0], high[1] + BEYOND_M]),
    ]
