"""The mock board as a program and behind a real pseudo-terminal, spoken to by pyserial."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import stat
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import serial
from support.line_socket import LineSocket
from unit.gantry_driver.mock_rig import BANNER, FREE, UNLOCK
from unit.gantry_driver.mock_service import DEADLINE_S, Port, Running, expect, wait_for

from gantry_driver.mock import service
from gantry_driver.mock.main import main
from gantry_driver.mock.service import Service

pytestmark = pytest.mark.slow


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    with contextlib.ExitStack() as stack:
        yield lambda **options: Running(tmp_path, stack, **options)


def test_opening_the_port_resets_the_board(start: Callable[..., Running]) -> None:
    running = start()
    port = running.open()
    assert expect(port, UNLOCK) == BANNER + UNLOCK
    port.write(b"$X\n")
    assert expect(port, b"ok\r\n") == b"[MSG:Caution: Unlocked]\r\nok\r\n"
    port.close()
    wait_for(lambda: running.control.ask(do="state")["open"] is False)
    again = running.open()
    assert expect(again, UNLOCK) == BANNER + UNLOCK


def test_a_port_that_does_not_hang_up_keeps_dtr_high_and_the_board_running(start: Callable[..., Running]) -> None:
    running = start()
    port = running.open()
    assert expect(port, UNLOCK) == BANNER + UNLOCK
    port.write(b"$X\n")
    assert expect(port, b"ok\r\n") == b"[MSG:Caution: Unlocked]\r\nok\r\n"
    modes = termios.tcgetattr(port.fileno())
    assert modes[2] & termios.HUPCL, "a port hangs up until a program changes that"
    modes[2] &= ~termios.HUPCL
    termios.tcsetattr(port.fileno(), termios.TCSANOW, modes)
    port.close()
    wait_for(lambda: running.control.ask(do="state")["open"] is False)
    port = running.open()
    wait_for(lambda: running.control.ask(do="state")["open"] is True)
    port.write(b"?")
    assert expect(port, b">\r\n").startswith(b"<Idle|")
    modes[2] |= termios.HUPCL
    termios.tcsetattr(port.fileno(), termios.TCSANOW, modes)
    port.close()
    wait_for(lambda: running.control.ask(do="state")["open"] is False)
    assert expect(running.open(), UNLOCK) == BANNER + UNLOCK


def test_a_board_that_ignores_dtr_keeps_its_state(start: Callable[..., Running]) -> None:
    running = start(settings=FREE, reset_on_open=False)
    wait_for(lambda: running.control.ask(do="state")["t"] > 0.2)
    port = running.open()
    wait_for(lambda: running.control.ask(do="state")["open"] is True)
    port.write(b"G0X-1\nG4P0\n")
    assert expect(port, b"ok\r\nok\r\n") == b"ok\r\nok\r\n"
    port.close()
    wait_for(lambda: running.control.ask(do="state")["open"] is False)
    port = running.open()
    wait_for(lambda: running.control.ask(do="state")["open"] is True)
    port.write(b"?")
    assert expect(port, b">\r\n").startswith(b"<Idle|MPos:-1.000,0.000,0.000|")


def test_home_and_move_end_to_end(start: Callable[..., Running]) -> None:
    running = start(time_scale=20.0)
    truth = running.client(running.truth_path)
    port = running.open()
    expect(port, UNLOCK)
    port.write(b"$H\n")
    assert expect(port, b"ok\r\n") == b"ok\r\n"
    port.write(b"G1X-300Y-150Z-20F6000\nM3S250\nG4P0\n")
    expect(port, b"ok\r\nok\r\nok\r\n")
    port.write(b"?")
    assert expect(port, b">\r\n").startswith(b"<Idle|MPos:-300.000,-150.000,-20.000|")
    deadline = time.monotonic() + DEADLINE_S
    while (line := truth.read())["mpos"] != [-300.0, -150.0, -20.0] or line["spindle"] != 250.0:
        assert time.monotonic() < deadline
    assert line["coolant"] is False
    assert abs(line["t"] - time.monotonic()) < DEADLINE_S
    assert running.control.ask(do="state")["steps"] == [-24000, -12000, -8000]
    texts = [entry["text"] for entry in running.control.ask(do="log", kind="line")["entries"]]
    assert texts == ["$H", "G1X-300Y-150Z-20F6000", "M3S250", "G4P0"]
    counters = running.control.ask(do="counters")["counters"]
    assert counters["lines"] == 4 and counters["homings"] == 1 and counters["bytes_lost"] == 0


class UnhurriedClock:
    """A board's clock: it runs while the board waits, and for 5 ms of its actions then, however long it is held up."""

    def __init__(self) -> None:
        self._now = self._seen = time.monotonic()
        self._left_s = 0.0

    def monotonic(self) -> float:
        now = time.monotonic()
        passed = min(now - self._seen, self._left_s)
        self._now, self._seen, self._left_s = self._now + passed, now, self._left_s - passed
        return self._now

    def waits(self, seconds: float | None) -> float | None:
        self._left_s = (seconds or 0.0) + 0.005
        return seconds


