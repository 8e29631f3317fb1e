"""Loops of the detector over pixels and corners, compiled by numba; harris.py explains their use.

Optimisations of the fused pass (measured by bench_harris.py, each relative to the previous one): two rows
are processed together and share loads and half of the vertical sums. Strips of columns keep all rows in the first-level
cache. All float rows are in one array at constant distances, so that the compiler sees that they do not overlap, and
vectorises the loops without checks. The horizontal sums are computed directly from the 16-bit gradients. The peak test
returns eight pixels as the bits of a byte; only marked pixels, listed from bits, are processed singly, and
independently of each other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image import lanes
from harris_perception.core.image.bitmap import MARGIN, lowest, ones, pack
from harris_perception.core.image.compiled import called, compiled, inlined

Array = npt.NDArray[Any]

# Number of columns processed at once, and length of a scratch row, which holds them and their neighbours. It is no
# power of two: rows 4096 bytes apart would fall on the same cache sets.
_STRIP = 640
_ROW = 656

# Eight elements are compared at a time, so up to seven elements before the first row of scratch are read.
_BEFORE = 8

_ONE, _ALL = np.uint64(1), np.uint64(2**64 - 1)

# Below this fraction of the product of the two diagonal elements, a determinant is float32 rounding, no corner.
_RANK_ONE = np.float32(2.0**-21)

# Maximum hxy^2 / (hxx hyy) of a peak's quadratic; 1 is a ridge, more is a saddle.
_RIDGE = np.float32(0.5)


@inlined
def _smooth_and_difference(p0: Any, p1: Any, p2: Any, p3: Any, rows: Any, n: int, centre: Any) -> None:
    """Combine image rows vertically: smoothed and differentiated around p1 (rows 0, 1) and around p2 (rows 2, 3)."""
    s0, d0, s1, d1 = rows[:_ROW], rows[_ROW : 2 * _ROW], rows[2 * _ROW : 3 * _ROW], rows[3 * _ROW :]
    # Explicit casts: numba widens sums of small integers to 64 bits, and does not narrow all of them again.
    cast = rows.dtype.type
    for x in range(n):
        a, b, c, d = cast(p0[x]), cast(p1[x]), cast(p2[x]), cast(p3[x])
        s0[x] = cast(a + cast(centre * b)) + c
        d0[x] = c - a
        s1[x] = cast(b + cast(centre * c)) + d
        d1[x] = d - b


@inlined
def _gradient(smooth: Any, difference: Any, gx: Any, gy: Any, n: int, centre: Any) -> None:
    """Complete a row of the gradient horizontally; element x belongs to the image's column x + 1."""
    for x in range(n):
        gx[x] = smooth[x + 2] - smooth[x]
        gy[x] = difference[x] + centre * difference[x + 1] + difference[x + 2]


