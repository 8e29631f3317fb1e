"""Detects that simulated time has stopped: without its clock, no timeout of the graph expires."""

from __future__ import annotations

import time

from icu_common.core.reasons.message import Message
from icu_common.nodes.graph_node import GraphNode, this_process
from icu_common.nodes.timers import every

_SILENT_S = 5.0


class SimulatedClock:
    """Logs once that the simulation has ended or hangs, and when it goes on."""

    def __init__(self, node: GraphNode) -> None:
        self._node = node
        self._ros_ns, self._since_s, self._reported = 0, time.monotonic(), False
        if this_process.simulated:
            every(node, 0.5, self._check, wall=True)

    def _check(self) -> None:
        ros_ns, wall_s = int(self._node.get_clock().now().nanoseconds), time.monotonic()
        if ros_ns != self._ros_ns:
            if wall_s - self._since_s > _SILENT_S:
                self._node.get_logger().info("simulated time goes on")
            self._ros_ns, self._since_s, self._reported = ros_ns, wall_s, False
        elif wall_s - self._since_s > _SILENT_S and not self._reported:
            self._reported = True
            text = Message("page.simulated_time_stood_still_bench", silent_s=_SILENT_S)
            self._node.get_logger().error(text)
