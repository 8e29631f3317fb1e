"""The base of every node of the graph: counted messages, timers of simulated time, watched and bounded subscriptions.

rclpy stays unchanged: all additions override ``create_publisher`` and ``create_subscription``, through
which rclpy itself subscribes to ``/clock``.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rclpy.clock_type import ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.time import Time

from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE, StepLedger
from icu_common.nodes.admission.message_sizes import max_bytes_of
from icu_common.nodes.qos import ARRIVES_WHOLE, LATCHED

CLOCK_TOPIC = "/clock"
Observer = Callable[[Node, Subscription], Callable[[], None]]
"""Function of a new subscription; it returns a function to call before each callback of the subscription."""
_DEPTH = 200
"""Queue depth of subscriptions in a process that counts: no message may be dropped."""
_DROPPED_S = 5.0
"""Minimum interval between two log entries on messages that were dropped."""
_PUBLISHED_DEPTH = 20
"""Number of messages that a publisher holds until every subscription has them; images take 3 MB each."""


@dataclass(slots=True)
class ProcessContext:
    """State shared by the nodes of this process.

    Attributes
    ----------
    ledger
        Ledger in which messages are counted; None in a process that uses its own clock.
    observer
        Observer of every subscription; None if there is none.
    publishers
        The counted publishers.
    """

    ledger: StepLedger | None = None
    observer: Observer | None = None
    publishers: list[Publisher] = field(default_factory=list)

    def count_steps(self) -> None:
        """Register with the ledger that the environment names, if any.

        Raises
        ------
        OSError
            If the ledger cannot be opened.
        """
        path = os.environ.get(LEDGER_VARIABLE, "")
        if path and self.ledger is None:
            self.ledger = StepLedger(Path(path))
            self.ledger.register()

    @property
    def simulated(self) -> bool:
        """Whether a simulation advances the time; a recording played in step does not set the ledger's time."""
        return self.ledger is not None and self.ledger.time_ns > 0

    def show_matches(self) -> None:
        """Write to the ledger how many subscriptions each publisher has found."""
        if self.ledger is not None:
            for publisher in self.publishers:
                self.ledger.match(publisher.topic_name, publisher.get_subscription_count())
            self.ledger.show()

    def end(self) -> None:
        """Release the row of the ledger."""
        if self.ledger is not None:
            self.ledger.close()
        self.ledger, self.observer = None, None
        self.publishers.clear()


this_process = ProcessContext()


class CountedPublisher(Publisher):
    """A publisher that counts each message once for every registered subscription that receives it."""

    def publish(self, msg: Any) -> None:
        """Count and send a message."""
        if (ledger := this_process.ledger) is not None:
            # Programs that do not count, such as `ros2 topic echo`, are only among the matched ones.
            topic = self.topic_name
            ledger.expect(topic, min(self.get_subscription_count(), ledger.subscriptions(topic)))
        super().publish(msg)


@dataclass(slots=True)
class _ClockTimer:
    period_ns: int
    callback: Callable[[], object]
    due_ns: int | None = None


