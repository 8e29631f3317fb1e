"""Timers and clocks of a node: of the steady clock, or of the time on ``/clock``."""

from __future__ import annotations

import time
from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from icu_common.nodes.graph_node import GraphNode


def runs_by_clock_topic(node: Node) -> bool:
    """Return whether the node's time is that on ``/clock``, of a simulation or a recording."""
    return bool(node.get_parameter("use_sim_time").value)


def every(node: Node, period_s: float, callback: Callable[[], object], *, wall: bool = False) -> None:
    """Call back every ``period_s`` of the steady clock, or with ``use_sim_time`` of the time on ``/clock``.

    rclpy's default, ROS time, is the system time: if that is set back, its timers pause for the same duration.

    Parameters
    ----------
    node, period_s, callback
        The node that owns the timer, its period, and the function to call.
    wall
        Always use the steady clock: for timers that guard people or programs.
    """
    if not wall and runs_by_clock_topic(node):
        if isinstance(node, GraphNode):
            node.add_clock_timer(period_s, callback)
        else:
            node.create_timer(period_s, callback, clock=node.get_clock())
    else:
        node.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def seconds_of(node: Node) -> Callable[[], float]:
    """Return the clock by which a node measures its waits, in seconds.

    It is the steady clock, which cannot be set, or with ``use_sim_time`` the time on ``/clock``.
    """
    if not runs_by_clock_topic(node):
        return time.monotonic
    clock = node.get_clock()
    return lambda: float(clock.now().nanoseconds) / 1e9
