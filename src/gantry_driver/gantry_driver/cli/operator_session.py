"""Common part of the command line programs: a node that acts as the operator while the program runs.

It publishes the heartbeat, receives states and results, waits with deadlines, and requests a stop on Ctrl-C.
"""

from __future__ import annotations

import argparse
import math
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeAlias

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Empty, Float32, Header, String

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.goals.results import GoalResult
from icu_common.core.reasons.codes import CODE
from icu_common.nodes import qos
from icu_common.nodes.graph_node import CLOCK_TOPIC
from icu_common.nodes.messages.heads import time_message
from icu_common.nodes.messages.results import result_of_message
from icu_common.nodes.runtime import prepare_transport, start_rclpy
from icu_common.nodes.state_codes import StateCodes
from icu_common.nodes.timers import every, runs_by_clock_topic

REACHED, FAILED, USAGE, TIMED_OUT = 0, 1, 2, 3
"""Exit codes."""
HEARTBEAT_S = 0.2
SLOW_SIMULATION = 0.9
"""Simulation factor below which it is shown."""
_TOLD_BY = ("gantry/driver_state", "gantry/result")
BEATS_HEARD = 6
"""Number of heartbeats before the first goal, counted per receiver: three with driver and controller, six with one."""
GONE_S, AT_REST_S = 2.0, 5.0
"""Seconds after which a wait for an answer ends: its sender is out of the graph, or at rest (the sequencer's limit)."""
_TURN_S = 0.05
Ends: TypeAlias = set[tuple[int, ...]]
_NEGATIVE = re.compile(r"-\.?[0-9]")


