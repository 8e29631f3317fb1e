"""The mock board where GRBL 1.1h itself differs from its documents, or from what one would expect.

Sources: system.c, gcode.c, jog.c, settings.c, report.c, print.c, nuts_bolts.c and spindle_control.c of gnea/grbl. The
compared parts are listed in docs/decisions/mock-board.md.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from unit.gantry_driver.mock_rig import BANNER, FREE, UNLOCK, Rig

REST_S = 3e6
"""After each input, so that the slowest move has ended."""
OK = b"ok\r\n"


def e(number: int) -> bytes:
    return b"error:%d\r\n" % number


SESSIONS = json.loads(Path(__file__).with_name("grbl_core_answers.json").read_text())
"""Answers of GRBL's own core: sessions of inputs, each from power-up; their origin is in
docs/decisions/mock-board.md."""
PINS = re.compile(rb"\|Pn:[XYZ]+")
"""The core had no switches; the mock's are where the axes end."""


@pytest.mark.parametrize("session", SESSIONS, ids=[session["name"] for session in SESSIONS])
def test_each_input_is_answered_as_by_the_core(session: dict[str, Any]) -> None:
    rig = Rig(settings={int(number): value for number, value in session["settings"].items()})
    for sent, expected in session["exchanges"]:
        answer = PINS.sub(b"", rig.send(sent.encode("latin-1"), REST_S)).decode("latin-1")
        assert answer == expected, sent


def test_a_homing_command_with_more_behind_it_leaves_the_board_in_home() -> None:
    """The state is set before the rest of the line is looked at."""
    rig = Rig.homed()
    assert rig.send(b"$HX\n", 0.1) == e(3)
    assert rig.send(b"?").startswith(b"<Home|MPos:-359.000,-219.000,-1.000|")
    assert rig.send(b"$H\n", 0.1) == e(8)
    assert rig.send(b"$10=3\n", 0.1) == e(8)
    assert rig.send(b"$J=X-1F100\n", 0.1) == e(8)
    assert rig.send(b"$C\n", 0.1) == e(8)
    assert rig.send(b"$X\n", 0.1) == OK
    assert rig.send(b"G0X-100\n", 5.0) == OK  # planned, and never begun
    assert rig.send(b"?").startswith(b"<Home|MPos:-359.000,-219.000,-1.000|")
    assert rig.send(b"\x18", 1.0) == b"ALARM:6\r\n" + BANNER + UNLOCK
    assert rig.report()[0] == "Alarm"


def test_a_homing_command_with_more_behind_it_is_refused_first_where_homing_is_off() -> None:
    rig = Rig.free()
    assert rig.send(b"$HX\n", 0.1) == e(5)
    assert rig.report()[0] == "Idle"


@pytest.mark.parametrize("line", [b"$J=F600\n", b"$J=G53F600\n", b"$J=G91F600\n", b"$J=G20F24\n"])
def test_a_jog_without_an_axis_word_goes_to_machine_zero(line: bytes) -> None:
    """The target's fields are cleared at the start of a line and filled only where the line has axis words."""
    rig = Rig.free()
    assert rig.send(b"G0X-10Y-5Z-2\nG92X0\n", 2.0) == OK * 2
    assert rig.send(line, 0.1) == OK
    assert rig.report()[0] == "Jog"
    rig.run(3.0)
    assert rig.report() == ("Idle", (0.0, 0.0, 0.0))


def test_a_startup_line_beyond_the_last_is_accepted_and_runs_never() -> None:
    rig = Rig.free()
    assert rig.send(b"$I=bench\n", 0.5) == OK
    assert rig.send(b"$N2=G20\n", 1.0) == OK
    assert rig.send(b"$N\n", 0.1) == b"$N0=\r\n$N1=\r\n" + OK
    assert b" G20 " in rig.send(b"$G\n")  # carried out at once, as every startup line
    assert rig.send(b"$I\n", 0.5).startswith(b"[VER:1.1h.20190830:]\r\n")  # its place in the EEPROM is this one's
    assert rig.send(b"\x18", 0.1) == BANNER
    assert rig.send(b"$N256=G18\n", 1.0) == OK  # the number is one byte
    assert rig.send(b"$N\n", 0.1) == b"$N0=G18\r\n$N1=\r\n" + OK


def test_a_startup_line_may_be_a_jog() -> None:
    rig = Rig.free()
    assert rig.send(b"$N1=$J=X-1F600\n", 2.0) == OK
    assert rig.report() == ("Idle", (-1.0, 0.0, 0.0))
    assert rig.send(b"$N0=$H\n", 0.5) == e(1)
    assert rig.send(b"\x18", 1.0) == BANNER + b">$J=X-1F600:ok\r\n"


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        (b"$30=1000.5", b"$30=1001"),
        (b"$31=0.5", b"$31=1"),
        (b"$30=2.5", b"$30=3"),
        (b"$27=1.0625", b"$27=1.063"),
        (b"$11=0.0625", b"$11=0.063"),
        (b"$110=1234.5678", b"$110=1234.568"),
    ],
)
def test_halves_are_rounded_up(line: bytes, shown: bytes) -> None:
    rig = Rig.free()
    assert rig.send(line + b"\n", 0.5) == OK
    assert b"\r\n" + shown + b"\r\n" in rig.send(b"$$\n", 0.1)


