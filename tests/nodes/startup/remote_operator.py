"""An operator's side on another host: a heartbeat, services and goals.

Lines on stdin: ``{"call": "gantry/home"}``, ``{"enable": true}``, ``{"go": [x_m, y_m]}``. Lines on stdout:
``{"state": "idle"}``, ``{"answer": "gantry/home", "success": true}``, ``{"sent": "17"}``, ``{"result": "reached"}`` ...
"""

from __future__ import annotations

import json
import os
import select
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import Header, String
from std_srvs.srv import SetBool, Trigger

from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import point_message
from icu_common.nodes.messages.results import result_of_message
from icu_common.nodes.runtime import ros_session


def say(**what: Any) -> None:
    print(json.dumps(what), flush=True)


class RemoteOperator(Node):
    def __init__(self) -> None:
        super().__init__("remote_operator")
        self._heartbeat = self.create_publisher(Header, "operator/heartbeat", qos.COMMAND)
        self._goal = self.create_publisher(PointStamped, "gantry/goal", qos.COMMAND)
        self.create_subscription(String, "gantry/driver_state", lambda m: say(state=m.data), qos.LATCHED)
        self.create_subscription(DiagnosticArray, "gantry/result", self._on_result, qos.RESULTS)
        self.create_timer(0.1, self._beat)
        self._listeners = -1

    def _beat(self) -> None:
        self._heartbeat.publish(Header(stamp=self.get_clock().now().to_msg(), frame_id="operator"))
        if (now := self._heartbeat.get_subscription_count()) != self._listeners:
            self._listeners = now
            say(listeners=now)

    def _on_result(self, message: DiagnosticArray) -> None:
        result = result_of_message(message)
        say(result=result.outcome.value, id=result.goal_id, reason=result.reason)

    def do(self, order: dict[str, Any]) -> None:
        if "go" in order:
            x_m, y_m = order["go"]
            stamp = self.get_clock().now().nanoseconds
            self._goal.publish(point_message((x_m, y_m, 0.0), header(stamp, "base_link")))
            say(sent=str(stamp))
        elif "enable" in order:
            self._call("gantry/enable", SetBool, SetBool.Request(data=order["enable"]))
        else:
            self._call(order["call"], Trigger, Trigger.Request())

    def _call(self, name: str, kind: Any, request: Any) -> None:
        client = self.create_client(kind, name)
        if not client.service_is_ready():  # discovery takes a while; the test asks again
            say(answer=name, success=False, message="the service is not there")
            return
        client.call_async(request).add_done_callback(
            lambda f: say(answer=name, success=f.result().success, message=f.result().message)
        )


def main() -> None:
    os.set_blocking(sys.stdin.fileno(), False)
    partial = b""
    with ros_session() as session:
        node = RemoteOperator()
        session.executor.add_node(node)
        while session.goes_on:
            session.spin(0.02)
            if select.select([sys.stdin], [], [], 0.0)[0]:
                data = os.read(sys.stdin.fileno(), 4096)
                if not data:
                    break
                *lines, partial = (partial + data).split(b"\n")
                for line in lines:
                    node.do(json.loads(line))
        session.end(node)


if __name__ == "__main__":
    main()
