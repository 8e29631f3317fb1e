"""Output of bring_up for a person: on a terminal one moving line, then a box that stays last; in a pipe plain lines."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from unit.icu_bringup.startup.small_terminal import SmallTerminal

pytestmark = pytest.mark.slow

DEADLINE_S = 60.0
COLUMNS, ROWS = 100, 40
ADDRESS = "http://127.0.0.1:9/?token=first"
GRAPH = """\
scope: dial
profiles: {bench: {about: a machine and its page}}
programs:
  mock_grbl: {package: p, executable: mock_grbl, ros: false, ends_last: true, arguments: [/tmp/a board]}
  serial_driver: {package: p, executable: driver, set: {port: /tmp/a board}}
  ui_bridge: {package: p, executable: ui_bridge, ros: false}
"""
RUNS = """\
#!/bin/sh
trap 'exit 0' INT TERM
"""
STAYS = "while true; do sleep 0.05; done\n"
PAGE = f"""\
{RUNS}
trap 'echo "Operator page: http://127.0.0.1:9/?token=second"' USR1
echo "[WARN] a warning"
echo "Operator page: {ADDRESS}"
echo $$ > "$FOLDER/page.pid"
{STAYS}"""
DRIVER = f"""\
{RUNS}
eval "echo 1 >&$ICU_READY_FD"
while true; do
  if [ -e "$FOLDER/crash" ]; then rm "$FOLDER/crash"; kill -KILL $$; fi
  sleep 0.05
done
"""
PREPARE = """\
#!/bin/sh
trap 'exit 1' INT TERM
echo x >> "$FOLDER/prepared"
echo "$@" > "$FOLDER/prepare_arguments"
echo '{"stage": "connecting"}'
echo '{"stage": "homing", "text": "homing: homing"}'
until [ -e "$FOLDER/homed" ]; do sleep 0.02; done
echo '{"stage": "calibrating", "text": "calibrating 12/24", "done": 12, "total": 24}'
until [ -e "$FOLDER/end" ]; do sleep 0.02; done
if [ "$(cat "$FOLDER/end")" = ready ]; then echo '{"stage": "ready"}'; exit 0; fi
cause=$(cat "$FOLDER/end")
rm "$FOLDER/end"
echo '{"stage": "failed", "failed_at": "calibrating", "cause": "'$cause'", "text": "the panel was not seen"}'
exit 1
"""


class Demo:
    """bring_up with programs of a few lines, on a terminal or in a pipe."""

    def __init__(self, folder: Path, *, terminal: bool, more: tuple[str, ...] = ()) -> None:
        self.folder = folder
        for name in ("config/scopes", "lib/p", "lib/gantry_driver"):
            (folder / name).mkdir(parents=True)
        (folder / "config" / "graph.yaml").write_text(GRAPH)
        (folder / "config" / "scopes" / "dial.yaml").touch()
        programs = {"p/mock_grbl": RUNS + STAYS, "p/driver": DRIVER, "p/ui_bridge": PAGE}
        for name, text in {**programs, "gantry_driver/gantry_prepare": PREPARE}.items():
            (folder / "lib" / name).write_text(text)
            (folder / "lib" / name).chmod(0o755)
        environment = {**os.environ, "AMENT_PREFIX_PATH": str(folder), "FOLDER": str(folder), "TERM": "xterm"}
        environment |= {"ROS_DOMAIN_ID": "7", "PYTHONIOENCODING": "utf-8"}
        command = [sys.executable, "-m", "icu_bringup.cli.bring_up", "--config", str(folder / "config"), "--prepare"]
        command += ["--state", str(folder / "state"), "--namespace", f"terminal_{os.getpid()}", *more]
        self.written = b""
        self.master, other = pty.openpty() if terminal else os.pipe()
        if terminal:
            fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
            settings = termios.tcgetattr(other)
            settings[3] |= termios.NOFLSH  # otherwise Ctrl-C discards what the terminal has not shown yet
            termios.tcsetattr(other, termios.TCSANOW, settings)
        stdin = other if terminal else subprocess.DEVNULL
        self.process = subprocess.Popen(
            command,
            env=environment,
            stdin=stdin,
            stdout=other,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            preexec_fn=(lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0)) if terminal else None,
        )
        os.close(other)

    @property
    def text(self) -> str:
        return self.written.decode(errors="ignore")

    @property
    def screen(self) -> list[str]:
        return SmallTerminal(COLUMNS, ROWS).write(self.text.replace("\r\n", "\n\r")).screen

    @property
    def notes(self) -> list[str]:
        """The texts next to the QR code."""
        return [row.strip("│ ").rpartition("  ")[2].strip() for row in self.screen if row.startswith("│")]

    def read(self, timeout_s: float) -> bool:
        """Read what has come; return False at the end."""
        if select.select([self.master], [], [], timeout_s)[0]:
            try:
                data = os.read(self.master, 65536)
            except OSError:
                return False
            self.written += data
            return bool(data)
        return True

    def until(self, condition: Callable[[], object]) -> None:
        end = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < end and self.read(0.05), f"not seen; the screen: {self.screen}\n{self.text!r}"

    def until_last(self, text: str) -> None:
        """Wait until a row of the block at the bottom has a text."""
        self.until(lambda: any(text in row for row in self.screen[-30:]))

    def say(self, text: str) -> None:
        os.write(self.master, text.encode())

    def ended(self) -> int:
        end = time.monotonic() + DEADLINE_S
        while self.process.poll() is None or self.read(0.0):
            if not self.read(0.05) and self.process.poll() is not None:
                break
            assert time.monotonic() < end, self.text
        return self.process.wait(DEADLINE_S)

    def let(self, name: str, text: str = "") -> None:
        (self.folder / f"{name}.new").write_text(text)
        (self.folder / f"{name}.new").rename(self.folder / name)


@pytest.fixture
def tmp_path() -> Iterator[Path]:
    """A folder whose path is short: with that of the log a row of the terminal would be wrapped."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@contextlib.contextmanager