def number(text: str) -> float:
    """Return an argument as a finite number, for argparse."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not finite")
    return value


def with_negatives(arguments: Sequence[str]) -> list[str]:
    """Return arguments with a blank before negative numbers such as -1e-3, which argparse would mistake for options."""
    return [f" {text}" if _NEGATIVE.match(text) else text for text in arguments]


class Interrupted(Exception):
    """Ctrl-C or SIGTERM."""


class TimedOut(Exception):
    """A wait has passed its deadline; the message names what was missing."""


class OperatorSession:
    """The operator's end of the graph; names are relative, so ``-r __ns:=/bed_1`` addresses another robot."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.interrupted = False
        self.results = self.hear("gantry/result")
        self.states: dict[str, list[str]] = {}
        self._codes: dict[str, StateCodes] = {}
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._heartbeat = node.create_publisher(Header, "operator/heartbeat", qos.RESULTS)
        self._stop = node.create_publisher(Empty, "gantry/stop_request", qos.RESULTS)
        self.watch("gantry/state")
        every(node, HEARTBEAT_S, self._beat, wall=True)
        self._beats_heard = 0
        self._factor = 1.0
        self._followed: tuple[float, int] | None = None
        """Wall and simulated time at which this node began to follow ``/clock``."""
        node.create_subscription(Float32, "simulation_factor", self._on_factor, qos.LATCHED)

    def _on_factor(self, message: Float32) -> None:
        slow, was_slow = message.data < SLOW_SIMULATION, self._factor < SLOW_SIMULATION
        self._factor = message.data
        if slow and not was_slow:
            say(f"simulation runs at {message.data:.1f} of real time: the computer is busy")

    def watch(self, topic: str) -> None:
        """Collect the texts of a latched state topic in ``states[topic]``."""
        texts = self.states.setdefault(topic, [])
        self.node.create_subscription(String, topic, lambda m: texts.append(m.data), qos.EACH_LATCHED)

    def watch_codes(self, topic: str) -> None:
        """Collect the codes that a state topic's program reports on ``/diagnostics``."""
        self._codes[topic] = StateCodes(self.node, topic)

    def code_of(self, topic: str, text: str) -> str | None:
        """Return the code that was reported with a text of a state topic: empty without one, None if not yet known."""
        values = self._codes[topic].values_of(plain(text))
        return None if values is None else values.get(CODE, "")

    def hear(self, topic: str) -> list[GoalResult]:
        """Return the list that collects the answers on a topic; invalid answers are logged."""
        answers: list[GoalResult] = []

        def take(message: DiagnosticArray) -> None:
            try:
                answers.append(result_of_message(message))
            except ValueError as error:
                self.node.get_logger().warning(f"{topic}: {error}")

        self.node.create_subscription(DiagnosticArray, topic, take, qos.RESULTS)
        return answers

    def latest(self, topic: str) -> str:
        """Return the newest text of a state topic, empty before the first."""
        texts = self.states[topic]
        return texts[-1] if texts else ""

    def now_ns(self) -> int:
        return int(self.node.get_clock().now().nanoseconds)

    def wait_for(self, condition: Callable[[], Any], until: float, missing: Callable[[], str]) -> Any:
        """Spin until the condition holds and return its value.

        Parameters
        ----------
        condition
            Called after every callback.
        until
            Deadline on ``time.monotonic()``; a slow simulation extends it.
        missing
            Returns the message after the deadline.

        Raises
        ------
        TimedOut, Interrupted
        """
        while not (value := condition()):
            if self.interrupted:
                raise Interrupted
            if time.monotonic() - self._lost_s() > until:
                raise TimedOut(missing())
            self._executor.spin_once(timeout_sec=_TURN_S)
        return value

    def wait_for_answer(
        self,
        answer: Callable[[], Any],
        topic: str,
        resting: Callable[[], str],
        until: float,
        missing: Callable[[], str],
    ) -> Any:
        """Wait for the answer to a message that was just sent, as :meth:`wait_for`, while a program can answer it.

        A program that has died is no longer in the graph; a restarted one is at rest and does not have the message.

        Parameters
        ----------
        answer
            Called after every callback.
        topic
            Topic of the answer.
        resting
            Returns a text on the program that is at rest, empty while it works.
        until, missing
            As for :meth:`wait_for`.

        Raises
        ------
        TimedOut, Interrupted
        """
        takers = self.publishers(topic)
        gone_s = rest_s = 0.0
        last = time.monotonic()

        def answered() -> Any:
            nonlocal gone_s, rest_s, last
            if value := answer():
                return value
            # A blockage of this process does not count: messages that arrived during it are still unread.
            now = time.monotonic()
            turn_s, last = min(now - last, 2 * _TURN_S), now
            gone_s = 0.0 if takers & self.publishers(topic) else gone_s + turn_s
            rest_s = rest_s + turn_s if resting() else 0.0
            if gone_s > GONE_S:
                raise TimedOut(f"who answers on {self.node.resolve_topic_name(topic)} has gone; {missing()}")
            if rest_s > AT_REST_S:
                raise TimedOut(f"{resting()} for {AT_REST_S:g} s without an answer")
            return None

        return self.wait_for(answered, until, missing)

    def publishers(self, topic: str) -> Ends:
        """Return the publishers of a topic, each by an identifier that no other and no later one has."""
        name = self.node.resolve_topic_name(topic)
        return {tuple(end.endpoint_gid) for end in self.node.get_publishers_info_by_topic(name)}

    def wait_until_taken(self, publisher: Publisher, answers: str, until: float) -> None:
        """Wait until a program receives and answers the publisher's messages, and the heartbeat is received."""
        self.wait_for(
            lambda: publisher.get_subscription_count() > 0 and self.node.count_publishers(answers) > 0,
            until,
            lambda: f"nobody takes {publisher.topic_name}: is the graph running, and in this ROS domain?",
        )
        self.wait_until_heard(until)

    def follow_clock_topic(self, until: float) -> None:
        """Take ROS time from ``/clock`` if the graph does, so that a goal's stamp is in the graph's time."""
        clock = self.node.resolve_topic_name(CLOCK_TOPIC)
        # The controller is known by now, its source of time perhaps not yet.
        simulated = self.node.count_publishers(clock) or self.node.count_subscribers(clock)
        if simulated and not runs_by_clock_topic(self.node):
            self.node.set_parameters([Parameter("use_sim_time", value=True)])
            self.wait_for(lambda: self.now_ns() > 0, until, lambda: "no time on /clock: does the simulation run?")
            self._followed = (time.monotonic(), self.now_ns())

    def _lost_s(self) -> float:
        """Return the seconds by which simulated time has fallen behind wall time; 0 without a simulation."""
        if self._followed is None:
            return 0.0
        wall_s, ros_ns = self._followed
        return max(time.monotonic() - wall_s - (self.now_ns() - ros_ns) / 1e9, 0.0)

    def wait_until_heard(self, until: float) -> None:
        """Wait until driver and controller have received the heartbeat."""
        self.wait_for(lambda: self.latest("gantry/state"), until, lambda: "no gantry/state: is the controller running?")
        self.wait_for(
            lambda: self._beats_heard >= BEATS_HEARD,
            until,
            lambda: f"nobody takes {self._heartbeat.topic_name}; the controller is {self.latest('gantry/state')!r}",
        )
        self.follow_clock_topic(until)

    def stop(self) -> None:
        """Request a stop of the driver, and wait until the request has been delivered."""
        self._stop.publish(Empty())
        self._stop.wait_for_all_acked(Duration(seconds=1.0))

    def close(self) -> None:
        self._executor.remove_node(self.node)
        self._executor.shutdown()
        self.node.destroy_node()

    def _beat(self) -> None:
        # Driver and controller are identified by the topics that they publish; a recorder or a page may subscribe as
        # well. Discovery of the second can take longer than that of the first.
        listeners = _nodes(self.node.get_subscriptions_info_by_topic(self._heartbeat.topic_name))
        roles = (_nodes(self.node.get_publishers_info_by_topic(topic)) for topic in _TOLD_BY)
        self._beats_heard += sum(bool(nodes & listeners) for nodes in roles)
        sender = self.node.get_fully_qualified_name()
        self._heartbeat.publish(Header(stamp=time_message(self.now_ns()), frame_id=sender))


def _nodes(ends: Sequence[TopicEndpointInfo]) -> set[tuple[str, str]]:
    return {(end.node_namespace, end.node_name) for end in ends}


def _own_clock(arguments: Sequence[str]) -> list[str]:
    """Return the remapping to the clock of the robot whose namespace the arguments name."""
    named = [text.removeprefix("__ns:=").strip("/") for text in arguments if text.startswith("__ns:=")]
    return ["--ros-args", "-r", f"/clock:=/{named[-1]}/clock"] if named and named[-1] else []


@contextmanager
def operator_session(name: str, arguments: Sequence[str]) -> Iterator[OperatorSession]:
    """Start rclpy with the ROS part of the arguments, and end it cleanly in every case."""
    prepare_transport()
    start_rclpy([*arguments, *_own_clock(arguments)])
    session: OperatorSession | None = None
    old = {}
    try:
        session = OperatorSession(Node(name))

        def interrupt(number: int, frame: FrameType | None) -> None:
            assert session is not None
            session.interrupted = True

        old = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
        yield session
    finally:
        for number, handler in old.items():
            signal.signal(number, handler)
        if session is not None:
            session.close()
        rclpy.shutdown()


def say(text: str) -> None:
    """Print a line without delay, also into a pipe."""
    print(text, flush=True)


def complain(text: str) -> None:
    """Print an error line."""
    print(f"error: {text}", file=sys.stderr, flush=True)