@inlined
def _response_rows(g: Any, rows: Any, old: int, new: int, result: int, n: int, k: Any) -> None:
    """Compute two rows of the response from two rows of gradients and the horizontal sums of the two rows above.

    ``g`` holds gx, gy of both rows. ``rows`` holds, from element ``old`` on, six rows: the sums gx^2, gy^2, gx gy of
    each of the two rows above. The new sums are written from ``new`` on in the same order, the response to the two rows
    at ``result``.
    """
    for x in range(n):
        u0, u1, u2 = np.float32(g[x]), np.float32(g[x + 1]), np.float32(g[x + 2])
        v0, v1, v2 = np.float32(g[_ROW + x]), np.float32(g[_ROW + x + 1]), np.float32(g[_ROW + x + 2])
        a0, b0, c0 = u0 * u0 + u1 * u1 + u2 * u2, v0 * v0 + v1 * v1 + v2 * v2, u0 * v0 + u1 * v1 + u2 * v2
        u0, u1, u2 = np.float32(g[2 * _ROW + x]), np.float32(g[2 * _ROW + x + 1]), np.float32(g[2 * _ROW + x + 2])
        v0, v1, v2 = np.float32(g[3 * _ROW + x]), np.float32(g[3 * _ROW + x + 1]), np.float32(g[3 * _ROW + x + 2])
        a1, b1, c1 = u0 * u0 + u1 * u1 + u2 * u2, v0 * v0 + v1 * v1 + v2 * v2, u0 * v0 + u1 * v1 + u2 * v2
        rows[new + x], rows[new + _ROW + x], rows[new + 2 * _ROW + x] = a0, b0, c0
        rows[new + 3 * _ROW + x], rows[new + 4 * _ROW + x], rows[new + 5 * _ROW + x] = a1, b1, c1
        am, bm, cm = rows[old + 3 * _ROW + x] + a0, rows[old + 4 * _ROW + x] + b0, rows[old + 5 * _ROW + x] + c0
        a, b, c = rows[old + x] + am, rows[old + _ROW + x] + bm, rows[old + 2 * _ROW + x] + cm
        trace = a + b
        rows[result + x] = a * b - c * c - k * trace * trace
        a, b, c = am + a1, bm + b1, cm + c1
        trace = a + b
        rows[result + _ROW + x] = a * b - c * c - k * trace * trace


@inlined
def _peaks_of_eight(above: Any, here: Any, below: Any, x: int, floor: Any) -> Any:
    """Return as bits which of eight columns from x on exceed ``floor`` and their four neighbours.

    Of equal ones the first counts.
    """
    least = lanes.above(here, x, floor) & lanes.exceed(here, x, here, x - 1) & lanes.exceed(here, x, above, x)
    return least & lanes.reach(here, x, here, x + 1) & lanes.reach(here, x, below, x)


