"""A program that was started anew after a crash and hears no camera ends, to be started once more."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from typing import Any

import pytest
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from icu_common.nodes import qos
from icu_common.nodes.hearing import DEAF, VARIABLE, Hearing
from scope_bench.adapters import processes

LISTENER = """
import sys
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from icu_common.nodes import qos
from icu_common.nodes.runtime import run

class Listener(Node):
    def __init__(self, **options):
        super().__init__("listener", **options)
        self.create_subscription(CameraInfo, "/left/camera_info", lambda m: None, qos.SENSOR)

sys.exit(run(Listener, []))
"""


@pytest.fixture
def hearing(monkeypatch: pytest.MonkeyPatch) -> Hearing:
    monkeypatch.setattr(Node, "create_subscription", Node.create_subscription)  # put back at the end
    hearing = Hearing(limit_s=5.0)
    hearing.install()
    return hearing


def test_a_camera_that_is_matched_and_not_heard_is_named(ros: Any, hearing: Hearing) -> None:
    node, camera = ros.plain("node"), ros.plain("camera")
    heard = ros.collect(node, CameraInfo, "/left/camera_info", qos.SENSOR)
    ros.collect(node, Image, "/left/image_raw", qos.NEWEST)
    ros.collect(node, Image, "/teach/image_raw", qos.NEWEST)
    assert hearing.deaf(0.0) == hearing.deaf(100.0) == "", "nobody is there to be heard"
    info = camera.create_publisher(CameraInfo, "/left/camera_info", qos.IMAGES)
    pictures = camera.create_publisher(Image, "/left/image_raw", qos.IMAGES)
    spoken = camera.create_publisher(Image, "/teach/image_raw", qos.IMAGES)  # has no camera: speaks when asked
    for publisher in (info, pictures, spoken):
        ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)
    matched = lambda: all(s.get_publisher_count() for s in node.subscriptions)  # noqa: E731
    ros.spin_until(matched, 10.0)
    assert hearing.deaf(100.0) == "", "not before the time is over"
    assert hearing.deaf(105.1) == "/left/camera_info"
    info.publish(CameraInfo())
    ros.spin_until(lambda: heard, 10.0)
    assert hearing.deaf(105.2) == "/left/image_raw"
    pictures.publish(Image())
    ros.spin_until(lambda: not hearing.deaf(105.3), 10.0)
    assert hearing.deaf(1000.0) == "", "what was heard once may fall silent"


@pytest.mark.parametrize(("after_crash", "speaks"), [("1", False), ("1", True), ("", False)])
def test_a_deaf_program_ends_only_after_a_crash(ros: Any, domain: int, after_crash: str, speaks: bool) -> None:
    """Its predecessor's shared memory, which the camera still writes to, is what nobody reads any more."""
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ICU_AFTER_CRASH": after_crash}
    camera = ros.plain("camera")
    info = camera.create_publisher(CameraInfo, "/left/camera_info", qos.IMAGES)
    program = subprocess.Popen([sys.executable, "-c", LISTENER], env=environment, stderr=subprocess.PIPE, text=True)
    try:
        ros.spin_until(lambda: info.get_subscription_count() == 1, 20.0)
        if after_crash and not speaks:
            ros.spin_until(lambda: program.poll() is not None, 20.0)
            assert program.returncode == 75
            assert program.stderr is not None
            assert "error: /left/camera_info: a camera is there and has not been heard for 8 s" in program.stderr.read()
            return
        until = time.monotonic() + 12.0
        ros.spin_until(lambda: (speaks and info.publish(CameraInfo()), time.monotonic() > until)[1], 15.0)
        assert program.poll() is None
    finally:
        program.kill()
        program.wait(10.0)


def test_the_names_are_those_of_bring_up() -> None:
    assert (processes.AFTER_CRASH_VARIABLE, processes.DEAF) == (VARIABLE, DEAF)
