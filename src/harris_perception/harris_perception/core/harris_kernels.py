"""The loops of the detector over pixels and corners, compiled by numba; see harris.py for what they are used for."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.compiled import compiled, inlined

F32 = npt.NDArray[np.float32]


@inlined
def quadratic_peak(above: Any, here: Any, below: Any, x: int) -> tuple[float, float]:
    """Return the offset (dx, dy) of the maximum of the quadratic through a 3x3 neighbourhood, at most half a pixel."""
    gx = 0.5 * (here[x + 1] - here[x - 1])
    gy = 0.5 * (below[x] - above[x])
    hxx = here[x + 1] + here[x - 1] - 2.0 * here[x]
    hyy = below[x] + above[x] - 2.0 * here[x]
    hxy = 0.25 * (below[x + 1] - below[x - 1] - above[x + 1] + above[x - 1])
    det = hxx * hyy - hxy * hxy
    if det > 1e-6 * hxx * hyy and hxx < 0.0:
        dx = (hxy * gy - hyy * gx) / det
        dy = (hxy * gx - hxx * gy) / det
        if abs(dx) <= 0.5 and abs(dy) <= 0.5:
            return dx, dy
    # A ridge or saddle beside the peak: each axis alone. A maximum has no positive curvature; zero means a plateau.
    dx = min(max(-gx / hxx, -0.5), 0.5) if hxx < 0.0 else 0.0
    dy = min(max(-gy / hyy, -0.5), 0.5) if hyy < 0.0 else 0.0
    return dx, dy


@inlined
def is_peak(above: Any, here: Any, below: Any, x: int) -> bool:
    """Tell whether a response is the largest of its 3x3 neighbourhood; of equal ones the first in reading order is."""
    r = here[x]
    return bool(
        r > here[x - 1]
        and r >= here[x + 1]
        and r > above[x - 1]
        and r > above[x]
        and r > above[x + 1]
        and r >= below[x - 1]
        and r >= below[x]
        and r >= below[x + 1]
    )


@compiled
def peaks_of(response: F32, margin: int, floor: float, subpixel: bool) -> tuple[F32, F32]:
    """Return xy (N, 2) [px] and response (N,) of the 3x3 maxima above ``floor``, ``margin`` px inside the picture."""
    height, width = response.shape
    count = 0
    xy = np.empty((1024, 2), np.float32)
    strength = np.empty(1024, np.float32)
    for y in range(margin, height - margin):
        above, here, below = response[y - 1], response[y], response[y + 1]
        for x in range(margin, width - margin):
            if here[x] > floor and is_peak(above, here, below, x):
                if count == len(strength):
                    xy = np.concatenate((xy, np.empty_like(xy)))
                    strength = np.concatenate((strength, np.empty_like(strength)))
                dx, dy = quadratic_peak(above, here, below, x) if subpixel else (0.0, 0.0)
                xy[count, 0] = x + dx
                xy[count, 1] = y + dy
                strength[count] = here[x]
                count += 1
    return xy[:count], strength[:count]


@compiled
def apart(xy: F32, distance: float, limit: int) -> npt.NDArray[np.int64]:
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
