"""Ctrl-C, a reader that has gone, and a full disk, end the command line programs without a traceback."""

from __future__ import annotations

import errno
import io
import os
import re
import signal
import subprocess
import sys
from importlib import import_module
from operator import itemgetter
from pathlib import Path

import pytest

from icu_common.adapters.processes.program_end import INTERRUPTED, UNREAD, UNWRITTEN, ends_quietly

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[4]
BAG = str(ROOT / "tests" / "golden" / "bag")


def programs() -> list[str]:
    """Return the modules of all command line programs that packages install."""
    lines = [line for path in ROOT.glob("src/*/setup.py") for line in path.read_text().splitlines() if " = " in line]
    return sorted({line.split("=")[1].split(":")[0].strip() for line in lines if ".cli." in line or "foxglove" in line})


@pytest.mark.parametrize("module", programs())
def test_every_program_ends_quietly(module: str) -> None:
    assert hasattr(import_module(module).main, "__wrapped__")


def entries() -> list[str]:
    """Return the modules that console scripts of all packages start; the mock board shares no code with the rest."""
    found = re.findall(r'"\w+ = ([\w.]+):', "".join(path.read_text() for path in ROOT.glob("src/*/setup.py")))
    return sorted({module for module in found if ".mock." not in module})


INTERRUPTED_IMPORT = """
import sys
class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if name in ("argparse", "numpy", "rclpy"):
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupts())
import importlib
importlib.import_module(sys.argv[1])
"""


@pytest.mark.parametrize("module", entries())
def test_ctrl_c_while_libraries_are_imported_is_told_in_one_line(module: str) -> None:
    """Which takes a second or more, before ``main`` is there to be called."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED_IMPORT, module], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "interrupted\n")


WITHOUT_ROS = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.startswith("rclpy") or name.partition(".")[0].endswith(("_msgs", "_srvs", "_interfaces")):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Missing())
import importlib
importlib.import_module(sys.argv[1])
"""
NEED_NO_ROS = {
    *(f"harris_perception.cli.{name}" for name in ("calibrate", "hand_eye", "harris", "panel_teach", "stereo")),
    *(
        "gantry_driver.cli.gantry_gcode",
        "gantry_driver.cli.gantry_guard",
        "icu_bringup.cli.bag_export",
        "icu_bringup.cli.bag_info",
        "icu_bringup.cli.bring_up",
        "icu_simulator.cli.render",
    ),
    "scope_ui_bridge.cli.page_admin",
}


@pytest.mark.parametrize("module", entries())
def test_without_a_ros_environment_one_line_says_what_to_source(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_ROS, module], capture_output=True, text=True, timeout=60, check=False
    )
    if module in NEED_NO_ROS:
        assert (done.returncode, done.stderr) == (0, "")
    else:
        told = rf"error: No module named '[\w.]+' for {re.escape(sys.executable)}: source ROS 2 first .*\n"
        assert done.returncode == 1 and re.fullmatch(told, done.stderr), done.stderr
        assert "/opt/ros/jazzy/setup.bash" in done.stderr and "scripts/setup.sh" in done.stderr