def test_half_a_thousandth_of_a_position_is_rounded_up() -> None:
    """123.4125 mm is a whole number of 80 steps per mm; Python would print 123.412."""
    rig = Rig.free()
    assert rig.send(b"G0X-123.4125\n", 5.0) == OK
    assert rig.report()[1] == (-123.413, 0.0, 0.0)


def test_a_small_negative_coordinate_keeps_its_sign() -> None:
    rig = Rig.free()
    assert rig.send(b"G92X0.0001\n", 0.1) == OK
    assert b"|WCO:-0.000,0.000,0.000" in rig.send(b"?")


def test_a_change_of_units_brings_the_offset_with_the_next_report() -> None:
    rig = Rig.free()
    assert b"|WCO:" in rig.send(b"?") and b"|WCO:" not in rig.send(b"?")
    assert rig.send(b"$13=1\n", 0.5) == OK
    assert b"|WCO:0.0000,0.0000,0.0000" in rig.send(b"?")
    assert b"|WCO:" not in rig.send(b"?")
    assert rig.send(b"$13=1\n", 0.5) == OK
    assert b"|WCO:" in rig.send(b"?")


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"G257X1", e(23)),  # 1 in one byte, and the rest counts as its decimals
        (b"G300", e(20)),
        (b"G-255X1", e(23)),
        (b"M256", e(23)),
        (b"G533", e(23)),
        (b"G10L258P1X1", OK),
        (b"G10L2P257X1", OK),
        (b"N10000000.9G21", OK),
        (b"G000000001", OK),  # eight digits are read: this is G0
        (b"T255.5", e(38)),
        (b"$256=1", e(3)),
        (b"$255.9=1", e(3)),
        (b"$10.9=3", OK),
    ],
)
def test_numbers_have_the_sizes_that_the_firmware_gives_them(line: bytes, answer: bytes) -> None:
    assert Rig.free().send(line + b"\n", 0.5) == answer


def test_digits_beyond_the_eighth_count_as_zeros() -> None:
    rig = Rig.free()
    assert rig.send(b"G92X-123.4567899\n", 0.1) == OK
    assert rig.send(b"$#\n", 0.1).splitlines()[8] == b"[G92:123.457,0.000,0.000]"
    assert rig.send(b"G92X000000001.5\n", 0.1) == OK
    assert rig.send(b"$#\n", 0.1).splitlines()[8] == b"[G92:0.000,0.000,0.000]"


def test_a_program_s_end_is_reported_by_a_line_that_a_reset_aborts() -> None:
    rig = Rig.free()
    assert rig.send(b"!", 0.1) == b"" and rig.send(b"M30\n", 0.1) == b""
    assert rig.send(b"\x18", 1.0) == BANNER
    assert rig.send(b"G0X-50\n", 0.01) == OK and rig.send(b"!", 1.0) == b""
    rig.send(b"~", 0.01)
    assert rig.send(b"M30\n", 0.01) == b""
    rig.send(b"!", 2.0)
    assert rig.send(b"\x18", 1.0) == b"[MSG:Pgm End]\r\n" + OK + BANNER


def test_a_word_after_a_conflict_is_never_read() -> None:
    rig = Rig.free()
    assert rig.send(b"G0G1X\n") == e(24)
    assert rig.send(b"F1F2#\n") == e(25)


def test_a_closed_door_brings_the_overrides_with_the_next_report() -> None:
    rig = Rig.free()
    for _ in range(3):
        rig.send(b"?")
    assert rig.send(b"\x84", 0.1) == b"[MSG:Check Door]\r\n"
    assert b"|Ov:100,100,100" in rig.send(b"?")


@pytest.mark.parametrize(("line", "answer"), [(b"$J=X0.000001F100\n", e(15)), (b"$J=X-360.00001F100\n", OK)])
def test_soft_limits_are_compared_as_numbers_of_32_bits(line: bytes, answer: bytes) -> None:
    assert Rig.homed().send(line, 0.1) == answer


def test_a_spindle_without_speed_is_off_and_an_empty_range_is_full_speed() -> None:
    rig = Rig.free()
    rig.send(b"?")
    assert rig.send(b"M3S0\n", 0.1) == OK
    assert rig.send(b"?").endswith(b"|Ov:100,100,100>\r\n")
    assert rig.send(b"S500\n", 0.1) == OK
    assert b"|FS:0,500|Ov:100,100,100|A:S>" in rig.send(b"?")
    assert rig.send(b"$31=1000\n", 0.5) == OK
    assert rig.send(b"S0\n", 0.1) == OK
    assert b"|FS:0,1000|" in rig.send(b"?")


def test_coolant_can_be_toggled_while_jogging() -> None:
    rig = Rig.free()
    assert rig.send(b"$J=X-100F600\n", 0.1) == OK
    rig.send(b"\xa0", 0.1)
    assert rig.machine.mechanics.flood


def test_the_probe_comes_first_among_the_pins() -> None:
    rig = Rig(settings=FREE | {21: 0})
    rig.machine.inject("limit", {"axis": "Y"})
    rig.machine.inject("probe_surface", {"z_mm": 10.0})
    assert b"|Pn:PY" in rig.send(b"?")
