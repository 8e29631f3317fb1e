"""Backlash of an axis from places that were entered from the other side than those of the calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye import HandEye, Sample


@dataclass(frozen=True, slots=True, kw_only=True)
class Backlash:
    """Play of one axis, metres along it, positive, and its standard deviation."""

    play_m: float
    sigma_m: float
    places: int

    def text(self) -> str:
        """Return it for people."""
        return f"{self.play_m * 1e3:.3f} +- {self.sigma_m * 1e3:.3f} mm"


def measure_backlash(calibration: HandEye, axis: int, pairs: Sequence[tuple[Sample, Sample]]) -> Backlash:
    """Measure how much further along an axis the carriage is when it comes from above.

    Parameters
    ----------
    calibration
        Tells where the axes run.
    axis
        0 for x, 1 for y.
    pairs
        Two places beside one another, the first entered from below, the second from above: what was seen there is the
        tip or, for cameras on the carriage, the panel's origin, which goes the other way. So near to one another, both
        are seen with nearly the same error of lens and light, and only their difference counts. Each with the
        covariance of what its neighbour does not share.
    """
    rail, count = calibration.fit.regression[axis], len(calibration.fit.regression) - 1
    information = play = 0.0
    for below, above in pairs:
        ahead = above.tip - below.tip - (above.reading - below.reading)[:count] @ calibration.fit.regression[:-1]
        # The play is along the rail and nowhere else. At the picture's edge, where these places are, the line of sight
        # leans, and an error of depth along it looks like play: the direction that is seen badly there must not count.
        weight = np.linalg.solve(below.covariance + above.covariance, rail)
        information += float(weight @ rail)
        play += float(weight @ ahead)
    # All pairs of an axis stand at the same place along it, so that cameras on the carriage see each line of the panel
    # in the same row or column of pixels: their number does not reduce that error.
    variance = (len(pairs) if calibration.on_carriage else 1) / information
    scale = float(np.linalg.norm(calibration.base_from_reading[:, axis]))
    return Backlash(play_m=play / information * scale, sigma_m=scale * float(np.sqrt(variance)), places=len(pairs))
