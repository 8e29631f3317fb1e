"""Topics about what is in the image: cameras, panel, stylus and target."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Float32
from visualization_msgs.msg import MarkerArray

from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.core.panel.panel_layout import Control
from icu_common.nodes import qos
from icu_common.nodes.camera_info import CameraInfoSubscription
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.cameras import camera_model
from icu_common.nodes.messages.heads import check_frame
from icu_common.nodes.messages.panels import controls_of_message, panel_state_of_message
from icu_common.nodes.messages.places import point_array, transform_of_pose
from scope_ui_bridge.adapters.web.web_server import WebServer
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.video import Face, labels_of
from scope_ui_bridge.nodes.arrival import Arrival
from scope_ui_bridge.nodes.checked_subscription import subscribe


class SceneInlets:
    """Passes geometry and the recognition's results to the desk, in the server's thread.

    Parameters
    ----------
    node
        Subscribes to the topics.
    server, desk
        Receive what arrives.
    arrival
        Stamps of messages.
    labels
        Labels of the panel's controls by their names, as written in its layout.
    """

    def __init__(
        self, node: GraphNode, server: WebServer, desk: Desk, arrival: Arrival, labels: Mapping[str, str]
    ) -> None:
        self._node = node
        self._server, self._mail = server, server.mailbox
        self._desk, self._scene = desk, desk.scene
        self._arrival = arrival
        self._labels = labels
        self._subscribe_camera("left")
        self._subscribe_camera("right")
        subscribe(node, PoseStamped, "panel/pose", qos.LATCHED, self._on_pose)
        subscribe(node, MarkerArray, "panel/controls", qos.LATCHED, self._on_controls)
        subscribe(node, DiagnosticArray, "panel/state", qos.SENSOR, self._on_panel)
        subscribe(node, Float32, "panel/confidence", qos.SENSOR, self._on_confidence)
        subscribe(node, PointStamped, "stylus/tip", qos.SENSOR, self._on_tip)
        subscribe(node, PointStamped, "gantry/target", qos.LATCHED, self._on_target)

    def _subscribe_camera(self, side: str) -> None:
        def changed(message: CameraInfo) -> None:
            try:
                self._on_camera(side, message)
            except ValueError as error:
                self._node.get_logger().error(f"{side}/camera_info: ignored: {error}", throttle_duration_sec=5.0)
                cameras.again()

        cameras = CameraInfoSubscription(self._node, f"{side}/camera_info", qos.SENSOR, changed)

    def _on_camera(self, side: str, message: CameraInfo) -> None:
        model = camera_model(message, side) if message.k[0] else None  # CameraInfo.msg: 0 is "uncalibrated"
        if model is None:
            self._node.get_logger().info(f"the {side} camera is not calibrated: no control is drawn in its picture")
        self._mail.each(self._set, {side: model})

    def _on_pose(self, message: PoseStamped) -> None:
        check_frame(message.header, CAMERA_LEFT)
        self._mail.newest("pose", self._scene.place_panel, transform_of_pose(message.pose))

    def _on_controls(self, message: MarkerArray) -> None:
        controls, outline = controls_of_message(message)
        labels = labels_of((control.name for control in controls), self._labels)
        faces = tuple(_face(control, labels[control.name]) for control in controls)
        self._mail.newest("controls", self._set, {"faces": faces, "outline": outline})

    def _on_panel(self, message: DiagnosticArray) -> None:
        seen = panel_state_of_message(message)
        self._mail.newest("panel", self._server.post_value, self._desk.panel.show, seen)

    def _on_confidence(self, message: Float32) -> None:
        confidence = float(message.data)
        self._mail.newest("confidence", self._server.post_value, self._desk.machine.set_confidence, confidence)

    def _on_tip(self, message: PointStamped) -> None:
        check_frame(message.header, CAMERA_LEFT)
        self._mail.newest("tip", self._set_tip, point_array(message), self._arrival.stamp_ns(message))

    def _on_target(self, message: PointStamped) -> None:
        self._mail.newest("target", setattr, self._scene, "target", (message.header.frame_id, point_array(message)))

    def _set(self, values: dict[str, Any]) -> None:
        for name, value in values.items():
            setattr(self._scene, name, value)
        self._scene.changed()

    def _set_tip(self, point: Any, stamp: int) -> None:
        self._scene.tip, self._scene.tip_ns = point, stamp


def _face(control: Control, label: str) -> Face:
    x, y, z = (v * 1e-3 for v in (*control.position_mm, control.height_mm))
    width, height = (v * 1e-3 for v in control.size_mm)
    circle = control.shape == "circle"
    return Face(
        name=control.name, kind=control.kind, label=label, circle=circle, centre=(x, y, z), size=(width, height)
    )
