"""The command blocks of the tutorials are executed, and their output is compared with what the text shows.

A block marked ``bash`` is executed, in the order of the page and in one shell. A block marked ``text`` has lines of the
output of the block before it; ``...`` in it means any text. docs/tutorials/first-press.md needs the whole graph: see
tests/system/graph/test_first_press.py.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from icu_common.core.panel.panel_layout import load_layout

ROOT = Path(__file__).resolve().parents[3]
TUTORIALS = ROOT / "docs" / "tutorials"
PATIENT = ROOT / "tests/nodes/driver/patient_driver.yaml"
WITHIN_S = 400.0
pytestmark = pytest.mark.timeout(600)


def blocks(page: str) -> list[tuple[str, str]]:
    """Return kind and text of the marked blocks of a tutorial."""
    text = (TUTORIALS / page).read_text(encoding="utf-8")
    return re.findall(r"^```(bash|text|python)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def steps(page: str) -> list[tuple[str, list[str]]]:
    """Return each block of commands with the lines of output that the page shows after it."""
    found: list[tuple[str, list[str]]] = []
    for kind, body in blocks(page):
        if kind != "text":
            found.append((body if kind == "bash" else "", []))
        else:
            found[-1][1].extend(body.splitlines())
    return [(commands, lines) for commands, lines in found if commands]


def programs(folder: Path) -> Path:
    """Write the programs of all packages, as colcon does, for this interpreter."""
    folder.mkdir()
    for setup in ROOT.glob("src/*/setup.py"):
        for name, module in re.findall(r'"(\w+) = ([\w.]+):main"', setup.read_text(encoding="utf-8")):
            # On a busy computer a board may be silent for seconds.
            patience = f' --params "{PATIENT}"' if name == "gantry_gcode" else ""
            program = folder / name
            program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m {module} "$@"{patience}\n')
            program.chmod(0o755)
    return folder


def execute(page: str, folder: Path, **replaced: str) -> list[str]:
    """Execute the commands of a tutorial in a folder and compare what they print; return the whole output."""
    script = ["exec 2>&1", "trap 'kill $(jobs -p) 2> /dev/null || true' EXIT"]
    for index, (commands, _) in enumerate(steps(page)):
        script.append(f"echo '== {index}'")
        for line in commands.rstrip().splitlines():
            script.append(line)
            if line.endswith(" &"):  # a reader waits for the printed port
                script.append('until [ -e "$PORT" ]; do sleep 0.1; done')
    text = "\n".join(script) + "\n"
    for old, new in replaced.items():
        text = text.replace(old, new)
    environment = {**os.environ, "PATH": f"{programs(folder / 'programs')}:{os.environ['PATH']}"}
    # As at a terminal: each line is printed at once, and the installed configuration is found.
    environment |= {"PYTHONUNBUFFERED": "1", "ICU_CONFIG": str(ROOT / "config"), "PORT": str(folder / "grbl")}
    shell = subprocess.Popen(
        ["bash", "-euo", "pipefail", "-c", text],
        cwd=folder,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        output, _ = shell.communicate(timeout=WITHIN_S)
    except subprocess.TimeoutExpired:
        os.killpg(shell.pid, signal.SIGKILL)
        output, _ = shell.communicate()
        pytest.fail(f"not within {WITHIN_S:g} s: {output}")
    assert shell.returncode == 0, output
    printed = output.splitlines()
    for index, (commands, lines) in enumerate(steps(page)):
        at = printed.index(f"== {index}")
        for line in lines:
            shown = line
            for old, new in replaced.items():
                shown = shown.replace(old, new)
            pattern = ".*".join(map(re.escape, shown.split("...")))
            found = [n for n in range(at, len(printed)) if re.fullmatch(pattern, printed[n])]
            assert found, f"{line!r} is not printed after {commands!r}: {output}"
            at = found[0]
    return printed


def test_tutorial_on_a_grbl_board(tmp_path: Path) -> None:
    printed = execute("grbl-terminal.md", tmp_path, **{"/tmp/grbl": str(tmp_path / "grbl")})
    states = [line for line in printed if line in ("homing", "idle", "moving")]
    assert states[:3] == ["homing", "idle", "moving"] and states[-1] == "idle"


def test_tutorial_on_corners(tmp_path: Path) -> None:
    printed = execute("detect-corners.md", tmp_path)
    counts = [int(line.split()[0]) for line in printed if re.match(r"\d+ corners", line)]
    assert len(counts) == 4 and 700 < counts[0] < 1500, "the page says about 1055"
    assert counts[1] == 200 == len((tmp_path / "corners.csv").read_text().splitlines()) - 1
    plain = cv2.imread(str(tmp_path / "picture.png"))
    for name in ("corners", "repeatable", "edges"):
        drawn = cv2.imread(str(tmp_path / f"{name}.png"))
        assert plain is not None and drawn is not None, name
        assert drawn.shape == plain.shape and (drawn != plain).any(), name
    example = next(body for kind, body in blocks("detect-corners.md") if kind == "python")
    shown = [body.strip() for kind, body in blocks("detect-corners.md") if kind == "text"][-1]
    path = re.search(r"PYTHONPATH=(\S+)", (TUTORIALS / "detect-corners.md").read_text())
    assert path is not None
    (tmp_path / "corners.py").write_text(example)
    done = subprocess.run(
        [sys.executable, "corners.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(str(ROOT / part) for part in path[1].split(":"))},
        capture_output=True,
        text=True,
        timeout=WITHIN_S,
        check=True,
    )
    assert re.fullmatch(".*".join(map(re.escape, shown.split("..."))), done.stdout.strip()), done.stdout


def test_tutorial_on_an_own_instrument(tmp_path: Path) -> None:
    (tmp_path / "config").symlink_to(ROOT / "config")
    execute("own-instrument.md", tmp_path)
    taught = load_layout(tmp_path / "my_scopes" / "my_ventilator.yaml")
    truth = load_layout(ROOT / "config" / "scopes" / "ventilator_v1.yaml")
    errors = {c.name: np.subtract(c.position_mm, truth.control(c.name).position_mm) for c in taught.controls}
    assert len(errors) == 4
    assert max(np.hypot(*error) for error in errors.values()) < 0.5, f"the page says at most 0.4 mm: {errors}"
    template = cv2.imread(str(tmp_path / "my_scopes" / "my_ventilator.png"), cv2.IMREAD_GRAYSCALE)
    assert template is not None and template.shape == (4 * 190, 4 * 320)
    text = yaml.safe_load((tmp_path / "my_scopes" / "my_ventilator.yaml").read_text())
    assert text["size_mm"] == [320.0, 190.0]
