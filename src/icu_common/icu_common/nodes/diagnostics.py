"""Status that a node publishes every second on ``/diagnostics``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from icu_common.adapters.processes.process_identity import own_process
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.results import diagnostic_status

own_names: set[str] = set()
"""Names of the nodes this process reports on."""


def sender_values(node: Node) -> list[tuple[str, str]]:
    """Return the node and its process, so that the operator page can distinguish late from ended nodes."""
    return [("node", node.get_fully_qualified_name()), ("process", own_process())]


class Diagnostics:
    """Publishes the status of a node; ``name`` is the name of the status, by default the node's full name."""

    def __init__(self, node: Node, name: str = "") -> None:
        self._node, self._name = node, name or node.get_fully_qualified_name()
        own_names.add(self._name)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.RESULTS)

    def tell(self, level: str, message: str, values: Iterable[tuple[str, Any]]) -> None:
        """Publish the status; ``level`` is ok, warn or error."""
        status = diagnostic_status(self._name, level, message, [*values, *sender_values(self._node)])
        head = header(self._node.get_clock().now().nanoseconds, "")
        self._publisher.publish(DiagnosticArray(header=head, status=[status]))
