"""The mock board against GRBL 1.1's documents, case by case: state before, bytes in, bytes out.

The numbers of errors and alarms are those of doc/csv/error_codes_en_US.csv and alarm_codes_en_US.csv, the texts those
of doc/markdown/interface.md and commands.md of gnea/grbl.
"""

from __future__ import annotations

import re

import pytest
from unit.gantry_driver.mock_rig import BANNER, UNLOCK, Rig

OK = b"ok\r\n"


def e(number: int) -> bytes:
    return b"error:%d\r\n" % number


def prepare(before: str) -> Rig:
    """Bring a board into the state a case starts from."""
    if before == "locked":
        return Rig()
    if before == "homed":
        return Rig.homed()
    rig = Rig.free()
    if before == "run":
        assert rig.send(b"G1X-100F600\n", 0.1) == OK
    elif before == "jog":
        assert rig.send(b"$J=X-100F600\n", 0.1) == OK
    elif before == "check":
        assert rig.send(b"$C\n", 0.1) == b"[MSG:Enabled]\r\n" + OK
    elif before == "hold":
        assert rig.send(b"!", 0.1) == b""
    elif before == "sleep":
        assert rig.send(b"$SLP\n", 0.1) == OK + b"[MSG:Sleeping]\r\n"
    elif before == "fed":
        assert rig.send(b"F100\n", 0.1) == OK
    return rig


