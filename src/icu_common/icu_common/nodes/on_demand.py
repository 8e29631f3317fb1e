"""Inputs that a node subscribes to only while another program reads its results.

Receiving a colour image of 1280x720 costs the reader 3 ms of processor time and the camera 1 ms, used or not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from icu_common.core.configuration.config import setting


def on_demand_setting(what: str = "Take images only while a program subscribes to a result") -> Any:
    """Return the setting ``on_demand`` of a node's configuration."""
    why = "a recording that is replayed in step needs the same subscriptions from its first message to its last"
    return setting(True, f"{what}. false: always, because {why}", read_only=True)


class OnDemand:
    """Starts and stops the inputs of a node as readers of its outputs appear and disappear.

    The middleware reports each reader that is matched or lost, so nothing is polled.

    Parameters
    ----------
    node
        The node that publishes.
    start, stop
        Create and destroy the subscriptions of the inputs.
    always
        Start at once and never stop.

    Attributes
    ----------
    running
        Whether the inputs are subscribed to.
    """

    def __init__(
        self, node: Node, start: Callable[[], None], stop: Callable[[], None], *, always: bool = False
    ) -> None:
        self._node, self._start, self._stop, self._always = node, start, stop, always
        self._outputs: list[Publisher] = []
        self._begun = self.running = False

    def publisher(self, kind: Any, topic: str, profile: QoSProfile) -> Publisher:
        """Create the publisher of one output."""
        events = PublisherEventCallbacks(matched=lambda status: self._follow())
        made = self._node.create_publisher(kind, topic, profile, event_callbacks=events)
        self._outputs.append(made)
        return made

    def begin(self) -> None:
        """Follow the readers from now on; call this after everything that the inputs need exists."""
        self._begun = True
        self._follow()

    @property
    def wanted(self) -> bool:
        """Whether an output has a reader."""
        return any(output.get_subscription_count() > 0 for output in self._outputs)

    def _follow(self) -> None:
        if not self._begun:
            return
        wanted = self._always or self.wanted
        if wanted == self.running:
            return
        self.running = wanted
        (self._start if wanted else self._stop)()
