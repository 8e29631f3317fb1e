"""Recursive Gaussian smoothing and derivative: the cost per pixel does not depend on sigma.

Source: R. Deriche, "Recursively implementing the Gaussian and its derivatives", INRIA RR-1893, 1993: each half of the
kernel is approximated by two damped oscillations, which a recursion of order four computes exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import compiled

F32 = npt.NDArray[Any]

# a0, a1, b0, w0 and c0, c1, b1, w1 of the report: (a0 cos w0 t + a1 sin w0 t) exp(-b0 t) + ..., t in units of sigma.
_SMOOTH = ((1.68, 3.735, 1.783, 0.6318), (-0.6803, -0.2598, 1.723, 1.997))
_DERIVATIVE = ((-0.6472, -4.531, 1.527, 0.6719), (0.6494, 0.9557, 1.516, 2.072))

_STRIP = 64
"""Number of columns processed at once, so that their rows stay in the first-level cache."""


@dataclass(frozen=True, slots=True, eq=False)
class RecursiveFilter:
    """Weights of the recursions downwards (``ahead``) and upwards (``back``), and of previous results (``poles``).

    All float64: ``ahead`` (4,) weights the input ``lag`` rows before and in the three rows before that, ``back`` (4,)
    the input in the four rows behind, ``poles`` (4,) the results of the last four rows.
    """

    ahead: npt.NDArray[np.float64]
    back: npt.NDArray[np.float64]
    poles: npt.NDArray[np.float64]
    lag: int


@lru_cache(maxsize=64)
def recursive_filter(sigma: float, derivative: bool) -> RecursiveFilter:
    """Return the filter for a Gaussian of ``sigma`` px (it keeps constants) or its derivative (it gives ramps' slope).

    Raises
    ------
    ValueError
        For sigma below 0.5, where the approximation of a sampled Gaussian is poor.
    """
    if not sigma >= 0.5:
        raise ValueError(f"sigma = {sigma}; expected at least 0.5 px")
    terms = _DERIVATIVE if derivative else _SMOOTH
    # Each oscillation is half the sum of g p^n and its conjugate.
    gains = np.array([z for a, b, _, _ in terms for z in ((a - 1j * b) / 2, (a + 1j * b) / 2)])
    powers = [(-b + sign * 1j * w) / sigma for _, _, b, w in terms for sign in (1, -1)]
    roots = np.exp(np.array(powers))
    denominator = np.real(np.poly(roots))
    numerator = sum(gain * np.poly(np.delete(roots, i)) for i, gain in enumerate(gains))
    ahead = np.append(np.real(numerator), 0.0)
    beside = ahead - ahead[0] * denominator  # without the kernel's middle, which only one of the recursions may count
    if derivative:
        ahead = beside  # an odd kernel is zero in its middle, so its weights start one row later
    back = -beside[1:] if derivative else beside[1:]
    # Normalise by the sampled kernel's response to a constant, or to a ramp.
    count = int(np.ceil(20.0 * sigma))
    t = np.arange(count)
    half = np.real((gains[:, None] * roots[:, None] ** t).sum(axis=0))
    scale = 2.0 * (half[1:] * t[1:]).sum() if derivative else 2.0 * half.sum() - half[0]
    scale = -scale if derivative else scale
    ahead = ahead[1:] if derivative else ahead[:4]
    return RecursiveFilter(ahead / scale, back / scale, denominator[1:].copy(), int(derivative))


@compiled
def _filter_columns(source: F32, ahead: F32, back: F32, poles: F32, lag: int, result: F32) -> None:
    """Filter (H, W) float32 down and up the columns; the first and last rows are replicated beyond the image."""
    height, width = source.shape
    n0, n1, n2, n3 = ahead
    m1, m2, m3, m4 = back
    d1, d2, d3, d4 = poles
    total = 1.0 + d1 + d2 + d3 + d4
    first, last = (n0 + n1 + n2 + n3) / total, (m1 + m2 + m3 + m4) / total
    # Float64: the poles are near one, and rounding errors would accumulate.
    down = np.empty((height + 4, _STRIP), np.float64)
    up = np.empty((4, _STRIP), np.float64)
    for left in range(0, width, _STRIP):
        n = min(_STRIP, width - left)
        for i in range(4):
            for x in range(n):
                down[i, x] = first * source[0, left + x]
                up[i, x] = last * source[height - 1, left + x]
        for y in range(height):
            here = y - lag
            x0, x1 = source[max(here, 0), left:], source[max(here - 1, 0), left:]
            x2, x3 = source[max(here - 2, 0), left:], source[max(here - 3, 0), left:]
            y1, y2, y3, y4, out = down[y + 3], down[y + 2], down[y + 1], down[y], down[y + 4]
            for x in range(n):
                forced = n0 * x0[x] + n1 * x1[x] + n2 * x2[x] + n3 * x3[x]
                out[x] = forced - d1 * y1[x] - d2 * y2[x] - d3 * y3[x] - d4 * y4[x]
        bottom = height - 1
        for y in range(bottom, -1, -1):
            x1, x2 = source[min(y + 1, bottom), left:], source[min(y + 2, bottom), left:]
            x3, x4 = source[min(y + 3, bottom), left:], source[min(y + 4, bottom), left:]
            turn = bottom - y
            y1, y2 = up[(turn + 3) % 4], up[(turn + 2) % 4]
            y3, y4 = up[(turn + 1) % 4], up[turn % 4]  # the oldest is replaced
            out, other = result[y, left:], down[y + 4]
            for x in range(n):
                forced = m1 * x1[x] + m2 * x2[x] + m3 * x3[x] + m4 * x4[x]
                value = forced - d1 * y1[x] - d2 * y2[x] - d3 * y3[x] - d4 * y4[x]
                y4[x] = value
                out[x] = other[x] + value


def filtered(picture: F32, along_x: RecursiveFilter, along_y: RecursiveFilter) -> F32:
    """Return an image (H, W) float32 filtered in both directions, (H, W) float32.

    Border pixels are replicated beyond the image. One value that is not finite makes the whole image invalid.
    """
    result = np.empty(picture.shape, np.float32)
    if picture.size == 0:
        return result
    rows = np.ascontiguousarray(picture, np.float32)
    _filter_columns(rows, along_y.ahead, along_y.back, along_y.poles, along_y.lag, result)
    turned = np.empty(picture.shape[::-1], np.float32)
    columns = np.ascontiguousarray(result.T)
    _filter_columns(columns, along_x.ahead, along_x.back, along_x.poles, along_x.lag, turned)
    return np.ascontiguousarray(turned.T)
