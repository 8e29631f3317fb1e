"""Bytes to messages and lines to bytes: chunking, noise, character counting, EEPROM lines, resets, stray answers."""

from __future__ import annotations

import itertools
import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gantry_driver.core.grbl.grbl_messages import (
    Alarm,
    Banner,
    BuildOptions,
    Dialect,
    ErrorAnswer,
    Feedback,
    Firmware,
    Garbage,
    GrblMessage,
    LineReader,
    OkAnswer,
    SettingValue,
    StatusReport,
    parse_line,
)
from gantry_driver.core.grbl.lines import Acknowledged, CountBroken, GrblLine, LineRefused, StrayAnswer, WasReset
from gantry_driver.core.grbl.session import GrblSession

TRANSCRIPT = (
    b"\r\nGrbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]\r\n[VER:1.1h.20190825:]\r\n[OPT:V,15,128]\r\nok\r\n"
    b"$100=80.000\r\n$110=12000.000 (x max rate, mm/min)\r\nok\r\n"
    b"<Idle|MPos:-359.000,-219.000,-1.000|Bf:15,128|FS:0,0|WCO:0.000,0.000,0.000>\r\n"
    b"ok\r\nerror:22\r\n<Run|WPos:1.000,2.000,3.000|Bf:12,90|FS:500,0|Ov:100,100,100>\r\nALARM:1\r\n"
    b"<Hold:1|MPos:1.000,2.000,3.000|FS:0,0|Pn:XYZ|A:SF>\nok\n"
)


def messages(reader: LineReader, chunks: list[bytes]) -> list[GrblMessage]:
    return [parse_line(line) for chunk in chunks for line in reader.feed(chunk)]


def cut(data: bytes, places: list[int]) -> list[bytes]:
    marks = [0, *sorted(p % (len(data) + 1) for p in places), len(data)]
    return [data[a:b] for a, b in itertools.pairwise(marks)]


@given(st.lists(st.integers(0, 10_000), max_size=60))
def test_any_chunking_gives_the_same_messages(places: list[int]) -> None:
    whole = messages(LineReader(), [TRANSCRIPT])
    assert messages(LineReader(), cut(TRANSCRIPT, places)) == whole
    assert sum(isinstance(m, Garbage) for m in whole) == 0 and len(whole) == 15


@given(st.binary(max_size=400), st.lists(st.integers(0, 10_000), max_size=10))
def test_noise_never_raises_and_chunking_does_not_matter_there_either(noise: bytes, places: list[int]) -> None:
    assert messages(LineReader(), cut(noise, places)) == messages(LineReader(), [noise])


ALPHABET = st.sampled_from(
    [b"ok\r\n", b"error:", b"9\r\n", b"ALARM:", b"<Idle|", b"MPos:", b"1,2,3", b"|Bf:", b">", b"\r\n", b"[OPT:", b"]"]
    + [
        b"Grbl 1.1h ['$' for help]\r\n",
        b"$10",
        b"=",
        b"nan",
        b"inf",
        b"1e999",
        b"-",
        b"\x00\xff",
        b"|",
        b":",
        b"<",
        b",",
    ]
)


