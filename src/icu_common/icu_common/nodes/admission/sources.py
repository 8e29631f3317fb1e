"""Watch the sources of the topics that a node trusts.

The middleware reports each match of a subscription and a publisher (``matched`` of rclpy's subscription events). Only
then the watch queries the graph, so a graph at rest costs nothing. While a source is undecided, or a topic has two
sources, a timer of the wall clock repeats the query. rclpy 7.1 does not report the sender of a message, so a topic is
trusted or distrusted as a whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from icu_common.adapters.processes.process_identity import ParticipantProcesses
from icu_common.core.admission.sources import Source, TopicSources, rivals_text
from icu_common.nodes.graph_node import CLOCK_TOPIC, GraphLifecycleNode, GraphNode
from icu_common.nodes.timers import runs_by_clock_topic

LOOK_AGAIN_S = 0.1
RENEWED_WITHIN_S = 0.3
"""Seconds in which a new subscription receives the latched message of the source that is left."""
PREFIX_BYTES = 12
"""Bytes of an endpoint's identifier that identify its participant (DDS-RTPS 9.3.1)."""
NO_NAME = "_NODE_NAME_UNKNOWN_"
"""Name that rmw_fastrtps returns for a node whose name it has not received yet."""
Judge = Callable[[str, tuple[str, ...]], str]
"""Function of a topic's name and its living sources; it returns their fault, empty for none."""


@dataclass(slots=True)
class _Watched:
    subscription: Subscription
    judge: Judge
    sources: TopicSources
    renew: Callable[[], Subscription] | None = None
    """Creates the subscription of a latched topic again."""
    names: tuple[str, ...] = ()
    text: str = ""
    undecided: bool = False
    renewed_s: float | None = None
    """Time at which the subscription was created again after the present conflict."""
    names_of: dict[bytes, str] = field(default_factory=dict)
    """Last known name of each publisher: the graph forgets an ending publisher's name before the publisher itself."""


class SourceWatch:
    """Reports topics with more than one source.

    Parameters
    ----------
    node
        Owner of the watched subscriptions.
    on_change
        Called with a topic's name as used to subscribe, and the fault of its sources, empty when it has ended.
    """

    def __init__(self, node: Node, on_change: Callable[[str, str], None]) -> None:
        self._node, self._on_change = node, on_change
        self._watched: dict[str, _Watched] = {}
        self._processes = ParticipantProcesses()
        self._timer = node.create_timer(LOOK_AGAIN_S, self._look_again, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._timer.cancel()

    def subscribe(
        self,
        message_type: Any,
        topic: str,
        callback: Callable[[Any], Any],
        profile: Any,
        judge: Judge = rivals_text,
        **kwargs: Any,
    ) -> Subscription:
        """Subscribe as ``node.create_subscription`` does, and watch the topic's sources."""
        events = SubscriptionEventCallbacks(matched=lambda _: self.look(topic))
        create = partial(
            self._node.create_subscription, message_type, topic, callback, profile, event_callbacks=events, **kwargs
        )
        made = create()
        self._watch(topic, made, judge, create if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else None)
        return made

    def _watch(
        self, topic: str, made: Subscription, judge: Judge, renew: Callable[[], Subscription] | None = None
    ) -> None:
        self._watched[topic] = _Watched(made, judge, TopicSources(self._processes.is_alive), renew)
        self.look(topic)

    def watch_clock(self) -> None:
        """Watch the sources of the graph's time, if the node follows it: a second source would age all fresh data."""
        node = self._node
        if not runs_by_clock_topic(node):
            return
        assert isinstance(node, GraphNode | GraphLifecycleNode) and node.clock_subscription is not None
        node.add_clock_match_listener(lambda: self.look(CLOCK_TOPIC))
        self._watch(CLOCK_TOPIC, node.clock_subscription, rivals_text)

    def names(self, topic: str) -> tuple[str, ...]:
        """Return the full names of a topic's sources at the last query."""
        return self._watched[topic].names

    def look(self, topic: str) -> str:
        """Query the graph for a topic's sources, and return their fault.

        The fault of a latched topic ends only after the node has received the remaining source's message again. Until
        then the last message may be that of the program that left.
        """
        watched = self._watched.get(topic)
        if watched is None:  # an event before create_subscription has returned
            return ""
        found = watched.sources.judge(self._sources_of(watched), time.monotonic())
        watched.names, watched.undecided = found.names, found.undecided
        # A successor whose name is not known yet must not count as a second program.
        text = watched.text if found.unnamed else watched.judge(watched.subscription.topic_name, found.names)
        if text:
            watched.renewed_s = None
        elif watched.text and watched.renew is not None and not self._is_renewed(watched):
            text = watched.text
        if text != watched.text:
            watched.text = text
            self._on_change(topic, text)
        if watched.undecided or watched.text:
            self._timer.reset()
        return text

    @staticmethod
    def _is_renewed(watched: _Watched) -> bool:
        return watched.renewed_s is not None and time.monotonic() - watched.renewed_s > RENEWED_WITHIN_S

    def _look_again(self) -> None:
        open_ones = [topic for topic, watched in self._watched.items() if watched.undecided or watched.text]
        for topic in open_ones:
            watched = self._watched[topic]
            text = self.look(topic)
            if text and watched.renew is not None and watched.renewed_s is None and len(watched.names) < 2:
                # Not in the callback of the subscription's own event.
                self._node.destroy_subscription(watched.subscription)
                watched.subscription, watched.renewed_s = watched.renew(), time.monotonic()
        if not open_ones:
            self._timer.cancel()

    def _sources_of(self, watched: _Watched) -> list[Source]:
        subscription = watched.subscription
        topic = subscription.topic_name
        if not self._processes.known:
            for end in self._node.get_subscriptions_info_by_topic(topic):
                if _full_name(end) == self._node.get_fully_qualified_name():
                    self._processes.learn(bytes(end.endpoint_gid))
        package = subscription.msg_type.__module__.partition(".")[0]
        kind = f"{package}/msg/{subscription.msg_type.__name__}"
        ends = [end for end in self._node.get_publishers_info_by_topic(topic) if end.topic_type == kind]
        before = watched.names_of
        watched.names_of = {
            gid: _full_name(end) or before.get(gid, "") for end in ends for gid in (bytes(end.endpoint_gid),)
        }
        return [Source(name=name, process=gid[:PREFIX_BYTES]) for gid, name in watched.names_of.items()]


def _full_name(end: TopicEndpointInfo) -> str:
    return "" if end.node_name == NO_NAME else f"{end.node_namespace.rstrip('/')}/{end.node_name}"