def demo(folder: Path, *, terminal: bool = True, more: tuple[str, ...] = ()) -> Iterator[Demo]:
    run = Demo(folder, terminal=terminal, more=more)
    try:
        yield run
    finally:
        run.process.kill()
        run.process.wait()
        os.close(run.master)


def log_of(folder: Path) -> str:
    return (folder / "state" / "logs" / "bring_up.log").read_text()


def test_one_line_moves_and_then_a_box_stays_the_last_thing(tmp_path: Path) -> None:
    with demo(tmp_path) as run:
        run.until_last("homing")
        assert [row for row in run.screen if row] == ["homing"], "one line"
        run.let("homed")
        run.until_last("calibrating 12/24")
        assert [row for row in run.screen if row] == ["[##########..........] calibrating 12/24"]
        run.let("end", "ready")
        run.until_last("└")
        box = run.screen
        assert any("homed and calibrated" in row for row in box)
        assert ADDRESS in box[1] and box[0].startswith("┌") and box[-1].startswith("└")
        assert any("▀" in row for row in box), "the code"
        assert any(f"Log: {tmp_path}/state/logs/bring_up.log" in row for row in box)
        run.let("crash")
        run.until(lambda: "serial_driver ! ended with signal SIGKILL" in run.text)
        run.until(lambda: run.screen[-len(box) :] == box)
        assert "serial_driver ! ended with signal SIGKILL" in run.screen[-len(box) - 1]
        os.kill(int((tmp_path / "page.pid").read_text()), signal.SIGUSR1)
        run.until_last("token=second")
        assert not any(ADDRESS in row for row in run.screen), "an address signs in once"
        run.say("\x03")
        assert run.ended() == 0
    assert [row for row in run.screen if row][-1] == "ending every program"
    assert "a warning" not in run.text and "a warning" in log_of(tmp_path)


def test_in_a_pipe_there_are_plain_lines_with_the_address_and_ready(tmp_path: Path) -> None:
    with demo(tmp_path, terminal=False) as run:
        run.let("homed")
        run.until(lambda: "calibrating 12/24" in run.text)
        run.let("end", "ready")
        run.until(lambda: "Ctrl-C ends every program." in run.text)
        run.process.send_signal(signal.SIGINT)
        assert run.ended() == 0
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f]", run.text), "no control codes"
    lines = run.text.splitlines()
    assert f"        ui_bridge | Operator page: {ADDRESS}" in lines and "        ui_bridge | [WARN] a warning" in lines
    assert f"Ready. Open {ADDRESS}" in lines and lines[-1] == "ending every program"
    assert "         progress | calibrating 12/24" in lines
    assert (tmp_path / "prepare_arguments").read_text().startswith("--json --ros-args -r __ns:=/terminal_")


def test_a_key_repeats_a_failed_preparation_on_the_same_graph(tmp_path: Path) -> None:
    with demo(tmp_path) as run:
        run.let("homed")
        run.let("end", "refused")
        run.until(lambda: "type r and Enter here or press Calibrate on the page" in " ".join(run.notes))
        assert any("failed while calibrating: the panel was not seen" in row for row in run.screen)
        run.until_last(ADDRESS)
        page = (tmp_path / "page.pid").read_text()
        run.say("x\n")
        run.until(lambda: "x\r\n" in run.text)
        run.let("end", "ready")
        assert (tmp_path / "prepared").read_text() == "x\n", "another key repeats nothing"
        run.say("r\n")
        run.until_last("homed and calibrated")
        assert not any("type r" in row for row in run.screen[-25:])
        assert (tmp_path / "prepared").read_text() == "x\nx\n" and (tmp_path / "page.pid").read_text() == page
        run.say("\x03")
        assert run.ended() == 0


def test_a_preparation_that_took_too_long_is_repeated_by_itself_and_not_for_ever(tmp_path: Path) -> None:
    with demo(tmp_path, terminal=False) as run:
        run.let("homed")
        for count in (1, 2):
            run.let("end", "timed_out")
            run.until(lambda count=count: f"It starts again by itself (repetition {count})." in run.text)
        run.let("end", "timed_out")
        run.until(lambda: "To repeat it, press Calibrate on the page" in run.text)
        assert run.text.count("The preparation took too long while calibrating: the panel was not seen") == 3
        run.process.send_signal(signal.SIGTERM)
        assert run.ended() == 0
    assert (tmp_path / "prepared").read_text() == "x\n" * 3


@pytest.mark.parametrize("step", ["homing", "calibrating 12/24", "homed and calibrated"])
def test_ctrl_c_ends_at_each_moment_and_a_second_one_is_harmless(step: str, tmp_path: Path) -> None:
    with demo(tmp_path) as run:
        if step != "homing":
            run.let("homed")
        if step == "homed and calibrated":
            run.let("end", "ready")
        run.until_last(step)
        run.say("\x03")
        run.until(lambda: "ending every program" in run.text)
        run.say("\x03")
        assert run.ended() == 0
    assert "Traceback" not in run.text and "killed" not in run.text
