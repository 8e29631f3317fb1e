"""Timers that a step of the system's clock does not hold up."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node


def every(node: Node, period_s: float, callback: Callable[[], object]) -> None:
    """Call back every ``period_s`` of the steady clock, with ``use_sim_time`` of the recording's.

    rclpy's own choice, ROS time, is the system's: a timer of it stands still for as long as that was set back.
    """
    recorded = node.get_parameter("use_sim_time").value
    clock = node.get_clock() if recorded else Clock(clock_type=ClockType.STEADY_TIME)
    node.create_timer(period_s, callback, clock=clock)
