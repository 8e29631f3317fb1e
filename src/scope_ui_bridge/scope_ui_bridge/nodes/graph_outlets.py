"""Orders to the graph, published from the server's thread.

rclpy's publishers and clients may be used from any thread, and a stop must not wait for the executor.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy.typing as npt
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Empty, Header, String
from std_srvs.srv import SetBool, Trigger

from icu_common.adapters.direct_stop.line import send_stop, stop_path
from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.core.reasons.message import Message
from icu_common.nodes import qos
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.answers import answer_of
from icu_common.nodes.messages.cameras import image_message
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import point_message
from icu_common.nodes.timers import runs_by_clock_topic
from scope_ui_bridge.adapters.graph_port import GraphUnavailable

_SERVICES = {
    "home": "gantry/home",
    "reset": "gantry/reset",
    "enable": "gantry/enable",
    "disable": "gantry/enable",
    "calibrate": "calibration/run",
    "accept_settings": "gantry/accept_settings",
    "add_sample": "calibration/add_sample",
    "solve": "calibration/solve",
    "save": "calibration/save",
}


class GraphOutlets:
    """The :class:`GraphPort` of the web server."""

    def __init__(self, node: GraphNode) -> None:
        self._node = node
        self._simulated = runs_by_clock_topic(node)
        self._goal = node.create_publisher(PointStamped, "gantry/goal", qos.COMMAND)
        self._command = node.create_publisher(String, "gantry/command", qos.COMMAND)
        self._teach_picture = node.create_publisher(Image, "panel/teach/image_raw", qos.RESULTS)
        self._teach_request = node.create_publisher(String, "panel/teach/request", qos.RESULTS)
        self._sequence = node.create_publisher(String, "gantry/sequence", qos.COMMAND)
        self._stop_request = node.create_publisher(Empty, "gantry/stop_request", qos.RESULTS)
        self._guard = stop_path(node.context.get_domain_id(), self._stop_request.topic_name)
        self._heartbeat = node.create_publisher(Header, "heartbeat", qos.RESULTS)
        self._stop_service = node.create_client(Trigger, "gantry/stop")
        self._enable_service = node.create_client(SetBool, "gantry/enable")
        self._triggers = {
            name: node.create_client(Trigger, topic) for name, topic in _SERVICES.items() if topic != "gantry/enable"
        }

    @property
    def runs_by_simulated_time(self) -> bool:
        return self._simulated

    def ros_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def stop(self, answered: Callable[[bool, str], None], cause: str = "stop") -> None:
        stopped = send_stop(
            self._guard, Message("driver.stop_requested")
        )  # first, because it does not need the middleware
        self._stop_request.publish(Empty())
        if self._stop_service.service_is_ready():
            asked = self._stop_service.call_async(Trigger.Request())
            asked.add_done_callback(lambda future: answered(True, ""))
        elif stopped:
            answered(True, "")
        elif self._stop_request.get_subscription_count() == 0:
            answered(False, Message("bridge.no_driver_listens"))
        self._node.get_logger().warning(cause)

    def heartbeat(self) -> None:
        self._heartbeat.publish(header(self.ros_ns(), self._node.get_fully_qualified_name()))

    def send_command(self, text: str) -> None:
        if self._command.get_subscription_count() == 0:
            raise GraphUnavailable(Message("sequence.no_gantry_controller_listens"))
        self._command.publish(String(data=text))

    def send_sequence(self, text: str) -> None:
        if self._sequence.get_subscription_count() == 0:
            raise GraphUnavailable(Message("bridge.no_sequencer_listens"))
        self._sequence.publish(String(data=text))

    def send_teaching(self, text: str, stamp_ns: int, encoding: str, picture: npt.NDArray[Any]) -> None:
        if not (self._teach_request.get_subscription_count() and self._teach_picture.get_subscription_count()):
            raise GraphUnavailable(Message("bridge.no_recognition_listens_could_taught"))
        self._teach_picture.publish(image_message(picture, encoding, header(stamp_ns, CAMERA_LEFT)))
        self._teach_request.publish(String(data=text))

    def send_goal(self, frame: str, point: tuple[float, float], stamp_ns: int) -> None:
        if self._goal.get_subscription_count() == 0:
            raise GraphUnavailable(Message("sequence.no_gantry_controller_listens"))
        self._goal.publish(point_message([*point, 0.0], header(stamp_ns, frame)))

    def call(self, service: str, answered: Callable[[bool, str], None]) -> None:
        switch = service in ("enable", "disable")
        client = self._enable_service if switch else self._triggers[service]
        if not client.service_is_ready():
            raise GraphUnavailable(Message("bridge.service_not", services=_SERVICES[service]))
        request = SetBool.Request(data=service == "enable") if switch else Trigger.Request()

        def done(future: Any) -> None:
            answer = future.result()
            answered(bool(answer.success), answer_of(answer.message))

        client.call_async(request).add_done_callback(done)
