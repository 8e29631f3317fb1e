"""A recorder's subscriptions to one topic: one for each kind of QoS that its publishers offer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from icu_bringup.core.bag.sequence_gaps import SequenceGaps
from icu_bringup.nodes.bag_qos import listening_qos

_REMEMBERED = 5000
Taken = tuple[int, bytes, Callable[[bytes], None]]


class TopicEar:
    """Receives the messages of all publishers of a topic, each message once.

    A single subscription that matches every publisher has the weakest QoS of all. It would miss the latched messages
    and the retransmissions that stronger publishers offer.

    Parameters
    ----------
    kind
        Type, as ``package/msg/Name``.
    subscribe
        Creates a subscription.
    most
        Maximum number of messages taken at once.

    Attributes
    ----------
    offers
        Profiles of all publishers that the topic has had.
    publishers
        Number of publishers at the last query of the profiles.
    """

    def __init__(self, kind: str, subscribe: Callable[[QoSProfile], Subscription], most: int) -> None:
        self.kind, self._subscribe, self._most = kind, subscribe, most
        self.subscriptions: dict[tuple[ReliabilityPolicy, DurabilityPolicy], Subscription] = {}
        self.offers: list[QoSProfile] = []
        self.publishers = 0
        self._gaps = SequenceGaps()
        self._seen: deque[tuple[int, int]] = deque(maxlen=_REMEMBERED)

    @property
    def lost(self) -> int:
        """Number of messages that were sent and not received."""
        return self._gaps.lost

    @property
    def matched(self) -> int:
        """Number of matched publishers."""
        return max((one.handle.get_publisher_count() for one in self.subscriptions.values()), default=0)

    def follow(self, offers: Sequence[QoSProfile]) -> bool:
        """Subscribe to all offered kinds of QoS; return whether a profile is new."""
        self.publishers = len(offers)
        new = [offer for number, offer in enumerate(offers) if offer not in [*self.offers, *offers[:number]]]
        self.offers += new
        for offer in new:
            profile = listening_qos(self.kind, [offer])
            key = (profile.reliability, profile.durability)
            if key not in self.subscriptions:
                self.subscriptions[key] = self._subscribe(profile)
        return bool(new)

    def take(self) -> Iterator[Taken]:
        """Yield (time of reception in ns or 0, CDR, callback) of each received message; the callback takes the CDR."""
        several = len(self.subscriptions) > 1
        for subscription in list(self.subscriptions.values()):
            for _ in range(self._most):
                if (taken := subscription.handle.take_message(subscription.msg_type, True)) is None:
                    break
                data, about = taken
                sent_ns, number = about.get("source_timestamp") or 0, about.get("publication_sequence_number")
                if several and sent_ns and number is not None:
                    if (sent_ns, number) in self._seen:
                        subscription.callback(data)  # a player in step counts each sent message
                        continue
                    self._seen.append((sent_ns, number))
                if number is not None:
                    self._gaps.add(number, max(1, self.publishers), sent_ns)
                yield int(about["received_timestamp"]), data, subscription.callback
