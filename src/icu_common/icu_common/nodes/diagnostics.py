"""What a node tells of itself every second, on ``/diagnostics``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from icu_common.adapters.process_identity import own_process
from icu_common.nodes import qos
from icu_common.nodes.conversions import diagnostic_status, header

own_names: set[str] = set()
"""Of whom this process tells."""


def sender_values(node: Node) -> list[tuple[str, str]]:
    """Return the node and its process, by which the operator page sees whether a silent node is late or has ended."""
    return [("node", node.get_fully_qualified_name()), ("process", own_process())]


class Diagnostics:
    """Publishes a node's one status; ``name`` is the status's, the node's full name where none is given."""

    def __init__(self, node: Node, name: str = "") -> None:
        self._node, self._name = node, name or node.get_fully_qualified_name()
        own_names.add(self._name)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.RESULTS)

    def tell(self, level: str, message: str, values: Iterable[tuple[str, Any]]) -> None:
        """Publish it; ``level`` is ok, warn or error."""
        status = diagnostic_status(self._name, level, message, [*values, *sender_values(self._node)])
        head = header(self._node.get_clock().now().nanoseconds, "")
        self._publisher.publish(DiagnosticArray(header=head, status=[status]))
