"""Comparison of the stylus's lowering with the measured motion of its tip."""

from __future__ import annotations

import numpy as np

from harris_perception.core.hand_eye_procedure.calibration_tour import CalibrationStop
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message

_WRONG_WAYS = 2
"""Number of successive wrong lowering distances that indicate a faulty stylus, not a wrong sighting."""


class LoweringCheck:
    """Detects a stylus that moves by another distance than ordered; the complete fit would detect it only at the end.

    Parameters
    ----------
    max_scale_error
        Maximum relative error of the lowering.
    max_error_m
        Maximum error that does not grow with the lowering.
    """

    def __init__(self, max_scale_error: float, max_error_m: float) -> None:
        self._max_scale_error, self._max_error_m = max_scale_error, max_error_m
        self._upper: tuple[CalibrationStop, Array] | None = None
        self._wrong_ways = 0

    def fault(self, stop: CalibrationStop, tip: Array) -> str:
        """Compare the tip (3,) m at a stop with that at the previous one; return the fault, or an empty text."""
        (above, before), self._upper = self._upper or (stop, tip), (stop, tip)
        way_m = above.z - stop.z
        if (above.x, above.y) != (stop.x, stop.y) or way_m <= 0:
            return ""
        seen_m = float(np.linalg.norm(tip - before))
        allowed_m = self._max_scale_error * way_m + self._max_error_m
        self._wrong_ways = self._wrong_ways + 1 if abs(seen_m - way_m) > allowed_m else 0
        if self._wrong_ways < _WRONG_WAYS:
            return ""
        return Message("calibration.lowered_tip_moved_check_stylus", way_mm=way_m * 1000.0, seen_mm=seen_m * 1000.0)
