"""Subscription that delivers only the newest message, and counts the messages overtaken while a callback ran."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import Image

from icu_common.nodes import qos
from icu_common.nodes.graph_node import this_process
from icu_common.nodes.images import ReceivedImage, image_of_bytes


class NewestSubscription:
    """Calls back with the newest message that has arrived.

    Parameters
    ----------
    node
        The node that subscribes.
    message_type, topic
        As for ``Node.create_subscription``.
    callback
        Called with the message.
    raw
        Call back with the serialised message.

    Attributes
    ----------
    dropped
        Number of messages that a newer one overtook in the queue of this process. Exact with one publisher, except for
        messages that fell out of the queue before the first overrun was detected.
    """

    def __init__(
        self, node: Node, message_type: Any, topic: str, callback: Callable[[Any], None], *, raw: bool = False
    ) -> None:
        self.dropped = 0
        self._sequence = 0
        self._callback = callback
        self._node = node
        self._raw = raw
        self._subscription = node.create_subscription(message_type, topic, self._on_message, qos.NEWEST, raw=raw)

    def end(self) -> None:
        """Cancel the subscription."""
        self._node.destroy_subscription(self._subscription)

    def _on_message(self, message: Any) -> None:
        # The executor delivers the oldest message of the queue; the rest is taken here. The middleware counts the
        # messages that a writer sent, which shows how many more fell out of a full queue. rclpy 7.1's EventsExecutor
        # fails on callbacks that request this count, so it is known only for messages that are taken here.
        drained = 0
        while (newer := self._subscription.handle.take_message(self._subscription.msg_type, self._raw)) is not None:
            message, info = newer
            drained += 1
        if drained:
            if this_process.ledger is not None:
                this_process.ledger.finish(self._subscription.topic_name, drained)
            gap = int(info.get("publication_sequence_number") or 0) - self._sequence - 1
            full = drained >= qos.NEWEST.depth - 1
            self.dropped += max(drained, gap) if full and self._sequence else drained
            self._sequence += gap + 1
        elif self._sequence:
            self._sequence += 1
        self._callback(message)


class NewestImage(NewestSubscription):
    """NewestSubscription for images, which are not unpacked: the callback gets the newest as a ReceivedImage."""

    def __init__(self, node: Node, topic: str, callback: Callable[[ReceivedImage], None]) -> None:
        super().__init__(node, Image, topic, lambda data: callback(image_of_bytes(data)), raw=True)
