"""gantry_gcode on a mock board: a process with arguments, output, keys and exit codes; truth from the board."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import serial
from nodes.background import output_in_background
from nodes.grbl_board import GrblBoard

from gantry_driver.adapters.check_mode import CheckFailed, dry_run
from gantry_driver.cli.gantry_gcode import main
from gantry_driver.core.grbl.settings_profile import parse_profile, profile_text

pytestmark = pytest.mark.long

GOOD = ["; a square", "G21 G90", *(f"G53 G1 X{-300 - 10 * k} Y-100 F9000" for k in range(5)), "G53 G0 X-359 Y-219"]
PATIENCE = ("--params", str(Path(__file__).with_name("patient_driver.yaml")))


@pytest.fixture
def board(tmp_path: Path) -> Iterator[GrblBoard]:
    board = GrblBoard(tmp_path, "--start=-350,-210,-2")
    yield board
    board.close()


@pytest.fixture
def program(tmp_path: Path) -> Callable[..., Path]:
    def write(*lines: str) -> Path:
        path = tmp_path / "program.nc"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


class Terminal:
    """The program on a terminal of its own."""

    def __init__(self, *arguments: str, patience: Sequence[str] = PATIENCE) -> None:
        self._master, slave = pty.openpty()
        command = [sys.executable, "-m", "gantry_driver.cli.gantry_gcode", *arguments, *patience]
        # As a script's background job: it starts with SIGINT ignored.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        self.process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave)
        signal.signal(signal.SIGINT, before)
        os.close(slave)
        self.seen = ""

    def until(self, wanted: str | Callable[[str], bool], within_s: float = 30.0) -> None:
        end = time.monotonic() + within_s
        printed = wanted if callable(wanted) else lambda seen: wanted in seen
        while not printed(self.seen):
            ready, _, _ = select.select([self._master], [], [], max(end - time.monotonic(), 0.0))
            assert ready, f"{wanted!r} was not printed: {self.seen[-600:]}"
            try:
                self.seen += os.read(self._master, 4096).decode()
            except OSError:  # the program has ended
                assert printed(self.seen), self.seen[-600:]

    def until_line(self, number: int) -> None:
        """Wait until this number of lines of the program is done; a held-up program does not report each number."""
        self.until(lambda seen: any(int(done) >= number for done in re.findall(r"(\d+)/\d+ lines", seen)))

    def type(self, keys: str) -> None:
        self.seen = ""
        os.write(self._master, keys.encode())

    def end(self, within_s: float = 30.0) -> int:
        try:
            return self.process.wait(within_s)
        finally:
            self.process.kill()
            os.close(self._master)


def run(*arguments: str, what: str = "run", within_s: float = 60.0) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-m", "gantry_driver.cli.gantry_gcode", what, *arguments, *PATIENCE],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=within_s,
    )
    return done.returncode, done.stdout


def test_a_program_is_run_and_every_line_is_executed(board: GrblBoard, program: Callable[..., Path]) -> None:
    code, output = run(str(program(*GOOD)), "--port", str(board.port))
    assert code == 0, output
    assert "program.nc: 7 lines, about " in output and "[########################] 100 %  7/7 lines" in output
    assert "reached in " in output
    moves = [line["text"] for line in board.lines() if "G53" in line["text"]]
    between = [f"X{-300 - 10 * k}Y-100G53G1" for k in range(1, 5)]
    assert moves == ["F9000X-300Y-100G53G1", *between, "F17234X-359Y-219G53G1"]
    assert board.mpos() == pytest.approx((-359.0, -219.0, -1.0), abs=0.02)


def test_a_program_is_run_from_the_background_of_a_terminal(board: GrblBoard, program: Callable[..., Path]) -> None:
    """The kernel stops who sets up a terminal from its background."""
    path = program("G53 G1 X-300 Y-100 F9000")
    command = ["gantry_driver.cli.gantry_gcode", "run", str(path), "--port", str(board.port), *PATIENCE]
    output = output_in_background(*command)
    assert "reached in " in output
    assert board.mpos()[:2] == pytest.approx((-300.0, -100.0), abs=0.02)


def test_a_program_whose_check_takes_longer_than_a_heartbeat_may_is_started(
    board: GrblBoard, program: Callable[..., Path], tmp_path: Path
) -> None:
    moves = [f"G1 X{-300 - k % 50} Y{-100 - k % 40} F9000" for k in range(40_000)]
    late_board = tmp_path / "late_board.yaml"
    late_board.write_text("/**: {ros__parameters: {status_timeout_s: 10.0}}")
    patience = ("--params", str(late_board))  # with the board alone
    terminal = Terminal("run", str(program(*moves)), "--port", str(board.port), patience=patience)
    terminal.until("   1 %  ", 100.0)
    terminal.process.send_signal(signal.SIGINT)
    terminal.until("interrupted: holding")
    assert terminal.end() == 1
    assert "heartbeat" not in terminal.seen and "no status report" not in terminal.seen


def test_a_refused_program_does_not_open_the_port(
    program: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = program("G21", "G53 G1 X-300 F6000", "G53 G1 X-100 Y7")
    assert main(["run", str(path), "--port", "no-such-port"]) == 1
    said = capsys.readouterr().err
    assert said == f"{path}:3:14: Y = 7.000 mm (machine) is outside -219 to 0 mm (ALARM:2)\n"


def test_a_port_that_is_busy_ends_the_program_with_the_reason(program: Callable[..., Path]) -> None:
    master, slave = pty.openpty()
    with serial.Serial(os.ttyname(slave), exclusive=True):
        code, output = run(str(program(*GOOD)), "--port", os.ttyname(slave), within_s=60.0)
    os.close(slave)
    os.close(master)
    assert code == 1 and "in use by another program" in output.splitlines()[-1], output


def test_the_check_alone_says_how_long_it_takes(
    program: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = program("G53 G1 X-259 F6000", "G4 P2")
    assert main(["run", str(path), "--check", "--port", "no-such-port"]) == 0
    assert capsys.readouterr().out == f"{path}: 2 lines, about 3.0 s\n"


def test_a_dry_run_moves_nothing_and_names_what_the_board_refuses(
    board: GrblBoard, program: Callable[..., Path]
) -> None:
    start = board.mpos()
    code, output = run(str(program(*GOOD)), "--port", str(board.port), "--dry-run")
    assert code == 0 and "dry run: 7 lines, 0 refused by the board" in output, output
    board.fault("error", number=20, after=7)  # $X, $C, and three to where it begins
    code, output = run(str(program(*GOOD)), "--port", str(board.port), "--dry-run")
    assert code == 1 and "program.nc:4:1: the board answers error:20 (command not supported)" in output, output
    assert board.mpos() == start


@pytest.mark.parametrize("how", ["whole", "interrupted"])
def test_a_dry_run_leaves_a_locked_board_locked(tmp_path: Path, program: Callable[..., Path], how: str) -> None:
    """It has not been homed: unlocked, it would accept moves from a position that it does not know."""
    board = GrblBoard(tmp_path, "--keep-running")
    try:
        start = board.mpos()
        path = program("G53 G1 X-300 Y-100 F9000", *["G4 P1"] * 60)
        terminal = Terminal("run", str(path), "--port", str(board.port), "--dry-run")
        terminal.until("dry run")
        if how == "interrupted":
            terminal.process.send_signal(signal.SIGINT)
        terminal.until("interrupted" if how == "interrupted" else "0 refused by the board")
        assert terminal.end() == (1 if how == "interrupted" else 0) and "Traceback" not in terminal.seen
        assert board.ask("state")["state"] == "Alarm" and board.mpos() == start
        assert [line["number"] for line in board.log() if line["kind"] == "alarm"] == [2]
    finally:
        board.close()


def test_a_dry_run_says_when_it_cannot_lock_the_board_again(tmp_path: Path, program: Callable[..., Path]) -> None:
    board = GrblBoard(tmp_path, "--set", "20=0")
    try:
        code, output = run(str(program(*GOOD)), "--port", str(board.port), "--dry-run")
        assert code == 1 and output.splitlines()[-1] == (
            "error: the board was locked before and could not be locked again: it is Idle, and moves without having "
            "been homed"
        )
    finally:
        board.close()


@pytest.mark.parametrize(
    ("options", "low"),
    [((), set()), (("--no-dtr",), {"DTR"}), (("--no-rts",), {"RTS"}), (("--no-dtr", "--no-rts"), {"DTR", "RTS"})],
)
@pytest.mark.parametrize("dry", [True, False])
def test_the_control_lines_have_the_levels_that_are_asked_for(
    board: GrblBoard,
    program: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    options: tuple[str, ...],
    low: set[str],
    dry: bool,
) -> None:
    """A pseudo-terminal has no such lines: what the library asks the kernel for is looked at."""
    lines = {termios.TIOCM_DTR: "DTR", termios.TIOCM_RTS: "RTS"}
    asked: dict[str, bool] = {}
    ioctl = fcntl.ioctl

    def note(fd: int, request: int, argument: Any = 0, *more: Any) -> Any:
        if request in (termios.TIOCMBIS, termios.TIOCMBIC):
            asked[lines[struct.unpack("I", argument)[0]]] = request == termios.TIOCMBIS
            return argument
        return ioctl(fd, request, argument, *more)

    monkeypatch.setattr(fcntl, "ioctl", note)
    monkeypatch.setattr("gantry_driver.cli.gantry_gcode._on_signals", lambda what: None)  # they are the test's here
    arguments = ["run", str(program("G53 G1 X-358 Y-218 F9000")), "--port", str(board.port), *options, *PATIENCE]
    assert main([*arguments, "--dry-run"] if dry else arguments) == 0
    assert asked == {line: line not in low for line in lines.values()}


def test_a_dry_run_begins_where_the_program_does(board: GrblBoard, program: Callable[..., Path]) -> None:
    """A board that is not homed counts from 0, the far end of the travel."""
    path = program("G91 G1 X10 Y10 F6000", "G2 X10 I5")
    code, output = run(str(path), "--port", str(board.port), "--dry-run")
    assert code == 0 and "dry run: 2 lines, 0 refused by the board" in output, output


def test_a_dry_run_resets_a_board_that_opening_its_port_does_not_reset(
    tmp_path: Path, program: Callable[..., Path]
) -> None:
    board = GrblBoard(tmp_path, "--keep-running", "--dialect", "grblHAL")
    try:
        path = program("G53 G1 X-300 Y-100 F9000", *["G4 P1"] * 60)
        terminal = Terminal("run", str(path), "--port", str(board.port), "--dry-run")
        terminal.until("dry run")
        terminal.process.send_signal(signal.SIGINT)
        terminal.until("interrupted")
        assert terminal.end() == 1 and "Traceback" not in terminal.seen
        assert board.ask("state")["state"] == "Idle" and board.counters()["resets"] == 2
    finally:
        board.close()


def test_a_dry_run_that_ends_in_an_alarm_leaves_the_board_as_after_a_reset(
    tmp_path: Path, program: Callable[..., Path]
) -> None:
    """For half a second after ALARM:2 a board ignores a reset; without one it answers nothing any more."""
    board = GrblBoard(tmp_path, "--keep-running", "--set", "130=200")
    try:
        code, output = run(str(program("G53 G1 X-300 Y-100 F9000")), "--port", str(board.port), "--dry-run")
        assert code == 1 and output.splitlines()[-1] == "error: line 'X-359Y-219Z-1G53G0': ALARM:2", output
        end = time.monotonic() + 20.0
        # How often it is reset before depends on whether its first banner is still in the port.
        while [line["kind"] for line in board.log() if line["kind"] in ("alarm", "banner")][-2:] != ["alarm", "banner"]:
            assert time.monotonic() < end, board.log()[-6:]
    finally:
        board.close()


@pytest.mark.parametrize("digits", [13, 75, 400])
def test_a_profile_with_a_value_that_no_board_keeps_is_refused(
    digits: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "profile"
    path.write_text("$22=1\n$110=-1" + "0" * (digits - 1) + "\n")
    assert main(["settings", "--port", "no-such-port", "--write-file", str(path)]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"error: {path}: line 2: ") and told.endswith(" is not within -1e+09 to 1e+09\n")


def test_a_comment_ends_where_its_line_ends_for_a_board(
    program: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Not at a form feed or at a line separator, behind which its rest would be a move."""
    remark = "; once\x0cG53 G0 X-300\x1eG53 G0 X-301\u2028G53 G0 X-302"
    path = program("\ufeff(a mark of the byte order before it)", remark)
    assert main(["run", str(path), "--check"]) == 1
    assert capsys.readouterr().err == f"{path}: nothing to send\n"


