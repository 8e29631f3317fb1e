"""The driver's state of a stylus that may be down, and its messages about one that was not lifted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from unit.gantry_driver import protocol_board
from unit.gantry_driver.protocol_board import HOMED, NO_PANEL, Rig

from gantry_driver.core.configuration.machine_config import STYLUS_KINDS, DriverConfig, StylusConfig
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.stylus_state import STYLUS_DOWN_M, Stylus, tells_of_stylus

NOT_LIFTED = "the board did not lift the stylus, it may still press"
RELEASED = "the solenoid is without power, the stylus is up"
SINKS = "the servo may be without pulses and sink, the stylus may press"

STATES = (
    "AS_READ",
    "UNDER_WAY",
    "UP",
    "LOWERING",
    "DOWN",
    "RISING",
    "LIMP",
    "LIMP_DOWN",
    "RELEASED",
    "LEFT_SEEN",
    "LEFT_UNSEEN",
)
HIGH, LOW = STYLUS_DOWN_M, STYLUS_DOWN_M + 1e-6
TABLE: list[tuple[str, Callable[[Stylus], Stylus], str]] = [
    # The next states, in the order of STATES; "." is the same one.
    ("ordered down", lambda s: s.ordered(True), "LOWERING " * 11),
    (
        "ordered up",
        lambda s: s.ordered(False),
        "RISING RISING . RISING RISING . RISING RISING UP RISING RISING",
    ),
    ("settled", lambda s: s.settled(), ". AS_READ . DOWN . UP . . . . ."),
    (
        "lost, read low",
        lambda s: s.lost(LOW),
        "LEFT_SEEN LEFT_SEEN . LEFT_SEEN LEFT_SEEN LEFT_SEEN . LEFT_SEEN . . .",
    ),
    (
        "lost, read high",
        lambda s: s.lost(HIGH),
        ". LEFT_UNSEEN . LEFT_UNSEEN LEFT_UNSEEN LEFT_UNSEEN . LEFT_UNSEEN . . .",
    ),
    (
        "lost, not read",
        lambda s: s.lost(None),
        ". LEFT_UNSEEN . LEFT_UNSEEN LEFT_UNSEEN LEFT_UNSEEN . LEFT_UNSEEN . . .",
    ),
    ("powerless servo", lambda s: s.powerless("servo_m3"), "LIMP . LIMP . . . . . . . ."),
    ("powerless solenoid", lambda s: s.powerless("solenoid_m8"), ". " * 11),
    ("powerless Z axis", lambda s: s.powerless("z_axis"), ". " * 11),
    (
        "reset with a servo or a Z axis",
        lambda s: s.was_reset("servo_m3"),
        ". AS_READ LIMP LIMP_DOWN LIMP_DOWN LIMP_DOWN . . . . .",
    ),
    ("seen clear, Z axis", lambda s: s.seen_clear("z_axis"), ". . . . . . . . . AS_READ AS_READ"),
    ("seen clear, servo", lambda s: s.seen_clear("servo_m3"), ". " * 11),
    ("reset with a solenoid", lambda s: s.was_reset("solenoid_m8"), "UP UP UP" + " RELEASED" * 8),
]


@pytest.mark.parametrize(("change", "nexts"), [row[1:] for row in TABLE], ids=[row[0] for row in TABLE])
def test_every_transition(change: Callable[[Stylus], Stylus], nexts: str) -> None:
    assert tuple(state.name for state in Stylus) == STATES
    expected = [name if after == "." else after for name, after in zip(STATES, nexts.split(), strict=True)]
    assert [change(state).name for state in Stylus] == expected


def test_what_presses_and_what_may_be_limp() -> None:
    ordered = [name for name in STATES[3:] if name != "RELEASED"]
    assert [state.name for state in Stylus if state.presses(None)] == ordered
    assert [state.name for state in Stylus if state.presses(HIGH)] == ordered
    assert [state.name for state in Stylus if state.presses(LOW)] == [*STATES[:2], *ordered]
    assert [state.name for state in Stylus if state.may_be_limp("servo_m3")] == ["LIMP", "LEFT_SEEN", "LEFT_UNSEEN"]
    assert Stylus.lifted("z_axis").name == "AS_READ" and Stylus.lifted("servo_m3").name == "UP"


@pytest.mark.parametrize(
    ("kind", "homed", "lost"),
    [
        ("z_axis", "AS_READ UNDER_WAY", "AS_READ LEFT_SEEN LEFT_UNSEEN"),
        ("servo_m3", "UP LOWERING DOWN RISING LIMP LIMP_DOWN", "AS_READ UP LIMP LEFT_SEEN LEFT_UNSEEN"),
        ("solenoid_m8", "UP LOWERING DOWN RISING RELEASED", "AS_READ UP RELEASED LEFT_SEEN LEFT_UNSEEN"),
    ],
)
def test_the_states_that_each_stylus_can_be_in(kind: str, homed: str, lost: str) -> None:
    """Found by trying everything from the start on; while it homes, one that is not a Z axis is ordered up as well."""
    assert kind in STYLUS_KINDS
    seen = {(False, Stylus.AS_READ)}
    while True:
        after = set(seen)
        for position, stylus in seen:
            after |= {(False, stylus.lost(read).powerless(kind)) for read in (None, HIGH, LOW)}
            after |= {(False, stylus.lost(read)) for read in (None, HIGH, LOW)}
            after |= {(position, stylus.was_reset(kind)), (True, Stylus.lifted(kind))}
            if position:
                after |= {(True, stylus.settled())}
                orders = {Stylus.UNDER_WAY} if kind == "z_axis" else {stylus.ordered(True), stylus.ordered(False)}
                after |= {(True, order) for order in orders}
            elif kind != "z_axis":
                rising = stylus.ordered(False)
                after |= {(False, rising.settled()), (False, rising.lost(None))}
        if after == seen:
            break
        seen = after
    assert {stylus.name for position, stylus in seen if position} == {*homed.split()}
    assert {stylus.name for position, stylus in seen if not position} == {*lost.split()}


def servo(**kwargs: Any) -> Rig:
    """Return a homed machine with a servo that is up."""
    stylus = StylusConfig(kind="servo_m3", dwell_s=0.1)
    return Rig(DriverConfig(enabled_at_start=True, stylus=stylus, **kwargs)).homed()


def homing(rig: Rig) -> Rig:
    """Let the machine home, up to the cycle itself: the servo has been lifted by then."""
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.board.homing_until > 0)
    return rig


def test_a_servo_whose_board_resets_itself_in_a_homing_cycle_is_told_to_be_limp() -> None:
    rig = homing(servo())
    rig.board.homing_until = -1.0
    rig.board.power_cycle()
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-1] == f"unhomed: the board has reset itself and lost its position; {SINKS}"


def test_a_servo_whose_link_is_lost_in_a_homing_cycle_is_told_to_be_limp() -> None:
    rig = homing(servo())
    rig.machine.closed("the device has gone", rig.now)
    rig.board.out.clear()
    rig.connect()
    assert rig.states[-1] == f"unhomed: {SINKS}"


def test_a_stop_while_settings_are_written_tells_that_the_servo_is_limp() -> None:
    rig = servo()
    assert rig.machine.write_settings(rig.now, {12: 0.01}) == ""
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == f"stopped: stop requested; {SINKS}"


def test_a_servo_whose_board_resets_itself_after_settings_were_written_is_told_to_be_limp() -> None:
    rig = servo()
    assert rig.machine.write_settings(rig.now, {12: 0.01}) == ""
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-1] == "unhomed", "it is up, and has its pulses"
    rig.board.reset()
    rig.until(lambda: rig.state == "connecting")
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-1].endswith(SINKS)


def test_a_stop_that_lifts_nothing_tells_that_its_reset_leaves_a_servo_limp() -> None:
    rig = servo(lift_on_stop=False)
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.3)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == f"stopped: stop requested; {SINKS}"


def test_a_servo_that_was_up_is_told_to_be_limp_and_not_to_press_still_after_a_hold_that_did_not_complete() -> None:
    rig = servo()
    rig.board.hold_s = 100.0
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.2)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == f"stopped: stop requested; {SINKS}" and not rig.machine.homed
    assert rig.machine.reset(rig.now) == ""
    rig.step()
    assert rig.states[-1] == f"unhomed: {SINKS}"


def test_a_servo_that_homing_has_lifted_is_not_told_to_be_limp_though_the_place_is_another_one() -> None:
    rig = servo()
    rig.board.alarm(3)
    rig.until(lambda: rig.state == "alarm")
    rig.machine.reset(rig.now)
    rig.until(lambda: rig.state == "unhomed")
    assert rig.states[-1] == f"unhomed: {SINKS}"
    rig.board.homed = (HOMED[0] + 1.0, *HOMED[1:])
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "mismatch")
    assert rig.machine.reset(rig.now) == ""
    rig.step()
    assert rig.states[-1] == "unhomed"


@pytest.mark.parametrize("kind", ["servo_m3", "z_axis"])
def test_settings_that_differ_do_not_hide_a_stylus_that_a_lost_link_has_left(kind: str) -> None:
    rig = Rig(DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind=kind, dwell_s=0.1))).homed()
    order = "M3S800" if kind == "servo_m3" else "Z0G1"
    rig.go((0.3, 0.1, 0.0), (0.3, 0.1, 0.02))
    rig.until(lambda: order in rig.sent())
    assert rig.positions[-1][2] == 0.0
    rig.machine.closed("the device has gone", rig.now)
    rig.board.settings[110] = "500.000"
    rig.connect()
    mismatch = "mismatch: $110 is 500.000; expected 12000 (the configuration)"
    assert rig.states[-1] == f"{mismatch}; {NOT_LIFTED}"
    assert rig.machine.accept_settings(rig.now) == ""
    rig.step()
    assert rig.states[-1] == f"unhomed: {NOT_LIFTED}"


def test_settings_that_differ_do_not_hide_a_servo_that_a_lost_link_has_left_limp() -> None:
    rig = servo()
    rig.machine.closed("the device has gone", rig.now)
    rig.board.settings[110] = "500.000"
    rig.connect()
    assert rig.states[-1] == f"mismatch: $110 is 500.000; expected 12000 (the configuration); {SINKS}"


def test_what_the_driver_says_of_a_stylus_is_known_as_that_wherever_it_stands_in_the_state() -> None:
    rig = servo()
    assert not tells_of_stylus(rig.states[-1])
    rig.board.alarm(3)
    rig.until(lambda: rig.state == "alarm")
    assert tells_of_stylus(rig.states[-1])
    rig.board.settings[110] = "500.000"
    rig.run_for(1.0)
    rig.machine.reset(rig.now)
    rig.until(lambda: rig.state == "mismatch")
    assert rig.states[-1].startswith("mismatch: $110 is 500.000") and tells_of_stylus(rig.states[-1])


def test_an_alarm_after_a_stop_that_did_not_lift_says_so_once() -> None:
    rig = servo()
    rig.board.hold_s = 100.0
    rig.go((0.05, 0.0, 0.0), (0.05, 0.0, 0.02), (0.3, 0.0, 0.02))
    rig.until(lambda: "X-59" in rig.sent())
    rig.run_for(0.2)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == f"stopped: stop requested; {NOT_LIFTED}"
    rig.board.alarm(2)
    rig.until(lambda: rig.state == "alarm")
    assert rig.states[-1] == f"alarm: ALARM:2 (target beyond soft limits), after: stop requested; {NOT_LIFTED}"


def test_a_door_that_is_opened_after_a_stop_leaves_the_servo_limp_until_it_is_closed() -> None:
    """The board ends the pulses while its door is open; the state went on to read as if the stylus were held up."""
    rig = servo()
    rig.go((0.3, 0.0, 0.0))
    rig.run_for(0.3)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == "stopped: stop requested"
    rig.board.state = "Door:1"
    rig.run_for(1.0)
    assert rig.states[-1] == f"stopped: stop requested; {SINKS}" and rig.board.state == "Door:1"
    told = len(rig.states)
    rig.run_for(1.0)
    assert len(rig.states) == told, "once"
    rig.board.received.clear()
    rig.board.state = "Door:0"
    rig.until(lambda: rig.states[-1] == "stopped: stop requested")
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert "M3S200" in rig.board.received and rig.machine.homed


def limp(stylus_m: float) -> Rig:
    """Return a machine at rest whose servo has lost its pulses by a stop that lifts nothing, at that extension."""
    rig = servo(lift_on_stop=False)
    rig.go((0.1, 0.0, 0.0), (0.1, 0.0, stylus_m))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.machine.reset(rig.now) == ""
    rig.run_for(0.3)
    assert rig.state == "idle"
    rig.board.received.clear()
    rig.results.clear()
    return rig


@pytest.mark.parametrize("before_m", [0.0, 0.02])
@pytest.mark.parametrize(
    ("way", "lines"),
    [
        ([(0.1, 0.0, 0.02)], ["M3S800", "$G", "G4P0.1"]),
        ([(0.2, 0.0, 0.02)], ["F9000X-159G53G1", "M3S800", "$G", "G4P0.1"]),
        ([(0.1, 0.0, 0.02), (0.2, 0.0, 0.02)], ["M3S800", "$G", "G4P0.1", "F9000X-159G53G1"]),
        ([(0.2, 0.0, 0.0)], ["F9000X-159G53G1"]),
    ],
)
def test_a_servo_that_may_have_no_pulses_is_ordered_anew_before_it_moves_or_presses(
    before_m: float, way: list[tuple[float, ...]], lines: list[str]
) -> None:
    """It counted as down, so that no M3 was written to lower it: it hung there limp, and was drawn over the panel."""
    rig = limp(before_m)
    assert rig.go(*way).outcome.value == "accepted"
    rig.until(lambda: len(rig.results) == 2)
    assert rig.outcomes()[-1] == "reached" and rig.machine.reading_m is not None
    assert rig.machine.reading_m[2] == way[-1][2]
    told = [text for text in rig.board.received if text not in ("G21G90G94", "G4P0")]
    assert told == ["M3S200", "G4P0.1", *lines]
    assert rig.go((0.1, 0.0, way[-1][2])).outcome.value == "accepted"
    rig.board.received.clear()
    rig.until(lambda: len(rig.results) == 4)
    assert not any("M3" in text for text in rig.board.received), "it has its pulses by now"


def test_a_program_does_not_draw_a_servo_without_pulses_over_the_panel() -> None:
    rig = limp(0.0)
    assert rig.machine.run_program("p", ["G53 G1 X-300 F6000"], rig.now).outcome.value == "accepted"
    rig.until(lambda: len(rig.results) == 2)
    told = [text for text in rig.board.received if "M3" in text or "X" in text]
    assert told == ["M3S200", "F6000X-300G53G1"] and rig.machine.reading_m is not None
    assert rig.machine.reading_m[2] == 0.0


GRBL, GRBLHAL = "Grbl 1.1h ['$' for help]", "GrblHAL 1.1f ['$' or '$HELP' for help]"
FLUIDNC = "Grbl 3.7 [FluidNC v3.7]"


def solenoid_down() -> Rig:
    """Return a homed machine with a solenoid that presses."""
    config = DriverConfig(enabled_at_start=True, stylus=StylusConfig(kind="solenoid_m8", dwell_s=0.2))
    rig = Rig(config)
    rig.board.macros = dict.fromkeys(("$/macros/startup_line0", "$/macros/startup_line1", "$/macros/after_reset"), "")
    rig.homed()
    rig.go((0.1, 0.1, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    return rig


def until_rest(rig: Rig, state: str) -> str:
    """Return the text of that state once it is there."""
    rig.until(lambda: rig.state == state)
    return rig.states[-1]


@pytest.mark.parametrize(
    ("banner", "code", "cut"),
    [(GRBL, 1, True), (GRBLHAL, 1, True), (GRBL, 2, True), (GRBL, 4, False), (FLUIDNC, 1, False)],
)
def test_a_solenoid_is_told_to_be_up_when_the_board_has_cut_its_power_and_it_has_had_its_time(
    banner: str, code: int, cut: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was reported as pressing until it was homed; GRBL and grblHAL switch it off with such an alarm, all at a
    reset."""
    monkeypatch.setattr(protocol_board, "BANNER", f"\r\n{banner}\r\n".encode())
    rig = solenoid_down()
    rig.board.alarm(code)
    assert until_rest(rig, "alarm").endswith(f"; {NOT_LIFTED}")
    rig.run_for(0.15)
    assert rig.states[-1].endswith(f"; {NOT_LIFTED}"), "it takes its time for the way"
    rig.run_for(1.0)
    assert rig.states[-1].endswith(f"; {RELEASED if cut else NOT_LIFTED}")
    assert rig.states[-1].startswith(f"alarm: ALARM:{code} (") and tells_of_stylus(rig.states[-1])
    assert rig.machine.reset(rig.now) == ""
    assert until_rest(rig, "unhomed") == f"unhomed: {RELEASED}"
    assert rig.machine.home(rig.now) == ""
    assert until_rest(rig, "idle") == "idle"
    rig.board.received.clear()
    rig.results.clear()
    rig.go((0.1, 0.1, 0.02))
    rig.until(lambda: len(rig.results) == 2)
    assert "M8" in rig.board.received


