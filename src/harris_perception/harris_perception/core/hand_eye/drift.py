"""Monitors a calibration in use: compares the tip and each control with their expected positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from harris_perception.core.hand_eye.calibration_file import StoredCalibration
from harris_perception.core.hand_eye.tip_samples import Sample
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.reasons.message import Message, joined


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftConfig(Config):
    """Limits beyond which a position counts as drifted."""

    max_tip_m: float = setting(
        0.0008,
        "Maximum distance between the tip and its calibrated position; backlash alone reaches some tenths of "
        "a millimetre",
        minimum=1e-5,
        maximum=0.1,
        unit="m",
    )
    max_control_m: float = setting(
        0.0015,
        "Maximum distance between a control and its position at the calibration",
        minimum=1e-5,
        maximum=0.5,
        unit="m",
    )
    times: int = setting(
        3, "Number of successive measurements beyond the limit before drift is reported", minimum=1, maximum=100
    )


class DriftWatch:
    """Compares measurements at rest with a calibration.

    Parameters
    ----------
    config
        Limits.
    calibration
        Calibration in use. The controls are expected relative to its ``base_from_panel``, or else to the first panel
        seen.
    """

    def __init__(self, config: DriftConfig, calibration: StoredCalibration) -> None:
        self.config, self._calibration = config, calibration
        self._panel = calibration.base_from_panel
        self._tips_off = self._panels_off = 0
        self.tip_m = float("nan")
        self.control_m = float("nan")
        self._control = ""

    def tip(self, sample: Sample) -> None:
        """Add a sighting of the tip at rest."""
        expected = self._calibration.tip_in_camera(sample.reading)
        self.tip_m = float(np.linalg.norm(sample.tip - expected))
        self._tips_off = self._tips_off + 1 if self.tip_m > self.config.max_tip_m else 0

    def panel(self, base_from_panel: Transform, controls: dict[str, Array]) -> None:
        """Add a pose of the panel at rest and its controls' positions (3,) m in panel_link."""
        if self._panel is None:
            self._panel = base_from_panel
        names = list(controls) or [Message("drift.panel_corner")]
        places = np.array(list(controls.values())) if controls else np.zeros((1, 3))
        off = np.linalg.norm(base_from_panel.apply(places) - self._panel.apply(places), axis=1)
        worst = int(np.argmax(off))
        self.control_m, self._control = float(off[worst]), names[worst]
        self._panels_off = self._panels_off + 1 if self.control_m > self.config.max_control_m else 0

    @property
    def off(self) -> tuple[bool, bool]:
        """Whether the tip, and whether the panel, is off its expected position."""
        return self._tips_off >= self.config.times, self._panels_off >= self.config.times

    @property
    def text(self) -> str:
        """Description of the drift and its meaning, for people; empty without drift."""
        tip, panel = self.off
        parts = []
        if tip:
            parts.append(Message("drift.tip_seen_calibrated_place", tip_mm=self.tip_m * 1000.0))
        if panel:
            parts.append(
                Message("drift.seen_place_calibration", control=self._control, control_mm=self.control_m * 1000.0)
            )
        if not parts:
            return ""
        advice = (
            Message("drift.camera_machine_moved_calibrate_again")
            if tip
            else Message("drift.panel_moved_camera_look_calibrate")
        )
        return Message("text.more", first=joined(parts, "text.both"), second=advice)
