"""The machine's policy against a board in virtual time: connect, home, move, stop, and the traps of the protocol."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from unit.gantry_driver import protocol_board
from unit.gantry_driver.protocol_board import HOMED, SETTINGS, Board, Rig

from gantry_driver.core.configuration.machine_config import DriverConfig, MachineConfig, StylusConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.machine.proof import QUEUED_LINES
from gantry_driver.core.program.gcode_check import CheckedLine
from gantry_driver.core.states.machine_states import Note
from icu_common.core.configuration.config import ConfigError, settings_of
from icu_common.core.geometry.frames import JOINTS


def test_connects_checks_settings_and_waits_unhomed() -> None:
    rig = Rig().connect()
    assert rig.states == ["disconnected: not opened yet", "connecting", "unhomed"]
    assert rig.board.received == ["$I", "$$", "$N"]
    assert rig.machine.session.rx_bytes == 128
    assert rig.positions == []


def test_settings_that_readings_depend_on_are_told_once_they_are_known() -> None:
    rig = Rig()
    assert rig.machine.settings_text() == ""
    rig.connect()
    # The test's board has no $3.
    told = dict(part.split("=") for part in rig.machine.settings_text().split())
    assert list(told) == ["$23", "$27", "$100", "$101", "$102", "$130", "$131", "$132"]
    assert [float(told[key]) for key in ("$100", "$102", "$131")] == [80.0, 400.0, 220.0]


def test_a_board_that_is_already_idle_is_reset_without_loss() -> None:
    rig = Rig(locked=False)
    rig.machine.opened(0.0)
    rig.until(lambda: rig.state == "unhomed")
    assert rig.board.resets == 1


def test_a_board_found_in_an_alarm_in_which_it_answers_nothing_is_reset() -> None:
    rig = Rig(locked=False)
    rig.board.alarm(1)  # GRBL reacts only to a reset then, and to a reset after half a second only
    rig.machine.opened(0.0)
    rig.until(lambda: rig.state == "unhomed", 20.0)
    assert rig.machine.connects == 1 and rig.now < rig.machine.config.connect_timeout_s


def test_a_board_found_moving_is_held_before_it_is_reset() -> None:
    rig = Rig(locked=False)
    rig.board.write(b"F1000X300G53G1\n")
    rig.board.step(0.001)
    assert rig.board.state == "Run"
    rig.machine.opened(0.0)
    rig.until(lambda: rig.state == "unhomed")
    codes = [code for _, code in rig.board.realtime if code != ord("?")]
    assert codes[0] == ord("!") and codes[-1] == 0x18
    assert rig.board.executed == [] and rig.board.state == "Idle"


def test_home_then_a_trajectory_is_executed_in_machine_coordinates() -> None:
    rig = Rig().homed()
    assert rig.positions[-1] == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    assert rig.go((0.1, 0.05, 0.0), (0.1, 0.05, 0.02)).outcome.value == "accepted"
    rig.until(lambda: "reached" in rig.outcomes())
    assert rig.outcomes() == ["accepted", "reached"]
    assert rig.board.mpos == pytest.approx([HOMED[0] + 100.0, HOMED[1] + 50.0, HOMED[2] - 20.0])
    # X and Y from -460 and -320, Z from the deepest point.
    frame = "F1800G21G90G94X201Y151Z20G92"
    assert rig.board.executed == ["G21G90G94", "F9000X-259Y-169G53G1", frame, "Z0G1", "G4P0"]
    assert rig.machine.reading_m == pytest.approx((0.1, 0.05, 0.02))
    assert rig.results[-1].error_m < 1e-6 and rig.results[-1].duration_s > 0.5
    counts = rig.machine.counts
    assert counts.sent == counts.acknowledged == counts.executed == len(rig.board.received)


def test_reached_is_not_said_before_the_machine_stands() -> None:
    rig = Rig().homed()
    rig.board.speed_scale = 0.6
    rig.go((0.1, 0.0, 0.0))
    rig.until(lambda: "reached" in rig.outcomes(), 20.0)
    assert rig.outcomes() == ["accepted", "reached"]
    assert rig.board.mpos[0] == pytest.approx(HOMED[0] + 100.0) and rig.board.state == "Idle"


@pytest.mark.parametrize(
    ("point", "kwargs", "reason"),
    [
        ((math.nan, 0.0, 0.0), {}, "gantry_x_joint = nan is not finite"),
        ((0.0, math.inf, 0.0), {}, "gantry_y_joint = inf is not finite"),
        ((0.3591, 0.0, 0.0), {}, "outside 0 to 0.359 m"),
        ((0.0, -0.001, 0.0), {}, "outside 0 to 0.219 m"),
        ((0.0, 0.0, 0.06), {}, "outside 0 to 0.059 m"),
        ((0.1, 0.0, 0.0), {"velocities_m_s": (0.5, 0.0, 0.0)}, "30000 mm/min (limit 12000"),
        ((0.1, 0.0, 0.0), {"time_s": 0.01}, "limit 12000 mm/min"),
        ((0.1, 0.0, 0.0), {"velocities_m_s": (math.nan, 0.0, 0.0)}, "not finite"),
        ((0.1, 0.0, 0.0), {"velocities_m_s": (1.7e308, 1.7e308, 0.0)}, "limit 12000 mm/min"),
        ((0.1, 0.0, 0.0), {"time_s": -1.0}, "time_from_start -1 s is negative"),
    ],
)
def test_bad_points_are_refused_and_nothing_is_sent(point: tuple[float, ...], kwargs: dict, reason: str) -> None:  # type: ignore[type-arg]
    rig = Rig().homed()
    lines = len(rig.board.received)
    answer = rig.go(point, **kwargs)
    rig.run_for(0.3)
    assert answer.outcome.value == "rejected" and reason in answer.reason
    assert len(rig.board.received) == lines and rig.board.mpos == list(HOMED)
    assert rig.state == "idle" and rig.outcomes() == ["rejected"]


def test_a_stylus_is_lifted_though_a_report_rounds_the_place_beyond_the_end() -> None:
    """At 80 steps/mm a report may lie up to 6 um beyond the end of the travel."""
    rig = Rig().homed()
    rig.go((0.359, 0.1, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.board.mpos[0] += 0.006
    rig.run_for(0.2)
    x, y, _ = rig.machine.reading_m or (0.0, 0.0, 0.0)
    assert x == pytest.approx(0.359006)
    rig.go((x, y, 0.0))
    rig.until(lambda: rig.outcomes().count("reached") == 2)
    assert rig.board.mpos[0] == pytest.approx(0.0) and rig.board.mpos[2] == pytest.approx(HOMED[2])
    assert "outside 0 to 0.359 m" in rig.go((0.35902, y, 0.0)).reason


def test_refused_while_unhomed_busy_disabled_stale_or_without_heartbeat() -> None:
    rig = Rig().connect()
    assert "unhomed" in rig.go((0.1, 0.1, 0.0)).reason
    rig = Rig().homed()
    assert "stale" in rig.machine.run("a", ("gantry_x_joint",), [], age_s=1.5, now=rig.now).reason
    assert "joint names" in rig.machine.run("a", ("arm",), [], age_s=0, now=rig.now).reason
    rig.machine.enable(False, rig.now)
    assert rig.go((0.1, 0.1, 0.0)).reason == "not enabled"
    rig.machine.enable(True, rig.now)
    rig.go((0.1, 0.1, 0.0))
    assert "moving" in rig.go((0.2, 0.1, 0.0)).reason
    rig.until(lambda: rig.state == "idle")
    rig.beating = False
    rig.run_for(1.0)
    assert "heartbeat lost" in rig.go((0.2, 0.1, 0.0)).reason
    assert rig.state == "idle", "idle with the stylus up needs no heartbeat"


def test_homed_and_at_rest_but_not_enabled_is_a_state_of_its_own() -> None:
    rig = Rig().homed()
    assert rig.machine.enable(False, rig.now) == ""
    rig.run_for(0.5)
    assert rig.states[-1] == "disabled" and rig.machine.homed and rig.machine.at_rest
    assert rig.go((0.1, 0.1, 0.0)).reason == rig.machine.home(rig.now) == "not enabled"
    rig.machine.enable(False, rig.now)
    rig.machine.enable(True, rig.now)
    rig.step()
    assert rig.states[-3:] == ["idle", "disabled", "idle"], "each change is said once"
    rig.go((0.1, 0.1, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())


def test_disabling_says_nothing_of_a_machine_that_is_not_homed() -> None:
    rig = Rig(DriverConfig()).connect()
    rig.step()
    assert rig.states[-1] == "unhomed" and rig.machine.home(rig.now) == "not enabled"
    rig.machine.enable(True, rig.now)
    rig.step()
    assert rig.states[-1] == "unhomed"


@pytest.mark.parametrize("at_rest", [False, True])
def test_disabling_stops_what_moves_and_lifts_a_stylus_that_is_down(at_rest: bool) -> None:
    rig = Rig().homed()
    rig.go((0.05, 0.0, 0.02))
    rig.until(lambda: "reached" in rig.outcomes() if at_rest else rig.board.mpos[2] < -10.0)
    rig.machine.enable(False, rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: disabled" and rig.board.mpos[2] == pytest.approx(HOMED[2])
    assert rig.machine.reset(rig.now) == ""
    rig.step()
    assert rig.states[-1] == "disabled"


def test_stop_holds_resets_keeps_the_position_and_stays_stopped() -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.2, 0.0))
    rig.run_for(0.5)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.outcomes() == ["accepted", "aborted"] and rig.results[-1].reason == "stop requested"
    assert rig.states[-1] == "stopped: stop requested"
    where = list(rig.board.mpos)
    rig.run_for(2.0)
    assert rig.board.mpos == where and "ALARM" not in rig.sent()
    assert "stopped" in rig.go((0.1, 0.1, 0.0)).reason
    assert rig.machine.reset(rig.now) == ""
    assert rig.state == "idle" and rig.machine.homed
    rig.step()
    rig.go((0.1, 0.1, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())
    assert rig.board.mpos[:2] == pytest.approx([HOMED[0] + 100, HOMED[1] + 100])


def test_stop_lifts_the_stylus_and_moves_nothing_else() -> None:
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.03), (0.2, 0.1, 0.03))
    rig.until(lambda: rig.board.mpos[2] < -30.9)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.board.state == "Hold:0")
    x, y = rig.board.mpos[:2]
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.board.mpos == [x, y, HOMED[2]]
    assert rig.states[-1] == "stopped: stop requested"


def test_a_stop_lifts_on_a_board_that_reports_work_positions_though_its_offset_is_garbled() -> None:
    rig = Rig()
    offset, garbled = (10.0, 20.0, -40.0), False

    def report() -> str:
        place = ",".join(f"{m - o:.3f}" for m, o in zip(rig.board.mpos, offset))
        told = "" if garbled else "|WCO:" + ",".join(map(str, offset))
        return f"<{rig.board.state}|WPos:{place}|FS:0,0{told}>"

    rig.board.report = report  # type: ignore[method-assign]
    rig.homed()
    rig.go((0.1, 0.1, 0.03), (0.2, 0.1, 0.03))
    rig.until(lambda: rig.board.mpos[2] < -30.9)
    rig.machine.stop("stop requested", rig.now)
    garbled = True  # the first report after a reset has the offset, the next ones have not
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.board.mpos[2] == pytest.approx(HOMED[2]) and rig.states[-1] == "stopped: stop requested"


def test_a_retreat_has_the_time_that_a_slow_start_takes() -> None:
    board = Board()
    board.settings[122] = "1.000"
    slow = MachineConfig(acceleration_mm_s2=(1500.0, 1500.0, 1.0))
    rig = Rig(DriverConfig(enabled_at_start=True, machine=slow, clearance_m=0.07), board=board).homed()
    rig.go((0.0, 0.0, 0.05))
    rig.until(lambda: rig.board.mpos[2] < -50.9, 60.0)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "LIFTING")
    # 50 mm at 1 mm/s^2: 14.1 s; the path at 30 mm/s would take 1.7 s of it.
    rig.board.speed_scale = 50.0 / 14.1 / 30.0
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 60.0)
    assert rig.states[-1] == "stopped: stop requested" and rig.board.mpos[2] == pytest.approx(HOMED[2])


@pytest.mark.parametrize("hold_written", [False, True])
def test_a_second_stop_lets_the_retreat_finish(hold_written: bool) -> None:
    rig = Rig().homed()
    rig.go((0.0, 0.0, 0.05))
    rig.until(lambda: rig.board.mpos[2] < -45)
    rig.machine.stop("first", rig.now)
    rig.until(lambda: rig.machine.phase.name == "LIFTING" and rig.board.state == "Run")
    for _ in range(3):
        if hold_written:  # by the thread that wanted the stop, before it could know of the retreat
            rig.board.write(b"!")
        rig.machine.stop("second", rig.now, hold_written=hold_written)
        rig.run_for(0.1)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.board.mpos == pytest.approx(list(HOMED)) and rig.states[-1] == "stopped: first"


NOT_LIFTED = "; the board did not lift the stylus, it may still press"


def pressing(config: DriverConfig | None = None) -> Rig:
    """Return a homed machine whose stylus rests on the panel."""
    rig = Rig(config).homed()
    rig.go((0.1, 0.1, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    return rig


def test_a_retreat_that_a_lost_answer_ends_is_told_and_made_by_another_stop() -> None:
    rig = pressing()
    rig.beating = False
    rig.until(lambda: rig.machine.phase.name == "LIFTING")
    first = rig.states[-1]
    rig.board.drop_answers = 1
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    rig.run_for(5.0)
    assert first.startswith("stopped: operator's heartbeat lost") and rig.states[-1] == first + NOT_LIFTED
    assert rig.board.mpos[2] == pytest.approx(HOMED[2] - 20.0)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.board.mpos == pytest.approx([HOMED[0] + 100.0, HOMED[1] + 100.0, HOMED[2]])
    assert rig.states[-1] == first, "the first reason stays, and it is up now"


def test_a_lift_that_the_board_refused_once_is_told_until_it_is_made() -> None:
    rig = pressing()
    rig.board.refuse = {"G21G90G94": 9}
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1].startswith("stopped: stop requested; the board did not lift the stylus: error:9")
    rig.board.refuse = {}
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: stop requested" and rig.board.mpos[2] == pytest.approx(HOMED[2])


@pytest.mark.parametrize("phase", ["LIFTING", "RESETTING"])
def test_a_door_that_ends_the_retreat_is_told_and_no_stop_lifts_after_it(phase: str) -> None:
    rig = pressing()
    board, leave = rig.board, rig.board.reset

    def with_the_door_open() -> None:
        leave()
        board.state = "Door:1"

    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == phase)
    board.blocks.clear()
    board.state, board.reset = "Door:1", with_the_door_open  # type: ignore[method-assign]
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    where = list(board.mpos)
    assert rig.states[-1] == "stopped: stop requested" + NOT_LIFTED and where[2] < HOMED[2] - 10.0
    board.state, board.reset = "Door:0", leave  # type: ignore[method-assign]
    for _ in range(2):
        rig.run_for(1.0)
        rig.machine.stop("stop requested", rig.now)
        rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert board.mpos == where and rig.states[-1] == "stopped: stop requested" + NOT_LIFTED
    assert rig.machine.reset(rig.now) == "" and rig.states[-1] != "idle"
    rig.step()
    assert rig.states[-1] == "idle"


def test_a_hold_that_never_completes_leaves_the_stylus_down_and_says_so_until_it_is_homed() -> None:
    rig = pressing()
    rig.board.hold_s, rig.board.speed_scale = 100.0, 0.05
    rig.go((0.2, 0.1, 0.02))
    rig.run_for(0.3)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: stop requested" + NOT_LIFTED and not rig.machine.homed
    assert rig.board.mpos[2] == pytest.approx(HOMED[2] - 20.0)
    rig.board.hold_s, rig.board.speed_scale = 0.05, 1.0
    assert rig.machine.reset(rig.now) == "" and rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: stop requested"


def test_a_link_that_is_lost_in_a_stop_leaves_the_stylus_down_and_the_stop_says_so() -> None:
    rig = pressing()
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "HOLDING")
    rig.machine.closed("the device has gone", rig.now)
    rig.collect()
    assert rig.states[-1] == "disconnected: the device has gone" + NOT_LIFTED
    rig.connect()
    rig.run_for(1.0)
    assert rig.states[-1] == "stopped: stop requested" + NOT_LIFTED
    assert rig.machine.reset(rig.now) == ""
    rig.step()
    assert rig.states[-1] == "unhomed: " + NOT_LIFTED.removeprefix("; ")


def test_what_no_stop_is_to_lift_and_what_a_reset_lets_go_is_not_told() -> None:
    rig = pressing(DriverConfig(enabled_at_start=True, lift_on_stop=False))
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: stop requested" and rig.board.mpos[2] == pytest.approx(HOMED[2] - 20.0)
    rig = pressing(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind="solenoid_m8", dwell_s=0.1)))
    rig.machine.closed("the device has gone", rig.now)
    rig.machine.stop("stop requested", rig.now)
    rig.connect()
    assert rig.states[-1] == "stopped: stop requested; the solenoid is without power, the stylus is up"


def test_resting_extended_for_too_long_is_a_stop_that_lifts() -> None:
    rig = Rig().homed()
    rig.go((0.1, 0.0, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.run_for(40.0)
    assert rig.state == "idle", "with the stylus up it may stand as long as it likes"
    rig.go((0.1, 0.0, 0.02))
    rig.until(lambda: rig.outcomes().count("reached") == 2)
    since = rig.now
    rig.until(lambda: rig.state == "stopped", 40.0)
    assert rig.now - since == pytest.approx(35.0, abs=0.1), "longer than the longest hold, 30 s"
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1].startswith("stopped: the stylus has been extended for 35.0 s (limit 35 s)")
    assert rig.board.mpos == pytest.approx([HOMED[0] + 100.0, HOMED[1], HOMED[2]])
    assert rig.machine.reset(rig.now) == "" and rig.state == "idle"


def test_each_motion_gives_a_resting_stylus_its_time_anew() -> None:
    rig = Rig(DriverConfig(enabled_at_start=True, max_rest_extended_s=2.0)).homed()
    for x in (0.01, 0.02, 0.03):
        rig.go((x, 0.0, 0.02))
        rig.until(lambda: rig.state == "idle")
        rig.run_for(1.8)
        assert rig.state == "idle"
    rig.until(lambda: rig.state == "stopped", 0.5)


def test_heartbeat_lost_while_moving_stops_and_while_pressing_lifts() -> None:
    rig = Rig().homed()
    rig.go((0.35, 0.0, 0.0))
    rig.run_for(0.2)
    rig.beating = False
    lost = rig.now
    rig.until(lambda: rig.board.state.startswith("Hold"))
    assert 0.55 < rig.now - lost < 0.72
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert "heartbeat lost" in rig.results[-1].reason and "heartbeat lost" in rig.states[-1]

    rig = Rig().homed()
    rig.go((0.0, 0.0, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.beating = False
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.board.mpos == list(HOMED)


def test_heartbeat_is_judged_by_the_wall_clock_while_simulated_time_is_slow() -> None:
    rig = Rig().homed()
    rig.machine.wall_s = 5000.0
    rig.machine.heartbeat(5000.0)
    rig.beating = False
    rig.go((0.35, 0.0, 0.0))
    rig.run_for(0.05)
    assert rig.machine.phase.name == "MOVING"
    rig.machine.wall_s = 5000.5
    rig.machine.tick(rig.now)
    assert rig.machine.phase.name == "MOVING"
    rig.machine.wall_s = 5000.7
    rig.machine.tick(rig.now)
    assert rig.machine.phase.name == "HOLDING", "0.7 s of wall time, none of the simulation's"
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert "heartbeat lost: 0.70 s old" in rig.states[-1]


def test_a_stop_without_a_link_is_remembered() -> None:
    rig = Rig().connect()
    rig.machine.closed("unplugged", rig.now)
    rig.machine.stop("stop requested", rig.now)
    rig.trace.clear()
    rig.connect()
    assert rig.states[-1] == "stopped: stop requested" and rig.trace[0][1].startswith(b"!")
    rig.machine.reset(rig.now)
    assert rig.state == "unhomed"


def test_a_board_whose_settings_were_not_heard_is_connected_anew() -> None:
    """As after two crossing resets and an error; nothing but its cable led out of the mismatch of all settings."""
    board = Board()
    board.settings = {}
    rig = Rig(board=board)
    rig.machine.opened(rig.now)
    board.reset()
    rig.until(lambda: rig.state not in ("connecting", "disconnected") or len(rig.states) > 2)
    assert rig.states[-1] == "disconnected: the board sent no settings"
    board.settings = dict(SETTINGS)
    assert rig.connect().state == "unhomed"


@pytest.mark.parametrize(
    ("said", "hint"),
    [
        (b"", "has the board power, and is /dev/ttyUSB0 its port?"),
        (
            b"\x80\xf8\x00\xfe" * 250,
            "1000 bytes arrived that are not GRBL's: is 115200 its line rate (baud), "
            "or is another device at /dev/ttyUSB0?",
        ),
    ],
)
def test_a_port_without_a_grbl_says_what_to_look_for_also_while_it_is_tried_again(said: bytes, hint: str) -> None:
    rig = Rig()
    rig.connected = False  # the board's input and output belong to another device
    rig.machine.opened(0.0)
    rig.machine.receive(said, 0.1)
    for tick in range(700):
        rig.machine.tick(tick / 100)
        rig.machine.output(tick / 100)
    rig.collect()
    reason = f"no answer in 6 s while waiting for a banner: {hint}"
    assert rig.states[-1] == f"disconnected: {reason}"
    rig.now, rig.connected = 8.0, True
    rig.connect()
    assert rig.states[-3:] == [f"connecting: {reason}", "connecting", "unhomed"], "nothing of it once there is one"
    rig.machine.closed("unplugged", rig.now)
    rig.connect()
    assert rig.states[-3:] == ["disconnected: unplugged", "connecting", "unhomed"]


class SuspendedBoard(Board):
    """Takes no line, and answers none, while its door is open or it holds; ``suspended`` is what it reports then."""

    suspended = ""

    def report(self) -> str:
        self.state = self.suspended or ("Idle" if self.state.startswith(("Door", "Hold")) else self.state)
        return super().report()

    def _next_line(self) -> bool:
        return not self.suspended and super()._next_line()


@pytest.mark.parametrize(
    ("suspended", "question"), [("Door:1", "is its safety door open"), ("Hold:0", "is its hold button pressed")]
)
@pytest.mark.parametrize("waiting", ["asking for the build", "reading the settings"])
def test_a_board_that_reports_why_it_takes_no_line_while_it_connects_is_quoted(
    suspended: str, question: str, waiting: str
) -> None:
    """It was ``no answer in 6 s`` again and again, though each report named the door."""
    board = SuspendedBoard()
    if waiting == "asking for the build":
        board.suspended = suspended
    else:
        board.hooks["$I"] = lambda: setattr(board, "suspended", suspended)
    rig = Rig(board=board)
    rig.machine.opened(rig.now)
    board.reset()
    why = f"the board reports {suspended}, {question}?"
    rig.until(lambda: rig.states[-1] == f"connecting: {why}", 1.0)
    rig.until(lambda: rig.state == "disconnected", 7.0)
    assert rig.states[-1] == f"disconnected: no answer in 6 s while {waiting}: {why}"
    rig.machine.opened(rig.now)
    board.reset()
    rig.until(lambda: rig.states[-1] == f"connecting: {why}", 1.0)
    board.suspended = ""
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-2:] == ["connecting", "unhomed"], "closed meanwhile, it goes on"


@pytest.mark.parametrize("delay", ["255", "25", None])
def test_motors_that_let_go_between_touches_are_told(delay: str | None) -> None:
    board = Board()
    board.settings |= {1: delay} if delay else {}
    rig = Rig(board=board).connect()
    told = [event.text for event in rig.events if isinstance(event, Note)]
    wanted = ["$1 is 25: motors without power can move unnoticed, 255 keeps them on"] if delay == "25" else []
    assert rig.state == "unhomed" and told == wanted


def test_a_line_that_the_board_runs_after_a_reset_blocks_until_it_is_gone() -> None:
    board = Board()
    board.startup[1] = "G91 G0 X5"
    rig = Rig(board=board).connect()
    said = "$N1 runs 'G91 G0 X5' after each reset; expected empty: unlock by $X, then send $N1="
    assert rig.states[-1] == f"mismatch: {said}"
    assert "mismatch" in rig.machine.home(rig.now)
    assert rig.machine.write_settings(rig.now) == f"nothing to write: it has these settings; {said}"
    assert "$H" not in board.received

    board.startup[1] = ""
    rig.machine.closed("unplugged", rig.now)
    rig.machine.opened(rig.now)
    rig.until(lambda: rig.state == "unhomed")


@pytest.mark.parametrize("spoilt", [{"$N1=G91 G0 X5": 1}, {"$N0=": 1, "$N1=G91 G0 X5": 2}])
def test_a_startup_line_that_noise_has_spoilt_is_asked_for_again(spoilt: dict[str, float]) -> None:
    board = Board()
    board.startup[1], board.spoilt = "G91 G0 X5", dict(spoilt)
    rig = Rig(board=board).connect()
    assert rig.states[-1].startswith("mismatch: $N1 runs 'G91 G0 X5' after each reset")
    assert board.received == ["$I", "$$", *["$N"] * (1 + int(max(spoilt.values())))]

    board.startup[1], board.spoilt = "", {"$N0=": 1, "$N1=": 1}
    rig.machine.closed("unplugged", rig.now)
    assert rig.connect().state == "unhomed"


def test_startup_lines_that_cannot_be_read_block() -> None:
    board = Board()
    board.spoilt = {"$N0=": math.inf}
    rig = Rig(board=board).connect()
    said = (
        "the driver could not read $N0: is there noise on the line? "
        "The lines that the board runs after each reset are unknown"
    )
    assert rig.states[-1] == f"mismatch: {said}: connect it again"
    assert "mismatch" in rig.machine.home(rig.now) and board.received.count("$N") == 5
    board.spoilt.clear()
    rig.machine.closed("unplugged", rig.now)
    assert rig.connect().state == "unhomed"


def test_a_startup_line_that_the_board_could_not_read_is_asked_for_again() -> None:
    """Error:7 replaces the line, before the ``ok``; GRBL empties the line then."""
    board = Board()
    board.startup[1] = "G91 G0 X5"
    board.refuse["$N"] = 7
    board.hooks["$N"] = lambda: board.hooks.update({"$N": lambda: board.refuse.clear()})
    rig = Rig(board=board).connect()
    assert rig.states[-1].startswith("mismatch: $N1 runs 'G91 G0 X5'") and board.received[2:] == ["$N", "$N"]


FLUIDNC_MACROS = ("$/macros/startup_line0", "$/macros/startup_line1", "$/macros/after_reset")


@pytest.mark.parametrize("known", [3, 2])
def test_fluidnc_is_asked_for_its_macros(known: int, monkeypatch: Any) -> None:
    """It has no ``$N`` any more: there it lists all settings with an n in their names."""
    monkeypatch.setattr(protocol_board, "BANNER", b"\r\nGrbl 3.7 [FluidNC v3.7]\r\nALARM:14\r\n")
    board = Board()
    board.macros = dict.fromkeys(FLUIDNC_MACROS[:known], "")
    board.spoilt = {f"{FLUIDNC_MACROS[0]}=": 1}
    rig = Rig(board=board).connect()
    assert rig.state == "unhomed" and board.received == ["$I", "$$", *FLUIDNC_MACROS, FLUIDNC_MACROS[0]]

    board.macros[FLUIDNC_MACROS[1]] = "G91 G0 X5"
    rig.machine.closed("unplugged", rig.now)
    said = f"{FLUIDNC_MACROS[1]} runs 'G91 G0 X5' after a reset; expected empty: remove it from the board's config file"
    assert rig.connect().states[-1] == f"mismatch: {said}"


def test_fluidnc_keeps_some_settings_to_itself_and_the_place_of_homing_tells_of_them(monkeypatch: Any) -> None:
    monkeypatch.setattr(protocol_board, "BANNER", b"\r\nGrbl 3.7 [FluidNC v3.7]\r\nALARM:14\r\n")
    board = Board()
    board.macros = dict.fromkeys(FLUIDNC_MACROS, "")
    for number in (13, 23, 27):
        del board.settings[number]
    rig = Rig(board=board).connect()
    assert rig.state == "unhomed" and rig.machine.write_settings(rig.now).startswith("nothing to write")
    board.homed = (-356.0, -216.0, -4.0)  # another pull-off
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state != "homing")
    assert rig.states[-1].startswith("mismatch: homed at MPos -356.000, -216.000, -4.000 mm")

    board.settings[23] = "0"  # the reported value counts
    rig.machine.closed("unplugged", rig.now)
    assert rig.connect().states[-1] == "mismatch: $23 is 0; expected 3 (the configuration)"


def test_a_firmware_without_startup_lines_connects_and_the_refusal_is_told() -> None:
    board = Board()
    board.refuse["$N"] = 3
    rig = Rig(board=board).connect()
    assert rig.state == "unhomed" and rig.machine.connects == 1
    assert any(isinstance(event, Note) and "'$N'" in event.text for event in rig.events)


def test_settings_mismatch_blocks_until_accepted_and_holds_for_these_only() -> None:
    board = Board()
    board.settings[110] = "500.000"
    rig = Rig(board=board).connect()
    assert rig.states[-1] == "mismatch: $110 is 500.000; expected 12000 (the configuration)"
    assert "mismatch" in rig.machine.home(rig.now)
    assert rig.machine.accept_settings(rig.now) == "" and rig.state == "unhomed"
    rig.machine.closed("unplugged", rig.now)
    rig.connect()
    assert rig.state == "unhomed", "the same difference was accepted"
    rig.machine.closed("unplugged", rig.now)
    board.settings[100] = "250.000"
    rig.connect()
    assert rig.state == "mismatch"


def test_trap_1_more_lines_than_the_buffer_holds_lose_no_byte() -> None:
    rig = Rig().homed()
    points = [(0.001 * (k % 300), 0.0005 * (k % 400), 0.0) for k in range(300)]
    rig.go(*points)
    rig.until(lambda: "reached" in rig.outcomes(), 60.0)
    assert rig.board.lost_bytes == 0
    assert max(len(line) for line in rig.board.received) < 80
    assert [t for t in rig.board.executed if "G53" in t] == [t for t in rig.board.received if "G53" in t] != []


def test_trap_2_reset_after_a_critical_alarm_waits_for_the_message() -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.3)
    rig.board.alarm(1)
    rig.step()
    assert rig.states[-1].startswith("alarm: ALARM:1") and rig.outcomes()[-1] == "aborted"
    rig.machine.reset(rig.now)
    at = rig.now
    rig.until(lambda: rig.state == "unhomed", 3.0)
    resets = [t for t, code in rig.board.realtime if code == 0x18 and t > at - 0.001]
    assert len(resets) == 1 and resets[0] - at > 0.45
    assert not rig.machine.homed


def reset_while_held_up(seconds: float) -> Rig:
    """Return a machine that was stopped while it pressed, with its board held up from the reset on."""
    rig = pressing()
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "RESETTING")
    # The reset is on the wire already; what it has set off was not to be.
    rig.board.state, rig.board.resets = "Hold:0", 0
    rig.board.out.clear()
    rig.board.held_up_until = rig.now + seconds
    rig.board.write(b"\x18")
    return rig


@pytest.mark.parametrize("seconds", [1.5, 2.5, 4.5])
def test_a_board_that_was_held_up_answers_a_reset_and_its_retries_without_losing_its_place(seconds: float) -> None:
    rig = reset_while_held_up(seconds)
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 20.0)
    assert rig.board.resets == 1 + int(seconds), "one for each reset that was sent"
    assert rig.states[-1] == "stopped: stop requested" and rig.machine.homed
    assert rig.board.mpos == pytest.approx([HOMED[0] + 100.0, HOMED[1] + 100.0, HOMED[2]])
    assert rig.machine.reset(rig.now) == "" and rig.state == "idle"


def test_a_reset_of_the_board_itself_is_none_that_answers_a_retry_once_it_has_answered_anything_else() -> None:
    rig = reset_while_held_up(1.5)
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 20.0)
    rig.board.reset()
    rig.until(lambda: any("reset itself" in state for state in rig.states), 1.0)
    assert not rig.machine.homed


@pytest.mark.parametrize("locks", [True, False])
@pytest.mark.parametrize("resets", [0, 1], ids=["of the reset", "of its retry"])
def test_a_loss_of_power_is_not_hidden_by_a_reset_that_was_expected(locks: bool, resets: int) -> None:
    """Its banner comes instead of the other; a board that does not lock itself is recognised by its position."""
    rig = reset_while_held_up(0.5 + resets)
    rig.until(lambda: rig.now > rig.board.held_up_until - 0.01)
    rig.until(lambda: rig.board.resets == resets)
    rig.board.waiting.clear()
    rig.board.power_cycle()
    if not locks:
        rig.board.state = "Idle"
    rig.until(lambda: rig.state == "alarm", 5.0)
    assert not rig.machine.homed and "lost its position" in rig.states[-1]
    x, y = rig.board.mpos[:2]
    rig.run_for(2.0)
    assert rig.board.mpos == [x, y, 0.0], "nothing moves by a position that is none"


def test_noise_in_a_report_after_a_reset_does_not_leave_the_stylus_down() -> None:
    rig = reset_while_held_up(0.0)
    rig.until(lambda: rig.board.resets == 1)
    rig.machine.receive(b"<Idle|MPos:-25.000,-119.000,-21.000|Bf:15,128|FS:0,0|WCO:0,0,0>\r\n", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: stop requested" and rig.board.mpos[2] == pytest.approx(HOMED[2])


def test_a_stop_while_an_alarm_is_left_is_remembered() -> None:
    rig = Rig().homed()
    rig.board.alarm(1)
    rig.step()
    assert rig.machine.reset(rig.now) == ""
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: stop requested" and not rig.machine.homed
    assert rig.machine.reset(rig.now) == "" and rig.state == "unhomed"


def test_trap_3_a_stray_ok_before_the_banner_counts_for_nothing() -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.0, 0.0), (0.0, 0.1, 0.0))
    rig.run_for(0.3)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "RESETTING")
    rig.machine.receive(b"ok\r\nok\r\n", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.machine.counts.stray == 2
    rig.machine.reset(rig.now)
    rig.go((0.05, 0.05, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())


def test_a_stray_ok_in_mid_stream_is_no_false_done() -> None:
    rig = Rig().homed()
    rig.go(*[(0.01 * k, 0.0, 0.0) for k in range(1, 30)])
    rig.run_for(0.1)
    rig.board.say("ok")
    rig.until(lambda: len(rig.outcomes()) == 2, 30.0)
    if rig.outcomes()[-1] == "reached":
        assert rig.board.mpos[0] == pytest.approx(HOMED[0] + 290.0)
    else:
        assert "belongs to no line" in rig.results[-1].reason
    assert rig.board.lost_bytes == 0


def test_a_lost_ok_is_noticed_and_reported() -> None:
    rig = Rig().homed()
    rig.board.drop_answers = 1
    rig.go((0.1, 0.0, 0.0))
    rig.until(lambda: len(rig.outcomes()) == 2)
    assert rig.outcomes() == ["accepted", "aborted"] and "has not answered" in rig.results[-1].reason
    assert rig.results[-1].code == "lost_answer" and rig.results[-1].duration_s < 0.6
    rig.until(lambda: rig.machine.phase.name == "STOPPED")


def test_trap_4_a_long_hold_runs_into_no_time_out() -> None:
    rig = Rig(DriverConfig(enabled_at_start=True, hold_timeout_s=10.0)).homed()
    rig.board.hold_s = 9.0
    rig.go((0.3, 0.0, 0.0), (0.1, 0.0, 0.0))
    rig.run_for(0.2)
    rig.machine.stop("stop requested", rig.now)
    rig.run_for(8.0)
    assert rig.states[-1] == "stopped: stop requested" and rig.machine.phase.name == "HOLDING"
    assert rig.machine.counts.lost == 0
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.machine.homed


def test_trap_5_after_an_error_at_most_one_more_block_runs() -> None:
    rig = Rig().homed()
    points = [(0.02 * k, 0.0, 0.0) for k in range(1, 12)]
    bad = "X-259G53G1"  # the speed is that of the lines before
    rig.board.refuse = {bad: 22}
    rig.go(*points)
    rig.until(lambda: "aborted" in rig.outcomes())
    assert "error:22 (no feed rate) at line" in rig.results[-1].reason and bad in rig.results[-1].reason
    done = len(rig.board.executed)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    rig.run_for(2.0)
    assert len(rig.board.executed) - done <= 1
    assert "error:22" in rig.states[-1]


def test_trap_6_reset_only_after_the_hold_is_complete() -> None:
    rig = Rig().homed()
    rig.board.hold_s = 0.4
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.2)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    hold = next(t for t, code in rig.board.realtime if code == ord("!"))
    reset = [t for t, code in rig.board.realtime if code == 0x18][-1]
    assert reset - hold >= 0.4 and rig.machine.homed and rig.board.state == "Idle"


def test_a_hold_that_never_completes_ends_in_a_reset_and_unhomed() -> None:
    rig = Rig().homed()
    rig.board.hold_s = 100.0
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.2)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED", 5.0)
    assert not rig.machine.homed
    rig.machine.reset(rig.now)
    assert rig.state == "unhomed"


def test_trap_7_and_8_an_unexpected_banner_is_a_reset() -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.2)
    rig.board.power_cycle()
    rig.until(lambda: rig.state == "unhomed")
    assert "reset itself" in rig.results[-1].reason and rig.outcomes() == ["accepted", "aborted"]
    assert not rig.machine.homed and rig.machine.reading_m is None


def restart_unheard(board: Board) -> None:
    """Lose the power for a moment, with noise for a banner, as a grblHAL that does not lock itself: its count starts
    again."""
    board.mpos, board.state = [0.0, 0.0, 0.0], "Idle"
    board.blocks.clear()
    board.rx.clear()


@pytest.mark.parametrize("phase", ["IDLE", "STOPPED", "MOVING", "HOLDING"])
def test_a_restart_whose_banner_noise_has_spoilt_is_noticed_by_the_place(phase: str) -> None:
    """The next goal was driven from a corner of the travel where the machine was not."""
    rig = Rig().homed()
    rig.go((0.1, 0.05, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())
    if phase != "IDLE":
        rig.go((0.2, 0.1, 0.0))
        rig.run_for(0.2)
    rig.board.hold_s = 0.3
    if phase in ("STOPPED", "HOLDING"):
        rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == phase)
    told = len(rig.positions)
    rig.run_for(0.12)
    restart_unheard(rig.board)
    rig.until(lambda: rig.state == "connecting", 0.5)
    reason = "the board has reset itself and lost its position"
    assert rig.states[-1] == f"connecting: {reason}"
    assert all(x < 0.21 for x, _, _ in rig.positions[told:]), "the false place was never told"
    rig.until(lambda: rig.state not in ("connecting",))
    stopped = phase in ("STOPPED", "HOLDING")
    assert rig.states[-1] == ("stopped: stop requested" if stopped else f"unhomed: {reason}")
    assert not rig.machine.homed and rig.outcomes()[-1] == ("reached" if phase == "IDLE" else "aborted")


def test_steps_that_are_changed_behind_its_back_are_found_by_the_place() -> None:
    """By a firmware's own page: the board counts the same motor steps as other millimetres from then on."""
    rig = Rig().homed()
    rig.go((0.1, 0.05, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.run_for(0.5)
    told = len(rig.positions)
    rig.board.settings[100] = "100.000"
    rig.board.mpos[0] *= 0.8
    rig.until(lambda: rig.state == "connecting", 0.5)
    lost = "the board's position has changed without a command from this driver: the true position is unknown"
    assert rig.states[-1] == f"connecting: {lost}" and all(x < 0.11 for x, _, _ in rig.positions[told:])
    rig.until(lambda: rig.state == "mismatch")
    assert rig.states[-1] == "mismatch: $100 is 100.000; expected 80 (the configuration)" and not rig.machine.homed


def test_a_step_of_a_pendant_that_no_report_has_shown_is_found_by_the_place_also_after_a_stop() -> None:
    rig = Rig().homed()
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    rig.run_for(0.5)
    rig.board.mpos[0] += 1.0
    rig.run_for(3.0)
    assert rig.states[-1] == "stopped: stop requested" and not rig.machine.homed
    assert rig.machine.reset(rig.now) == "" and rig.state == "unhomed"


def test_noise_that_makes_one_report_tell_the_place_of_a_restart_is_none() -> None:
    rig = Rig().homed()
    rig.board.say("<Idle|MPos:0.000,0.000,0.000|FS:0,0>")
    rig.run_for(1.0)
    assert rig.state == "idle" and rig.machine.homed and rig.machine.reading_m == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize("mask", [3, 0])
def test_the_corner_where_all_is_zero_can_be_gone_to(mask: int) -> None:
    """Position of a board that was just switched on, and target of a stage without a Z axis, which may move or home
    there."""
    machine = MachineConfig(homing_direction_mask=mask, pull_off_mm=0.0)
    board = Board()
    board.settings |= {23: str(mask), 27: "0.000"}
    board.homed = (-360.0, -220.0, 0.0) if mask else (0.0, 0.0, 0.0)
    stylus = StylusConfig(kind="servo_m3", dwell_s=0.3)
    rig = Rig(DriverConfig(enabled_at_start=True, machine=machine, stylus=stylus), board).homed()
    corner = (0.36, 0.22) if mask else (0.0, 0.0)
    rig.go((0.1, 0.1, 0.0), (*corner, 0.0), (*corner, 0.02), (0.1, 0.1, 0.0), (*corner, 0.02))
    rig.until(lambda: "reached" in rig.outcomes(), 30.0)
    rig.run_for(0.5)
    assert rig.state == "idle" and rig.board.mpos == [0.0, 0.0, 0.0]
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")


def test_link_lost_while_moving_aborts_and_comes_back_unhomed() -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.2)
    rig.machine.closed("the device has gone", rig.now)
    rig.collect()
    assert rig.outcomes() == ["accepted", "aborted"] and rig.states[-1] == "disconnected: the device has gone"
    rig.board.out.clear()
    rig.board.power_cycle()
    rig.machine.opened(rig.now)
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-1] == "unhomed"
    rig.run_for(1.0)
    assert rig.board.blocks == []


