"""Backlash of an axis from places that were entered from the other side than those of the calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye import HandEye, Sample

_ALIKE = 0.8
"""Part of a view's error that the panel's next view, a few millimetres on, has too (found by simulation, as the half
below, on other machines than benchmarks/bench_hand_eye.py reports)."""


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
        Tells where the axes run and how well a place is seen.
    axis
        0 for x, 1 for y.
    pairs
        Two places beside one another, the first entered from below, the second from above: what was seen there is the
        tip or, for cameras on the carriage, the panel's origin, which goes the other way. So near to one another, both
        are seen with nearly the same error of light, lens and background, and only their difference counts.
    """
    fit = calibration.fit
    rail, count = fit.regression[axis], len(fit.regression) - 1
    # The play is along the rail and nowhere else, so what is seen badly (depth) hardly counts.
    weight = np.linalg.solve(fit.noise, rail)
    along = weight / float(weight @ rail)
    ahead = [
        (above.tip - below.tip - (above.reading - below.reading)[:count] @ fit.regression[:-1]) @ along
        for below, above in pairs
    ]
    scatter = [along @ (below.covariance + above.covariance) @ along for below, above in pairs]
    # All pairs of an axis stand at the same edge of the picture: half of the error there is taken as theirs together,
    # which their number does not reduce.
    one = 2.0 * float(along @ fit.noise @ along) * (1.0 - (_ALIKE if calibration.on_carriage else 0.0))
    variance = one * (0.5 + 0.5 / len(pairs)) + float(np.mean(scatter)) / len(pairs)
    scale = float(np.linalg.norm(calibration.base_from_reading[:, axis]))
    return Backlash(play_m=float(np.mean(ahead)) * scale, sigma_m=float(np.sqrt(variance)) * scale, places=len(pairs))
