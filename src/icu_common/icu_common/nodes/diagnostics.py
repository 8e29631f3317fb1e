"""What a node tells of itself every second, on ``/diagnostics``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from icu_common.nodes import qos
from icu_common.nodes.conversions import diagnostic_status, header

own_names: set[str] = set()
"""Of whom this process tells."""


class Diagnostics:
    """Publishes a node's one status; ``name`` is the status's, the node's full name where none is given."""

    def __init__(self, node: Node, name: str = "") -> None:
        self._node, self._name = node, name or node.get_fully_qualified_name()
        own_names.add(self._name)
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", qos.RESULTS)

    def tell(self, level: str, message: str, values: Iterable[tuple[str, Any]]) -> None:
        """Publish it; ``level`` is ok, warn or error."""
        status = diagnostic_status(self._name, level, message, values)
        head = header(self._node.get_clock().now().nanoseconds, "")
        self._publisher.publish(DiagnosticArray(header=head, status=[status]))