def test_a_silent_board_is_noticed() -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.2)
    rig.board.mute = True
    rig.until(lambda: rig.state == "disconnected", 2.0)
    assert "no status report" in rig.states[-1] and "!" in rig.trace[-1][1].decode()


def test_a_silent_board_is_noticed_while_parameters_are_changed_all_the_time() -> None:
    rig = Rig().homed()
    rig.board.mute = True
    end = rig.now + 2.0
    feeds = itertools.cycle((0.05, 0.06))
    while rig.state != "disconnected":
        assert rig.now < end, rig.states[-3:]
        rig.machine.configure(replace(rig.machine.config, feed_m_s=next(feeds)), rig.now)
        rig.run_for(0.1)
    assert "no status report" in rig.states[-1]


def test_homing_is_no_silence_and_its_alarm_is_one() -> None:
    rig = Rig().connect()
    rig.step()
    rig.machine.home(rig.now)
    rig.board.hooks["$H"] = lambda: None
    rig.until(lambda: rig.state == "idle")
    rig.machine.home(rig.now)
    rig.until(lambda: rig.board.homing_until > 0)
    rig.board.homing_until = rig.now + 60.0
    rig.run_for(2.0 * rig.machine.config.status_timeout_s)
    rig.board.homing_until = -1.0
    rig.board.alarm(9)
    rig.until(lambda: rig.state == "alarm")
    rig.run_for(0.5)
    assert "ALARM:9 (homing: no switch found)" in rig.states[-1] and not rig.machine.homed


