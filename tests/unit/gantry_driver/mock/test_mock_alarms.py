"""Stops, alarms, resets, doors, jogs, homing failures and probing of the mock board, in the order of their bytes."""

from __future__ import annotations

import re

import pytest
from unit.gantry_driver.mock_rig import BANNER, UNLOCK, Rig

from gantry_driver.mock.machine import FaultError
from gantry_driver.mock.mechanics import MechanicsOptions

OK = b"ok\r\n"
RESET_HINT = b"[MSG:Reset to continue]\r\n"


def moving(**arguments) -> Rig:
    """Return a homed board in the middle of a long move at 100 mm/s."""
    rig = Rig.homed(**arguments)
    assert rig.send(b"G1X-100F6000\n", 1.0) == OK
    assert rig.report()[0] == "Run"
    return rig


def test_reset_while_moving_loses_the_position() -> None:
    rig = moving()
    counted = rig.report()[1][0]
    assert rig.send(b"\x18", 0.499) == b"ALARM:3\r\n"
    assert rig.run(0.01) == BANNER + UNLOCK
    state, (x, _, _) = rig.report()
    assert (state, x) == ("Alarm", counted)
    slip = rig.machine.truth()["mpos"][0] - x
    assert 0.04 < slip <= 0.1 + 1 / 80  # the carriage ran on: 100 mm/s for 0.5 to 1 ms
    assert rig.send(b"G0X-300\n", 0.1) == b"error:9\r\n"
    assert rig.send(b"$X\n", 0.1) == b"[MSG:Caution: Unlocked]\r\n" + OK


def test_bytes_sent_during_the_alarm_are_lost_with_the_reset() -> None:
    rig = moving()
    rig.send(b"\x18", 0.1)
    assert rig.send(b"$X\n$H\n", 1.0) == BANNER + UNLOCK
    assert rig.count("bytes_lost_reset") == 6


def test_reset_after_a_complete_hold_keeps_the_position() -> None:
    rig = moving()
    rig.send(b"!", 0.2)
    state, position = rig.report()
    assert state == "Hold:0"
    assert rig.send(b"\x18", 0.1) == BANNER
    assert rig.report() == ("Idle", position)
    assert rig.machine.truth()["mpos"] == pytest.approx(position, abs=0.0006)
    assert rig.run(5.0) == b"" and rig.report()[1] == position  # the rest of the move is gone


def test_reset_during_a_hold_alarms() -> None:
    rig = moving()
    rig.send(b"!", 0.01)
    assert rig.report()[0] == "Hold:1"
    assert rig.send(b"\x18", 1.0) == b"ALARM:3\r\n" + BANNER + UNLOCK


def test_an_aborted_line_still_says_ok_before_the_banner() -> None:
    rig = Rig.homed()
    blocks = b"".join(b"G1X%dF600\n" % (-358 + i) for i in range(16))
    assert rig.send(blocks, 0.0) == OK * 15  # the 16th waits for room
    assert rig.send(b"!", 0.2) == b""
    assert rig.send(b"\x18", 0.1) == OK + BANNER
    assert rig.send(b"G4P5\n", 0.1) == b""
    assert rig.send(b"\x18", 0.1) == OK + BANNER


def test_soft_limit_stops_first_and_is_deaf_for_half_a_second() -> None:
    rig = moving()
    before = rig.report()[1][0]
    assert rig.send(b"G1X1\n", 0.04) == b""
    assert rig.report()[0] == "Hold:1"
    assert rig.run(0.05) == b"ALARM:2\r\n"
    x = rig.machine.truth()["mpos"][0]
    assert x - before == pytest.approx(100.0**2 / 3000.0, abs=0.05)
    assert rig.send(b"?\x18", 0.5) == RESET_HINT  # both swallowed
    assert rig.send(b"?$X\n", 0.5) == b""
    assert rig.send(b"\x18", 0.1) == OK + BANNER + UNLOCK
    state, position = rig.report()
    assert state == "Alarm" and position[0] == pytest.approx(x, abs=0.0006)  # the position is kept
    assert rig.send(b"$X\n", 0.1) == b"[MSG:Caution: Unlocked]\r\n" + OK


