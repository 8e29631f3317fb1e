"""ROS node of the gantry controller: messages become events, actions become messages; decisions are in core.

An unexpected error stops the machine, aborts the goal, and ends the process with a traceback and an exit code above 0,
because the controller's state cannot be trusted after it. Bring-up starts a new controller, which first requests a stop
if the stylus was left extended.
"""

from __future__ import annotations

import contextlib
import time
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped, TransformStamped
from rclpy.duration import Duration
from sensor_msgs.msg import CameraInfo, JointState
from std_msgs.msg import Bool, Empty, Float32, Float64MultiArray, Header, String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from gantry_driver.core.goals.controller import Controller
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.machine.attendance import SIGN_S
from gantry_driver.core.motion.scene import PanelMap
from gantry_driver.nodes.panel_plane import plane_message
from icu_common.adapters.processes.processor_load import LoadMeter
from icu_common.adapters.real_time import steady_s
from icu_common.core.admission.heartbeats import HeartbeatSources
from icu_common.core.admission.sources import rivals_text
from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, JOINT_STYLUS, JOINTS, PANEL
from icu_common.core.goals.intent import frame_of
from icu_common.core.goals.results import GoalResult
from icu_common.core.processes.delays import is_delayed, with_load
from icu_common.core.reasons.codes import CODE
from icu_common.core.reasons.message import Message, quoted
from icu_common.core.reasons.state_text import state_name
from icu_common.nodes import qos
from icu_common.nodes.admission.sources import Judge, SourceWatch
from icu_common.nodes.alignment.layout_message import layout_of_message
from icu_common.nodes.alignment.pair_message import pair_of_message
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode, this_process
from icu_common.nodes.messages.cameras import camera_model, same_camera
from icu_common.nodes.messages.heads import MAX_NAME, check_frame, check_not_ahead, header, stamp_ns
from icu_common.nodes.messages.joints import joint_contact, joint_positions, trajectory_message
from icu_common.nodes.messages.panels import controls_of_message, panel_state_of_message
from icu_common.nodes.messages.places import (
    axes_of_message,
    point_array,
    point_message,
    transform_of_message,
    transform_of_pose,
)
from icu_common.nodes.messages.results import result_message, result_of_message
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.state_codes import StateCodes, code_values
from icu_common.nodes.timers import every

TICK_S, WALL_TICK_S = 0.05, 0.1
DIAGNOSTICS_S = 1.0
LEVELS = {"stopped": "error", "alarm": "error", "waiting": "warn"}
"""Level of the report on /diagnostics by the name of the state; ok for every other state."""
LAST_WORDS = Duration(seconds=0.3)


