"""End of a stop, a retreat and a reset where the board does not carry out the order."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from unit.gantry_driver.protocol_board import HOMED, Board, Rig

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.machine.connection import HOLD_REPEAT_S
from gantry_driver.core.machine.machine import BANNER_TIMEOUT_S
from gantry_driver.core.machine.stopping import LOCKED
from gantry_driver.core.states.machine_states import CloseRequested, MachinePhase

PRESSED = (0.1, 0.1, 0.02)
CONFIG = DriverConfig(enabled_at_start=True)


def pressing(config: DriverConfig = CONFIG, board: Board | None = None) -> Rig:
    """Return a rig that rests with the stylus extended."""
    rig = Rig(config, board).homed()
    rig.go((0.1, 0.1, 0.0), PRESSED)
    rig.until(lambda: rig.state == "idle" and rig.board.mpos[2] < HOMED[2] - 19.0)
    return rig


def until(rig: Rig, phase: MachinePhase) -> Rig:
    rig.until(lambda: rig.machine.phase is phase, 20.0)
    return rig


def stopped(rig: Rig, phase: MachinePhase) -> Rig:
    """Stop a rig, and return it in a phase of the way down."""
    rig.machine.stop("why", rig.now)
    return until(rig, phase)


class WithoutHold(Board):
    """A firmware that does not hold while it is idle."""

    def _realtime(self, byte: int) -> None:
        if byte != ord("!") or self.state != "Idle":
            super()._realtime(byte)


class HardOfHearing(Board):
    """A board that does not receive the next ``deaf`` holds."""

    deaf = 0

    def _realtime(self, byte: int) -> None:
        if byte == ord("!") and self.deaf:
            self.deaf -= 1
            return
        super()._realtime(byte)


@pytest.mark.parametrize("phase", [MachinePhase.HOLDING, MachinePhase.RESETTING, MachinePhase.LIFTING])
def test_a_stop_under_way_cannot_be_reset(phase: MachinePhase) -> None:
    rig = stopped(pressing(), phase)
    assert rig.machine.retreating is (phase is MachinePhase.LIFTING)
    assert rig.machine.reset(rig.now) == "the stop is not complete yet"
    until(rig, MachinePhase.STOPPED)
    assert not rig.machine.retreating and rig.board.mpos[2] == HOMED[2]
    assert rig.machine.reset(rig.now) == "" and rig.state == "idle"


@pytest.mark.parametrize("phase", [MachinePhase.HOLDING, MachinePhase.LIFTING, MachinePhase.MOVING])
def test_a_report_of_an_alarm_whose_number_was_lost_ends_in_an_alarm(phase: MachinePhase) -> None:
    rig = pressing()
    if phase is MachinePhase.MOVING:
        rig.go((0.3, 0.1, 0.02), (0.3, 0.1, 0.0))
        until(rig, phase)
    else:
        stopped(rig, phase)
    rig.board.blocks.clear()
    rig.board.state = "Alarm"
    rig.board.say(rig.board.report())
    until(rig, MachinePhase.ALARM)
    after = "" if phase is MachinePhase.MOVING else ", after: why"
    assert rig.states[-1].startswith(f"alarm: {LOCKED}{after}") and not rig.machine.homed


def test_a_second_alarm_keeps_the_reason_of_the_first() -> None:
    rig = pressing()
    rig.board.alarm(1)
    until(rig, MachinePhase.ALARM)
    first = rig.machine.state_text
    rig.board.say("ALARM:2")
    rig.run_for(0.1)
    assert rig.machine.phase is MachinePhase.ALARM and rig.machine.state_text == first and "ALARM:1" in first


def test_a_board_that_does_not_hold_while_idle_is_reset_after_a_while() -> None:
    rig = pressing(board=WithoutHold())
    begun = rig.now
    stopped(rig, MachinePhase.RESETTING)
    assert 1.5 * HOLD_REPEAT_S < rig.now - begun < 1.5 * HOLD_REPEAT_S + 0.2
    until(rig, MachinePhase.STOPPED)
    assert rig.board.mpos[2] == HOMED[2] and rig.machine.homed


@pytest.mark.parametrize(("state", "resets"), [("Hold:0", 1), ("Door:0", 1), ("Run", 0), ("Home", 0)])
def test_a_board_still_held_after_a_reset_is_reset_again_and_a_moving_one_is_waited_for(
    state: str, resets: int
) -> None:
    rig = stopped(pressing(), MachinePhase.RESETTING)
    rig.until(lambda: not rig.machine.session.awaiting_banner)
    before, now_in = rig.board.resets, rig.board.state
    rig.board.out.clear()
    rig.board.state = state
    rig.board.say(rig.board.report())
    rig.step()
    rig.board.state = now_in
    rig.step()
    assert rig.board.resets - before == resets and rig.machine.phase is MachinePhase.RESETTING
    until(rig, MachinePhase.STOPPED)
    assert rig.board.mpos[2] == HOMED[2]


@pytest.mark.parametrize("phase", [MachinePhase.RESETTING, MachinePhase.ALARM_RESET])
def test_a_reset_without_a_banner_closes_the_port(phase: MachinePhase) -> None:
    rig = pressing()
    if phase is MachinePhase.RESETTING:
        stopped(rig, MachinePhase.RESETTING)
    else:
        rig.board.alarm(3)
        until(rig, MachinePhase.ALARM)
        assert rig.machine.reset(rig.now) == ""
        rig.step()
    assert rig.machine.session.awaiting_banner
    rig.board.mute = True
    rig.board.out.clear()
    begun = rig.now
    rig.until(lambda: closings(rig), 20.0)
    assert BANNER_TIMEOUT_S <= rig.now - begun + 0.01 < BANNER_TIMEOUT_S + 1.0
    assert closings(rig) == ["no banner within 5 s of a reset"]


def closings(rig: Rig) -> list[str]:
    return [event.reason for event in rig.events if isinstance(event, CloseRequested)]


def test_a_homing_cycle_that_never_ends_is_stopped_by_a_reset() -> None:
    rig = Rig(DriverConfig(enabled_at_start=True, homing_timeout_s=10.0)).connect()
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.board.homing_until > 0)
    rig.board.homing_until = 1e9
    begun = rig.now
    rig.until(lambda: rig.state == "stopped", 20.0)
    assert rig.now - begun == pytest.approx(10.0, abs=0.2)
    assert rig.machine.state_text == "stopped: homing took longer than 10 s"
    assert rig.board.homing_until == -1.0 and not rig.machine.homed, "the reset has ended it"


def test_a_retreat_that_takes_too_long_is_reported_as_such() -> None:
    rig = stopped(pressing(), MachinePhase.LIFTING)
    rig.board.speed_scale = 0.0
    until(rig, MachinePhase.STOPPED)
    assert rig.machine.state_text == "stopped: why; the board did not lift the stylus in time"
    assert rig.board.mpos[2] == pytest.approx(HOMED[2] - 20.0, abs=0.5)


def test_a_retreat_that_ends_below_the_top_says_by_how_much() -> None:
    rig = stopped(pressing(), MachinePhase.LIFTING)
    rig.until(lambda: bool(rig.board.blocks))
    text, target, feed = rig.board.blocks[0]
    rig.board.blocks[0] = (text, [*target[:2], HOMED[2] - 8.0], feed)
    until(rig, MachinePhase.STOPPED)
    said = "the board did not lift the stylus: it is still extended by 8.0 mm"
    assert rig.machine.state_text == f"stopped: why; {said}"


@pytest.mark.parametrize("written", [False, True])
def test_a_stop_while_connecting_writes_its_hold_once(written: bool) -> None:
    rig = Rig()
    rig.machine.opened(rig.now)
    rig.machine.output(rig.now)
    rig.machine.stop("why", rig.now, hold_written=written)
    assert rig.machine.output(rig.now).count(b"!") == (0 if written else 1)
    assert rig.machine.phase is MachinePhase.SYNCHRONISE
    rig.board.reset()
    rig.until(lambda: rig.state not in ("connecting", "disconnected"))
    assert rig.machine.state_text.startswith("stopped: why")


def test_a_stop_of_a_board_with_other_settings_ends_in_the_mismatch_again() -> None:
    board = Board()
    board.settings[100] = "40.000"
    rig = Rig(CONFIG, board).connect()
    assert rig.state == "mismatch"
    said = rig.machine.state_text
    stopped(rig, MachinePhase.STOPPED)
    assert rig.machine.reset(rig.now) == "" and rig.machine.state_text == said


def test_a_hold_of_a_pause_is_repeated_until_it_shows() -> None:
    board = HardOfHearing()
    rig = Rig(CONFIG, board).homed()
    rig.go((0.3, 0.1, 0.0))
    rig.until(lambda: board.state == "Run")
    board.deaf = 2
    assert rig.machine.pause(rig.now) == ""
    begun = rig.now
    rig.until(lambda: board.state == "Hold:0")
    holds = [at for at, byte in board.realtime if byte == ord("!") and at >= begun]
    assert len(holds) == 3 and all(b - a >= HOLD_REPEAT_S for a, b in itertools.pairwise(holds))
    assert rig.machine.resume(rig.now) == ""
    rig.until(lambda: rig.outcomes()[-1:] == ["reached"], 30.0)


def test_a_pause_is_not_ended_without_the_operator() -> None:
    rig = Rig(CONFIG).homed()
    rig.go((0.3, 0.1, 0.0))
    rig.until(lambda: rig.board.state == "Run")
    assert rig.machine.pause(rig.now) == ""
    late = rig.now + CONFIG.heartbeat_timeout_s + 0.25
    refusal = rig.machine.resume(late)
    assert refusal == f"operator's heartbeat lost: {late - rig.now:.2f} s old (limit {CONFIG.heartbeat_timeout_s:g} s)"
    assert rig.machine.state_text == "moving: paused"


def test_no_transition_outside_the_table_is_made() -> None:
    machine: Any = Rig().machine
    with pytest.raises(AssertionError, match="CLOSED to LIFTING is not in the table"):
        machine._enter(MachinePhase.LIFTING, 0.0)
    assert machine.phase is MachinePhase.CLOSED