def test_an_alarm_that_a_reset_does_not_leave_stays_one() -> None:
    """While an emergency stop is pressed, grblHAL answers a reset by the alarm, without a banner."""
    rig = Rig().homed()
    board = rig.board
    leave = board.reset
    board.alarm(10)
    board.reset = lambda: board.say("ALARM:10")  # type: ignore[method-assign]
    rig.until(lambda: rig.state == "alarm")
    for _ in range(2):
        rig.run_for(1.0)
        assert rig.machine.reset(rig.now) == ""
        rig.run_for(8.0)
        assert rig.machine.state_text.startswith("alarm: ALARM:10") and rig.machine.connects == 1
    board.reset = leave  # type: ignore[method-assign]
    rig.run_for(3.0)
    assert rig.machine.phase.name == "ALARM", "it is left when somebody asks for it, not when the button is released"
    assert rig.machine.reset(rig.now) == ""
    rig.until(lambda: rig.state == "unhomed")


@pytest.mark.parametrize(
    ("banner", "code", "meaning"),
    [
        (b"Grbl 1.1h ['$' for help]", 10, "emergency stop or second axis"),
        (b"GrblHAL 1.1f ['$' for help]", 10, "the emergency stop is pressed"),
        (b"GrblHAL 1.1f ['$' for help]", 12, "a limit switch is engaged"),
        (b"Grbl 3.7 [FluidNC v3.7]", 10, "spindle fault"),
        (b"Grbl 3.7 [FluidNC v3.7]", 13, "hard stop"),
        (b"Grbl 3.7 [FluidNC v3.7]", 1, "hard limit switch, position lost"),
    ],
)
def test_an_alarm_means_what_the_firmware_means_by_it(
    banner: bytes, code: int, meaning: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(protocol_board, "BANNER", b"\r\n" + banner + b"\r\n")
    rig = Rig().connect()
    rig.until(lambda: rig.state == "unhomed")
    rig.board.alarm(code)
    rig.until(lambda: rig.state == "alarm")
    assert rig.states[-1] == f"alarm: ALARM:{code} ({meaning})"


def test_an_alarm_outlasts_the_reset_that_the_board_adds_to_it() -> None:
    rig = Rig().connect()
    rig.step()
    rig.machine.home(rig.now)
    rig.run_for(0.2)
    rig.board.homing_until = -1.0
    rig.board.alarm(9)
    rig.board.say("ok")  # of the line that was aborted
    rig.board.reset()
    rig.run_for(2.0)
    assert rig.states[-1] == "alarm: ALARM:9 (homing: no switch found)"
    assert rig.machine.reset(rig.now) == ""
    rig.until(lambda: rig.state == "unhomed")


@pytest.mark.parametrize("code", [1, 3])
def test_an_alarm_while_connecting_does_not_spare_the_board_the_comparison(code: int) -> None:
    board = Board()
    board.settings[110] = "500.000"
    board.hooks["$I"] = lambda: board.alarm(code)
    rig = Rig(board=board)
    rig.machine.opened(0.0)
    board.reset()
    rig.until(lambda: rig.state == "alarm")
    assert rig.machine.reset(rig.now) == ""
    rig.until(lambda: rig.state == "mismatch")
    assert "$110 is 500.000" in rig.states[-1] and rig.machine.session.rx_bytes == 128


@pytest.mark.parametrize(("banner", "code"), [(b"GrblHAL 1.1f ['$' for help]", 11), (b"Grbl 3.7 [FluidNC v3.7]", 14)])
def test_a_board_that_only_wants_to_be_homed_is_unhomed(banner: bytes, code: int, monkeypatch: Any) -> None:
    monkeypatch.setattr(protocol_board, "BANNER", b"\r\n%s\r\nALARM:%d\r\n" % (banner, code))
    rig = Rig().connect()
    assert rig.states[1:] == ["connecting", "unhomed"] and rig.machine.settings
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")
    rig.board.alarm(code)
    rig.until(lambda: rig.state == "alarm")


def homing_wanted(kind: str, setting: str, monkeypatch: Any) -> Rig:
    """Return a machine with a grblHAL whose $22 was accepted; with its bit 2 it takes no $X before it is homed."""
    monkeypatch.setattr(protocol_board, "BANNER", b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\nALARM:11\r\n")
    board = Board()
    board.settings[22] = setting
    board.refuse = {"$X": 46} if int(setting) & 4 else {}
    rig = Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind)), board=board).connect()
    assert rig.states[-1] == f"mismatch: $22 is {setting}; expected 1 (the configuration)"
    assert rig.machine.accept_settings(rig.now) == ""
    rig.step()
    return rig