UNGUARDED = [part for number in (20, 21, 22) for part in ("--set", f"{number}=0")]
"""Settings of a board that obeys moves as soon as it has started."""
MOVES = [f"F600X{-10 - k}G53G1" for k in range(5)]


def test_a_dry_run_ends_when_the_board_resets_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is in check mode no more then, and would do what the next lines say."""
    ports: list[serial.Serial] = []
    open_port = serial.Serial.open
    monkeypatch.setattr(serial.Serial, "open", lambda port: (ports.append(port), open_port(port)))
    board = GrblBoard(tmp_path, *UNGUARDED)
    try:
        start = board.mpos()

        def brown_out(done: int) -> None:
            if done == 2:
                board.fault("brown_out")
                end = time.monotonic() + 20.0
                while ports[0].in_waiting < 10:  # until the banner has come
                    assert time.monotonic() < end, board.log()[-6:]

        with pytest.raises(CheckFailed, match="the board was reset by itself before line 'F600X-12G53G1'"):
            list(dry_run(str(board.port), 115200, MOVES, brown_out))
        assert board.mpos() == start
        assert [line["text"] for line in board.lines()] == ["$X", "$C", *MOVES[:2]]
    finally:
        board.close()


def test_a_dry_run_sends_nothing_to_a_board_that_is_not_in_check_mode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One flipped bit makes a $G of $C, which any board answers by ok as well."""
    write = serial.Serial.write
    monkeypatch.setattr(serial.Serial, "write", lambda port, data: write(port, data.replace(b"$C", b"$G")))
    board = GrblBoard(tmp_path, *UNGUARDED)
    try:
        start = board.mpos()
        with pytest.raises(CheckFailed, match="after \\$C the board reports <Idle"):
            list(dry_run(str(board.port), 115200, MOVES))
        assert board.mpos() == start and [line["text"] for line in board.lines()] == ["$X", "$G"]
    finally:
        board.close()


