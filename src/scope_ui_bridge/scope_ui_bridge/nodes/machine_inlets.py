"""Topics about the machine: states, position, calibration, paths and results."""

from __future__ import annotations

from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float32, Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.frames import CAMERA_LEFT, JOINTS
from icu_common.core.geometry.geometry import Transform
from icu_common.nodes import qos
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.heads import check_frame
from icu_common.nodes.messages.joints import joint_positions, trajectory_array
from icu_common.nodes.messages.places import axes_of_message, transform_of_message
from icu_common.nodes.messages.results import result_of_message
from icu_common.nodes.timers import every
from scope_ui_bridge.adapters.web.web_server import WebServer
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.nodes.checked_subscription import subscribe

STATES = {
    "controller": "gantry/state",
    "driver": "gantry/driver_state",
    "calibration": "calibration/state",
    "sequencer": "gantry/sequence_state",
}
"""Part -> topic of its state."""
_MAX_PATH = 200


class MachineInlets:
    """Passes reports of driver, controller, calibration and sequencer to the desk, in the server's thread.

    Parameters
    ----------
    node
        Subscribes to the topics.
    server, desk
        Receive what arrives.
    replay
        Whether a recorded session is shown.
    """

    def __init__(self, node: GraphNode, server: WebServer, desk: Desk, replay: bool) -> None:
        self._node = node
        self._server, self._mail = server, server.mailbox
        self._desk = desk
        self._axes = np.eye(2)
        self._withdrawn = False
        self._camera_from_base: Transform | None = None
        path = "gantry/recorded_trajectory" if replay else "gantry/trajectory"  # name in bag_play
        subscribe(node, JointTrajectory, path, qos.COMMAND, self._on_trajectory)
        self._state_inlets = {part: self._follow(part) for part in STATES}
        self._left: set[str] = set()
        """Parts whose state lost one of its publishers."""
        subscribe(node, TransformStamped, "calibration/camera_from_base", qos.LATCHED, self._on_calibration)
        subscribe(node, Float64MultiArray, "calibration/axes", qos.LATCHED, self._on_axes)
        subscribe(node, JointState, "joint_states", qos.SENSOR, self._on_joints)
        subscribe(node, Float32, "simulation_factor", qos.LATCHED, self._on_factor)
        subscribe(node, DiagnosticArray, "gantry/result", qos.RESULTS, self._on_result)
        subscribe(node, DiagnosticArray, "panel/teach/result", qos.RESULTS, self._on_taught)
        subscribe(node, DiagnosticArray, "gantry/sequence_result", qos.RESULTS, self._on_sequence_result)
        every(node, 1.0, self._check_states, wall=True)

    def _follow(self, part: str) -> Subscription:
        def take(message: String) -> None:
            self._mail.newest(part, self._desk.set_state, part, plain(message.data))

        def matched(info: Any) -> None:
            if info.current_count_change < 0 < info.current_count:
                self._left.add(part)

        events = SubscriptionEventCallbacks(matched=matched)
        return subscribe(self._node, String, STATES[part], qos.LATCHED, take, event_callbacks=events)

    def _check_states(self) -> None:
        # The last state may be that of the program that left: receive the remaining one's latched state again.
        for part in self._left:
            self._node.destroy_subscription(self._state_inlets[part])
            self._state_inlets[part] = self._follow(part)
        self._left.clear()
        # The latched state of a node that has ended no longer applies.
        for part, topic in STATES.items():
            if self._node.count_publishers(self._node.resolve_topic_name(topic)) == 0:
                self._mail.newest(part, self._desk.set_state, part, "")

    def _on_trajectory(self, message: JointTrajectory) -> None:
        readings = trajectory_array(message, JOINTS)[:_MAX_PATH]
        path = np.column_stack([readings[:, :2] @ self._axes.T, -readings[:, 2]])
        self._mail.newest("path", self._desk.tip_path.publish, path)

    def _on_calibration(self, message: TransformStamped) -> None:
        check_frame(message.header, CAMERA_LEFT)
        self._camera_from_base = transform_of_message(message)
        self._use_calibration()

    def _on_axes(self, message: Float64MultiArray) -> None:
        axes = axes_of_message(message)
        self._withdrawn, self._axes = axes is None, np.eye(2) if axes is None else axes
        self._use_calibration()

    def _use_calibration(self) -> None:
        # Empty axes: the calibration was withdrawn. Its transform is still latched, and may arrive after them.
        known = None if self._withdrawn else self._camera_from_base
        self._mail.newest("calibrated", setattr, self._desk.scene, "camera_from_base", known)

    def _on_joints(self, message: JointState) -> None:
        reading = joint_positions(message, JOINTS)
        x, y = self._axes @ reading[:2]
        position = float(x), float(y), float(reading[2])
        self._mail.newest("joints", self._server.post_value, self._desk.machine.set_position, *position)

    def _on_factor(self, message: Float32) -> None:
        self._mail.newest("factor", self._desk.machine.set_simulation_factor, float(message.data))

    def _on_result(self, message: DiagnosticArray) -> None:
        self._server.post(self._desk.answers.result, result_of_message(message))

    def _on_sequence_result(self, message: DiagnosticArray) -> None:
        self._server.post(self._desk.answers.sequence_result, result_of_message(message))

    def _on_taught(self, message: DiagnosticArray) -> None:
        self._server.post(self._desk.answers.taught, result_of_message(message))
