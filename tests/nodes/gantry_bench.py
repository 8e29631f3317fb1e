"""The graph around the gantry controller as plain publishers: a machine that obeys at once, cameras, an operator."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped
from sensor_msgs.msg import CameraInfo, JointState
from std_msgs.msg import Empty, Float32, Float64MultiArray, Header, String
from support.pinhole import pinhole
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from gantry_driver.nodes.controller_node import ControllerNode
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, JOINTS, PANEL
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.panel_layout import Control, PanelLayout
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.joints import joint_message
from icu_common.nodes.messages.panels import controls_message
from icu_common.nodes.messages.places import point_message, pose_message, transform_message
from icu_common.nodes.messages.results import result_message, result_of_message

REMAPS = [
    "--ros-args",
    *(
        part
        for name, target in {
            "panel/pose": "/panel/pose",
            "panel/controls": "/panel/controls",
            "panel/confidence": "/panel/confidence",
            "panel/alarm": "/panel/alarm",
            "calibration/camera_from_base": "/calibration/camera_from_base",
            "calibration/axes": "/calibration/axes",
            "calibration/sigma": "/calibration/sigma",
            "panel/plane": "/panel/plane",
            "stylus/tip": "/stylus/tip",
            "stylus/unseen": "/stylus/unseen",
            "joint_states": "/joint_states",
            "heartbeat": "/operator/heartbeat",
            "camera_info": "/stereo/left/camera_info",
        }.items()
        for part in ("-r", f"{name}:={target}")
    ),
]
# The camera looks straight down on the panel from 0.6 m; its x is base x, its y is minus base y.
CAMERA_FROM_BASE = Transform(np.diag([1.0, -1.0, -1.0]), np.array([-0.15, 0.10, 0.57]))
BASE_FROM_PANEL = Transform(np.eye(3), np.array([0.02, 0.025, -0.035]))
CAMERA_FROM_PANEL = CAMERA_FROM_BASE @ BASE_FROM_PANEL
CAMERA = pinhole()
LAYOUT = PanelLayout(
    model="test",
    title="test",
    size_mm=(320.0, 150.0),
    colour="#303438",
    controls=(
        Control(name="RUN_STOP", kind="button", position_mm=(208.0, 127.0), size_mm=(16.0, 9.0), height_mm=3.0),
        Control(name="CH1_IN", kind="connector", position_mm=(211.0, 13.0), size_mm=(14.0, 14.0), height_mm=12.0),
    ),
    artwork=(),
)
RUN_STOP = BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])
BALL_M, KEY_END_M = 0.002, 0.0015
KEY_TRAVEL_M = 0.0023
"""Of a first press, which ends with the spring compressed by 0.8 mm: nothing deeper is needed."""
PRESSED = np.array([*RUN_STOP[:2], -(RUN_STOP[2] + BALL_M) + KEY_TRAVEL_M])
"""Readings of that press."""

# Everything here shares one thread and, in a full test run, a busy machine: no deadline may be near.
PATIENCE = {
    "heartbeat_timeout_s": 2.0,
    "joints_timeout_s": 5.0,
    "camera_timeout_s": 5.0,
    "panel_max_age_s": 20.0,
    "goal_max_age_s": 5.0,
    "look_timeout_s": 20.0,
    "press_max_s": 5.0,
    "picture_wait_s": 10.0,
    "motion_timeout_s": 20.0,
}


class GantryBench:
    """The controller under test, and everything around it with the names of the whole graph."""

    def __init__(self, ros: Any, parameters: dict[str, Any] | None = None, *, heartbeat: bool = True) -> None:
        self.ros = ros
        self.readings = np.zeros(3)
        self.tip_error: Array = np.zeros(3)
        self.ahead_s = 0.0
        """Of the cameras' clock."""
        self.late_s = 0.0
        """After an image arrives all that comes of it."""
        self._images: deque[tuple[int, int]] = deque()
        self.heartbeat = heartbeat
        self.obey = True
        self.trajectories: list[JointTrajectory] = []
        self.controller = ros.node(
            ControllerNode, {**PATIENCE, **(parameters or {})}, namespace="gantry", cli_args=REMAPS
        )
        self.node = node = ros.plain("around")
        self.joints = node.create_publisher(JointState, "/joint_states", qos.RESULTS)
        self.driver_state = node.create_publisher(String, "/gantry/driver_state", qos.LATCHED)
        self.trajectory_result = node.create_publisher(DiagnosticArray, "/gantry/trajectory_result", qos.RESULTS)
        self.pose = node.create_publisher(PoseStamped, "/panel/pose", qos.LATCHED)
        self.controls = node.create_publisher(MarkerArray, "/panel/controls", qos.LATCHED)
        self.confidence = node.create_publisher(Float32, "/panel/confidence", qos.RESULTS)
        self.calibration = node.create_publisher(TransformStamped, "/calibration/camera_from_base", qos.LATCHED)
        self.axes = node.create_publisher(Float64MultiArray, "/calibration/axes", qos.LATCHED)
        self.tip = node.create_publisher(PointStamped, "/stylus/tip", qos.SENSOR)
        self.camera = node.create_publisher(CameraInfo, "/stereo/left/camera_info", qos.RESULTS)
        self.beat = node.create_publisher(Header, "/operator/heartbeat", qos.RESULTS)
        self.goal = node.create_publisher(PointStamped, "/gantry/goal", qos.COMMAND)
        self.command = node.create_publisher(String, "/gantry/command", qos.COMMAND)
        self.messages = ros.collect(node, DiagnosticArray, "/gantry/result", qos.RESULTS)
        self.states = ros.collect(node, String, "/gantry/state", qos.LATCHED)
        self.targets = ros.collect(node, PointStamped, "/gantry/target", qos.LATCHED)
        self.stops = ros.collect(node, Empty, "/gantry/stop_request", qos.RESULTS)
        node.create_subscription(JointTrajectory, "/gantry/trajectory", self._on_trajectory, qos.COMMAND)
        self.driver_state.publish(String(data="idle"))
        node.create_timer(0.1, self._publish)
        node.create_timer(0.2, self._beat)

    def see(self) -> None:
        """Publish what is latched: the calibration and the panel's controls."""
        now = self.now_ns()
        self.calibration.publish(transform_message(CAMERA_FROM_BASE, header(now, CAMERA_LEFT), BASE))
        self.axes.publish(Float64MultiArray(data=[1.0, 0.0, 0.0, 1.0]))
        self.controls.publish(controls_message(LAYOUT, header(now, PANEL)))

    def now_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def _publish(self) -> None:
        now = self.now_ns()
        self.joints.publish(joint_message(JOINTS, self.readings, header(now, "")))
        self._images.append((now + int(self.late_s * 1e9), now))
        while self._images and self._images[0][0] <= now:
            self._publish_image(self._images.popleft()[1])

    def _publish_image(self, taken_ns: int) -> None:
        seen = header(taken_ns + int(self.ahead_s * 1e9), CAMERA_LEFT)
        self.camera.publish(camera_info_message(CAMERA, seen))
        self.pose.publish(pose_message(CAMERA_FROM_PANEL, seen))
        self.confidence.publish(Float32(data=0.9))
        tip = self.readings * [1, 1, -1] + self.tip_error
        x, y, _ = BASE_FROM_PANEL.inverse().apply(tip)
        over_key = abs(x - 0.208) < 0.008 and abs(y - 0.127) < 0.0045
        # The ball is stopped by the face, or by the key at the end of its stroke.
        tip[2] = max(tip[2], BASE_FROM_PANEL.translation[2] + BALL_M + (KEY_END_M if over_key else 0.0))
        self.tip.publish(point_message(CAMERA_FROM_BASE.apply(tip), seen))

    def _beat(self) -> None:
        if self.heartbeat:
            self.beat.publish(Header())

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self.trajectories.append(message)
        if not self.obey:
            return
        self.readings = np.array(message.points[-1].positions)
        identity = str(stamp_ns(message.header.stamp))
        for outcome in (Outcome.ACCEPTED, Outcome.REACHED):
            result = GoalResult(goal_id=identity, goal="trajectory", outcome=outcome)
            self.trajectory_result.publish(result_message(result, self.now_ns()))

    @property
    def state(self) -> str:
        return self.states[-1].data if self.states else ""

    @property
    def results(self) -> list[GoalResult]:
        return [result_of_message(m) for m in self.messages]

    def spin_until_state(self, state: str, within_s: float = 20.0) -> None:
        self.ros.spin_until(lambda: self.state == state, within_s, lambda: self.state)

    def spin_until_final(self, count: int = 1, within_s: float = 30.0) -> GoalResult:
        def finals() -> list[GoalResult]:
            return [r for r in self.results if r.outcome.final]

        self.ros.spin_until(lambda: len(finals()) >= count, within_s, lambda: (self.state, self.results))
        return finals()[count - 1]

    def connect_goals(self) -> None:
        """Wait until the controller has its subscriptions, and its answers arrive."""
        self.ros.spin_until(lambda: self.goal.get_subscription_count() and self.command.get_subscription_count(), 20.0)
        self.ros.spin_until(lambda: self.node.count_publishers("/gantry/result"), 20.0)