def test_a_kept_profile_can_be_read_again_though_some_settings_are_texts() -> None:
    """A grblHAL board with a network has such settings; they stay in the file as comments."""
    text = profile_text({110: "12000.000", 302: "192.168.5.1", 74: "", 9: "1"})
    assert text == "$9=1\n; $74=\n$110=12000.000\n; $302=192.168.5.1\n"
    assert parse_profile(text.splitlines()) == {9: 1.0, 110: 12000.0}


def test_a_setting_that_differs_is_named(tmp_path: Path, program: Callable[..., Path]) -> None:
    board = GrblBoard(tmp_path, "--set", "110=500")
    try:
        code, output = run(str(program(*GOOD)), "--port", str(board.port))
    finally:
        board.close()
    assert code == 1 and "mismatch: $110 is 500.000; expected 12000 (the configuration)" in output, output


def test_space_pauses_and_resumes_and_ctrl_c_ends_safely(board: GrblBoard, program: Callable[..., Path]) -> None:
    way = [f"G53 G1 X{-300 + 100 * (k % 2)} F6000" for k in range(300)]  # lasts a minute
    terminal = Terminal("run", str(program("G53 G1 Z-11 F1800", *way)), "--port", str(board.port))
    terminal.until("moving")
    terminal.until_line(3)
    terminal.type(" ")
    terminal.until("moving: paused")
    end = time.monotonic() + 20.0
    while board.ask("state")["state"] != "Hold:0":
        assert time.monotonic() < end
    where = board.mpos()
    assert where[2] == pytest.approx(-11.0)
    terminal.type(" ")
    end = time.monotonic() + 20.0
    while board.mpos() == where:
        assert time.monotonic() < end, "it goes on"
    terminal.process.send_signal(signal.SIGINT)
    terminal.until("interrupted: holding")
    terminal.process.send_signal(signal.SIGINT)  # people press again; the retreat goes on
    terminal.process.send_signal(signal.SIGTERM)
    assert terminal.end() == 1
    x, _, z = board.mpos()
    assert -359.0 < x < -199.9 and z == pytest.approx(-1.0, abs=0.02), ("held on the way, stylus up", terminal.seen)
    assert not [entry for entry in board.log() if entry["kind"] == "alarm"], "the position is kept"


