"""Node that calibrates the gantry against the stereo camera by moving it and looking at the stylus."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, TransformStamped
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension, MultiArrayLayout, String
from std_srvs.srv import Trigger

from harris_perception.core.calibration_file import (
    CalibrationFileError,
    StoredCalibration,
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
)
from harris_perception.core.hand_eye import DegenerateError, HandEye, HandEyeConfig, Sample, calibrate
from icu_common.core.camera_model import CameraModel
from icu_common.core.config import Config, nested, setting
from icu_common.core.frames import BASE, CAMERA_LEFT, JOINTS
from icu_common.core.geometry import Array
from icu_common.nodes import qos
from icu_common.nodes.conversions import (
    camera_model,
    diagnostic_status,
    header,
    joint_positions,
    point_array,
    point_message,
    result_of_message,
    stamp_ns,
    transform_message,
)
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run

_TICK_S = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class HandEyeNodeConfig(Config):
    """The file, the machine and the procedure."""

    calibration_file: str = setting("", "Where the calibration is kept; empty: nowhere", read_only=True)
    machine: str = setting("default", "Name of the machine's configuration; a calibration is bound to it")
    run: RunConfig = nested(RunConfig)
    still: StillConfig = nested(StillConfig)
    solver: HandEyeConfig = nested(HandEyeConfig)


class HandEyeNode(Node):
    """Services ``run``, ``add_sample``, ``solve``, ``save``; publishes ``camera_from_base``, ``axes`` and ``state``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("hand_eye", **options)
        self._live = LiveParameters(self, HandEyeNodeConfig, self._on_config)
        self._watch = StillWatch(self._live.config.still)
        self._procedure: CalibrationRun | None = None
        self._samples: list[Sample] = []
        self._stored: StoredCalibration | None = None
        self._unchecked: StoredCalibration | None = None
        self._solved: HandEye | None = None
        self._driver = "unknown"
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

    # What arrives.

    def _camera_callback(self, side: str) -> Callable[[CameraInfo], None]:
        def callback(message: CameraInfo) -> None:
            if side in self._cameras:
                return
            try:
                self._cameras[side] = camera_model(message, side)
            except ValueError as error:
                self.get_logger().error(f"{side} camera_info: {error}", throttle_duration_sec=5.0)
            self._check_loaded()

        return callback

    def _on_joints(self, message: JointState) -> None:
        try:
            reading = joint_positions(message, JOINTS)
        except ValueError as error:
            self.get_logger().error(f"joint_states: {error}", throttle_duration_sec=5.0)
            return
        stamp = stamp_ns(message.header.stamp)
        self._watch.reading(stamp, reading)
        if self._procedure is not None:
            self._procedure.reading(stamp, reading)

    def _on_tip(self, message: PointStamped) -> None:
        if message.header.frame_id != CAMERA_LEFT:
            self.get_logger().error(f"tip in {message.header.frame_id!r} ignored", throttle_duration_sec=5.0)
            return
        stamp, tip = stamp_ns(message.header.stamp), point_array(message)
        self._watch.tip(stamp, tip)
        if self._procedure is not None:
            self._act(self._procedure.tip(stamp, tip, self._now_ns()))

    def _on_driver(self, message: String) -> None:
        self._driver = message.data
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
        self._use(self._describe(action.calibration, action.held_out_m), action.calibration)
        if self._live.config.calibration_file:
            try:
                self._save()
            except _Refused as error:
                self.get_logger().error(str(error))

    def _describe(self, solved: HandEye, held_out_m: Array) -> StoredCalibration:
        return StoredCalibration(
            camera_from_base=solved.camera_from_base,
            base_from_reading=solved.base_from_reading,
            stylus_direction=solved.stylus_direction,
            left=self._cameras["left"],
            right=self._cameras.get("right"),
            machine=self._live.config.machine,
            rms_m=solved.rms_m,
            sigma_m=solved.sigma_m(_corners(self._live.config.run)),
            held_out_m=float(held_out_m.max()) if len(held_out_m) else float("nan"),
            samples=int(solved.used.sum()),
            made_at=datetime.fromtimestamp(self._now_ns() * 1e-9, timezone.utc).isoformat(timespec="seconds"),
        )

    def _use(self, calibration: StoredCalibration, solved: HandEye | None = None) -> None:
        self._stored, self._solved = calibration, solved
        layout = MultiArrayLayout(
            dim=[
                MultiArrayDimension(label="base", size=2, stride=4),
                MultiArrayDimension(label="axis", size=2, stride=2),
            ]
        )
        self._axes.publish(
            Float64MultiArray(layout=layout, data=[float(v) for v in calibration.base_from_reading.flat])
        )
        head = header(self._now_ns(), CAMERA_LEFT)
        self._transform.publish(transform_message(calibration.camera_from_base, head, BASE))
        self._set_state(f"calibrated: {calibration.summary()}")

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
            check_fits(loaded, left, right, self._live.config.machine)
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
        self._need_cameras()
        config = self._live.config
        self._samples.clear()
        self._procedure = CalibrationRun(config.run, config.still, config.solver, self._now_ns())
        self._act(self._procedure.start(self._now_ns()))
        return "calibrating; watch the state"

    def _add_sample(self) -> str:
        if self._procedure is not None:
            raise _Refused("a calibration is running")
        sample = self._watch.sample(self._now_ns())
        if isinstance(sample, str):
            raise _Refused(sample)
        self._samples.append(sample)
        x, y, stylus = sample.reading * 1e3
        return f"sample {len(self._samples)} at readings x = {x:.1f}, y = {y:.1f}, stylus = {stylus:.1f} mm"

    def _solve(self) -> str:
        if self._procedure is not None:
            raise _Refused("a calibration is running")
        self._need_cameras()
        try:
            solved = calibrate(self._samples, self._live.config.solver)
        except DegenerateError as error:
            raise _Refused(str(error)) from error
        self._use(self._describe(solved, np.empty(0)), solved)
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

    def _need_cameras(self) -> None:
        if "left" not in self._cameras:
            raise _Refused("no camera_info of the left camera has arrived")

    def _report(self) -> None:
        level = "error" if self._state.startswith("failed") else "ok" if self._stored is not None else "warn"
        values: list[tuple[str, Any]] = [("samples", len(self._samples))]
        if self._stored is not None:
            stored, axes = self._stored, self._stored.base_from_reading
            values += [
                ("rms_mm", f"{stored.rms_m * 1e3:.4f}"),
                ("predicted_sigma_mm", f"{stored.sigma_m * 1e3:.4f}"),
                ("held_out_max_mm", f"{stored.held_out_m * 1e3:.4f}"),
                ("scale_x", f"{axes[0, 0]:.6f}"),
                ("scale_y", f"{float(np.hypot(axes[0, 1], axes[1, 1])):.6f}"),
                ("skew_mrad", f"{float(np.arctan2(axes[0, 1], axes[1, 1])) * 1e3:.3f}"),
                ("stylus_tilt_mrad", _tilt(stored.stylus_direction)),
                ("made_at", stored.made_at),
            ]
        if self._solved is not None:
            values.append(("chi_square_per_freedom", f"{self._solved.variance_factor:.2f}"))
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


def _tilt(direction: Array) -> str:
    x, y, _ = direction * 1e3 / -direction[2]
    return f"x {x:.2f}, y {y:.2f}"


def main() -> int:
    """Run the hand-eye node."""
    return run(HandEyeNode)


if __name__ == "__main__":
    raise SystemExit(main())
