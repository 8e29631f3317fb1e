"""Nodes detect a second publisher of a topic for one source; recorders and subscribers do not count."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String
from support.ros_rig import participant

from icu_common.nodes import qos
from icu_common.nodes.admission.sources import SourceWatch
from icu_common.nodes.graph_node import GraphNode

TOPIC = "panel/pose"
PROGRAM = """
import sys, time, rclpy
from rclpy.node import Node
from geometry_msgs.msg import PoseStamped
rclpy.init()
node = Node(sys.argv[1])
out = node.create_publisher(PoseStamped, "panel/pose", 10)
print("there", flush=True)
while rclpy.ok():
    time.sleep(0.02)  # the stimulus: 50 poses a second
    out.publish(PoseStamped())
"""


class Watcher(GraphNode):
    def __init__(self, **kwargs: Any) -> None:
        super().__init__("watcher", **kwargs)
        self.texts: list[str] = []
        self.poses = 0
        self.watch = SourceWatch(self, lambda topic, text: self.texts.append(text))
        self.pose = self.watch.subscribe(PoseStamped, TOPIC, self._on_pose, qos.SENSOR)

    def _on_pose(self, message: PoseStamped) -> None:
        self.poses += 1


@pytest.fixture
def start(ros: Any, tmp_path: Path) -> Iterator[Callable[[str], subprocess.Popen[bytes]]]:
    """Start a program that publishes the pose, and return once it has a publisher."""
    started: list[subprocess.Popen[bytes]] = []
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)

    def make(name: str) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(ros.context.get_domain_id())}
        command = [sys.executable, str(script), name]
        process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE)
        started.append(process)
        assert process.stdout is not None and process.stdout.readline()
        return process

    yield make
    for process in started:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def test_second_program_is_named_within_a_second_and_forgotten_when_it_leaves(ros: Any) -> None:
    node = ros.node(Watcher)
    first, second = ros.plain("first"), ros.plain("second")
    first.create_publisher(PoseStamped, TOPIC, 10)
    ros.spin_until(lambda: node.watch.names(TOPIC) == ("/first",), 10.0)
    began_s = time.monotonic()
    outlet = second.create_publisher(PoseStamped, TOPIC, 10)
    ros.spin_until(lambda: node.texts, 10.0)
    assert node.texts == ["two programs publish panel/pose: /first and /second"]
    assert time.monotonic() - began_s < 1.0
    second.destroy_publisher(outlet)
    ros.spin_until(lambda: node.texts[-1] == "", 10.0)
    assert node.watch.names(TOPIC) == ("/first",)


def test_latched_value_of_a_program_that_left_is_replaced_before_the_topic_counts_as_sound(ros: Any) -> None:
    """A foreign calibration must not stay in force once its publisher has gone."""
    received: list[str] = []
    at_end: list[str] = []
    node = ros.plain("watcher")
    watch = SourceWatch(node, lambda topic, text: None if text else at_end.append(received[-1]))
    watch.subscribe(String, "calibration/note", lambda message: received.append(message.data), qos.LATCHED)
    first, second = ros.plain("first"), ros.plain("second")
    first.create_publisher(String, "calibration/note", qos.LATCHED).publish(String(data="own"))
    ros.spin_until(lambda: received == ["own"], 10.0)
    outlet = second.create_publisher(String, "calibration/note", qos.LATCHED)
    outlet.publish(String(data="foreign"))
    ros.spin_until(lambda: received[-1] == "foreign" and watch.look("calibration/note"), 10.0)
    second.destroy_publisher(outlet)
    ros.spin_until(lambda: at_end, 10.0)
    assert at_end == ["own"]


def test_recorder_and_publishers_of_other_topics_are_no_sources(ros: Any) -> None:
    node = ros.node(Watcher)
    first, recorder = ros.plain("first"), ros.plain("bag_recorder")
    first.create_publisher(PoseStamped, TOPIC, 10)
    recorder.create_subscription(PoseStamped, TOPIC, lambda _: None, 10, raw=True)
    recorder.create_publisher(String, "panel/poses", 10)
    ros.spin_until(lambda: node.watch.names(TOPIC), 10.0)
    ros.spin_until(lambda: node.count_subscribers("/panel/pose") == 2, 10.0)
    node.watch.look(TOPIC)
    assert node.watch.names(TOPIC) == ("/first",) and node.texts == []


def test_program_that_is_killed_and_started_again_is_one(ros: Any, start: Callable[..., Any]) -> None:
    node = ros.node(Watcher)
    old = start("recognition")
    ros.spin_until(lambda: node.watch.names(TOPIC) == ("/recognition",) and node.poses, 20.0)
    old.kill()
    old.wait()
    start("recognition")
    # The killed program stays in the graph until its lease ends.
    ros.spin_until(lambda: len(node.get_publishers_info_by_topic("/panel/pose")) == 2, 20.0)
    node.poses = 0
    ros.spin_until(lambda: node.poses > 50, 20.0)
    assert node.texts == [] and node.watch.names(TOPIC) == ("/recognition",)


def test_twin_is_a_second_program(ros: Any, start: Callable[..., Any]) -> None:
    node = ros.node(Watcher)
    start("recognition")
    twin = start("recognition")
    ros.spin_until(lambda: node.texts, 20.0)
    assert node.texts == ["two programs publish panel/pose: /recognition (2 times)"]
    twin.kill()
    twin.wait()
    began_s = time.monotonic()
    ros.spin_until(lambda: node.texts[-1] == "", 20.0)
    assert time.monotonic() - began_s < 5.0, "long before the lease of the killed one ends"


def test_stranger_beside_a_killed_program_is_alone(ros: Any, start: Callable[..., Any]) -> None:
    node = ros.node(Watcher)
    old = start("recognition")
    ros.spin_until(lambda: node.watch.names(TOPIC) == ("/recognition",), 20.0)
    old.kill()
    old.wait()
    ros.plain("stranger").create_publisher(PoseStamped, TOPIC, 10)
    ros.spin_until(lambda: node.watch.names(TOPIC) == ("/stranger",), 20.0)
    assert node.texts == []


def test_two_beds_do_not_meet(ros: Any) -> None:
    node = ros.node(Watcher, namespace="bed_1")
    for bed in ("bed_1", "bed_2"):
        ros.plain(f"first_{bed}").create_publisher(PoseStamped, f"/{bed}/panel/pose", 10)
    ros.spin_until(lambda: node.watch.names(TOPIC), 10.0)
    ros.spin_until(lambda: node.count_publishers("/bed_2/panel/pose") == 1, 10.0)
    assert node.watch.names(TOPIC) == ("/first_bed_1",) and node.texts == []


def test_nodes_of_one_process_are_sources_of_their_own(ros: Any) -> None:
    """Composed nodes share a participant; a node that publishes twice is one source, two nodes are two."""
    node = ros.node(Watcher)
    first = ros.plain("first")
    first.create_publisher(PoseStamped, TOPIC, 10)
    first.create_publisher(PoseStamped, TOPIC, 10)
    ros.spin_until(lambda: node.pose.get_publisher_count() == 2, 10.0)
    ros.spin_until(lambda: node.watch.names(TOPIC) == ("/first",), 10.0)
    assert node.texts == []
    ros.plain("second").create_publisher(PoseStamped, TOPIC, 10)
    ros.spin_until(lambda: node.texts, 10.0)


def test_programs_of_another_participant_of_this_process_are_alive(ros: Any) -> None:
    node = ros.node(Watcher)
    ros.plain("first").create_publisher(PoseStamped, TOPIC, 10)
    with participant(ros.context.get_domain_id()) as other:
        other.plain("first").create_publisher(PoseStamped, TOPIC, 10)
        ros.spin_until(lambda: node.texts, 10.0)


def test_a_program_that_ends_keeps_its_name_until_its_publisher_is_gone(
    ros: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The graph forgets the name first; the reason of the stop must not change to a program without a name."""
    node = ros.node(Watcher)
    for name in ("first", "second"):
        ros.plain(name).create_publisher(PoseStamped, TOPIC, 10)
    ros.spin_until(lambda: node.texts, 10.0)
    ends = node.get_publishers_info_by_topic(f"/{TOPIC}")
    for end in ends:
        if end.node_name == "second":
            end.node_name, end.node_namespace = "_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_"
    monkeypatch.setattr(node, "get_publishers_info_by_topic", lambda topic: ends)
    ended_s = time.monotonic()
    ros.spin_until(lambda: time.monotonic() - ended_s > 2.0, 5.0)
    assert node.texts == ["two programs publish panel/pose: /first and /second"]
    monkeypatch.setattr(node, "get_publishers_info_by_topic", lambda topic: [e for e in ends if e.node_name == "first"])
    ros.spin_until(lambda: node.texts[-1] == "", 5.0)