@pytest.mark.usefixtures("hang_up")
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGTSTP])
def test_a_terminal_that_is_closed_and_ctrl_z_leave_no_stylus_down(
    number: signal.Signals, board: GrblBoard, program: Callable[..., Path]
) -> None:
    """Killed or put aside, the program let the board do what it had, and press from then on."""
    way = [f"G53 G1 X{-300 + 100 * (k % 2)} F6000" for k in range(300)]
    terminal = Terminal("run", str(program("G53 G1 Z-11 F1800", *way)), "--port", str(board.port))
    terminal.until_line(3)
    terminal.process.send_signal(number)
    assert terminal.end() == 1
    x, _, z = board.mpos()
    assert -359.0 < x < -199.9 and z == pytest.approx(-1.0, abs=0.02)
    assert not [entry for entry in board.log() if entry["kind"] == "alarm"], "the position is kept"


def test_settings_are_kept_in_a_file_compared_and_written_back(board: GrblBoard, tmp_path: Path) -> None:
    port, kept, wrong = str(board.port), tmp_path / "kept.txt", tmp_path / "wrong.txt"
    code, output = run("--port", port, "--save", str(kept), what="settings")
    assert code == 0 and "settings" in output and "$110=12000.000\n" in kept.read_text()
    wrong.write_text("; slow\n$110=500\n$12=0.003 (arcs)\n")
    assert run("--port", port, "--write-file", str(wrong), what="settings")[0] == 0
    code, output = run("--port", port, what="settings")
    assert code == 1 and output.splitlines()[-1] == "$110 is 500.000; expected 12000 (the configuration)"
    code, output = run("--port", port, "--write", what="settings")
    assert code == 0 and output.splitlines()[-1] == "all 17 settings are as they should be"
    written = [e["text"] for e in board.lines() if "=" in e["text"]]
    assert written == ["$12=0.003", "$110=500", "$110=12000"] and board.counters().get("bytes_lost_eeprom", 0) == 0
    wrong.write_text("$110=fast\n")
    code, output = run("--port", port, "--write-file", str(wrong), what="settings")
    assert code == 2 and "line 1: '$110=fast' is not $number=value" in output


