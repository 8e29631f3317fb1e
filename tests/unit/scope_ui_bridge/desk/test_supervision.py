"""Heartbeat and watchdog of the page in control."""

from __future__ import annotations

import pytest
from unit.scope_ui_bridge.desk_rig import Rig, of_type, refusal

from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.effects import (
    PublishHeartbeat,
    StopNow,
)


def test_the_heartbeat_follows_the_operators_keep_alives() -> None:
    rig = Rig()
    assert 9 <= len(of_type(rig.wait(1.0, alive=True), PublishHeartbeat)) <= 10
    assert of_type(rig.wait(0.3), PublishHeartbeat)
    rig.wait(0.15)
    silent = rig.wait(1.6)
    assert of_type(silent, PublishHeartbeat) == [], "none after 400 ms of silence"
    assert of_type(silent, StopNow) == [], "nothing moves, so there is nothing to stop"
    assert of_type(rig.wait(0.5, alive=True), PublishHeartbeat)


def test_without_an_operator_there_is_no_heartbeat_even_with_live_viewers() -> None:
    rig = Rig(operator=False)
    assert of_type(rig.wait(2.0, alive=True), PublishHeartbeat) == []


@pytest.mark.parametrize("moving", ["driver", "controller", "calibration", "pending"])
def test_600_ms_of_silence_while_something_moves_stops_it_once_and_takes_the_lease(moving: str) -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    if moving == "pending":
        rig.act()
    else:
        rig.desk.machine.set_state(moving, {"calibration": "calibrating 3/12"}.get(moving, "moving"))
    assert of_type(rig.wait(0.55), StopNow) == []
    effects = rig.wait(0.1)
    (stop,) = of_type(effects, StopNow)
    assert (stop.record["who"], stop.record["target"]) == ("Watchdog", "stopped_link_lost")
    assert rig.desk.lease.holder == ""
    assert of_type(rig.wait(2.0, alive=True), (PublishHeartbeat, StopNow)) == [], "nothing resumes by itself"
    assert refusal(rig.act()) == "no_lease"


def test_a_motion_whose_pictures_stop_is_stopped_once() -> None:
    rig = Rig()
    rig.desk.machine.picture_came(rig.now)
    rig.desk.machine.set_state("driver", "moving")
    assert of_type(rig.wait(0.55, alive=True), StopNow) == []
    (stop,) = of_type(rig.wait(0.5, alive=True), StopNow)
    assert stop.record["target"] == "stopped_no_picture"
    assert rig.desk.lease.holder == rig.a


def test_a_motion_begun_without_pictures_or_by_nobody_here_goes_on() -> None:
    rig = Rig()
    rig.desk.machine.picture_came(rig.now)
    rig.wait(3.0, alive=True)
    rig.desk.machine.set_state("driver", "homing")
    assert of_type(rig.wait(3.0, alive=True), StopNow) == [], "homing needs no picture"
    rig = Rig(operator=False)
    rig.desk.machine.picture_came(rig.now)
    rig.desk.machine.set_state("driver", "moving")
    assert of_type(rig.wait(3.0), StopNow) == []


def test_a_page_that_goes_away_stops_what_it_moved_at_once() -> None:
    rig = Rig()
    rig.desk.machine.set_state("controller", "touching")
    (stop,) = of_type(rig.desk.leave(rig.a, rig.now), StopNow)
    assert stop.record["target"] == "stopped_page_gone"
    rig = Rig()
    assert of_type(rig.desk.leave(rig.a, rig.now), StopNow) == []
    assert rig.desk.lease.holder == ""


def test_a_viewers_page_may_go_away_while_others_work() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Operator 2")
    rig.desk.machine.set_state("controller", "moving")
    assert rig.desk.leave(viewer, rig.now) == []
    assert rig.desk.lease.holder == rig.a


def test_what_others_move_from_the_command_line_is_not_stopped_without_an_operator() -> None:
    rig = Rig(operator=False)
    rig.desk.machine.set_state("controller", "moving")
    assert of_type(rig.wait(2.0), StopNow) == []


def test_an_idle_operator_loses_control_after_the_timeout() -> None:
    rig = Rig()
    assert of_type(rig.wait(5.2), StopNow) == []
    assert rig.desk.lease.holder == ""


@pytest.mark.parametrize("timeout_s", [2.0, 8.0])
def test_a_change_of_the_timeout_is_in_force_at_once(timeout_s: float) -> None:
    rig = Rig()
    rig.desk.config = BridgeConfig(lease_timeout_s=timeout_s)
    rig.wait(timeout_s - 0.2)
    assert rig.desk.lease.holder == rig.a
    rig.wait(0.4)
    assert rig.desk.lease.holder == ""
