"""Ctrl-C, and a reader that has gone, end the command line programs without a traceback."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from icu_common.adapters.program_end import INTERRUPTED, UNREAD, ends_quietly

ROOT = Path(__file__).resolve().parents[3]
OTHERWISE = {"bring_up", "composed", "foxglove_sidecar"}
"""They run nodes, which end by the runtime's own handlers."""


def programs() -> list[str]:
    """Return the modules of all command line programs that packages install."""
    lines = [line for path in ROOT.glob("src/*/setup.py") for line in path.read_text().splitlines() if ".cli." in line]
    return sorted({line.split("=")[1].split(":")[0].strip() for line in lines})


@pytest.mark.parametrize("module", [m for m in programs() if m.rpartition(".")[2] not in OTHERWISE])
def test_every_program_ends_quietly(module: str) -> None:
    assert hasattr(import_module(module).main, "__wrapped__")


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


@pytest.mark.parametrize("buffered", ["", "1"])
@pytest.mark.parametrize(
    "program",
    [
        ["harris_perception.cli.panel_teach", "--help"],
        ["gantry_driver.nodes.sequence_node", "--help"],
        ["scope_ui_bridge.cli.page_admin", "audit", os.devnull],
    ],
    ids=lambda program: program[0],
)
def test_nobody_reads_what_is_printed(program: list[str], buffered: str) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    try:
        done = subprocess.run(
            [sys.executable, "-m", *program],
            env={**os.environ, "PYTHONUNBUFFERED": buffered},
            stdout=writing,
            stderr=subprocess.PIPE,
            text=True,
            timeout=120,
            check=False,
        )
    finally:
        os.close(writing)
    assert "Traceback" not in done.stderr and "Exception ignored" not in done.stderr, done.stderr
    assert done.returncode in (0, 1, UNREAD)