def test_a_solenoid_is_told_to_be_up_when_the_board_has_reset_itself_after_its_alarm(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(protocol_board, "BANNER", f"\r\n{FLUIDNC}\r\n".encode())
    rig = solenoid_down()
    rig.board.alarm(3)
    assert until_rest(rig, "alarm").endswith(f"; {NOT_LIFTED}")
    rig.board.reset()
    rig.run_for(0.1)
    assert rig.states[-1] == f"alarm: ALARM:3 (reset while moving, position lost); {RELEASED}"


def test_a_solenoid_is_told_to_be_up_after_a_hold_that_did_not_complete() -> None:
    rig = solenoid_down()
    rig.board.hold_s = 100.0
    rig.go((0.3, 0.1, 0.02))
    rig.run_for(0.5)
    rig.machine.stop("stop requested", rig.now)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert rig.states[-1] == f"stopped: stop requested; {RELEASED}" and not rig.machine.homed


def test_a_stylus_that_an_earlier_driver_left_down_is_told_until_the_machine_is_homed() -> None:
    rig = Rig()
    rig.machine = Machine(DriverConfig(enabled_at_start=True, envelope=NO_PANEL), left_down=True)
    assert rig.machine.may_be_down
    rig.connect()
    assert rig.states[-1] == f"unhomed: {NOT_LIFTED}"
    rig.step()
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")
    assert rig.states[-1] == "idle" and not rig.machine.may_be_down


def test_a_cable_that_is_pulled_in_contact_is_told_after_the_reconnect() -> None:
    rig = Rig().homed()
    rig.go((0.1, 0.1, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.machine.closed("the device has gone", rig.now)
    assert rig.machine.may_be_down
    rig.board.out.clear()
    rig.connect()
    assert rig.states[-1] == f"unhomed: {NOT_LIFTED}"


def test_a_stylus_that_was_left_down_is_believed_up_when_images_show_it_off_the_panel() -> None:
    rig = Rig()
    rig.machine = Machine(DriverConfig(enabled_at_start=True, envelope=NO_PANEL), left_down=True)
    rig.connect()
    rig.machine.seen_clear(0.031, age_s=1.5)
    assert rig.machine.may_be_down, "an image of 1.5 s ago"
    rig.machine.seen_clear(0.031, age_s=0.1)
    rig.step()
    assert rig.states[-1] == "unhomed" and not rig.machine.may_be_down
    assert rig.machine.home(rig.now) == ""
    rig.until(lambda: rig.state == "idle")
    rig.go((0.1, 0.1, 0.02))
    rig.until(lambda: "reached" in rig.outcomes())
    rig.machine.seen_clear(0.031, age_s=0.1)
    assert rig.machine.may_be_down, "its own reports tell, and no image"