@pytest.mark.parametrize("kind", ["servo_m3", "solenoid_m8"])
def test_a_board_that_lets_no_stylus_be_lifted_before_homing_is_not_homed(kind: str, monkeypatch: Any) -> None:
    rig = homing_wanted(kind, "5", monkeypatch)
    said = rig.machine.home(rig.now)
    assert said == (
        "the board accepts no line before homing ($22 is 5), but the driver must lift the stylus before that: "
        "set $22 to 1, as gantry/write_settings does"
    )
    assert rig.state == "unhomed" and "$X" not in rig.board.received and "$H" not in rig.board.received
    assert rig.machine.write_settings(rig.now) == ""
    rig.board.refuse = {}
    rig.until(lambda: rig.state == "unhomed" and "$22=1" in rig.board.received)
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")


@pytest.mark.parametrize(("kind", "setting"), [("z_axis", "5"), ("servo_m3", "3")])
def test_a_stylus_that_homing_lifts_or_a_board_that_can_be_unlocked_is_homed(
    kind: str, setting: str, monkeypatch: Any
) -> None:
    rig = homing_wanted(kind, setting, monkeypatch)
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")


def test_homing_with_the_door_open_is_refused_by_a_reason_that_names_it() -> None:
    rig = Rig().connect()
    rig.board.refuse["$H"] = 13
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1].startswith("stopped: the board rejected homing: error:13 (safety door open)")


