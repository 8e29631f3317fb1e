"""The graph's time has one source: a second program on /clock stops the machine."""

from __future__ import annotations

from typing import Any

from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from gantry_driver.nodes.controller_node import ControllerNode
from icu_common.nodes.qos import LATCHED, RESULTS


def test_a_second_clock_stops_the_machine_and_both_programs_are_named(ros: Any) -> None:
    own = ros.plain("bench").create_publisher(Clock, "/clock", RESULTS)
    watcher = ros.plain("watcher")
    states = ros.collect(watcher, String, "state", LATCHED)
    ros.node(ControllerNode, {"use_sim_time": True})
    ros.spin_until(lambda: own.get_subscription_count() == 1 and states, 15.0)
    assert not any("clock" in message.data for message in states)
    stranger = ros.plain("stranger")
    other = stranger.create_publisher(Clock, "/clock", RESULTS)
    said = "two programs publish clock: /bench and /stranger"
    ros.spin_until(lambda: any(said in message.data for message in states), 10.0, lambda: states)
    stranger.destroy_publisher(other)
    ros.spin_until(lambda: said not in states[-1].data, 10.0, lambda: states[-3:])


def test_a_node_by_the_wall_clock_does_not_follow_the_topic(ros: Any) -> None:
    clock = ros.plain("bench").create_publisher(Clock, "/clock", RESULTS)
    states = ros.collect(ros.plain("watcher"), String, "state", LATCHED)
    ros.node(ControllerNode)
    ros.spin_until(lambda: states, 15.0)
    assert clock.get_subscription_count() == 0
