"""Connecting, homing and starting where something is missing, odd or too late."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
from unit.gantry_driver.protocol_board import HOMED, Board, Rig

from gantry_driver.core.configuration.machine_config import DriverConfig, MachineConfig, StylusConfig
from gantry_driver.core.grbl.contradictions import OUT_OF_TURN
from gantry_driver.core.grbl.grbl_messages import parse_line
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import CloseRequested, MachinePhase, Note
from gantry_driver.core.wire.faults import MotionFault
from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.frames import JOINTS

CONFIG = DriverConfig(enabled_at_start=True)
RUNS = b"<Run|MPos:-1.000,-1.000,-1.000|Bf:15,128|FS:0,0>\r\n"
IDLE = b"<Idle|MPos:-1.000,-1.000,-1.000|Bf:15,128|FS:0,0>\r\n"


class OtherOffsets(Board):
    """A board whose first ``told`` reports have the work offset, and no later one."""

    told = 0

    def report(self) -> str:
        self.told -= 1
        text = super().report()
        return text if self.told >= 0 else text[: text.index("|WCO")] + ">"


class OddHoming(Board):
    """A board that is in another state after homing."""

    after = "Door:1"

    def step(self, now: float) -> None:
        homing = self.homing_until >= 0
        super().step(now)
        if homing and self.homing_until < 0:
            self.state = self.after


def closings(rig: Rig) -> list[str]:
    return [event.reason for event in rig.events if isinstance(event, CloseRequested)]


# --- connecting -------------------------------------------------------------------------------------------------------


def test_a_board_found_moving_is_held_once_in_a_while_and_reset_once() -> None:
    machine = Machine(CONFIG)
    machine.opened(0.0)
    machine.output(0.0)
    machine.receive(RUNS, 1.0)
    machine.receive(RUNS, 1.01)
    assert machine.output(1.01).count(b"!") == 1
    machine.receive(IDLE, 1.02)
    machine.receive(IDLE, 1.03)
    machine.receive(RUNS, 2.0)
    assert machine.output(2.0).replace(b"?", b"") == b"\x18", "reports before the banner are of before the reset"


def test_a_refused_question_for_the_build_closes_the_port() -> None:
    board = Board()
    board.refuse["$I"] = 3
    rig = Rig(CONFIG, board)
    rig.machine.opened(0.0)
    board.reset()
    rig.until(lambda: closings(rig))
    (reason,) = closings(rig)
    assert reason.startswith("the board rejected $I: error:3") and reason.endswith("at line 1 '$I'")


def test_a_firmware_with_a_name_that_nobody_knows_keeps_the_banner_s_dialect() -> None:
    rig = Rig(CONFIG).connect()
    before = rig.machine.dialect
    rig.board.say("[FIRMWARE:other]")
    rig.step()
    rig.step()
    assert rig.machine.dialect is before and rig.machine.firmware == "other"


def test_an_answer_out_of_turn_while_connecting_connects_again() -> None:
    board = Board()
    board.hooks["$$"] = lambda: board.say("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]")
    rig = Rig(CONFIG, board)
    rig.machine.opened(0.0)
    board.reset()
    rig.until(lambda: rig.state == "unhomed")
    assert [event.text for event in rig.events if isinstance(event, Note)] == [OUT_OF_TURN]
    assert f"connecting: {OUT_OF_TURN}" in rig.states and board.received.count("$$") == 2


def test_another_rate_of_reports_begins_the_silence_again() -> None:
    rig = Rig(CONFIG).connect()
    limit_s = CONFIG.status_timeout_s
    rig.board.mute = True
    rig.run_for(0.8 * limit_s)
    rig.machine.configure(dataclasses.replace(rig.machine.config, moving_status_rate_hz=40.0), rig.now)
    rig.run_for(0.8 * limit_s)
    assert rig.state == "unhomed"
    rig.run_for(0.4 * limit_s)
    assert len(closings(rig)) == 1 and closings(rig)[0].startswith("no status report for ")


@pytest.mark.parametrize("state", ["Door:1", "Sleep"])
def test_a_board_that_is_not_idle_after_homing_is_not_homed(state: str) -> None:
    board = OddHoming()
    board.after = state
    rig = Rig(CONFIG, board).connect()
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.machine.phase is MachinePhase.ALARM)
    assert rig.machine.state_text.startswith(f"alarm: after homing the board is {state}") and not rig.machine.homed


# --- what may start ---------------------------------------------------------------------------------------------------


def test_an_inactive_driver_starts_nothing() -> None:
    rig = Rig(CONFIG).homed()
    rig.machine.activate(False, rig.now)
    answer = rig.go((0.1, 0.1, 0.0))
    rig.run_for(0.2)
    assert (answer.outcome.value, answer.reason) == ("rejected", "the driver is inactive")
    assert rig.board.mpos == list(HOMED)


def test_without_any_heartbeat_nothing_is_homed() -> None:
    rig = Rig(CONFIG)
    rig.beating = False
    rig.connect()
    assert rig.machine.home(rig.now) == "no operator's heartbeat yet"
    assert rig.machine.phase is MachinePhase.UNHOMED


@pytest.mark.parametrize(
    ("told", "reason"),
    [
        (0, "the board has not sent its work offset (WCO) yet"),
        (1, "the board has not sent the same work offset (WCO) twice yet"),
    ],
)
def test_a_program_waits_for_a_work_offset_that_two_reports_have_told(told: int, reason: str) -> None:
    board = OtherOffsets()
    rig = Rig(CONFIG, board).connect()
    board.told = told
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")
    answer = rig.machine.run_program("p", ["G1 X-300 F100"], rig.now)
    assert (answer.outcome.value, answer.reason, answer.goal) == ("rejected", reason, "program")


def test_a_program_is_refused_before_homing_and_after_another_goal_has_begun() -> None:
    rig = Rig(CONFIG).connect()
    assert rig.machine.run_program("p", ["G1 X-300 F100"], rig.now).reason == "the driver is unhomed"
    rig = Rig(CONFIG).homed()
    checker = rig.machine.program_checker()
    checked = list(checker.check_all(["G53 G1 X-300 F100"]))
    rig.go((0.1, 0.1, 0.0))
    assert rig.machine.run_checked("p", checker, checked, rig.now).reason == "the driver is moving"


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        ([Waypoint(positions_m=(0.1, 0.1))], "point 1 has 2 positions for 3 joints"),
        (
            [Waypoint(positions_m=(0.1, 0.1, 0.0), time_s=8.0), Waypoint(positions_m=(0.2, 0.1, 0.0), time_s=8.0)],
            "point 2: time_from_start 8 s does not follow 8 s",
        ),
    ],
)
def test_a_point_without_all_joints_or_without_time_is_refused(points: list[Waypoint], reason: str) -> None:
    rig = Rig(CONFIG).homed()
    answer = rig.machine.run("g", JOINTS, points, age_s=0.0, now=rig.now)
    assert (answer.outcome.value, answer.reason) == ("rejected", reason)


def test_a_point_where_the_way_down_is_cut_leaves_no_empty_move() -> None:
    """Aslant to the height at which the way down is cut, and then straight on."""
    rig = Rig(CONFIG).homed()
    cut_m = 0.03 - CONFIG.clearance_m
    rig.go((0.1, 0.1, 0.0), (0.12, 0.1, cut_m), (0.12, 0.1, 0.03))
    rig.until(lambda: rig.outcomes()[-1:] == ["reached"], 30.0)
    assert rig.board.mpos == pytest.approx([HOMED[0] + 120.0, HOMED[1] + 100.0, HOMED[2] - 30.0], abs=0.001)
    moves = [line for line in rig.board.received if line.endswith("G1") and any(a in line for a in "XYZ")]
    assert len(moves) == len(set(moves)), moves


# --- messages and configuration ---------------------------------------------------------------------------------------


def test_a_fluidnc_names_itself_in_its_version() -> None:
    message: Any = parse_line(b"[VER:3.7 FluidNC v3.7.8:]")
    assert (message.dialect.name, message.version) == ("FLUIDNC", "3.7 FluidNC v3.7.8:")


def test_a_report_with_damaged_overrides_is_none() -> None:
    good = b"<Idle|MPos:0.000,0.000,0.000|Ov:100,100,90>"
    report: Any = parse_line(good)
    assert report.overrides_percent == (100, 100, 90)
    damaged: Any = parse_line(good.replace(b"100,90", b"100"))
    assert not hasattr(damaged, "overrides_percent")


@pytest.mark.parametrize("fault", MotionFault)
def test_a_fault_of_a_motion_is_its_code_as_text(fault: MotionFault) -> None:
    assert f"{fault}" == fault.value


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (
            lambda: MachineConfig(travel_mm=(360.0, 220.0)),
            "travel_mm = (360.0, 220.0); expected three values, for x, y and z",
        ),
        (
            lambda: MachineConfig(travel_mm=(9.0, 9.0, 9.0), pull_off_mm=9.0),
            "pull_off_mm = 9 leaves nothing of travel_mm",
        ),
        (
            lambda: StylusConfig(servo_range=(1000.0, 1000.0)),
            "servo_range = (1000.0, 1000.0); expected a lower and a higher",
        ),
        (
            lambda: StylusConfig(servo_range=(0.0, 1.0, 2.0)),
            "servo_range = (0.0, 1.0, 2.0); expected a lower and a higher",
        ),
    ],
)
def test_a_machine_that_cannot_be_is_no_configuration(make: Any, reason: str) -> None:
    with pytest.raises(ConfigError) as error:
        make()
    assert reason in str(error.value)
