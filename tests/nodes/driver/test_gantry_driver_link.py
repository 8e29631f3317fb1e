"""The serial link against mock_grbl and a bare pseudo-terminal: goals, stop latency, unplugging, the exclusive port."""

from __future__ import annotations

import dataclasses
import os
import pty
import re
import select
import statistics
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from nodes.grbl_board import PATIENT, AwakeClock, GrblBoard, LinkRig

from gantry_driver.adapters import serial_link
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.machine.machine import Machine

pytestmark = pytest.mark.long

HOMED = (-359.0, -219.0, -1.0)
Start = Callable[..., tuple[GrblBoard, LinkRig]]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start a board and a link; both are closed in the end."""
    made: list[GrblBoard | LinkRig] = []

    def make(*arguments: str, config: DriverConfig | None = None) -> tuple[GrblBoard, LinkRig]:
        # Near its home: how long the way there takes matters to no test.
        board = GrblBoard(tmp_path, "--start=-350,-210,-2", *arguments)
        made.append(board)
        rig = LinkRig(board.port, config)
        made.append(rig)
        return board, rig

    yield make
    for thing in reversed(made):
        thing.close()


def test_a_path_is_executed_line_by_line_and_ends_where_it_should(start: Start) -> None:
    board, rig = start()
    rig.home()
    before = board.log()[-1]["n"]
    assert rig.go((0.1, 0.05, 0.0), (0.1, 0.05, 0.01), (0.1, 0.05, 0.0)).outcome.value == "accepted"
    rig.until(lambda: len(rig.results) == 2)
    assert rig.outcomes() == ["accepted", "reached"], rig.results
    assert rig.results[-1].error_m < 2e-5
    texts = [line["text"] for line in board.lines(before)]
    assert texts == [
        *("G21G90G94", "F9000X-259Y-169G53G1", "F1800G21G90G94X201Y151Z10G92", "$G"),
        *("Z0G1", "Z10G1", "G92.1", "G4P0"),
    ]
    assert board.mpos() == pytest.approx((HOMED[0] + 100, HOMED[1] + 50, HOMED[2]), abs=0.02)
    assert rig.machine.counts.sent == rig.machine.counts.acknowledged == rig.machine.counts.executed


def test_a_long_path_fills_the_buffer_and_loses_no_byte(start: Start) -> None:
    board, rig = start()
    rig.home()
    before = board.log()[-1]["n"]
    points = [(0.0005 * k, 0.0003 * (k % 50), 0.0) for k in range(1, 301)]
    rig.go(*points)
    rig.until(lambda: len(rig.results) == 2, 60.0)
    assert rig.outcomes()[-1] == "reached"
    entries = board.log(before)
    moves = [e["text"] for e in entries if e["kind"] == "line" and "G53" in e["text"]]
    assert len(moves) == 300 and moves[-1].startswith("X-209") and board.counters().get("bytes_lost", 0) == 0
    assert board.mpos()[:2] == pytest.approx((HOMED[0] + 150, HOMED[1] + 0.0), abs=0.02)


def test_stop_in_mid_path_keeps_the_position_and_lifts_the_stylus(start: Start) -> None:
    board, rig = start()
    rig.home()
    rig.go((0.05, 0.0, 0.02), (0.081, 0.0, 0.02), (0.35, 0.0, 0.02), (0.0, 0.2, 0.02), slow_after=2)
    rig.until(lambda: bool(rig.positions) and rig.positions[-1][0] > 0.08)
    rig.link.stop("stop requested")
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    x, y, z = board.mpos()
    assert z == pytest.approx(HOMED[2], abs=0.01) and -359 + 80 < x < -359 + 349 and y == pytest.approx(HOMED[1])
    assert rig.machine.homed and board.counters().get("alarms", 0) == 0
    assert rig.outcomes() == ["accepted", "aborted"]
    rig.link.call(lambda machine, now: machine.reset(now))
    rig.until(lambda: rig.state == "idle")
    rig.go((0.3, 0.1, 0.0))
    rig.until(lambda: len(rig.results) == 4)
    assert rig.outcomes()[-1] == "reached"
    assert board.mpos()[:2] == pytest.approx((HOMED[0] + 300, HOMED[1] + 100), abs=0.02)


def test_a_hold_that_shows_before_its_stop_has_the_lock_is_that_stop(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, rig = start()
    rig.home()
    rig.go((0.051, 0.0, 0.0), (0.35, 0.0, 0.0), slow_after=1)
    rig.until(lambda: bool(rig.positions) and rig.positions[-1][0] > 0.05)
    call = rig.link.call

    def late(action: Callable[..., None]) -> None:
        rig.until(lambda: rig.state.startswith("stopped"))
        call(action)

    monkeypatch.setattr(rig.link, "call", late)
    rig.link.stop("asked for")
    assert rig.machine.reason == "asked for"
    rig.until(lambda: rig.results and rig.results[-1].reason == "asked for")


def test_the_loss_of_a_silent_board_is_told_before_its_port_is_closed(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That may take long: Linux waits half a minute for a USB board that takes no byte any more."""
    board, rig = start(config=DriverConfig(enabled_at_start=True))
    rig.home()
    rig.go((0.35, 0.2, 0.0), slow_after=0)
    rig.until(lambda: rig.state == "moving")
    close, told = serial.Serial.close, []
    monkeypatch.setattr(
        serial.Serial, "close", lambda port: (told.append((rig.results[-1], rig.states[-1])), close(port))
    )
    board.fault("hang", seconds=10.0)
    rig.until(lambda: told)
    result, (_, state) = told[0]
    assert result.outcome.value == "aborted" and "no status report" in result.reason
    assert state.startswith("disconnected: no status report")


