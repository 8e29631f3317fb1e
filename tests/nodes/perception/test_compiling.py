"""A node whose code is compiled at its first start says so: that takes a minute or more in which it does nothing."""

from __future__ import annotations

import threading
from typing import Any

from rcl_interfaces.msg import Log
from rclpy.node import Node

from harris_perception.nodes.compiling import compiling
from icu_common.nodes import qos

WITHIN_S = 30.0


def test_a_node_that_compiles_says_so(ros: Any) -> None:
    said: list[Log] = ros.collect(ros.plain("listener"), Log, "/rosout", qos.RESULTS)
    node = ros.node(lambda **options: Node("slow", **options))
    ros.spin_until(lambda: node.count_subscribers("/rosout"), WITHIN_S)
    with compiling(node, say_after_s=0.0):
        ros.spin_until(lambda: [line for line in said if line.msg.startswith("compiling")], WITHIN_S)
    assert [line.name for line in said if line.msg.startswith("compiling")] == ["slow"]


def test_a_node_whose_code_is_kept_says_nothing(ros: Any) -> None:
    node = ros.node(lambda **options: Node("quick", **options))
    with compiling(node):
        waiting = [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]
    assert len(waiting) == 1
    waiting[0].join(WITHIN_S)
    assert waiting[0].finished.is_set() and not waiting[0].is_alive()