@settings(max_examples=300)
@given(st.lists(ALPHABET, max_size=40), st.integers(0, 5))
def test_a_session_survives_every_mixture_of_almost_valid_pieces(pieces: list[bytes], lines: int) -> None:
    session = GrblSession()
    session.start(0.0)
    for k in range(lines):
        session.queue(f"G1X{k}")
    session.output(0.0)
    for k, piece in enumerate(pieces):
        list(session.receive(piece, 0.01 * k))
        assert session.in_flight_bytes >= 0
        session.output(0.01 * k)
    counts = session.counts
    assert counts.acknowledged + counts.refused + counts.lost <= counts.sent <= lines


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (b"ok", OkAnswer()),
        (b"error:9", ErrorAnswer(code=9)),
        (b"ALARM:11", Alarm(code=11)),
        (b"Grbl 1.1h ['$' for help]", Banner(dialect=Dialect.GRBL, version="1.1h")),
        (b"GrblHAL 1.1f ['$' or '$HELP' for help]", Banner(dialect=Dialect.GRBLHAL, version="1.1f")),
        (b"Grbl 3.7 [FluidNC v3.7.8 (wifi) '$' for help]", Banner(dialect=Dialect.FLUIDNC, version="3.7")),
        (b"echo:Marlin 2.1.2", Banner(dialect=Dialect.MARLIN, version="2.1.2")),
        (b"\xfe\x80Grbl 1.1h ['$' for help]", Banner(dialect=Dialect.GRBL, version="1.1h")),
        (b"<Run|MPos:1.0,2.Grbl 1.1h ['$' for help]", Banner(dialect=Dialect.GRBL, version="1.1h")),
        (b"[OPT:VNM,35,1024,3,0]", BuildOptions(rx_bytes=1024, planner_blocks=35)),
        (b"[OPT:PHS]", BuildOptions(rx_bytes=0, planner_blocks=0)),
        (b"[MSG:Reset to continue]", Feedback(key="MSG", text="Reset to continue")),
        (b"$132=60.000", SettingValue(number=132, text="60.000")),
        (b"okok", Garbage(raw=b"okok")),
        (b"ok<Idle|MPos:0,0,0|FS:0,0>", Garbage(raw=b"ok<Idle|MPos:0,0,0|FS:0,0>")),
        (b"<Idle|MPos:0.000,0.0", Garbage(raw=b"<Idle|MPos:0.000,0.0")),
        (b"<Idle|MPos:0,0>", Garbage(raw=b"<Idle|MPos:0,0>")),
        (b"<Run|MPos:-217.088,-83.688,-1.05>", Garbage(raw=b"<Run|MPos:-217.088,-83.688,-1.05>")),
        (b"<Run|MPos:1.000,2.0000,3.000>", Garbage(raw=b"<Run|MPos:1.000,2.0000,3.000>")),
        (
            b"<Run|MPos:1.000,2.000,3.000|WCO:1.000,2.00,3.000>",
            Garbage(raw=b"<Run|MPos:1.000,2.000,3.000|WCO:1.000,2.00,3.000>"),
        ),
        (b"<Idle|MPos:nan,0,0>", Garbage(raw=b"<Idle|MPos:nan,0,0>")),
        (b"<Fast|MPos:0,0,0>", Garbage(raw=b"<Fast|MPos:0,0,0>")),
    ],
)
def test_lines_mean_what_the_documents_say(line: bytes, expected: GrblMessage) -> None:
    assert parse_line(line) == expected


def test_marlin_is_told_by_its_answer() -> None:
    answer = parse_line(b"FIRMWARE_NAME:Marlin 2.1.2 SOURCE_CODE_URL:github.com PROTOCOL_VERSION:1.0")
    assert isinstance(answer, Firmware) and answer.dialect is Dialect.MARLIN


def started(rx: int = 128) -> GrblSession:
    session = GrblSession()
    session.start(0.0)
    session.rx_bytes = rx
    return session


@given(
    st.lists(st.integers(1, 60), min_size=1, max_size=80), st.integers(0, 2**31), st.sampled_from([80, 127, 128, 1024])
)
def test_the_buffer_is_never_overfilled_and_every_line_goes_once_in_order(
    lengths: list[int], seed: int, rx: int
) -> None:
    session, rng = started(rx), random.Random(seed)
    texts = [f"{k:03d}" + "X" * n for k, n in enumerate(lengths)]
    for text in texts:
        session.queue(text)
    buffer, taken, now = b"", [], 0.0
    while session.pending:
        now += 0.001
        buffer += session.output(now)
        assert len(buffer) <= rx
        if rng.random() < 0.7 and b"\n" in buffer:
            line, _, buffer = buffer.partition(b"\n")
            taken.append(line.decode())
            assert isinstance(next(iter(session.receive(b"ok\r\n", now))), Acknowledged)
    assert taken == texts and session.in_flight_bytes == 0
    assert session.counts.sent == session.counts.acknowledged == len(texts)


