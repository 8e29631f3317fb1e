"""The calibration in use: taken up once it fits the conditions, withdrawn when it no longer does, checked for drift."""

from __future__ import annotations

from typing import Any

import numpy as np

from harris_perception.core.hand_eye.calibration_file import CalibrationFileError, StoredCalibration
from harris_perception.core.hand_eye.carriage_camera import PanelSample
from harris_perception.core.hand_eye.drift import DriftWatch
from harris_perception.core.hand_eye.hand_eye import HandEye
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.hand_eye_procedure.calibrator_actions import (
    Action,
    LogNote,
    SetAxes,
    SetPose,
    SetSigma,
    StateText,
)
from harris_perception.core.hand_eye_procedure.calibrator_config import CalibratorConfig
from harris_perception.core.hand_eye_procedure.conditions import Conditions
from harris_perception.core.hand_eye_procedure.still_watch import StillWatch
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message
from icu_common.core.reasons.state_text import because


class CalibrationInUse:
    """See the module's text. ``running`` is true while a run is active; calls return the actions to carry out."""

    def __init__(self, config: CalibratorConfig, conditions: Conditions, state: StateText) -> None:
        self._config, self._conditions, self._state = config, conditions, state
        self.stored: StoredCalibration | None = None
        self.drift: DriftWatch | None = None
        self._solved: HandEye | None = None
        # A calibration from the file, or a withdrawn one: used as soon as it fits. And the reported reason why it does
        # not fit.
        self._loaded: StoredCalibration | None = None
        self._refused = ""
        self._looked_ns = [0, 0]

    def configure(self, config: CalibratorConfig, now_ns: int, *, running: bool) -> list[Action]:
        """Apply new settings."""
        self._config = config
        actions: list[Action] = []
        if self.stored is not None and self.drift is not None and self.drift.config != config.drift:
            told, self.drift = self.drift.text, DriftWatch(config.drift, self.stored)
            if told and not running:
                actions += self._state.set(because("calibrated", self.stored.summary()))
        return actions + self.check(now_ns, running=running)

    def offer(self, loaded: StoredCalibration) -> list[Action]:
        """Offer the calibration from the file; it is used once the cameras are known."""
        self._loaded = loaded
        return self._state.set(
            because(
                "uncalibrated",
                Message("calibration.waiting_camera_info_check_calibration"),
            )
        )

    def use(self, calibration: StoredCalibration, solved: HandEye | None, now_ns: int) -> list[Action]:
        """Use this calibration; ``solved`` is its solution, unless it is from the file."""
        self.stored, self._solved = calibration, solved
        self._loaded, self._refused = None, ""
        self.drift = DriftWatch(self._config.drift, calibration)
        return [
            SetSigma(calibration.sigma_m),
            SetAxes(calibration.base_from_reading),
            *self._pose(calibration, now_ns),
            *self._state.set(because("calibrated", calibration.summary())),
        ]

    def follow_carriage(self, stamp_ns: int) -> list[Action]:
        """Publish the pose of cameras on the carriage, which has moved."""
        return self._pose(self.stored, stamp_ns) if self.stored is not None and self.stored.on_carriage else []

    def _pose(self, calibration: StoredCalibration, stamp_ns: int) -> list[Action]:
        """Publish the present pose of base_link; with cameras on the carriage it changes with every reading."""
        reading = self._conditions.reading
        if calibration.on_carriage and reading is None:
            return []
        reading = np.zeros(3) if reading is None else reading
        return [SetPose(calibration.camera_from_base_at(reading), stamp_ns)]

    def withdraw(self, why: str) -> list[Action]:
        """Withdraw the calibration until it fits again: without axes the controller touches nothing."""
        if self.stored is None:
            return []
        self._loaded, self._refused = self.stored, why
        self.stored, self._solved, self.drift = None, None, None
        reason = Message("calibration.calibration_use_refused", why=why)
        return [
            SetAxes(None),
            LogNote("error", reason),
            *self._state.set(because("failed", reason)),
        ]

    def check(self, now_ns: int, *, running: bool) -> list[Action]:
        """Check again whether the calibration in use, or else the waiting one, fits the conditions."""
        return self._check_loaded(now_ns, running) if self.stored is None else self._check_used(self.stored)

    def _check_used(self, used: StoredCalibration) -> list[Action]:
        """Reject the calibration in use if the camera, the resolution or the machine's settings have changed."""
        if "left" not in self._conditions.cameras:
            return []
        try:
            self._conditions.check_fit(used, self._config)
        except CalibrationFileError as error:
            return self.withdraw(str(error))
        return []

    def _check_loaded(self, now_ns: int, running: bool) -> list[Action]:
        """Use the calibration from the file, or the withdrawn one, once it fits the cameras and no run is active."""
        loaded, cameras = self._loaded, self._conditions.cameras
        if loaded is None or "left" not in cameras or running:
            return []
        if "right" not in cameras and loaded.right is not None:
            return []
        try:
            self._conditions.check_fit(loaded, self._config)
        except CalibrationFileError as error:
            # Reported once: a later report, for example of a run, is newer.
            if str(error) == self._refused:
                return []
            self._refused = str(error)
            reason = Message("calibration.stored_calibration_refused", error=error)
            return [LogNote("error", reason), *self._state.set(because("failed", reason))]
        return self.use(loaded, None, now_ns)

    def drifted(self, *, running: bool) -> str:
        """Return the parts that are off their expected positions; not monitored during a run."""
        looked = self.stored is not None and not running and self._conditions.reading is not None
        return self.drift.text if self.drift is not None and looked else ""

    def look_around(self, watch: StillWatch, controls: dict[str, Array], now_ns: int, *, running: bool) -> list[Action]:
        """Check tip and panel while nothing moves; report when drift starts or ends."""
        if self.drift is None or self.stored is None or running or self._conditions.reading is None:
            return []
        before = self.drift.off
        # Sightings that were already checked do not count again. A stamp in the future precedes a step back of the
        # clock.
        tips_ns, panels_ns = (stamp if stamp <= now_ns else 0 for stamp in self._looked_ns)
        sample, panel = watch.sample(now_ns, tips_ns), watch.panel_sample(now_ns, panels_ns)
        if isinstance(sample, Sample):
            self._looked_ns[0] = watch.newest_ns[0]
            self.drift.tip(sample)
        if isinstance(panel, PanelSample):
            self._looked_ns[1] = watch.newest_ns[1]
            base_from_camera = self.stored.camera_from_base_at(panel.reading).inverse()
            self.drift.panel(base_from_camera @ panel.camera_from_panel, controls)
        text = self.drift.text
        if self.drift.off == before:
            return []
        note = LogNote("warn", text) if text else LogNote("info", Message("drift.none_any_more"))
        summary = self.stored.summary()
        return [
            note,
            *self._state.set(
                because("calibrated", Message("calibration.drifted", summary=summary, drift=text) if text else summary)
            ),
        ]

    def values(self, *, running: bool) -> list[tuple[str, Any]]:
        """Return the values for the diagnostics."""
        values: list[tuple[str, Any]] = []
        if self.stored is not None:
            values += self.stored.values()
        if self._solved is not None:
            values.append(("chi_square_per_freedom", f"{self._solved.fit.variance_factor:.2f}"))
        if self.drift is not None:
            drifted = self.drifted(running=running)
            values += [("tip_off_mm", f"{self.drift.tip_m * 1e3:.3f}"), ("drift", drifted or "none")]
            values.append(("control_off_mm", f"{self.drift.control_m * 1e3:.3f}"))
        return values
