"""Measures a constant offset of the right camera's stamps from the motion of the ball in both cameras.

A point has the same rectified row in both images. While the ball moves along the columns, a right image with a late
stamp shows an earlier position: the rows differ by velocity times offset. A regression of row difference on velocity
gives the offset; its constant term is the misalignment of the cameras.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

_SAMPLES = 300
_FEWEST = 12
_LEAST_PX_S = 15.0
"""Minimum speed along the columns; slower motion has no information, and a ball at rest would fill the record."""
_OUTLIER = 3.0
_LEAST_ROW_PX = 0.05
"""Lower limit of the error of a pair's row difference."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Offset:
    """Delay of the right stamps relative to the left camera's clock, its standard deviation, and number of samples."""

    late_s: float = 0.0
    sigma_s: float = math.inf
    samples: int = 0


class OffsetEstimator:
    """Collects row differences and velocities of a moving ball; times are the cameras' own stamps."""

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque(maxlen=_SAMPLES)
        self._rest: deque[float] = deque(maxlen=_SAMPLES)

    def add(self, row_difference_px: float, velocity_px_s: float) -> None:
        """Add a pair: left minus right row at the instant of the left stamp, and the ball's downward velocity."""
        if abs(velocity_px_s) >= _LEAST_PX_S:
            self._samples.append((velocity_px_s, row_difference_px))
        else:
            self._rest.append(row_difference_px)

    def estimate(self) -> Offset:
        """Return the offset; its sigma is infinite until enough motion has been seen."""
        if len(self._samples) < _FEWEST:
            return Offset(samples=len(self._samples))
        velocity, rows = np.array(self._samples).T
        use = np.ones(len(rows), bool)
        for _ in range(3):
            design = np.column_stack([velocity[use], np.ones(int(use.sum()))])
            slope, constant = np.linalg.lstsq(design, rows[use], rcond=None)[0]
            misfit = rows - slope * velocity - constant
            scale = max(1.4826 * float(np.median(np.abs(misfit[use]))), _LEAST_ROW_PX)
            use = np.abs(misfit) <= _OUTLIER * scale
            if int(use.sum()) < _FEWEST:
                return Offset(samples=int(use.sum()))
        spread = float(np.sum((velocity[use] - velocity[use].mean()) ** 2))
        sigma = scale / math.sqrt(spread) if spread > 0 else math.inf
        return Offset(late_s=float(slope), sigma_s=sigma, samples=int(use.sum()))