CASES: list[tuple[str, bytes, bytes]] = [
    # Lines, comments, blanks, ends of line
    ("idle", b"\n", OK),
    ("idle", b"\r", OK),
    ("idle", b"\r\n", OK + OK),
    ("idle", b"(only a comment)\n", OK),
    ("idle", b"; only a comment\n", OK),
    ("idle", b"g21 (small letters) g90\n", OK),
    ("idle", b"G2 1 ; blanks inside a word\n", OK),
    ("idle", b"/G21\n", OK),
    ("idle", b"G21\xb0\xff\n", OK),
    ("idle", b"G21\tG90\n", OK),
    ("idle", b"N10G21\n", OK),
    ("idle", b"G0" + b" " * 300 + b"\n", OK),
    ("idle", b"G0X" + b"0" * 76 + b"\n", OK),  # 79 characters and the end
    ("idle", b"G0X" + b"0" * 77 + b"\n", e(11)),
    ("idle", b"G21\nG90\nX\nG94\n", OK + OK + e(2) + OK),
    # Real-time bytes never reach the line
    # Words
    ("idle", b"1\n", e(1)),
    ("idle", b"G1X1F100#\n", e(1)),
    ("idle", b"G0X1.2.3\n", e(1)),
    ("idle", b"G\n", e(2)),
    ("idle", b"GX1\n", e(2)),
    ("idle", b"G0X-\n", e(2)),
    ("idle", b"G0X.\n", e(2)),
    ("idle", b"F-1\n", e(4)),
    ("idle", b"S-1\n", e(4)),
    ("idle", b"G4P-1\n", e(4)),
    ("idle", b"G0A1\n", e(20)),
    ("idle", b"G0Q1\n", e(20)),
    ("idle", b"G5\n", e(20)),
    ("idle", b"G64\n", e(20)),
    ("idle", b"G61.1\n", e(20)),
    ("idle", b"G90.1\n", e(20)),
    ("idle", b"G91.1\n", OK),
    ("idle", b"G28.2\n", e(20)),
    ("idle", b"G38.1Z-1F10\n", e(20)),
    ("idle", b"G43Z1\n", e(20)),
    ("idle", b"G41\n", e(20)),
    ("idle", b"M6\n", e(20)),
    ("idle", b"M7\n", e(20)),
    ("idle", b"G10L3P1X1\n", e(20)),
    ("idle", b"G10L2P1X1R1\n", e(20)),
    ("idle", b"G54G55\n", e(21)),
    ("idle", b"G17G18\n", e(21)),
    ("idle", b"G20G21\n", e(21)),
    ("idle", b"G90G91\n", e(21)),
    ("idle", b"G93G94\n", e(21)),
    ("idle", b"M3M5\n", e(21)),
    ("idle", b"M8M9\n", e(21)),
    ("idle", b"M0M2\n", e(21)),
    ("idle", b"G4P1G53\n", e(21)),
    ("idle", b"G1X1\n", e(22)),
    ("idle", b"G1\n", e(22)),
    ("idle", b"G2X1I1\n", e(22)),
    ("fed", b"G93G1X1\n", e(22)),
    ("fed", b"G93G0X-1\n", OK),
    ("idle", b"G1.5X1F100\n", e(23)),
    ("idle", b"G54.1\n", e(23)),
    ("idle", b"M3.5\n", e(23)),
    ("idle", b"G0G1X1\n", e(24)),
    ("idle", b"G28G0X1\n", e(24)),
    ("idle", b"G10G92X1\n", e(24)),
    ("idle", b"G43.1G0Z1\n", e(24)),
    ("idle", b"G0X1X2\n", e(25)),
    ("idle", b"F1F2\n", e(25)),
    ("idle", b"G10L2P1\n", e(26)),
    ("idle", b"G92\n", e(26)),
    ("fed", b"G2I1\n", e(26)),
    ("fed", b"G38.2\n", e(26)),
    ("idle", b"N99999999G21\n", e(27)),
    ("idle", b"G4\n", e(28)),
    ("idle", b"G10X1\n", e(28)),
    ("idle", b"G10L2P7X1\n", e(29)),
    ("fed", b"G53G2X1I1\n", e(30)),
    ("idle", b"G80G53\n", e(30)),
    ("idle", b"G80X1\n", e(31)),
    ("fed", b"G2Z-1I1\n", e(32)),
    ("fed", b"G2X10I1\n", e(33)),
    ("fed", b"G38.2Z0\n", e(33)),
    ("fed", b"G3X0Y0R5\n", e(33)),
    ("fed", b"G2X10R1\n", e(34)),
    ("fed", b"G2X1\n", e(35)),
    ("fed", b"G2X1K1\n", e(35)),
    ("idle", b"G0X-1I1\n", e(36)),
    ("idle", b"G21P1\n", e(36)),
    ("fed", b"G2X10R6I5\n", e(36)),
    ("idle", b"G43.1X1\n", e(37)),
    ("idle", b"G43.1X1Z1\n", e(37)),
    ("idle", b"T256\n", e(38)),
    ("idle", b"T255\n", OK),
    # $ commands
    ("idle", b"$\n", b"[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n" + OK),
    ("idle", b"$G\n", b"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\n" + OK),
    ("idle", b"$I\n", b"[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\n" + OK),
    ("idle", b"$N\n", b"$N0=\r\n$N1=\r\n" + OK),
    ("idle", b"$GG\n", e(3)),
    ("idle", b"$$$#\n", e(3)),
    ("idle", b"$#X\n", e(3)),
    ("idle", b"$Q\n", e(2)),
    ("idle", b"$10\n", e(3)),
    ("idle", b"$10=\n", e(2)),
    ("idle", b"$10=1X\n", e(3)),
    ("idle", b"$33=1\n", e(3)),
    ("idle", b"$140=1\n", e(3)),
    ("idle", b"$110=-5\n", e(4)),
    ("idle", b"$0=2\n", e(6)),
    ("idle", b"$20=1\n", e(10)),
    ("idle", b"$H\n", e(5)),
    ("idle", b"$SLEEP\n", e(3)),
    ("idle", b"$RST=X\n", e(3)),
    ("idle", b"$X\n", OK),
    ("idle", b"$C\n", b"[MSG:Enabled]\r\n" + OK),
    ("idle", b"$SLP\n", OK + b"[MSG:Sleeping]\r\n"),
    ("idle", b"$RST=$\n", b"[MSG:Restoring defaults]\r\n" + OK + BANNER),
    ("idle", b"$J\n", e(3)),
    ("idle", b"$J=X-1\n", e(22)),
    ("idle", b"$J=F100\n", OK),
    ("idle", b"$J=G0X-1F100\n", e(16)),
    ("idle", b"$J=G54X-1F100\n", e(16)),
    ("idle", b"$J=M3X-1F100\n", e(16)),
    ("idle", b"$J=G28X-1F100\n", e(16)),
    ("idle", b"$J=X-1F100S5\n", e(36)),
    ("idle", b"$J=G91G21X-1F100\n", OK),
    ("idle", b"$J=G53X-1F100\n", OK),
    # Program words
    ("idle", b"M2\n", b"[MSG:Pgm End]\r\n" + OK),
    ("idle", b"M30\n", b"[MSG:Pgm End]\r\n" + OK),
    ("idle", b"M1\n", OK),
    ("idle", b"M0\n", b""),  # holds until ~
    ("idle", b"G4P0\n", OK),
    # Alarm: locked after power-up with homing enabled
    ("locked", b"G0X1\n", e(9)),
    ("locked", b"G4P0\n", e(9)),
    ("locked", b"$J=X-1F100\n", e(8)),
    ("locked", b"$C\n", e(8)),
    ("locked", b"$N0=G21\n", e(8)),
    ("locked", b"$G\n", b"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\n" + OK),
    ("locked", b"$10=3\n", OK),
    ("locked", b"$X\n", b"[MSG:Caution: Unlocked]\r\n" + OK),
    ("locked", b"\x18", BANNER + UNLOCK),
    ("locked", b"!", b""),
    ("locked", b"\x84", b""),
    # Idle and real-time bytes
    ("idle", b"\x18", BANNER),
    ("idle", b"\x84", b"[MSG:Check Door]\r\n"),
    ("idle", b"\x85", b""),
    ("idle", b"~", b""),
    # Run
    ("run", b"$$\n", e(8)),
    ("run", b"$#\n", e(8)),
    ("run", b"$I\n", e(8)),
    ("run", b"$10=3\n", e(8)),
    ("run", b"$H\n", e(8)),
    ("run", b"$C\n", e(8)),
    ("run", b"$J=X-1F100\n", e(8)),
    ("run", b"$G\n", b"[GC:G1 G54 G17 G21 G90 G94 M5 M9 T0 F600 S0]\r\n" + OK),
    ("run", b"G0X-1\n", OK),
    # Jog
    ("jog", b"G0X1\n", e(9)),
    ("jog", b"$J=X-5F100\n", OK),
    ("jog", b"$G\n", b"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\n" + OK),
    # Check mode
    ("check", b"G1X1000F100\n", OK),
    ("check", b"G1X1Q1\n", e(20)),
    ("check", b"$J=X-1F100\n", e(8)),
    ("check", b"$#\n", e(8)),
    ("check", b"$C\n", b"[MSG:Disabled]\r\n" + OK + BANNER),
    # Hold and sleep: nothing is acknowledged
    ("hold", b"G0X-1\n$G\n", b""),
    ("hold", b"~", b""),
    ("hold", b"\x18", BANNER),
    ("sleep", b"$X\n$H\n", b""),
    ("sleep", b"\x18", BANNER + UNLOCK),
    # Homed: the limits of the bench
    ("homed", b"$J=X1F100\n", e(15)),
    ("homed", b"$J=G91X-2F100\n", e(15)),
    ("homed", b"$J=Z-60.01F100\n", e(15)),
    ("homed", b"$J=X-360Y-220Z-60F100\n", OK),
    ("homed", b"G0X-360.01\n", b"ALARM:2\r\n[MSG:Reset to continue]\r\n"),
    ("homed", b"G90G28\n", OK),
]  # fmt: skip


