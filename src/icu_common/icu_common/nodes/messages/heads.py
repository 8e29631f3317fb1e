"""Stamps, frames and headers of messages."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from rclpy.clock import ROSClock
from std_msgs.msg import Header

from icu_common.core.configuration.text_bounds import plain

MAX_NAME = 80
"""Maximum number of characters in a name."""
MOST_AHEAD_S = 0.1


"""Maximum difference in seconds between the clocks of machines: docs/decisions/several-machines.md."""


def time_message(stamp_ns: int) -> Time:
    """Return a Time of ``stamp_ns`` nanoseconds of ROS time."""
    return Time(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)


def stamp_ns(time: Time) -> int:
    """Return nanoseconds of ROS time."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def header(stamp: int, frame: str) -> Header:
    """Return a Header with ``stamp`` in nanoseconds."""
    return Header(stamp=time_message(stamp), frame_id=frame)


def check_frame(head: Header, frame: str) -> None:
    """Raise ValueError unless a header names this frame."""
    if head.frame_id != frame:
        raise ValueError(f"frame {plain(head.frame_id)!r}; expected {frame!r}")


def check_not_ahead(head: Header, clock: ROSClock) -> None:
    """Raise ValueError if the stamp of an observation is in the future: its age cannot be known.

    The clock of a recording advances in ticks, so it always lags behind the stamps of the recording.
    """
    ahead_s = (stamp_ns(head.stamp) - int(clock.now().nanoseconds)) / 1e9
    if ahead_s > MOST_AHEAD_S and not clock.ros_time_is_active:
        raise ValueError(f"its stamp is {ahead_s:.3f} s ahead of the clock here (limit {MOST_AHEAD_S:g} s)")
