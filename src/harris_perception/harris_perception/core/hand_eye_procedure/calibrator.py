"""State and decisions of the hand-eye node: events and time in, actions out; no ROS, no clock, no file.

Samples, contacts and a calibration are valid only while cameras, machine settings and readings are those with which
they were made. Events that invalidate them come in any order, also during a run, and are therefore judged in one
method.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import datetime, timezone
from typing import Any

import numpy as np

from harris_perception.core.hand_eye.calibration_file import StoredCalibration
from harris_perception.core.hand_eye.carriage_camera import (
    MAX_CONTACTS,
    Contact,
    PanelSample,
    calibrate_on_carriage,
    stylus_offset,
)
from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.hand_eye.drift import DriftWatch
from harris_perception.core.hand_eye.hand_eye import HandEye, calibrate
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.hand_eye_procedure import calibration_run
from harris_perception.core.hand_eye_procedure.calibration_in_use import CalibrationInUse
from harris_perception.core.hand_eye_procedure.calibration_plan import check_plan, corners
from harris_perception.core.hand_eye_procedure.calibration_run import CalibrationRun, Progress, SendCalibrationGoal
from harris_perception.core.hand_eye_procedure.calibration_solution import CalibrationFailed, CalibrationFinished
from harris_perception.core.hand_eye_procedure.calibrator_actions import Action, Keep, LogNote, StateText
from harris_perception.core.hand_eye_procedure.calibrator_config import CalibratorConfig
from harris_perception.core.hand_eye_procedure.conditions import CalibrationRefused, Conditions
from harris_perception.core.hand_eye_procedure.still_watch import NO_READINGS, StillWatch
from harris_perception.core.pose.planar_pose import FacePoints
from harris_perception.core.stereo.pairing import Pairing
from icu_common.core.alignment.pair import PairCode, PairState
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.frames import PANEL
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult
from icu_common.core.reasons.message import Message, quoted
from icu_common.core.reasons.state_text import as_message, because, state_name


class Calibrator:
    """See the module's text. Every call returns the actions to carry out, in order; times are ROS time."""

    def __init__(self, config: CalibratorConfig) -> None:
        self.config = config
        self.watch = StillWatch(config.still)
        self.driver = "unknown"
        self.samples: list[Sample] = []
        self.panels: list[PanelSample] = []
        self.contacts: list[Contact] = []
        self.sightings = Pairing(2)
        self._state = StateText()
        self._conditions = Conditions()
        self._in_use = CalibrationInUse(config, self._conditions, self._state)
        self._run: CalibrationRun | None = None
        self._progress = Progress(0, 0, remaining_s=0.0)
        self._panel: Transform | None = None
        self._controls: dict[str, Array] = {}
        self._pair: tuple[int, Array] | None = None

    @property
    def state(self) -> str:
        """State, as text."""
        return self._state.text

    @property
    def stored(self) -> StoredCalibration | None:
        """Calibration in use."""
        return self._in_use.stored

    @property
    def drift(self) -> DriftWatch | None:
        """Comparison of the calibration in use with later measurements."""
        return self._in_use.drift

    @property
    def cameras(self) -> Mapping[str, CameraModel]:
        """Known cameras, by side."""
        return self._conditions.cameras

    @property
    def reading(self) -> Array | None:
        """Newest readings (3,) m."""
        return self._conditions.reading

    @property
    def running(self) -> bool:
        """Whether a run is active."""
        return self._run is not None

    @property
    def _on_carriage(self) -> bool:
        return self.config.run.mounting == "carriage"

    def configure(self, config: CalibratorConfig, now_ns: int) -> list[Action]:
        """Apply new settings."""
        self.config, self.watch = config, StillWatch(config.still)
        return self._in_use.configure(config, now_ns, running=self.running)

    def _check(self, now_ns: int) -> list[Action]:
        return self._in_use.check(now_ns, running=self.running)

    def close(self) -> list[Action]:
        """Report that a run was interrupted; the controller finishes its goal and then rests."""
        return self._fail_run(Message("calibration.hand_eye_node_stopped"))

    # Events.

    def offer(self, loaded: StoredCalibration) -> list[Action]:
        """Offer the calibration from the file; it is used once the cameras are known."""
        return self._in_use.offer(loaded)

    def reject_file(self, reason: str) -> list[Action]:
        """Record that the file cannot be read."""
        return [LogNote("error", reason), *self._state.set(because("failed", reason))]

    def take_camera(self, side: str, camera: CameraModel, now_ns: int) -> list[Action]:
        """Set a camera that is new or has changed."""
        actions = []
        if side in self._conditions.cameras:
            actions = self._forget_seen(Message("calibration.camera_calibration_changed_meanwhile", side=side))
        self._conditions.cameras[side] = camera
        return actions + self._check(now_ns)

    def lose_camera(self, side: str, width: int, height: int) -> list[Action]:
        """Stop using calibrations with a camera that has been replaced by an unknown one."""
        if self._conditions.cameras.pop(side, None) is None:
            return []
        why = Message("calibration.camera_pictures_no_calibration", side=side, width=width, height_px=height)
        actions = self._forget_seen(why)
        return actions + self._in_use.withdraw(why)

    def _forget_seen(self, why: str) -> list[Action]:
        """Discard sightings of a camera that has changed; they cannot be combined with those of another camera."""
        self.samples.clear()
        self.panels.clear()
        self.watch.forget()
        self.sightings.clear()
        self._panel = None
        return self._fail_run(why)

    def take_reading(self, stamp_ns: int, reading: Array) -> list[Action]:
        """Add the readings (3,) m."""
        before = self._conditions.reading
        moved = before is None or bool(np.abs(reading - before).max() > 0)
        self._conditions.reading = reading
        actions = self._in_use.follow_carriage(stamp_ns) if moved else []
        self.watch.reading(stamp_ns, reading)
        if self._run is not None:
            self._run.reading(stamp_ns, reading)
        return actions

    def take_tip(self, stamp_ns: int, tip: Array, now_ns: int) -> list[Action]:
        """Add a finite tip (3,) m in the left camera's frame."""
        self.watch.tip(stamp_ns, tip)
        return [] if self._run is None else self._follow(self._run.tip(stamp_ns, tip, now_ns), now_ns)

    def take_unseen(self, stamp_ns: int, now_ns: int) -> list[Action]:
        """Record that the tip was not found in the images of that stamp."""
        return [] if self._run is None else self._follow(self._run.tip(stamp_ns, None, now_ns), now_ns)

    def take_image(self, stamp_ns: int, now_ns: int) -> list[Action]:
        """Record that the cameras have taken an image, which counts during a run."""
        return [] if self._run is None else self._follow(self._run.image(stamp_ns, now_ns), now_ns)

    def take_panel(self, stamp_ns: int, pose: Transform, now_ns: int) -> list[Action]:
        """Add camera_from_panel."""
        self._panel = pose
        self._inform_run()
        if self._on_carriage:
            return self._take_sighting(self.sightings.add(0, stamp_ns, (stamp_ns, pose)), now_ns)
        self.watch.panel(stamp_ns, pose, FacePoints.joined([]))
        return []

    def take_points(self, stamp_ns: int, points: FacePoints, now_ns: int) -> list[Action]:
        """Add the points measured for the panel's pose of that stamp."""
        return self._take_sighting(self.sightings.add(1, stamp_ns, points), now_ns)

    def _take_sighting(self, sighting: tuple[Any, ...] | None, now_ns: int) -> list[Action]:
        """Process a pose and its points, once both have arrived."""
        if sighting is None:
            return []
        (stamp, pose), points = sighting
        self.watch.panel(stamp, pose, points)
        return [] if self._run is None else self._follow(self._run.panel(stamp, pose, points, now_ns), now_ns)

    def take_pair(self, state: PairState) -> None:
        """Set the rotation of the right camera, which the stylus tracker corrects once it is known."""
        if state.code is not PairCode.CHANGING:
            self._pair = state.stamp_ns, state.rotation_rad
            self._inform_run()

    def take_controls(self, controls: dict[str, Array]) -> None:
        """Set the controls' positions (3,) m in panel_link, by name."""
        self._controls = controls
        self._inform_run()

    def _inform_run(self) -> None:
        if self._run is None:
            return
        tallest = max((float(place[2]) for place in self._controls.values()), default=0.0)
        self._run.keep_clear_of(self._panel, tallest + self.config.ball_radius_m)
        if self._pair is not None:
            self._run.pair(*self._pair)

    def take_settings(self, text: str, now_ns: int) -> list[Action]:
        """Set the board's settings."""
        self._conditions.settings = text
        return self._check(now_ns)

    def take_contact(self, point: Array, frame: str, now_ns: int) -> list[Action]:
        """Store a contact of the stylus with this point (3,) m of the panel at the present readings."""
        if frame != PANEL or not np.isfinite(point).all():
            why: str = Message(
                "calibration.finite_point_needed", point=point.tolist(), frame=quoted(frame), panel=quoted(PANEL)
            )
        elif (reading := self._conditions.reading) is None:
            why = NO_READINGS
        elif unrest := self.watch.unrest(now_ns):
            why = unrest
        elif self._run is not None:
            why = Message("calibration.calibration_running")
        elif len(self.contacts) >= MAX_CONTACTS:
            why = Message("calibration.already_solve", max_contacts=MAX_CONTACTS)
        else:
            ball = np.array([0.0, 0.0, self.config.ball_radius_m])
            self.contacts.append(Contact(reading=reading, in_panel=point + ball))
            x, y, _ = point
            return [LogNote("info", f"contact {len(self.contacts)} at {x:.4f}, {y:.4f} m of the panel")]
        return [LogNote("error", f"contact refused: {why}")]

    def take_driver(self, text: str, now_ns: int) -> list[Action]:
        """Set the driver's state."""
        self.driver = text
        if text == "homing":
            # Readings restart from zero; collected samples belong to the previous readings.
            for kept in (self.samples, self.panels, self.contacts):
                kept.clear()
        return [] if self._run is None else self._follow(self._run.driver_state(text), now_ns)

    def take_result(self, result: GoalResult, now_ns: int) -> list[Action]:
        """Process a result from the controller, which counts during a run."""
        return [] if self._run is None else self._follow(self._run.result(result, now_ns), now_ns)

    def tick(self, now_ns: int) -> list[Action]:
        """Process time-outs."""
        return [] if self._run is None else self._follow(self._run.tick(now_ns), now_ns)

    # Requests; they raise CalibrationRefused.

    def run(self, now_ns: int) -> list[Action]:
        """Start a calibration."""
        if self._run is not None:
            raise CalibrationRefused(Message("calibration.calibration_already_running"))
        if state_name(self.driver) != "idle":
            driver = quoted(as_message(self.driver))
            raise CalibrationRefused(Message("calibration.driver_says_connected_homed_idle", driver=driver))
        cameras, config = self._conditions.pair(), self.config
        try:
            check_plan(config.run, config.solver)
        except DegenerateError as error:
            raise CalibrationRefused(Message("calibration.run_places_not_tell_calibration", error=error)) from error
        self.samples.clear()
        self.panels.clear()
        # The controller still converts goals into readings with the calibration that it has.
        axes = None if self.stored is None else self.stored.base_from_reading
        self._run = CalibrationRun(config.run, config.still, config.solver, cameras, now_ns, axes, tuple(self.contacts))
        self._inform_run()
        return self._follow(self._run.start(now_ns), now_ns)

    def add_sample(self, now_ns: int) -> str:
        """Add a sample of the tip, or the panel, at the present position; return a description for people."""
        if self._run is not None:
            raise CalibrationRefused(Message("calibration.calibration_running"))
        sample = self.watch.sample(now_ns)
        if self._on_carriage:
            panel = self.watch.panel_sample(now_ns)
            if isinstance(panel, str):
                raise CalibrationRefused(panel)
            self.panels.append(panel)
            reading, count = panel.reading, len(self.panels)
        if isinstance(sample, Sample):
            self.samples.append(sample)
            reading, count = sample.reading, max(len(self.samples), len(self.panels))
        elif not self._on_carriage:
            raise CalibrationRefused(sample)
        x, y, stylus = reading * 1e3
        return Message("calibration.sample_readings_stylus", count=count, x=x, y=y, stylus_mm=stylus)

    def solve(self, now_ns: int) -> list[Action]:
        """Calibrate from the added samples."""
        if self._run is not None:
            raise CalibrationRefused(Message("calibration.calibration_running"))
        cameras, solver = self._conditions.pair(), self.config.solver
        try:
            if self._on_carriage:
                solved = calibrate_on_carriage(self.panels, self.samples, cameras, self.contacts, solver)
            else:
                solved = calibrate(self.samples, cameras, solver)
        except DegenerateError as error:
            raise CalibrationRefused(str(error)) from error
        found = self._describe(solved, np.empty(0), np.full((2, 2), np.nan), now_ns)
        self.contacts.clear()
        return self._in_use.use(found, solved, now_ns)

    # A run and its results.

    def _follow(self, events: Iterable[calibration_run.Action], now_ns: int) -> list[Action]:
        actions: list[Action] = []
        for event in events:
            if isinstance(event, SendCalibrationGoal):
                actions.append(event)
            elif isinstance(event, Progress):
                self._progress = event
                values = {"done": event.done, "total": event.total, "remaining_s": event.remaining_s}
                reason = Message("calibration.part", **values)
                if event.note:
                    reason = Message("calibration.part_with_note", **values, note=event.note)
                text = Message("calibration.progress", reason=reason)
                actions += self._state.set(text)
            elif isinstance(event, CalibrationFailed):
                actions += self._fail_run(event.reason)
            else:
                actions += self._finish(event, now_ns)
        return actions

    def _fail_run(self, reason: str) -> list[Action]:
        if self._run is None:
            return []
        self._run = None
        return [
            LogNote("error", Message("calibration.failed", reason=reason)),
            *self._state.set(because("failed", reason)),
        ]

    def _finish(self, event: CalibrationFinished, now_ns: int) -> list[Action]:
        self._run = None
        plays = [(float("nan"), float("nan")) if b is None else (b.play_m, b.sigma_m) for b in event.backlash]
        found = self._describe(event.calibration, event.held_out_m, np.array(plays), now_ns)
        self.contacts.clear()
        return [*self._in_use.use(found, event.calibration, now_ns), Keep()]

    def _describe(self, solved: HandEye, held_out_m: Array, plays_m: Array, now_ns: int) -> StoredCalibration:
        """Return the values to store."""
        offset = np.full(3, np.nan)
        camera_from_panel = solved.camera_from_panel if solved.on_carriage else self._panel
        if camera_from_panel is not None and self.contacts:
            offset = stylus_offset(solved, camera_from_panel, self.contacts, self.config.solver).offset
        panel = None if camera_from_panel is None else solved.camera_from_base.inverse() @ camera_from_panel
        return StoredCalibration(
            settings=self._conditions.settings,
            mounting="carriage" if solved.on_carriage else "fixed",
            backlash_m=plays_m[:, 0],
            backlash_sigma_m=plays_m[:, 1],
            base_from_panel=panel,
            contact_offset_m=offset,
            camera_from_base=solved.camera_from_base,
            base_from_reading=solved.base_from_reading,
            stylus_direction=solved.stylus_direction,
            left=self._conditions.cameras["left"],
            right=self._conditions.cameras.get("right"),
            machine=self.config.machine,
            rms_m=solved.fit.rms_m,
            sigma_m=solved.sigma_m(corners(self.config.run)),
            held_out_m=float(held_out_m.max()) if len(held_out_m) else float("nan"),
            samples=int(solved.fit.used.sum()),
            made_at=datetime.fromtimestamp(now_ns * 1e-9, timezone.utc).isoformat(timespec="seconds"),
        )

    # Periodic report, once a second.

    @property
    def drifted(self) -> str:
        """Parts that are off their expected positions; not monitored during a run."""
        return self._in_use.drifted(running=self.running)

    def look_around(self, now_ns: int) -> list[Action]:
        """Check tip and panel while nothing moves; report when drift starts or ends."""
        return self._in_use.look_around(self.watch, self._controls, now_ns, running=self.running)

    @property
    def level(self) -> str:
        """Level for the diagnostics."""
        fine = self.stored is not None and not self.drifted
        return "error" if state_name(self.state) == "failed" else "ok" if fine else "warn"

    def values(self) -> list[tuple[str, Any]]:
        """Values for the diagnostics."""
        values: list[tuple[str, Any]] = [("samples", len(self.samples)), ("contacts", len(self.contacts))]
        if self._run is not None:
            done, total = self._progress.done, self._progress.total
            values += [("done", done), ("total", total), ("remaining_s", f"{self._progress.remaining_s:.1f}")]
        return values + self._in_use.values(running=self.running)