def test_a_link_that_is_closed_before_the_machine_is_at_rest_says_so(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A board that receives nothing gets as long as a hold may take, and the rest of the way out."""
    monkeypatch.setattr(serial_link, "WAY_OUT_S", 0.5)
    board, rig = start(config=dataclasses.replace(PATIENT, hold_timeout_s=1.0))
    rig.home()
    rig.go((0.35, 0.2, 0.0), slow_after=0)
    rig.until(lambda: rig.state == "moving")
    board.fault("hang", seconds=60.0)
    rig.link.close("enough")
    assert rig.notes[-2].startswith("the hold did not complete in 1.")
    assert rig.notes[-1] == (
        "closed 1.5 s after the stop, while resetting: the machine's state is unknown, the stylus may be down"
    )


def test_nothing_goes_on_when_a_computer_that_slept_wakes(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock of the heartbeat's age was stopped meanwhile: a motion continued after hours."""
    _, rig = start()
    rig.home()
    assert rig.go((0.3, 0.2, 0.0), slow_after=0).outcome.value == "accepted"

    def beat(machine: Machine, now: float) -> None:
        machine._heartbeat_at = now + 60.0  # it does not end by itself in this test

    rig.link.call(beat)
    clock = time.clock_gettime
    monkeypatch.setattr(time, "clock_gettime", lambda which: clock(which) + 3600.0)
    rig.until(lambda: len(rig.results) == 2, 30.0)
    assert rig.results[-1].outcome.value == "aborted"
    assert re.match(r"operator's heartbeat lost: 35\d\d\.\d+ s old", rig.results[-1].reason)


def test_unplugged_while_moving_then_back_and_unhomed(start: Start) -> None:
    board, rig = start()
    rig.home()
    rig.go((0.35, 0.2, 0.0), slow_after=0)
    rig.until(lambda: rig.state == "moving")

    def when(state: str) -> list[float]:
        return [t for t, text in rig.states[before:] if text.startswith(state)]

    with AwakeClock() as clock:
        rig.clock, before = clock.now, len(rig.states)
        board.fault("unplug", seconds=1.0)  # is answered when it is done
        pulled = clock.now()
        rig.until(lambda: when("disconnected") and when("unhomed"), 20.0)
    noticed, back = when("disconnected")[0] - pulled, when("unhomed")[0] - pulled - 0.5
    print(f"noticed after {1000 * noticed:.1f} ms, back {back:.2f} s after the port's return")
    assert noticed < 0.1 and back < 3.0
    assert rig.outcomes() == ["accepted", "aborted"] and "link lost" in rig.results[-1].reason
    since = board.log()[-1]["n"]
    rig.link.wait_for(lambda machine: machine.phase.state == "moving", 0.5)
    assert not any(line["text"].startswith("G") for line in board.lines(since)), "nothing resumes by itself"


@pytest.mark.parametrize(
    ("fault", "arguments", "state", "reason"),
    [
        ("brown_out", {}, "unhomed", "reset itself"),
        ("soft_reset", {}, "alarm", "ALARM:3"),
        ("alarm", {"number": 1}, "alarm", "ALARM:1"),
        ("error", {"number": 22, "after": 2}, "stopped", "error:22"),
        ("answers", {"how": "lost", "count": 1}, "stopped", "has not answered"),
        ("hang", {"seconds": 20.0}, "disconnected", "no status report"),
    ],
)
def test_faults_in_mid_path_end_in_a_state_that_says_why(
    start: Start, fault: str, arguments: dict[str, object], state: str, reason: str
) -> None:
    board, rig = start(config=DriverConfig(enabled_at_start=True) if fault == "hang" else None)
    rig.home()
    at_once = fault in ("error", "answers")
    if at_once:
        board.fault(fault, **arguments)
    rig.go(*[(0.02 * k, 0.01 * k, 0.0) for k in range(1, 17)], slow_after=16 if at_once else 2)
    if not at_once:
        rig.until(lambda: bool(rig.positions) and rig.positions[-1][0] > 0.03)
        board.fault(fault, **arguments)
    rig.until(lambda: len(rig.results) == 2, 30.0)
    assert rig.outcomes() == ["accepted", "aborted"] and reason in rig.results[-1].reason
    rig.until(lambda: any(text.startswith(state) for _, text in rig.states[-4:]), 10.0)
    assert rig.machine.homed is (state == "stopped")


def test_noise_between_the_answers_is_no_harm(start: Start) -> None:
    board, rig = start()
    rig.home()
    rig.go(*[(0.01 * k, 0.0, 0.0) for k in range(1, 20)])
    for _ in range(5):
        board.fault("answers", how="split", count=2)
    rig.until(lambda: len(rig.results) == 2, 20.0)
    assert rig.outcomes() == ["accepted", "reached"]


def test_the_port_is_exclusive_while_open_and_free_after(start: Start) -> None:
    board, rig = start()
    rig.until(lambda: rig.state == "unhomed")
    with pytest.raises(serial.SerialException, match="exclusively lock"):
        serial.Serial(str(board.port), exclusive=True)
    rig.close()
    serial.Serial(str(board.port), exclusive=True).close()


def test_a_missing_port_is_named_and_taken_when_it_appears(tmp_path: Path) -> None:
    rig = LinkRig(tmp_path / "grbl")
    try:
        rig.until(lambda: any("No such file or directory" in text for _, text in rig.states))
        board = GrblBoard(tmp_path)
        try:
            rig.until(lambda: rig.state == "unhomed")
        finally:
            board.close()
    finally:
        rig.close()


def test_stop_byte_is_on_the_wire_within_ten_milliseconds() -> None:
    """The other end of a pseudo-terminal gets ``!`` although no program answers and lines are waiting."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    rig = LinkRig(os.ttyname(slave), DriverConfig(connect_timeout_s=60.0))
    delays = []
    try:
        rig.until(lambda: rig.state == "connecting")
        for _ in range(50):
            while select.select([master], [], [], 0)[0]:
                os.read(master, 4096)
            began = time.monotonic()
            rig.link.stop("stop requested")
            seen = b""
            while b"!" not in seen:
                assert select.select([master], [], [], 1.0)[0], f"no hold within a second, only {seen!r}"
                seen += os.read(master, 4096)
            delays.append(time.monotonic() - began)
    finally:
        rig.close()
        os.close(slave)
        os.close(master)
    delays.sort()
    print(f"stop to byte: median {1e3 * statistics.median(delays):.2f} ms, worst {1e3 * delays[-1]:.2f} ms")
    assert delays[-3] < 0.010


def test_a_program_with_arcs_runs_on_the_board_as_it_was_checked(start: Start) -> None:
    board, rig = start()
    rig.home()
    source = [
        "(a square with a round corner)",
        "G90 G53 G0 X-200 Y-150",
        "G91 G1 X20 F6000",
        "G3 X10 Y10 J10",
        "G1 Y20",
    ]
    source += ["G2 X-10 Y10 R10", "G90 G1 X-190 Y-100 ; back", "M30"]
    answer = rig.link.call(lambda machine, now: machine.run_program("square", source, now))
    assert answer.outcome.value == "accepted", answer.reason
    rig.until(lambda: len(rig.results) == 2, 30.0)
    assert rig.outcomes()[-1] == "reached", rig.results[-1]
    assert board.mpos() == pytest.approx((-190.0, -100.0, HOMED[2]), abs=0.02)
    assert board.counters().get("errors", 0) == 0


def test_a_listener_that_always_fails_does_not_end_the_thread(start: Start) -> None:
    _, rig = start()
    rig.home()
    failures: list[float] = []

    def fail() -> None:
        failures.append(time.monotonic())
        raise RuntimeError("nobody takes the events")

    rig.complaint = fail
    rig.until(lambda: len(failures) >= 2)
    assert not rig.machine.homed, "the port was closed, nobody else could stop the board"
    rig.complaint = None
    rig.until(lambda: rig.state == "unhomed")
    assert rig.link.alive


def test_stops_during_the_retreat_let_it_finish(start: Start) -> None:
    board, rig = start()
    rig.home()
    rig.go((0.0, 0.0, 0.05))
    rig.until(lambda: bool(rig.positions) and rig.positions[-1][2] > 0.03)
    lifting = []

    def again() -> None:  # in the link's own thread: meanwhile the retreat does not end
        if rig.machine.phase.name == "LIFTING" and not lifting:
            lifting.extend(rig.link.stop("again") for _ in range(5))

    rig.complaint = again
    rig.link.stop("first")
    rig.until(lambda: lifting)
    rig.until(lambda: rig.machine.phase.name == "STOPPED")
    assert board.mpos()[2] == pytest.approx(HOMED[2], abs=0.01) and rig.states[-1][1] == "stopped: first"
    assert len(board.holds()) == 1, "one hold for the motion, none for the retreat"


@pytest.mark.parametrize(("dialect", "told", "buffer"), [("grblHAL", 1024, 1024), ("FluidNC", 128, 256)])
def test_dialects_are_told_apart_and_driven_alike(tmp_path: Path, dialect: str, told: int, buffer: int) -> None:
    """The receive buffer is the one that the board names; without a name, GRBL's is assumed."""
    board = GrblBoard(tmp_path, "--dialect", dialect, "--start=-350,-210,-2")
    rig = LinkRig(board.port)
    try:
        rig.home()
        assert (rig.machine.dialect.value, rig.machine.session.rx_bytes) == (dialect, told)
        assert rig.machine.counts.refused == 0, "each question is one that the dialect knows"
        rig.go(*[(0.0005 * k, 0.0, 0.0) for k in range(1, 301)])
        rig.until(lambda: "reached" in rig.outcomes(), 30.0)
        assert board.counters().get("bytes_lost", 0) == 0 and told <= buffer
        assert len([e for e in board.lines() if e["text"].endswith("G53G1")]) == 300
    finally:
        rig.close()
        board.close()