@pytest.mark.parametrize("lost", ["$X", "$H"])
def test_an_answer_that_is_lost_while_homing_is_noticed_soon(lost: str) -> None:
    """The wait lasted as long as a homing cycle may take, while the board reported again and again that it is idle."""
    rig = Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind="servo_m3", dwell_s=0.1))).connect()
    rig.step()

    def drop() -> None:
        rig.board.drop_answers = 1

    rig.board.hooks[lost] = drop
    assert rig.machine.home(rig.now) == ""
    since = rig.now
    rig.until(lambda: rig.state == "stopped", 60.0)
    assert rig.now - since < 1.0 + rig.machine.config.answer_timeout_s + 1.0
    assert rig.states[-1].startswith(f"stopped: no answer to {lost!r} within 3.1 s although the board is at rest")
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert not rig.machine.homed


def test_a_homing_line_that_noise_has_swallowed_is_noticed_soon() -> None:
    rig = Rig().connect()
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: b"$H" in rig.board.rx)
    rig.board.rx.clear()
    rig.until(lambda: rig.state == "stopped", 5.0)
    reason = "no answer to '$H' within 3.25 s although the board is at rest"
    assert rig.states[-1] == f"stopped: {reason}"
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.machine.reset(rig.now) == "" and rig.state == "unhomed"


def test_a_homing_cycle_that_takes_long_after_a_last_report_of_an_idle_board_is_no_lost_answer() -> None:
    """GRBL gives no reports in it: the silence is no time in which the board was idle."""
    rig = Rig().homed()
    rig.board.hooks["$H"] = lambda: rig.board.say(rig.board.report())  # to a `?` that was just before
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.board.homing_until > 0)
    rig.board.homing_until += 20.0
    rig.run_for(20.5)
    rig.board.say(rig.board.report())  # just before its answer, as a firmware may whose tasks share the line
    rig.until(lambda: rig.state in ("idle", "stopped"), 30.0)
    assert rig.states[-1] == "idle"


def test_stop_while_homing_resets_at_once() -> None:
    rig = Rig().connect()
    rig.step()
    rig.machine.home(rig.now)
    rig.run_for(0.3)
    rig.machine.stop("stop requested", rig.now)
    rig.step()
    assert rig.board.realtime[-1][1] in (0x18, ord("?")) and rig.board.homing_until < 0
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    rig.machine.reset(rig.now)
    assert rig.state == "unhomed"


@pytest.mark.parametrize(("kind", "down", "up"), [("servo_m3", "M3S800", "M3S200"), ("solenoid_m8", "M8", "M9")])
def test_other_styluses_go_down_after_the_move_and_up_before_it(kind: str, down: str, up: str) -> None:
    config = DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind, stroke_m=0.01, dwell_s=0.1))
    board = Board()
    board.homed = (*HOMED[:2], 0.0)  # a stage without a Z axis homes X and Y alone
    rig = Rig(config, board).homed()
    rig.go((0.1, 0.0, 0.01), (0.2, 0.0, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())
    lines = [t for t in rig.board.received if t not in ("G21G90G94", "G4P0")]
    assert lines[-8:] == ["F9000X-259G53G1", down, "$G", "G4P0.1", up, "$G", "G4P0.1", "X-159G53G1"]


@pytest.mark.parametrize("kind", ["servo_m3", "solenoid_m8"])
@pytest.mark.parametrize("hover_m", [0.003, 0.012, 0.0185])
def test_a_stylus_with_two_positions_is_not_lowered_by_a_goal_that_lies_between(kind: str, hover_m: float) -> None:
    """Of 12 mm, where it was to hover and be looked at, it made all 20."""
    rig = Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind, dwell_s=0.1))).homed()
    rig.board.received.clear()
    rig.go((0.1, 0.0, 0.0), (0.1, 0.0, hover_m))
    rig.step()
    assert rig.outcomes() == ["rejected"] and rig.board.received == []
    assert f"stylus_joint = {hover_m:g} m; a" in rig.results[-1].reason
    rig.go((0.1, 0.0, 0.0198))  # as an axis may report its end
    rig.until(lambda: "reached" in rig.outcomes())
    assert rig.machine.reading_m == pytest.approx((0.1, 0.0, 0.02))


@pytest.mark.parametrize(("kind", "up"), [("servo_m3", "M3S200"), ("solenoid_m8", "M9")])
def test_other_styluses_are_lifted_before_homing_crosses_the_panel(kind: str, up: str) -> None:
    """No $H does that: a solenoid was drawn over the panel, and pressed on, because it counted as lifted."""
    rig = Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind, dwell_s=0.1))).homed()
    rig.go((0.1, 0.05, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.board.received.clear()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle", 5.0)
    assert up in rig.board.received[: rig.board.received.index("$H")]


@pytest.mark.parametrize(("number", "value"), [(32, "1"), (30, "255"), (31, "300")])
def test_a_servo_needs_the_spindle_settings_that_its_s_values_mean(number: int, value: str) -> None:
    board = Board()
    board.settings[number] = value  # with $32=1, GRBL gives M3 no power until a G1 has been sent: no stop would lift
    config = DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind="servo_m3"))
    assert f"mismatch: ${number} is {value}; expected " in Rig(config, board).connect().states[-1]
    assert Rig(board=board).connect().state == "unhomed", "a Z axis needs none of them"


def test_a_servo_outside_its_range_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"servo_down = 1200 is not within servo_range = \(0.*, 1000"):
        StylusConfig(servo_down=1200.0)


def test_no_more_points_may_be_allowed_than_are_written_within_a_heartbeat() -> None:
    """Writing 100,000 takes two seconds, in which neither a heartbeat nor a report of the board is read."""
    with pytest.raises(ConfigError, match="max_points = 10001 is above its maximum 10000"):
        DriverConfig(max_points=10_001)
    rig = Rig(DriverConfig(enabled_at_start=True, max_points=10_000)).homed()
    points = [((0.1 + 0.001 * (k % 50)), 0.1, 0.0) for k in range(10_001)]
    assert "the trajectory has 10001 points (limits 1 to 10000)" in rig.go(*points).reason
    assert rig.go(*points[1:]).outcome.value == "accepted"
    rig.run_for(0.5)
    assert rig.state == "moving"


def test_a_board_without_a_device_is_refused() -> None:
    """As where a script's variable is not set; the driver had looked for it for ever."""
    with pytest.raises(ConfigError, match=r"port = '': the path of the board's device is needed"):
        DriverConfig(port="")