@pytest.mark.parametrize("text", [b"a: [", b"\xff\0", b"x: {ros__parameters: {baud: 2026-13-45}}"])
def test_a_parameter_file_that_cannot_be_read_ends_it_with_one_line(
    text: bytes, tmp_path: Path, program: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    params = tmp_path / "params.yaml"
    params.write_bytes(text)
    assert main(["run", str(program(*GOOD)), "--params", str(params)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: {params}") and said.count("\n") == 1


CONFIG = Path(__file__).parents[3] / "config" / "params"
SMALL = "--set=130=200", "--set=131=150", "--set=132=40"
"""Settings of a board on a stage that is smaller than the bench's."""


def test_the_machine_of_a_lab_is_that_of_its_drivers_files(tmp_path: Path) -> None:
    """Of the profile "hardware" they are two, and the second has entries for other nodes."""
    own = tmp_path / "hardware.yaml"
    text = (CONFIG / "hardware.yaml").read_text(encoding="utf-8")
    assert "travel_mm: [360.0, 220.0, 60.0]" in text
    own.write_text(text.replace("travel_mm: [360.0, 220.0, 60.0]", "travel_mm: [200.0, 150.0, 40.0]"))
    files = ("--params", str(CONFIG / "serial_driver.yaml"), "--params", str(own))
    board = GrblBoard(tmp_path, *SMALL)
    try:
        code, output = run(*files, "--port", str(board.port), "--write", what="settings")
        assert code == 0 and output.splitlines()[-1] == "all 17 settings are as they should be"
        assert not [e["text"] for e in board.lines() if "=" in e["text"]]
    finally:
        board.close()


def test_no_machine_is_written_to_a_board_that_nobody_has_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = GrblBoard(tmp_path, *SMALL)
    try:
        assert main(["settings", "--port", str(board.port), "--write"]) == 2
        assert "--write: the configured machine is named by --params" in capsys.readouterr().err
        assert not [e["text"] for e in board.lines() if "=" in e["text"]]
    finally:
        board.close()


def test_a_file_without_the_driver_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    params = tmp_path / "params.yaml"
    params.write_text("/**/camera: {ros__parameters: {baud: 9600}}\n/**/hand_eye: {ros__parameters: {baud: 9600}}\n")
    assert main(["settings", "--params", str(params), "--port", "no-such-port"]) == 2
    assert capsys.readouterr().err == f"error: {params}; expected ros__parameters for serial_driver\n"
