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
from icu_common.nodes.hearing import Hearing

LISTENER = """
import sys
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from icu_common.nodes import qos
from icu_common.nodes.runtime import run

class Listener(Node):
    def __init__(self, **options):
        super().__init__("listener", **options)
        self.create_subscription(CameraInfo, f"/{sys.argv[1]}/camera_info", lambda m: None, qos.SENSOR)

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


def test_a_subscription_that_was_given_up_unheard_is_not_asked_any_more(ros: Any, hearing: Hearing) -> None:
    """Corners and pictures for people are only subscribed to while somebody looks."""
    node, camera = ros.plain("node"), ros.plain("camera")
    camera.create_publisher(CameraInfo, "/left/camera_info", qos.IMAGES)
    given_up = node.create_subscription(CameraInfo, "/left/camera_info", lambda m: None, qos.SENSOR)
    ros.spin_until(lambda: given_up.get_publisher_count() == 1, 10.0)
    assert hearing.deaf(0.0) == ""
    node.destroy_subscription(given_up)
    assert hearing.deaf(100.0) == ""


def test_a_deaf_program_ends_only_after_a_crash(ros: Any, domain: int) -> None:
    """Its predecessor's shared memory, which the camera still writes to, is what nobody reads any more."""
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
