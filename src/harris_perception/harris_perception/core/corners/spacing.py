"""Selection of corners that keep a distance to each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import compiled

Array = npt.NDArray[Any]


@compiled
def apart(xy: Array, distance: float, limit: int) -> npt.NDArray[np.int64]:
    """Return indices of at most ``limit`` points, taken in order, that keep ``distance`` px to all taken before."""
    left, top = xy[:, 0].min(), xy[:, 1].min()
    columns = int((xy[:, 0].max() - left) / distance) + 1
    rows = int((xy[:, 1].max() - top) / distance) + 1
    first = np.full((rows, columns), -1, np.int32)
    following = np.empty(len(xy), np.int32)
    taken = np.empty(min(limit, len(xy)), np.int64)
    count = 0
    for i in range(len(xy)):
        if count == len(taken):
            break
        column, row = int((xy[i, 0] - left) / distance), int((xy[i, 1] - top) / distance)
        free = True
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                j = first[r, c]
                while j >= 0 and free:
                    dx, dy = xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]
                    free = dx * dx + dy * dy >= distance * distance
                    j = following[j]
        if free:
            following[i] = first[row, column]
            first[row, column] = i
            taken[count] = i
            count += 1
    return taken[:count]


def spread(xy: Array, least: float, limit: int) -> npt.NDArray[np.int64]:
    """Return ``limit`` indices of corners (N, 2) px, strongest first, at the largest distance, at least ``least`` px.

    The distance that leaves this number is found by bisection (Bailo, PRL 106, 2018).
    """
    low, high = least, float(np.hypot(*np.ptp(xy, axis=0))) + least
    best = apart(xy, low, limit)
    while high - low > 0.25 and len(best) == limit:
        middle = 0.5 * (low + high)
        tried = apart(xy, middle, limit)
        if len(tried) == limit:
            low, best = middle, tried
        else:
            high = middle
    return best