def test_hard_limit_halts_at_the_switch() -> None:
    rig = Rig.homed()
    assert rig.send(b"$20=0\n", 0.5) == OK
    assert rig.send(b"G1X-365F1200\n", 1.0) == OK + b"ALARM:1\r\n" + RESET_HINT
    assert b"Pn:X" in rig.send(b"\x18", 0.1) + rig.send(b"?")
    assert -360.05 < rig.machine.truth()["mpos"][0] <= -360.0
    rig.board.power_on(rig.now)
    assert rig.run(0.5) == BANNER + b"[MSG:Check Limits]\r\n" + UNLOCK


@pytest.mark.parametrize("button", ["limit", "stop_button"])
def test_buttons_halt_a_move(button: str) -> None:
    rig = moving()
    rig.machine.inject(button, {"axis": "Y"} if button == "limit" else {})
    here = rig.machine.truth()["mpos"]
    answer = rig.run(1.0)
    if button == "limit":
        assert answer == b"ALARM:1\r\n" + RESET_HINT
        rig.machine.inject("limit", {"axis": "Y", "on": False})
        assert rig.send(b"\x18", 0.1) == BANNER + UNLOCK
    else:
        assert answer == b"ALARM:3\r\n" + BANNER + UNLOCK
        assert b"|Pn:R|" in rig.send(b"?")
    assert rig.machine.truth()["mpos"] == here


def test_without_hard_limits_a_switch_is_only_reported() -> None:
    rig = moving(settings={21: 0})
    rig.machine.inject("limit", {"axis": "X"})
    assert b"|Pn:X" in rig.send(b"?", 0.1)
    assert rig.report()[0] == "Run"


def test_an_axis_stalls_at_its_hard_end() -> None:
    rig = Rig.free()
    assert rig.send(b"G1X-400F12000\n", 5.0) == OK
    assert rig.report()[1][0] == -400.0
    assert rig.machine.truth()["mpos"][0] == -362.0


def test_jog_cancel_flushes_and_keeps_the_position() -> None:
    rig = Rig.homed()
    for target in (-300, -250, -200):
        assert rig.send(b"$J=X%dF6000\n" % target, 0.0) == OK
    rig.run(0.3)
    assert rig.report()[0] == "Jog"
    rig.send(b"\x85", 0.03)
    assert rig.report()[0] == "Jog"
    rig.run(0.1)
    state, position = rig.report()
    assert state == "Idle" and -359 < position[0] < -300
    assert rig.machine.truth()["mpos"] == pytest.approx(position, abs=0.0006)
    assert b"|Bf:15,128|" in rig.send(b"?")
    assert rig.send(b"$J=G91X1F6000\n", 1.0) == OK  # counted from where it stopped
    assert rig.report()[1][0] == pytest.approx(position[0] + 1.0, abs=0.0006 + 1 / 80)


def test_hold_and_door_cancel_a_jog() -> None:
    rig = Rig.homed()
    rig.send(b"$J=X-100F6000\n", 0.3)
    rig.send(b"!", 0.2)
    assert rig.report()[0] == "Idle"
    rig.send(b"$J=X-100F6000\n", 0.3)
    assert rig.send(b"\x84", 0.2) == b"[MSG:Check Door]\r\n"
    assert rig.report()[0] == "Door:0"
    rig.send(b"~", 0.1)
    assert rig.report()[0] == "Idle"


def test_dwell_and_tools_wait_for_the_planner() -> None:
    rig = Rig.free()
    rig.send(b"G1X-10F600\n")
    assert rig.send(b"G4P0.5\n", 0.9) == b""
    assert rig.until(OK, 1.0) == pytest.approx(1.007 + 0.5 - 0.9, abs=0.01)
    rig.send(b"G1X0\nM3S500\n", 0.9)
    assert rig.machine.truth()["spindle"] == 0.0
    rig.run(0.2)
    assert rig.machine.truth()["spindle"] == 500.0
    assert b"|FS:0,500|" in rig.send(b"?")
    rig.send(b"S2000\nM8\n")
    assert rig.machine.truth() == {"mpos": [-180.0, -110.0, -5.0], "spindle": 1000.0, "coolant": True, "state": "Idle"}
    assert b"|A:SF>" in rig.send(b"?") + rig.send(b"?")
    rig.send(b"\x18", 0.1)
    assert rig.machine.truth()["spindle"] == 0.0 and rig.machine.truth()["coolant"] is False


