"""docs/tutorials/first-press.md: its commands on the whole graph, and their output as the page shows it."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "tutorials" / "first-press.md"

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(600)]


def commands_and_lines() -> list[tuple[list[str], list[str]]]:
    """Return the commands of each block that calls gantry_goal, and the lines that the page shows after it."""
    found: list[tuple[list[str], list[str]]] = []
    for kind, body in re.findall(r"^```(bash|text)\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE):
        if kind == "bash":
            found.append(([line for line in body.splitlines() if line.startswith("gantry_goal ")], []))
        else:
            found[-1][1].extend(body.splitlines())
    return [pair for pair in found if pair[0]]


def test_commands_of_the_tutorial_print_what_it_shows(running_graph: Any) -> None:
    bench, start = running_graph.bench(), len(running_graph.truth_log())
    before = bench.ask(do="truth")["instrument"]["running"]
    codes = []
    for commands, lines in commands_and_lines():
        printed: list[str] = []
        for command in commands:
            name, *arguments = shlex.split(command, comments=True)
            done = running_graph.command("gantry_driver", name, *arguments, within_s=120.0)
            codes.append(done.returncode)
            printed += (done.stdout + done.stderr).splitlines()
        for line in lines:
            pattern = ".*".join(map(re.escape, line.split("...")))
            assert any(re.fullmatch(pattern, text) for text in printed), f"{line!r} is not in {printed}"
    assert codes == [0, 0, 1]
    assert [e["control"] for e in running_graph.truth_log()[start:] if e["event"] == "press"] == ["RUN_STOP"]
    truth = bench.ask(do="truth")["instrument"]
    assert truth["running"] is (not before)
    assert dict(truth["knobs"])["CH2_SCALE"] == pytest.approx(60, abs=3)


def test_command_of_the_readme_is_that_of_the_tutorial() -> None:
    shown = re.findall(r"^(gantry_goal [^#\n]*?) *(?:#.*)?$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert shown == [commands_and_lines()[0][0][0]]
