"""The loops of the edge detector over pixels, compiled by numba; see edges.py for what they are used for."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.compiled import called, compiled

Array = npt.NDArray[Any]

# Neighbours in circular order; even ones share a side.
_DX = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int32)
_DY = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int32)


@compiled
def thin(a: Array, b: Array, c: Array, k: float) -> Array:
    """Return (-R / k)^(1/4) where R < 0 and a maximum along the structure tensor's main direction, else 0.

    The two values beside a pixel are interpolated between its neighbours, as Canny's suppression does.
    """
    height, width = a.shape
    weight, one = np.float32(k), np.float32(1.0)
    strength = np.zeros((height, width), np.float32)
    for y in range(height):
        ra, rb, rc, out = a[y], b[y], c[y], strength[y]
        for x in range(width):
            trace = ra[x] + rb[x]
            r = ra[x] * rb[x] - rc[x] * rc[x] - weight * trace * trace
            out[x] = np.sqrt(np.sqrt(max(-r, np.float32(0.0)) / weight)) if r < 0 else np.float32(0.0)
    result = np.zeros((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            s = strength[y, x]
            if s <= 0.0:
                continue
            # The tangent of half the angle atan2(2 c, a - b), measured from the axis nearer to the direction.
            difference, twice = a[y, x] - b[y, x], np.float32(2.0) * c[y, x]
            share = abs(twice) / (abs(difference) + np.sqrt(difference * difference + twice * twice))
            sign = 1 if twice >= 0 else -1
            if difference >= 0:
                step_x, step_y, side_x, side_y = 1, sign, 1, 0
            else:
                step_x, step_y, side_x, side_y = sign, 1, 0, 1
            # Beyond the picture the edge goes on as it is, so that it is not lost along the frame.
            xs, ys = min(max(x + side_x, 0), width - 1), min(max(y + side_y, 0), height - 1)
            xd, yd = min(max(x + step_x, 0), width - 1), min(max(y + step_y, 0), height - 1)
            ahead = (one - share) * strength[ys, xs] + share * strength[yd, xd]
            xs, ys = min(max(x - side_x, 0), width - 1), min(max(y - side_y, 0), height - 1)
            xd, yd = min(max(x - step_x, 0), width - 1), min(max(y - step_y, 0), height - 1)
            behind = (one - share) * strength[ys, xs] + share * strength[yd, xd]
            if s > behind and s >= ahead:
                result[y, x] = s
    return result


@compiled
def hysteresis(thinned: Array, high: float, low: float, least: int) -> Array:
    """Return the mask of connected pixels above ``low`` with one above ``high``, in pieces of ``least`` or more."""
    height, width = thinned.shape
    mask = np.zeros((height, width), np.bool_)
    seen = np.zeros((height, width), np.bool_)
    queue = np.empty((height * width, 2), np.int32)
    for y0 in range(height):
        for x0 in range(width):
            if seen[y0, x0] or not (thinned[y0, x0] > 0.0 and thinned[y0, x0] >= high):
                continue
            queue[0, 0], queue[0, 1] = x0, y0
            seen[y0, x0] = True
            count, done = 1, 0
            while done < count:
                x, y = queue[done, 0], queue[done, 1]
                done += 1
                for i in range(8):
                    xn, yn = x + _DX[i], y + _DY[i]
                    if not (0 <= xn < width and 0 <= yn < height) or seen[yn, xn]:
                        continue
                    if thinned[yn, xn] > 0.0 and thinned[yn, xn] >= low:
                        seen[yn, xn] = True
                        queue[count, 0], queue[count, 1] = xn, yn
                        count += 1
            if count >= least:
                for i in range(count):
                    mask[queue[i, 1], queue[i, 0]] = True
    return mask


@called
def _around(mask: Array, x: int, y: int, ring: Array) -> int:
    """Fill ``ring`` with the eight neighbours and return how many are set."""
    count = 0
    for i in range(8):
        xn, yn = x + _DX[i], y + _DY[i]
        inside = 0 <= xn < mask.shape[1] and 0 <= yn < mask.shape[0]
        ring[i] = 1 if inside and mask[yn, xn] else 0
        count += ring[i]
    return count


@called
def _pieces(ring: Array) -> int:
    """Return in how many pieces the neighbours would fall apart without the pixel (Yokoi's number, 8-connected)."""
    number = 0
    for i in range(0, 8, 2):
        s0, s1, s2 = 1 - ring[i], 1 - ring[i + 1], 1 - ring[(i + 2) % 8]
        number += s0 - s0 * s1 * s2
    return number


@compiled
def skeletonise(mask: Array, strength: Array) -> None:
    """Remove pixels, weak ones first, that are no ends and whose neighbours stay connected without them, in place."""
    ring = np.empty(8, np.int32)
    ys, xs = np.nonzero(mask)
    values = np.empty(len(ys), np.float32)
    for i in range(len(ys)):
        values[i] = strength[ys[i], xs[i]]
    for i in np.argsort(values):
        x, y = xs[i], ys[i]
        if _around(mask, x, y, ring) >= 2 and _pieces(ring) == 1:
            mask[y, x] = False


@compiled
def link(mask: Array) -> tuple[Array, Array]:
    """Return chains of neighbouring pixels between ends and branch points: points (N, 2) x, y and starts (M + 1,).

    Chain i is points[starts[i]:starts[i + 1]]. A closed chain without branches repeats its first point at its end.
    """
    height, width = mask.shape
    ring = np.empty(8, np.int32)
    degree = np.zeros((height, width), np.int8)
    total = 0
    ys, xs = np.nonzero(mask)
    for i in range(len(ys)):
        degree[ys[i], xs[i]] = _around(mask, xs[i], ys[i], ring)
        total += max(degree[ys[i], xs[i]], 1)
    points = np.empty((2 * total + 2 * len(ys) + 2, 2), np.int32)
    starts = np.zeros(total + len(ys) + 2, np.int64)
    used = np.zeros((height, width), np.bool_)
    count = chains = 0
    for closed in range(2):
        for i in range(len(ys)):
            x0, y0 = xs[i], ys[i]
            if closed == 0 and degree[y0, x0] == 2:
                continue
            if closed == 1 and used[y0, x0]:
                continue
            used[y0, x0] = True
            if degree[y0, x0] == 0:
                points[count, 0], points[count, 1] = x0, y0
                count += 1
                chains += 1
                starts[chains] = count
                continue
            for first in range(8 if closed == 0 else 1):
                start = count
                points[count, 0], points[count, 1] = x0, y0
                count += 1
                x, y, turn = x0, y0, first
                came_x, came_y = -1, -1
                while True:
                    found = False
                    # The first step takes the given direction only; later ones prefer neighbours that share a side.
                    for j in range(1 if count == start + 1 and closed == 0 else 8):
                        direction = turn if count == start + 1 and closed == 0 else (2 * j if j < 4 else 2 * j - 7)
                        xn, yn = x + _DX[direction], y + _DY[direction]
                        if not (0 <= xn < width and 0 <= yn < height and mask[yn, xn]) or (
                            xn == came_x and yn == came_y
                        ):
                            continue
                        node = degree[yn, xn] != 2
                        if used[yn, xn] and not node and not (xn == x0 and yn == y0 and count > start + 2):
                            continue
                        if node and count == start + 1 and (yn < y0 or (yn == y0 and xn < x0)):
                            continue  # two branch points side by side: linked from the other one
                        found = True
                        break
                    if not found:
                        break
                    points[count, 0], points[count, 1] = xn, yn
                    count += 1
                    if degree[yn, xn] != 2 or (xn == x0 and yn == y0):
                        break
                    used[yn, xn] = True
                    came_x, came_y, x, y = x, y, xn, yn
                if count == start + 1:
                    count = start
                else:
                    chains += 1
                    starts[chains] = count
    return points[:count], starts[: chains + 1]


@compiled
def remove_spurs(mask: Array, points: Array, starts: Array, longest: int) -> int:
    """Delete chains of up to ``longest`` px from a free end to a branch point; return how many were deleted."""
    ring = np.empty(8, np.int32)
    removed = 0
    for i in range(len(starts) - 1):
        first, last = points[starts[i]], points[starts[i + 1] - 1]
        length = starts[i + 1] - starts[i]
        if length < 2 or length - 1 > longest:
            continue
        free_first = _around(mask, first[0], first[1], ring) == 1
        free_last = _around(mask, last[0], last[1], ring) == 1
        branch_first = _around(mask, first[0], first[1], ring) >= 3
        branch_last = _around(mask, last[0], last[1], ring) >= 3
        if (free_first and branch_last) or (free_last and branch_first):
            for j in range(starts[i], starts[i + 1]):
                if (branch_last and j == starts[i + 1] - 1) or (branch_first and j == starts[i]):
                    continue
                mask[points[j, 1], points[j, 0]] = False
            removed += 1
    return removed


@compiled
def lead_to_corners(mask: Array, corners: Array, farthest: float) -> int:
    """Draw a line from each free end to the nearest corner (N, 2) px within reach; return how many were drawn.

    Edges round corners off on the outside, so what passes within three quarters of the reach is cut first.
    """
    height, width = mask.shape
    ring = np.empty(8, np.int32)
    at = np.full((height, width), -1, np.int32)
    for i in range(len(corners)):
        if 0 <= corners[i, 0] < width and 0 <= corners[i, 1] < height:
            at[corners[i, 1], corners[i, 0]] = i
    reach, cut = int(farthest), 0.75 * farthest
    for i in range(len(corners)):
        for y in range(max(corners[i, 1] - reach, 0), min(corners[i, 1] + reach + 1, height)):
            for x in range(max(corners[i, 0] - reach, 0), min(corners[i, 0] + reach + 1, width)):
                if (x - corners[i, 0]) ** 2 + (y - corners[i, 1]) ** 2 <= cut * cut:
                    mask[y, x] = False
    drawn = 0
    ys, xs = np.nonzero(mask)
    ends = np.zeros(len(ys), np.bool_)
    for i in range(len(ys)):
        ends[i] = _around(mask, xs[i], ys[i], ring) <= 1
    for i in range(len(ys)):
        if not ends[i]:
            continue
        x0, y0 = xs[i], ys[i]
        best, best_x, best_y = farthest * farthest, -1, -1
        for y in range(max(y0 - reach, 0), min(y0 + reach + 1, height)):
            for x in range(max(x0 - reach, 0), min(x0 + reach + 1, width)):
                distance = float((x - x0) ** 2 + (y - y0) ** 2)
                if at[y, x] >= 0 and distance <= best:
                    best, best_x, best_y = distance, x, y
        steps = max(abs(best_x - x0), abs(best_y - y0))
        if best_x < 0 or steps == 0:
            continue
        for j in range(1, steps + 1):
            x = x0 + int(np.rint((best_x - x0) * j / steps))
            y = y0 + int(np.rint((best_y - y0) * j / steps))
            mask[y, x] = True
        drawn += 1
    return drawn