@pytest.mark.parametrize(("before", "sent", "expected"), CASES, ids=[f"{b}-{s[:24]!r}" for b, s, _ in CASES])
def test_answer(before: str, sent: bytes, expected: bytes) -> None:
    rig = prepare(before)
    assert rig.send(sent, 0.7) == expected


STATES: list[tuple[str, bytes, str]] = [
    ("locked", b"", "Alarm"),
    ("idle", b"", "Idle"),
    ("run", b"", "Run"),
    ("jog", b"", "Jog"),
    ("check", b"", "Check"),
    ("hold", b"", "Hold:0"),
    ("sleep", b"", "Sleep"),
    ("homed", b"", "Idle"),
    ("run", b"!", "Hold:1"),
    ("idle", b"!", "Hold:0"),
    ("hold", b"~", "Idle"),
    ("hold", b"\x84", "Door:0"),
    ("idle", b"\x84", "Door:0"),
    ("run", b"\x84", "Door:2"),
    ("jog", b"\x85", "Jog"),
    ("jog", b"!", "Jog"),
    ("locked", b"$X\n", "Idle"),
    ("locked", b"!", "Alarm"),
    ("check", b"!", "Check"),
    ("check", b"$C\n", "Idle"),
    ("sleep", b"~", "Sleep"),
    ("sleep", b"\x18", "Alarm"),
]


@pytest.mark.parametrize(("before", "sent", "state"), STATES, ids=[f"{b}-{s!r}" for b, s, _ in STATES])
def test_state(before: str, sent: bytes, state: str) -> None:
    rig = prepare(before)
    rig.send(sent)
    assert rig.report()[0] == state


def test_greeting() -> None:
    assert Rig().greeting == BANNER + UNLOCK
    assert Rig.free().greeting == BANNER


