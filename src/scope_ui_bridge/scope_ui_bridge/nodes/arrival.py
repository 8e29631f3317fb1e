"""Stamps of received messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from icu_common.nodes.messages import heads


class Arrival:
    """Gives the stamp of a message: its own, or in a replay the time of its arrival.

    In a replay, recorded stamps are as old as the session.
    """

    def __init__(self, replay: bool, ros_ns: Callable[[], int]) -> None:
        self._replay = replay
        self._ros_ns = ros_ns

    def stamp_ns(self, message: Any) -> int:
        """Return the stamp in ns of ROS time."""
        return self._ros_ns() if self._replay else heads.stamp_ns(message.header.stamp)
