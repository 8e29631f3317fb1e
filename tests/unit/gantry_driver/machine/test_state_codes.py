"""Codes of the driver's states: other programs decide by them, and they stay with a state while its reason does."""

from __future__ import annotations

import json

import pytest
from unit.gantry_driver.protocol_board import Board, Rig

from gantry_driver.core.configuration.machine_config import DriverConfig, MachineConfig
from gantry_driver.core.guard.messages import event_of, event_values
from gantry_driver.core.states.machine_states import StateChanged
from gantry_driver.core.states.reasons import STOP_REQUESTED, Reason, why_of
from icu_common.core.reasons.codes import DriverCode


def moving() -> Rig:
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.03), (0.2, 0.1, 0.03))
    rig.until(lambda: rig.board.mpos[2] < -30.9)
    return rig


@pytest.mark.parametrize(
    ("why", "code"),
    [
        (STOP_REQUESTED, DriverCode.STOP_REQUESTED),
        (Reason(code=DriverCode.STOP_REQUESTED, text="by another name"), DriverCode.STOP_REQUESTED),
        ("stop requested", ""),
    ],
)
def test_a_stop_has_the_code_that_it_was_requested_with_until_the_reset(why: Reason | str, code: str) -> None:
    rig = moving()
    rig.machine.stop(why, rig.now)
    assert rig.machine.phase.name == "HOLDING"
    rig.step()
    assert rig.code() == code
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == f"stopped: {why}" and rig.code() == code
    assert rig.codes == ({"code": code, "reason": str(why)} if code else {})
    assert rig.results[-1].reason == str(why)
    assert rig.machine.reset(rig.now) == ""
    rig.step()
    assert rig.state == "idle" and rig.code() == ""


def test_a_second_stop_does_not_change_the_code() -> None:
    rig = moving()
    rig.machine.stop("deactivated", rig.now)
    rig.machine.stop(STOP_REQUESTED, rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: deactivated" and rig.code() == ""


def test_a_lost_heartbeat_has_its_code() -> None:
    rig = moving()
    rig.beating = False
    rig.until(lambda: rig.state == "stopped")
    assert rig.code() == DriverCode.HEARTBEAT_LOST


def test_a_mismatch_of_settings_and_one_of_the_place_have_different_codes() -> None:
    board = Board()
    board.settings[110] = "500.000"
    rig = Rig(board=board).connect()
    assert rig.state == "mismatch" and rig.code() == DriverCode.SETTINGS_DIFFER
    board = Board()
    board.settings[27] = "2.000"
    rig = Rig(DriverConfig(enabled_at_start=True, machine=MachineConfig(pull_off_mm=2.0)), board).connect()
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "mismatch")
    assert rig.code() == DriverCode.HOMED_ELSEWHERE


def test_codes_pass_between_guard_and_node() -> None:
    event = StateChanged(text="stopped: stop requested", codes=(("code", "driver.stop_requested"),))
    assert event_of(json.loads(json.dumps(event_values(event)))) == event
    assert event_of(["StateChanged", {"text": "idle", "logged": True}]) == StateChanged(text="idle")
    assert why_of("stop requested", DriverCode.STOP_REQUESTED.value) == STOP_REQUESTED
    assert why_of("the end", "driver.of_a_newer_program") == "the end"