def test_a_dwell_lasts_whole_steps_and_stands_still_in_a_hold() -> None:
    rig = Rig.free()
    rig.board.receive(b"G4P0.01\n", rig.now)
    assert rig.until(OK, 1.0) == pytest.approx(0.05)
    rig.send(b"G4P1\n", 0.5)
    rig.send(b"!", 5.0)
    assert rig.send(b"~", 0.4) == b""
    assert rig.run(0.2) == OK


def test_an_open_door_at_power_up_suspends_the_board() -> None:
    rig = Rig.free()
    rig.machine.mechanics.door_open = True
    rig.board.power_on(rig.now)
    assert rig.run(0.5) == BANNER + b"[MSG:Check Door]\r\n"
    assert rig.send(b"G21\n~", 0.2) == b""
    assert rig.report()[0] == "Door:1"
    rig.machine.inject("door", {"on": False})
    rig.run(0.1)
    assert rig.send(b"~", 0.2) == OK
    assert rig.report()[0] == "Idle"


def test_program_pause_waits_for_resume() -> None:
    rig = Rig.free()
    assert rig.send(b"M0\nG0X-1\n", 1.0) == b""
    assert rig.report()[0] == "Hold:0"
    assert rig.send(b"~", 1.0) == OK + OK
    assert rig.report() == ("Idle", (-1.0, 0.0, 0.0))


def test_door_stops_the_spindle_and_restores_it() -> None:
    rig = Rig.free()
    rig.send(b"M3S800\nG1X-50F600\n", 1.0)
    rig.machine.inject("door", {"on": True})
    assert rig.run(0.0) == b"[MSG:Check Door]\r\n"
    assert rig.report()[0] == "Door:2"
    rig.run(0.1)
    assert rig.report()[0] == "Door:1" and rig.machine.truth()["spindle"] == 0.0
    rig.send(b"~", 0.1)
    assert rig.report()[0] == "Door:1"  # still open
    rig.machine.inject("door", {"on": False})
    rig.run(0.1)
    assert rig.report()[0] == "Door:0"
    assert rig.send(b"~?", 0.06).startswith(b"<Door:3|")  # while it waits, every 50 ms
    assert rig.machine.truth()["spindle"] == 800.0
    rig.run(4.0)
    assert rig.report()[0] == "Run"
    rig.run(10.0)
    assert rig.report() == ("Idle", (-50.0, 0.0, 0.0))


def test_door_that_opens_again_while_the_spindle_is_restored_stops_it_again() -> None:
    rig = Rig.free()
    rig.send(b"M3S800\nG1X-50F600\n", 1.0)
    rig.send(b"\x84", 0.2)
    assert rig.send(b"~?", 0.06).startswith(b"<Door:3|")
    assert rig.machine.truth()["spindle"] == 800.0
    rig.machine.inject("door", {"on": True})
    assert rig.run(0.2) == b"[MSG:Check Door]\r\n"
    assert rig.report()[0] == "Door:1" and rig.machine.truth()["spindle"] == 0.0
    rig.machine.inject("door", {"on": False})
    rig.run(0.1)
    rig.send(b"~", 0.1)
    assert rig.machine.truth()["spindle"] == 800.0
    rig.run(15.0)
    assert rig.report() == ("Idle", (-50.0, 0.0, 0.0))


def test_spindle_stop_acts_only_in_hold() -> None:
    rig = Rig.free()
    rig.send(b"M3S800\n\x9e", 0.1)
    assert rig.machine.truth()["spindle"] == 800.0
    rig.send(b"!\x9e", 0.1)
    assert rig.machine.truth()["spindle"] == 0.0
    rig.send(b"~", 0.1)
    assert rig.machine.truth()["spindle"] == 800.0


def test_homing_leaves_questions_unanswered() -> None:
    rig = Rig()
    assert rig.send(b"$H\n", 0.1) == b""
    seen = b"".join(rig.send(b"?", 0.2) for _ in range(10))
    assert seen == b""
    rest = rig.run(20.0)
    assert re.fullmatch(rb"<Home\|MPos:-359.000,-219.000,-1.000\|[^>]*>\r\nok\r\n", rest)


