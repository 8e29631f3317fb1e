"""Programs are checked before they are sent: each refusal names line, column and reason; arcs are followed."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gantry_driver.core.program.gcode_check import Bounds, ProgramChecker
from gantry_driver.core.program.gcode_words import GcodeError

BOUNDS = Bounds(low_mm=(-360.0, -220.0, -60.0), high_mm=(0.0, 0.0, 0.0), rapid_mm_min=(12000.0, 12000.0, 3000.0))
START = (-100.0, -100.0, -1.0)
LONG = "G1 G17 G21 G40 M3 M8 N9999999 T255 S9.123456 F9999.123456 X-100.123456 Y-100.123456 Z-9.123456"


def checked(*lines: str, **kwargs: object) -> list[str]:
    checker = ProgramChecker(BOUNDS, START, **kwargs)  # type: ignore[arg-type]
    return [line.text for line in checker.check_all(lines)]


KEPT: dict[str, object] = {"offsets_mm": {"G54": (0.0, 0.0, 20.0)}, "kept_g92": True}


@pytest.mark.parametrize("lines", [["G92.1", "G1 Z-30 F300"], ["G92 X0", "G92.1"]])
def test_an_offset_that_may_be_a_kept_g92_is_not_cancelled(lines: list[str]) -> None:
    """The board went 20 mm deeper than was checked."""
    with pytest.raises(GcodeError) as error:
        checked(*lines, **KEPT)
    assert error.value.line == lines.index("G92.1") + 1
    assert error.value.reason.startswith("G92.1 moves all targets by what of the work offset (0, 0, 20) mm is a G92, ")
    assert error.value.reason.endswith("leave it out, and send it from a terminal before")


def test_an_offset_that_is_no_g92_may_stay_and_one_that_is_none_may_be_cancelled() -> None:
    assert checked("G92.1", "G1 Z-30 F300", offsets_mm=KEPT["offsets_mm"])[0] == "G92.1"
    assert checked("G92.1", "G1 Z-30 F300", kept_g92=True)[0] == "G92.1", "a board without an offset has no G92"
    assert checked("G92 Z0", "G1 Z-1 F300", **KEPT)[0] == "Z0G92", "what it makes of the offset is known"


@pytest.mark.parametrize(
    ("lines", "line", "column", "reason"),
    [
        (["G1 X-10 F"], 1, 9, "F has no number (error:2)"),
        (["G21", "G1 X-10.5.2 F100"], 2, 10, "'.': a letter is expected (error:1)"),
        (["G0 G1 X-10"], 1, 4, "G0 and G1 are both motion (error:21)"),
        (["G20 G21"], 1, 5, "both units"),
        (["G0 G49"], 1, 4, "G0 and G49 both use the axis words (error:24)"),
        (["G1 X-10 X-20 F100"], 1, 9, "X is given twice (error:25)"),
        (["G5 X-1"], 1, 1, "G5 is not supported (error:20)"),
        (["M6 T1"], 1, 1, "M6 is not supported"),
        (["G1 X-10"], 1, 4, "no feed rate (error:22)"),
        (["G93 G1 X-10 F10", "X-20"], 2, 1, "no feed rate"),
        (["G93 G1 X-10 F600", "G94 X-20"], 2, 5, "no feed rate"),
        (["G93 G1 X-10 F600", "M2", "X-20"], 3, 1, "no feed rate"),
        (["G1 F600", "G93", "G94", "X-20"], 4, 1, "no feed rate"),
        (["G1 X-10 F0.0000001"], 1, 4, "no feed rate"),
        (["G1 X-10 F" + "9" * 400], 1, 9, "F has a number that no board can read (error:2)"),
        (["G4 P" + "9" * 400], 1, 4, "P has a number that no board can read (error:2)"),
        (["N10000000 G0 X-10"], 1, 1, "N10000000 is above 9999999 (error:27)"),
        (["G1 X-10 F100 I5"], 1, 14, "I is of no use here (error:36)"),
        (["G0 X-10 P1"], 1, 9, "P is of no use here (error:36)"),
        (["G2 X-90 R6 J1 F100"], 1, 12, "J is of no use here (error:36)"),
        (["G2 X-90 I5 F100", "G92 X0 I5"], 2, 8, "I is of no use here (error:36)"),
        (["L2"], 1, 1, "L is of no use here (error:36)"),
        (["T256"], 1, 1, "T256 is above 255 (error:38)"),
        (["(a comment", "G0"], 1, 1, "the comment has no end"),
        (["", "$100=5"], 2, 1, "system commands are not part of a program"),
        (["G0 X1"], 1, 4, "X = 1.000 mm (machine) is outside -360 to 0 mm (ALARM:2)"),
        (["G0 X0.0009"], 1, 4, "X = 0.001 mm (machine) is outside -360 to 0 mm (ALARM:2)"),
        (["G0 Z-60.00002"], 1, 4, "Z = -60.000020 mm (machine) is outside -60 to 0 mm (ALARM:2)"),
        (["G91", "G0 X-200", "G0 X-70"], 3, 4, "X = -370.000 mm"),
        (["G20", "G0 Y-9"], 2, 4, "Y = -228.600 mm"),
        (["G92 X0", "G0 X101"], 2, 4, "X = 1.000 mm"),
        (["G53 G2 X-1 I1 F10"], 1, 1, "G53 needs G0 or G1"),
        (["G80", "X-1"], 2, 1, "axis words without a motion (error:31)"),
        (["G4"], 1, 1, "G4 needs P"),
        (["G4 P1 X-10"], 1, 7, "G4 takes no axis words: a board would move by them"),
        (["G92.1 Y-10"], 1, 7, "G92.1 takes no axis words"),
        (["G1 F100 X-9", "G49 Z-5"], 2, 5, "G49 takes no axis words"),
        (["G0 X-10 M2"], 1, 4, "M2 takes no axis words"),
        (["G91 G1 F100", "M30 X-10"], 2, 5, "M30 takes no axis words"),
        (["G28"], 1, 1, "G28 goes to a stored place"),
        (["G10 L2 P1 X0"], 1, 1, "writes to the board's memory"),
        (["G38.2 Z-5 F10"], 1, 1, "where the probe touches"),
        (["G55"], 1, 1, "the offset of G55 is not known here"),
        (["G2 X-90 F100"], 1, 4, "an arc needs I, J or R (error:35)"),
        (["G2 X-90 R2 F100"], 1, 9, "radius 2 mm does not span 10 mm (error:34)"),
        (["G2 X-90 Y-100 I4 F100"], 1, 4, "radii differ by 2.000 mm (error:33)"),
        (["G2 Z-5 I1 F100"], 1, 4, "axis word of its plane (error:26)"),
        (["G1 X-10 F-5"], 1, 9, "negative"),
        ([LONG], 1, 80, "bytes with its newline (limits 2 to 80"),
    ],
)
def test_refusals_name_line_column_and_reason(lines: list[str], line: int, column: int, reason: str) -> None:
    with pytest.raises(GcodeError) as caught:
        checked(*lines)
    assert (caught.value.line, caught.value.column) == (line, column)
    assert reason in str(caught.value)


def test_spaces_comments_and_realtime_bytes_do_not_reach_the_board() -> None:
    lines = ["%", "; all of it", "g21 (mm) g90", "/G1 x-50.0000 ?y-60 ! F1200 ; go", "~", "M3S0200\x18\x85", "m30"]
    assert checked(*lines) == ["G21G90", "F1200X-50Y-60G1", "M3S200", "M30"]


@pytest.mark.parametrize(
    ("line", "column", "char"),
    [("G91 G1 X\u221210 F600", 9, "\u2212"), ("G1 X\uff11\uff10 F600", 5, "\uff11"), ("G1 X1\u00b5 F600", 6, "\u00b5")],
)
def test_a_character_that_no_board_reads_is_refused_and_not_left_out(line: str, column: int, char: str) -> None:
    """Without the typographic minus the move would go the other way."""
    with pytest.raises(GcodeError) as caught:
        checked(line)
    assert (caught.value.column, caught.value.reason) == (column, f"{char!r} is no character that a board reads")
    assert checked(f"G4\u00a0P1 ({char}) ; {char}") == ["G4P1"]


def test_a_g53_without_a_move_is_left_out() -> None:
    assert checked("G3 X-90 I5 F100", "G0 G53 F500", "X-80") == ["F100X-90I5G3", "F17234X-80G1"]


def test_modes_stay_and_offsets_are_followed() -> None:
    checker = ProgramChecker(BOUNDS, START, {"G54": (-200.0, -200.0, 0.0)})
    for text in ("G0 X10 Y20", "G91 G1 X5 F100", "Y-1", "G90 G92 X0", "X7"):
        checker.check(text)
    assert checker.position_mm == pytest.approx((-178.0, -181.0, -1.0))


def test_steps_that_add_up_to_the_very_end_of_the_travel_are_inside() -> None:
    checker = ProgramChecker(BOUNDS, START)
    assert len(list(checker.check_all(["G91 F600", *["G1 X0.1 Y-0.1"] * 1000, "G20", "Y-0.787401575"]))) == 1003
    assert checker.position_mm == pytest.approx((0.0, -220.0, -1.0), abs=1e-6)


def test_times_are_those_of_feed_and_rapid() -> None:
    checker = ProgramChecker(BOUNDS, START)
    times = [checker.check(text).seconds for text in ("G0 X-200", "G1 X-190 F600", "G4 P0.5", "G93 G1 X-180 F30")]  # type: ignore[union-attr]
    assert times == pytest.approx([0.5, 1.0, 0.5, 2.0])


@given(
    st.floats(-math.pi, math.pi), st.floats(0.1, 2 * math.pi - 0.1), st.floats(5.0, 60.0), st.booleans(), st.booleans()
)
def test_arcs_are_refused_exactly_when_a_point_of_them_is_outside(
    begin: float, sweep: float, radius: float, clockwise: bool, by_radius: bool
) -> None:
    centre = (-50.0, -100.0)
    sign = -1.0 if clockwise else 1.0
    angles = [begin + sign * k * sweep / 2000 for k in range(2001)]
    points = [(centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in angles]
    furthest = max(x for x, _ in points)
    start, end = points[0], points[-1]
    if abs(furthest) < 0.02 or max(start[0], end[0]) > 0:
        return
    checker = ProgramChecker(BOUNDS, (*start, -1.0))
    if by_radius:
        how = f"R{radius if sweep <= math.pi else -radius:.4f}"
        if abs(sweep - math.pi) < 0.2:
            return
    else:
        how = f"I{centre[0] - start[0]:.4f} J{centre[1] - start[1]:.4f}"
    line = f"G{2 if clockwise else 3} X{end[0]:.4f} Y{end[1]:.4f} {how} F600"
    try:
        result = checker.check(line)
    except GcodeError as error:
        assert furthest > 0 and "outside" in error.reason, line
    else:
        assert furthest < 0 and result is not None, line
        assert result.seconds == pytest.approx(radius * sweep / 10.0, rel=0.02, abs=0.02)


@pytest.mark.parametrize("motion", ["G2", "G3"])
@pytest.mark.parametrize("off", ["-300", "-299.9999999", "-300.0000001"])
def test_an_arc_that_ends_where_it_begins_but_for_rounding_is_a_whole_circle(motion: str, off: str) -> None:
    """GRBL takes less than 5e-7 rad for none; steps of 0.1 mm add up to no whole number of millimetres, either."""
    checker = ProgramChecker(BOUNDS, (-299.7, -150.0, -1.0))
    for text in ("G91 F600", *["G1 X-0.1"] * 3, "G90"):
        checker.check(text)
    circle = checker.check(f"{motion} X{off} Y-150 J20")
    assert circle is not None and circle.seconds == pytest.approx(math.tau * 20.0 / 10.0)
    with pytest.raises(GcodeError, match="outside"):
        checker.check(f"{motion} X{off} Y-150 J100")


@given(st.text(max_size=60))
def test_any_text_is_checked_or_refused_with_a_place(text: str) -> None:
    checker = ProgramChecker(BOUNDS, START)
    try:
        line = checker.check(text)
    except GcodeError as error:
        assert error.line == 1 and 1 <= error.column <= max(len(text), 80)
    else:
        assert line is None or (line.text.isascii() and line.text.isprintable() and not set(line.text) & set("?!~$"))


def test_small_steps_are_sent_as_they_were_checked() -> None:
    """Rounded to four decimals, 400 steps of 0.00005 inch were 0.5 mm longer than what had been checked."""
    lines = checked("G20 G91 F10", *["G1 X-0.00005"] * 400)
    ways = [float(word.group(1)) for line in lines if (word := re.search(r"X(-?[\d.]+)", line))]
    assert len(ways) == 400 and sum(ways) == pytest.approx(-0.02)
