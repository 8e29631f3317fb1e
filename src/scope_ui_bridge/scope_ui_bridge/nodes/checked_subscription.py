"""Subscriptions whose invalid messages are logged and ignored."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from icu_common.core.configuration.text_bounds import plain
from icu_common.nodes.graph_node import GraphNode


def subscribe(
    node: GraphNode, message_type: Any, topic: str, profile: QoSProfile, take: Callable[[Any], None], **kwargs: Any
) -> Subscription:
    """Subscribe ``take``, which raises ValueError for an invalid message; the rest is as for the node."""

    def callback(message: Any) -> None:
        try:
            take(message)
        except ValueError as error:
            node.get_logger().error(f"{topic}: ignored: {plain(str(error))}", throttle_duration_sec=5.0)

    return node.create_subscription(message_type, topic, callback, profile, **kwargs)
