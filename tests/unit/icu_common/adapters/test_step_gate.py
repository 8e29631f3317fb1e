"""When time may advance: the shared counts of a graph's processes, and what is still outstanding."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from icu_common.adapters.steps.step_gate import StepGate
from icu_common.adapters.steps.step_ledger import StepLedger, ledger_path
from icu_common.core.processes.outstanding import Outstanding


class Clock:
    """Wall time that a test sets."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def ledgers(tmp_path: Path) -> Iterator[list[StepLedger]]:
    """Three processes of one graph; the third only watches."""
    made = [StepLedger(tmp_path / "steps") for _ in range(3)]
    for ledger in made[:2]:
        ledger.register()
    yield made
    for ledger in made:
        ledger.close()


@pytest.fixture
def gate(ledgers: list[StepLedger], clock: Clock) -> StepGate:
    gate = StepGate(ledgers[2], patience_s=5.0, callback_patience_s=60.0, clock=clock)
    gate.settled()  # the first look finds new processes
    return gate


def test_step_ends_when_what_followed_from_a_message_is_processed_too(
    ledgers: list[StepLedger], gate: StepGate
) -> None:
    camera, detector = ledgers[:2]
    detector.subscribe("/image")
    camera.subscribe("/corners")
    assert gate.settled()
    camera.expect("/image")
    assert not gate.settled() and gate.owed() == ["/image"]
    detector.expect("/corners")
    detector.finish("/image")
    assert not gate.settled() and gate.owed() == ["/corners"]
    camera.finish("/corners")
    assert gate.settled() and gate.owed() == []


def test_message_to_two_subscriptions_is_processed_twice(ledgers: list[StepLedger], gate: StepGate) -> None:
    camera, detector = ledgers[:2]
    detector.subscribe("/image", 2)
    assert camera.subscriptions("/image") == 2 and gate.settled()
    camera.expect("/image", 2)
    detector.finish("/image")
    assert not gate.settled()
    detector.finish("/image")
    assert gate.settled()


def test_latched_message_of_an_earlier_step_does_not_hide_an_outstanding_one(
    ledgers: list[StepLedger], gate: StepGate
) -> None:
    publisher, late = ledgers[:2]
    late.subscribe("/state")
    late.finish("/state")  # it was published before there was a subscription, and so is not expected
    assert gate.settled()
    publisher.expect("/state")
    assert not gate.settled()


@pytest.mark.parametrize("busy", [False, True])
def test_time_goes_on_without_a_process_that_makes_no_progress(
    ledgers: list[StepLedger], gate: StepGate, clock: Clock, busy: bool
) -> None:
    camera, detector = ledgers[:2]
    detector.subscribe("/image")
    assert gate.settled()
    camera.expect("/image")
    if busy:
        detector._table[0, 1, 1] = 1  # in a callback
    assert not gate.settled()
    clock.now_s += 5.1
    assert gate.settled() is not busy
    clock.now_s += 60.0
    assert gate.settled() and [late.topic for late in gate.left_behind] == ["/image"]
    assert camera.subscriptions("/image") == 0, "nothing more is expected of it, so that time goes on at its pace"
    detector.finish("/image")
    assert gate.settled() and camera.subscriptions("/image") == 1
    camera.expect("/image")
    assert not gate.settled(), "the process goes on, and is waited for again"


def test_progress_elsewhere_is_none_for_what_is_outstanding(
    ledgers: list[StepLedger], gate: StepGate, clock: Clock
) -> None:
    camera, detector = ledgers[:2]
    detector.subscribe("/image")
    detector.subscribe("/heartbeat")
    assert gate.settled()
    camera.expect("/image")
    for _ in range(12):
        detector.finish("/heartbeat")  # of a program that does not count
        settled = gate.settled()
        clock.now_s += 0.5
    assert settled, "a lost message must not stop the time for ever"


