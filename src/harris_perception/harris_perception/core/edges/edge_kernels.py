"""Loops of the edge detector over pixels, compiled by numba; edges.py explains their use.

Optimisations: every loop over all pixels is a loop over rows without branches, which the compiler vectorises; the mean
along an edge is computed only at maxima.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import compiled, inlined

Array = npt.NDArray[Any]


@inlined
def _smooth_row(source: Any, result: Any, taps: Any, n: int) -> None:
    """Smooth a row by symmetric taps, centre first; ``source`` is longer than n by the radius at both ends."""
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
    """Fill three rows with the gradient's products, smoothed along the row by 1 2 1; the input has n + 4 columns."""
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

    The image (H, W) is smoothed by ``taps`` (centre and one side of a symmetric filter, sum one) and differentiated by
    central differences. The products are summed with the weights 1 2 1 over 4 in both directions. Border pixels are
    replicated beyond the image.
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
def bends(framed: Array, reach: int, dx: int, dy: int, most: int) -> Array:
    """Return the absolute difference of twice a pixel and the sum of the two at (dx, dy) px and opposite, (H, W) uint8.

    Parameters
    ----------
    framed
        (H + 2 reach, W + 2 reach) uint8.
    reach
        Upper limit of |dx| and |dy|.
    dx, dy
        Offset to the other two, px.
    most
        Grey levels, 1 to 255; larger differences are clipped to it, and all are scaled so that it becomes at most 255.
    """
    height, width = framed.shape[0] - 2 * reach, framed.shape[1] - 2 * reach
    limit, scale = np.int16(most), np.int16(255 // most)
    result = np.empty((height, width), np.uint8)
    for y in range(height):
        here, out = framed[y + reach, reach:], result[y]
        before, after = framed[y + reach - dy, reach - dx :], framed[y + reach + dy, reach + dx :]
        for x in range(width):  # casts: numba widens sums of small integers to 64 bits
            both = np.int16(np.int16(before[x]) + np.int16(after[x]))
            bend = np.int16(both - np.int16(np.int16(2) * np.int16(here[x])))
            out[x] = np.uint8(np.int16(min(np.int16(abs(bend)), limit)) * scale)
    return result


@compiled
def weigh(strength: Array, difference: Array) -> None:
    """Multiply ``strength`` (H, W) by the square root of ``difference`` (H, W), in place."""
    for y in range(strength.shape[0]):
        one, other = strength[y], difference[y]
        for x in range(strength.shape[1]):
            one[x] *= np.sqrt(other[x])


@inlined
def _directions(ra: Any, rb: Any, rc: Any, shares: Any, flats: Any, n: int) -> None:
    """Fill ``shares`` with the tangent of the main direction to the nearer axis, ``flats`` with 1 if that is x."""
    zero, one, two, tiny = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(1e-30)
    for x in range(n):
        difference, twice = ra[x] - rb[x], two * rc[x]  # the direction is half the angle atan2(twice, difference)
        shares[x] = twice / (abs(difference) + np.sqrt(difference * difference + twice * twice) + tiny)
        flats[x] = one if difference >= zero else zero


@inlined
def _maxima(above: Any, here: Any, below: Any, shares: Any, flats: Any, out: Any, n: int) -> None:
    """Keep values that exceed the two next to them; all neighbours are loaded, then selected without branches."""
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

    The two values next to a pixel are interpolated between its neighbours, as in Canny's suppression. ``framed``
    (H + 2, W + 2) is the strength extended by one pixel, so that no edge is lost along the border.
    """
    height, width = a.shape
    result = np.empty((height, width), np.float32)
    shares, flats = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(height):
        _directions(a[y], b[y], c[y], shares, flats, width)
        _maxima(framed[y], framed[y + 1], framed[y + 2], shares, flats, result[y], width)
    return result


@compiled
def mean_along(thinned: Array, strength: Array, a: Array, b: Array, c: Array, reach: int) -> None:
    """Replace each maximum in ``thinned`` by the mean of ``strength`` along the edge, in place; means below 0 become 0.

    Parameters
    ----------
    thinned, strength
        (H, W) float32.
    a, b, c
        gx^2, gy^2, gx gy, (H, W) float32: edges run perpendicular to their main direction.
    reach
        Distance in both directions, px; every second pixel is used.
    """
    height, width = thinned.shape
    zero, one, two, half = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)
    for y in range(height):
        row = thinned[y]
        for x in range(width):
            if not row[x] > zero:
                continue
            difference, twice = a[y, x] - b[y, x], two * c[y, x]
            length = np.sqrt(difference * difference + twice * twice) + np.float32(1e-30)
            cosine = max(min(difference / length, one), -one)  # of twice the angle of the gradient
            dx = -np.sqrt(half * (one - cosine)) * (one if twice >= zero else -one)
            dy = np.sqrt(half * (one + cosine))
            total, count = strength[y, x], 1
            for i in range(-reach, reach + 1, 2):
                at_x, at_y = np.float32(x) + i * dx, np.float32(y) + i * dy
                x0, y0 = int(at_x), int(at_y)
                if i == 0 or not (at_x >= zero and at_y >= zero and x0 < width - 1 and y0 < height - 1):
                    continue
                fx, fy = np.float32(at_x - x0), np.float32(at_y - y0)
                above = strength[y0, x0] + fx * (strength[y0, x0 + 1] - strength[y0, x0])
                below = strength[y0 + 1, x0] + fx * (strength[y0 + 1, x0 + 1] - strength[y0 + 1, x0])
                total += above + fy * (below - above)
                count += 1
            row[x] = max(total / np.float32(count), zero)


@inlined
def _walk_a_line(cells: Any, flow: Any, first: int, step: int, count: int, ahead: Any) -> None:
    """Do an implicit step along every ``step``-th cell (N, K) from ``first`` on, by the algorithm of Thomas.

    ``flow`` (N,) is the flow from each cell to the next one of the line, 0 from the last; ``ahead`` is overwritten.
    """
    one, before = np.float32(1.0), np.float32(0.0)
    for i in range(count):
        here = first + i * step
        pivot = one / (one + before + flow[here] - (before * ahead[i - 1] if i > 0 else before))
        ahead[i] = flow[here] * pivot
        share = before * pivot
        cell, last = cells[here], cells[here - step if i > 0 else here]
        for k in range(len(cell)):
            cell[k] = cell[k] * pivot + share * last[k]
        before = flow[here]
    for i in range(count - 2, -1, -1):
        here = first + i * step
        cell, following, share = cells[here], cells[here + step], ahead[i]
        for k in range(len(cell)):
            cell[k] += share * following[k]


@compiled
def walk(cells: Array, right: Array, down: Array, steps: int) -> None:
    """Diffuse values along rows and columns alternately, in place, in implicit steps, which are stable at any length.

    Parameters
    ----------
    cells
        (H, W, K) float32, K values per cell.
    right, down
        (H, W) float32, conductivity to the next cell of the row, and of the column, times the time of a step. It is
        zero in the last column, and in the last row.
    steps
        Number of steps.
    """
    height, width, depth = cells.shape
    flat = cells.reshape(height * width, depth)
    along, across = right.reshape(right.size), down.reshape(down.size)
    ahead = np.empty(max(height, width), np.float32)
    for _ in range(steps):
        for y in range(height):
            _walk_a_line(flat, along, y * width, 1, width, ahead)
        for x in range(width):
            _walk_a_line(flat, across, x, width, height, ahead)
