"""Detects a program that no longer receives messages; the program is then ended and restarted.

A killed program leaves its part of Fast DDS's shared memory behind. Sometimes a camera continues to write to it after
the successor has created its own: both have discovered each other, but no message ever arrives. Fast DDS's threads can
also wait for each other when a program of the graph ends: from then on no message is delivered. The node then continues
to run and never receives a message again. See docs/decisions/processes.md.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.subscription import Subscription

from icu_common.nodes import diagnostics, qos
from icu_common.nodes.graph_node import CLOCK_TOPIC, GraphNode, this_process
from icu_common.nodes.timers import runs_by_clock_topic

LIMIT_S = 8.0
"""Seconds without messages of a matched camera; a camera needs less for its first image, and between images."""
SILENCE_S = 15.0
"""Seconds without any message. Each program reports every second; others rediscover a stopped one in less time."""
_LOOK_S, _LONGEST_TURN_S = 0.25, 1.0
"""Minimum interval between two checks, and maximum silence it counts: messages may still wait to be served."""
_INFO, _PICTURES = "camera_info", "image_raw"


@dataclass(slots=True)
class _Ear:
    made: Subscription | None = None
    heard: bool = False
    silent_s: float = 0.0
    """Seconds since the last message; for images, counted only while the camera's other topic is received."""
    matched_at_s: float | None = None


class Hearing:
    """Watches the subscriptions of one process.

    Parameters
    ----------
    after_crash
        The process's predecessor was ended by a signal: a camera that is present but never received counts as well.
    others
        The loss of all messages, or of images alone, counts as well: all other programs are on this host, so no network
        is cut or slow.
    limit_s, silence_s
        Maximum seconds without messages from a camera or its images, and without any message.
    """

    def __init__(
        self, *, after_crash: bool, others: bool, limit_s: float = LIMIT_S, silence_s: float = SILENCE_S
    ) -> None:
        self.limit_s, self.silence_s = limit_s, silence_s
        self._after_crash, self._others = after_crash, others
        self._ears: list[tuple[Node, _Ear]] = []
        self._any = _Ear()
        """Messages of any subscription; ``heard`` is set by the first message of another program."""
        self._looked_at_s = -math.inf

    def observe(self, node: Node, subscription: Subscription) -> Callable[[], None]:
        """Watch a new subscription; call the returned function before each of its callbacks."""
        ear = _Ear(made=subscription)
        self._ears.append((node, ear))

        def hears() -> None:
            ear.heard = True
            ear.silent_s = self._any.silent_s = 0.0

        return hears

    def listen(self, node: GraphNode) -> None:
        """Subscribe to the other programs' diagnostics of each second, unless a recording sets the time.

        In a simulation each step's message on ``/clock`` shows as much, without another subscription.
        """
        if runs_by_clock_topic(node) and this_process.ledger is None:
            self._others = False
            return
        clock = node.resolve_topic_name(CLOCK_TOPIC)
        if this_process.simulated and clock not in (publisher.topic_name for publisher in node.publishers):
            node.add_clock_listener(lambda _: self._on_others())
            return
        node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.SENSOR, observed=False, raw=True
        )

    def _on_diagnostics(self, data: bytes) -> None:
        # Serialised, as sender and content do not matter; the process's own messages take another path.
        if not any(_serialised(name) in data for name in diagnostics.own_names):
            self._on_others()

    def _on_others(self) -> None:
        self._any.heard, self._any.silent_s = True, 0.0

    def deaf(self, now_s: float) -> str:
        """Return the topic on which no messages arrive although they are sent, and why; empty if there is none."""
        if now_s - self._looked_at_s < _LOOK_S:
            return ""
        turn_s = min(now_s - self._looked_at_s, _LONGEST_TURN_S)
        self._looked_at_s = now_s
        self._ears = [(node, ear) for node, ear in self._ears if ear.made in node.subscriptions]
        for ear in (self._any, *(ear for _, ear in self._ears)):
            ear.silent_s += turn_s
        if self._others and self._any.heard and self._any.silent_s > self.silence_s:
            return f"all topics: the other programs have not been heard for {self.silence_s:g} s"
        if self._others and (topic := self._picture_less()):
            return f"{topic}: a camera's camera_info is heard, and its pictures have not been for {self.limit_s:g} s"
        if self._after_crash and (topic := self._never_heard(now_s)):
            return f"{topic}: a camera is there and has not been heard for {self.limit_s:g} s"
        return ""

    def _picture_less(self) -> str:
        """Return the image topic that has fallen silent while the camera's camera_info is received."""
        ears = {_parts(ear): ear for _, ear in self._ears}
        for (place, name), ear in ears.items():
            info = ears.get((place, _INFO))
            if name != _PICTURES or not ear.heard:
                continue
            if info is None or info.silent_s > _LONGEST_TURN_S:
                ear.silent_s = 0.0
            elif ear.silent_s > self.limit_s:
                return f"{place}/{name}"
        return ""

    def _never_heard(self, now_s: float) -> str:
        """Return the topic of a camera that has been present for too long without a received message."""
        for node, ear in self._ears:
            if ear.heard:
                continue
            assert ear.made is not None
            topic: str = ear.made.topic_name
            if not _is_camera(node, ear) or not ear.made.get_publisher_count():
                ear.matched_at_s = None
                continue
            if ear.matched_at_s is None:
                ear.matched_at_s = now_s
            if now_s - ear.matched_at_s > self.limit_s:
                return topic
        return ""


def _parts(ear: _Ear) -> tuple[str, str]:
    """Return namespace and name of a topic."""
    assert ear.made is not None
    place, _, name = ear.made.topic_name.rpartition("/")
    return place, name


def _is_camera(node: Node, ear: _Ear) -> bool:
    place, name = _parts(ear)
    return name == _INFO or (name == _PICTURES and node.count_publishers(f"{place}/{_INFO}") > 0)


def _serialised(text: str) -> bytes:
    """Return a string in CDR (little-endian): its length with the terminating zero, then the string."""
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data