class ControllerNode(GraphNode):
    """Takes goals and gestures, sends trajectories, answers every goal."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("gantry_controller", **kwargs)
        self._live = LiveParameters(self, ControllerConfig, self._on_config, unrest=lambda: self._controller.unrest())
        config = self._live.config
        self._controller = Controller(config)
        # Otherwise ROS time is wall time, or that of a recording, which includes the heartbeats.
        self._wall_ns = (lambda: round(1e9 * steady_s())) if this_process.simulated else self._now_ns
        self._sources = SourceWatch(self, self._on_sources)
        self._heartbeats = HeartbeatSources(config.heartbeat_programs)
        self._camera: tuple[CameraInfo, CameraModel] | None = None
        self._load = LoadMeter()
        self._trajectory = self.create_publisher(JointTrajectory, "trajectory", qos.COMMAND)
        self._result = self.create_publisher(DiagnosticArray, "result", qos.RESULTS)
        self._state = self.create_publisher(String, "state", qos.LATCHED)
        self._target = self.create_publisher(PointStamped, "target", qos.LATCHED)
        self._stop = self.create_publisher(Empty, "stop_request", qos.RESULTS)
        self._clear = self.create_publisher(PointStamped, "stylus_seen_clear", qos.RESULTS)
        self._attending = self.create_publisher(Bool, "attending", qos.RESULTS)
        self._attended = False
        self._plane = self.create_publisher(PoseWithCovarianceStamped, "panel/plane", qos.LATCHED)
        self._diagnostics = Diagnostics(self, "gantry controller")
        self._driver_codes = StateCodes(self, "driver_state")
        self._hear(String, "driver_state", qos.EACH_LATCHED, self._driver_state)
        self._hear(
            JointState,
            "joint_states",
            qos.SENSOR,
            lambda m: msg.Joints(readings=joint_positions(m, JOINTS), probe=joint_contact(m, JOINT_STYLUS)),
        )
        self._hear(
            DiagnosticArray,
            "trajectory_result",
            qos.RESULTS,
            lambda m: msg.MotionResult(result=result_of_message(m)),
        )
        self._see(PoseStamped, "panel/pose", qos.LATCHED, _panel_pose)
        self._hear(MarkerArray, "panel/controls", qos.LATCHED, _panel_controls)
        self._hear(Float32, "panel/confidence", qos.SENSOR, lambda m: msg.PanelConfidence(value=m.data))
        self._hear(String, "panel/alarm", qos.LATCHED, lambda m: msg.PanelAlarm(text=plain(m.data)))
        self._see(DiagnosticArray, "panel/state", qos.SENSOR, lambda m: msg.PanelState(seen=panel_state_of_message(m)))
        self._hear(TransformStamped, "calibration/camera_from_base", qos.LATCHED, _camera_from_base)
        self._hear(Float64MultiArray, "calibration/axes", qos.LATCHED, _axes)
        self._hear(Float32, "calibration/sigma", qos.LATCHED, lambda m: msg.CalibrationSigma(value_m=m.data))
        self._see(DiagnosticArray, "stylus/pair", qos.LATCHED, lambda m: msg.PairSeen(pair=pair_of_message(m)))
        self._hear(
            DiagnosticArray, "stylus/layout", qos.LATCHED, lambda m: msg.LayoutSeen(deviations=layout_of_message(m))
        )
        self._see(PointStamped, "stylus/tip", qos.SENSOR, _tip)
        self._see(Header, "stylus/unseen", qos.SENSOR, lambda m: msg.TipUnseen(stamp_ns=stamp_ns(m.stamp)))
        self._see(CameraInfo, "camera_info", qos.SENSOR, self._camera_seen)
        self._hear(Header, "heartbeat", qos.SENSOR, self._beat, self._heartbeats.judge)
        self._sources.watch_clock()
        # Last: after a blockage, executors other than our own take waiting messages in this order.
        self._take(PointStamped, "goal", qos.COMMAND, _point_goal)
        self._take(String, "command", qos.COMMAND, lambda m: msg.Command(text=m.data))
        every(self, TICK_S, self._tick)
        if this_process.simulated:  # detects the end of the heartbeat even while simulated time is paused
            every(self, WALL_TICK_S, self._tick, wall=True)
        every(self, SIGN_S, self._attend)
        every(self, DIAGNOSTICS_S, self._diagnose)
        self._handle(msg.Tick())

    def close(self) -> None:
        """Hold the machine if a goal is in progress, and report that the controller has ended."""
        self._act(self._controller.close(self._now_ns()))
        self._load.finish()

    def _driver_state(self, message: String) -> msg.Event:
        return msg.DriverState(text=self._driver_codes.message_of(plain(message.data)))

    def _hear(
        self,
        message_type: Any,
        topic: str,
        profile: Any,
        convert: Callable[[Any], msg.Event],
        judge: Judge = rivals_text,
    ) -> None:
        """Subscribe to a topic for one source; a second source stops the machine."""
        self._sources.subscribe(message_type, topic, self._callback(topic, convert), profile, judge)

    def _take(self, message_type: Any, topic: str, profile: Any, convert: Callable[[Any], msg.Event]) -> None:
        """Subscribe to a topic that any program may publish."""
        self.create_subscription(message_type, topic, self._callback(topic, convert), profile)

    def _callback(self, topic: str, convert: Callable[[Any], msg.Event]) -> Callable[[Any], None]:
        def callback(message: Any) -> None:
            with self._stopping_on_error():
                try:
                    event = convert(message)
                except ValueError as error:
                    self.get_logger().error(f"{topic}: ignored: {plain(str(error))}", throttle_duration_sec=5.0)
                    return
                self._handle(event)

        return callback

    def _on_sources(self, topic: str, text: str) -> None:
        if not text:
            self.get_logger().info(f"{topic} has one source again")
        with self._stopping_on_error():
            self._handle(msg.Rivals(topic=topic, text=text))

    def _beat(self, message: Header) -> msg.Event:
        if self._heartbeats.heard(message.frame_id, time.monotonic()):
            self._sources.look("heartbeat")
        stamp = stamp_ns(message.stamp)
        # As in the driver, a heartbeat without a stamp, or with one from the future, counts as new.
        return msg.OperatorHeartbeat(age_ns=max(0, self._now_ns() - stamp) if stamp else 0)

    def _see(self, message_type: Any, topic: str, profile: Any, convert: Callable[[Any], msg.Event]) -> None:
        """Subscribe to results of images; ignore stamps in the future, which would count as recent for too long."""

        def seen(message: Any) -> msg.Event:
            check_not_ahead(message if isinstance(message, Header) else message.header, self.get_clock())
            return convert(message)

        self._hear(message_type, topic, profile, seen)

    def _camera_seen(self, message: CameraInfo) -> msg.Event:
        # Every image repeats the same calibration; unpacking it each time would be most of this node's work.
        if self._camera is None or not same_camera(self._camera[0], message):
            self._camera = (message, camera_model(message, "left"))
        return msg.CameraSeen(camera=self._camera[1], stamp_ns=stamp_ns(message.header.stamp))

    def _on_config(self, config: ControllerConfig) -> None:
        self._controller.config = config

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _tick(self) -> None:
        with self._stopping_on_error():
            self._handle(msg.Tick())

    @contextlib.contextmanager
    def _stopping_on_error(self) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            self.get_logger().fatal(traceback.format_exc())
            self._act(
                self._controller.fail(Message("controller.error_controller", error=quoted(error)), self._now_ns())
            )
            self._stop.wait_for_all_acked(LAST_WORDS)
            raise

    def _handle(self, event: msg.Event) -> None:
        self._act(self._controller.handle(event, self._now_ns(), self._wall_ns()))
        if bool(self._controller.goal) != self._attended:
            self._attend()

    def _attend(self) -> None:
        """Signal to the driver that a goal is in progress, or release the machine."""
        attends, before = bool(self._controller.goal), self._attended
        self._attended = attends
        if attends or before:
            self._attending.publish(Bool(data=attends))

    def _act(self, actions: list[msg.Action]) -> None:
        for action in actions:
            match action:
                case msg.SendTrajectory():
                    # Readings have no frame, so the frame id carries the intent of the trajectory for the driver.
                    head = header(action.stamp_ns, frame_of(action.intent))
                    path = action.path
                    self._trajectory.publish(trajectory_message(JOINTS, path.points, path.times_s, head))
                case msg.PublishResult():
                    self._answer(action.result)
                case msg.ReportDelay():
                    self._load.describe(
                        partial(
                            self._report_delay, Message("text.and_also", first=action.delay.text(), second=action.then)
                        )
                    )
                case msg.PublishState():
                    self._diagnose()  # before the text, whose code other programs look for there
                    self._state.publish(String(data=action.text))
                case msg.ShowTarget():
                    self._target.publish(point_message(action.in_base, header(self._now_ns(), BASE)))
                case msg.ReportClear():
                    place = np.array([0.0, 0.0, action.height_m])
                    self._clear.publish(point_message(place, header(self._now_ns(), PANEL)))
                case msg.ReportPlane():
                    self._plane.publish(plane_message(action.plane, action.stamp_ns))
                case msg.CallStop():
                    self.get_logger().error(f"stop: {action.reason}")
                    self._stop.publish(Empty())

    def _answer(self, answer: GoalResult) -> None:
        """Publish a result; if lateness is its cause, add the programs that use the processor."""
        if is_delayed(answer):
            self._load.describe(lambda load: self._publish(with_load(answer, load)))
        else:
            self._publish(answer)

    def _publish(self, answer: GoalResult) -> None:
        self.get_logger().info(f"{answer.goal}: {answer.outcome.value} {answer.reason}".rstrip())
        self._result.publish(result_message(answer, self._now_ns()))

    def _report_delay(self, text: str, load: str) -> None:
        self.get_logger().warning(f"{text}; {load}" if load else text)

    def _diagnose(self) -> None:
        controller = self._controller
        counts = [(outcome.value, count) for outcome, count in controller.counts.items()]
        level = LEVELS.get(state_name(controller.state), "ok")
        values = [("phase", controller.phase.value), ("goal", controller.goal), *counts]
        values += code_values(self._state.topic_name, {CODE: controller.code.value})
        self._diagnostics.tell(level, controller.state, values)


def _point_goal(message: PointStamped) -> msg.Event:
    stamp = stamp_ns(message.header.stamp)
    return msg.PointGoal(frame=plain(message.header.frame_id, MAX_NAME), xyz=point_array(message), stamp_ns=stamp)


def _panel_pose(message: PoseStamped) -> msg.Event:
    check_frame(message.header, CAMERA_LEFT)
    pose = transform_of_pose(message.pose)
    return msg.PanelPose(camera_from_panel=pose, stamp_ns=stamp_ns(message.header.stamp))


def _panel_controls(message: MarkerArray) -> msg.Event:
    for marker in message.markers:
        check_frame(marker.header, PANEL)
    return msg.PanelControls(panel=PanelMap.of(*controls_of_message(message)))


def _camera_from_base(message: TransformStamped) -> msg.Event:
    check_frame(message.header, CAMERA_LEFT)
    if message.child_frame_id != BASE:
        raise ValueError(
            Message("controller.child_frame_needed", child_frame_id=quoted(message.child_frame_id), base=quoted(BASE))
        )
    return msg.CameraFromBase(transform=transform_of_message(message))


def _axes(message: Float64MultiArray) -> msg.Event:
    return msg.Axes(base_from_reading=axes_of_message(message))


def _tip(message: PointStamped) -> msg.Event:
    check_frame(message.header, CAMERA_LEFT)
    return msg.TipSeen(in_camera=point_array(message), stamp_ns=stamp_ns(message.header.stamp))


def main() -> int:
    return run(ControllerNode, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
