"""A program that receives nothing though another program sends ends, to be restarted."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image

from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE
from icu_common.core.processes.supervision import DEAF, READY_VARIABLE
from icu_common.nodes import diagnostics, qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode, this_process
from icu_common.nodes.hearing import Hearing
from icu_common.nodes.messages.heads import time_message

LISTENER = """
import functools, sys
from sensor_msgs.msg import CameraInfo
from icu_common.nodes import qos, runtime
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.runtime import run

runtime.Hearing = functools.partial(runtime.Hearing, silence_s=4.0)

class Listener(GraphNode):
    def __init__(self, **options):
        super().__init__("listener", **options)
        self.create_subscription(CameraInfo, f"/{sys.argv[1]}/camera_info", lambda m: None, qos.SENSOR)

sys.exit(run(Listener, []))
"""


@pytest.fixture
def hearing(monkeypatch: pytest.MonkeyPatch) -> Hearing:
    """After a crash, on one host."""
    monkeypatch.setattr(diagnostics, "own_names", set())
    hearing = Hearing(after_crash=True, others=True, limit_s=5.0, silence_s=5.0)
    monkeypatch.setattr(this_process, "observer", hearing.observe)
    return hearing


def test_a_camera_that_is_matched_and_not_heard_is_named(ros: Any, hearing: Hearing) -> None:
    node, camera = ros.plain("node"), ros.plain("camera")
    heard = ros.collect(node, CameraInfo, "/left/camera_info", qos.SENSOR)
    seen = ros.collect(node, Image, "/left/image_raw", qos.NEWEST)
    ros.collect(node, Image, "/teach/image_raw", qos.NEWEST)
    assert hearing.deaf(0.0) == hearing.deaf(100.0) == "", "nobody is there to be heard"
    info = camera.create_publisher(CameraInfo, "/left/camera_info", qos.IMAGES)
    pictures = camera.create_publisher(Image, "/left/image_raw", qos.IMAGES)
    spoken = camera.create_publisher(Image, "/teach/image_raw", qos.IMAGES)  # has no camera: speaks when asked
    for publisher in (info, pictures, spoken):
        ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)
    matched = lambda: all(s.get_publisher_count() for s in node.subscriptions)  # noqa: E731
    ros.spin_until(matched, 10.0)
    assert hearing.deaf(100.5) == "", "not before the time is over"
    assert hearing.deaf(105.6).startswith("/left/camera_info")
    info.publish(CameraInfo())
    ros.spin_until(lambda: heard, 10.0)
    assert hearing.deaf(106.0).startswith("/left/image_raw")
    pictures.publish(Image())
    ros.spin_until(lambda: seen, 10.0)
    for now_s in np.arange(107.0, 120.0):
        assert hearing.deaf(float(now_s)) == "", "a camera that was heard once may fall silent"


@pytest.mark.parametrize("one_host", [True, False])
def test_a_camera_whose_pictures_alone_are_not_heard_any_more_is_named_on_one_host(
    ros: Any, hearing: Hearing, one_host: bool
) -> None:
    hearing._others = one_host
    node, camera = ros.plain("node"), ros.plain("camera")
    infos = ros.collect(node, CameraInfo, "/left/camera_info", qos.SENSOR)
    seen = ros.collect(node, Image, "/left/image_raw", qos.NEWEST)
    info = camera.create_publisher(CameraInfo, "/left/camera_info", qos.IMAGES)
    pictures = camera.create_publisher(Image, "/left/image_raw", qos.IMAGES)
    for publisher in (info, pictures):
        ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)
    pictures.publish(Image())
    ros.spin_until(lambda: seen, 10.0)
    told = []
    for number in range(8):
        info.publish(CameraInfo())
        ros.spin_until(lambda n=number: len(infos) > n, 10.0)
        told.append(hearing.deaf(100.0 + number))
    if not one_host:
        assert told == [""] * 8, "pictures are what a slow network loses"
        return
    assert told[:5] == [""] * 5
    assert told[-1] == "/left/image_raw: a camera's camera_info is heard, and its pictures have not been for 5 s"
    pictures.publish(Image())
    ros.spin_until(lambda: len(seen) > 1, 10.0)
    for now_s in np.arange(110.0, 130.0):
        assert hearing.deaf(float(now_s)) == "", "the camera stands still"
    info.publish(CameraInfo())
    ros.spin_until(lambda: len(infos) > 8, 10.0)
    assert hearing.deaf(131.0) == "", "it goes on, and its first picture is on its way"


def told_by(ros: Any, name: str) -> Diagnostics:
    """Return the messages that announce a node of another process."""
    told = Diagnostics(ros.plain(name))
    diagnostics.own_names.clear()
    return told


def test_who_hears_no_other_program_any_more_is_deaf(ros: Any, hearing: Hearing) -> None:
    node = ros.plain("node")
    hearing.listen(node)
    other, own = told_by(ros, "other"), Diagnostics(node)
    ros.spin_until(lambda: len(node.get_publishers_info_by_topic("/diagnostics")) == 2, 10.0)

    def silent_s() -> float:
        return hearing._any.silent_s

    hearing.deaf(99.0)
    ros.spin_until(lambda: (own.tell("ok", "well", []), hearing._any.made is None, silent_s() > 0)[-1], 10.0)
    for now_s in (100.0, 101.0, 102.0, 103.0, 104.0, 105.0, 106.0, 107.0):
        assert hearing.deaf(now_s) == "", "nobody else was ever heard"
    assert silent_s() > 7.0, "its own words do not count"
    ros.spin_until(lambda: (other.tell("ok", "well", []), silent_s() == 0.0)[1], 10.0)
    assert [hearing.deaf(now_s) for now_s in (200.0, 300.0, 400.0, 500.0, 600.0)] == [""] * 5, "it was held up itself"
    assert hearing.deaf(601.0).startswith("all topics")
    ros.spin_until(lambda: (other.tell("ok", "well", []), silent_s() == 0.0)[1], 10.0)
    assert hearing.deaf(602.0) == ""


def test_by_the_clock_of_a_recording_which_may_stand_still_nobody_is_deaf(ros: Any, hearing: Hearing) -> None:
    node = ros.plain("node")
    node.set_parameters([Parameter("use_sim_time", value=True)])
    hearing.listen(node)
    other = told_by(ros, "other")
    seen = ros.collect(node, DiagnosticArray, "/diagnostics", qos.RESULTS)
    ros.spin_until(lambda: (other.tell("ok", "well", []), seen)[1], 10.0)
    assert [hearing.deaf(float(now_s)) for now_s in range(100, 120)] == [""] * 20


def test_in_a_simulation_the_steps_of_its_time_show_that_others_are_heard(
    ros: Any, hearing: Hearing, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LEDGER_VARIABLE, str(tmp_path / "steps"))
    this_process.count_steps()
    assert this_process.ledger is not None
    this_process.ledger.time_ns = 10**18
    try:
        node = ros.node(functools.partial(GraphNode, "node"), {"use_sim_time": True})
        bench = ros.node(functools.partial(GraphNode, "bench"), {"use_sim_time": True})
        clock = bench.create_publisher(Clock, "/clock", qos.LATCHED)
        hearing.listen(node)
        assert {subscription.topic_name for subscription in node.subscriptions} == {"/clock"}
        ros.spin_until(lambda: clock.get_subscription_count() == 2, 10.0)
        clock.publish(Clock(clock=time_message(10**18 + 1)))
        ros.spin_until(lambda: node.get_clock().now().nanoseconds > 10**18, 10.0)
        told = [hearing.deaf(float(now_s)) for now_s in range(100, 108)]
        assert told[0] == "" and told[-1].startswith("all topics")
        clock.publish(Clock(clock=time_message(10**18 + 2)))
        ros.spin_until(lambda: node.get_clock().now().nanoseconds > 10**18 + 1, 10.0)
        assert hearing.deaf(108.0) == ""
        Hearing(after_crash=False, others=True).listen(bench)
        topics = {subscription.topic_name for subscription in bench.subscriptions}
        assert "/diagnostics" in topics, "its own time shows nothing about others"
    finally:
        this_process.end()


def test_a_subscription_that_was_given_up_unheard_is_not_asked_any_more(ros: Any, hearing: Hearing) -> None:
    """Corners and drawn images are only subscribed to while a viewer requests them."""
    node, camera = ros.plain("node"), ros.plain("camera")
    camera.create_publisher(CameraInfo, "/left/camera_info", qos.IMAGES)
    given_up = node.create_subscription(CameraInfo, "/left/camera_info", lambda m: None, qos.SENSOR)
    ros.spin_until(lambda: given_up.get_publisher_count() == 1, 10.0)
    assert hearing.deaf(0.0) == ""
    node.destroy_subscription(given_up)
    assert hearing.deaf(100.0) == ""


def test_a_deaf_program_ends_only_after_a_crash(ros: Any, domain: int) -> None:
    """No program reads its predecessor's shared memory any more, to which the camera still writes."""
    silent, speaking = ros.plain("silent"), ros.plain("speaking")
    mute = silent.create_publisher(CameraInfo, "/left/camera_info", qos.IMAGES)
    heard = speaking.create_publisher(CameraInfo, "/right/camera_info", qos.IMAGES)

    def start(side: str, after_crash: str) -> subprocess.Popen[str]:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ICU_AFTER_CRASH": after_crash}
        command = [sys.executable, "-c", LISTENER, side]
        return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)

    deaf, first, hearing = programs = [start("left", "1"), start("left", ""), start("right", "1")]
    try:
        ros.spin_until(lambda: (mute.get_subscription_count(), heard.get_subscription_count()) == (2, 1), 40.0)
        ros.spin_until(lambda: (heard.publish(CameraInfo()), deaf.poll() is not None)[1], 40.0)
        assert deaf.returncode == 75
        assert deaf.stderr is not None
        assert "error: /left/camera_info: a camera is there and has not been heard for 8 s" in deaf.stderr.read()
        until = time.monotonic() + 3.0
        ros.spin_until(lambda: (heard.publish(CameraInfo()), time.monotonic() > until)[1], 5.0)
        assert (first.poll(), hearing.poll()) == (None, None)
    finally:
        for program in programs:
            program.kill()
            program.communicate(timeout=10.0)


