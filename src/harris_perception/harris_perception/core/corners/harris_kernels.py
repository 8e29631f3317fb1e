"""The fused pass of the detector from image rows to peaks and edges, compiled by numba; harris.py explains its use.

Optimisations of the fused pass (measured by bench_harris.py, each relative to the previous one): two rows
are processed together and share loads and half of the vertical sums. Strips of columns keep all rows in the first-level
cache. All float rows are in one array at constant distances, so that the compiler sees that they do not overlap, and
vectorises the loops without checks. The horizontal sums are computed directly from the 16-bit gradients. Peaks are
found in eight pixels at a time (``peak_kernels``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.peak_kernels import ROW, STRIP, collect, mark_peaks, peaks_of_eight
from harris_perception.core.image import lanes
from harris_perception.core.image.bitmap import MARGIN
from harris_perception.core.image.compiled import compiled, inlined

Array = npt.NDArray[Any]

# Eight elements are compared at a time, so up to seven elements before the first row of scratch are read.
_BEFORE = 8


@inlined
def _smooth_and_difference(p0: Any, p1: Any, p2: Any, p3: Any, rows: Any, n: int, centre: Any) -> None:
    """Combine image rows vertically: smoothed and differentiated around p1 (rows 0, 1) and around p2 (rows 2, 3)."""
    s0, d0, s1, d1 = rows[:ROW], rows[ROW : 2 * ROW], rows[2 * ROW : 3 * ROW], rows[3 * ROW :]
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
        v0, v1, v2 = np.float32(g[ROW + x]), np.float32(g[ROW + x + 1]), np.float32(g[ROW + x + 2])
        a0, b0, c0 = u0 * u0 + u1 * u1 + u2 * u2, v0 * v0 + v1 * v1 + v2 * v2, u0 * v0 + u1 * v1 + u2 * v2
        u0, u1, u2 = np.float32(g[2 * ROW + x]), np.float32(g[2 * ROW + x + 1]), np.float32(g[2 * ROW + x + 2])
        v0, v1, v2 = np.float32(g[3 * ROW + x]), np.float32(g[3 * ROW + x + 1]), np.float32(g[3 * ROW + x + 2])
        a1, b1, c1 = u0 * u0 + u1 * u1 + u2 * u2, v0 * v0 + v1 * v1 + v2 * v2, u0 * v0 + u1 * v1 + u2 * v2
        rows[new + x], rows[new + ROW + x], rows[new + 2 * ROW + x] = a0, b0, c0
        rows[new + 3 * ROW + x], rows[new + 4 * ROW + x], rows[new + 5 * ROW + x] = a1, b1, c1
        am, bm, cm = rows[old + 3 * ROW + x] + a0, rows[old + 4 * ROW + x] + b0, rows[old + 5 * ROW + x] + c0
        a, b, c = rows[old + x] + am, rows[old + ROW + x] + bm, rows[old + 2 * ROW + x] + cm
        trace = a + b
        rows[result + x] = a * b - c * c - k * trace * trace
        a, b, c = am + a1, bm + b1, cm + c1
        trace = a + b
        rows[result + ROW + x] = a * b - c * c - k * trace * trace


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
    """Mark peaks as ``mark_peaks``, and in two ``minima`` those along the axis nearer to the gradient.

    The two are those below ``low`` and those below ``high``. ``shift`` bits precede that of column 1; for peaks they
    are meaningless. Element x of the responses belongs to element x + 1 of the gradient. This is the thinning of the
    paper of 1988.
    """
    eighths = (shift + n + 5) // 8
    weak, strong = minima
    kept = weak[0], strong[0]  # of the previous strip, which ends in the byte in which this one begins
    for i in range(eighths):
        x = 8 * i + 1 - shift
        marks[i] = peaks_of_eight(above, here, below, x, floor)
        along_x = lanes.reach_in_magnitude(gx, x + 1, gy, x + 1)
        least = lanes.chosen_exceed(along_x, here, x - 1, above, x, here, x)
        least &= lanes.chosen_reach(along_x, here, x + 1, below, x, here, x)
        weak[i] = least & lanes.below(here, x, low)
        strong[i] = least & lanes.below(here, x, high)
    first, last = 255 << shift, 255 >> (8 * eighths - (shift + n - 2))
    weak[0], strong[0] = kept[0] | (weak[0] & first), kept[1] | (strong[0] & first)
    weak[eighths - 1] &= last
    strong[eighths - 1] &= last


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
    vertical = np.empty(4 * ROW, weight.dtype)
    # gx, gy of two rows, and of the previous two rows, which give the direction in which minima are tested.
    gradients = np.empty(_BEFORE + 8 * ROW, weight.dtype)[_BEFORE:]
    g0, g1 = gradients[: 4 * ROW], gradients[4 * ROW :]
    rows = np.empty(16 * ROW, np.float32)
    r0, r1 = rows[12 * ROW : 13 * ROW], rows[13 * ROW : 14 * ROW]
    r2, r3 = rows[14 * ROW : 15 * ROW], rows[15 * ROW :]
    # Marks of edges start at a byte boundary of the bitmap, this number of columns before the strip.
    shift = border % 8 if edges.size > 0 else 0
    columns, bits = np.empty(ROW + 8, np.int32), np.zeros(ROW // 64 + 1, np.uint64)
    marks = bits.view(np.uint8)
    weight_k, fraction, floor = np.float32(k), np.float32(relative), np.float32(absolute)
    found = np.empty((2048 + (last - first) * width // 32, 3), np.float32)
    count = 0
    low, high = np.float32(weak), np.float32(strong)
    for start in range(border, width - border, STRIP):
        x0 = start - 1  # column of the response's first element; its gradient starts one further left, the image two
        n = min(start + STRIP, width - border) + 1 - x0
        byte = (MARGIN + start - shift) // 8
        for y in range(first - 2, last + 2, 2):  # y and y + 1 are gradient rows; responses are y - 1 and y
            p = x0 - 2
            # The last pair may lack its second row; results computed from the repeated row are not used.
            bottom = gray[min(y + 2, gray.shape[0] - 1), p:]
            _smooth_and_difference(gray[y - 1, p:], gray[y, p:], gray[y + 1, p:], bottom, vertical, n + 4, centre)
            even = ((y - first) // 2) % 2 == 0
            g, before = (g0, g1) if even else (g1, g0)
            _gradient(vertical[:ROW], vertical[ROW : 2 * ROW], g[:ROW], g[ROW : 2 * ROW], n + 2, centre)
            _gradient(
                vertical[2 * ROW : 3 * ROW],
                vertical[3 * ROW :],
                g[2 * ROW : 3 * ROW],
                g[3 * ROW :],
                n + 2,
                centre,
            )
            if even:
                _response_rows(g0, rows, 0, 6 * ROW, 12 * ROW, n, weight_k)
                above, here, below, beyond = r2, r3, r0, r1
            else:
                _response_rows(g1, rows, 6 * ROW, 0, 14 * ROW, n, weight_k)
                above, here, below, beyond = r0, r1, r2, r3
            for i in range(2):  # rows y - 2 and y - 1
                row = y - 2 + i
                if not first <= row < last:
                    continue
                one, middle, other = (above, here, below) if i == 0 else (here, below, beyond)
                if edges.size > 0:
                    gx, gy = before[2 * i * ROW :], before[(2 * i + 1) * ROW :]
                    minima = edges[0, row + 1, byte:], edges[1, row + 1, byte:]
                    _mark_all(one, middle, other, gx, gy, marks, minima, shift, n, floor, low, high)
                else:
                    mark_peaks(one, middle, other, marks, n, floor)
                found, count, floor = collect(
                    one, middle, other, bits, shift, columns, n, x0, row, floor, fraction, subpixel, half, found, count
                )
    return found[:count], floor