def test_settings_listing() -> None:
    lines = Rig().send(b"$$\n", 0.1).decode().split("\r\n")
    assert lines[-2:] == ["ok", ""]
    assert " ".join(lines[:-2]) == (
        "$0=10 $1=255 $2=0 $3=0 $4=0 $5=0 $6=0 $10=3 $11=0.010 $12=0.002 $13=0 $20=1 $21=1 $22=1 $23=3 $24=300.000 "
        "$25=6000.000 $26=50 $27=1.000 $30=1000 $31=0 $32=0 $100=80.000 $101=80.000 $102=400.000 $110=12000.000 "
        "$111=12000.000 $112=3000.000 $120=1500.000 $121=1500.000 $122=400.000 "
        "$130=360.000 $131=220.000 $132=60.000"
    )


def test_settings_are_stored_over_a_power_cycle() -> None:
    rig = Rig.free()
    assert rig.send(b"$110=1234.5\n", 0.5) == OK
    assert rig.send(b"$10=300\n", 0.5) == OK
    rig.board.power_on(rig.now)
    listing = rig.run(0.5) + rig.send(b"$$\n", 0.1)
    assert b"\r\n$110=1234.500\r\n" in listing
    assert b"\r\n$10=44\r\n" in listing  # one byte is kept
    assert rig.send(b"$22=1\n", 0.5) + rig.send(b"$20=1\n", 0.5) + rig.send(b"$22=0\n", 0.5) == OK * 3
    assert b"$20=0\r\n" in rig.send(b"$$\n", 0.1)  # soft limits go with homing


@pytest.mark.parametrize(
    ("mask", "expected"),
    [
        (0, b"<Idle|WPos:-9.000,0.000,0.000|FS:0,0|WCO:10.000,0.000,0.000>\r\n"),
        (1, b"<Idle|MPos:1.000,0.000,0.000|FS:0,0|WCO:10.000,0.000,0.000>\r\n"),
        (2, b"<Idle|WPos:-9.000,0.000,0.000|Bf:15,128|FS:0,0|WCO:10.000,0.000,0.000>\r\n"),
        (3, b"<Idle|MPos:1.000,0.000,0.000|Bf:15,128|FS:0,0|WCO:10.000,0.000,0.000>\r\n"),
    ],
)
def test_report_mask(mask: int, expected: bytes) -> None:
    rig = Rig.free({10: mask})
    rig.send(b"G0X1\nG10L2P1X10\n", 1.0)
    assert rig.send(b"?") == expected


def test_offsets_and_overrides_come_now_and_then() -> None:
    rig = Rig.free()
    reports = [rig.send(b"?") for _ in range(24)]
    assert [i for i, r in enumerate(reports) if b"|WCO:" in r] == [0, 10, 20]
    assert [i for i, r in enumerate(reports) if b"|Ov:" in r] == [1, 11, 21]
    rig.send(b"G92X1\n", 0.1)
    assert b"|WCO:-1.000,0.000,0.000" in rig.send(b"?")
    rig.send(b"\x91\x93\x96\x9a")
    reports = [rig.send(b"?") for _ in range(2)]
    assert b"|Ov:111,50,110>" in reports[0] + reports[1]


def test_two_questions_at_once_get_one_report() -> None:
    rig = Rig.free(baud=0)
    rig.board.stall(0.01)
    assert rig.send(b"???", 0.02).count(b"<Idle") == 1


def test_real_time_bytes_are_taken_out_of_a_line() -> None:
    rig = Rig.free()
    answer = rig.send(b"$$?$#\n", 0.1)  # becomes $$$#
    assert re.fullmatch(rb"<Idle\|[^>]*>\r\nerror:3\r\n", answer)


def test_parameters() -> None:
    rig = Rig.free()
    sent = b"G10L2P1X1Y2Z3\nG10L20P6X-5\nG0X-2Y-3\nG28.1\nG30.1\nG92Z4\nG43.1Z1.5\n"
    for line in sent.splitlines(keepends=True):
        assert rig.send(line, 2.0) == OK
    assert rig.send(b"$#\n", 0.1).decode().split("\r\n") == [
        "[G54:1.000,2.000,3.000]", "[G55:0.000,0.000,0.000]", "[G56:0.000,0.000,0.000]", "[G57:0.000,0.000,0.000]",
        "[G58:0.000,0.000,0.000]", "[G59:5.000,0.000,0.000]", "[G28:-1.000,-1.000,0.000]", "[G30:-1.000,-1.000,0.000]",
        "[G92:0.000,0.000,-7.000]", "[TLO:1.500]", "[PRB:0.000,0.000,0.000:0]", "ok", "",
    ]  # fmt: skip
    rig.send(b"\x18", 0.1)
    answer = rig.send(b"$#\n", 0.1)
    assert b"[G54:1.000,2.000,3.000]" in answer and b"[G28:-1.000,-1.000,0.000]" in answer  # kept
    assert b"[G92:0.000,0.000,0.000]\r\n[TLO:0.000]" in answer  # not kept


