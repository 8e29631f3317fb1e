"""A reconnection to a board that kept running with the stylus down: the first motion lifts it."""

from __future__ import annotations

import pytest
from unit.gantry_driver.protocol_board import HOMED, NO_PANEL, Board, Rig

from gantry_driver.core.configuration.machine_config import DriverConfig, StylusConfig
from gantry_driver.core.machine.machine import Machine

NOT_LIFTED = "the board did not lift the stylus, it may still press"
LIFTED = "stopped: the stylus stayed down while no driver was connected"


def left_pressing() -> Rig:
    """Return a rig whose link was lost in contact, 20 mm down; the board keeps its power and its position."""
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    assert rig.board.mpos[2] == pytest.approx(HOMED[2] - 20.0)
    rig.machine.closed("no status report for 1.5 s", rig.now)
    rig.collect()
    assert rig.states[-1].endswith(NOT_LIFTED)
    return rig


def reopen(rig: Rig) -> None:
    """Open the port of a board that this does not reset."""
    rig.board.out.clear()
    rig.board.received.clear()
    rig.machine.opened(rig.now)
    rig.until(lambda: rig.machine.phase.name in ("STOPPED", "UNHOMED", "MISMATCH", "ALARM"), 5.0)


def moves(board: Board) -> list[str]:
    return [text for text in board.received if text.endswith("G1")]


def test_the_first_motion_after_a_reconnect_lifts_the_stylus_and_moves_nothing_else() -> None:
    rig = left_pressing()
    x, y, _ = rig.board.mpos
    reopen(rig)
    assert rig.board.mpos == pytest.approx([x, y, HOMED[2]])
    assert moves(rig.board) == ["F1800Z-1G53G1"]
    assert rig.states[-1] == LIFTED and not rig.machine.may_be_down
    assert not rig.machine.homed, "the steps of the time without a link are not known"
    assert rig.machine.reset(rig.now) == "" and rig.state == "unhomed"


def test_a_new_driver_lifts_what_its_predecessor_left_down() -> None:
    rig = left_pressing()
    rig.machine = Machine(DriverConfig(enabled_at_start=True, envelope=NO_PANEL), left_down=True)
    reopen(rig)
    assert rig.board.mpos[2] == pytest.approx(HOMED[2]) and rig.states[-1] == LIFTED


def test_a_stop_that_was_asked_for_without_a_link_keeps_its_reason_and_lifts() -> None:
    rig = left_pressing()
    rig.machine.stop("stop requested", rig.now)
    reopen(rig)
    assert rig.board.mpos[2] == pytest.approx(HOMED[2]) and rig.states[-1] == "stopped: stop requested"


def test_a_board_that_still_moves_is_held_at_once_and_lifted() -> None:
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.02), (0.3, 0.1, 0.02))
    rig.until(lambda: rig.board.mpos[0] > HOMED[0] + 150)
    rig.machine.closed("no status report for 1.5 s", rig.now)
    rig.board.step(rig.now)
    since, begun = len(rig.board.realtime), rig.now
    reopen(rig)
    assert rig.board.mpos[2] == pytest.approx(HOMED[2]) and rig.board.mpos[0] < HOMED[0] + 290
    held_at = next(at for at, byte in rig.board.realtime[since:] if byte == ord("!"))
    assert held_at - begun < 0.1


@pytest.mark.parametrize("same_driver", [True, False])
def test_a_board_that_still_travels_with_the_stylus_up_is_held_at_once(same_driver: bool) -> None:
    rig = Rig().homed()
    rig.go((0.3, 0.1, 0.0))
    rig.until(lambda: rig.board.mpos[0] > HOMED[0] + 20)
    rig.machine.closed("no status report for 1.5 s", rig.now)
    if not same_driver:
        rig.machine = Machine(rig.machine.config)
        rig.machine.left_moving = True
    rig.board.step(rig.now)
    since, begun = len(rig.board.realtime), rig.now
    reopen(rig)
    held_at = next(at for at, byte in rig.board.realtime[since:] if byte == ord("!"))
    assert held_at - begun < 0.1
    assert rig.board.mpos[0] < HOMED[0] + 290 and moves(rig.board) == [] and rig.state == "unhomed"