def test_a_line_longer_than_the_told_buffer_goes_alone() -> None:
    """Noise has made 18 of 128: no line would ever leave, not even one that lifts the stylus."""
    session = started(18)
    session.queue("G21G90G94X100Y200")
    session.queue("X101G53G1")
    assert session.output(0.0) == b"G21G90G94X100Y200\n"
    list(session.receive(b"ok\r\n", 0.1))
    assert session.output(0.1) == b"X101G53G1\n"


def test_no_more_than_the_reported_room_is_filled_though_more_was_told() -> None:
    """Noise has made 1280 of 128."""
    session = started(1280)
    list(session.receive(b"<Idle|MPos:0,0,0|Bf:15,128|FS:0,0>\r\n", 0.0))
    for number in range(100):
        session.queue(f"X{number}.123G1")
    session.output(0.01)
    assert 90 < session.in_flight_bytes <= 128


def test_what_noise_made_of_the_room_ends_with_the_next_banner() -> None:
    session = started()
    list(session.receive(b"<Idle|MPos:0,0,0|Bf:15,928|FS:0,0>\r\n", 0.0))
    list(session.receive(b"\r\nGrbl 1.1h ['$' for help]\r\n", 0.1))
    session.queue("X1G1")
    session.output(0.2)
    told = list(session.receive(b"<Idle|MPos:0,0,0|Bf:15,128|FS:0,0>\r\n", 0.3))
    assert [type(m) for m in told] == [StatusReport], "no contradiction with a report of before the reset"


@pytest.mark.parametrize(
    "text", ["$100=250.000", "$N0=G21", "$RST=$", "$I=mill", "G10L2P1X0", "G10 L20 P1 X0", "G28.1", "G30.1"]
)
def test_eeprom_lines_go_alone_and_the_board_gets_fifty_milliseconds_after_them(text: str) -> None:
    session = started()
    session.polling = True
    for line in ("G1X1", text, "G1X2"):
        session.queue(line)
    assert session.output(0.0) == b"?G1X1\n"
    assert session.output(0.2) == b"?"
    list(session.receive(b"ok\r\n", 0.3))
    assert session.output(0.32) == b"?" + text.encode() + b"\n"
    assert session.output(0.5) == b"", "no byte at all while the EEPROM is written"
    list(session.receive(b"ok\r\n", 1.0))
    assert session.output(1.049) == b""
    assert session.output(1.051) == b"?G1X2\n"


@pytest.mark.parametrize("text", ["G1X10", "$J=G91X1F100", "G4P0", "G28", "G30", "G10.5"])
def test_other_lines_are_not_taken_for_eeprom_lines(text: str) -> None:
    assert not GrblLine.of(1, text, 1.0).eeprom


@pytest.mark.parametrize(
    "text",
    [
        "F100",
        "F100X5G53G1",
        "G1X5F100",
        "G1X5",
        "X5",
        "X5G0",
        "X5G10",
        "Z5G21",
        "M3S800",
        "M08",
        "G28",
        "G30",
        "$H",
        "$J=X1F9",
    ],
)
def test_what_a_board_would_obey_after_a_reset_is_sent_alone(text: str) -> None:
    session = started()
    for line in ("G4P0", text, "X2G1"):
        session.queue(line)
    assert session.output(0.0) == b"G4P0\n"
    list(session.receive(b"ok\r\n", 0.1))
    assert session.output(0.1) == text.encode() + b"\n"
    assert session.output(0.2) == b""
    list(session.receive(b"ok\r\n", 0.3))
    assert session.output(0.3) == b"X2G1\n"


@pytest.mark.parametrize("text", ["X5G53G1", "X5Y-2.5I1G02", "X0G92", "G4P0.25", "G21G90G94", "M5", "M9", "M30"])
def test_what_a_board_would_refuse_or_do_nothing_for_after_a_reset_is_streamed(text: str) -> None:
    session = started()
    session.queue("X1G1")
    session.queue(text)
    session.queue("X2G1")
    assert session.output(0.0) == b"X1G1\n" + text.encode() + b"\nX2G1\n"