@pytest.mark.parametrize("rate", ["status_rate_hz", "moving_status_rate_hz"])
def test_a_silence_shorter_than_the_time_between_reports_is_refused(rate: str) -> None:
    with pytest.raises(ConfigError, match=r"status_timeout_s = 0\.2: .* 0\.3 s at 5 Hz"):
        DriverConfig(status_timeout_s=0.2, **{rate: 5.0})
    DriverConfig(status_timeout_s=0.3, **{rate: 5.0})


def test_homed_somewhere_else_than_configured_is_a_mismatch() -> None:
    rig = Rig(DriverConfig(enabled_at_start=True, machine=MachineConfig(pull_off_mm=2.0)))
    rig.board.settings[27] = "2.000"
    rig.connect()
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "mismatch")
    assert "homed at MPos -359.000, -219.000, -1.000" in rig.states[-1]
    assert "mismatch" in rig.go((0.1, 0.1, 0.0)).reason and not rig.machine.homed
    assert "nothing to accept" in rig.machine.accept_settings(rig.now)
    # It may have been a switch that was touched: home again, and there is the configured place.
    rig.board.homed = (-358.0, -218.0, -2.0)
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle", 5.0)
    assert rig.machine.homed and rig.states[-1] == "idle"
    assert rig.go((0.1, 0.1, 0.0)).outcome.value == "accepted"


def test_reset_leaves_a_wrong_homed_place_towards_homing() -> None:
    rig = Rig(DriverConfig(enabled_at_start=True, machine=MachineConfig(pull_off_mm=2.0)))
    rig.board.settings[27] = "2.000"
    rig.connect()
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "mismatch")
    assert rig.machine.reset(rig.now) == ""
    assert rig.state == "unhomed" and not rig.machine.homed
    assert "unhomed" in rig.go((0.1, 0.1, 0.0)).reason
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "mismatch", 5.0)


def test_reset_and_home_do_not_leave_settings_that_differ() -> None:
    board = Board()
    board.settings[110] = "500.000"
    rig = Rig(board=board).connect()
    assert "nothing to reset" in rig.machine.reset(rig.now) and "mismatch" in rig.machine.home(rig.now)
    assert rig.state == "mismatch"


def test_settings_of_the_test_board_are_those_of_the_configuration() -> None:
    expected = DriverConfig(stylus=StylusConfig(kind="servo_m3")).expected_settings()
    assert {n: float(v) for n, v in SETTINGS.items()} == pytest.approx(expected)


def test_a_program_is_checked_as_a_whole_and_then_streamed() -> None:
    rig = Rig().homed()
    refused = rig.machine.run_program("p", ["G53 G1 X-300 F6000", "G53 G1 X-10 Y5"], rig.now)
    assert refused.outcome.value == "rejected" and "line 2, column 13: Y = 5.000 mm" in refused.reason
    assert rig.machine.session.pending == 0
    source = [f"G53 G1 X{-300 - k} F6000 ; step {k}" for k in range(50)]
    accepted = rig.machine.run_program("p", source, rig.now)
    assert accepted.outcome.value == "accepted" and accepted.goal.startswith("program of 50 lines")
    rig.until(lambda: "reached" in rig.outcomes(), 60.0)
    assert [t for t in rig.board.executed if "X" in t] == [
        "F6000X-300G53G1",
        *(f"X{-300 - k}G53G1" for k in range(1, 50)),
    ]
    assert rig.board.mpos[0] == -349.0


def test_a_program_starts_at_a_home_that_motor_steps_round_beyond_the_travel() -> None:
    """At 53.333 steps/mm a board homes at -359.008 mm; a program was refused for the axes it left alone."""
    board = Board()
    board.settings |= {100: "53.333", 101: "53.333"}
    board.homed = (-359.008, -219.009, -1.0)
    machine = MachineConfig(steps_per_mm=(53.333, 53.333, 400.0))
    rig = Rig(DriverConfig(enabled_at_start=True, machine=machine), board).homed()
    assert rig.machine.run_program("p", ["G53 G1 Y-100 F6000"], rig.now).outcome.value == "accepted"
    rig.until(lambda: "reached" in rig.outcomes())
    assert rig.board.mpos == [-359.008, -100.0, -1.0]
    rig.board.mpos[0] = -359.03
    rig.run_for(0.2)
    refused = rig.machine.run_program("p", ["G53 G1 Y-110 F6000"], rig.now)
    assert refused.reason == "line 1, column 8: X = -359.030 mm (machine) is outside -359 to 0 mm (ALARM:2)"


def test_a_long_program_is_queued_while_it_runs() -> None:
    """The user who starts it may interrupt it meanwhile, and no program waits until all of it is queued."""
    rig = Rig().homed()
    source = [f"G53 G1 X{-300 - k % 2} F6000" for k in range(3 * QUEUED_LINES)]
    assert rig.machine.run_program("p", source, rig.now).outcome.value == "accepted"
    assert rig.machine.session.pending == 0
    most = 0
    while "reached" not in rig.outcomes():
        rig.run_for(0.5)
        most = max(most, rig.machine.session.pending)
        assert rig.now < 100.0 and rig.state in ("moving", "idle")
    moves = [text for text in rig.board.executed if "X" in text]
    assert moves == ["F6000X-300G53G1", *(f"X{-300 - k % 2}G53G1" for k in range(1, len(source)))]
    assert QUEUED_LINES / 2 < most < QUEUED_LINES + 60


class Walked(list[CheckedLine]):
    """Lines of a program that count how many of them have been asked for."""

    walked = 0

    def __iter__(self) -> Iterator[CheckedLine]:
        for line in super().__iter__():
            self.walked += 1
            yield line


@pytest.mark.parametrize("kind", ["z_axis", "servo_m3"])
def test_the_start_of_a_long_program_takes_no_longer_than_that_of_a_short_one(kind: str) -> None:
    """The link waits for it: the heartbeat of 800,000 lines was lost before the first had been sent."""
    rig = Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind))).homed()
    checker = rig.machine.program_checker()
    source = ["M3 S200", *(f"G53 G1 X{-300 - k % 2} F6000" for k in range(3 * QUEUED_LINES)), "M3 S800"]
    lines = Walked(checker.check_all(source if kind == "servo_m3" else source[1:-1]))
    started = rig.machine.run_checked("p", checker, lines, rig.now)
    assert started.goal.endswith("lines, about 18.6 s") and lines.walked == 0
    rig.step()
    assert lines.walked <= QUEUED_LINES and rig.machine.reading_m == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    rig.until(lambda: "reached" in rig.outcomes(), 60.0)
    stylus = rig.machine.config.stylus.stroke_m if kind == "servo_m3" else 0.0
    assert lines.walked == len(lines) and rig.machine.reading_m == pytest.approx((0.058, 0.0, stylus))


def test_nothing_of_a_long_program_is_queued_after_a_stop() -> None:
    rig = Rig().homed()
    rig.machine.run_program("p", [f"G53 G1 X{-300 - k % 2} F6000" for k in range(3 * QUEUED_LINES)], rig.now)
    rig.run_for(1.0)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    sent = len(rig.board.received)
    assert rig.machine.reset(rig.now) == ""
    rig.run_for(1.0)
    assert rig.state == "idle" and rig.machine.session.pending == 0 and len(rig.board.received) == sent


def test_a_program_is_not_started_from_elsewhere_than_where_it_was_checked() -> None:
    rig = Rig().homed()
    checker = rig.machine.program_checker()
    checked = list(checker.check_all(["G91", "G1 X50 F6000"]))
    rig.go((0.1, 0.1, 0.0))
    rig.until(lambda: "reached" in rig.outcomes())
    refused = rig.machine.run_checked("p", checker, checked, rig.now)
    assert refused.reason == "position or work offset have changed since the check of the program"
    assert rig.machine.session.pending == 0 and rig.state == "idle"
    again = rig.machine.program_checker()
    lines = list(again.check_all(["G91", "G1 X50 F6000"]))
    assert rig.machine.run_checked("p", again, lines, rig.now).outcome.value == "accepted"


@pytest.mark.parametrize(
    ("banner", "keeps"),
    [(b"Grbl 1.1h ['$' for help]", False), (b"GrblHAL 1.1f ['$' for help]", True), (b"Grbl 3.7 [FluidNC v3.7]", True)],
)
def test_a_g92_that_a_board_may_have_kept_is_not_cancelled_by_a_program(
    banner: bytes, keeps: bool, monkeypatch: Any
) -> None:
    """All of the offset counted as G54's: after a G92.1 the board went elsewhere than was checked."""
    monkeypatch.setattr(protocol_board, "BANNER", b"\r\n%s\r\n" % banner)
    rig = Rig()
    report, offset = rig.board.report, "0,0,20"
    rig.board.macros = dict.fromkeys(FLUIDNC_MACROS, "")
    rig.board.report = lambda: re.sub("WCO:[^|>]*", f"WCO:{offset}", report())  # type: ignore[method-assign]
    rig.homed()

    def run(*lines: str) -> str:
        answer = rig.machine.run_program("p", lines, rig.now)
        rig.until(lambda: rig.state == "idle")
        return answer.reason

    assert ("G92.1 moves all targets" in run("G92.1")) is keeps
    assert run("G92 X0 Y0 Z0") == "" and "G92.1 moves all targets" in run("G92.1"), "the program before has left one"
    offset = "0,0,0"
    rig.run_for(0.5)
    assert run("G92.1") == ""
    offset = "0,0,20"
    rig.run_for(0.5)
    assert run("G92.1") == "", "there is none since it was cancelled"
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.machine.reset(rig.now) == ""
    rig.run_for(0.5)
    assert ("G92.1 moves all targets" in run("G92.1")) is keeps, "what a reset does to it, each firmware knows"


@pytest.mark.parametrize("ended_by", ["G49", "G54"])
def test_a_program_is_checked_with_the_offset_that_it_will_have_where_a_board_keeps_another_over_a_reset(
    ended_by: str, monkeypatch: Any
) -> None:
    """A grblHAL keeps a tool's length, or G55; the lines before a program end both, and it went 20 mm deeper."""
    monkeypatch.setattr(protocol_board, "BANNER", b"\r\nGrblHAL 1.1f ['$' for help]\r\n")
    rig = Rig()
    report = rig.board.report

    def with_what_was_kept() -> str:
        return report() if ended_by in rig.board.executed else report().replace("WCO:0,0,0", "WCO:0,0,20")

    rig.board.report = with_what_was_kept  # type: ignore[method-assign]
    rig.homed()
    reason = rig.machine.run_program("p", ["G1 Z-70 F300"], rig.now).reason
    assert "Z = -70.000 mm (machine) is outside -60 to -1 mm" in reason
    assert rig.board.received[-3:] == ["$H", "G49", "G54"], "nothing of it was sent"


@pytest.mark.parametrize(
    ("kind", "told", "kept"),
    [
        ("z_axis", [200, 100, 100], [100, 100, 100]),
        ("z_axis", [110, 25, 130], [100, 25, 100]),
        ("z_axis", [50, 25, 130], [50, 25, 130]),  # who slows it down does so with care
        ("servo_m3", [100, 100, 130], [100, 100, 100]),  # the pulse, and with it how deep the stylus goes
        ("servo_m3", [100, 100, 90], [100, 100, 100]),
    ],
)
@pytest.mark.parametrize("moving", [False, True])
def test_no_pendant_makes_a_touch_faster_or_a_servo_go_elsewhere(
    kind: str, told: list[int], kept: list[int], moving: bool
) -> None:
    rig = Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind))).homed()
    if moving:
        rig.go((0.3, 0.0, 0.0))
        rig.run_for(0.3)
    rig.board.overrides = list(told)
    rig.run_for(0.5)
    assert rig.board.overrides == kept and rig.state == ("moving" if moving else "idle")
    notes = [event.text for event in rig.events if isinstance(event, Note)]
    said = f"the board's overrides were {told[0]} % (feed) and {told[2]} % (spindle): the driver set them back to 100 %"
    assert [note for note in notes if "override" in note] == ([] if kept == told else [said])


