"""Node that subscribes to topics as they appear and hands their serialized messages to a bag."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from icu_bringup.adapters.bag.bag_sink import BagSink
from icu_bringup.adapters.bag.bags import BagTopic
from icu_bringup.adapters.bag.definitions import is_known
from icu_bringup.core.bag.account import Account
from icu_bringup.nodes.bag_qos import is_large, message_class, recorded_qos
from icu_bringup.nodes.topic_ear import TopicEar
from icu_common.nodes.graph_node import CLOCK_TOPIC, GraphNode, this_process
from icu_common.nodes.timers import runs_by_clock_topic

_LOOK_S, _TAKE_S = 0.1, 0.02
_TAKE_IN_STEP_S = 0.002
"""Seconds between two takes in a graph that runs in step, whose time waits until its messages have been taken."""
_LEAST_QUIET_S = 0.5
_LARGE_AT_ONCE, _SMALL_AT_ONCE = 4, 1000
"""Maximum number of messages taken from a topic before the other topics have their turn."""


class BagRecorder(GraphNode):
    """Records ``topics``, or all topics except names that match ``exclude``.

    Messages are never unpacked. Their stamp is the time of reception, however much later they are taken. Therefore no
    executor serves their subscriptions, as an executor does not report that time. Images and clouds use separate
    sockets: a recorder delayed by a twentieth of a second loses some of them. In a shared buffer it would also lose
    orders and states that are sent only once. Those sockets belong to a separate context, which takes ``arguments``
    (``--ros-args --enclave ...``). The ``account`` gets the messages that are not recorded.
    """

    def __init__(
        self,
        sink: BagSink,
        topics: Sequence[str],
        exclude: str = "",
        *,
        arguments: Sequence[str] = (),
        account: Account | None = None,
        **options: Any,
    ) -> None:
        super().__init__("bag_recorder", **options)
        self._sink, self._account = sink, account or Account()
        self._topics = [self.resolve_topic_name(name) for name in topics]
        self._exclude = re.compile(exclude) if exclude else None
        self.recorded: set[str] = set()
        self._ignored: set[str] = set()
        self._apart = Context()
        self._apart.init(args=list(arguments), domain_id=self.context.get_domain_id())
        self._small, self._large = self._ear("small", self.context), self._ear("large", self._apart)
        self._heard: dict[str, TopicEar] = {}
        self._other_types: set[tuple[str, str]] = set()
        self._begun_s = self._found_s = time.monotonic()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_LOOK_S, self.look, clock=steady)
        take_s = _TAKE_S if this_process.ledger is None else _TAKE_IN_STEP_S
        self.create_timer(take_s, self.take, clock=steady)
        self.look()

    def _ear(self, what: str, context: Context) -> GraphNode:
        return GraphNode(
            f"_{self.get_name()}_{what}",
            context=context,
            namespace=self.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )

    @property
    def missing(self) -> list[str]:
        """Requested topics that no program publishes yet."""
        return [name for name in self._topics if name not in self.recorded | self._ignored]

    @property
    def listens(self) -> bool:
        """Whether messages published now are recorded: all requested topics have matched subscriptions.

        Without requested topics: all topics found so far are matched, and most likely no more will be found.
        """
        heard = all(ear.matched for ear in self._heard.values())
        if self._topics:
            return heard and not self.missing
        quiet_s = time.monotonic() - self._found_s
        return heard and quiet_s >= max(_LEAST_QUIET_S, self._found_s - self._begun_s)

    def take(self) -> int:
        """Store the received messages, and return their number; more images and clouds may be waiting."""
        found: list[tuple[int, str, bytes, Callable[[bytes], None]]] = []
        clock = self.get_clock()
        if clock.ros_time_is_active and not clock.now().nanoseconds:
            return 0  # received messages wait for the first time on /clock
        for name, ear in self._heard.items():
            for received_ns, data, done in ear.take():
                came_ns = 0 if clock.ros_time_is_active else received_ns  # 0: CycloneDDS's
                found.append((came_ns or clock.now().nanoseconds, name, data, done))
        for stamp_ns, name, data, done in sorted(found, key=lambda one: one[0]):
            self._sink.put(name, stamp_ns, data)
            done(data)  # informs a player in step
        return len(found)

    def destroy_node(self) -> None:
        """Destroy the node and its subscriptions."""
        self._heard.clear()
        for ear in (self._small, self._large):
            ear.destroy_node()
        self._apart.try_shutdown()
        super().destroy_node()

    def look(self) -> None:
        """Subscribe to new topics, and follow the clock of a simulation."""
        if not runs_by_clock_topic(self) and self.count_publishers(self.resolve_topic_name(CLOCK_TOPIC)):
            # Stamps of the system time would be ahead of those in the messages, by the delay of the simulation.
            self.set_parameters([Parameter("use_sim_time", value=True)])
        for name, kinds in self.get_topic_names_and_types():
            wanted = name in self._topics if self._topics else not (self._exclude and self._exclude.search(name))
            if wanted and name not in self.recorded and name not in self._ignored:
                self._record(name, kinds)
        for name, ear in self._heard.items():
            count = self.count_publishers(name)
            # A query of the profiles takes half a millisecond for each topic.
            if count != ear.publishers or count != ear.matched:
                self._follow(name, ear)

    def _follow(self, name: str, ear: TopicEar) -> None:
        """Subscribe to publishers of another QoS, and report those of another type."""
        publishers = self.get_publishers_info_by_topic(name)
        for kind in {one.topic_type for one in publishers if one.topic_type != ear.kind}:
            if (name, kind) not in self._other_types:
                self._other_types.add((name, kind))
                self._not_recorded(name, f"type {kind} differs from {ear.kind}: a topic is recorded with one type")
        if ear.follow([one.qos_profile for one in publishers if one.topic_type == ear.kind]):
            profiles = tuple(recorded_qos(offer) for offer in ear.offers)
            self._sink.add_topic(BagTopic(name=name, type=ear.kind, qos=profiles))

    def _not_recorded(self, name: str, why: str) -> None:
        self._account.miss(name, f"not recorded: {why}", 0)
        self.get_logger().error(f"{name} is not recorded: {why}")

    def account_for_losses(self) -> None:
        """Add the messages that the middleware has lost to the account, once, at the end."""
        for name, ear in self._heard.items():
            if ear.lost:
                self._account.miss(name, "sent, and lost before the recorder received them", ear.lost)

    def _record(self, name: str, kinds: list[str]) -> None:
        offers = [info.qos_profile for info in self.get_publishers_info_by_topic(name)]
        if not offers:
            return
        try:
            if len(kinds) > 1:
                raise ValueError(f"it has several types: {', '.join(kinds)}")
            kind = message_class(kinds[0])
            if not is_known(kinds[0]):
                raise ValueError(f"the definition of {kinds[0]} is not known")
        except (ImportError, AttributeError, ValueError) as error:
            self._ignored.add(name)
            self._not_recorded(name, str(error))
            return
        self.recorded.add(name)
        self._found_s = time.monotonic()
        node, most = (self._large, _LARGE_AT_ONCE) if is_large(kinds[0]) else (self._small, _SMALL_AT_ONCE)

        def subscribe(profile: QoSProfile) -> Subscription:
            return node.create_subscription(kind, name, lambda data: None, profile, raw=True)

        self._heard[name] = TopicEar(kinds[0], subscribe, most)
        self._follow(name, self._heard[name])
