"""State and decisions of the hand-eye node: events and time in, actions out; no ROS, no clock, no file.

Samples, contacts and a calibration are valid only while cameras, machine settings and readings are those with which
they were made. Events that invalidate them come in any order, also during a run, and are therefore judged in one
method.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np

from harris_perception.core.hand_eye.calibration_file import CalibrationFileError, StoredCalibration, check_fits
from harris_perception.core.hand_eye.carriage_camera import (
    MAX_CONTACTS,
    Contact,
    PanelSample,
    calibrate_on_carriage,
    stylus_offset,
)
from harris_perception.core.hand_eye.drift import DriftConfig, DriftWatch
from harris_perception.core.hand_eye.hand_eye import (
    DegenerateError,
    HandEye,
    HandEyeConfig,
    Sample,
    calibrate,
    check_axes,
    check_stylus,
)
from harris_perception.core.hand_eye_procedure import calibration_run
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig, check_plan, corners
from harris_perception.core.hand_eye_procedure.calibration_run import (
    CalibrationRun,
    Failed,
    Finished,
    Progress,
    SendGoal,
)
from harris_perception.core.hand_eye_procedure.still_watch import NO_READINGS, StillConfig, StillWatch
from harris_perception.core.pose.planar_pose import FacePoints
from harris_perception.core.stereo.pairing import Pairing
from icu_common.core.configuration.config import Config, nested, setting
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.frames import PANEL
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratorConfig(Config):
    """Settings of the file, the machine and the procedure."""

    calibration_file: str = setting("", "File that stores the calibration; empty: not stored", read_only=True)
    machine: str = setting("default", "Name of the machine's configuration; a calibration is valid only for it")
    ball_radius_m: float = setting(
        0.002, "Radius of the stylus's ball, for contacts", minimum=0.0, maximum=0.05, unit="m"
    )
    run: RunConfig = nested(RunConfig)
    still: StillConfig = nested(StillConfig)
    solver: HandEyeConfig = nested(HandEyeConfig)
    drift: DriftConfig = nested(DriftConfig)


class Refused(ValueError):
    """A request is rejected; the text gives the reason."""


@dataclass(frozen=True, slots=True)
class SetState:
    """Publish the state."""

    text: str


@dataclass(frozen=True, slots=True, eq=False)
class SetAxes:
    """Publish (2, 2) base_from_reading; None: the calibration is withdrawn."""

    base_from_reading: Array | None


@dataclass(frozen=True, slots=True)
class SetSigma:
    """Publish the predicted error of the calibration in use, m."""

    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class SetPose:
    """Publish the pose of base_link."""

    camera_from_base: Transform
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Keep:
    """Write the calibration in use to the file."""


@dataclass(frozen=True, slots=True)
class Note:
    """Write a log message; the level is ``info``, ``warn`` or ``error``."""

    level: str
    text: str


Action = SendGoal | SetState | SetAxes | SetSigma | SetPose | Keep | Note


class Calibrator:
    """See the module's text. Every call returns the actions to carry out, in order; times are ROS time."""

    def __init__(self, config: CalibratorConfig) -> None:
        self.config = config
        self.watch = StillWatch(config.still)
        self.state = "uncalibrated"
        self.driver = "unknown"
        self.cameras: dict[str, CameraModel] = {}
        self.reading: Array | None = None
        self.samples: list[Sample] = []
        self.panels: list[PanelSample] = []
        self.contacts: list[Contact] = []
        self.sightings = Pairing(2)
        self.drift: DriftWatch | None = None
        self.stored: StoredCalibration | None = None
        self._looked_ns = [0, 0]
        self._solved: HandEye | None = None
        # A calibration from the file, or a withdrawn one: used as soon as it fits. And the reported reason why it does
        # not fit.
        self._loaded: StoredCalibration | None = None
        self._refused = ""
        self._run: CalibrationRun | None = None
        self._progress = Progress(0, 0, remaining_s=0.0)
        self._panel: Transform | None = None
        self._controls: dict[str, Array] = {}
        self._settings = ""

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
        actions: list[Action] = []
        if self.stored is not None and self.drift is not None and self.drift.config != config.drift:
            told, self.drift = self.drift.text, DriftWatch(config.drift, self.stored)
            if told and self._run is None:
                actions += self._set_state(f"calibrated: {self.stored.summary()}")
        return actions + self._check(now_ns)

    def close(self) -> list[Action]:
        """Report that a run was interrupted; the controller finishes its goal and then rests."""
        return self._fail_run("the hand-eye node was stopped")

    # Events.

    def offer(self, loaded: StoredCalibration) -> list[Action]:
        """Offer the calibration from the file; it is used once the cameras are known."""
        self._loaded = loaded
        return self._set_state("uncalibrated: waiting for camera_info to check the calibration file")

    def reject_file(self, reason: str) -> list[Action]:
        """Record that the file cannot be read."""
        return [Note("error", reason), *self._set_state(f"failed: {reason}")]

    def take_camera(self, side: str, camera: CameraModel, now_ns: int) -> list[Action]:
        """Set a camera that is new or has changed."""
        actions = []
        if side in self.cameras:
            actions = self._forget_seen(f"the {side} camera's calibration has changed meanwhile")
        self.cameras[side] = camera
        return actions + self._check(now_ns)

    def lose_camera(self, side: str, width: int, height: int) -> list[Action]:
        """Stop using calibrations with a camera that has been replaced by an unknown one."""
        if self.cameras.pop(side, None) is None:
            return []
        why = f"the {side} camera's pictures of {width} x {height} px have no calibration"
        actions = self._forget_seen(why)
        return actions + (self._withdraw(why) if self.stored is not None else [])

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
        moved = self.reading is None or bool(np.abs(reading - self.reading).max() > 0)
        self.reading = reading
        actions = []
        if moved and self.stored is not None and self.stored.on_carriage:
            actions = self._pose(self.stored, stamp_ns)
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
        self._tell_run_the_face()
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

    def take_controls(self, controls: dict[str, Array]) -> None:
        """Set the controls' positions (3,) m in panel_link, by name."""
        self._controls = controls
        self._tell_run_the_face()

    def _tell_run_the_face(self) -> None:
        if self._run is not None:
            tallest = max((float(place[2]) for place in self._controls.values()), default=0.0)
            self._run.keep_clear_of(self._panel, tallest + self.config.ball_radius_m)

    def take_settings(self, text: str, now_ns: int) -> list[Action]:
        """Set the board's settings."""
        self._settings = text
        return self._check(now_ns)

    def take_contact(self, point: Array, frame: str, now_ns: int) -> list[Action]:
        """Store a contact of the stylus with this point (3,) m of the panel at the present readings."""
        if frame != PANEL or not np.isfinite(point).all():
            why = f"{point.tolist()} in {frame!r}: a finite point in {PANEL!r} is needed"
        elif self.reading is None:
            why = NO_READINGS
        elif unrest := self.watch.unrest(now_ns):
            why = unrest
        elif self._run is not None:
            why = "a calibration is running"
        elif len(self.contacts) >= MAX_CONTACTS:
            why = f"there are {MAX_CONTACTS} already; solve"
        else:
            ball = np.array([0.0, 0.0, self.config.ball_radius_m])
            self.contacts.append(Contact(reading=self.reading, in_panel=point + ball))
            x, y, _ = point
            return [Note("info", f"contact {len(self.contacts)} at {x:.4f}, {y:.4f} m of the panel")]
        return [Note("error", f"contact refused: {why}")]

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

    # Requests; they raise Refused.

    def run(self, now_ns: int) -> list[Action]:
        """Start a calibration."""
        if self._run is not None:
            raise Refused("a calibration is already running")
        if self.driver.split(":")[0] != "idle":
            raise Refused(f"the driver says {self.driver!r}: connected, homed and idle is needed")
        cameras, config = self._pair(), self.config
        try:
            check_plan(config.run, config.solver)
        except DegenerateError as error:
            raise Refused(f"the run's places do not tell the calibration: {error}") from error
        self.samples.clear()
        self.panels.clear()
        # The controller still converts goals into readings with the calibration that it has.
        axes = None if self.stored is None else self.stored.base_from_reading
        self._run = CalibrationRun(config.run, config.still, config.solver, cameras, now_ns, axes, tuple(self.contacts))
        self._tell_run_the_face()
        return self._follow(self._run.start(now_ns), now_ns)

    def add_sample(self, now_ns: int) -> str:
        """Add a sample of the tip, or the panel, at the present position; return a description for people."""
        if self._run is not None:
            raise Refused("a calibration is running")
        sample = self.watch.sample(now_ns)
        if self._on_carriage:
            panel = self.watch.panel_sample(now_ns)
            if isinstance(panel, str):
                raise Refused(panel)
            self.panels.append(panel)
            reading, count = panel.reading, len(self.panels)
        if isinstance(sample, Sample):
            self.samples.append(sample)
            reading, count = sample.reading, max(len(self.samples), len(self.panels))
        elif not self._on_carriage:
            raise Refused(sample)
        x, y, stylus = reading * 1e3
        return f"sample {count} at readings x = {x:.1f}, y = {y:.1f}, stylus = {stylus:.1f} mm"

    def solve(self, now_ns: int) -> list[Action]:
        """Calibrate from the added samples."""
        if self._run is not None:
            raise Refused("a calibration is running")
        cameras, solver = self._pair(), self.config.solver
        try:
            if self._on_carriage:
                solved = calibrate_on_carriage(self.panels, self.samples, cameras, self.contacts, solver)
            else:
                solved = calibrate(self.samples, cameras, solver)
        except DegenerateError as error:
            raise Refused(str(error)) from error
        found = self._describe(solved, np.empty(0), np.full((2, 2), np.nan), now_ns)
        self.contacts.clear()
        return self._use(found, solved, now_ns)

    def _pair(self) -> StereoModel:
        for side in ("left", "right"):
            if side not in self.cameras:
                raise Refused(f"no camera_info of the {side} camera has arrived")
        try:
            return StereoModel(left=self.cameras["left"], right=self.cameras["right"])
        except ValueError as error:
            raise Refused(f"camera_info: {error}") from error

    # A run and its results.

    def _follow(self, events: Iterable[calibration_run.Action], now_ns: int) -> list[Action]:
        actions: list[Action] = []
        for event in events:
            if isinstance(event, SendGoal):
                actions.append(event)
            elif isinstance(event, Progress):
                self._progress = event
                note = f" ({event.note})" if event.note else ""
                text = f"calibrating {event.done}/{event.total}, {event.remaining_s:.0f} s left{note}"
                actions += self._set_state(text)
            elif isinstance(event, Failed):
                actions += self._fail_run(event.reason)
            else:
                actions += self._finish(event, now_ns)
        return actions

    def _fail_run(self, reason: str) -> list[Action]:
        if self._run is None:
            return []
        self._run = None
        return [Note("error", f"calibration failed: {reason}"), *self._set_state(f"failed: {reason}")]

    def _finish(self, event: Finished, now_ns: int) -> list[Action]:
        self._run = None
        plays = [(float("nan"), float("nan")) if b is None else (b.play_m, b.sigma_m) for b in event.backlash]
        found = self._describe(event.calibration, event.held_out_m, np.array(plays), now_ns)
        self.contacts.clear()
        return [*self._use(found, event.calibration, now_ns), Keep()]

    def _describe(self, solved: HandEye, held_out_m: Array, plays_m: Array, now_ns: int) -> StoredCalibration:
        """Return the values to store."""
        offset = np.full(3, np.nan)
        camera_from_panel = solved.camera_from_panel if solved.on_carriage else self._panel
        if camera_from_panel is not None and self.contacts:
            offset = stylus_offset(solved, camera_from_panel, self.contacts, self.config.solver).offset
        panel = None if camera_from_panel is None else solved.camera_from_base.inverse() @ camera_from_panel
        return StoredCalibration(
            settings=self._settings,
            mounting="carriage" if solved.on_carriage else "fixed",
            backlash_m=plays_m[:, 0],
            backlash_sigma_m=plays_m[:, 1],
            base_from_panel=panel,
            contact_offset_m=offset,
            camera_from_base=solved.camera_from_base,
            base_from_reading=solved.base_from_reading,
            stylus_direction=solved.stylus_direction,
            left=self.cameras["left"],
            right=self.cameras.get("right"),
            machine=self.config.machine,
            rms_m=solved.fit.rms_m,
            sigma_m=solved.sigma_m(corners(self.config.run)),
            held_out_m=float(held_out_m.max()) if len(held_out_m) else float("nan"),
            samples=int(solved.fit.used.sum()),
            made_at=datetime.fromtimestamp(now_ns * 1e-9, timezone.utc).isoformat(timespec="seconds"),
        )

    # The calibration in use.

    def _use(self, calibration: StoredCalibration, solved: HandEye | None, now_ns: int) -> list[Action]:
        self.stored, self._solved = calibration, solved
        self._loaded, self._refused = None, ""
        self.drift = DriftWatch(self.config.drift, calibration)
        return [
            SetSigma(calibration.sigma_m),
            SetAxes(calibration.base_from_reading),
            *self._pose(calibration, now_ns),
            *self._set_state(f"calibrated: {calibration.summary()}"),
        ]

    def _pose(self, calibration: StoredCalibration, stamp_ns: int) -> list[Action]:
        """Publish the present pose of base_link; with cameras on the carriage it changes with every reading."""
        if calibration.on_carriage and self.reading is None:
            return []
        reading = np.zeros(3) if self.reading is None else self.reading
        return [SetPose(calibration.camera_from_base_at(reading), stamp_ns)]

    def _withdraw(self, why: str) -> list[Action]:
        """Withdraw the calibration in use until it fits again: without axes the controller touches nothing."""
        self._loaded, self._refused = self.stored, why
        self.stored, self._solved, self.drift = None, None, None
        reason = f"the calibration in use is refused: {why}"
        return [SetAxes(None), Note("error", reason), *self._set_state(f"failed: {reason}")]

    def _check(self, now_ns: int) -> list[Action]:
        """Check again whether the calibration in use, or else the waiting one, fits the present state."""
        return self._check_loaded(now_ns) if self.stored is None else self._check_used(self.stored)

    def _check_used(self, used: StoredCalibration) -> list[Action]:
        """Reject the calibration in use if the camera, the resolution or the machine's settings have changed."""
        if "left" not in self.cameras:
            return []
        try:
            self._check_fit(used)
        except CalibrationFileError as error:
            return self._withdraw(str(error))
        return []

    def _check_loaded(self, now_ns: int) -> list[Action]:
        """Use the calibration from the file, or the withdrawn one, once it fits the cameras and no run is active."""
        loaded, left, right = self._loaded, self.cameras.get("left"), self.cameras.get("right")
        if loaded is None or left is None or (right is None and loaded.right is not None) or self._run is not None:
            return []
        try:
            self._check_fit(loaded)
        except CalibrationFileError as error:
            # Reported once: a later report, for example of a run, is newer.
            if str(error) == self._refused:
                return []
            self._refused = str(error)
            reason = f"the stored calibration is refused: {error}"
            return [Note("error", reason), *self._set_state(f"failed: {reason}")]
        return self._use(loaded, None, now_ns)

    def _check_fit(self, calibration: StoredCalibration) -> None:
        config, cameras = self.config, self.cameras
        mounting = config.run.mounting
        check_fits(calibration, cameras["left"], cameras.get("right"), config.machine, self._settings, mounting)
        try:
            check_axes(calibration.base_from_reading, config.solver)
            check_stylus(calibration.stylus_direction, config.solver)
        except DegenerateError as error:
            raise CalibrationFileError(str(error)) from error

    def _set_state(self, text: str) -> list[Action]:
        self.state = text
        return [SetState(text)]

    # Periodic report, once a second.

    @property
    def drifted(self) -> str:
        """Parts that are off their expected positions; not monitored during a run."""
        looked = self.stored is not None and self._run is None and self.reading is not None
        return self.drift.text if self.drift is not None and looked else ""

    def look_around(self, now_ns: int) -> list[Action]:
        """Check tip and panel while nothing moves; report when drift starts or ends."""
        if self.drift is None or self.stored is None or self._run is not None or self.reading is None:
            return []
        before = self.drift.off
        # Sightings that were already checked do not count again. A stamp in the future precedes a step back of the
        # clock.
        tips_ns, panels_ns = (stamp if stamp <= now_ns else 0 for stamp in self._looked_ns)
        sample, panel = self.watch.sample(now_ns, tips_ns), self.watch.panel_sample(now_ns, panels_ns)
        if isinstance(sample, Sample):
            self._looked_ns[0] = self.watch.newest_ns[0]
            self.drift.tip(sample)
        if isinstance(panel, PanelSample):
            self._looked_ns[1] = self.watch.newest_ns[1]
            base_from_camera = self.stored.camera_from_base_at(panel.reading).inverse()
            self.drift.panel(base_from_camera @ panel.camera_from_panel, self._controls)
        text = self.drift.text
        if self.drift.off == before:
            return []
        note = Note("warn", text) if text else Note("info", "everything is seen in its place again")
        return [note, *self._set_state(f"calibrated: {self.stored.summary()}" + (f"; drift: {text}" if text else ""))]

    @property
    def level(self) -> str:
        """Level for the diagnostics."""
        fine = self.stored is not None and not self.drifted
        return "error" if self.state.startswith("failed") else "ok" if fine else "warn"

    def values(self) -> list[tuple[str, Any]]:
        """Values for the diagnostics."""
        values: list[tuple[str, Any]] = [("samples", len(self.samples)), ("contacts", len(self.contacts))]
        if self._run is not None:
            done, total = self._progress.done, self._progress.total
            values += [("done", done), ("total", total), ("remaining_s", f"{self._progress.remaining_s:.1f}")]
        if self.stored is not None:
            values += self.stored.values()
        if self._solved is not None:
            values.append(("chi_square_per_freedom", f"{self._solved.fit.variance_factor:.2f}"))
        if self.drift is not None:
            values += [("tip_off_mm", f"{self.drift.tip_m * 1e3:.3f}"), ("drift", self.drifted or "none")]
            values.append(("control_off_mm", f"{self.drift.control_m * 1e3:.3f}"))
        return values
