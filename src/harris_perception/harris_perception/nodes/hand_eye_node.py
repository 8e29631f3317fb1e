"""Node that calibrates the gantry against the stereo camera: it moves the gantry and measures the stylus."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2
from std_msgs.msg import Float32, Float64MultiArray, Header, String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from harris_perception.core.hand_eye.calibration_file import CalibrationFileError, load, save
from harris_perception.core.hand_eye_procedure.calibration_run import SendCalibrationGoal
from harris_perception.core.hand_eye_procedure.calibrator import Calibrator
from harris_perception.core.hand_eye_procedure.calibrator_actions import (
    Action,
    Keep,
    LogNote,
    SetAxes,
    SetPose,
    SetSigma,
    SetState,
)
from harris_perception.core.hand_eye_procedure.calibrator_config import CalibratorConfig
from harris_perception.core.hand_eye_procedure.conditions import CalibrationRefused
from harris_perception.core.pose.planar_pose import FACE_POINT_COLUMNS, FacePoints
from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, JOINTS
from icu_common.core.reasons.message import Message
from icu_common.nodes import qos
from icu_common.nodes.alignment.pair_message import pair_of_message
from icu_common.nodes.camera_info import CameraInfoSubscription
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.answers import answer_text
from icu_common.nodes.messages.cameras import camera_model
from icu_common.nodes.messages.clouds import cloud_array
from icu_common.nodes.messages.heads import check_frame, check_not_ahead, header, stamp_ns
from icu_common.nodes.messages.joints import joint_positions
from icu_common.nodes.messages.panels import controls_of_message
from icu_common.nodes.messages.places import (
    axes_message,
    point_array,
    point_message,
    transform_message,
    transform_of_pose,
)
from icu_common.nodes.messages.results import result_of_message
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.state_codes import code_values
from icu_common.nodes.timers import every

_TICK_S = 0.05


class HandEyeNode(GraphNode):
    """Offers the services ``run``, ``add_sample``, ``solve``, ``save``; publishes the calibration and its state."""

    def __init__(self, **options: Any) -> None:
        super().__init__("hand_eye", **options)
        self._live = LiveParameters(self, CalibratorConfig, self._on_config)
        self.calibrator = Calibrator(self._live.config)
        self._cameras: dict[str, CameraInfoSubscription] = {}
        self._goal = self.create_publisher(PointStamped, "goal", qos.COMMAND)
        self._transform = self.create_publisher(TransformStamped, "camera_from_base", qos.LATCHED)
        self._axes = self.create_publisher(Float64MultiArray, "axes", qos.LATCHED)
        self._sigma = self.create_publisher(Float32, "sigma", qos.LATCHED)
        self._state = self.create_publisher(String, "state", qos.LATCHED)
        self._topic = self._state.topic_name
        self._diagnostics = Diagnostics(self)
        self._act([SetState(self.calibrator.state)])
        self._load()
        self.create_subscription(PointStamped, "tip", self._on_tip, qos.SENSOR)
        self.create_subscription(Header, "unseen", self._on_unseen, qos.SENSOR)
        self.create_subscription(JointState, "joint_states", self._on_joints, qos.SENSOR)
        self.create_subscription(String, "driver_state", self._on_driver, qos.LATCHED)
        self.create_subscription(String, "machine_settings", self._on_settings, qos.LATCHED)
        self.create_subscription(PoseStamped, "panel/pose", self._on_panel, qos.LATCHED)
        if self._live.config.run.mounting == "carriage":
            self.create_subscription(PointCloud2, "panel/points", self._on_points, qos.RESULTS)
        self.create_subscription(MarkerArray, "panel/controls", self._on_controls, qos.LATCHED)
        self.create_subscription(DiagnosticArray, "pair", self._on_pair, qos.LATCHED)
        self.create_subscription(PointStamped, "contact", self._on_contact, qos.RESULTS)
        self.create_subscription(DiagnosticArray, "result", self._on_result, qos.RESULTS)
        for side in ("left", "right"):
            self._cameras[side] = CameraInfoSubscription(
                self, f"{side}/camera_info", qos.SENSOR, self._camera_callback(side), self._on_image
            )
        for name, call in (
            ("run", self._run),
            ("add_sample", lambda: self.calibrator.add_sample(self._now_ns())),
            ("solve", self._solve),
            ("save", self._save),
        ):
            self.create_service(Trigger, name, _answered(call))
        every(self, _TICK_S, lambda: self._act(self.calibrator.tick(self._now_ns())))
        every(self, 1.0, self._report)

    def close(self) -> None:
        """Report that a run was interrupted."""
        self._act(self.calibrator.close())

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _on_config(self, config: CalibratorConfig) -> None:
        self._act(self.calibrator.configure(config, self._now_ns()))

    def _load(self) -> None:
        path = self._live.config.calibration_file
        if not path or not Path(path).exists():
            return
        try:
            self._act(self.calibrator.offer(load(Path(path))))
        except (CalibrationFileError, OSError) as error:
            self._act(self.calibrator.reject_file(str(error)))

    # Subscriptions.

    def _camera_callback(self, side: str) -> Callable[[CameraInfo], None]:
        def callback(message: CameraInfo) -> None:
            try:
                camera = camera_model(message, side)
            except ValueError as error:
                self.get_logger().error(f"{side} camera_info: {error}", throttle_duration_sec=5.0)
                self._act(self.calibrator.lose_camera(side, message.width, message.height))
                self._cameras[side].again()
                return
            self._act(self.calibrator.take_camera(side, camera, self._now_ns()))

        return callback

    def _on_image(self, stamp: int) -> None:
        # The image is evaluated later; the calibration may move on without waiting for that.
        self._act(self.calibrator.take_image(stamp, self._now_ns()))

    def _on_joints(self, message: JointState) -> None:
        try:
            check_not_ahead(message.header, self.get_clock())
            reading = joint_positions(message, JOINTS)
        except ValueError as error:
            self.get_logger().error(f"joint_states: {error}", throttle_duration_sec=5.0)
            return
        self._act(self.calibrator.take_reading(stamp_ns(message.header.stamp), reading))

    def _on_tip(self, message: PointStamped) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
            check_not_ahead(message.header, self.get_clock())
        except ValueError as error:
            self.get_logger().error(f"stylus/tip: {error}", throttle_duration_sec=5.0)
            return
        tip = point_array(message)
        if not np.isfinite(tip).all():
            self.get_logger().error(f"tip {tip.tolist()} m ignored: it is not finite", throttle_duration_sec=5.0)
            return
        self._act(self.calibrator.take_tip(stamp_ns(message.header.stamp), tip, self._now_ns()))

    def _on_unseen(self, message: Header) -> None:
        self._act(self.calibrator.take_unseen(stamp_ns(message.stamp), self._now_ns()))

    def _on_panel(self, message: PoseStamped) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
            check_not_ahead(message.header, self.get_clock())
            pose = transform_of_pose(message.pose)
        except ValueError as error:
            self.get_logger().error(f"panel/pose: {error}", throttle_duration_sec=5.0)
            return
        self._act(self.calibrator.take_panel(stamp_ns(message.header.stamp), pose, self._now_ns()))

    def _on_points(self, message: PointCloud2) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
            check_not_ahead(message.header, self.get_clock())
            points = FacePoints.of_rows(cloud_array(message, FACE_POINT_COLUMNS))
        except ValueError as error:
            self.get_logger().error(f"panel/points: {error}", throttle_duration_sec=5.0)
            return
        self._act(self.calibrator.take_points(stamp_ns(message.header.stamp), points, self._now_ns()))

    def _on_controls(self, message: MarkerArray) -> None:
        try:
            controls, _ = controls_of_message(message)
        except ValueError as error:
            self.get_logger().error(f"panel/controls: {error}", throttle_duration_sec=5.0)
            return
        self.calibrator.take_controls({c.name: np.array([*c.position_mm, c.height_mm]) / 1e3 for c in controls})

    def _on_pair(self, message: DiagnosticArray) -> None:
        try:
            check_not_ahead(message.header, self.get_clock())
            self.calibrator.take_pair(pair_of_message(message))
        except ValueError as error:
            self.get_logger().error(f"stylus/pair: {error}", throttle_duration_sec=5.0)

    def _on_settings(self, message: String) -> None:
        self._act(self.calibrator.take_settings(message.data, self._now_ns()))

    def _on_contact(self, message: PointStamped) -> None:
        self._act(self.calibrator.take_contact(point_array(message), message.header.frame_id, self._now_ns()))

    def _on_driver(self, message: String) -> None:
        self._act(self.calibrator.take_driver(plain(message.data), self._now_ns()))

    def _on_result(self, message: DiagnosticArray) -> None:
        if not self.calibrator.running:
            return
        try:
            answer = result_of_message(message)
        except ValueError as error:
            self.get_logger().error(f"result: {error}")
            return
        self._act(self.calibrator.take_result(answer, self._now_ns()))

    # Actions of the calibrator.

    def _act(self, actions: Iterable[Action]) -> None:
        for action in actions:
            match action:
                case SendCalibrationGoal():
                    self._goal.publish(point_message(action.xyz, header(action.stamp_ns, BASE)))
                case SetState():
                    values = code_values(self._topic, {})
                    self._diagnostics.tell(self.calibrator.level, action.text, [*self.calibrator.values(), *values])
                    self._state.publish(String(data=action.text))
                case SetAxes():
                    self._axes.publish(axes_message(action.base_from_reading))
                case SetSigma():
                    self._sigma.publish(Float32(data=action.sigma_m))
                case SetPose():
                    head = header(action.stamp_ns, CAMERA_LEFT)
                    self._transform.publish(transform_message(action.camera_from_base, head, BASE))
                case Keep():
                    self._keep()
                case LogNote(level="error"):  # rclpy requires a separate line of code for each level
                    self.get_logger().error(action.text)
                case LogNote(level="warn"):
                    self.get_logger().warning(action.text)
                case LogNote():
                    self.get_logger().info(action.text)

    def _keep(self) -> None:
        if self._live.config.calibration_file:
            try:
                self._save()
            except CalibrationRefused as error:
                self.get_logger().error(str(error))

    # Services: each returns its result as text, or raises CalibrationRefused.

    def _run(self) -> str:
        self._act(self.calibrator.run(self._now_ns()))
        return Message("calibration.calibrating_watch_state")

    def _solve(self) -> str:
        self._act(self.calibrator.solve(self._now_ns()))
        return self.calibrator.state

    def _save(self) -> str:
        path = self._live.config.calibration_file
        if not path:
            raise CalibrationRefused(Message("calibration.calibration_file_not_set"))
        if self.calibrator.stored is None:
            raise CalibrationRefused(Message("calibration.no_calibration_save"))
        try:
            save(self.calibrator.stored, Path(path))
        except OSError as error:
            raise CalibrationRefused(Message("calibration.calibration_could_not_saved", error=error)) from error
        return Message("calibration.saved", path=path)

    def _report(self) -> None:
        kept = self.calibrator
        self._act(kept.look_around(self._now_ns()))
        self._diagnostics.tell(kept.level, kept.state, [*kept.values(), *code_values(self._topic, {})])


def _answered(call: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message, response.success = answer_text(call()), True
        except CalibrationRefused as refusal:
            response.message, response.success = answer_text(str(refusal)), False
        return response

    return answer


def main() -> int:
    """Run the hand-eye node."""
    return run(HandEyeNode)


if __name__ == "__main__":
    raise SystemExit(main())