@pytest.mark.parametrize(
    ("number", "fault", "arguments"),
    [(8, "limit", {"axis": "Z"}), (9, "broken_switch", {"axis": "X"}), (9, "broken_switch", {"axis": "Z"})],
)
def test_homing_failures(number: int, fault: str, arguments: dict[str, str]) -> None:
    rig = Rig()
    rig.machine.inject(fault, arguments)
    answer = rig.send(b"$H\n", 60.0)
    closed = number == 8 or arguments["axis"] == "X"  # Z is held closed; Y has found its switch
    hint = b"[MSG:Check Limits]\r\n" if closed else b""
    assert answer == b"ALARM:%d\r\n" % number + OK + BANNER + hint + UNLOCK
    assert rig.report()[0] == "Alarm"


def test_homing_can_be_reset_and_the_door_stops_it() -> None:
    rig = Rig()
    rig.send(b"$H\n", 1.0)
    assert rig.send(b"\x18", 1.0) == b"ALARM:6\r\n" + OK + BANNER + UNLOCK
    rig.send(b"$H\n", 1.0)
    assert rig.send(b"\x84", 1.0) == b"ALARM:7\r\n" + OK + BANNER + UNLOCK


def test_homing_jitter_is_repeated_by_the_seed() -> None:
    def standing(seed: int) -> list[float]:
        return Rig.homed(seed=seed, mechanics=MechanicsOptions(home_jitter_mm=0.05)).machine.truth()["mpos"]

    assert standing(1) == standing(1) != standing(2)
    assert standing(1) == pytest.approx([-359.0, -219.0, -1.0], abs=0.25)


def test_probing() -> None:
    rig = Rig.homed()
    rig.machine.inject("probe_surface", {"z_mm": -20.0})
    answer = rig.send(b"G38.2Z-40F300\n", 10.0)
    match = re.fullmatch(rb"\[PRB:-359.000,-219.000,(-[\d.]+):1\]\r\nok\r\n", answer)
    assert match and float(match[1]) == pytest.approx(-20.0, abs=0.003)
    assert b"Pn:P" in rig.send(b"?")
    assert rig.send(b"G38.2Z-50F300\n", 1.0) == b"ALARM:4\r\nok\r\n"


def test_lost_steps_move_the_motor_and_not_the_count_until_the_board_homes() -> None:
    rig = Rig.homed()
    rig.machine.inject("lost_steps", {"axis": "Z", "mm": 0.8})
    rig.machine.inject("lost_steps", {"axis": "x", "mm": -1.5})
    assert rig.machine.truth()["mpos"] == pytest.approx([-360.5, -219.0, -0.2])
    assert rig.report()[1] == (-359.0, -219.0, -1.0)
    assert rig.send(b"G53G1Z-11F1800\n", 2.0) == OK
    assert rig.machine.truth()["mpos"][2] == pytest.approx(-10.2), "0.8 mm higher than the board believes"
    assert rig.send(b"$H\n", 60.0) == OK
    assert rig.machine.truth()["mpos"] == pytest.approx([-359.0, -219.0, -1.0], abs=0.01)


@pytest.mark.parametrize(("word", "alarm"), [(b"G38.2", b"ALARM:5\r\n"), (b"G38.3", b"")])
def test_probing_without_contact(word: bytes, alarm: bytes) -> None:
    rig = Rig.homed()
    expected = alarm + b"[PRB:-359.000,-219.000,-5.000:0]\r\n" + OK
    assert rig.send(word + b"Z-5F300\n", 5.0) == expected
    assert rig.report()[0] == ("Alarm" if alarm else "Idle")


def test_idle_delay_stalls_the_main_loop() -> None:
    fast, slow = Rig.free({1: 255}), Rig.free({1: 25})
    for rig in (fast, slow):
        rig.board.receive(b"G1X-1F6000\nG4P0\n", rig.now)
    assert slow.until(OK + OK, 1.0) - fast.until(OK + OK, 1.0) == pytest.approx(0.025, abs=1e-6)


