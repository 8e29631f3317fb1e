"""Programs of the graph: what they report and log, which are late or have ended, and who records."""

from __future__ import annotations

import time
from functools import partial

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import Log, ParameterEvent
from rclpy.parameter import parameter_value_to_python

from icu_common.adapters.processes.hanging_programs import hanging_file, read_hanging
from icu_common.adapters.processes.process_identity import is_alive, process_number
from icu_common.adapters.processes.processor_load import LoadMeter
from icu_common.core.configuration.text_bounds import plain
from icu_common.core.reasons.codes import CODE, REASON, TOPIC
from icu_common.core.reasons.message import MESSAGE, Message
from icu_common.nodes import qos
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.heads import MAX_NAME, stamp_ns
from icu_common.nodes.messages.results import message_of, pairs_of
from icu_common.nodes.timers import every, seconds_of
from scope_ui_bridge.adapters.web.web_server import WebServer
from scope_ui_bridge.core.desk import Desk
from scope_ui_bridge.core.status import Condition, LivenessMonitor, Sender, judge
from scope_ui_bridge.nodes.checked_subscription import subscribe
from scope_ui_bridge.nodes.machine_inlets import STATES

SILENT_S = 5.0
"""Seconds without a report from which on a node counts as late; nodes report every second."""
_REPORTERS = {"hand_eye": "calibration", "serial_driver": "driver", "calibration_capture": "cameras"}
_MAX_VALUE = 200
"""Maximum number of characters shown of a changed parameter's name and value."""
_RECORDERS = ("bag_recorder", "rosbag2_recorder")
"""Prefixes of recorders' node names: of bag_record, and of `ros2 bag record`."""
_LEVELS = {20: "info", 30: "warn", 40: "error", 50: "fatal"}


class ProgramWatch:
    """Passes reports, log lines and changes of parameters to the desk, and logs which programs are late.

    The page's console shows these log messages, which it receives from /rosout.
    """

    def __init__(self, node: GraphNode, server: WebServer, desk: Desk) -> None:
        self._node = node
        self._server, self._mail = server, server.mailbox
        self._desk = desk
        self.liveness = LivenessMonitor(SILENT_S)
        self._stated = {node.resolve_topic_name(topic): part for part, topic in STATES.items()}
        self._hanging_file = hanging_file()
        self._load = LoadMeter()
        self._seconds = seconds_of(node)
        subscribe(node, DiagnosticArray, "/diagnostics", qos.RESULTS, self._on_facts)
        subscribe(node, Log, "/rosout", qos.RESULTS, self._on_log)
        subscribe(node, ParameterEvent, "/parameter_events", qos.RESULTS, self._on_parameters)
        every(node, 0.5, self._check_liveness)
        every(node, 1.0, self._look_for_recorders, wall=True)

    def close(self) -> None:
        """End the measurement of the processor's load."""
        self._load.finish()

    def _on_facts(self, message: DiagnosticArray) -> None:
        for status in message.status:
            name, facts = plain(status.name, MAX_NAME), pairs_of(status)
            sender = Sender(node=facts.get("node", ""), process=facts.get("process", ""))
            if self.liveness.heard(name, sender):
                self._node.get_logger().info(f"{name} reports again")
            part = next((part for reporter, part in _REPORTERS.items() if reporter in name), "")
            if part:
                shown = {name: value for name, value in facts.items() if name not in (CODE, MESSAGE, REASON, TOPIC)}
                self._mail.newest(f"facts {part}", self._desk.machine.set_facts, part, shown)
            if stated := self._stated.get(facts.get(TOPIC, "")):
                self._mail.each(self._desk.set_report, stated, plain(status.message), facts, message_of(status))

    def _on_log(self, message: Log) -> None:
        level = _LEVELS.get(message.level)
        # All robots of the domain share this topic; loggers have their nodes' names.
        mine = ".".join(self._node.get_namespace().split("/")[1:])
        if level and (not mine or message.name.startswith(f"{mine}.")):
            wall_ms = stamp_ns(message.stamp) // 1_000_000
            name, text = plain(message.name, MAX_NAME), plain(message.msg, 300)
            line = {"wall_ms": wall_ms, "level": level, "name": name, "text": text}
            self._mail.each(self._desk.said, line)

    def _on_parameters(self, message: ParameterEvent) -> None:
        # All robots of the domain share this topic.
        if not message.node.startswith(self._node.get_namespace()):
            return
        for changed in message.changed_parameters:
            if changed.name != "use_sim_time":  # a command-line program that follows the graph's clock
                value = str(parameter_value_to_python(changed.value))[:_MAX_VALUE]
                self._server.post(self._desk.parameters.changed, message.node, changed.name[:_MAX_VALUE], value)

    def _check_liveness(self) -> None:
        changes = self.liveness.check(self._seconds(), self._condition_of)
        late = [change for change in changes if change.condition is Condition.LATE]
        if late:
            silent_s, names = min(change.silent_s for change in late), ", ".join(change.name for change in late)
            self._load.describe(
                partial(self._report_late, Message("bridge.no_report_late", silent_s=silent_s, names=names))
            )
        for change in changes:
            if change.condition is Condition.ENDED:
                self._node.get_logger().error(f"{change.name} has ended")
            elif change.condition is Condition.HANGS:
                self._node.get_logger().fatal(f"{change.name} hangs: it gives no sign of life")

    def _report_late(self, text: str, load: str) -> None:
        self._node.get_logger().warning(f"{text}; {load}" if load else text)

    def _condition_of(self, sender: Sender) -> Condition:
        number = process_number(sender.process)
        nodes = {f"{place.rstrip('/')}/{name}" for name, place in self._node.get_node_names_and_namespaces()}
        return judge(
            alive=None if number is None else is_alive(number),
            hangs=number in read_hanging(self._hanging_file),
            in_graph=sender.node in nodes,
        )

    def _look_for_recorders(self) -> None:
        found = [
            f"{namespace.rstrip('/')}/{name}"
            for name, namespace in self._node.get_node_names_and_namespaces()
            if name.startswith(_RECORDERS) and name != self._server.recorder.node_name
        ]
        self._mail.newest("recorders", self._desk.recordings.seen, found, time.monotonic())