def test_messages_on_another_topic_do_not_prolong_the_wait(
    ledgers: list[StepLedger], gate: StepGate, clock: Clock
) -> None:
    """The simulation factor is published by the wall clock, also while simulated time is stopped."""
    camera, detector = ledgers[:2]
    detector.subscribe("/image")
    detector.subscribe("/simulation_factor")
    assert gate.settled()
    camera.expect("/image")
    for _ in range(12):
        camera.expect("/simulation_factor")
        settled = gate.settled()
        detector.finish("/simulation_factor")
        settled = settled or gate.settled()
        clock.now_s += 0.5
    assert settled and [late.topic for late in gate.left_behind] == ["/image"]


def test_message_that_was_counted_for_a_process_that_was_ending_costs_half_a_second(
    ledgers: list[StepLedger], gate: StepGate, clock: Clock
) -> None:
    camera, detector = ledgers[:2]
    camera.subscribe("/image")
    detector.subscribe("/image")
    assert gate.settled()
    detector.leave()
    assert gate.settled()
    camera.expect("/image", 2)  # it read the number of subscriptions earlier
    camera.finish("/image")
    gate.settled()
    clock.now_s += 0.4
    assert not gate.settled()
    clock.now_s += 0.2
    assert gate.settled()
    clock.now_s += 10.0
    assert gate.settled()
    camera.expect("/image")
    assert not gate.settled()
    clock.now_s += 4.9
    assert not gate.settled(), "later the usual patience applies"


def test_process_that_has_ended_is_not_waited_for(tmp_path: Path, ledgers: list[StepLedger], clock: Clock) -> None:
    camera, watcher = ledgers[0], ledgers[2]
    gate = StepGate(watcher, patience_s=5.0, clock=clock)
    script = (
        "import sys\nfrom pathlib import Path\nfrom icu_common.adapters.steps.step_ledger import StepLedger\n"
        "ledger = StepLedger(Path(sys.argv[1]))\nledger.register()\nledger.subscribe('/image')\n"
        "ledger.finish('/other', 7)\nprint('ready', flush=True)\nsys.stdin.read()\n"
    )
    other = subprocess.Popen(
        [sys.executable, "-c", script, str(watcher.path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert other.stdout is not None and other.stdin is not None
    assert other.stdout.readline() == "ready\n"
    gate.settled()
    camera.expect("/image")
    assert not gate.settled() and gate.processes() == 3
    other.kill()
    # No program collects its exit code: bring-up may be suspended itself.
    os.waitid(os.P_PID, other.pid, os.WEXITED | os.WNOWAIT)
    for pipe in (other.stdout, other.stdin):
        pipe.close()
    clock.now_s += 1.0
    assert not gate.settled()
    assert gate.settled() or gate.settled(), "within its patience: the process is gone"
    assert gate.processes() == 2 and os.getpid() in watcher.processes().values()
    other.wait()


def test_graphs_of_other_domains_and_namespaces_have_other_ledgers() -> None:
    places = [ledger_path(domain, name) for domain, name in (("", ""), ("1", ""), ("", "bed_1"), ("1", "bed_1"))]
    assert len(set(places)) == 4
    assert ledger_path("0", "/bed_1/") == ledger_path("", "bed_1")


def test_file_that_is_no_ledger_is_refused(tmp_path: Path) -> None:
    (tmp_path / "steps").write_text("something else")
    with pytest.raises(OSError, match=r"steps: 14 bytes, a step ledger has \d+; delete it"):
        StepLedger(tmp_path / "steps")


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_outstanding_exactly_when_all_deliveries_are_finished(seed: int) -> None:
    rng = np.random.default_rng(seed)
    print(f"seed {seed}")
    subscriptions = rng.integers(0, 3, 6)
    outstanding, expected, finished = Outstanding(), np.zeros(6, np.int64), np.zeros(6, np.int64)
    outstanding.update(finished, expected, subscriptions)
    for _ in range(50):
        topic = int(rng.integers(6))
        expected[topic] += subscriptions[topic]
        if rng.random() < 0.7:
            finished[topic] += subscriptions[topic]
        missing = expected - finished
        assert (outstanding.update(finished, expected, subscriptions) == missing).all()
    outstanding.forgive(outstanding.update(finished, expected, subscriptions))
    assert not outstanding.update(finished, expected, subscriptions).any()