def test_check_mode_knows_the_soft_limits_and_moves_nothing() -> None:
    rig = Rig.homed()
    rig.send(b"$C\n", 0.1)
    assert rig.send(b"G1X-100F1000\nM3S100\nG4P9\n", 0.1) == OK * 3
    assert rig.report() == ("Check", (-359.0, -219.0, -1.0))
    assert rig.machine.truth()["spindle"] == 0.0
    assert rig.send(b"G1X5\n", 1.0) == b"ALARM:2\r\n" + RESET_HINT


def test_brown_out_forgets_the_position_but_the_motors_stay() -> None:
    rig = moving()
    rig.machine.inject("brown_out", {})
    assert rig.run(0.5) == BANNER + UNLOCK
    assert rig.report() == ("Alarm", (0.0, 0.0, 0.0))
    assert -300.0 < rig.machine.truth()["mpos"][0] < -200.0
    assert rig.send(b"$H\n", 60.0) == OK
    assert rig.machine.truth()["mpos"] == pytest.approx([-359.0, -219.0, -1.0])


@pytest.mark.parametrize(
    ("kind", "arguments", "sentence"),
    [
        ("explode", {}, "fault 'explode' is none of"),
        ("alarm", {}, "number = None; expected a whole number"),
        ("alarm", {"number": 0}, "number = 0 is not within 1 to"),
        ("hang", {"seconds": -1}, "seconds = -1 is not within 0 to 3600 s"),
        ("hang", {"seconds": "long"}, "seconds = 'long'; expected a number of seconds"),
        ("answers", {"how": "eaten"}, "how = 'eaten' is none of lost, delayed, split, merged"),
        ("limit", {"axis": "A"}, "axis = 'A' is none of X, Y, Z"),
        ("door", {"on": 1}, "on = 1; expected true or false"),
        ("probe_surface", {"z_mm": "low"}, "z_mm = 'low': a number of mm"),
        ("lost_steps", {"axis": "Z"}, "mm = None: a number of mm"),
        ("lost_steps", {"axis": "Z", "mm": 2e4}, "mm = 20000.0 is not within -10000 to 10000 mm"),
        ("unplug", {"seconds": float("nan")}, "seconds = nan"),
    ],
)
def test_a_fault_that_does_not_fit_is_refused(kind: str, arguments: dict[str, object], sentence: str) -> None:
    rig = Rig.free()
    with pytest.raises(FaultError, match=re.escape(sentence)):
        rig.machine.inject(kind, arguments)
    assert rig.send(b"G21\n", 0.1) == OK


def test_hard_limits_look_from_where_the_motors_are_when_a_block_begins() -> None:
    """Down and back to the pull-off: the way up is shorter than it would be from where the way down began."""
    rig = Rig.homed(settings={21: 1})
    assert rig.send(b"G53G1Z-11F1800\nG53G1Z-1\n", 5.0) == b"ok\r\nok\r\n"
    assert rig.report()[1][2] == -1.0


@pytest.mark.parametrize(("dialect", "pulses"), [("GRBL", 0.0), ("grblHAL", 0.0), ("FluidNC", 800.0)])
def test_an_alarm_ends_the_pulses_of_a_servo_and_a_reset_does_on_each(dialect: str, pulses: float) -> None:
    rig = Rig.homed(dialect=dialect)
    rig.send(b"M3S800\n", 0.5)
    assert rig.machine.mechanics.spindle_rpm == 800.0
    rig.machine.inject("alarm", {"number": 1})
    rig.run(1.0)
    assert rig.machine.mechanics.spindle_rpm == pulses
    rig.send(b"\x18", 0.1)
    assert rig.machine.mechanics.spindle_rpm == 0.0


@pytest.mark.parametrize(("dialect", "pulses"), [("GRBL", 200.0), ("grblHAL", 0.0), ("FluidNC", 200.0)])
def test_only_one_switches_a_servo_off_before_it_homes(dialect: str, pulses: float) -> None:
    rig = Rig(dialect=dialect)
    rig.send(b"$X\nM3S200\n", 0.5)
    rig.send(b"$H\n", 1.0)
    assert rig.machine.mechanics.spindle_rpm == pulses
    rig.run(60.0)
    assert rig.machine.mechanics.spindle_rpm == pulses
