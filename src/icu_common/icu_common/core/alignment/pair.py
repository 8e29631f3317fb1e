"""Measured rotation of the right camera relative to its calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from icu_common.core.geometry.geometry import Array


class PairCode(str, Enum):
    """State of the pair."""

    UNKNOWN = "unknown"
    """Not measured yet."""
    ALIGNED = "aligned"
    """No significant rotation."""
    CORRECTED = "corrected"
    """The right camera has rotated; the measurement of the tip corrects the rotation."""
    CHANGING = "changing"
    """The newest measurement differs from the previous ones and is not confirmed yet."""
    MOVED = "moved"
    """The right camera has rotated by more than may be corrected without a new calibration."""

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PairState:
    """Rotation of the right camera.

    Attributes
    ----------
    code
        See :class:`PairCode`.
    rotation_rad
        (3,) rotation vector relative to the calibration in the rectified right frame: pitch, yaw, roll.
    sigma_rad
        (3,) standard deviations; infinite before the first measurement.
    turn_deg
        Angle of pitch and yaw since the last calibration.
    limit_deg
        Angle up to which the rotation is corrected.
    focal_px, baseline_m
        Focal length of the rectified images, and distance between the cameras.
    stamp_ns
        Stamp of the newest measured pair, 0 before the first.

    Raises
    ------
    ValueError
        If a value is invalid for a rotation.
    """

    code: PairCode = PairCode.UNKNOWN
    rotation_rad: Array = field(default_factory=lambda: np.zeros(3))
    sigma_rad: Array = field(default_factory=lambda: np.full(3, np.inf))
    turn_deg: float = 0.0
    limit_deg: float = 0.0
    focal_px: float = 1.0
    baseline_m: float = 1.0
    stamp_ns: int = 0

    def __post_init__(self) -> None:
        rotation, sigma = np.asarray(self.rotation_rad), np.asarray(self.sigma_rad)
        if rotation.shape != (3,) or not np.abs(rotation).max() < 1.0:
            raise ValueError(f"rotation {rotation.tolist()} rad: expected three angles below 1 rad")
        if sigma.shape != (3,) or not sigma.min() >= 0:
            raise ValueError(f"standard deviations {sigma.tolist()} rad: expected three values of at least 0")
        if not (self.focal_px > 0 and self.baseline_m > 0 and math.isfinite(self.turn_deg)):
            raise ValueError(f"focal length {self.focal_px} px, baseline {self.baseline_m} m, turn {self.turn_deg} deg")

    @property
    def turn_px(self) -> float:
        """Shift of the middle of the right image by pitch and yaw since the last calibration, px."""
        return self.focal_px * math.radians(self.turn_deg)

    @property
    def known(self) -> bool:
        """Whether the rotation has been measured and repeats."""
        return self.code not in (PairCode.UNKNOWN, PairCode.CHANGING)
