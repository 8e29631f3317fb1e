"""Loops that find the peaks of a response, to a fraction of a pixel, compiled by numba.

The peak test returns eight pixels as the bits of a byte; only marked pixels, listed from bits, are processed singly,
and independently of each other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image import lanes
from harris_perception.core.image.bitmap import lowest, ones
from harris_perception.core.image.compiled import called, compiled, inlined

Array = npt.NDArray[Any]

# Number of columns processed at once, and length of a scratch row, which holds them and their neighbours. It is no
# power of two: rows 4096 bytes apart would fall on the same cache sets.
STRIP = 640
ROW = 656

_ONE, _ALL = np.uint64(1), np.uint64(2**64 - 1)

# Maximum hxy^2 / (hxx hyy) of a peak's quadratic; 1 is a ridge, more is a saddle.
_RIDGE = np.float32(0.5)


@inlined
def peaks_of_eight(above: Any, here: Any, below: Any, x: int, floor: Any) -> Any:
    """Return as bits which of eight columns from x on exceed ``floor`` and their four neighbours.

    Of equal ones the first counts.
    """
    least = lanes.above(here, x, floor) & lanes.exceed(here, x, here, x - 1) & lanes.exceed(here, x, above, x)
    return least & lanes.reach(here, x, here, x + 1) & lanes.reach(here, x, below, x)


@inlined
def mark_peaks(above: Any, here: Any, below: Any, marks: Any, n: int, floor: Any) -> None:
    """Mark the peaks among the columns 1 to n - 2.

    Column 1 is the first bit. Up to seven bits after the last column are meaningless; for them, elements beyond a row
    are read, which must exist: here scratch, or the rows of the image border.
    """
    for i in range((n + 5) // 8):
        marks[i] = peaks_of_eight(above, here, below, 8 * i + 1, floor)


@called
def _gain(gx: Any, gy: Any, hxx: Any, hyy: Any, hxy: Any, dx: Any, dy: Any) -> Any:
    """Return twice the increase of a quadratic with these derivatives from its centre to (dx, dy)."""
    return dx * (gx + gx + hxx * dx + hxy * dy) + dy * (gy + gy + hxy * dx + hyy * dy)


@inlined
def _quadratic_peak(above: Any, here: Any, below: Any, x: np.uint64, half: Any) -> tuple[Any, Any]:
    """Return the maximum of the quadratic through a 3x3 neighbourhood within half a pixel of its centre (dx, dy).

    At a corner that is nearly an edge the quadratic is a ridge or a saddle, and noise determines the position of the
    maximum along it. The ridge is therefore limited by ``_RIDGE``, so that the position does not jump with the
    responses.

    Only ratios of derivatives matter, so all are scaled by ``half`` and have its precision: float32 cannot hold
    products of the responses to images of any unit.
    """
    limit, zero = np.float32(0.5), half - half
    quarter = limit * half
    left, right = x - _ONE, x + _ONE
    gx = quarter * (here[right] - here[left])
    gy = quarter * (below[x] - above[x])
    hxx = half * ((here[right] - here[x]) + (here[left] - here[x]))
    hyy = half * ((below[x] - here[x]) + (above[x] - here[x]))
    hxy = limit * quarter * ((below[right] - below[left]) - (above[right] - above[left]))
    if not (hxx < 0 and hyy < 0):  # a plateau, or as small as rounding
        dx = min(max(-gx / hxx, -limit), limit) if hxx < 0 else zero
        dy = min(max(-gy / hyy, -limit), limit) if hyy < 0 else zero
        return dx, dy
    product = hxx * hyy
    if hxy * hxy > _RIDGE * product:
        steepest = np.sqrt(_RIDGE * product)
        hxy = steepest if hxy > zero else -steepest
    det = product - hxy * hxy
    dx = (hxy * gy - hyy * gx) / det
    dy = (hxy * gx - hxx * gy) / det
    beyond_x, beyond_y = abs(dx) > limit, abs(dy) > limit
    if not (beyond_x or beyond_y):
        return dx, dy
    # The best point on the two sides of the square that face the maximum.
    side_x, side_y = limit if dx > zero else -limit, limit if dy > zero else -limit
    on_x = min(max(-(gy + hxy * side_x) / hyy, -limit), limit)
    on_y = min(max(-(gx + hxy * side_y) / hxx, -limit), limit)
    if beyond_x and beyond_y:
        beyond_x = _gain(gx, gy, hxx, hyy, hxy, side_x, on_x) >= _gain(gx, gy, hxx, hyy, hxy, on_y, side_y)
    return (side_x, on_x) if beyond_x else (on_y, side_y)


@inlined
def _columns_of(bits: Any, shift: int, columns: Any, n: int) -> int:
    """List the marked columns of 1 to n - 2, and return their number; ``shift`` bits precede column 1's."""
    marked, first, end = 0, 1 - shift, shift + n - 2
    for i in range((end + 63) // 64):
        word = bits[i]
        if i == 0:
            word &= _ALL << np.uint64(shift)
        if 64 * i + 64 > end:
            word &= ~(_ALL << np.uint64(end & 63))
        following = marked + ones(word)
        for j in range(marked, marked + 4):  # most have fewer; writing always avoids a mispredicted branch
            columns[np.uint64(j)] = 64 * i + lowest(word) + first
            word &= word - _ONE
        for j in range(marked + 4, following):
            columns[np.uint64(j)] = 64 * i + lowest(word) + first
            word &= word - _ONE
        marked = following
    return marked


@inlined
def collect(
    above: Any,
    here: Any,
    below: Any,
    bits: Any,
    shift: int,
    columns: Any,
    n: int,
    x0: int,
    y: int,
    floor: Any,
    relative: Any,
    subpixel: bool,
    half: Any,
    found: Any,
    count: int,
) -> tuple[Any, int, Any]:
    """Append the marked pixels that also exceed their diagonal neighbours to ``found`` (x, y, response).

    ``bits`` are the marks, after ``shift`` others, and ``columns`` is scratch for a row. The floor rises with the
    strongest peak of the row. Returns ``found`` (a larger array if it was full), the count and the floor.
    """
    marked = _columns_of(bits, shift, columns, n)
    if count + marked > found.shape[0]:
        found = np.concatenate((found, np.empty_like(found)))
    start, row, strongest = count, np.float32(y), np.float32(0.0)
    for i in range(marked):  # not compared with the floor here, or each would wait for the previous one
        x = np.uint64(columns[i])
        left, right = x - _ONE, x + _ONE
        r = here[x]
        peak = (r > above[left]) & (r > above[right]) & (r >= below[left]) & (r >= below[right])
        at = np.uint64(count)
        found[at, 0], found[at, 1], found[at, 2] = np.float32(x0 + columns[i]), row, r
        columns[np.uint64(count - start)] = columns[i]
        count += peak
        strongest = r if peak & (r > strongest) else strongest
    if subpixel:
        for i in range(start, count):
            at = np.uint64(i)
            dx, dy = _quadratic_peak(above, here, below, np.uint64(columns[i - start]), half)
            found[at, 0] += dx
            found[at, 1] += dy
    return found, count, max(floor, relative * strongest)


@compiled
def peaks_of(
    response: Array, border: int, first: int, last: int, absolute: float, relative: float, subpixel: bool
) -> tuple[Array, Any]:
    """Return the peaks of a response (H, W) float32, in row-major order; otherwise like ``fused_peaks``.

    ``last`` is at most H - ``border``, with ``border`` at least 2: as many rows follow the last row used.
    """
    width = response.shape[1]
    columns, bits = np.empty(ROW + 8, np.int32), np.zeros(ROW // 64 + 1, np.uint64)
    marks = bits.view(np.uint8)
    fraction, floor = np.float32(relative), np.float32(absolute)
    found = np.empty((2048 + (last - first) * width // 32, 3), np.float32)
    count = 0
    for start in range(border, width - border, STRIP):
        x0 = start - 1
        n = min(start + STRIP, width - border) + 1 - x0
        for y in range(first, last):
            above, here, below = response[y - 1, x0:], response[y, x0:], response[y + 1, x0:]
            mark_peaks(above, here, below, marks, n, floor)
            found, count, floor = collect(
                above, here, below, bits, 0, columns, n, x0, y, floor, fraction, subpixel, 0.5, found, count
            )
    return found[:count], floor
