"""docs/how-to/hardware.md: its drawing, settings and commands are those of the configuration and the programs."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import pytest

from gantry_driver.cli.gantry_gcode import read_config
from gantry_driver.core.grbl.settings_profile import parse_profile
from harris_perception.cli.calibrate import main as camera_calibration

ROOT = Path(__file__).resolve().parents[4]
PAGE = (ROOT / "docs" / "how-to" / "hardware.md").read_text()


def test_drawing_is_that_of_the_configuration() -> None:
    """After a change of the configuration: make figures."""
    drawn = runpy.run_path(str(ROOT / "scripts" / "figures" / "bench_drawing.py"))["drawing"]()
    assert (ROOT / "docs" / "how-to" / "bench.svg").read_text() == drawn
    for words in ("360 mm, $130", "220 mm, $131", "120 mm baseline", "665 mm, 25 deg from below", "panel 320 x 150 mm"):
        assert words in drawn


def test_settings_are_those_that_the_driver_requires() -> None:
    blocks = re.findall(r"```text\n((?:\$.*\n)+)```", PAGE)
    params = [ROOT / "config" / "params" / name for name in ("serial_driver.yaml", "hardware.yaml")]
    wanted = read_config(params).expected_settings()
    assert parse_profile(blocks[0].splitlines()) == wanted
    assert not parse_profile(blocks[1].splitlines()).keys() & wanted.keys()


def test_sum_of_the_prices_is_that_of_the_rows() -> None:
    section = PAGE.partition("## Parts to buy")[2].partition("\n## ")[0]
    rows = re.findall(r"\| (\d+)(?: set)? \| (\d+) to (\d+) \|", section)
    assert len(rows) == 14
    low, high = (sum(int(row[0]) * int(row[column]) for row in rows) for column in (1, 2))
    told = re.search(r"about (\d+) to (\d+) euros", section)
    assert told and int(told[1]) == pytest.approx(low, rel=0.02) and int(told[2]) == pytest.approx(high, rel=0.02)


def test_commands_print_true_size_pdfs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^camera_calibration .*$", PAGE, re.MULTILINE)
    assert len(commands) == 2
    for command in commands:
        assert camera_calibration(shlex.split(command)[1:]) == 0
    boxes = [re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", path.read_bytes()) for path in tmp_path.glob("*.pdf")]
    a4 = (297 / 25.4 * 72, 210 / 25.4 * 72)
    assert [tuple(map(float, box[0])) for box in boxes] == [pytest.approx(a4)] * 2