def test_every_machine_that_can_be_configured_has_settings_that_fit_their_lines() -> None:
    """A line that is too long ended the driver, in the service that was to write it."""
    with pytest.raises(ConfigError, match=r"steps_per_mm = 1e\+90 is above its maximum"):
        MachineConfig(steps_per_mm=(1e90, 80.0, 400.0))
    machine = MachineConfig(steps_per_mm=(999999.999, 0.011, 1e6))
    rig = Rig(DriverConfig(enabled_at_start=True, machine=machine)).connect()
    assert rig.machine.write_settings(rig.now) == ""
    rig.run_for(1.0)
    written = [text for text in rig.board.received if "=" in text]
    assert written == ["$100=999999.999", "$101=0.011", "$102=1000000"]


def test_what_homing_and_the_settings_check_rest_on_is_fixed_while_the_node_runs() -> None:
    items = {item.name: item.setting.read_only for item in settings_of(DriverConfig)}
    fixed = {name for name in items if name.startswith("machine.")}
    fixed |= {f"stylus.{name}" for name in ("kind", "stroke_m", "servo_up", "servo_down", "servo_range")}
    fixed |= {"port", "baud"}
    assert len(fixed) == 13 and [name for name in sorted(fixed) if not items[name]] == []
    assert not items["feed_m_s"], "what only the next motion needs stays live"


def test_pause_holds_and_resume_goes_on_without_losing_a_line() -> None:
    rig = Rig().homed()
    source = [f"G53 G1 X{-359 + 5 * k} F9000" for k in range(1, 41)]
    assert rig.machine.pause(rig.now) == "nothing to pause: the driver is idle"
    assert not rig.machine.paused
    assert rig.machine.run_program("p", source, rig.now).outcome.value == "accepted"
    rig.run_for(0.4)
    assert rig.machine.pause(rig.now) == "" and rig.machine.paused
    rig.until(lambda: rig.board.state == "Hold:0", 1.0)
    where = list(rig.board.mpos)
    rig.run_for(5.0)
    assert rig.states[-1] == "moving: paused" and rig.board.mpos == where and rig.outcomes() == ["accepted"]
    assert "paused" in rig.machine.pause(rig.now)
    assert rig.machine.resume(rig.now) == ""
    rig.until(lambda: "reached" in rig.outcomes(), 20.0)
    assert [t for t in rig.board.executed if "X" in t] == [
        "F9000X-354G53G1",
        *(f"X{-359 + 5 * k}G53G1" for k in range(2, 41)),
    ]
    assert "nothing to resume" in rig.machine.resume(rig.now)


def test_resume_waits_for_the_hold_to_complete() -> None:
    rig = Rig().homed()
    rig.board.hold_s = 0.4
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.3)
    rig.machine.pause(rig.now)
    rig.step()
    rig.machine.resume(rig.now)
    rig.until(lambda: "reached" in rig.outcomes(), 10.0)
    resumed = [t for t, code in rig.board.realtime if code == ord("~")]
    hold = next(t for t, code in rig.board.realtime if code == ord("!"))
    assert resumed and resumed[0] >= hold + 0.4


def test_resume_just_after_a_pause_trusts_no_report_from_before_the_hold() -> None:
    """The hold that appeared then seemed to come from another sender, and ended the program."""
    rig = Rig().homed()
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.3)
    running = rig.board.report()
    assert rig.machine.pause(rig.now) == "" and rig.machine.resume(rig.now) == ""
    rig.machine.receive(f"{running}\r\n".encode(), rig.now)
    rig.until(lambda: len(rig.outcomes()) == 2, 10.0)
    assert rig.outcomes() == ["accepted", "reached"] and {code for _, code in rig.board.realtime} >= {*b"!~"}
    assert rig.go((0.1, 0.0, 0.0)).outcome.value == "accepted"
    rig.run_for(0.3)
    rig.board.write(b"!")  # a button at the board: once resumed, no program here holds it
    rig.until(lambda: "the board went to Hold" in rig.states[-1])


def test_a_stop_and_a_lost_operator_end_a_pause() -> None:
    for end in ("stop", "heartbeat"):
        rig = Rig().homed()
        rig.go((0.1, 0.1, 0.03), (0.3, 0.1, 0.03))
        rig.until(lambda rig=rig: rig.board.mpos[2] < -30.9)
        rig.machine.pause(rig.now)
        rig.run_for(1.0)
        if end == "stop":
            rig.machine.stop("stop requested", rig.now)
        rig.beating = end == "stop"
        rig.until(lambda rig=rig: rig.machine.phase.name == "STOPPED")
        assert rig.outcomes() == ["accepted", "aborted"] and rig.board.mpos[2] == pytest.approx(HOMED[2])
        assert rig.machine.homed


@pytest.mark.parametrize("late", [1, 2, 3, 6])
def test_a_stop_just_after_a_resume_trusts_no_hold_from_before_it(late: int) -> None:
    """A busy computer delivers several reports from before the resume at once."""
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.03), (0.3, 0.1, 0.03))
    rig.until(lambda: rig.board.mpos[0] > HOMED[0] + 110.0)
    rig.machine.pause(rig.now)
    rig.until(lambda: rig.board.state == "Hold:0")
    rig.run_for(0.2)
    paused = rig.board.report()
    rig.machine.resume(rig.now)
    rig.until(lambda: rig.board.state == "Run", 1.0)
    rig.machine.receive(f"{paused}\r\n".encode(), rig.now)  # asked for again: `~` waits to be written
    rig.board.write(b"!")
    rig.machine.stop("stop requested", rig.now, hold_written=True)
    rig.machine.receive(late * f"{paused}\r\n".encode(), rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.machine.homed and rig.board.mpos[2] == pytest.approx(HOMED[2])
    resumed = [t for t, code in rig.board.realtime if code == ord("~")]
    assert next(code for t, code in rig.board.realtime if t > resumed[-1] and code != ord("?")) == ord("!")


def test_settings_are_written_alone_and_read_back() -> None:
    board = Board()
    board.settings |= {20: "0", 22: "0", 110: "500.000"}
    rig = Rig(board=board).connect()
    assert rig.state == "mismatch"
    began = rig.now
    assert rig.machine.write_settings(rig.now) == ""
    rig.until(lambda: rig.state == "unhomed")
    assert "connecting: writing $22, $20, $110" in rig.states
    assert [t for t in board.received if "=" in t] == ["$22=1", "$20=1", "$110=12000"], "homing before soft limits"
    sent = [(t, data) for t, data in rig.trace if b"=" in data or b"$$" in data]
    times = [t for t, data in sent if t > began]
    assert all(b - a >= 0.05 for a, b in itertools.pairwise(times)) and len(times) == 4
    assert all(data.count(b"\n") == 1 for _, data in sent), "nothing else under way with one"
    assert rig.machine.write_settings(rig.now) == "nothing to write: it has these settings"


def test_a_setting_that_the_board_does_not_keep_is_named() -> None:
    board = Board()
    board.settings |= {110: "500.000", 111: "500.000"}
    board.stubborn, board.refuse = {110}, {"$111=12000": 3}
    rig = Rig(board=board).connect()
    assert rig.machine.write_settings(rig.now) == ""
    rig.until(lambda: rig.state == "mismatch")
    assert rig.states[-1] == (
        "mismatch: $110 is 500.000; expected 12000 (the configuration); "
        "$111 is 500.000; expected 12000 (the configuration)"
    )
    notes = [event.text for event in rig.events if isinstance(event, Note)]
    assert "the board did not keep a setting: $110 is 500.000; expected 12000 (value written)" in notes
    assert any("error:3" in text and "$111=12000" in text for text in notes)


def test_settings_are_not_written_while_something_moves_and_unhome_the_machine() -> None:
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.0))
    assert "at rest with the stylus up; it is moving" in rig.machine.write_settings(rig.now, {12: 0.01})
    rig.until(lambda: "reached" in rig.outcomes())
    rig.go((0.1, 0.1, 0.01))
    rig.until(lambda: rig.outcomes().count("reached") == 2)
    assert "at rest with the stylus up" in rig.machine.write_settings(rig.now, {12: 0.01})
    rig.go((0.1, 0.1, 0.0))
    rig.until(lambda: rig.outcomes().count("reached") == 3)
    assert rig.machine.write_settings(rig.now, {12: 0.01}) == ""
    rig.until(lambda: rig.state == "unhomed")
    assert rig.board.settings[12] == "0.010" and not rig.machine.homed


def test_a_stop_while_settings_are_written_is_a_stop() -> None:
    rig = Rig().homed()
    assert rig.machine.write_settings(rig.now, {12: 0.01, 11: 0.02}) == ""
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.state == "stopped", 20.0)
    assert rig.states[-1] == "stopped: stop requested"


@pytest.mark.parametrize(
    "program",
    [
        [],
        ["M3 S800", "G53 G1 X-300 F6000", "G53 G1 X-100", "M3 S200"],
        ["G1 F6000", "S800 G53 X-300 M3", "G53 X-100"],
        ["M3 S200", "G53 G1 X-300 F6000", "S800", "G53 G1 X-100"],
        ["M3 S800", "M5", "G53 G1 X-300 F6000", "G53 G1 X-100"],  # a servo without pulses is limp, not up
    ],
)
def test_a_servo_that_is_down_between_two_moves_is_lifted_by_a_stop(program: list[str]) -> None:
    config = DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind="servo_m3", dwell_s=0.1))
    rig = Rig(config).homed()
    if program:
        source = program
        assert rig.machine.run_program("p", source, rig.now).outcome.value == "accepted"
    else:
        assert rig.go((0.05, 0.0, 0.02), (0.25, 0.0, 0.02), (0.25, 0.0, 0.0)).outcome.value == "accepted"
    rig.until(lambda: rig.board.mpos[0] > -280)
    rig.board.received.clear()
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert "M3S200" in rig.board.received and rig.machine.homed


@pytest.mark.parametrize("lift", [True, False])
def test_a_servo_that_was_up_is_not_left_limp_over_the_panel_by_a_stop(lift: bool) -> None:
    """The reset with which a stop ends takes the servo's pulses away; the next motion must not cross with it so."""
    config = DriverConfig(enabled_at_start=True, lift_on_stop=lift, stylus=StylusConfig(kind="servo_m3", dwell_s=0.1))
    rig = Rig(config).homed()
    assert rig.go((0.25, 0.0, 0.0)).outcome.value == "accepted"
    rig.until(lambda: rig.board.mpos[0] > -280)
    rig.board.received.clear()
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.machine.homed and ("M3S200" in rig.board.received) is lift
    assert rig.machine.reset(rig.now) == ""
    rig.run_for(0.3)
    x, y, stylus = rig.machine.reading_m or (0.0, 0.0, 0.0)
    assert rig.state == "idle" and stylus == (0.0 if lift else config.stylus.stroke_m), "limp may be down"
    assert rig.go((x, y, 0.0), (0.0, 0.0, 0.0)).outcome.value == "accepted"
    rig.until(lambda: "reached" in rig.outcomes())
    lines = [text for text in rig.board.received if "X" in text or "M3" in text]
    assert lines[0] == "M3S200" and "X" in lines[-1]


