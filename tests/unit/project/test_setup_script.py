"""scripts/setup.sh with a Python that only pretends: one sentence for what is wrong, and Ctrl-C leaves no process."""

from __future__ import annotations

import os
import pty
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from support.deadlines import wait_until

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
DEADLINE_S = 60.0
PYTHON = """\
#!/bin/bash
# Pretends to be a Python: it has a version, makes environments, and its other programs do nothing.
case "$*" in
  *version_info*) echo "${FAKE_VERSION:-3.11}" ;;
  "-m venv "*)
    echo venv >> "$FAKE/calls"
    if [ -n "${FAKE_SLOW_VENV:-}" ]; then sleep 1000 & echo $! > "$FAKE/child"; wait; fi
    if [ -n "${FAKE_NO_VENV:-}" ]; then echo "ensurepip is not available"; exit 1; fi
    mkdir -p "${@: -1}/bin"
    cp "$0" "${@: -1}/bin/python"
    cp "$FAKE/pip" "${@: -1}/bin/pip" ;;
  *sysconfig*) mkdir -p "$FAKE/purelib"; echo "$FAKE/purelib" ;;
  *colcon*) mkdir -p install; echo colcon >> "$FAKE/calls" ;;
  *) ;;
esac
"""
PIP = """\
#!/bin/bash
echo "pip $*" >> "$FAKE/calls"
if [ -n "${FAKE_SLOW_PIP:-}" ]; then trap '' INT; sleep 1000 & echo $! > "$FAKE/child"; wait; fi
echo "Collecting numpy"
if [ -n "${FAKE_PIP_SAYS:-}" ]; then echo "$FAKE_PIP_SAYS"; exit 1; fi
echo "Successfully installed numpy"
"""


class Folder:
    """A copy of the files that the script reads."""

    def __init__(self, folder: Path) -> None:
        self.root, self.fake = folder / "robot", folder / "fake"
        (self.root / "scripts").mkdir(parents=True)
        (self.root / "ros2_ws").mkdir()
        self.fake.mkdir()
        shutil.copy(ROOT / "scripts" / "setup.sh", self.root / "scripts")
        for path in (*ROOT.glob("requirements*.txt"), *ROOT.glob("src/*/package.xml"), *ROOT.glob("src/*/setup.*")):
            to = self.root / path.relative_to(ROOT)
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, to)
        for folder in ("config", "src/harris_perception/harris_perception/core", "src/gantry_driver/launch"):
            (self.root / folder).mkdir(parents=True)
        (self.root / "src/harris_perception/harris_perception/core/kernel.py").touch()
        for name, text in (("python3.11", PYTHON), ("pip", PIP)):
            (self.fake / name).write_text(text)
            (self.fake / name).chmod(0o755)

    def start(self, terminal: bool = False, **variables: str) -> subprocess.Popen[bytes]:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("ROS_")}
        environment |= {"PYTHON": str(self.fake / "python3.11"), "FAKE": str(self.fake), "TERM": "xterm", **variables}
        output: int = subprocess.PIPE
        if terminal:
            self.master, output = pty.openpty()
        process = subprocess.Popen(
            ["bash", str(self.root / "scripts/setup.sh")],
            env=environment,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        if terminal:
            os.close(output)
        return process

    def run(self, **variables: str) -> tuple[int, str]:
        with self.start(**variables) as process:
            out, _ = process.communicate(timeout=DEADLINE_S)
        return process.returncode, out.decode()

    @property
    def calls(self) -> list[str]:
        return (self.fake / "calls").read_text().splitlines() if (self.fake / "calls").exists() else []


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path)


def test_without_a_terminal_each_step_is_a_plain_line(folder: Folder) -> None:
    code, output = folder.run()
    assert code == 0, output
    assert "\x1b" not in output and "\r" not in output
    steps = [line for line in output.splitlines() if line.startswith("[")]
    assert [line[:5] for line in steps if not line.startswith("[3/4]")] == ["[1/4]", "[2/4]", "[2/4]", "[4/4]"]
    assert folder.run()[1] == "", "a second time nothing is left to do"


def test_on_a_terminal_one_line_moves(folder: Folder) -> None:
    with folder.start(terminal=True) as process:
        written = b""
        while True:
            try:
                data = os.read(folder.master, 65536)
            except OSError:
                break
            if not data:
                break
            written += data
        assert process.wait(DEADLINE_S) == 0
    os.close(folder.master)
    assert b"\n" not in written and written.endswith(b"\r\x1b[K"), written
    shown = written.decode().split("\r\x1b[K")
    assert "set-up [2/4] Collecting numpy" in shown and any(line.startswith("set-up [4/4] colcon") for line in shown)


@pytest.mark.parametrize(
    ("variables", "sentence"),
    [
        ({"FAKE_VERSION": "3.9"}, "is Python 3.9, and rclpy needs 3.10 to 3.13; "),
        ({"FAKE_VERSION": "3.15"}, "is Python 3.15, and rclpy needs 3.10 to 3.13; "),
        (
            {"FAKE_NO_VENV": "1"},
            "cannot make a virtual environment; install what it lacks: sudo apt install python3.11-venv",
        ),
        (
            {"FAKE_PIP_SAYS": "WARNING: Retrying after connection broken by 'NewConnectionError('"},
            "no connection to the Python package index; connect to the network",
        ),
        ({"FAKE_PIP_SAYS": "ERROR: [Errno 28] No space left on device"}, "is full; free 1000 MB"),
        ({"FAKE_PIP_SAYS": "ERROR: No matching distribution"}, "pip could not install requirements-python.txt; "),
    ],
)
def test_what_is_wrong_is_one_sentence_with_a_command(variables: dict[str, str], sentence: str, folder: Folder) -> None:
    code, output = folder.run(**variables)
    errors = [line for line in output.splitlines() if line.startswith("error: ")]
    assert code == 1 and len(errors) == 1 and sentence in errors[0], output
    assert "make demo" in errors[0]
    assert folder.run()[0] == 0, "the next run goes on once that is mended"


def test_a_disk_without_space_is_told_before_anything_is_installed(folder: Folder) -> None:
    (folder.fake / "df").write_text("#!/bin/sh\necho head\necho disk 9 9 70 9% /\n")
    (folder.fake / "df").chmod(0o755)
    code, output = folder.run(PATH=f"{folder.fake}:{os.environ['PATH']}")
    assert code == 1 and "is full: 70 MB are free; expected 1000 MB" in output
    assert folder.calls == []


@pytest.mark.parametrize("step", ["FAKE_SLOW_VENV", "FAKE_SLOW_PIP"])
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_ends_every_child_and_the_next_run_recovers(step: str, how: signal.Signals, folder: Folder) -> None:
    with folder.start(**{step: "1"}) as process:

        def started() -> str:
            assert process.poll() is None
            return (folder.fake / "child").read_text().strip() if (folder.fake / "child").exists() else ""

        child = int(wait_until(started, "the step has started", DEADLINE_S))
        begun = time.monotonic()
        process.send_signal(how)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == (130 if how == signal.SIGINT else 143)
        assert time.monotonic() - begun < 20.0
    assert b"Traceback" not in output and b"error" not in output

    def ended() -> bool:
        try:
            return Path(f"/proc/{child}/stat").read_text().rpartition(")")[2][1] == "Z"
        except (FileNotFoundError, ProcessLookupError):
            return True

    wait_until(ended, "the child has ended", DEADLINE_S)
    code, text = folder.run()
    assert code == 0, text
