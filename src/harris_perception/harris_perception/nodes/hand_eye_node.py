"""Node that calibrates the gantry against the stereo camera by moving it and looking at the stylus."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from harris_perception.core.calibration_file import (
    CalibrationFileError,
    StoredCalibration,
    axes_scale,
    axes_skew,
    check_fits,
    load,
    save,
)
from harris_perception.core.calibration_run import (
    Action,
    CalibrationRun,
    Failed,
    Finished,
    Progress,
    RunConfig,
    SendGoal,
    StillConfig,
    StillWatch,
    check_plan,
)
from harris_perception.core.carriage_camera import (
    MAX_CONTACTS,
    Contact,
    PanelSample,
    calibrate_on_carriage,
    stylus_offset,
)
from harris_perception.core.drift import DriftConfig, DriftWatch
from harris_perception.core.hand_eye import DegenerateError, HandEye, HandEyeConfig, Sample, calibrate, check_axes
from harris_perception.core.pairing import Pairing
from harris_perception.core.planar_pose import FACE_POINT_COLUMNS, FacePoints
from icu_common.core.camera_model import CameraModel, StereoModel
from icu_common.core.config import Config, nested, setting
from icu_common.core.frames import BASE, CAMERA_LEFT, JOINTS, PANEL
from icu_common.core.geometry import Array, Transform
from icu_common.nodes import qos
from icu_common.nodes.conversions import (
    camera_model,
    check_frame,
    cloud_array,
    controls_of_message,
    diagnostic_status,
    header,
    joint_positions,
    point_array,
    point_message,
    result_of_message,
    same_camera,
    stamp_ns,
    transform_message,
    transform_of_pose,
)
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run

_TICK_S = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class HandEyeNodeConfig(Config):
    """The file, the machine and the procedure."""

    calibration_file: str = setting("", "Where the calibration is kept; empty: nowhere", read_only=True)
    machine: str = setting("default", "Name of the machine's configuration; a calibration is bound to it")
    ball_radius_m: float = setting(
        0.002, "Radius of the stylus's ball, for contacts", minimum=0.0, maximum=0.05, unit="m"
    )
    run: RunConfig = nested(RunConfig)
    still: StillConfig = nested(StillConfig)
    solver: HandEyeConfig = nested(HandEyeConfig)
    drift: DriftConfig = nested(DriftConfig)


class HandEyeNode(Node):
    """Services ``run``, ``add_sample``, ``solve``, ``save``; publishes ``camera_from_base``, ``axes`` and ``state``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("hand_eye", **options)
        self._live = LiveParameters(self, HandEyeNodeConfig, self._on_config)
        self._watch = StillWatch(self._live.config.still)
        self._procedure: CalibrationRun | None = None
        self._samples: list[Sample] = []
        self._panels: list[PanelSample] = []
        self._contacts: list[Contact] = []
        self._reading: Array | None = None
        self._panel: Transform | None = None
        self._sightings = Pairing(2)
        self._controls: dict[str, Array] = {}
        self._settings = ""
        self._drift: DriftWatch | None = None
        self._stored: StoredCalibration | None = None
        self._unchecked: StoredCalibration | None = None
        self._solved: HandEye | None = None
        self._driver = "unknown"
        self._infos: dict[str, CameraInfo] = {}
        self._cameras: dict[str, CameraModel] = {}
        self._goal = self.create_publisher(PointStamped, "goal", qos.COMMAND)
        self._transform = self.create_publisher(TransformStamped, "camera_from_base", qos.LATCHED)
        self._axes = self.create_publisher(Float64MultiArray, "axes", qos.LATCHED)
        self._state_out = self.create_publisher(String, "state", qos.LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.RESULTS)
        self._set_state("uncalibrated")
        self._load()
        self.create_subscription(PointStamped, "tip", self._on_tip, qos.SENSOR)
        self.create_subscription(JointState, "joint_states", self._on_joints, qos.SENSOR)
        self.create_subscription(String, "driver_state", self._on_driver, qos.LATCHED)
        self.create_subscription(String, "machine_settings", self._on_settings, qos.LATCHED)
        self.create_subscription(PoseStamped, "panel/pose", self._on_panel, qos.LATCHED)
        if self._live.config.run.mounting == "carriage":
            self.create_subscription(PointCloud2, "panel/points", self._on_points, qos.RESULTS)
        self.create_subscription(MarkerArray, "panel/controls", self._on_controls, qos.LATCHED)
        self.create_subscription(PointStamped, "contact", self._on_contact, qos.RESULTS)
        self.create_subscription(DiagnosticArray, "result", self._on_result, qos.RESULTS)
        for side in ("left", "right"):
            self.create_subscription(CameraInfo, f"{side}/camera_info", self._camera_callback(side), qos.SENSOR)
        for name, call in (
            ("run", self._run),
            ("add_sample", self._add_sample),
            ("solve", self._solve),
            ("save", self._save),
        ):
            self.create_service(Trigger, name, _answered(call))
        self.create_timer(_TICK_S, self._on_tick)
        self.create_timer(1.0, self._report)

    def close(self) -> None:
        """Say that a run was cut short; the controller finishes the goal it has and then rests."""
        if self._procedure is not None:
            self._act([Failed("the hand-eye node was stopped")])

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_config(self, config: HandEyeNodeConfig) -> None:
        self._watch = StillWatch(config.still)
        if self._stored is not None and self._drift is not None and self._drift.config != config.drift:
            told, self._drift = self._drift.text, DriftWatch(config.drift, self._stored)
            if told:
                self._set_state(f"calibrated: {self._stored.summary()}")
        self._check_used()

    # What arrives.

    def _camera_callback(self, side: str) -> Callable[[CameraInfo], None]:
        def callback(message: CameraInfo) -> None:
            if same_camera(self._infos.get(side), message):
                return
            known = self._cameras.pop(side, None) is not None
            self._infos.pop(side, None)
            try:
                self._cameras[side] = camera_model(message, side)
            except ValueError as error:
                self.get_logger().error(f"{side} camera_info: {error}", throttle_duration_sec=5.0)
                if known:
                    self._camera_lost(side, message)
                return
            self._infos[side] = message
            if known:
                self._forget_seen(f"the {side} camera's calibration has changed meanwhile")
            self._check_used()
            self._check_loaded()

        return callback

    def _camera_lost(self, side: str, message: CameraInfo) -> None:
        """Use no calibration with a camera that has become another, and does not say which."""
        why = f"the {side} camera's pictures of {message.width} x {message.height} px have no calibration"
        self._forget_seen(why)
        if self._stored is not None:
            self._withdraw(f"the calibration in use is refused: {why}")

    def _forget_seen(self, why: str) -> None:
        """End what was seen with a camera as it was; what is seen with another does not belong to it."""
        self._samples.clear()
        self._panels.clear()
        if self._procedure is not None:
            self._act([Failed(why)])

    def _on_joints(self, message: JointState) -> None:
        try:
            reading = joint_positions(message, JOINTS)
        except ValueError as error:
            self.get_logger().error(f"joint_states: {error}", throttle_duration_sec=5.0)
            return
        stamp = stamp_ns(message.header.stamp)
        moved = self._reading is None or bool(np.abs(reading - self._reading).max() > 0)
        self._reading = reading
        if moved and self._stored is not None and self._stored.on_carriage:
            self._publish_transform(self._stored, stamp)
        self._watch.reading(stamp, reading)
        if self._procedure is not None:
            self._procedure.reading(stamp, reading)

    def _on_tip(self, message: PointStamped) -> None:
        if message.header.frame_id != CAMERA_LEFT:
            self.get_logger().error(f"tip in {message.header.frame_id!r} ignored", throttle_duration_sec=5.0)
            return
        stamp, tip = stamp_ns(message.header.stamp), point_array(message)
        if not np.isfinite(tip).all():
            self.get_logger().error(f"tip {tip.tolist()} m ignored: it is not finite", throttle_duration_sec=5.0)
            return
        self._watch.tip(stamp, tip)
        if self._procedure is not None:
            self._act(self._procedure.tip(stamp, tip, self._now_ns()))

    def _on_panel(self, message: PoseStamped) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
            self._panel = transform_of_pose(message.pose)
        except ValueError as error:
            self.get_logger().error(f"panel/pose: {error}", throttle_duration_sec=5.0)
            return
        stamp = stamp_ns(message.header.stamp)
        if self._live.config.run.mounting == "carriage":
            self._take_panel(self._sightings.add(0, stamp, (stamp, self._panel)))
        else:
            self._watch.panel(stamp, self._panel, FacePoints.joined([]))

    def _on_points(self, message: PointCloud2) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
            points = FacePoints.of_rows(cloud_array(message, FACE_POINT_COLUMNS))
        except ValueError as error:
            self.get_logger().error(f"panel/points: {error}", throttle_duration_sec=5.0)
            return
        self._take_panel(self._sightings.add(1, stamp_ns(message.header.stamp), points))

    def _take_panel(self, sighting: tuple[Any, ...] | None) -> None:
        """Take a pose and what was measured for it, once both have come."""
        if sighting is None:
            return
        (stamp, pose), points = sighting
        self._watch.panel(stamp, pose, points)
        if self._procedure is not None:
            self._act(self._procedure.panel(stamp, pose, points, self._now_ns()))

    def _on_controls(self, message: MarkerArray) -> None:
        try:
            controls, _ = controls_of_message(message)
        except ValueError as error:
            self.get_logger().error(f"panel/controls: {error}", throttle_duration_sec=5.0)
            return
        self._controls = {c.name: np.array([*c.position_mm, c.height_mm]) / 1e3 for c in controls}

    def _on_settings(self, message: String) -> None:
        self._settings = message.data
        self._check_used()
        self._check_loaded()

    def _on_contact(self, message: PointStamped) -> None:
        """Keep that the stylus touches this point of the panel now."""
        point = point_array(message)
        if message.header.frame_id != PANEL or not np.isfinite(point).all():
            why = f"{point.tolist()} in {message.header.frame_id!r}: a finite point in {PANEL!r} is needed"
        elif self._reading is None:
            why = "no joint_states arrive"
        elif unrest := self._watch.unrest(self._now_ns()):
            why = unrest
        elif self._procedure is not None:
            why = "a calibration is running"
        elif len(self._contacts) >= MAX_CONTACTS:
            why = f"there are {MAX_CONTACTS} already; solve"
        else:
            ball = np.array([0.0, 0.0, self._live.config.ball_radius_m])
            self._contacts.append(Contact(reading=self._reading, in_panel=point + ball))
            self.get_logger().info(f"contact {len(self._contacts)} at {point[0]:.4f}, {point[1]:.4f} m of the panel")
            return
        self.get_logger().error(f"contact refused: {why}")

    def _on_driver(self, message: String) -> None:
        self._driver = message.data
        if message.data == "homing":
            # Readings begin anew; what was collected before belongs to others.
            for kept in (self._samples, self._panels, self._contacts):
                kept.clear()
        if self._procedure is not None:
            self._act(self._procedure.driver_state(message.data))

    def _on_result(self, message: DiagnosticArray) -> None:
        if self._procedure is None:
            return
        try:
            answer = result_of_message(message)
        except ValueError as error:
            self.get_logger().error(f"result: {error}")
            return
        self._act(self._procedure.result(answer, self._now_ns()))

    def _on_tick(self) -> None:
        if self._procedure is not None:
            self._act(self._procedure.tick(self._now_ns()))

    # What is done about it.

    def _act(self, actions: Iterable[Action]) -> None:
        for action in actions:
            if isinstance(action, SendGoal):
                self._goal.publish(point_message(action.xyz, header(action.stamp_ns, BASE)))
            elif isinstance(action, Progress):
                note = f" ({action.note})" if action.note else ""
                self._set_state(f"calibrating {action.done}/{action.total}{note}")
            elif isinstance(action, Failed):
                self._procedure = None
                self.get_logger().error(f"calibration failed: {action.reason}")
                self._set_state(f"failed: {action.reason}")
            else:
                self._finish(action)

    def _finish(self, action: Finished) -> None:
        self._procedure = None
        plays = [(float("nan"), float("nan")) if b is None else (b.play_m, b.sigma_m) for b in action.backlash]
        found = self._describe(action.calibration, action.held_out_m, np.array(plays))
        self._contacts.clear()
        self._use(found, action.calibration)
        if self._live.config.calibration_file:
            try:
                self._save()
            except _Refused as error:
                self.get_logger().error(str(error))

    def _describe(self, solved: HandEye, held_out_m: Array, plays_m: Array) -> StoredCalibration:
        """Return what is kept."""
        solver = self._live.config.solver
        offset = np.full(3, np.nan)
        camera_from_panel = solved.camera_from_panel if solved.on_carriage else self._panel
        if camera_from_panel is not None and self._contacts:
            offset = stylus_offset(solved, camera_from_panel, self._contacts, solver).offset
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
            left=self._cameras["left"],
            right=self._cameras.get("right"),
            machine=self._live.config.machine,
            rms_m=solved.fit.rms_m,
            sigma_m=solved.sigma_m(_corners(self._live.config.run)),
            held_out_m=float(held_out_m.max()) if len(held_out_m) else float("nan"),
            samples=int(solved.fit.used.sum()),
            made_at=datetime.fromtimestamp(self._now_ns() * 1e-9, timezone.utc).isoformat(timespec="seconds"),
        )

    def _use(self, calibration: StoredCalibration, solved: HandEye | None = None) -> None:
        self._stored, self._solved = calibration, solved
        self._drift = DriftWatch(self._live.config.drift, calibration)
        layout = MultiArrayLayout(
            dim=[
                MultiArrayDimension(label="base", size=2, stride=4),
                MultiArrayDimension(label="axis", size=2, stride=2),
            ]
        )
        self._axes.publish(
            Float64MultiArray(layout=layout, data=[float(v) for v in calibration.base_from_reading.flat])
        )
        self._publish_transform(calibration, self._now_ns())
        self._set_state(f"calibrated: {calibration.summary()}")

    def _publish_transform(self, calibration: StoredCalibration, stamp: int) -> None:
        """Say where base_link is seen now; with cameras on the carriage that changes with every reading."""
        if calibration.on_carriage and self._reading is None:
            return
        reading = np.zeros(3) if self._reading is None else self._reading
        head = header(stamp, CAMERA_LEFT)
        self._transform.publish(transform_message(calibration.camera_from_base_at(reading), head, BASE))

    def _withdraw(self, reason: str) -> None:
        """Take the calibration in use back: without axes nothing is touched any more."""
        self._stored, self._solved, self._drift = None, None, None
        self._axes.publish(Float64MultiArray())
        self.get_logger().error(reason)
        self._set_state(f"failed: {reason}")

    def _check_used(self) -> None:
        """Refuse the calibration in use when the camera, the resolution or the machine's settings have changed."""
        if self._stored is None or "left" not in self._cameras:
            return
        try:
            self._check(self._stored)
        except CalibrationFileError as error:
            self._withdraw(f"the calibration in use is refused: {error}")

    def _check(self, calibration: StoredCalibration) -> None:
        config, cameras = self._live.config, self._cameras
        mounting = config.run.mounting
        check_fits(calibration, cameras["left"], cameras.get("right"), config.machine, self._settings, mounting)
        try:
            check_axes(calibration.base_from_reading, config.solver)
        except DegenerateError as error:
            raise CalibrationFileError(str(error)) from error

    def _set_state(self, text: str) -> None:
        self._state = text
        self._state_out.publish(String(data=text))

    def _load(self) -> None:
        path = self._live.config.calibration_file
        if not path or not Path(path).exists():
            return
        try:
            self._unchecked = load(Path(path))
        except (CalibrationFileError, OSError) as error:
            self.get_logger().error(str(error))
            self._set_state(f"failed: {error}")
            return
        self._set_state("uncalibrated: waiting for camera_info to check the calibration file")

    def _check_loaded(self) -> None:
        """Use the file once the cameras are known, unless a newer calibration came first."""
        loaded, left, right = self._unchecked, self._cameras.get("left"), self._cameras.get("right")
        if loaded is None or left is None or (right is None and loaded.right is not None) or self._stored is not None:
            return
        self._unchecked = None
        try:
            self._check(loaded)
        except CalibrationFileError as error:
            self.get_logger().error(f"{self._live.config.calibration_file}: {error}")
            self._set_state(f"failed: the stored calibration is refused: {error}")
            return
        self._use(loaded)

    # Services: each returns what it did, or raises _Refused.

    def _run(self) -> str:
        if self._procedure is not None:
            raise _Refused("a calibration is already running")
        if self._driver.split(":")[0] != "idle":
            raise _Refused(f"the driver says {self._driver!r}: connected, homed and idle is needed")
        cameras = self._pair()
        config = self._live.config
        try:
            check_plan(config.run, config.solver)
        except DegenerateError as error:
            raise _Refused(f"the run's places do not tell the calibration: {error}") from error
        self._samples.clear()
        self._panels.clear()
        # The controller still turns goals into readings with the calibration that it has.
        axes = None if self._stored is None else self._stored.base_from_reading
        self._procedure = CalibrationRun(
            config.run, config.still, config.solver, cameras, self._now_ns(), axes, tuple(self._contacts)
        )
        self._act(self._procedure.start(self._now_ns()))
        return "calibrating; watch the state"

    def _add_sample(self) -> str:
        if self._procedure is not None:
            raise _Refused("a calibration is running")
        on_carriage = self._live.config.run.mounting == "carriage"
        sample = self._watch.sample(self._now_ns())
        if on_carriage:
            panel = self._watch.panel_sample(self._now_ns())
            if isinstance(panel, str):
                raise _Refused(panel)
            self._panels.append(panel)
            reading, count = panel.reading, len(self._panels)
        if isinstance(sample, Sample):
            self._samples.append(sample)
            reading, count = sample.reading, max(len(self._samples), len(self._panels))
        elif not on_carriage:
            raise _Refused(sample)
        x, y, stylus = reading * 1e3
        return f"sample {count} at readings x = {x:.1f}, y = {y:.1f}, stylus = {stylus:.1f} mm"

    def _solve(self) -> str:
        if self._procedure is not None:
            raise _Refused("a calibration is running")
        cameras = self._pair()
        solver = self._live.config.solver
        try:
            if self._live.config.run.mounting == "carriage":
                solved = calibrate_on_carriage(self._panels, self._samples, cameras, self._contacts, solver)
            else:
                solved = calibrate(self._samples, cameras, solver)
        except DegenerateError as error:
            raise _Refused(str(error)) from error
        self._use(self._describe(solved, np.empty(0), np.full((2, 2), np.nan)), solved)
        self._contacts.clear()
        return self._state

    def _save(self) -> str:
        path = self._live.config.calibration_file
        if not path:
            raise _Refused("calibration_file is not set")
        if self._stored is None:
            raise _Refused("there is no calibration to save")
        try:
            save(self._stored, Path(path))
        except OSError as error:
            raise _Refused(f"the calibration could not be saved: {error}") from error
        return f"saved to {path}"

    def _pair(self) -> StereoModel:
        for side in ("left", "right"):
            if side not in self._cameras:
                raise _Refused(f"no camera_info of the {side} camera has arrived")
        try:
            return StereoModel(left=self._cameras["left"], right=self._cameras["right"])
        except ValueError as error:
            raise _Refused(f"camera_info: {error}") from error

    def _watch_drift(self) -> str:
        """Look at tip and panel while nothing moves; return what has drifted."""
        if self._drift is None or self._stored is None or self._procedure is not None or self._reading is None:
            return ""
        now, before = self._now_ns(), self._drift.text
        sample, panel = self._watch.sample(now), self._watch.panel_sample(now)
        if isinstance(sample, Sample):
            self._drift.tip(sample)
        if isinstance(panel, PanelSample):
            base_from_camera = self._stored.camera_from_base_at(panel.reading).inverse()
            self._drift.panel(base_from_camera @ panel.camera_from_panel, self._controls)
        text = self._drift.text
        if bool(text) != bool(before):
            if text:
                self.get_logger().warning(text)
            else:
                self.get_logger().info("everything is seen in its place again")
            self._set_state(f"calibrated: {self._stored.summary()}" + (f"; drift: {text}" if text else ""))
        return text

    def _report(self) -> None:
        drift = self._watch_drift()
        failed = self._state.startswith("failed")
        level = "error" if failed else "ok" if self._stored is not None and not drift else "warn"
        values: list[tuple[str, Any]] = [("samples", len(self._samples)), ("contacts", len(self._contacts))]
        if self._stored is not None:
            stored, axes = self._stored, self._stored.base_from_reading
            values += [
                ("rms_mm", f"{stored.rms_m * 1e3:.4f}"),
                ("predicted_sigma_mm", f"{stored.sigma_m * 1e3:.4f}"),
                ("held_out_max_mm", f"{stored.held_out_m * 1e3:.4f}"),
                ("mounting", stored.mounting),
                ("scale_x", f"{axes_scale(axes)[0]:.6f}"),
                ("scale_y", f"{axes_scale(axes)[1]:.6f}"),
                ("skew_mrad", f"{axes_skew(axes) * 1e3:.3f}"),
                ("right_angle_deg", f"{90.0 - float(np.degrees(axes_skew(axes))):.4f}"),
                ("backlash_x_mm", _measured(stored.backlash_m[0], stored.backlash_sigma_m[0])),
                ("backlash_y_mm", _measured(stored.backlash_m[1], stored.backlash_sigma_m[1])),
                ("contact_offset_mm", ", ".join(f"{v * 1e3:.3f}" for v in stored.contact_offset_m)),
                ("stylus_tilt_mrad", _tilt(stored.stylus_direction)),
                ("made_at", stored.made_at),
            ]
        if self._solved is not None:
            values.append(("chi_square_per_freedom", f"{self._solved.fit.variance_factor:.2f}"))
        if self._drift is not None:
            values += [("tip_off_mm", f"{self._drift.tip_m * 1e3:.3f}"), ("drift", drift or "none")]
            values.append(("control_off_mm", f"{self._drift.control_m * 1e3:.3f}"))
        status = diagnostic_status(self.get_fully_qualified_name(), level, self._state, values)
        self._diagnostics.publish(DiagnosticArray(header=header(self._now_ns(), ""), status=[status]))


class _Refused(Exception):
    """A service says no; the text says why."""


def _answered(call: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message, response.success = call(), True
        except _Refused as refusal:
            response.message, response.success = str(refusal), False
        return response

    return answer


def _corners(config: RunConfig) -> Array:
    """Return readings (4, 3) at the corners of the calibrated area, on the panel's side."""
    depth = -min(config.heights_m)
    corners = [(x, y, depth) for x in (config.x_min_m, config.x_max_m) for y in (config.y_min_m, config.y_max_m)]
    return np.array(corners)


def _measured(value_m: float, sigma_m: float) -> str:
    return f"{value_m * 1e3:.3f} +- {sigma_m * 1e3:.3f}"


def _tilt(direction: Array) -> str:
    x, y, _ = direction * 1e3 / -direction[2]
    return f"x {x:.2f}, y {y:.2f}"


def main() -> int:
    """Run the hand-eye node."""
    return run(HandEyeNode)


if __name__ == "__main__":
    raise SystemExit(main())