@pytest.fixture
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, timeout = UnhurriedClock(), Service._timeout
    monkeypatch.setattr(service, "time", clock)
    monkeypatch.setattr(Service, "_timeout", lambda self: clock.waits(timeout(self)))


@pytest.mark.usefixtures("unhurried")
def test_truth_comes_fast_while_moving_to_every_client(start: Callable[..., Running]) -> None:
    running = start(settings=FREE)
    fast, slow = running.client(running.truth_path), running.client(running.truth_path)
    port = running.open()
    expect(port, BANNER)
    port.write(b"G1X-50F3000\nG4P0\n")
    expect(port, b"ok\r\nok\r\n")
    track = [fast.read()]
    while track[-1]["mpos"][0] != -230.0:
        track.append(fast.read())
    moving = [line for line in track if line["state"] == "Run"]
    span = moving[-1]["t"] - moving[0]["t"]
    assert span == pytest.approx(1.0, abs=0.2)
    assert len(moving) > 60  # 200 on an idle machine
    xs = [line["mpos"][0] for line in moving]
    assert xs == sorted(xs, reverse=True)
    for line in moving[10:-10]:  # at constant speed, 50 mm/s
        assert xs[0] - line["mpos"][0] == pytest.approx(50.0 * (line["t"] - moving[0]["t"]), abs=2.5)
    assert slow.read()["mpos"] == track[0]["mpos"]  # it reads late and hinders no other program
    rest = [fast.read()["t"] for _ in range(6)]
    assert (rest[-1] - rest[0]) / 5 > 0.03


def test_unplugging_kills_the_port_and_a_new_one_appears(start: Callable[..., Running]) -> None:
    running = start()
    port = running.open()
    expect(port, UNLOCK)
    before = running.link.readlink()
    running.fault("unplug", seconds=3600.0)
    assert not running.link.exists()
    with pytest.raises(serial.SerialException):
        port.read(1)
    port.close()
    assert running.control.ask(do="state")["port"] is None
    running.fault("unplug", seconds=0.0)
    wait_for(running.link.exists)
    port = running.open()
    assert expect(port, UNLOCK) == BANNER + UNLOCK
    assert running.control.ask(do="state")["port"] == str(running.link.readlink())
    assert before.parent == running.link.readlink().parent


def test_unplugging_in_a_move_stops_the_motors(start: Callable[..., Running]) -> None:
    running = start(settings=FREE)
    port = running.open()
    expect(port, BANNER)
    port.write(b"G1X-100F600\n")
    wait_for(lambda: running.control.ask(do="state")["mpos"][0] < -180.5)
    running.fault("unplug", seconds=3600.0)
    here = running.control.ask(do="state")
    assert here["state"] == "Off" and -280.0 < here["mpos"][0] < -180.0
    running.fault("unplug", seconds=0.0)
    wait_for(running.link.exists)
    assert running.control.ask(do="state")["mpos"] == here["mpos"]
    assert running.control.ask(do="state")["steps"] == [0, 0, 0]


def test_a_port_that_is_not_read_blocks_the_writer(start: Callable[..., Running]) -> None:
    running = start(settings=FREE)
    port = running.open(write_timeout=0.3)
    expect(port, BANNER)
    running.fault("stop_reading", seconds=3600.0)
    with pytest.raises(serial.SerialTimeoutException):
        for _ in range(64):
            port.write(b"\n" * 4096)
    assert running.control.ask(do="counters")["counters"].get("lines", 0) == 0
    running.fault("stop_reading", seconds=0.0)
    wait_for(lambda: running.control.ask(do="counters")["counters"].get("lines", 0) > 0)


