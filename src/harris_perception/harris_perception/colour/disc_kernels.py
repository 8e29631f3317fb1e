"""Equations of one channel in the fit of a shaded, blurred disc, compiled because the tracker solves them often."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.colour.blurred_disc import REACH, STEP
from harris_perception.core.image.compiled import compiled

Array = npt.NDArray[Any]

COLUMNS = 10
"""Unknowns of one channel: centre (2), radius, blur, shading (4), background, gain."""
SHADING, BACKGROUND, GAIN = 4, 8, 9
"""Columns of the first shading term, of the background, and of the gain."""


@compiled
def disc_equations(
    at: Array,
    values: Array,
    around: Array,
    table: Array,
    by_blur_table: Array,
    disc: Array,
    blur: float,
    shape: Array,
    gain: float,
    rest: float,
) -> tuple[Array, Array]:
    """Return the derivatives (N, 10) of the pixels by the unknowns, and what the model leaves unexplained (N,).

    Parameters
    ----------
    at
        (N, 2) pixels, px.
    values, around
        (N,) values of the pixels and of the background behind the ball, grey levels.
    table, by_blur_table
        (3, M) each, from :func:`harris_perception.colour.blurred_disc.profile_tables`.
    disc
        (3,) centre and radius, px.
    blur
        Standard deviation of the blur, px.
    shape
        (4,) constant, two tilts and dome of the first channel, grey levels.
    gain
        The channel's brightness as a multiple of the first one's.
    rest
        Deviation of the background from ``around``, grey levels.
    """
    count = len(at)
    joint, error = np.empty((count, COLUMNS)), np.empty(count)
    x, y, radius = disc
    for i in range(count):
        dx, dy = at[i, 0] - x, at[i, 1] - y
        distance = max(np.hypot(dx, dy), 1e-6)
        dx, dy = dx / distance, dy / distance
        place = min(distance / radius, REACH) / STEP
        cell = int(place)
        share = place - cell
        flat = (1 - share) * table[0, cell] + share * table[0, cell + 1]
        tilt = (1 - share) * table[1, cell] + share * table[1, cell + 1]
        dome = (1 - share) * table[2, cell] + share * table[2, cell + 1]
        lean = gain * (dx * shape[1] + dy * shape[2])
        step = gain * shape[0] - around[i] - rest
        outward = (
            (table[0, cell + 1] - table[0, cell]) * step
            + (table[1, cell + 1] - table[1, cell]) * lean
            + (table[2, cell + 1] - table[2, cell]) * gain * shape[3]
        ) / (STEP * radius)
        by_blur = (
            ((1 - share) * by_blur_table[0, cell] + share * by_blur_table[0, cell + 1]) * step
            + ((1 - share) * by_blur_table[1, cell] + share * by_blur_table[1, cell + 1]) * lean
            + ((1 - share) * by_blur_table[2, cell] + share * by_blur_table[2, cell + 1]) * gain * shape[3]
        ) / radius
        shaded = flat * shape[0] + tilt * (dx * shape[1] + dy * shape[2]) + dome * shape[3]
        joint[i, 0] = -dx * outward - (gain * shape[1] - lean * dx) * tilt / distance
        joint[i, 1] = -dy * outward - (gain * shape[2] - lean * dy) * tilt / distance
        joint[i, 2] = -outward * distance / radius - by_blur * blur / radius
        joint[i, 3] = by_blur
        joint[i, 4] = gain * flat
        joint[i, 5] = gain * dx * tilt
        joint[i, 6] = gain * dy * tilt
        joint[i, 7] = gain * dome
        joint[i, 8] = 1 - flat
        joint[i, 9] = shaded
        error[i] = values[i] - (around[i] + rest) * (1 - flat) - gain * shaded
    return joint, error


@compiled
def weighted_sums(joint: Array, error: Array, width: float, noise: float) -> tuple[Array, Array, Array]:
    """Return the normal matrix (10, 10), its right side (10,) and Tukey's weights (N,).

    Parameters
    ----------
    joint, error
        Results of :func:`disc_equations`.
    width
        Error at which a pixel has no weight, grey levels.
    noise
        Standard deviation of a pixel, grey levels.
    """
    normal, known, weights = np.zeros((COLUMNS, COLUMNS)), np.zeros(COLUMNS), np.empty(len(error))
    for i in range(len(error)):
        weight = max(1 - (error[i] / width) ** 2, 0.0) ** 2
        weights[i] = weight
        if weight == 0.0:
            continue
        factor = weight / noise**2
        for j in range(COLUMNS):
            scaled = joint[i, j] * factor
            known[j] += scaled * error[i]
            for k in range(j, COLUMNS):
                normal[j, k] += scaled * joint[i, k]
    for j in range(COLUMNS):
        for k in range(j):
            normal[j, k] = normal[k, j]
    return normal, known, weights
