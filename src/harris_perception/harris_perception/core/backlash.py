"""Backlash of an axis from places that were entered from the other side than those of the calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye import HandEye, Place

_WORTH = 8.0
"""How much what is predicted of a place's error counts against what its own pair misses by, in degrees of freedom.

The prediction is the mean of many places, and each has another background: the likeliest value for seeds 100 to 149 of
the benchmark with fixed cameras.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Backlash:
    """Play of one axis, metres along it, positive, and its standard deviation."""

    play_m: float
    sigma_m: float
    places: int

    def text(self) -> str:
        """Return it for people."""
        return f"{self.play_m * 1e3:.3f} +- {self.sigma_m * 1e3:.3f} mm"


def measure_backlash(calibration: HandEye, axis: int, pairs: Sequence[tuple[Place, Place]]) -> Backlash:
    """Measure how much further along an axis the carriage is when it comes from above.

    Parameters
    ----------
    calibration
        Tells where the axes run.
    axis
        0 for x, 1 for y.
    pairs
        Two places beside one another, the first entered from below, the second from above. So near to one another, both
        are seen with nearly the same error of lens and light, and only their difference counts.
    """
    rail, count = calibration.fit.regression[axis], len(calibration.fit.regression) - 1
    ahead = [
        above.point - below.point - (above.reading - below.reading)[:count] @ calibration.fit.regression[:-1]
        for below, above in pairs
    ]
    # The play is along the rail and nowhere else. At the picture's edge, where these places are, the line of sight
    # leans, and an error of depth along it looks like play: the direction that is seen badly there must not count.
    # The covariances themselves are too rough to be weights: pairs that seem good by chance would count too much.
    badly = sum(below.per_pixel + above.per_pixel for below, above in pairs)
    weight = np.linalg.solve(badly, rail)
    weight = weight / (weight @ rail)
    play = float(np.mean([weight @ a for a in ahead]))
    spreads = [below.covariance + above.covariance for below, above in pairs]
    variance = float(sum(weight @ spread @ weight for spread in spreads)) / len(pairs) ** 2
    # Across the rail nothing moves, so what the pairs miss by there tells how well these very places were seen.
    missed = [a - play * rail for a in ahead]
    square = float(sum(off @ np.linalg.solve(spread, off) for off, spread in zip(missed, spreads)))
    variance *= (_WORTH + square) / (_WORTH + 3 * len(pairs) - 1)
    scale = float(np.linalg.norm(calibration.base_from_reading[:, axis]))
    return Backlash(play_m=play * scale, sigma_m=scale * float(np.sqrt(variance)), places=len(pairs))