def test_another_module_that_is_missing_is_no_matter_of_ros() -> None:
    script = WITHOUT_ROS.replace('name.startswith("rclpy")', 'name == "yaml"')
    done = subprocess.run(
        [sys.executable, "-c", script, "harris_perception.cli.harris"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1 and "Traceback" in done.stderr and "No module named 'yaml'" in done.stderr


def test_ctrl_c_is_told_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    @ends_quietly
    def main() -> int:
        raise KeyboardInterrupt

    assert main() == INTERRUPTED
    assert capsys.readouterr().err == "interrupted\n"


def test_closed_output_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """As Python has it behind ``>&-``."""

    @ends_quietly
    def main() -> int:
        print("not read")
        return 0

    monkeypatch.setattr(sys, "stdout", None)
    assert main() == 0


def test_a_name_that_is_no_utf8_is_printed_as_on_standard_error(monkeypatch: pytest.MonkeyPatch) -> None:
    @ends_quietly
    def main() -> int:
        print("caf\udce9.png")
        return 0

    printed = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(printed, "utf-8"))
    assert main() == 0
    assert printed.getvalue() == b"caf\\udce9.png\n"


HELP, AUDIT = ["gantry_driver.nodes.sequence_node", "--help"], ["scope_ui_bridge.cli.page_admin", "audit", os.devnull]
UNBUFFERED = pytest.mark.parametrize("unbuffered", ["", "1"])


def printed_into(output: int, program: list[str], unbuffered: str) -> subprocess.CompletedProcess[str]:
    """Run a program whose standard output is that descriptor, which is closed here afterwards."""
    try:
        return subprocess.run(
            [sys.executable, "-m", *program],
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            stdout=output,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            check=False,
        )
    finally:
        os.close(output)


@UNBUFFERED
@pytest.mark.parametrize("program", [["harris_perception.cli.panel_teach", "--help"], HELP, AUDIT], ids=itemgetter(0))
def test_nobody_reads_what_is_printed(program: list[str], unbuffered: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = printed_into(writing, program, unbuffered)
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr, done.stderr
    assert done.returncode in (0, 1, UNREAD)


@UNBUFFERED
@pytest.mark.parametrize("program", [["icu_bringup.cli.bag_info", BAG], HELP, AUDIT], ids=itemgetter(0))
def test_a_full_disk_is_told_in_one_line(program: list[str], unbuffered: str) -> None:
    done = printed_into(os.open("/dev/full", os.O_WRONLY), program, unbuffered)
    assert done.stderr.count("\n") == 1 and "No space left on device" in done.stderr
    assert done.returncode in (1, UNWRITTEN)


@pytest.mark.parametrize("program", ["gantry_driver.cli.gantry_goal 0 0", "gantry_driver.nodes.sequence_node"])
@pytest.mark.parametrize("folder", ["/proc/new", "/proc/self/attr"])
def test_a_folder_for_logs_that_cannot_be_is_told_in_one_line(program: str, folder: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", *program.split()],
        env={**os.environ, "ROS_LOG_DIR": folder},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert folder in done.stderr and "ROS_LOG_DIR names another folder for logs" in done.stderr
    assert done.returncode == 2


@pytest.mark.parametrize(
    ("program", "strange"),
    [
        (["gantry_driver.nodes.serial_driver_node", "--params-file", "driver.yaml"], "--params-file"),
        (["gantry_driver.nodes.sequence_node", "--ros-args", "-r", "__ns:=/a", "--", "bed_1"], "bed_1"),
    ],
    ids=["before --ros-args", "behind --"],
)
def test_what_a_node_would_not_hear_is_refused(program: list[str], strange: str) -> None:
    """A driver that is given its parameters without ``--ros-args`` would open another port, without a word."""
    done = subprocess.run([sys.executable, "-m", *program], capture_output=True, text=True, timeout=60, check=False)
    assert done.stderr == f"error: {strange!r}: a node takes only what follows --ros-args; see --help\n"
    assert (done.returncode, done.stdout) == (2, "")


@pytest.mark.parametrize(("code", "end"), [(0, UNWRITTEN), (3, 3)])
def test_a_full_disk_makes_no_success(
    code: int, end: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @ends_quietly
    def main() -> int:
        print("not written")
        return code

    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main() == end
    assert capsys.readouterr().err == "error: standard output: No space left on device\n"


@pytest.mark.parametrize(
    "error", [PermissionError(errno.EACCES, "not allowed"), OSError(errno.EIO, "the port"), OSError(errno.ENOSPC, "")]
)
@pytest.mark.parametrize("unbuffered", [False, True])
def test_what_fails_elsewhere_is_raised(
    error: OSError, unbuffered: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @ends_quietly
    def main() -> int:
        print("written")
        raise error

    with (tmp_path / "printed").open("w") as printed:
        printed.reconfigure(write_through=unbuffered)
        monkeypatch.setattr(sys, "stdout", printed)
        with pytest.raises(OSError) as raised:
            main()
    assert raised.value is error
    assert (tmp_path / "printed").read_text().rstrip() == "written"


@pytest.mark.parametrize(
    "module", ["cli.gantry_gcode", "cli.gantry_monitor", "nodes.serial_driver_node", "nodes.sequence_node"]
)
def test_a_help_has_no_marks_of_the_api_documentation(module: str) -> None:
    # As a program of its own: the driver's asks for real-time scheduling, which the tests here would keep.
    command = [sys.executable, "-m", f"gantry_driver.{module}", "--help"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    assert shown.startswith("usage: ") and "`" not in shown.split("While it runs")[0] and ":class:" not in shown
