"""Structure tensor of an image for any separable kernels and window, in one pass over its rows; compiled by numba.

Rows of gradient products are kept in a ring buffer as high as the window, so that only the result is written to memory.
Separate filters would write and read five intermediate images.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import compiled, inlined

Array = npt.NDArray[Any]


@inlined
def _smoothed(source: Any, taps: Any, result: Any, n: int) -> None:
    """Filter a row by symmetric taps, centre first; two pairs of taps at a time."""
    radius = len(taps) - 1
    centre, middle = taps[0], source[radius:]
    for x in range(n):
        result[x] = centre * middle[x]
    for i in range(1, radius, 2):
        first, second = taps[i], taps[i + 1]
        a, b, c, d = source[radius - i :], source[radius + i :], source[radius - i - 1 :], source[radius + i + 1 :]
        for x in range(n):
            result[x] += first * (a[x] + b[x]) + second * (c[x] + d[x])
    if radius % 2:
        last, end = taps[radius], source[2 * radius :]
        for x in range(n):
            result[x] += last * (source[x] + end[x])


@compiled
def structure_of(gray: Array, derivative: Array, smooth: Array, window: Array, a: Array, b: Array, c: Array) -> None:
    """Fill a, b, c with the sums of gx^2, gy^2 and gx gy over the window.

    Parameters
    ----------
    gray
        (H, W) of any type.
    derivative
        (r,) float32 weights of the pixels 1 to r ahead; those behind have the opposite sign.
    smooth, window
        (r + 1,), (w + 1,) float32 weights of the centre and of the pixels on either side.
    a, b, c
        (H - 2 (r + w), W - 2 (r + w)) float32, to be filled.
    """
    height, width = gray.shape
    radius, half = len(smooth) - 1, len(window) - 1
    n, m, size = width - 2 * radius, a.shape[1], 2 * half + 1
    vertical, change = np.empty(width, np.float32), np.empty(width, np.float32)
    gx, gy = np.empty(n, np.float32), np.empty(n, np.float32)
    ring = np.empty((3, size, n), np.float32)
    column = np.empty(n, np.float32)
    sums = a, b, c
    for y in range(radius, height - radius):
        row = gray[y]
        centre = smooth[0]
        for x in range(width):
            vertical[x] = centre * np.float32(row[x])
            change[x] = np.float32(0.0)
        for i in range(1, radius + 1):
            above, below = gray[y - i], gray[y + i]
            share, slope = smooth[i], derivative[i - 1]
            for x in range(width):
                p, q = np.float32(above[x]), np.float32(below[x])
                vertical[x] += share * (p + q)
                change[x] += slope * (q - p)
        _smoothed(change, smooth, gy, n)
        for x in range(n):
            gx[x] = np.float32(0.0)
        for i in range(1, radius + 1):
            slope = derivative[i - 1]
            before, after = vertical[radius - i :], vertical[radius + i :]
            for x in range(n):
                gx[x] += slope * (after[x] - before[x])
        newest = y % size
        ra, rb, rc = ring[0, newest], ring[1, newest], ring[2, newest]
        for x in range(n):
            u, v = gx[x], gy[x]
            ra[x], rb[x], rc[x] = u * u, v * v, u * v
        out = y - radius - 2 * half
        if out < 0:
            continue
        for which in range(3):
            rows = ring[which]
            middle = rows[(y - half) % size]
            centre = window[0]
            for x in range(n):
                column[x] = centre * middle[x]
            for i in range(1, half, 2):
                first, second = window[i], window[i + 1]
                p, q = rows[(y - half - i) % size], rows[(y - half + i) % size]
                s, t = rows[(y - half - i - 1) % size], rows[(y - half + i + 1) % size]
                for x in range(n):
                    column[x] += first * (p[x] + q[x]) + second * (s[x] + t[x])
            if half % 2:
                last = window[half]
                p, q = rows[(y - 2 * half) % size], rows[y % size]
                for x in range(n):
                    column[x] += last * (p[x] + q[x])
            _smoothed(column, window, sums[which][out], m)