def test_a_move_that_takes_for_ever_leaves_the_program_at_work(start: Callable[..., Running]) -> None:
    running = start(settings=FREE)
    port = running.open()
    expect(port, BANNER)
    port.write(b"G1X-" + b"9" * 60 + b"F1\n")
    expect(port, b"ok\r\n")
    port.write(b"?")
    assert b"<Run|" in expect(port, b">\r\n")


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        (b"[" * 20_000, "not JSON"),
        (b'{"do": "fault", "kind": "hang", "seconds": 1%s}' % (b"0" * 400), "not within 0 to 3600 s"),
        (b'{"do": "fault", "kind": "probe_surface", "z_mm": 1%s}' % (b"0" * 400), "not within"),
    ],
)
def test_no_request_ends_the_program(line: bytes, sentence: str, start: Callable[..., Running]) -> None:
    running = start()
    answer = running.control.send(line)
    assert answer["ok"] is False and sentence in answer["error"]
    assert running.control.ask(do="state")["ok"] is True


def test_control_refuses_what_it_does_not_know(start: Callable[..., Running]) -> None:
    control = start().control
    assert control.send(b"{oops")["error"].startswith("not JSON")
    assert control.send(b"[1]")["error"] == "a JSON object is needed"
    assert control.ask(do="dance")["error"] == "do = 'dance' is none of state, counters, log, fault"
    assert control.ask(do="log", since="x")["error"] == "since = 'x'; expected a whole number"
    assert control.ask(do="fault", kind="hang", seconds=-2)["error"] == "seconds = -2 is not within 0 to 3600 s"
    assert control.ask(do="fault", kind="unheard of")["ok"] is False
    assert control.ask(do="state")["state"] == "Alarm"