class _Graph:
    """Overrides of Node; this class precedes Node in the order of bases."""

    # Node.__init__ subscribes to /clock before a constructor of this class could set them.
    _clock_timers: list[_ClockTimer]
    _clock_listeners: list[Callable[[int], object]]
    _clock_match_listeners: list[Callable[[], object]]
    clock_subscription: Subscription | None = None
    """rclpy's subscription to the graph's time; None while the node uses its own clock."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        clock = self.get_clock()  # type: ignore[attr-defined]
        if this_process.ledger is not None and clock.ros_time_is_active and (now_ns := this_process.ledger.time_ns):
            # Before the first message on /clock the time would be 0, and then jump by decades.
            clock.set_ros_time_override(Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any, **kwargs: Any) -> Any:
        """Create a publisher as Node does; it counts if the process counts."""
        if this_process.ledger is None:
            return super().create_publisher(msg_type, topic, qos_profile, **kwargs)  # type: ignore[misc]
        kwargs.setdefault("publisher_class", CountedPublisher)
        profile = _lossless(qos_profile, published=True)
        made = super().create_publisher(msg_type, topic, profile, **kwargs)  # type: ignore[misc]
        this_process.publishers.append(made)
        return made

    def destroy_publisher(self, publisher: Publisher) -> bool:
        """Destroy a publisher as Node does."""
        if publisher in this_process.publishers:
            this_process.publishers.remove(publisher)
        return bool(super().destroy_publisher(publisher))  # type: ignore[misc]

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Any,
        qos_profile: Any,
        *,
        observed: bool = True,
        max_bytes: int | None = None,
        too_large: Callable[[int], object] | None = None,
        **kwargs: Any,
    ) -> Any:
        """Create a subscription as Node does; the process's ledger and observer are informed of each callback.

        Parameters
        ----------
        msg_type, topic, callback, qos_profile, **kwargs
            As for Node. With ``raw`` there is no limit unless ``max_bytes`` is given.
        observed
            Whether the process's observer counts the messages.
        max_bytes
            Largest serialised message that is unpacked, 0 for no limit; None for the limit of the type.
        too_large
            Called with the size in bytes of a larger message instead of ``callback``.
        """
        raw = bool(kwargs.get("raw", False))
        if max_bytes is None:
            max_bytes = 0 if raw else max_bytes_of(msg_type)
        if max_bytes:
            callback = self._bounded(msg_type, topic, callback, raw, max_bytes, too_large)
            kwargs["raw"] = True
        ledger, observer = this_process.ledger, this_process.observer if observed else None
        name, before = "", None
        runs_timers = topic == CLOCK_TOPIC and not raw  # rclpy's own subscription; a recorder takes the bytes
        if runs_timers:
            kwargs.setdefault("event_callbacks", SubscriptionEventCallbacks(matched=self._on_clock_match))

        def take(message: Any) -> None:
            if before is not None:
                before()
            callback(message)
            if runs_timers:
                self._run_clock_timers(message.clock.sec * 1_000_000_000 + message.clock.nanosec)

        def counted(message: Any) -> None:
            assert ledger is not None
            ledger.begin_callback()
            try:
                take(message)
            finally:
                ledger.end_callback(name)

        if runs_timers and this_process.simulated:
            # DDS matches both ends at different times: the publisher may count this one before it receives. A latched
            # time arrives all the same; a lost one would stop the simulation for seconds.
            qos_profile = LATCHED
        if ledger is None:
            made = super().create_subscription(msg_type, topic, take, qos_profile, **kwargs)  # type: ignore[misc]
        else:
            made = super().create_subscription(msg_type, topic, counted, _lossless(qos_profile), **kwargs)  # type: ignore[misc]
        name = made.topic_name
        if runs_timers:
            self.clock_subscription = made
        if observer is not None:
            before = observer(self, made)  # type: ignore[arg-type]
        if ledger is not None:
            ledger.subscribe(name)
        return made

    def _bounded(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], object],
        raw: bool,
        max_bytes: int,
        too_large: Callable[[int], object] | None,
    ) -> Callable[[bytes], None]:
        """Return a callback that unpacks serialised messages within the limit and drops larger ones."""

        def bounded(data: bytes) -> None:
            if len(data) > max_bytes:
                text = f"{topic}: message of {len(data)} bytes dropped (limit {max_bytes} bytes)"
                self.get_logger().error(text, throttle_duration_sec=_DROPPED_S)  # type: ignore[attr-defined]
                if too_large is not None:
                    too_large(len(data))
                return
            try:
                message = data if raw else deserialize_message(data, msg_type)
            except RuntimeError as error:  # RMWError, which rclpy does not export
                text = f"{topic}: message of {len(data)} bytes dropped: {error}"
                self.get_logger().error(text, throttle_duration_sec=_DROPPED_S)  # type: ignore[attr-defined]
                return
            callback(message)

        return bounded

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription as Node does."""
        if (ledger := this_process.ledger) is not None:
            ledger.subscribe(subscription.topic_name, -1)
        return bool(super().destroy_subscription(subscription))  # type: ignore[misc]

    def add_clock_timer(self, period_s: float, callback: Callable[[], object]) -> None:
        """Call back every ``period_s`` of the time on ``/clock``, in the step that reaches the due time."""
        timer = _ClockTimer(period_ns=round(period_s * 1e9), callback=callback)
        self._clock_timers = [*getattr(self, "_clock_timers", []), timer]

    def add_clock_listener(self, callback: Callable[[int], object]) -> None:
        """Call back with each time on ``/clock``, in ns, before the timers of that step."""
        self._clock_listeners = [*getattr(self, "_clock_listeners", []), callback]

    def add_clock_match_listener(self, callback: Callable[[], object]) -> None:
        """Call back when a publisher of the graph's time has been matched or lost."""
        self._clock_match_listeners = [*getattr(self, "_clock_match_listeners", []), callback]

    def _on_clock_match(self, status: Any) -> None:
        for listener in getattr(self, "_clock_match_listeners", []):
            listener()

    def _run_clock_timers(self, now_ns: int) -> None:
        for listener in getattr(self, "_clock_listeners", []):
            listener(now_ns)
        for timer in getattr(self, "_clock_timers", []):
            if timer.due_ns is None or timer.due_ns > now_ns + timer.period_ns:  # the first step, or set back
                timer.due_ns = now_ns + timer.period_ns
            if now_ns >= timer.due_ns:
                # A step longer than the period causes one call, as with rclpy's timers.
                timer.due_ns += timer.period_ns * ((now_ns - timer.due_ns) // timer.period_ns + 1)
                timer.callback()


class GraphNode(_Graph, Node):
    """A node of the graph."""


class GraphLifecycleNode(_Graph, LifecycleNode):
    """A lifecycle node of the graph."""


def _lossless(profile: Any, *, published: bool = False) -> QoSProfile:
    """Return a profile with which no message is lost, dropped or outdated, with the durability of ``profile``."""
    depth = _PUBLISHED_DEPTH if published else _DEPTH
    if not isinstance(profile, QoSProfile):
        return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)
    # A publisher's depth limits how many messages a late subscriber of a latched topic receives.
    latched = published and profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
    # A reader of images that requests lost fragments can hang after a kill (docs/decisions/transport.md).
    as_sent = not published and this_process.simulated and ARRIVES_WHOLE
    return QoSProfile(
        depth=profile.depth if latched else depth,
        reliability=profile.reliability if as_sent else ReliabilityPolicy.RELIABLE,
        durability=profile.durability,
    )