def test_a_board_that_restarts_at_the_opening_gets_questions_only_before_its_banner() -> None:
    rig = Rig().homed()
    rig.machine = Machine(rig.machine.config)
    rig.machine.left_moving = True
    rig.board.out.clear()
    rig.board.mute = True  # its start takes 0.4 s, in which its loader receives what is sent
    since, begun = len(rig.board.realtime), rig.now
    rig.machine.opened(begun)
    rig.run_for(0.4)
    before = {byte for _, byte in rig.board.realtime[since:]}
    rig.board.mute = False
    rig.board.power_cycle()
    rig.until(lambda: rig.state == "unhomed")
    assert before == {ord("?")}, "three holds in a row are a command of a common loader"
    assert ord("!") not in {byte for _, byte in rig.board.realtime[since:]} and moves(rig.board) == []


def test_a_board_that_was_at_rest_is_given_time_for_its_banner() -> None:
    rig = Rig().homed()
    rig.machine.closed("the device has gone", rig.now)
    since, begun = len(rig.board.realtime), rig.now
    reopen(rig)
    assert rig.board.realtime[since][0] - begun >= rig.machine.config.banner_wait_s


def test_nothing_is_lifted_where_the_board_does_not_know_its_position() -> None:
    rig = left_pressing()
    rig.board.power_cycle()
    z = rig.board.mpos[2]
    reopen(rig)
    assert moves(rig.board) == [] and rig.board.mpos[2] == z
    assert rig.states[-1] == f"unhomed: {NOT_LIFTED}"


def test_nothing_is_lifted_when_the_board_stands_elsewhere_after_the_reset() -> None:
    rig = left_pressing()
    rig.board.hooks["$I"] = lambda: rig.board.mpos.__setitem__(2, HOMED[2] - 5.0)
    reopen(rig)
    assert moves(rig.board) == [] and rig.states[-1] == f"unhomed: {NOT_LIFTED}"


def test_nothing_is_lifted_by_a_board_of_other_settings() -> None:
    rig = left_pressing()
    rig.board.settings[102] = "200.000"
    reopen(rig)
    assert moves(rig.board) == [] and rig.states[-1].startswith("mismatch: $102")
    assert rig.states[-1].endswith(NOT_LIFTED)


def test_nothing_is_lifted_that_is_not_extended() -> None:
    rig = left_pressing()
    rig.board.mpos[2] = HOMED[2]
    reopen(rig)
    assert moves(rig.board) == [] and rig.states[-1] == "unhomed" and not rig.machine.may_be_down


def test_without_lift_on_stop_it_stays_and_the_state_says_so() -> None:
    rig = left_pressing()
    rig.machine.configure(DriverConfig(enabled_at_start=True, lift_on_stop=False), rig.now)
    reopen(rig)
    assert moves(rig.board) == [] and rig.states[-1] == f"unhomed: {NOT_LIFTED}"


def test_a_servo_is_lifted_by_its_pulses() -> None:
    config = DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind="servo_m3"))
    rig = Rig(config).homed()
    rig.go((0.1, 0.1, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.machine.closed("no status report for 1.5 s", rig.now)
    reopen(rig)
    assert (rig.board.modes["spindle"], rig.board.modes["speed"]) == ("M3", "200")
    assert rig.states[-1] == LIFTED and not rig.machine.may_be_down


def test_an_alarm_during_the_lift_says_that_the_stylus_may_press() -> None:
    rig = left_pressing()
    rig.board.hooks["F1800Z-1G53G1"] = lambda: rig.board.alarm(3)
    reopen(rig)
    assert rig.states[-1].startswith("alarm: ALARM:3") and rig.states[-1].endswith(NOT_LIFTED)
