"""The detector and the GRBL client, each installed by pip alone in a new virtual environment without ROS.

No network is needed: the environment shares the libraries that `setup.py` names, and those that they need, with this
one. Everything else, ROS above all, cannot be imported there.
"""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
import setuptools
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[3]
BUILDERS = ("setuptools", "wheel")
"""Packages that pip needs to install a folder of sources; with a network it would fetch both."""
INSTALL_WITHIN_S, RUN_WITHIN_S = 240.0, 600.0

pytestmark = [pytest.mark.timeout(900), pytest.mark.long]  # the detector is compiled in a new environment


def libraries_of(package: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the libraries that a package's `setup.py` names."""
    given: dict[str, Any] = {}
    with monkeypatch.context() as patch:
        patch.setattr(setuptools, "setup", lambda **keywords: given.update(keywords))
        runpy.run_path(str(package / "setup.py"))
    return [str(name) for name in given["extras_require"]["libraries"]]


def share(names: Iterable[str], site: Path, shared: set[str]) -> None:
    """Link installed distributions, and all that they need, into another environment's folder of libraries."""
    for name in names:
        if name in shared:
            continue
        shared.add(name)
        try:
            found = metadata.distribution(name)
        except metadata.PackageNotFoundError:
            pytest.skip(f"pip has not installed {name} here")
        for part in {file.parts[0] for file in found.files or ()} - {"..", "__pycache__"}:
            if not (site / part).exists():
                (site / part).symlink_to(Path(str(found.locate_file(part))))
        needed = [Requirement(text) for text in found.requires or ()]
        share([need.name for need in needed if not need.marker or need.marker.evaluate({"extra": ""})], site, shared)


class Environment:
    """A virtual environment with one package of this project."""

    def __init__(self, folder: Path, package: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bin = folder / "venv" / "bin"
        sources = folder / "src"
        for name in ("icu_common", package):  # building writes next to the sources
            shutil.copytree(ROOT / "src" / name, sources / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg*"))
        venv.create(folder / "venv", symlinks=True)
        site = Path(sysconfig.get_path("purelib", "venv", {"base": str(folder / "venv")}))
        libraries = [name for one in ("icu_common", package) for name in libraries_of(sources / one, monkeypatch)]
        share([*BUILDERS, *libraries], site, set())
        command = [sys.executable, "-m", "pip", "--python", str(self.bin / "python"), "install", "--no-index"]
        command += ["--no-build-isolation", "--disable-pip-version-check", "--quiet", str(sources / package)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=INSTALL_WITHIN_S, check=False)
        assert done.returncode == 0, done.stdout + done.stderr

    def run(self, code: str) -> str:
        """Run a program that can import this environment's libraries only; return what it prints."""
        command = [str(self.bin / "python"), "-I", "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, timeout=RUN_WITHIN_S, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def finds(self, *modules: str) -> dict[str, bool]:
        """Return which modules can be imported there."""
        code = f"import importlib.util as u\nprint({{name: u.find_spec(name) is not None for name in {modules!r}}})"
        return dict(eval(self.run(code)))


def example(package: str, start: str) -> str:
    """Return the example of a package's README that begins with these words."""
    for found in re.findall(r"```python\n(.*?)```", (ROOT / "src" / package / "README.md").read_text(), re.DOTALL):
        if found.startswith(start):
            return str(found)
    pytest.fail(f"the README of {package} has no example that begins with {start!r}")


def test_detector_finds_corners_and_edges_of_an_array(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = Environment(tmp_path, "harris_perception", monkeypatch)
    assert alone.finds("rclpy", "sensor_msgs", "serial", "cv2") == {
        "rclpy": False,
        "sensor_msgs": False,
        "serial": False,
        "cv2": True,
    }
    square = "import numpy as np\npicture = np.zeros((60, 60), np.uint8)\npicture[15:45, 15:45] = 200\n"
    shown = "print(sorted(corners.xy.round().astype(int).tolist()), len(edges.chains))"
    printed = alone.run(square + example("harris_perception", "from harris_perception import") + shown)
    assert printed == "[[15, 15], [15, 44], [44, 15], [44, 44]] 4\n"


def test_grbl_client_homes_a_board_and_runs_a_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    alone = Environment(tmp_path, "gantry_driver", monkeypatch)
    assert alone.finds("rclpy", "sensor_msgs", "numba", "serial") == {
        "rclpy": False,
        "sensor_msgs": False,
        "numba": False,
        "serial": True,
    }
    port = tmp_path / "grbl"
    shown = example("gantry_driver", "from gantry_driver import GrblClient")
    # A busy computer may keep the board waiting for longer than the driver's defaults allow.
    patience = "DriverConfig(heartbeat_timeout_s=2.0, status_timeout_s=10.0, hold_timeout_s=10.0)"
    assert shown.count('GrblClient("/tmp/grbl")') == 1
    shown = shown.replace('GrblClient("/tmp/grbl")', f'GrblClient("{port}", {patience})')
    board = subprocess.Popen([alone.bin / "mock_grbl", "--link", port, "--start=-350,-210,-2"], stdout=subprocess.PIPE)
    try:
        assert board.stdout is not None and board.stdout.readline() == f"{port}\n".encode()
        printed = alone.run("from gantry_driver.core.configuration.machine_config import DriverConfig\n" + shown)
    finally:
        board.terminate()
        board.communicate(timeout=20.0)
    result, place = printed.splitlines()
    assert "Outcome.REACHED" in result
    assert [round(float(value), 3) for value in place.strip("()").split(",")] == [0.02, 0.01, 0.0]
