"""The loops of the edge detector over pixels, compiled by numba; see edges.py for what they are used for.

How the passes got fast: everything that touches all pixels is a loop over rows without branches, which the compiler
vectorises; everything after the thinning touches edge pixels only, on pictures framed by one empty pixel, where
neighbours are constant distances and need no test for the border.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.compiled import called, compiled, inlined

Array = npt.NDArray[Any]

# Neighbours in circular order; even ones share a side.
_DX = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int32)
_DY = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int32)


def _needless() -> npt.NDArray[np.bool_]:
    """Tell for each pattern of eight neighbours whether a pixel can go without an end or a connection being lost.

    It can when at least two neighbours are set and they stay in one piece (Yokoi's number, 8-connected).
    """
    empty = 1 - np.array([[pattern >> i & 1 for i in range(8)] for pattern in range(256)])
    sides, after, beyond = empty[:, 0::2], empty[:, 1::2], np.roll(empty, -2, axis=1)[:, 0::2]
    pieces = (sides - sides * after * beyond).sum(axis=1)
    return np.asarray((8 - empty.sum(axis=1) >= 2) & (pieces == 1))


_NEEDLESS = _needless()


@inlined
def _smooth_row(source: Any, result: Any, taps: Any, n: int) -> None:
    """Smooth a row by symmetric taps, centre first; ``source`` is longer than n by the radius at either end."""
    radius = len(taps) - 1
    for x in range(n):
        result[x] = taps[0] * source[x + radius]
    for i in range(1, len(taps)):
        weight = taps[i]
        before, behind = source[radius - i :], source[radius + i :]
        for x in range(n):
            result[x] += weight * (before[x] + behind[x])


@inlined
def _products(above: Any, here: Any, below: Any, a: Any, b: Any, c: Any, n: int) -> None:
    """Fill three rows with the products of the gradient, smoothed along the row by 1 2 1; n + 4 columns go in."""
    half, two, quarter = np.float32(0.5), np.float32(2.0), np.float32(0.25)
    for x in range(n):
        u0, v0 = half * (here[x + 2] - here[x]), half * (below[x + 1] - above[x + 1])
        u1, v1 = half * (here[x + 3] - here[x + 1]), half * (below[x + 2] - above[x + 2])
        u2, v2 = half * (here[x + 4] - here[x + 2]), half * (below[x + 3] - above[x + 3])
        a[x] = quarter * (u0 * u0 + two * u1 * u1 + u2 * u2)
        b[x] = quarter * (v0 * v0 + two * v1 * v1 + v2 * v2)
        c[x] = quarter * (u0 * v0 + two * u1 * v1 + u2 * v2)


@inlined
def _add_rows(r0: Any, r1: Any, r2: Any, result: Any, n: int, weight: Any) -> None:
    two = np.float32(2.0)
    for x in range(n):
        result[x] += weight * (r0[x] + two * r1[x] + r2[x])


@compiled
def add_structure(gray: Array, taps: Array, weight: float, a: Array, b: Array, c: Array) -> None:
    """Add the structure tensor of a channel, times ``weight``, to a, b, c (gx^2, gy^2, gx gy; (H, W) float32).

    Smoothed by ``taps`` (centre and one side of a symmetric filter, sum one), central differences, products summed with
    the weights 1 2 1 over 4 both ways. The picture (H, W) is continued by its border pixels.
    """
    height, width = gray.shape
    radius = len(taps) - 1
    n = width + 4  # smoothed columns -2 to width + 1
    column = np.empty(n + 2 * radius, np.float32)
    smooth = np.empty((3, n), np.float32)
    products = np.empty((9, width), np.float32)
    quarter = np.float32(0.25 * weight)
    margin = radius + 2
    for y in range(-2, height + 2):
        inner = column[margin : margin + width]
        first = gray[min(max(y, 0), height - 1)]
        for x in range(width):
            inner[x] = taps[0] * np.float32(first[x])
        for i in range(1, radius + 1):
            one, other = gray[min(max(y - i, 0), height - 1)], gray[min(max(y + i, 0), height - 1)]
            share = taps[i]
            for x in range(width):
                inner[x] += share * (np.float32(one[x]) + np.float32(other[x]))
        column[:margin] = inner[0]
        column[margin + width :] = inner[width - 1]
        newest = (y + 2) % 3
        _smooth_row(column, smooth[newest], taps, n)
        if y < 0:
            continue
        p = y % 3  # products of row y - 1 go here
        _products(
            smooth[y % 3],
            smooth[(y + 1) % 3],
            smooth[newest],
            products[p],
            products[3 + p],
            products[6 + p],
            width,
        )
        if y < 2:
            continue
        row = y - 2
        for which in range(3):
            result = a[row] if which == 0 else (b[row] if which == 1 else c[row])
            _add_rows(
                products[3 * which + (p + 1) % 3],
                products[3 * which + (p + 2) % 3],
                products[3 * which + p],
                result,
                width,
                quarter,
            )


@compiled
def strength_of(a: Array, b: Array, c: Array, k: float) -> Array:
    """Return (-R / k)^(1/4) where R < 0, else 0, (H, W) float32."""
    weight, zero = np.float32(k), np.float32(0.0)
    scale = np.float32(1.0 / k)
    result = np.empty(a.shape, np.float32)
    for y in range(a.shape[0]):
        ra, rb, rc, out = a[y], b[y], c[y], result[y]
        for x in range(a.shape[1]):
            trace = ra[x] + rb[x]
            r = rc[x] * rc[x] + weight * trace * trace - ra[x] * rb[x]
            out[x] = np.sqrt(np.sqrt(r * scale if r > zero else zero))
    return result


@compiled
def combine(fine: Array, coarse: Array) -> None:
    """Replace ``fine`` (H, W) by the geometric mean of the strengths at two scales; the coarse one is of half size."""
    half = np.float32(0.5)  # a gradient per pixel of half the size is twice as large
    for y in range(fine.shape[0]):
        one, other = fine[y], coarse[y]
        for x in range(fine.shape[1]):
            one[x] = np.sqrt(half * one[x] * other[x])


@inlined
def _directions(ra: Any, rb: Any, rc: Any, shares: Any, flats: Any, n: int) -> None:
    """Fill ``shares`` with the tangent of the main direction from the nearer axis, ``flats`` with 1 where that is x."""
    zero, one, two, tiny = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(1e-30)
    for x in range(n):
        difference, twice = ra[x] - rb[x], two * rc[x]  # the direction is half the angle atan2(twice, difference)
        shares[x] = twice / (abs(difference) + np.sqrt(difference * difference + twice * twice) + tiny)
        flats[x] = one if difference >= zero else zero


@inlined
def _maxima(above: Any, here: Any, below: Any, shares: Any, flats: Any, out: Any, n: int) -> None:
    """Keep what exceeds the two values beside it; all neighbours are loaded, then chosen from, so without branches."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for x in range(n):
        nw, north, ne = above[x], above[x + 1], above[x + 2]
        west, s, east = here[x], here[x + 1], here[x + 2]
        sw, south, se = below[x], below[x + 1], below[x + 2]
        share, flat = shares[x], flats[x] > zero
        part = abs(share)
        falling = share >= zero
        side_ahead, side_behind = east if flat else south, west if flat else north
        rising_ahead, rising_behind = ne if flat else sw, sw if flat else ne
        step_ahead, step_behind = se if falling else rising_ahead, nw if falling else rising_behind
        ahead = (one - part) * side_ahead + part * step_ahead
        behind = (one - part) * side_behind + part * step_behind
        out[x] = s if (s > zero) & (s > behind) & (s >= ahead) else zero


@compiled
def thin(framed: Array, a: Array, b: Array, c: Array) -> Array:
    """Return the strength where it is a maximum along the structure tensor's main direction, else 0, (H, W) float32.

    The two values beside a pixel are interpolated between its neighbours, as Canny's suppression does. ``framed``
    (H + 2, W + 2) is the strength continued by a pixel, so that no edge is lost along the frame.
    """
    height, width = a.shape
    result = np.empty((height, width), np.float32)
    shares, flats = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(height):
        _directions(a[y], b[y], c[y], shares, flats, width)
        _maxima(framed[y], framed[y + 1], framed[y + 2], shares, flats, result[y], width)
    return result


@compiled
def hysteresis(thinned: Array, high: float, low: float, least: int, weight: float) -> Array:
    """Return the mask of connected pixels above ``low`` with one above ``high``.

    Pieces of fewer than ``least`` pixels, or whose strengths sum up to less than ``weight`` times ``high``, are left
    out.
    """
    height, width = thinned.shape
    stride = (width + 2 + 7) // 8 * 8
    state = np.zeros((height + 2, stride), np.uint8)  # 1 above low, 2 above high as well; 0 when seen
    upper, lower, zero = np.float32(high), np.float32(low), np.float32(0.0)
    for y in range(height):
        row, out = thinned[y], state[y + 1, 1:]
        for x in range(width):
            s = row[x]
            out[x] = np.uint8((s > zero) & (s >= lower)) + np.uint8((s > zero) & (s >= lower) & (s >= upper))
    mask = np.zeros((height, width), np.bool_)
    flat = state.reshape(-1)
    words = flat.view(np.uint64)
    steps = _DY * stride + _DX
    queue = np.empty(height * width, np.int32)
    for word in range(len(words)):
        if words[word] & np.uint64(0x0202020202020202) == 0:
            continue
        for seed in range(8 * word, 8 * word + 8):
            if flat[seed] != 2:
                continue
            queue[0] = seed
            flat[seed] = 0
            count, done = 1, 0
            while done < count:
                here = queue[done]
                done += 1
                for i in range(8):
                    beside = here + steps[i]
                    if flat[beside] != 0:
                        flat[beside] = 0
                        queue[count] = beside
                        count += 1
            if count < least:
                continue
            total = 0.0
            for i in range(count):
                y = queue[i] // stride
                total += thinned[y - 1, queue[i] - y * stride - 1]
            if total >= weight * high:
                for i in range(count):
                    y = queue[i] // stride
                    mask[y - 1, queue[i] - y * stride - 1] = True
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
def _pattern(flat: Array, here: int, steps: Array) -> int:
    """Return the eight neighbours of a pixel of a framed picture as bits."""
    pattern = 0
    for i in range(8):
        pattern |= int(flat[here + steps[i]]) << i
    return pattern


@called
def _set_pixels(mask: Array) -> tuple[Array, Array]:
    """Return rows and columns of the pixels that are set, as ``np.nonzero``; eight empty ones are passed at once."""
    width = mask.shape[1]
    flat = mask.reshape(-1).view(np.uint8)
    whole = len(flat) // 8 * 8
    words = flat[:whole].view(np.uint64)
    places = np.empty(len(flat) + 1, np.int32)
    count = 0
    for word in range(len(words)):
        if words[word] != 0:
            for place in range(8 * word, 8 * word + 8):
                places[count] = place
                count += flat[place]
    for place in range(whole, len(flat)):
        places[count] = place
        count += flat[place]
    ys, xs = np.empty(count, np.int32), np.empty(count, np.int32)
    for i in range(count):
        ys[i] = places[i] // width
        xs[i] = places[i] - ys[i] * width
    return ys, xs


@compiled
def skeletonise(mask: Array, strength: Array) -> None:
    """Remove pixels, weak ones first, that are no ends and whose neighbours stay connected without them, in place."""
    height, width = mask.shape
    stride = width + 2
    flat = np.zeros((height + 2) * stride, np.uint8)
    steps = _DY * stride + _DX
    ys, xs = _set_pixels(mask)
    for i in range(len(ys)):
        flat[(ys[i] + 1) * stride + xs[i] + 1] = 1
    places = np.empty(len(ys) + 1, np.int32)
    values = np.empty(len(ys) + 1, np.float32)
    while True:
        # Of a thinned picture few pixels are needless, so that sorting them costs little.
        count = 0
        for i in range(len(ys)):
            here = (ys[i] + 1) * stride + xs[i] + 1
            places[count], values[count] = i, strength[ys[i], xs[i]]
            count += flat[here] != 0 and _NEEDLESS[_pattern(flat, here, steps)]
        removed = 0
        for j in np.argsort(values[:count]):
            i = places[j]
            here = (ys[i] + 1) * stride + xs[i] + 1
            if _NEEDLESS[_pattern(flat, here, steps)]:
                flat[here] = 0
                mask[ys[i], xs[i]] = False
                removed += 1
        if removed == 0:
            break


@compiled
def link(mask: Array) -> tuple[Array, Array]:
    """Return chains of neighbouring pixels between ends and branch points: points (N, 2) x, y and starts (M + 1,).

    Chain i is points[starts[i]:starts[i + 1]]. A closed chain without branches repeats its first point at its end.
    """
    height, width = mask.shape
    ring = np.empty(8, np.int32)
    degree = np.zeros((height, width), np.int8)
    total = 0
    ys, xs = _set_pixels(mask)
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
    at = np.zeros((height, width), np.bool_)
    for i in range(len(corners)):
        if 0 <= corners[i, 0] < width and 0 <= corners[i, 1] < height:
            at[corners[i, 1], corners[i, 0]] = True
    reach, cut = int(farthest), 0.75 * farthest
    for i in range(len(corners)):
        for y in range(max(corners[i, 1] - reach, 0), min(corners[i, 1] + reach + 1, height)):
            for x in range(max(corners[i, 0] - reach, 0), min(corners[i, 0] + reach + 1, width)):
                if (x - corners[i, 0]) ** 2 + (y - corners[i, 1]) ** 2 <= cut * cut:
                    mask[y, x] = False
    drawn = 0
    ys, xs = _set_pixels(mask)
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
                if at[y, x] and distance <= best:
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
