"""A controller that ends or hangs while the stylus is down: the driver misses its signs, holds and lifts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from nodes.guard_rig import HOMED, GuardRig
from std_msgs.msg import Bool

from icu_common.nodes.qos import RESULTS

TIMEOUT_S = 0.4
SILENT = "stopped: gantry_controller has sent no sign of its goal for 0."
Attend = Callable[[bool], None]


@pytest.fixture
def pressing(ros: Any, tmp_path: Path) -> Iterator[tuple[GuardRig, Attend]]:
    rig = GuardRig(ros, tmp_path, attendance_timeout_s=TIMEOUT_S)
    try:
        rig.op.ready()
        outlet = rig.op.node.create_publisher(Bool, "attending", RESULTS)
        rig.op.until(lambda: outlet.get_subscription_count() == 1)
        rig.press()
        yield rig, lambda attends: outlet.publish(Bool(data=attends))
    finally:
        rig.close()


def wait_s(rig: GuardRig, seconds: float) -> None:
    begun_s = rig.now_s()
    rig.op.until(lambda: rig.now_s() > begun_s + seconds)


def test_a_controller_whose_signs_end_in_contact_is_missed(pressing: tuple[GuardRig, Attend]) -> None:
    rig, attend = pressing
    since, begun_s = rig.entry(), rig.now_s()
    attend(True)
    rig.until_lifted()
    assert TIMEOUT_S < rig.held_s(since) - begun_s < TIMEOUT_S + 1.0
    rig.op.state(SILENT)


def test_a_controller_that_goes_on_is_not_missed(pressing: tuple[GuardRig, Attend]) -> None:
    rig, attend = pressing
    since = rig.entry()
    for _ in range(8):
        attend(True)
        wait_s(rig, TIMEOUT_S / 4)
    attend(False)
    wait_s(rig, 3 * TIMEOUT_S)
    assert not [e for e in rig.board.log(since) if e["kind"] == "realtime" and e["byte"] == ord("!")]
    assert rig.z_mm() < HOMED[2] - 10.0, "a program without such signs rests extended for as long as before"


def test_a_controller_that_ends_at_rest_is_not_missed(pressing: tuple[GuardRig, Attend]) -> None:
    rig, attend = pressing
    rig.op.results.clear()
    rig.op.go((0.1, 0.05, 0.0))
    rig.op.until(lambda: rig.op.results and rig.op.results[-1].outcome.value == "reached")
    attend(True)
    wait_s(rig, 3 * TIMEOUT_S)
    assert rig.op.states[-1] == "idle"
