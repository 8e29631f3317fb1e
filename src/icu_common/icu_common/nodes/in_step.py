"""Counts what a process publishes and takes, so that a player can wait until nobody has anything left to do.

With the environment variable ``ICU_IN_STEP`` set, every subscription of the process is reliable and deep, and every
publication and every callback that has ended is counted and told on ``in_step``. A player that adds these numbers up
knows when each message, and all that followed from it, has been dealt with: no frame is dropped, and the results do not
depend on how fast the recording is played. See docs/decisions/bags.md.
"""

from __future__ import annotations

import functools
import json
import os
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

VARIABLE, TOPIC = "ICU_IN_STEP", "/in_step"
DEEP = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)


def wanted() -> bool:
    """Whether this process is to be counted."""
    return bool(os.environ.get(VARIABLE))


class Tally:
    """The counts of one process, by absolute topic names.

    Attributes
    ----------
    sent, taken
        Messages published, and callbacks that have ended.
    listeners
        Subscriptions.
    """

    def __init__(self) -> None:
        self.sent: Counter[str] = Counter()
        self.taken: Counter[str] = Counter()
        self.listeners: Counter[str] = Counter()
        self._publishers: list[Publisher] = []
        self._voice: Publisher | None = None
        self._publish = Publisher.publish
        self._lock = threading.RLock()
        self._busy = 0

    def install(self) -> None:
        """Count every publisher and subscription that is made from now on in this process."""
        create_publisher, create_subscription = Node.create_publisher, Node.create_subscription

        @functools.wraps(create_publisher)
        def publisher(node: Node, *args: Any, **kwargs: Any) -> Publisher:
            made = create_publisher(node, *args, **kwargs)
            self._publishers.append(made)
            if self._voice is None and made.topic_name != "/rosout":
                self._voice = create_publisher(node, String, TOPIC, DEEP)
            return made

        @functools.wraps(create_subscription)
        def subscription(
            node: Node, kind: Any, topic: str, callback: Callable[[Any], None], profile: Any, **kwargs: Any
        ) -> Any:
            names: list[str] = []

            def counted(message: Any) -> None:
                self._busy += 1
                try:
                    callback(message)
                finally:
                    self._busy -= 1
                    with self._lock:
                        self.taken[names[0]] += 1
                    self.tell()

            made = create_subscription(node, kind, topic, counted, _deep(profile), **kwargs)
            names.append(made.topic_name)
            self.listeners[made.topic_name] += 1
            return made

        def publish(made: Publisher, message: Any) -> None:
            with self._lock:
                self.sent[made.topic_name] += 1
            self._publish(made, message)
            if not self._busy:
                self.tell()

        Node.create_publisher, Node.create_subscription = publisher, subscription
        Publisher.publish = publish

    def tell(self) -> None:
        """Publish the counts."""
        if self._voice is None:
            return
        with self._lock:
            counts = {
                "process": os.getpid(),
                "sent": self.sent,
                "taken": self.taken,
                "listeners": self.listeners,
                "readers": {p.topic_name: p.get_subscription_count() for p in self._publishers},
            }
            self._publish(self._voice, String(data=json.dumps(counts)))


def _deep(profile: Any) -> QoSProfile:
    if not isinstance(profile, QoSProfile):
        return DEEP
    return QoSProfile(depth=DEEP.depth, reliability=DEEP.reliability, durability=profile.durability)
