"""Node that subscribes to topics as they appear and hands their serialized messages to a bag."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from icu_common.nodes.timers import every
from scope_bench.adapters.bag_sink import BagSink
from scope_bench.adapters.bags import BagTopic, is_known
from scope_bench.nodes.bag_qos import listening_qos, message_class, recorded_qos

_LOOK_S = 0.1


class BagRecorder(Node):
    """Records ``topics``, or all; a name that matches ``exclude`` is left out.

    Messages are stamped with the time at which they were received, and never unpacked.
    """

    def __init__(self, sink: BagSink, topics: Sequence[str], exclude: str = "", **options: Any) -> None:
        super().__init__("bag_recorder", **options)
        self._sink = sink
        self._topics = [self.resolve_topic_name(name) for name in topics]
        self._exclude = re.compile(exclude) if exclude else None
        self.recorded: set[str] = set()
        self._ignored: set[str] = set()
        every(self, _LOOK_S, self._look)
        self._look()

    @property
    def missing(self) -> list[str]:
        """Topics that were asked for and that nobody publishes yet."""
        return [name for name in self._topics if name not in self.recorded | self._ignored]

    def _look(self) -> None:
        for name, kinds in self.get_topic_names_and_types():
            wanted = name in self._topics if self._topics else not (self._exclude and self._exclude.search(name))
            if wanted and name not in self.recorded and name not in self._ignored:
                self._record(name, kinds)

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
            self.get_logger().error(f"{name} is not recorded: {error}")
            return
        self.recorded.add(name)
        self._sink.add_topic(BagTopic(name=name, type=kinds[0], qos=tuple(recorded_qos(offer) for offer in offers)))
        profile = listening_qos(kinds[0], offers)
        self.create_subscription(kind, name, lambda data: self._sink.put(name, self._now_ns(), data), profile, raw=True)

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)
