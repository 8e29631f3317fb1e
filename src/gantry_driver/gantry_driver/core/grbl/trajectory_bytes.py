"""The head of a serialised ``trajectory_msgs/JointTrajectory``, read before the message is unpacked.

Unpacking 200,000 points holds the interpreter's lock for more than a second, so no other thread of the process runs.
The driver therefore compares the size and the number of points with their limits first.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from icu_common.core.goals.intent import read_frame
from icu_common.core.goals.results import GoalResult, Outcome

HEAD_BYTES = 4096
"""Maximum size in bytes of everything before the points: stamp, goal name and joint names."""
POINT_BYTES = 192
"""Maximum size of a serialised point of three joints: positions, velocities, accelerations, effort, and a time."""
MAX_NAMES = 16
"""Maximum number of joint names."""
_LITTLE, _BIG = b"\x00\x01", b"\x00\x00"
_START = 4
"""Size of the encapsulation in bytes; alignment counts from its end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryHead:
    """Data of a trajectory that was not unpacked."""

    stamp_ns: int
    frame_id: str
    points: int

    @property
    def goal_id(self) -> str:
        """Name of the goal in its answers."""
        return read_frame(self.frame_id, self.stamp_ns)[0]


def max_bytes(max_points: int) -> int:
    """Return the maximum size in bytes of a trajectory with ``max_points`` points."""
    return HEAD_BYTES + POINT_BYTES * max_points


def read_head(data: bytes) -> TrajectoryHead:
    """Return the head of a serialised trajectory.

    Raises
    ------
    ValueError
        If the bytes are not a serialised trajectory, or it has too many or too long names.
    """
    if data[:2] not in (_LITTLE, _BIG):
        raise ValueError(f"encapsulation {data[:_START].hex()}: expected plain CDR")
    order = "<" if data[:2] == _LITTLE else ">"
    try:
        seconds, nanoseconds = struct.unpack_from(order + "iI", data, _START)
        frame, at = _text(data, _START + 8, order)
        (names,) = struct.unpack_from(order + "I", data, at)
        if names > MAX_NAMES:
            raise ValueError(f"{names} joint names (limit {MAX_NAMES})")
        at += 4
        for _ in range(names):
            _, at = _text(data, at, order)
        (points,) = struct.unpack_from(order + "I", data, at)
    except struct.error as error:
        raise ValueError(f"a trajectory of {len(data)} bytes ends too early") from error
    return TrajectoryHead(stamp_ns=seconds * 1_000_000_000 + nanoseconds, frame_id=frame, points=points)


def refusal(head: TrajectoryHead, reason: str) -> GoalResult:
    """Return the answer that rejects a trajectory without unpacking it."""
    text = f"{head.points} points"
    return GoalResult(goal_id=head.goal_id, goal=text, outcome=Outcome.REJECTED, reason=reason)


def _text(data: bytes, at: int, order: str) -> tuple[str, int]:
    """Return the text at an offset, and the offset of the number that follows it."""
    (size,) = struct.unpack_from(order + "I", data, at)
    if size > HEAD_BYTES:
        raise ValueError(f"a text of {size} bytes (limit {HEAD_BYTES})")
    begin, end = at + 4, at + 4 + size
    text = data[begin : end - 1] if size else b""
    return text.decode("utf-8", "replace"), (end + 3) // 4 * 4
