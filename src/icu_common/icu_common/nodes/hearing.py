"""Tells whether a program still hears the others; one that does not is ended, to be started anew.

A program that is killed leaves its part of Fast DDS's shared memory behind. Now and then a camera goes on writing to it
after the successor has made its own: both know each other, and nothing is heard, for ever. And Fast DDS's threads can
wait for each other when some program of the graph ends: from then on all that comes is left lying. Then the node goes
on, and hears nothing, for ever. See docs/decisions/processes.md.
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
from icu_common.nodes.graph_node import GraphNode, this_process
from icu_common.nodes.timers import runs_by_clock_topic

LIMIT_S = 8.0
"""A camera needs less for its first picture, and for the next ones."""
SILENCE_S = 15.0
"""Every program tells of itself each second; one that was stopped for long is found again by the others within this."""
_LOOK_S, _LONGEST_TURN_S = 0.25, 1.0
"""Between two looks: the least time, and the most silence that counts, as what came meanwhile is yet to be served."""
_INFO, _PICTURES = "camera_info", "image_raw"


@dataclass(slots=True)
class _Ear:
    made: Subscription | None = None
    heard: bool = False
    silent_s: float = 0.0
    """Since it heard anything; of pictures only while the rest of their camera is heard."""
    matched_at_s: float | None = None


class Hearing:
    """Watches the subscriptions of one process.

    Parameters
    ----------
    after_crash
        The process's predecessor was ended by a signal: a camera that is there, and never heard, counts as well.
    others
        That nothing at all is heard any more counts as well, and that pictures alone are not: all others are on this
        host, so no network is cut or slow.
    limit_s, silence_s
        How long nothing may be heard of a camera or its pictures, and of all.
    """

    def __init__(
        self, *, after_crash: bool, others: bool, limit_s: float = LIMIT_S, silence_s: float = SILENCE_S
    ) -> None:
        self.limit_s, self.silence_s = limit_s, silence_s
        self._after_crash, self._others = after_crash, others
        self._ears: list[tuple[Node, _Ear]] = []
        self._any = _Ear()
        """What any subscription hears; ``heard`` once it was another program."""
        self._looked_at_s = -math.inf

    def observe(self, node: Node, subscription: Subscription) -> Callable[[], None]:
        """Watch a new subscription; call what is returned before each of its callbacks."""
        ear = _Ear(made=subscription)
        self._ears.append((node, ear))

        def hears() -> None:
            ear.heard = True
            ear.silent_s = self._any.silent_s = 0.0

        return hears

    def listen(self, node: GraphNode) -> None:
        """Hear what the other programs tell of themselves each second, unless those are a recording's seconds."""
        if runs_by_clock_topic(node) and this_process.ledger is None:
            self._others = False
            return
        node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.SENSOR, observed=False, raw=True
        )

    def _on_diagnostics(self, data: bytes) -> None:
        # Serialised, as it is of no interest who says what; the process's own words come by another way.
        if not any(_serialised(name) in data for name in diagnostics.own_names):
            self._any.heard, self._any.silent_s = True, 0.0

    def deaf(self, now_s: float) -> str:
        """Return what is not heard though somebody speaks there, empty without such a thing."""
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
        """Return the pictures that are not heard any more from a camera of which the rest is."""
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
        """Return a topic on which a camera is there and was never heard for too long."""
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
    """Return place and name of a topic."""
    assert ear.made is not None
    place, _, name = ear.made.topic_name.rpartition("/")
    return place, name


def _is_camera(node: Node, ear: _Ear) -> bool:
    place, name = _parts(ear)
    return name == _INFO or (name == _PICTURES and node.count_publishers(f"{place}/{_INFO}") > 0)


def _serialised(text: str) -> bytes:
    """Return a string as CDR has it (little-endian): its length with the zero at its end, and itself."""
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data
