"""Settings of a calibration, and the parameters of a camera that they have estimated."""

from __future__ import annotations

from dataclasses import dataclass

import cv2

from icu_common.core.configuration.config import Config, setting

INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
ANY_RMS_PX = 1e5
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig(Config):
    """Settings of a calibration."""

    radial_terms: int = setting(
        2,
        "Number of radial distortion terms to estimate; the third is useful only for wide lenses",
        minimum=1,
        maximum=3,
    )
    min_views: int = setting(5, "Minimum number of views that show the board", minimum=3, maximum=100)
    outlier_factor: float = setting(
        2.0,
        "Ratio of a view's rms error to the median of all views, above which the view is an outlier",
        minimum=1.1,
        maximum=20.0,
    )
    drop_outliers: bool = setting(False, "Remove outliers and calibrate again")
    max_rms_px: float = setting(3.0, "Maximum accepted rms error", minimum=0.01, maximum=ANY_RMS_PX, unit="px")
    alpha: float = setting(
        0.0,
        "Field of the rectified image: 0 shows only valid pixels, 1 keeps every pixel of the raw image",
        minimum=0.0,
        maximum=1.0,
    )


def solver_flags(config: CalibrationConfig) -> int:
    """Return OpenCV's flags for the distortion terms that are not estimated."""
    fixed = (0, cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3, cv2.CALIB_FIX_K3, 0)
    return int(fixed[config.radial_terms])


def estimated(config: CalibrationConfig) -> list[int]:
    """Return the indices of the INTRINSICS to estimate."""
    left_alone = {1: (5, 8), 2: (8,), 3: ()}[config.radial_terms]
    return [i for i in range(len(INTRINSICS)) if i not in left_alone]