@inlined
def _mark_peaks(above: Any, here: Any, below: Any, marks: Any, n: int, floor: Any) -> None:
    """Mark the peaks among the columns 1 to n - 2.

    Column 1 is the first bit. Up to seven bits after the last column are meaningless; for them, elements beyond a row
    are read, which must exist: here scratch, or the rows of the image border.
    """
    for i in range((n + 5) // 8):
        marks[i] = _peaks_of_eight(above, here, below, 8 * i + 1, floor)


@inlined
def _mark_all(
    above: Any,
    here: Any,
    below: Any,
    gx: Any,
    gy: Any,
    marks: Any,
    minima: Any,
    shift: int,
    n: int,
    floor: Any,
    low: Any,
    high: Any,
) -> None:
    """Mark peaks as ``_mark_peaks``, and in two ``minima`` those along the axis nearer to the gradient.

    The two are those below ``low`` and those below ``high``. ``shift`` bits precede that of column 1; for peaks they
    are meaningless. Element x of the responses belongs to element x + 1 of the gradient. This is the thinning of the
    paper of 1988.
    """
    eighths = (shift + n + 5) // 8
    weak, strong = minima
    kept = weak[0], strong[0]  # of the previous strip, which ends in the byte in which this one begins
    for i in range(eighths):
        x = 8 * i + 1 - shift
        marks[i] = _peaks_of_eight(above, here, below, x, floor)
        along_x = lanes.reach_in_magnitude(gx, x + 1, gy, x + 1)
        least = lanes.chosen_exceed(along_x, here, x - 1, above, x, here, x)
        least &= lanes.chosen_reach(along_x, here, x + 1, below, x, here, x)
        weak[i] = least & lanes.below(here, x, low)
        strong[i] = least & lanes.below(here, x, high)
    first, last = 255 << shift, 255 >> (8 * eighths - (shift + n - 2))
    weak[0], strong[0] = kept[0] | (weak[0] & first), kept[1] | (strong[0] & first)
    weak[eighths - 1] &= last
    strong[eighths - 1] &= last


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
def _collect(
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


@called
def _reading_order(peak: Any) -> float:
    """Return a number that increases with the row of a peak, and within a row with the column."""
    return float(np.floor(np.float64(peak[1]) + 0.5) * 2.0**20 + np.float64(peak[0]))


@compiled
def ranked(peaks: Array, floor: float, limit: int) -> tuple[Array, Array]:
    """Return xy (N, 2) and response (N,) of the ``limit`` strongest peaks (M, 3) above ``floor``, by falling response.

    This is a radix sort over the bits of the responses, which as positive floats sort like integers. Equal responses
    are sorted by row, then column, independently of strips and bands.
    """
    keys, moved = np.empty(len(peaks), np.uint64), np.empty(len(peaks), np.uint64)
    bits, half, last = peaks.view(np.uint32), np.uint64(32), np.uint64(2047)
    count = 0
    for i in range(len(peaks)):  # key: inverted response, then index
        keys[count] = (np.uint64(~bits[i, 2]) << half) | np.uint64(i)
        count += peaks[i, 2] > floor
    first, second, third = np.zeros(2048, np.int32), np.zeros(2048, np.int32), np.zeros(2048, np.int32)
    for i in range(count):
        key = keys[i] >> half
        first[key & last] += 1
        second[(key >> np.uint64(11)) & last] += 1
        third[key >> np.uint64(22)] += 1
    for digit, starts in enumerate((first, second, third)):
        total = 0
        for value in range(2048):
            here = starts[value]
            starts[value] = total
            total += here
        shift = half + np.uint64(11 * digit)
        for i in range(count):
            value = (keys[i] >> shift) & last
            moved[np.uint64(starts[value])] = keys[i]
            starts[value] += 1
        keys, moved = moved, keys
    places = keys[:count].astype(np.uint32)  # the lower half
    kept = min(limit, count)
    start = 0
    while start < kept:
        end, in_order = start + 1, True
        while end < count and keys[end] >> half == keys[start] >> half:
            in_order &= _reading_order(peaks[places[end - 1]]) < _reading_order(peaks[places[end]])
            end += 1
        if not in_order:
            equal = places[start:end].copy()
            order = np.empty(len(equal), np.float64)
            for i in range(len(equal)):
                order[i] = _reading_order(peaks[equal[i]])
            sorted_places = np.argsort(order)
            for i in range(len(equal)):  # setting a slice takes seconds to compile
                places[start + i] = equal[sorted_places[i]]
        start = end
    xy, response = np.empty((kept, 2), np.float32), np.empty(kept, np.float32)
    for i in range(kept):
        j = places[i]
        xy[i, 0], xy[i, 1], response[i] = peaks[j, 0], peaks[j, 1], peaks[j, 2]
    return xy, response


@compiled
def fused_peaks(
    gray: Array,
    weight: Array,
    border: int,
    first: int,
    last: int,
    k: float,
    absolute: float,
    relative: float,
    subpixel: bool,
    half: float,
    weak: float,
    strong: float,
    edges: Array,
) -> tuple[Array, Any]:
    """Return the peaks of the Harris response with a 3x3 gradient and a 3x3 box window in the rows first to last - 1.

    If ``edges`` has bitmaps, also sets the pixels of edges there: minima of the response across the edge.

    Parameters
    ----------
    gray
        (H, W) uint8 or float32.
    weight
        (1,) weight of the centre in the gradient's smoothing: 1 for Prewitt's kernels, 2 for Sobel's. Its dtype is that
        of the gradients: int16 for uint8 images (exact), float32 for float32.
    border
        Number of columns at the left and right border without peaks, at least 3.
    first, last
        Rows with peaks, 3 <= first, last <= H - 3.
    k
        Weight of trace^2.
    absolute, relative
        Thresholds; the second is a fraction of the strongest peak so far.
    subpixel
        Refine by the quadratic through 3x3 responses.
    half
        0.5 or less, float32 or float64: the unit and the precision of ``_quadratic_peak``.
    weak, strong
        Negative: the response at which an edge continues, and the one at which it starts.
    edges
        Two empty bitmaps of the image, for the pixels below ``weak`` and below ``strong``; (2, 0, 0) for no edges.

    Returns
    -------
    tuple
        (N, 3) float32 x, y, response, and the threshold reached, which the first peaks may not exceed.
    """
    width = gray.shape[1]
    centre = weight[0]
    vertical = np.empty(4 * _ROW, weight.dtype)
    # gx, gy of two rows, and of the previous two rows, which give the direction in which minima are tested.
    gradients = np.empty(_BEFORE + 8 * _ROW, weight.dtype)[_BEFORE:]
    g0, g1 = gradients[: 4 * _ROW], gradients[4 * _ROW :]
    rows = np.empty(16 * _ROW, np.float32)
    r0, r1 = rows[12 * _ROW : 13 * _ROW], rows[13 * _ROW : 14 * _ROW]
    r2, r3 = rows[14 * _ROW : 15 * _ROW], rows[15 * _ROW :]
    # Marks of edges start at a byte boundary of the bitmap, this number of columns before the strip.
    shift = border % 8 if edges.size > 0 else 0
    columns, bits = np.empty(_ROW + 8, np.int32), np.zeros(_ROW // 64 + 1, np.uint64)
    marks = bits.view(np.uint8)
    weight_k, fraction, floor = np.float32(k), np.float32(relative), np.float32(absolute)
    found = np.empty((2048 + (last - first) * width // 32, 3), np.float32)
    count = 0
    low, high = np.float32(weak), np.float32(strong)
    for start in range(border, width - border, _STRIP):
        x0 = start - 1  # column of the response's first element; its gradient starts one further left, the image two
        n = min(start + _STRIP, width - border) + 1 - x0
        byte = (MARGIN + start - shift) // 8
        for y in range(first - 2, last + 2, 2):  # y and y + 1 are gradient rows; responses are y - 1 and y
            p = x0 - 2
            # The last pair may lack its second row; results computed from the repeated row are not used.
            bottom = gray[min(y + 2, gray.shape[0] - 1), p:]
            _smooth_and_difference(gray[y - 1, p:], gray[y, p:], gray[y + 1, p:], bottom, vertical, n + 4, centre)
            even = ((y - first) // 2) % 2 == 0
            g, before = (g0, g1) if even else (g1, g0)
            _gradient(vertical[:_ROW], vertical[_ROW : 2 * _ROW], g[:_ROW], g[_ROW : 2 * _ROW], n + 2, centre)
            _gradient(
                vertical[2 * _ROW : 3 * _ROW],
                vertical[3 * _ROW :],
                g[2 * _ROW : 3 * _ROW],
                g[3 * _ROW :],
                n + 2,
                centre,
            )
            if even:
                _response_rows(g0, rows, 0, 6 * _ROW, 12 * _ROW, n, weight_k)
                above, here, below, beyond = r2, r3, r0, r1
            else:
                _response_rows(g1, rows, 6 * _ROW, 0, 14 * _ROW, n, weight_k)
                above, here, below, beyond = r0, r1, r2, r3
            for i in range(2):  # rows y - 2 and y - 1
                row = y - 2 + i
                if not first <= row < last:
                    continue
                one, middle, other = (above, here, below) if i == 0 else (here, below, beyond)
                if edges.size > 0:
                    gx, gy = before[2 * i * _ROW :], before[(2 * i + 1) * _ROW :]
                    minima = edges[0, row + 1, byte:], edges[1, row + 1, byte:]
                    _mark_all(one, middle, other, gx, gy, marks, minima, shift, n, floor, low, high)
                else:
                    _mark_peaks(one, middle, other, marks, n, floor)
                found, count, floor = _collect(
                    one, middle, other, bits, shift, columns, n, x0, row, floor, fraction, subpixel, half, found, count
                )
    return found[:count], floor


@compiled
def peaks_of(
    response: Array, border: int, first: int, last: int, absolute: float, relative: float, subpixel: bool
) -> tuple[Array, Any]:
    """Return the peaks of a response (H, W) float32, in row-major order; otherwise like ``fused_peaks``.

    ``last`` is at most H - ``border``, with ``border`` at least 2: as many rows follow the last row used.
    """
    width = response.shape[1]
    columns, bits = np.empty(_ROW + 8, np.int32), np.zeros(_ROW // 64 + 1, np.uint64)
    marks = bits.view(np.uint8)
    fraction, floor = np.float32(relative), np.float32(absolute)
    found = np.empty((2048 + (last - first) * width // 32, 3), np.float32)
    count = 0
    for start in range(border, width - border, _STRIP):
        x0 = start - 1
        n = min(start + _STRIP, width - border) + 1 - x0
        for y in range(first, last):
            above, here, below = response[y - 1, x0:], response[y, x0:], response[y + 1, x0:]
            _mark_peaks(above, here, below, marks, n, floor)
            found, count, floor = _collect(
                above, here, below, bits, 0, columns, n, x0, y, floor, fraction, subpixel, 0.5, found, count
            )
    return found[:count], floor


@compiled
def minima_of(response: Array, a: Array, b: Array, border: int, weak: float, strong: float, edges: Array) -> None:
    """Set the pixels of edges, like ``fused_peaks``, of a response (H, W) float32.

    ``a`` and ``b`` are the sums of gx^2 and gy^2 of all but the outermost ``border - 1`` pixels. There are no edges
    nearer than ``border`` to the image border.
    """
    height, width = response.shape
    eighths = (width + 7) // 8
    words = np.zeros((2, eighths), np.uint64)
    marks = words.view(np.uint8)
    low, high = np.float32(weak), np.float32(strong)
    for y in range(border, height - border):
        above, here, below = response[y - 1], response[y], response[y + 1]
        ra, rb = a[y - border + 1], b[y - border + 1]
        for x in range(border, width - border):
            along_x = ra[x - border + 1] >= rb[x - border + 1]
            before, after = (here[x - 1], here[x + 1]) if along_x else (above[x], below[x])
            least = (here[x] < before) & (here[x] <= after)
            marks[0, x] = least & (here[x] < low)
            marks[1, x] = least & (here[x] < high)
        for i in range(2):
            pack(words[i], eighths, edges[i, y + 1, MARGIN // 8 :])


@compiled
def response_of(a: Array, b: Array, c: Array, kind: int, k: float, result: Array) -> None:
    """Fill ``result`` with the response of the sums a = gx^2, b = gy^2, c = gx gy, all (H, W) float32.

    ``kind`` 0: det - k trace^2; 1: the smaller eigenvalue; 2: det / trace; 3: sqrt(det) det / (det + k trace^2).
    """
    weight = np.float32(k)
    zero, half = np.float32(0.0), np.float32(0.5)
    for y in range(a.shape[0]):
        ra, rb, rc, out = a[y], b[y], c[y], result[y]
        if kind == 0:
            for x in range(a.shape[1]):
                trace = ra[x] + rb[x]
                out[x] = ra[x] * rb[x] - rc[x] * rc[x] - weight * trace * trace
            continue
        for x in range(a.shape[1]):
            product = ra[x] * rb[x]
            det = product - rc[x] * rc[x]
            trace = ra[x] + rb[x]
            divisor = trace
            if kind == 1:  # det / larger eigenvalue: the difference of two large numbers would be rounding
                divisor = half * trace + np.sqrt((half * (ra[x] - rb[x])) ** 2 + rc[x] * rc[x])
            elif kind == 3 and det > zero:
                divisor = (det + weight * trace * trace) / np.sqrt(det)
            out[x] = zero if det <= _RANK_ONE * product else det / divisor


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
