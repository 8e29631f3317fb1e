"""Messages that are larger than their topic allows are dropped before they are unpacked."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from icu_common.nodes import graph_node, qos
from icu_common.nodes.admission.message_sizes import MAX_BYTES

pytestmark = pytest.mark.long


def trajectory(points: int) -> JointTrajectory:
    return JointTrajectory(points=[JointTrajectoryPoint(positions=[0.1, 0.2, 0.3])] * points)


def test_large_message_is_not_unpacked_and_the_next_one_arrives(ros: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    unpacked: list[int] = []

    def unpack(data: bytes, message_type: Any) -> Any:
        unpacked.append(len(data))
        return unpack_for_real(data, message_type)

    unpack_for_real = graph_node.deserialize_message
    monkeypatch.setattr(graph_node, "deserialize_message", unpack)
    speaker, listener = ros.plain("speaker"), ros.plain("listener")
    heard: list[int] = []
    sizes: list[int] = []
    outlet = speaker.create_publisher(JointTrajectory, "way", qos.RESULTS)
    listener.create_subscription(
        JointTrajectory,
        "way",
        lambda m: heard.append(len(m.points)),
        qos.RESULTS,
        max_bytes=2_000,
        too_large=sizes.append,
    )
    ros.spin_until(lambda: outlet.get_subscription_count() == 1, 10.0)
    outlet.publish(trajectory(20_000))
    outlet.publish(trajectory(3))
    ros.spin_until(lambda: heard, 20.0)
    assert heard == [3]
    # On the wire a message is shorter than from serialize_message, which aligns differently.
    assert len(sizes) == 1 and sizes[0] > 20_000 * 3 * 8
    assert len(unpacked) == 1 and 3 * 3 * 8 < unpacked[0] < 2_000


def test_type_has_a_limit_of_its_own(ros: Any) -> None:
    speaker, listener = ros.plain("speaker"), ros.plain("listener")
    outlet = speaker.create_publisher(String, "text", qos.RESULTS)
    heard = ros.collect(listener, String, "text", qos.RESULTS)
    ros.spin_until(lambda: outlet.get_subscription_count() == 1, 10.0)
    outlet.publish(String(data="x" * MAX_BYTES[String]))
    outlet.publish(String(data="y" * (MAX_BYTES[String] - 100)))
    ros.spin_until(lambda: heard, 20.0)
    assert {message.data[0] for message in heard} == {"y"}


def test_message_that_cannot_be_unpacked_is_dropped(ros: Any) -> None:
    speaker, listener = ros.plain("speaker"), ros.plain("listener")
    outlet = speaker.create_publisher(JointTrajectory, "way", qos.RESULTS)
    heard = ros.collect(listener, JointTrajectory, "way", qos.RESULTS)
    ros.spin_until(lambda: outlet.get_subscription_count() == 1, 10.0)
    outlet.publish(serialize_message(trajectory(10))[:100])
    outlet.publish(trajectory(2))
    ros.spin_until(lambda: heard, 20.0)
    assert [len(message.points) for message in heard] == [2]


def test_raw_subscription_is_limited_only_where_it_asks_for_it(ros: Any) -> None:
    speaker, listener = ros.plain("speaker"), ros.plain("listener")
    outlet = speaker.create_publisher(String, "text", qos.RESULTS)
    everything: list[bytes] = []
    bounded: list[bytes] = []
    listener.create_subscription(String, "text", everything.append, qos.RESULTS, raw=True)
    listener.create_subscription(String, "text", bounded.append, qos.RESULTS, raw=True, max_bytes=50)
    ros.spin_until(lambda: outlet.get_subscription_count() == 2, 10.0)
    outlet.publish(String(data="x" * 2 * MAX_BYTES[String]))
    outlet.publish(String(data="y"))
    ros.spin_until(lambda: len(everything) == 2 and bounded, 20.0)
    assert bounded == [everything[1]] == [serialize_message(String(data="y"))]
