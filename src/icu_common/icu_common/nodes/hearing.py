"""Tells a program that was started anew after a crash whether it hears the cameras that it has found.

A program that is killed leaves its part of Fast DDS's shared memory behind. Now and then a camera goes on writing to it
after the successor has made its own: both know each other, and nothing is heard, for ever. See
docs/decisions/processes.md.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

LIMIT_S = 8.0
"""A camera needs less for its first picture."""


@dataclass(slots=True)
class _Ear:
    made: Subscription | None = None
    heard: bool = False
    matched_at_s: float | None = None


class Hearing:
    """Watches the subscriptions of one process to cameras: topics ``camera_info``, and ``image_raw`` beside one.

    Parameters
    ----------
    limit_s
        How long a publisher may be known without a first message.
    """

    def __init__(self, limit_s: float = LIMIT_S) -> None:
        self.limit_s = limit_s
        self._ears: list[tuple[Node, _Ear]] = []

    def install(self) -> None:
        """Watch every subscription that is made from now on in this process."""
        create_subscription = Node.create_subscription

        @functools.wraps(create_subscription)
        def subscription(
            node: Node, kind: Any, topic: str, callback: Callable[[Any], None], *args: Any, **kwargs: Any
        ) -> Any:
            ear = _Ear()

            def hears(message: Any) -> None:
                ear.heard = True
                callback(message)

            ear.made = create_subscription(node, kind, topic, hears, *args, **kwargs)
            self._ears.append((node, ear))
            return ear.made

        Node.create_subscription = subscription

    def deaf(self, now_s: float) -> str:
        """Return a topic on which a camera is there and was never heard for too long, empty without one."""
        self._ears = [(node, ear) for node, ear in self._ears if not ear.heard and ear.made in node.subscriptions]
        for node, ear in self._ears:
            assert ear.made is not None
            topic: str = ear.made.topic_name
            if not self._is_camera(node, topic) or not ear.made.get_publisher_count():
                ear.matched_at_s = None
                continue
            if ear.matched_at_s is None:
                ear.matched_at_s = now_s
            if now_s - ear.matched_at_s > self.limit_s:
                return topic
        return ""

    @staticmethod
    def _is_camera(node: Node, topic: str) -> bool:
        place, _, name = topic.rpartition("/")
        return name == "camera_info" or (name == "image_raw" and node.count_publishers(f"{place}/camera_info") > 0)
