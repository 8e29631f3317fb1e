"""Points of the panel's face that the acceptance test touches: away from all controls, far from each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import Control

STEP_M = 0.004
"""Distance of the candidates."""
EDGE_M = 0.006
"""Minimum distance of a point from the panel's edge and from a control: the ball, and what it may miss by."""
TALL_M = 0.005
"""Height above which a control needs more room: the shaft of the stylus passes next to it."""
TALL_EDGE_M = 0.010


def choose_points(outline: Array, controls: Sequence[Control], count: int, inside: Array) -> Array:
    """Return at most ``count`` points (N, 2) in metres on the panel, in an order with short ways.

    Each next point is the candidate with the largest distance from all chosen ones (farthest-point sampling).

    Parameters
    ----------
    outline
        (M, 2) corners of the panel's face in metres.
    controls
        Controls to avoid, in mm.
    count
        Number of points.
    inside
        (K, 2) corners of the convex area in reach, in metres of the panel, counter-clockwise.
    """
    low, high = outline.min(axis=0) + EDGE_M, outline.max(axis=0) - EDGE_M
    x, y = np.meshgrid(np.arange(low[0], high[0], STEP_M), np.arange(low[1], high[1], STEP_M))
    free = np.column_stack([x.ravel(), y.ravel()])
    for control in controls:
        middle, half = np.array(control.position_mm) * 1e-3, np.array(control.size_mm) * 0.5e-3
        room = TALL_EDGE_M if control.height_mm * 1e-3 > TALL_M else EDGE_M
        off = np.maximum(np.abs(free - middle) - half, 0.0)
        free = free[np.hypot(*off.T) >= room]
    for start, end in zip(inside, np.roll(inside, -1, axis=0)):
        along, to = end - start, free - start
        free = free[along[0] * to[:, 1] - along[1] * to[:, 0] >= EDGE_M * np.hypot(*along)]
    if not len(free):
        return free
    chosen = [int(np.hypot(*(free - outline.min(axis=0)).T).argmin())]
    distance = np.full(len(free), np.inf)
    while len(chosen) < min(count, len(free)):
        distance = np.minimum(distance, np.hypot(*(free - free[chosen[-1]]).T))
        chosen.append(int(distance.argmax()))
    return _short_way(free[chosen])


def _short_way(points: Array) -> Array:
    """Order points so that each is followed by the nearest one that is left."""
    left = list(range(1, len(points)))
    order = [0]
    while left:
        nearest = min(left, key=lambda i: float(np.hypot(*(points[i] - points[order[-1]]))))
        left.remove(nearest)
        order.append(nearest)
    return np.asarray(points[order])
