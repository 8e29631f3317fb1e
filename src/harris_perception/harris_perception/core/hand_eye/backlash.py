"""Backlash of an axis, from positions approached from the opposite side to those of the calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.hand_eye import HandEye
from harris_perception.core.hand_eye.tip_samples import Place

_WORTH = 8.0
"""Weight of the predicted error of a position relative to the misfit of its own pair, in degrees of freedom.

The prediction is the mean of many positions, which have different backgrounds. The value is the most likely one for
seeds 100 to 149 of the benchmark with fixed cameras.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Backlash:
    """Backlash of one axis in metres along it, positive, and its standard deviation."""

    play_m: float
    sigma_m: float
    places: int

    def text(self) -> str:
        """Return the backlash as text for people."""
        return f"{self.play_m * 1e3:.3f} +- {self.sigma_m * 1e3:.3f} mm"


def measure_backlash(calibration: HandEye, axis: int, pairs: Sequence[tuple[Place, Place]]) -> Backlash:
    """Measure how much further along an axis the carriage is when it arrives from above.

    Parameters
    ----------
    calibration
        Gives the directions of the axes.
    axis
        0 for x, 1 for y.
    pairs
        Two adjacent positions, the first approached from below, the second from above. They are so close that both have
        nearly the same error of lens and light, and only their difference counts.
    """
    rail, count = calibration.fit.regression[axis], len(calibration.fit.regression) - 1
    ahead = [
        above.point - below.point - (above.reading - below.reading)[:count] @ calibration.fit.regression[:-1]
        for below, above in pairs
    ]
    # The backlash is only along the rail. At the image border, where these positions are, the line of sight is oblique,
    # and a depth error along it looks like backlash. So the direction with the largest error must have no weight. The
    # covariances themselves are too inaccurate to be weights: pairs that seem good by chance would dominate.
    badly = sum(below.per_pixel + above.per_pixel for below, above in pairs)
    weight = np.linalg.solve(badly, rail)
    weight = weight / (weight @ rail)
    play = float(np.mean([weight @ a for a in ahead]))
    spreads = [below.covariance + above.covariance for below, above in pairs]
    variance = float(sum(weight @ spread @ weight for spread in spreads)) / len(pairs) ** 2
    # Nothing moves across the rail, so the pairs' misfit in that direction measures the error at these positions.
    missed = [a - play * rail for a in ahead]
    square = float(sum(off @ np.linalg.solve(spread, off) for off, spread in zip(missed, spreads)))
    variance *= (_WORTH + square) / (_WORTH + 3 * len(pairs) - 1)
    scale = float(np.linalg.norm(calibration.base_from_reading[:, axis]))
    return Backlash(play_m=play * scale, sigma_m=scale * float(np.sqrt(variance)), places=len(pairs))
