"""Heights from looks and touches since the calibration."""

from __future__ import annotations

import math

from gantry_driver.core.contact.config import ContactConfig
from gantry_driver.core.contact.heights import HeightEstimate, HeightFinding, HeightFindingCode

KEY_STROKE_M = 0.0015
KEY_STROKE_SIGMA_M = 0.001
"""Usual stroke of a key and its standard deviation, before the key has been pressed."""
END_SPARE_M = 0.0005
"""Additional compression of the spring at the end of a press of a known key, in metres."""


class HeightMemory:
    """The stylus's offset from its readings, and for each control the depth of its stop below its expected top."""

    def __init__(self, config: ContactConfig) -> None:
        self.config = config
        self.forget()

    def forget(self, correction_m: float = 0.0) -> None:
        """Start again, after a calibration that was made with this part of heights due to a corrected camera."""
        height = self.config.height
        self._correction_m = correction_m
        self.stylus = HeightEstimate(
            code=HeightFindingCode.STYLUS_OFFSET, sigma_m=height.start_sigma_m, drift_m=height.drift_sigma_m
        )
        self._ends: dict[tuple[str, bool], HeightEstimate] = {}

    def end(self, control: str, key: bool) -> HeightEstimate:
        """Return the estimated depth below its expected top where a control stops the ball; a key gives way first."""
        if (known := self._ends.get((control, key))) is not None:
            return known
        height = self.config.height
        return self._ends.setdefault(
            (control, key),
            HeightEstimate(
                code=HeightFindingCode.PANEL_DEPTH,
                value_m=KEY_STROKE_M if key else 0.0,
                sigma_m=KEY_STROKE_SIGMA_M if key else height.start_sigma_m,
                drift_m=height.drift_sigma_m,
            ),
        )

    def travel_m(self, control: str, key: bool, usual_m: float) -> float:
        """Return the first travel of a press: to where the control stopped the last one, else ``usual_m``."""
        end = self.end(control, key)
        if not end.measured:
            return usual_m
        known_m = end.value_m + self.config.lag_m + END_SPARE_M
        return min(max(known_m, usual_m if not key else 0.0), self.config.max_travel_m)

    def looked(self, offset_m: float, sigma_m: float, correction_m: float | None = None) -> HeightFinding | None:
        """Take a ball that is seen ``offset_m`` above the height of its reading.

        A camera's correction changes seen heights by ``correction_m``. When it changes, the stylus has not moved, so
        such a difference is expected. None: as before.
        """
        if correction_m is not None:
            self.stylus.sigma_m = math.hypot(self.stylus.sigma_m, correction_m - self._correction_m)
            self._correction_m = correction_m
        return self.stylus.take(offset_m, math.hypot(sigma_m, self.config.height.look_sigma_m))

    def touched(self, control: str, key: bool, end_m: float, sigma_m: float) -> HeightFinding | None:
        """Take a control that stopped the ball ``end_m`` below its expected top."""
        return self.end(control, key).take(end_m, math.hypot(sigma_m, self.config.height.panel_sigma_m))
