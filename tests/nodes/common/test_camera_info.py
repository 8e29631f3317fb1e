"""A repeated calibration is reported once, a new one at once, and each message's stamp."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo
from unit.harris_perception import panel_scene as scene

from icu_common.nodes import qos
from icu_common.nodes.camera_info import CameraInfoSubscription
from icu_common.nodes.messages.cameras import camera_info_message
from icu_common.nodes.messages.heads import header

pytestmark = pytest.mark.long

START = 1_700_000_000_000_000_001


def test_only_a_change_is_reported_and_each_stamp(ros: Any) -> None:
    probe, changes, stamps = ros.plain(), [], []
    out = probe.create_publisher(CameraInfo, "camera_info", qos.IMAGES)
    reader = ros.plain("reader")
    infos = CameraInfoSubscription(reader, "camera_info", qos.RESULTS, changes.append, stamps.append)
    ros.spin_until(lambda: out.get_subscription_count() == 1, 10.0)

    def send(message: CameraInfo, number: int) -> int:
        message.header = header(START + number, "camera_left_optical_frame")
        out.publish(message)
        ros.spin_until(lambda: stamps[-1:] == [START + number], 10.0, lambda: stamps)
        return len(changes)

    same, other = camera_info_message(scene.camera(), header(0, "")), camera_info_message(scene.camera(), header(0, ""))
    other.d[0] += 1e-9
    assert [send(same, number) for number in (1, 2, 3)] == [1, 1, 1]
    assert send(other, 4) == 2 and changes[-1].d[0] == other.d[0]
    assert send(same, 5) == 3
    infos.again()
    assert send(same, 6) == 4, "asked for again"
    infos.end()
    ros.spin_until(lambda: out.get_subscription_count() == 0, 10.0)


def test_a_damaged_message_is_dropped_and_the_next_one_is_reported(ros: Any) -> None:
    probe, changes, stamps = ros.plain(), [], []
    out = probe.create_publisher(CameraInfo, "camera_info", qos.IMAGES)
    CameraInfoSubscription(ros.plain("reader"), "camera_info", qos.RESULTS, changes.append, stamps.append)
    ros.spin_until(lambda: out.get_subscription_count() == 1, 10.0)
    message = camera_info_message(scene.camera(), header(START, "camera_left_optical_frame"))
    out.publish(serialize_message(message)[:60])
    out.publish(message)
    ros.spin_until(lambda: stamps == [START], 10.0, lambda: stamps)
    assert changes[0].k.tolist() == message.k.tolist()
