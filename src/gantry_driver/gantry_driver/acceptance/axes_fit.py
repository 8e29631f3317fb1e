"""Axes of the gantry as the cameras see them: directions, scale, squareness, tilt and backlash.

The tips are measured in the frame of the panel, by the stereo cameras and the panel's print. The board's counts are
used only as readings, so a wrong direction, steps/mm, or a slipping belt shows as a difference of the two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gantry_driver.acceptance.stops import AcceptanceStop
from icu_common.core.geometry.geometry import Array

UNKNOWNS = 5
"""Unknowns of each coordinate: origin, two axes, two backlashes."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class AxesFit:
    """Least-squares solution of ``tip = origin + axes @ reading + lag @ from_above`` in the panel's frame [m].

    ``axes`` and ``lag`` are (3, 2); the columns belong to x and y. ``residuals`` (N, 3) belong to the stops.
    ``sigma_m`` is the standard deviation of one tip on the face, ``axis_sigma`` (2,) that of an axis' length,
    ``lag_sigma_m`` (2,) that of the backlash.
    """

    origin: Array
    axes: Array
    lag: Array
    residuals: Array
    sigma_m: float
    axis_sigma: Array
    lag_sigma_m: Array

    @property
    def scale_error(self) -> Array:
        """Relative difference (2,) of the seen way from the way by the board's counts."""
        return np.asarray(np.linalg.norm(self.axes, axis=0) - 1.0)

    @property
    def direction_deg(self) -> Array:
        """Angles (2,) between the axes and those of the panel, in its face."""
        x, y = self.axes[:2].T
        return np.degrees([math.atan2(x[1], x[0]), math.atan2(-y[0], y[1])])

    @property
    def squareness_deg(self) -> float:
        """Angle between the axes less 90 degrees."""
        x, y = (axis / np.linalg.norm(axis) for axis in self.axes.T)
        return float(np.degrees(np.arccos(np.clip(x @ y, -1.0, 1.0)))) - 90.0

    @property
    def tilt_deg(self) -> float:
        """Angle between the plane of the axes and the panel's face."""
        normal = np.cross(*self.axes.T)
        return float(np.degrees(np.arccos(np.clip(abs(normal[2]) / np.linalg.norm(normal), 0.0, 1.0))))

    @property
    def backlash_m(self) -> Array:
        """Backlash (2,): how much further along the axis the tip is when it arrives from above."""
        return np.asarray((self.lag * self.axes).sum(axis=0) / np.linalg.norm(self.axes, axis=0))

    @property
    def straightness_m(self) -> float:
        """Rms distance of the tips from the fit, on the face."""
        return float(np.sqrt((self.residuals[:, :2] ** 2).sum(axis=1).mean()))

    def panel_at(self, readings: Array) -> Array:
        """Return the points (N, 2) of the panel's face in front of readings (N, 2)."""
        return np.asarray(self.origin[:2] + readings @ self.axes[:2].T)


def fit_axes(stops: Sequence[AcceptanceStop], readings: Array, tips: Array) -> AxesFit:
    """Fit the axes to tips (N, 3) in the panel's frame at readings (N, 2), both in metres.

    Raises
    ------
    ValueError
        If the tip was seen at too few stops to determine all unknowns.
    """
    above = np.array([stop.from_above for stop in stops]).reshape(-1, 2)
    design = np.column_stack([np.ones(len(above)), readings, above])
    rank = int(np.linalg.matrix_rank(design / np.maximum(np.abs(design).max(axis=0), 1e-9))) if len(design) else 0
    if len(design) <= UNKNOWNS or rank < UNKNOWNS:
        raise ValueError(
            f"the tip was seen at {len(design)} stops; expected more than {UNKNOWNS} with all backlash pairs: "
            "check the stylus tracker and the cameras' view"
        )
    solution, *_ = np.linalg.lstsq(design, tips, rcond=None)
    residuals = tips - design @ solution
    freedom = 2 * (len(design) - UNKNOWNS)
    sigma = math.sqrt(float((residuals[:, :2] ** 2).sum()) / freedom)
    spread = sigma * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    return AxesFit(
        origin=solution[0],
        axes=solution[1:3].T,
        lag=solution[3:].T,
        residuals=residuals,
        sigma_m=sigma,
        axis_sigma=spread[1:3],
        lag_sigma_m=spread[3:],
    )