@pytest.mark.parametrize("text", ["", "X" * 80, "G1X1\nG1X2", "G1?", "G1!", "G1~", "G1\x18", "G1\x85", "é"])
def test_what_cannot_be_one_line_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="line"):
        started().queue(text)


def test_a_reset_loses_what_was_under_way_and_says_so() -> None:
    session = started()
    for k in range(60):
        session.queue(f"G1X{k:03d}Y100F1000")
    session.output(0.0)
    under_way = session.counts.sent
    event = next(iter(session.receive(b"\r\nGrbl 1.1h ['$' for help]\r\n", 0.1)))
    assert isinstance(event, WasReset) and not event.expected
    assert len(event.lost) == under_way == session.counts.lost and len(event.unsent) == 60 - under_way
    assert session.pending == 0 and session.in_flight_bytes == 0


def test_no_line_and_no_answer_counts_between_a_reset_and_its_banner() -> None:
    session = started()
    session.queue("G1X1")
    session.output(0.0)
    session.soft_reset(0.1)
    session.queue("G1X2")
    assert session.output(0.1) == b"\x18"
    assert isinstance(next(iter(session.receive(b"ok\r\n", 0.11))), StrayAnswer)
    assert session.output(0.5) == b"" and session.output(1.2) == b"\x18", "a swallowed reset is repeated"
    event = next(iter(session.receive(b"Grbl 1.1h ['$' for help]\r\n", 1.3)))
    assert isinstance(event, WasReset) and event.expected


def test_a_stray_ok_is_caught_by_the_boards_own_count() -> None:
    session = started()
    session.queue("X1G1")
    session.queue("X22G1")
    session.output(0.0)
    idle = b"<Idle|MPos:0,0,0|Bf:15,128|FS:0,0>\r\n"
    assert [type(m) for m in session.receive(idle * 2, 0.01)] == [StatusReport, StatusReport]
    stray = list(session.receive(b"ok\r\nok\r\n<Run|MPos:0,0,0|Bf:14,118|FS:0,0>\r\n", 0.02))
    assert [type(m) for m in stray] == [Acknowledged, Acknowledged, StatusReport], "this report may be damaged"
    again = list(session.receive(b"<Run|MPos:0,0,0|Bf:14,118|FS:0,0>\r\n", 0.12))
    assert [type(m) for m in again] == [StatusReport, CountBroken]


@pytest.mark.parametrize("damaged", [b"Bf:14,528", b"Bf:14,028", b"Bf:14,1160", b"Bf:94,128", b"Bf:04,128"])
def test_one_damaged_count_of_the_buffers_is_no_contradiction(damaged: bytes) -> None:
    session = started()
    report = b"<Run|MPos:0,0,0|Bf:14,128|FS:0,0>\r\n"
    list(session.receive(report * 2, 0.01))
    session.queue("X1G1")
    session.output(0.02)
    busy = report.replace(b"128", b"123")
    told = [*session.receive(busy.replace(b"Bf:14,123", damaged), 0.03), *session.receive(busy * 5, 0.05)]
    assert [type(m) for m in told] == [StatusReport] * 6
    assert session.counts.executed == 0
    assert [type(m) for m in session.receive(b"ok\r\n" + report * 3, 0.4)] == [Acknowledged] + [StatusReport] * 3


@pytest.mark.parametrize(("line", "after"), [("X1G1", 2), ("G4P3", 30)])
def test_a_missing_answer_is_noticed_only_while_the_board_is_idle(line: str, after: int) -> None:
    """A dwell may last; any other line has been answered by a board that rests."""
    session = started()
    session.queue(line, answer_within_s=3.0)
    session.output(0.0)
    hold, idle = b"<Hold:0|MPos:0,0,0|FS:0,0>\r\n", b"<Idle|MPos:0,0,0|FS:0,0>\r\n"
    for k in range(1000):
        assert [type(m) for m in session.receive(hold, 0.1 * k)] == [StatusReport]
    late = [type(m) for k in range(40) for m in session.receive(idle, 100.0 + 0.1 * k)]
    assert after <= late.index(CountBroken) <= after + 2


