"""Backlash of an axis from places that were entered from the other side than those of the calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye import HandEye
from icu_common.core.geometry import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Backlash:
    """Play of one axis, metres along it, positive, and its standard deviation."""

    play_m: float
    sigma_m: float
    places: int

    def text(self) -> str:
        """Return it for people."""
        return f"{self.play_m * 1e3:.3f} +- {self.sigma_m * 1e3:.3f} mm"


def measure_backlash(calibration: HandEye, axis: int, seen: Sequence[tuple[Array, Array]]) -> Backlash:
    """Measure how much further along an axis the carriage is when it comes from above.

    Parameters
    ----------
    calibration
        Made of places that were entered from below.
    axis
        0 for x, 1 for y.
    seen
        Readings (3,) m and what was seen there (3,) m in the camera's frame: the tip or, for cameras on the carriage,
        the panel's origin, which goes the other way.
    """
    fit = calibration.fit
    readings = np.array([reading for reading, _ in seen])
    points = np.array([point for _, point in seen])
    count = len(fit.regression)
    design = np.column_stack([readings[:, : count - 1], np.ones(len(seen))])
    rail = fit.regression[axis]
    along = rail / float(rail @ rail)  # from the camera's frame to metres of reading, as the play is
    ahead = (points - design @ fit.regression) @ along
    scale = float(np.linalg.norm(calibration.base_from_reading[:, axis]))
    # One place's own noise, averaged, and the fit's, which the places share.
    own = float(along @ fit.noise @ along) / len(seen)
    shared = float(np.mean(design, axis=0) @ fit.spread @ np.mean(design, axis=0)) * float(along @ fit.noise @ along)
    return Backlash(play_m=float(ahead.mean()) * scale, sigma_m=float(np.sqrt(own + shared)) * scale, places=len(seen))
