"""Loops over the response of any gradient and window, compiled by numba: from sums of products, and to edges."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.bitmap import MARGIN, pack
from harris_perception.core.image.compiled import compiled

Array = npt.NDArray[Any]

# Below this fraction of the product of the two diagonal elements, a determinant is float32 rounding, no corner.
_RANK_ONE = np.float32(2.0**-21)


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
