"""The exact image of a shaded disc behind a Gaussian blur, as tables over the distance from its centre.

A ball whose brightness is linear in its surface normal (Lambert) has, within a disc of radius 1, the brightness
``c0 + c1 x + c2 y + c3 sqrt(1 - x^2 - y^2)``. A rotationally symmetric blur changes only the radial profile of each of
the four terms, not its angle: ``c0 P0(r) + (c1 cos + c2 sin) P1(r) + c3 P2(r)``. For sharp images the product of
shading and blurred outline is exact enough. It is 0.4 px off if the blur is a quarter of the radius, as with colour of
half the resolution.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

REACH = 3.0
"""Radii that the tables cover; farther out the disc is invisible."""
STEP = 0.05
"""Distance between two columns of a table, in radii."""
_BLUR_STEP = 0.02
_LEAST_BLUR, _LARGEST_BLUR = 0.1, 0.8
_RINGS, _SPOKES = 24, 48


@functools.cache
def _table(index: int) -> Array:
    """Return (3, M) profiles of the constant, the linear and the dome term at multiples of ``STEP`` radii."""
    blur = index * _BLUR_STEP
    # Gauss-Legendre along the radius, equal angles around; the integrands are smooth except at the rim, where the dome
    # ends.
    nodes, weights = np.polynomial.legendre.leggauss(_RINGS)
    radius, share = 0.5 * (nodes + 1.0), 0.5 * weights
    angle = (np.arange(_SPOKES) + 0.5) * 2 * np.pi / _SPOKES
    x, y = (radius[:, None] * np.cos(angle)).ravel(), (radius[:, None] * np.sin(angle)).ravel()
    area = np.repeat(radius * share * 2 * np.pi / _SPOKES, _SPOKES)
    terms = np.stack([np.ones_like(x), x, np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))]) * area
    at = np.arange(0.0, REACH + 2 * STEP, STEP)
    kernel = np.exp(-0.5 * ((at[:, None] - x) ** 2 + y**2) / blur**2) / (2 * np.pi * blur**2)
    return np.asarray(terms @ kernel.T)


def profile_tables(blur: float) -> tuple[Array, Array]:
    """Return the table of the profiles at one blur, and its derivative by the blur, each (3, M).

    Column k is for the distance ``k * STEP``. Distances and the blur's standard deviation are in radii of the disc.
    """
    level = min(max(blur, _LEAST_BLUR), _LARGEST_BLUR - 1e-6) / _BLUR_STEP
    low = int(level)
    part = level - low
    lower, upper = _table(low), _table(low + 1)
    return (1 - part) * lower + part * upper, (upper - lower) / _BLUR_STEP