@pytest.mark.parametrize(
    ("dialect", "after_reset", "after_power"),
    [("GRBL", (0.0, 0.0), 0.0), ("FluidNC", (0.0, 0.0), 0.0), ("grblHAL", (-7.0, 1.5), -7.0)],
)
def test_what_a_reset_leaves_of_offsets(dialect: str, after_reset: tuple[float, float], after_power: float) -> None:
    """grblHAL's gc_init clears its state up to the offsets, and loads G92 at power-up; the others clear all."""
    rig = Rig.free(dialect=dialect)
    for line in (b"G0Z-3\n", b"G92Z4\n", b"G55\n", b"G43.1Z1.5\n"):
        assert rig.send(line, 2.0) == OK
    rig.send(b"\x18", 0.1)
    z, tool = after_reset
    answer = rig.send(b"$#\n$G\n", 0.2)
    assert b"[G92:0.000,0.000,%.3f]\r\n[TLO:%.3f]" % (z, tool) in answer and b" G54 " in answer
    assert b"|WCO:0.000,0.000,%.3f" % (z + tool) in rig.send(b"?")
    rig.board.power_on(rig.now)
    rig.run(0.5)
    assert b"[G92:0.000,0.000,%.3f]\r\n[TLO:0.000]" % after_power in rig.send(b"$#\n", 0.2)


def test_modes_are_reported_and_end_with_the_program() -> None:
    rig = Rig.free(mist=True)
    assert rig.send(b"G1F250G55G18G20G91G93M4S500M7T3\nG94\nM8\n", 0.5) == OK * 3
    assert rig.send(b"$G\n") == b"[GC:G1 G55 G18 G20 G91 G94 M4 M7 M8 T0 F0 S500]\r\n" + OK
    assert rig.send(b"M30\n$G\n", 0.1).endswith(b"[GC:G1 G54 G17 G20 G90 G94 M5 M9 T0 F0 S500]\r\n" + OK)


def test_inches() -> None:
    rig = Rig.free({13: 1})
    assert rig.send(b"G20G1X-1F10\n", 0.5) == OK
    rig.run(10.0)
    assert rig.send(b"?").startswith(b"<Idle|MPos:-1.0000,0.0000,0.0000|")
    assert rig.send(b"$G\n") == b"[GC:G1 G54 G17 G20 G90 G94 M5 M9 T0 F10.0 S0]\r\n" + OK
    assert rig.machine.mechanics.mpos_mm()[0] == pytest.approx(-180.0 - 25.4, abs=0.0126)


def test_build_info_and_startup_lines_are_kept() -> None:
    rig = Rig.free()
    assert rig.send(b"$I=bench 1\n", 0.5) == OK
    assert rig.send(b"$N0=G20 G54\n", 1.0) == OK
    assert rig.send(b"$N1=G1X1\n", 1.0) == e(22)  # checked before it is stored
    assert rig.send(b"$N\n", 0.1) == b"$N0=G20G54\r\n$N1=\r\n" + OK
    assert rig.send(b"$I\n", 0.1).startswith(b"[VER:1.1h.20190830:BENCH1]\r\n")
    assert rig.send(b"\x18", 0.1) == BANNER + b">G20G54:ok\r\n"
    assert b" G20 " in rig.send(b"$G\n")
    assert rig.send(b"$RST=*\n", 1.0) == b"[MSG:Restoring defaults]\r\n" + OK + BANNER
    assert rig.send(b"$N\n", 0.1) == b"$N0=\r\n$N1=\r\n" + OK


def test_startup_lines_run_after_homing_and_not_after_unlocking() -> None:
    rig = Rig()
    rig.send(b"$X\n", 0.1)
    assert rig.send(b"$N0=G20\n", 1.0) == OK
    rig.board.power_on(rig.now)
    assert rig.run(0.5) == BANNER + UNLOCK
    assert rig.send(b"$X\n", 0.1) == b"[MSG:Caution: Unlocked]\r\n" + OK
    assert rig.send(b"$H\n", 30.0) == b">G20:ok\r\n" + OK


@pytest.mark.parametrize("line", ["$100=NAN", "$100=INF", "$100=", "$=5"])
def test_only_digits_and_a_point_make_a_number_of_a_setting(line: str) -> None:
    rig = Rig.free()
    before = rig.send(b"$$\n")
    assert rig.send(line.encode() + b"\n", 0.1) == e(2)
    assert rig.send(b"$$\n") == before
