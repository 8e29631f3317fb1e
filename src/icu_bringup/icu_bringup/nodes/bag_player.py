"""Node that publishes a bag's messages in their serialized form, including unpacked images."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from pathlib import PurePosixPath
from typing import Any

from rclpy.duration import Duration
from rclpy.qos import ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from icu_bringup.adapters.bag.bag_pictures import BESIDE, COMPRESSED, IMAGE, SUFFIX, PictureCodec
from icu_bringup.adapters.bag.bags import BagTopic
from icu_bringup.nodes.bag_qos import message_class, playing_qos
from icu_common.nodes import qos
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.heads import time_message

_LAST_WORDS = Duration(seconds=2)
MOVING = (
    *("gantry/goal", "gantry/command", "gantry/sequence", "gantry/trajectory", "gantry/stop_request"),
    *("operator/heartbeat", "panel/teach/request"),
)
"""Topics that move a machine, allow it to move, or make it store a panel."""
ASIDE = {"gantry/trajectory": "gantry/recorded_trajectory"}
"""Topics played under another name: a page shows them, and no driver subscribes to that name."""


class BagPlayer(GraphNode):
    """Publishes messages of a bag.

    Parameters
    ----------
    topics
        Topics to play.
    unpack
        Publish images that were recorded compressed as ``Image`` on their original topic.
    twice
        Topics whose images were also recorded raw: their compressed images stay compressed.
    in_step
        Lose no message, and offer /clock from the start.
    aside
        Publish topics in ASIDE under their other names.
    toggle
        Called by the service ``toggle_paused``; returns whether playback is now paused.
    """

    def __init__(
        self,
        topics: Iterable[BagTopic],
        *,
        unpack: bool = True,
        twice: Collection[str] = (),
        in_step: bool = False,
        aside: bool = True,
        toggle: Callable[[], bool] = lambda: False,
        **options: Any,
    ) -> None:
        super().__init__("bag_player", **options)
        self._codec = PictureCodec()
        self._packed: set[str] = set()
        # Not the name of rclpy's own list of publishers.
        self._outputs: dict[str, Any] = {}
        self._clock_out: Any = self.create_publisher(Clock, "/clock", qos.RESULTS) if in_step else None
        topics = list(topics)
        apart = {*twice, *(t.name.removesuffix(BESIDE + SUFFIX) for t in topics if t.name.endswith(BESIDE + SUFFIX))}
        for topic in topics:
            name, kind = topic.name, topic.type
            base = name.removesuffix(SUFFIX)
            if unpack and kind == COMPRESSED and base != name and base not in apart:
                self._packed.add(name)
                name, kind = base.removesuffix(BESIDE), IMAGE
            for ending, other in ASIDE.items() if aside else ():
                if name.endswith(ending):
                    name = name.removesuffix(ending) + other
            profile = playing_qos(topic.qos)
            self._outputs[topic.name] = self.create_publisher(message_class(kind), name, profile)
        self._toggle = toggle
        self.create_service(Trigger, "~/toggle_paused", self._on_toggle)

    def _on_toggle(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, "paused" if self._toggle() else "playing"
        return response

    def show_time(self, bag_ns: int) -> None:
        """Publish the bag's time on /clock."""
        if self._clock_out is None:
            self._clock_out = self.create_publisher(Clock, "/clock", qos.RESULTS)
        self._clock_out.publish(Clock(clock=time_message(bag_ns)))

    def play(self, topic: str, data: bytes) -> str:
        """Publish one message and return the topic's absolute name; raises ValueError for a broken image."""
        output = self._outputs[topic]
        if topic in self._packed:
            try:
                data = self._codec.unpack(data)
            except ValueError as error:
                raise ValueError(f"{topic}: {error}; --keep-compressed plays it as it is") from error
        output.publish(data)
        return str(output.topic_name)

    def others(self, topic: str) -> str:
        """Return a topic's name here if other programs publish it, otherwise an empty text."""
        name = self.resolve_topic_name(topic)
        mine = [output for output in self._outputs.values() if output.topic_name == name]
        return name if self.count_publishers(name) > len(mine) else ""

    @property
    def places(self) -> set[PurePosixPath]:
        """All namespaces of the played topics."""
        return {place for output in self._outputs.values() for place in PurePosixPath(output.topic_name).parents}

    @property
    def unheard(self) -> list[str]:
        """Topics without a subscriber."""
        return [name for name, publisher in self._outputs.items() if publisher.get_subscription_count() == 0]

    @property
    def matched(self) -> tuple[int, ...]:
        """Number of matched subscribers of each topic."""
        return tuple(output.get_subscription_count() for output in self._outputs.values())

    @property
    def unmatched(self) -> bool:
        """Whether the graph has a subscriber that is not matched yet, or cannot be because of its QoS."""
        return any(
            self.count_subscribers(output.topic_name) > output.get_subscription_count()
            for output in self._outputs.values()
        )

    def settle(self) -> None:
        """Wait until every reliable subscriber has the last messages, for at most two seconds."""
        for publisher in self._outputs.values():
            if publisher.qos_profile.reliability is ReliabilityPolicy.RELIABLE:
                publisher.wait_for_all_acked(_LAST_WORDS)