def test_work_positions_become_machine_positions_with_the_last_offset() -> None:
    session = started()
    list(session.receive(b"<Idle|MPos:1,2,3|WCO:10.000,20.000,30.000>\r\n", 0.0))
    report = next(iter(session.receive(b"<Idle|WPos:1.000,2.000,3.000|FS:0,0>\r\n", 0.1)))
    assert isinstance(report, StatusReport) and report.mpos_mm == (11.0, 22.0, 33.0)


def test_a_work_position_whose_offset_has_not_been_told_is_no_position() -> None:
    session = started()
    for _ in range(2):
        report = next(iter(session.receive(b"<Idle|WPos:1.000,2.000,3.000|FS:0,0>\r\n", 0.0)))
        assert isinstance(report, StatusReport) and report.mpos_mm is None and session.wco_mm is None
        report = next(iter(session.receive(b"<Idle|WPos:1.000,2.000,3.000|WCO:-1.000,0.000,1.000>\r\n", 0.1)))
        assert isinstance(report, StatusReport) and report.mpos_mm == (0.0, 2.0, 4.0)
        list(session.receive(b"Grbl 1.1h ['$' for help]\r\n", 0.2))  # G92 may have gone with the reset


def test_errors_belong_to_their_lines() -> None:
    session = started()
    first, second = session.queue("X1G1"), session.queue("G77")
    session.output(0.0)
    assert list(session.receive(b"ok\r\nerror:20\r\n", 0.1)) == [
        Acknowledged(line=first),
        LineRefused(line=second, code=20),
    ]


def test_executed_follows_the_planner_and_never_overtakes() -> None:
    session = started()
    for k in range(5):
        session.queue(f"X{k}G1")
    session.output(0.0)
    list(session.receive(b"<Idle|MPos:0,0,0|Bf:15,128|FS:0,0>\r\n" + b"ok\r\n" * 5, 0.1))
    list(session.receive(b"<Run|MPos:0,0,0|Bf:12,128|FS:0,0>\r\n", 0.2))
    assert (session.counts.sent, session.counts.acknowledged, session.counts.executed) == (5, 5, 2)
    session.executed_all()
    assert session.counts.executed == 5


def test_executed_follows_a_board_that_does_not_report_its_planner() -> None:
    """As $10=1 has it, GRBL's default: a program's progress stayed at nothing until its end."""
    session = GrblSession()
    list(session.receive(b"[OPT:V,15,128]\r\n", 0.0))
    for number in range(20):
        session.queue(f"G1X-{number}")
        session.output(0.0)
        list(session.receive(b"ok\r\n", 0.0))
    list(session.receive(b"<Run|MPos:0,0,0|FS:0,0>\r\n", 0.0))
    assert (session.counts.acknowledged, session.counts.executed) == (20, 5)


def test_nothing_is_due_while_lines_wait_for_room() -> None:
    session = GrblSession()
    for number in range(40):
        session.queue(f"X{number}.123G1")
    session.polling = True
    session.output(1.0)
    assert session.pending == 40 and session.in_flight_bytes > 90
    assert session.deadline(1.0) == pytest.approx(1.0 + session.poll_interval_s), "waiting is for the next report"


def test_nothing_is_due_while_the_board_writes_its_memory() -> None:
    session = GrblSession()
    session.polling = True
    session.queue("$110=500")
    session.queue("G1X1")
    assert session.output(1.0).endswith(b"$110=500\n")
    assert session.deadline(5.0) == math.inf and session.output(5.0) == b""


