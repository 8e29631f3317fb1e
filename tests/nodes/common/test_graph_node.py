"""Nodes that follow /clock: timers in the step that reaches them, and messages that are counted until processed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE, StepLedger
from icu_common.nodes import qos
from icu_common.nodes.graph_node import GraphNode, this_process
from icu_common.nodes.messages.heads import time_message
from icu_common.nodes.newest import NewestSubscription
from icu_common.nodes.timers import every, seconds_of

START_NS = 1_700_000_000_000_000_000
SIMULATED = {"use_sim_time": True}


@pytest.fixture
def ledger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StepLedger]:
    """Let this process count, and return the table as another process sees it."""
    monkeypatch.setenv(LEDGER_VARIABLE, str(tmp_path / "steps"))
    with contextlib.closing(StepLedger(tmp_path / "steps")) as watched:
        watched.time_ns = START_NS
        this_process.count_steps()
        try:
            yield watched
        finally:
            this_process.end()


@pytest.fixture
def step(ros: Any) -> Callable[[GraphNode, float], None]:
    """Publish a time on /clock, in seconds after the start, and wait until a node has it."""
    clock = ros.plain("clock").create_publisher(Clock, "/clock", qos.LATCHED)

    def advance(node: GraphNode, after_s: float) -> None:
        ros.spin_until(lambda: clock.get_subscription_count() > 0, 10.0)
        now_ns = START_NS + round(after_s * 1e9)
        clock.publish(Clock(clock=time_message(now_ns)))
        ros.spin_until(lambda: node.get_clock().now().nanoseconds == now_ns, 10.0)

    return advance


def test_time_that_was_published_before_a_node_started_reaches_it(ros: Any, ledger: StepLedger) -> None:
    """A publisher may count a subscription that does not receive yet; then the simulation would wait for it."""
    now_ns = START_NS + 2_000_000_000
    ros.plain("clock").create_publisher(Clock, "/clock", qos.LATCHED).publish(Clock(clock=time_message(now_ns)))
    node = ros.node(make, SIMULATED)
    ros.spin_until(lambda: node.get_clock().now().nanoseconds == now_ns, 10.0)


def make(**options: Any) -> GraphNode:
    return GraphNode("simulated", **options)


def test_timer_fires_in_the_step_that_reaches_it(ros: Any, step: Callable[[GraphNode, float], None]) -> None:
    node = ros.node(make, SIMULATED)
    fired: list[float] = []
    now_s = seconds_of(node)
    every(node, 0.05, lambda: fired.append(round(now_s() - START_NS / 1e9, 3)))
    for after_s in (0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.5, 0.52):
        step(node, after_s)
    assert fired == [0.06, 0.1, 0.5], "once for a long step"


def test_timer_goes_on_after_time_was_set_back(ros: Any, step: Callable[[GraphNode, float], None]) -> None:
    node = ros.node(make, SIMULATED)
    fired: list[int] = []
    every(node, 1.0, lambda: fired.append(1))
    for after_s in (100.0, 101.0, 0.0, 1.0):
        step(node, after_s)
    assert len(fired) == 2


def test_wall_timer_fires_while_simulated_time_stands_still(ros: Any) -> None:
    node = ros.node(make, SIMULATED)
    fired: list[int] = []
    every(node, 0.02, lambda: fired.append(1), wall=True)
    ros.spin_until(lambda: len(fired) >= 3, 10.0)


def test_node_begins_at_the_time_of_its_graph(ros: Any, ledger: StepLedger) -> None:
    node = ros.node(make, SIMULATED)
    assert node.get_clock().now().nanoseconds == START_NS
    assert this_process.simulated


def test_message_counts_as_processed_when_its_callback_has_returned(ros: Any, ledger: StepLedger) -> None:
    node = ros.plain("node")
    during: list[tuple[int, bool]] = []

    def callback(message: String) -> None:
        during.append((ledger.finished("/words"), ledger.is_busy(0)))

    node.create_subscription(String, "/words", callback, QoSProfile(depth=1))
    publisher = node.create_publisher(String, "/words", qos.SENSOR)
    ros.spin_until(lambda: publisher.get_subscription_count() == 1, 10.0)
    for number in range(20):  # more than the depth and best effort would hold
        publisher.publish(String(data=f"{number}"))
    ros.spin_until(lambda: len(during) == 20, 10.0)
    ros.spin_until(lambda: ledger.finished("/words") == 20, 10.0)
    assert during == [(number, True) for number in range(20)] and not ledger.is_busy(0)
    assert int(ledger.totals()[1].sum()) >= 20


def test_overtaken_messages_count_as_processed(ros: Any, ledger: StepLedger) -> None:
    node = ros.plain("node")
    seen: list[str] = []
    newest = NewestSubscription(node, String, "/words", lambda message: seen.append(message.data))
    publisher = node.create_publisher(String, "/words", qos.RESULTS)
    ros.spin_until(lambda: publisher.get_subscription_count() == 1, 10.0)
    for number in range(5):
        publisher.publish(String(data=f"{number}"))
    publisher.wait_for_all_acked()
    ros.spin_until(lambda: seen[-1:] == ["4"], 10.0)
    ros.spin_until(lambda: ledger.finished("/words") == 5, 10.0, lambda: ledger.finished("/words"))
    newest.end()
    assert ledger.subscriptions("/words") == 0


def test_subscription_of_a_program_that_does_not_count_is_not_waited_for(
    ros: Any, ledger: StepLedger, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = ros.plain("node")
    publisher = node.create_publisher(String, "/words", qos.RESULTS)
    with monkeypatch.context() as patch:
        patch.setattr(this_process, "ledger", None)
        heard = ros.collect(ros.plain("stranger"), String, "/words", qos.RESULTS)
    ros.spin_until(lambda: publisher.get_subscription_count() == 1, 10.0)
    publisher.publish(String(data="x"))
    ros.spin_until(lambda: heard, 10.0)
    columns = ledger.topics()
    assert ledger.totals()[1][columns.index("/words")] == 0