SINKS = "; the servo may be without pulses and sink, the stylus may press"


def servo() -> Rig:
    return Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind="servo_m3", dwell_s=0.1))).homed()


@pytest.mark.parametrize("code", [1, 3])
def test_an_alarm_tells_that_a_servo_may_be_limp_until_homing_lifts_it(code: int) -> None:
    """GRBL ends the pulses at the alarm, grblHAL at the reset after it: also a stylus that was up may sink."""
    rig = servo()
    rig.go((0.25, 0.0, 0.0))
    rig.run_for(0.3)
    rig.board.alarm(code)
    rig.until(lambda: rig.state == "alarm")
    assert rig.states[-1].startswith(f"alarm: ALARM:{code}") and rig.states[-1].endswith(SINKS)
    rig.run_for(1.0)
    rig.machine.reset(rig.now)
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-1] == f"unhomed: {SINKS[2:]}"
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")
    assert rig.states[-1] == "idle"
    assert rig.go((0.1, 0.0, 0.0)).outcome.value == "accepted"


@pytest.mark.parametrize("kind", ["servo_m3", "solenoid_m8", "z_axis"])
def test_an_alarm_tells_that_a_stylus_which_was_down_has_not_been_lifted(kind: str) -> None:
    rig = pressing(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind, dwell_s=0.1)))
    rig.board.alarm(1)
    rig.until(lambda: rig.state == "alarm")
    assert rig.states[-1].endswith(NOT_LIFTED)


def test_a_link_that_is_lost_tells_of_a_servo_that_the_opened_port_leaves_limp() -> None:
    rig = servo()
    rig.machine.closed("the device has gone", rig.now)
    rig.board.power_cycle()
    rig.board.out.clear()
    rig.machine.opened(rig.now)
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-1] == f"unhomed: {SINKS[2:]}"


@pytest.mark.parametrize("kind", ["servo_m3", "z_axis"])
def test_a_link_that_is_lost_on_the_way_down_tells_of_a_stylus_that_no_report_has_shown_there(kind: str) -> None:
    """The lines in the board's buffer continue: its last report was that the stylus is up."""
    rig = Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind, dwell_s=0.1))).homed()
    order = "M3S800" if kind == "servo_m3" else "Z0G1"
    rig.go((0.3, 0.1, 0.0), (0.3, 0.1, 0.02))
    rig.until(lambda: order in rig.sent())
    assert rig.positions[-1][2] == 0.0
    rig.machine.closed("the device has gone", rig.now)
    rig.collect()
    assert rig.states[-1] == f"disconnected: the device has gone{NOT_LIFTED}"
    rig.machine.opened(rig.now)
    rig.board.reset()
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-1] == f"unhomed: {NOT_LIFTED[2:]}"
    rig.run_for(0.1)
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")
    assert rig.states[-1] == "idle"


@pytest.mark.parametrize("kind", ["servo_m3", "solenoid_m8"])
def test_a_stylus_counts_as_down_until_it_has_been_lifted_and_not_from_the_order_on(kind: str) -> None:
    """An alarm on that path leaves it at any position, and the controller knows only the last reading."""
    rig = pressing(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind, dwell_s=0.1)))
    rig.positions.clear()
    assert rig.go((0.3, 0.1, 0.02), (0.3, 0.1, 0.0), (0.1, 0.1, 0.0)).outcome.value == "accepted"
    rig.until(lambda: rig.board.mpos[0] > HOMED[0] + 250.0)  # it draws
    assert rig.positions and {stylus for _, _, stylus in rig.positions} == {0.02}
    rig.until(lambda: rig.board.executed[-1] == "G4P0.1")
    rig.run_for(0.2)
    assert rig.state == "moving" and rig.positions[-1][2] == 0.0, "it has gone up, though the motion goes on"
    rig.until(lambda: rig.outcomes()[-1] == "reached")
    rig.go((0.1, 0.1, 0.02))
    rig.until(lambda: rig.state == "idle")
    rig.go((0.3, 0.1, 0.02), (0.3, 0.1, 0.0))
    rig.until(lambda: rig.board.mpos[0] > HOMED[0] + 250.0)
    rig.board.alarm(1)
    rig.until(lambda: rig.state == "alarm")
    assert rig.positions[-1][2] == 0.02 and rig.states[-1].endswith(NOT_LIFTED)


@pytest.mark.parametrize("kind", ["servo_m3", "solenoid_m8"])
def test_a_goal_just_after_a_lift_knows_that_the_stylus_is_up(kind: str) -> None:
    down = {"servo_m3": "M3S800", "solenoid_m8": "M8"}[kind]
    rig = pressing(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind, dwell_s=0.1)))
    for stylus in (0.0, 0.02):
        rig.board.received.clear()
        rig.results.clear()
        assert rig.go((0.1, 0.1, stylus)).outcome.value == "accepted"
        rig.until(lambda: len(rig.results) == 2)
        assert rig.outcomes()[-1] == "reached"
    assert down in rig.board.received


@pytest.mark.parametrize(
    ("banner", "again"), [(b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n", True), (None, False)]
)
def test_a_servo_is_lifted_once_more_after_a_homing_that_switches_the_spindle_off(
    banner: bytes | None, again: bool, monkeypatch: Any
) -> None:
    if banner is not None:
        monkeypatch.setattr(protocol_board, "BANNER", banner)
    rig = servo()
    assert ("M3S200" in rig.board.received[rig.board.received.index("$H") :]) is again


def test_a_pause_that_presses_for_longer_than_a_rest_may_is_a_stop() -> None:
    rig = Rig(DriverConfig(enabled_at_start=True, max_rest_extended_s=3.0)).homed()
    rig.go((0.1, 0.1, 0.0), (0.3, 0.1, 0.0))
    rig.run_for(0.5)
    rig.machine.pause(rig.now)
    rig.run_for(10.0)
    assert rig.states[-1] == "moving: paused", "with the stylus up there is no limit"
    rig.machine.resume(rig.now)
    rig.until(lambda: "reached" in rig.outcomes())
    rig.go((0.3, 0.1, 0.03), (0.1, 0.1, 0.03))
    rig.until(lambda: rig.board.mpos[2] < -30.9)
    rig.machine.pause(rig.now)
    rig.run_for(2.5)
    assert rig.states[-1] == "moving: paused"
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert "extended for 3.0 s (limit 3 s)" in rig.states[-1]
    assert rig.board.mpos[2] == pytest.approx(HOMED[2]) and rig.machine.homed


@pytest.mark.parametrize("banner", [True, False])
def test_marlin_is_told_from_the_others_and_nothing_but_a_question_is_sent_to_it(banner: bool) -> None:
    machine, now, sent = Machine(DriverConfig(enabled_at_start=True)), 0.0, b""
    machine.opened(now)
    if banner:
        machine.receive(b"start\necho:Marlin 2.1.2\necho: Last Updated: 2024-01-01\n", 0.1)
    while machine.state != "mismatch":
        now += 0.05
        assert now < 6.0
        machine.tick(now)
        sent += machine.output(now)
        if b"M115" in sent.split(b"\n")[:-1]:  # behind question marks in its line, no Marlin would know it
            machine.receive(b"FIRMWARE_NAME:Marlin 2.1.2 SOURCE_CODE_URL:x PROTOCOL_VERSION:1.0\nok\n", now)
    assert set(sent.replace(b"M115\n", b"")) <= set(b"?\n") and (b"M115" in sent) is not banner
    assert machine.state_text.startswith("mismatch: the firmware is Marlin, which has no feed hold")
    machine.heartbeat(now)
    refused = machine.run("g", JOINTS, [Waypoint(positions_m=(0.1, 0.1, 0.0))], age_s=0.0, now=now)
    assert "the firmware is Marlin" in refused.reason and "Marlin" in machine.home(now)
    assert "Marlin" in machine.write_settings(now) or "no settings" in machine.write_settings(now)
    assert "nothing to accept" in machine.accept_settings(now)
    machine.stop("stop requested", now)
    assert machine.output(now) == b""


def test_a_grbl_before_1_1_is_told_from_the_others_and_asked_for_nothing() -> None:
    """Its reports were noise, and so the link was lost and found again for ever."""
    machine = Machine(DriverConfig(enabled_at_start=True))
    machine.opened(0.0)
    machine.receive(b"\r\nGrbl 0.9j ['$' for help]\r\n['$H'|'$X' to unlock]\r\n", 0.1)
    sent = b""
    for now in (0.1 * k for k in range(2, 100)):
        machine.tick(now)
        sent += machine.output(now)
    machine.heartbeat(now)
    assert machine.state_text.startswith("mismatch: the firmware is a GRBL before 1.1") and sent == b""
    assert "before 1.1" in machine.home(now) and "nothing to accept" in machine.accept_settings(now)


@pytest.mark.parametrize("phase", ["MOVING", "HOMING"])
def test_a_marlin_that_comes_up_in_the_place_of_the_board_ends_what_was_under_way(phase: str) -> None:
    """The goal got no final answer, and the machine stayed homed."""
    rig = Rig().homed()
    rig.machine.home(rig.now) if phase == "HOMING" else rig.go((0.3, 0.1, 0.0))
    rig.run_for(0.2)
    assert rig.machine.phase.name == phase
    rig.board.mute = True
    rig.run_for(0.05)  # a report in transit would come from the Marlin otherwise
    rig.trace.clear()
    rig.machine.receive(b"start\necho:Marlin 2.1.2\n", rig.now)
    rig.step()
    assert rig.states[-1].startswith("connecting: the board has reset itself") and not rig.machine.homed
    assert rig.outcomes() == (["accepted", "aborted"] if phase == "MOVING" else [])
    assert rig.trace[0][1].startswith(b"!"), "perhaps it was noise, and the board moves"
    rig.until(lambda: "M115" in rig.sent())
    rig.machine.receive(b"FIRMWARE_NAME:Marlin 2.1.2 SOURCE_CODE_URL:x PROTOCOL_VERSION:1.0\nok\n", rig.now)
    rig.step()
    assert rig.states[-1].startswith("mismatch: the firmware is Marlin")
    rig.machine.receive(b"start\necho:Marlin 2.1.2\n", rig.now)
    rig.trace.clear()
    rig.run_for(5.0)
    assert rig.states[-1].startswith("mismatch: the firmware is Marlin") and rig.trace == []


def test_a_stop_is_one_though_a_line_has_named_another_firmware() -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.1, 0.0))
    rig.run_for(0.2)
    rig.machine.receive(b"FIRMWARE_NAME:Marlin 2.1.2 SOURCE_CODE_URL:x PROTOCOL_VERSION:1.0\n", rig.now)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.outcomes() == ["accepted", "aborted"] and rig.board.mpos[0] < HOMED[0] + 200.0


def test_a_banner_that_noise_has_made_an_old_one_is_a_reset_like_any_other(monkeypatch: Any) -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.1, 0.0))
    rig.until(lambda: rig.board.state == "Run")
    monkeypatch.setattr(protocol_board, "BANNER", protocol_board.BANNER.replace(b"1.1h", b"0.1h"))
    rig.board.power_cycle()
    rig.step()
    monkeypatch.undo()
    rig.until(lambda: rig.state == "unhomed")
    assert rig.outcomes() == ["accepted", "aborted"] and "reset itself" in rig.results[-1].reason
