"""Sightings of the tip at rest, and the rows of the regression that their readings give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from icu_common.core.geometry.geometry import Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sample:
    """A sighting of the tip while the machine was at rest.

    Attributes
    ----------
    reading
        (3,) m: x, y, stylus extension.
    tip
        (3,) m in the camera's rectified frame.
    covariance
        (3, 3) m^2 of ``tip``.
    """

    reading: Array
    tip: Array
    covariance: Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Place:
    """Position of a point: the tip or, with cameras on the carriage, the panel's origin.

    Attributes
    ----------
    reading
        (3,) m: x, y, stylus extension.
    point
        (3,) m in the camera's rectified frame.
    per_pixel
        (3, 3) m^2: the covariance of ``point`` if all measurements in the images had an independent error of 1 px.
    covariance
        (3, 3) m^2 of ``point``, without the error shared with its neighbours.
    """

    reading: Array
    point: Array
    per_pixel: Array
    covariance: Array


def reading_design(readings: Array, with_stylus: bool) -> Array:
    """Return the design (N, 4) or (N, 3) of a point that moves with the readings (N, 3) m."""
    columns = readings if with_stylus else readings[:, :2]
    return np.column_stack([columns, np.ones(len(readings))])


def extension_design(extensions: Array, with_stylus: bool) -> Array:
    """Return the design (N, 2) or (N, 1) of a point that moves only with the stylus, for extensions (N,) m."""
    ones = np.ones((len(extensions), 1))
    return np.column_stack([extensions, ones]) if with_stylus else ones