@pytest.fixture
def program(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    command = [sys.executable, "-m", "gantry_driver.mock.main", "--set", "20=0", "--set", "22=0", "--log"]
    command += [str(tmp_path / "log.jsonl"), "--link", str(tmp_path / "port"), "--truth-socket", str(tmp_path / "t")]
    command += ["--control-socket", str(tmp_path / "c"), "--ros-args", "-r", "__node:=x", "--", "--seed", "3"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield process, tmp_path
    finally:
        if process.poll() is None:
            process.kill()
        process.wait(DEADLINE_S)
        assert process.stdout is not None
        process.stdout.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_program_prints_its_port_logs_and_cleans_up(
    program: tuple[subprocess.Popen[str], Path], number: signal.Signals
) -> None:
    process, folder = program
    assert process.stdout is not None
    path = process.stdout.readline().strip()
    assert path == str(folder / "port") and stat.S_ISCHR(Path(path).stat().st_mode)
    with Port(path, 115200, timeout=DEADLINE_S) as port:
        expect(port, BANNER)
        port.write(b"G21 (mm)\n?")
        expect(port, b">\r\n")
        process.send_signal(number)
        assert process.wait(DEADLINE_S) == 0
    assert sorted(p.name for p in folder.iterdir()) == ["log.jsonl"]
    entries = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert [e["bytes"] for e in entries if e["kind"] == "rx"] == ["G21 (mm)\n?"]
    assert [(e["text"], e["answer"]) for e in entries if e["kind"] == "line"] == [("G21", "ok")]
    assert [e["byte"] for e in entries if e["kind"] == "realtime"] == [ord("?")]


def test_program_ends_with_one_line_when_the_logs_disk_is_full(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "gantry_driver.mock.main", "--log", "/dev/full", "--link", str(tmp_path / "port")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S)
    told = "error: --log /dev/full: No space left on device\n"
    assert (ended.stderr, ended.returncode) == (told, os.EX_IOERR)
    assert list(tmp_path.iterdir()) == []


def test_a_board_whose_port_nobody_reads_is_at_its_link(program: tuple[subprocess.Popen[str], Path]) -> None:
    process, folder = program
    assert process.stdout is not None
    process.stdout.close()
    wait_for((folder / "port").exists)
    with Port(str(folder / "port"), 115200, timeout=DEADLINE_S) as port:
        expect(port, BANNER)
        process.send_signal(signal.SIGTERM)
        assert process.wait(DEADLINE_S) == 0
    assert not (folder / "port").is_symlink()


ENDED_UNSEEN = """
import signal, sys, threading, time
from gantry_driver.mock.main import main
threading.Thread(target=time.sleep, args=(60.0,), daemon=True).start()  # gets the signal
signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
sys.exit(main(["--link", sys.argv[1]]))
"""


def test_a_signal_that_interrupts_no_wait_ends_the_board(tmp_path: Path) -> None:
    """One that comes between the last instruction and the wait does not: here none does."""
    command = [sys.executable, "-c", ENDED_UNSEEN, str(tmp_path / "port")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            link = Path(process.stdout.readline().strip())
            with Port(str(link), 115200, timeout=DEADLINE_S) as port:
                expect(port, BANNER)
                port.timeout = 0.2
                while port.read(100):
                    pass  # until the board waits
                process.send_signal(signal.SIGTERM)
                assert process.wait(DEADLINE_S) == 0
        finally:
            process.kill()
    assert not link.is_symlink()


def cpu_s(pid: int) -> float:
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) / 1e9


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="needs the scheduler's statistics")
def test_program_needs_little_of_a_core(program: tuple[subprocess.Popen[str], Path]) -> None:
    process, folder = program
    assert process.stdout is not None
    path = process.stdout.readline().strip()
    with Port(path, 115200, timeout=DEADLINE_S) as port, contextlib.closing(LineSocket(folder / "t")) as truth:
        expect(port, BANNER)
        shares = []
        for command in (b"", b"G1X-100F3000\n"):
            port.write(command)
            begin, used = time.monotonic(), cpu_s(process.pid)
            while truth.read()["t"] < begin + 1.0:
                pass
            used = cpu_s(process.pid) - used
            shares.append(used / (time.monotonic() - begin))
    print(f"share of a core at rest {shares[0]:.3%}, moving {shares[1]:.3%}")
    assert shares[0] < 0.03
    assert shares[1] < 0.15


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--set", "99=1"], "GRBL 1.1 has no setting $99"),
        (["--set", "22=0"], "$20=1 is refused with error:10"),
        (["--set", "100=0"], "$100=0: a machine is built with more than 0 steps per mm"),
        (["--set", "110=1e999"], "$110=1e999 is above 3.4e+38"),
        (["--settings", "no-such-file"], "No such file"),
        (["--truth-socket", f"/tmp/{'x' * 200}"], f"/tmp/{'x' * 200}: a socket's path may have 107 bytes"),
        (["--settings", sys.executable], f"{sys.executable} is no text"),
    ],
)
def test_program_refuses_bad_arguments(arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert sentence in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["--time-scale", "0"],
        ["--baud", "17"],
        ["--start", "1,2"],
        ["--start", "nan,0,0"],
        ["--start", "1e308,0,0"],
        ["--bogus"],
    ],
)
def test_program_refuses_values_out_of_bounds(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert arguments[-1] in capsys.readouterr().err


def test_program_takes_a_negative_start_behind_a_blank(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--start", "-180,-110,-5", "--set", "99=1"]) == 2
    assert capsys.readouterr().err == "error: GRBL 1.1 has no setting $99\n"


@pytest.mark.parametrize("text", ["a,b,c", "", "1,,2"])
def test_program_tells_the_form_of_a_start_that_is_no_numbers(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--start", text])
    assert f"{text!r} is not of the form X,Y,Z in mm" in capsys.readouterr().err


def test_program_leaves_a_file_in_the_links_place_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for option in ("--link", "--truth-socket"):
        (tmp_path / "precious").write_text("data")
        assert main(["--control-socket", str(tmp_path / "c"), option, str(tmp_path / "precious")]) == 2
        assert "exists and is not a" in capsys.readouterr().err
        assert (tmp_path / "precious").read_text() == "data"
        assert sorted(path.name for path in tmp_path.iterdir()) == ["precious"]


@pytest.mark.parametrize("option", ["--link", "--truth-socket", "--control-socket", "--log"])
def test_program_makes_no_folder(option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a misspelt path it would serve where no client connects."""
    assert main(["--link", str(tmp_path / "port"), option, str(tmp_path / "nope" / "x")]) == 2
    expected = f"error: {option} {tmp_path}/nope/x: there is no folder {tmp_path}/nope\n"
    assert capsys.readouterr() == ("", expected)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", ["--truth-socket", "--control-socket"])
def test_program_names_a_socket_that_cannot_be(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([option, "/proc/socket"]) == 2
    assert capsys.readouterr() == ("", "error: /proc/socket: No such file or directory\n")
