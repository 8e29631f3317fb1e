"""Whatever a host sends, the mock board goes on: no line ends it, each gets one answer, and time goes by."""

from __future__ import annotations

import re

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from unit.gantry_driver.mock_rig import FREE, Rig

from gantry_driver.mock.settings import BENCH

OK = b"ok\r\n"
ANSWER = re.compile(rb"(?:^|\r\n)(?:ok|error:\d+)(?=\r\n)")
LONG_S = 1e100
"""Longer than the slowest move that numbers of 32 bits can ask for."""

NINES = "9" * 60
NUMBERS = st.one_of(
    st.sampled_from(["0", "-0", "1", "-1", "3", "255", "256", "65536", "0.000001", ".5", "1.", "80X", "", NINES]),
    st.sampled_from([f"-{NINES}", f".{'0' * 50}1", "1E9", "NAN", "INF", "1.2.3"]),
    st.decimals(-1000, 1000, places=3).map(str),
)
SETTINGS = st.tuples(st.sampled_from([*BENCH, 33, 140, 255, 256, 999]), NUMBERS).map(lambda s: f"${s[0]}={s[1]}")
WORDS = st.tuples(st.sampled_from("FGIJKLMNPRSTXYZA"), NUMBERS).map("".join)
COMMANDS = st.sampled_from(
    ["G0", "G1", "G2", "G3", "G4", "G10L2", "G10L20", "G17", "G18", "G19", "G20", "G21", "G28", "G28.1", "G38.2"]
    + ["G43.1", "G49", "G53", "G54", "G59", "G80", "G90", "G91", "G92", "G93", "G94", "M2", "M3", "M5", "M8", ""]
)
MOVES = st.tuples(COMMANDS, st.lists(WORDS, max_size=5)).map(lambda m: m[0] + "".join(m[1]))
OTHERS = st.sampled_from(
    ["", "$", "$$", "$#", "$G", "$N", "$I", "$H", "$X", "$C", "$RST=#", "$N0=G20", "$I=a", "$J=X-1F9"]
)
NOISE = st.text(st.characters(min_codepoint=0x21, max_codepoint=0x7F, exclude_characters="?!~"), max_size=90)
LINES = st.one_of(SETTINGS, SETTINGS, MOVES, MOVES, OTHERS, NOISE).filter(lambda text: text != "$SLP")


def answered(rig: Rig, line: str) -> list[bytes]:
    """Send a line, let all the time pass that it can take, and return its answers."""
    out = rig.send(line.encode() + b"\n", 0.0)
    while not ANSWER.search(out):
        due = rig.board.next_due()
        if due is None or due > LONG_S:
            break
        rig.board.advance(max(due, rig.now))
        out += b"".join(rig.board.take_output())
        if rig.board.state_text().startswith("Hold"):
            out += rig.send(b"~")  # M0
    return ANSWER.findall(out)


@given(lines=st.lists(LINES, min_size=1, max_size=25), homing=st.booleans())
@example(lines=["$100=0", "$$", "G0X-1", "?"], homing=False)
@example(lines=["$100=0", "$H"], homing=True)
@example(lines=["$120=0", "G0X-1", "G4P0"], homing=False)
@example(lines=["$110=0", "G0X-1", "G4P0"], homing=False)
@example(lines=[f"${number}={NINES}" for number in BENCH], homing=False)
@example(lines=[f"$130={NINES}", f"$100={NINES}", "$H", "$#"], homing=True)
@example(lines=[f"G10L2P1X{NINES}", f"G92X{NINES}", f"G10L20P1X-{NINES}", "$#"], homing=False)
@example(lines=["$C", f"G2X0I{NINES}F1"], homing=False)
@example(lines=["$12=0", "$C", f"G2X0I{NINES}F1"], homing=False)
@example(lines=[f"G4P{NINES}"], homing=False)
@example(lines=["G1X-1F1", "$13=256"], homing=False)
@settings(max_examples=150)
def test_each_line_gets_one_answer(lines: list[str], homing: bool) -> None:
    rig = Rig(settings={} if homing else FREE)
    rig.send(b"$X\n")
    for line in lines:
        if rig.board.state_text() == "Alarm":
            rig.send(b"\x18", 2.0)
            rig.send(b"$X\n", 1.0)
        answers = answered(rig, line)
        if rig.board.journal.counts["alarms"]:
            return  # what is on the line then is thrown away
        assert len(answers) == 1, f"{line!r}: {answers!r}"
        assert rig.send(b"?", 1e-3) or rig.board.state_text() in ("Home", "Sleep")


@given(data=st.binary(max_size=400), pauses=st.integers(0, 5))
@settings(max_examples=150)
def test_no_bytes_end_the_board(data: bytes, pauses: int) -> None:
    rig = Rig(baud=115200, line_s=0.0005)
    for part in data.split(b"\n"):
        rig.send(part + b"\n", 0.2 * pauses)
    rig.run(3.0)
    rig.board.power_on(rig.now)
    assert b"Grbl 1.1h" in rig.run(1.0)


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("$100=80X", "error:3"),
        ("$10=1X", "error:3"),
        ("$1_0=3", "error:3"),
        ("$100=1E2", "error:3"),
        ("$300=-1", "error:3"),
        ("$999=1", "error:3"),
        ("$99=-1", "error:4"),
        ("$100=-0.001", "error:4"),
        ("$0=2.9", "error:6"),
        ("$0=258", "error:6"),
        ("$20=256", "ok"),
    ],
)
def test_a_setting_is_read_as_the_firmware_reads_it(line: str, answer: str) -> None:
    """system.c reads a number, a '=', a number, and wants the end there; settings.c keeps whole numbers in a byte."""
    rig = Rig.free()
    before = rig.send(b"$$\n")
    assert rig.send(line.encode() + b"\n", 1.0) == answer.encode() + b"\r\n"
    assert rig.send(b"$$\n") == before


@pytest.mark.parametrize(("number", "sent", "kept"), [(26, "300", "44"), (1, "256", "0"), (13, "256", "0")])
def test_whole_numbers_are_kept_in_a_byte(number: int, sent: str, kept: str) -> None:
    rig = Rig.free()
    assert rig.send(f"${number}={sent}\n".encode(), 1.0) == OK
    assert f"${number}={kept}\r\n".encode() in rig.send(b"$$\n")


@pytest.mark.parametrize("line", ["$100=0", "$120=0", "$110=0"])
def test_an_axis_without_a_scale_or_a_speed_hardly_moves_and_a_reset_ends_it(line: str) -> None:
    rig = Rig.free()
    assert rig.send(line.encode() + b"\n", 1.0) == OK
    assert rig.send(b"G1X-100F6000\n", 10.0) == OK
    assert abs(rig.machine.mechanics.mpos_mm()[0] + 180.0) < 0.2
    rig.send(b"!", 1.0)
    assert b"Grbl 1.1h" in rig.send(b"\x18", 1.0)
    assert rig.send(b"G4P0\n", 1.0).endswith(OK) or rig.report()[0] == "Alarm"