def test_room_for_two_lines_stays_until_the_wire_is_the_limit() -> None:
    session = GrblSession()
    for _ in range(60):
        session.queue("X-100G53G1")
    sent = session.output(0.0).count(b"\n")
    assert (sent + 2) * 11 < 128 <= (sent + 3) * 11
    for _ in range(3):
        assert session.output(0.0) == b""
        list(session.receive(b"<Run|MPos:0,0,0|Bf:9,110|FS:0,0>\r\n", 0.1))
    assert session.output(0.1).count(b"\n") == 2, "the motion is not the limit: the whole buffer is used"
    list(session.receive(b"<Run|MPos:0,0,0|Bf:0,10|FS:0,0>\r\n" + b"ok\r\n" * 2, 0.2))
    assert session.output(0.2) == b"", "the planner is full: room is left again"


def test_a_line_that_must_go_alone_does_not_make_the_wire_the_limit() -> None:
    """While M3 waits for the motion the planner runs empty, and nothing is known of the wire: room is left."""
    session = GrblSession()
    for text in ("M3S800", "G4P0.25", *["X-10Y-20G53G1"] * 12):
        session.queue(text)
    assert session.output(0.0) == b"M3S800\n"
    for k in range(5):
        list(session.receive(b"<Run|MPos:0.000,0.000,0.000|Bf:14,121|FS:0,0>\r\n", 0.04 * k))
        assert session.output(0.04 * k) == b""
    for now in (0.3, 0.31):  # answers to nothing: the board still has M3 and then G4 in its buffer
        list(session.receive(b"ok\r\n", now))
        session.output(now)
    assert len(b"M3S800\nG4P0.25\n") + session.in_flight_bytes <= 128


def test_a_late_report_counts_as_asked_for_by_the_first_question_though_later_ones_were_repeated() -> None:
    """Counted from a later question, the board would seem to have moved farther than it can."""
    session = started()
    session.poll_interval_s, session.sets_feed_back = 0.04, True
    session.polling = True
    session.poll_now()
    session.output(10.0)
    list(session.receive(b"<Run|MPos:0.000,0.000,0.000|FS:500,0>\r\n", 10.01))
    asked = [session.output(at).count(b"?") for at in (10.05, 10.1, 10.15)]
    assert asked == [1, 2, 2]
    list(session.receive(b"<Run|MPos:1.000,0.000,0.000|FS:500,0>\r\n", 10.16))
    assert session.report_asked_at == 10.05


def test_a_question_that_was_lost_at_rest_repeats_none_in_motion_and_makes_no_report_older() -> None:
    """A board that starts, or merges two questions, answers one report fewer for the rest of the connection."""
    session = started()
    session.polling, session.poll_interval_s = True, 0.1
    assert session.output(1.0) == b"?", "it gets lost"
    for step in range(1, 4):
        now = 1.0 + 0.101 * step
        assert session.output(now) == b"?"
        list(session.receive(b"<Idle|MPos:0,0,0|FS:0,0>\r\n", now + 0.005))
        assert session.report_asked_at == pytest.approx(now)
    session.poll_interval_s, session.sets_feed_back = 0.02, True
    session.poll_now()
    for step in range(5):
        now = 1.4 + 0.021 * step
        assert session.output(now) == b"?"
        list(session.receive(b"<Run|MPos:0,0,0|FS:0,0>\r\n", now + 0.005))
        assert session.report_asked_at == pytest.approx(now)


def test_the_first_report_after_a_silence_counts_as_asked_for_by_the_first_request_that_was_dropped() -> None:
    """A busy computer delivers a report late, after more requests than the driver keeps."""
    session = started()
    session.polling, session.poll_interval_s, session.sets_feed_back = True, 0.05, True
    session.poll_now()
    assert session.output(10.0) == b"?"
    list(session.receive(b"<Run|MPos:0.000,0.000,0.000|FS:500,0>\r\n", 10.01))
    for step in range(1, 9):
        assert b"?" in session.output(10.0 + 0.051 * step)
    list(session.receive(b"<Run|MPos:1.000,0.000,0.000|FS:500,0>\r\n", 10.5))
    assert session.report_asked_at == pytest.approx(10.051)
    list(session.receive(b"<Run|MPos:60.000,0.000,0.000|FS:500,0>\r\n", 10.501))
    assert session.report_asked_at > 10.2, "the next one answers a request that was kept"
