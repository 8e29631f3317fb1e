"""Presses on the whole graph while one byte in five hundred is damaged on the wire: every answer is true.

``make noise`` runs it for ten minutes; NOISE_MINUTES sets another time.
"""

from __future__ import annotations

import collections
import itertools
import os
import random
import time
from collections.abc import Iterator
from typing import Any

import pytest
from std_msgs.msg import String
from support.ros_rig import domain_of_worker
from system.conftest import RunningGraph
from system.damaging_proxy import DamagingProxy
from system.terminal_operator import Operator

from icu_common.core.goals.results import GoalResult, Outcome

MINUTES = float(os.environ.get("NOISE_MINUTES", "1"))
BYTES_APART = 500
SEED = 1
CONTROLS = ("RUN_STOP", "SINGLE", "AUTO_SET", "SAVE", "MENU", "CH1", "CH2", "TRIG_MENU", "CURSORS", "MATH")
ANSWER_WITHIN_S = 90.0
READY_WITHIN_S = 90.0
DEEPEST_MM = 2.0
"""Overtravel of a press, at most: 1 mm is planned, and the panel is measured to some tenths."""
RECOVERIES = {"stopped": "reset", "alarm": "reset", "unhomed": "home", "mismatch": "write_settings"}

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(600 + 60 * MINUTES), pytest.mark.long]


@pytest.fixture(scope="module")
def noisy_graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[RunningGraph, DamagingProxy]]:
    folder = tmp_path_factory.mktemp("noise")
    link, domain = folder / "noisy", domain_of_worker(150, 40)
    graph = RunningGraph(folder, domain, "--real-time", "--set", f"serial_driver.port={link}")
    try:
        with DamagingProxy(graph.run_dir / "grbl", link, BYTES_APART, SEED) as proxy:
            graph.prepare()
            yield graph, proxy
            if graph.process.poll() is None:
                graph.stop()
    finally:
        if graph.process.poll() is None:
            graph.stop()


@pytest.fixture
def running_graph(noisy_graph: tuple[RunningGraph, DamagingProxy]) -> RunningGraph:
    """The graph that the operator of this file works with."""
    return noisy_graph[0]


def recover(operator: Operator) -> None:
    """Do what an operator does after a stop, until the machine is ready."""
    deadline = time.monotonic() + READY_WITHIN_S
    while not (operator.state == "ready" and operator.driver_state == "idle"):
        assert time.monotonic() < deadline, f"not ready: {operator.state!r}, {operator.driver_state!r}"
        if service := RECOVERIES.get(operator.driver_state.partition(":")[0]):
            operator.call(f"/gantry/{service}")
        wait_for_change(operator, operator.driver_state, time.monotonic() + 0.5)


def wait_for_change(operator: Operator, before: str, until: float) -> None:
    operator.ros.spin_until(lambda: time.monotonic() > until or operator.driver_state != before, 10.0)


def falsehoods(name: str, answer: GoalResult, events: list[dict[str, Any]]) -> list[str]:
    """Compare an answer with what happened on the bench from the goal to the next one."""
    touched = [event for event in events if event["event"] in ("contact", "collision")]
    presses = [event["control"] for event in events if event["event"] == "press"]
    found = [f"{event['event']} at {event['control']!r}" for event in touched if event["control"] != name]
    deepest = max((event["overtravel_mm"] for event in events if event["event"] == "release"), default=0.0)
    if deepest > DEEPEST_MM:
        found.append(f"pressed {deepest:.2f} mm deep")
    if answer.outcome is Outcome.REACHED and presses != [name]:
        found.append(f"reached, but pressed was {presses}")
    admitted = "gone down" in answer.reason or "touched" in answer.reason
    if answer.outcome is not Outcome.REACHED and touched and not admitted:
        found.append("the answer does not say that the stylus has touched")
    return found


def test_every_answer_is_true_while_bytes_are_damaged(
    noisy_graph: tuple[RunningGraph, DamagingProxy], operator: Operator
) -> None:
    graph, proxy = noisy_graph
    rng, outcomes = random.Random(SEED), collections.Counter[str]()
    wrong: list[str] = []
    end = time.monotonic() + 60.0 * MINUTES
    for number in itertools.count(1):
        if time.monotonic() > end:
            break
        name, begin = rng.choice(CONTROLS), len(graph.truth_log())
        proxy.damage(True)
        operator.command.publish(String(data=f"press:{name} id=noise-{number}"))
        answer = operator.answer(f"noise-{number}", ANSWER_WITHIN_S)
        proxy.damage(False)
        recover(operator)
        outcomes[answer.outcome.value] += 1
        for text in falsehoods(name, answer, graph.truth_log()[begin:]):
            wrong.append(f"press {number} of {name}: {text}; answer {answer.outcome.value}: {answer.reason!r}")
    print(f"\nseed {SEED}, {MINUTES:g} minutes: {dict(outcomes)}\n{proxy.described()}")
    assert not wrong, "\n".join([*wrong, proxy.described()])
    assert outcomes["reached"], f"no press was reached: {dict(outcomes)}"
    assert proxy.to_board.count and proxy.from_board.count, proxy.described()
