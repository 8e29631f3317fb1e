"""The head of a serialised trajectory, read without unpacking it, against ROS's own serialisation."""

from __future__ import annotations

import struct

import pytest
from builtin_interfaces.msg import Time
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from gantry_driver.core.grbl.trajectory_bytes import HEAD_BYTES, MAX_NAMES, TrajectoryHead, max_bytes, read_head
from icu_common.core.geometry.frames import JOINTS


def trajectory(points: int, frame_id: str = "goal 7", names: tuple[str, ...] = JOINTS) -> bytes:
    stamp = Time(sec=12, nanosec=345)
    message = JointTrajectory(header=Header(stamp=stamp, frame_id=frame_id), joint_names=list(names))
    full = [0.1, 0.2, 0.3]
    point = JointTrajectoryPoint(positions=full, velocities=full, accelerations=full, effort=full)
    message.points = [point] * points
    return bytes(serialize_message(message))


@pytest.mark.parametrize("frame_id", ["", "a", "ab", "abc", "abcd", "Ω"])
@pytest.mark.parametrize("names", [(), ("a",), JOINTS, tuple("abcdefg")])
def test_the_head_is_what_was_serialised(frame_id: str, names: tuple[str, ...]) -> None:
    head = read_head(trajectory(5, frame_id, names))
    assert head == TrajectoryHead(stamp_ns=12_000_000_345, frame_id=frame_id, points=5)
    assert head.goal_id == (frame_id or "12000000345")


@pytest.mark.parametrize("points", [0, 1, 2000])
def test_every_trajectory_of_three_joints_fits_into_the_limit(points: int) -> None:
    assert len(trajectory(points)) <= max_bytes(points)


def test_big_endian_bytes_are_read_too() -> None:
    data = b"\x00\x00\x00\x00" + struct.pack(">iII", 1, 2, 2) + b"g\0\0\0" + struct.pack(">II", 0, 9)
    assert read_head(data) == TrajectoryHead(stamp_ns=1_000_000_002, frame_id="g", points=9)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "expected plain CDR"),
        (b"\x00\x03\x00\x00" + bytes(40), "encapsulation 00030000"),
        (trajectory(1)[:20], "ends too early"),
        (b"\x00\x01\x00\x00" + struct.pack("<iII", 0, 0, 2**32 - 1), f"limit {HEAD_BYTES}"),
        (b"\x00\x01\x00\x00" + struct.pack("<iII", 0, 0, 0) + struct.pack("<I", 2**31), f"limit {MAX_NAMES}"),
    ],
)
def test_what_is_no_trajectory_is_refused_with_the_reason(data: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_head(data)
