"""Tips that the tracker has measured with different corrections of the right camera, converted to one of them.

The stylus tracker corrects the rotation of the right camera. If this correction begins or changes during a calibration,
tips before and after it differ by up to a millimetre, as if they were from two pairs of cameras.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from harris_perception.core.hand_eye.tip_samples import Sample
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array


class PairCorrections:
    """Stores the corrections with their stamps.

    Parameters
    ----------
    cameras
        The pair as its calibration files describe it.
    """

    def __init__(self, cameras: StereoModel) -> None:
        self._baseline_m = cameras.baseline
        self._turns: list[tuple[int, Array]] = []

    def take(self, stamp_ns: int, rotation_rad: Array) -> None:
        """Add the rotation vector (3,) rad by which images after ``stamp_ns`` are corrected."""
        if not self._turns or not np.array_equal(self._turns[-1][1], rotation_rad):
            self._turns.append((stamp_ns, np.array(rotation_rad, dtype=np.float64)))

    def neutral(self, stamp_ns: int, tip: Array) -> Array:
        """Return the tip (3,) m of ``stamp_ns`` as measured without its correction."""
        before = [rotation for since_ns, rotation in self._turns if since_ns < stamp_ns]
        return self._turned(tip, -before[-1]) if before else tip

    def newest(self, tip: Array) -> Array:
        """Return a tip (3,) m of :meth:`neutral` as measured with the newest correction."""
        return self._turned(tip, self._turns[-1][1]) if self._turns else tip

    def corrected(self, sample: Sample) -> Sample:
        """Return a sample of neutral tips with the newest correction; its covariance hardly changes."""
        return replace(sample, tip=self.newest(sample.tip))

    def _turned(self, tip: Array, rotation_rad: Array) -> Array:
        """Triangulate the tip again with the right line of sight rotated; its row is the mean of both images' rows."""
        left = tip / tip[2]
        right = np.asarray(cv2.Rodrigues(rotation_rad)[0] @ (tip - (self._baseline_m, 0.0, 0.0)), dtype=np.float64)
        right = right / right[2]
        depth_m = self._baseline_m / float(left[0] - right[0])
        return depth_m * np.array([left[0], 0.5 * (left[1] + right[1]), 1.0])