def test_a_program_that_hears_nobody_any_more_ends_where_it_is_started_anew(ros: Any, domain: int) -> None:
    other = told_by(ros, "other")
    beside = ros.plain("beside").create_publisher(CameraInfo, "/left/camera_info", qos.IMAGES)
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    command = [sys.executable, "-c", LISTENER, "left"]
    pipe, told = os.pipe()
    alone = subprocess.Popen(command, env=environment)
    watched = subprocess.Popen(
        command, env={**environment, READY_VARIABLE: str(told)}, pass_fds=[told], stderr=subprocess.PIPE, text=True
    )
    try:
        os.close(told)
        ros.spin_until(lambda: beside.get_subscription_count() == 2, 40.0)
        until = time.monotonic() + 6.0  # longer than the limit without a message
        ros.spin_until(lambda: (other.tell("ok", "well", []), time.monotonic() > until)[1], 20.0)
        assert watched.poll() is None
        ros.spin_until(lambda: watched.poll() is not None, 40.0)
        assert watched.returncode == DEAF
        assert watched.stderr is not None
        assert "error: all topics: the other programs have not been heard for 4 s" in watched.stderr.read()
        assert alone.poll() is None, "nobody would start it anew"
    finally:
        for program in (alone, watched):
            program.kill()
            program.communicate(timeout=10.0)
        os.close(pipe)
