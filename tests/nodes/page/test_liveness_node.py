"""The page's console names a node that is late, hangs or has ended, each only when it is so."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from icu_common.adapters.processes.hanging_programs import write_hanging
from icu_common.core.processes.supervision import HANGING_VARIABLE
from scope_ui_bridge.nodes.bridge_node import BridgeNode

WITHIN_S = 30.0
# Reports each tenth of a second.
REPORTER = """
import sys
from rclpy.node import Node
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.runtime import run

class Reporter(Node):
    def __init__(self, **options):
        super().__init__("stylus_tracker", **options)
        self._diagnostics = Diagnostics(self)
        self.create_timer(0.1, lambda: self._diagnostics.tell("ok", "tip seen", []))

sys.exit(run(Reporter, []))
"""


class Console:
    """The bridge, what it shows on the page's console, and one node in a process of its own."""

    def __init__(self, ros: Any, domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ros = ros
        self.node = ros.node(BridgeNode, {"port": 0, "token_file": ""})
        self.lines: list[tuple[str, str]] = []
        monkeypatch.setattr(self.node._desk, "said", lambda line: self._take(line))
        self.program = subprocess.Popen(
            [sys.executable, "-c", REPORTER], env={**os.environ, "ROS_DOMAIN_ID": str(domain)}
        )
        ros.spin_until(lambda: self.node.programs.liveness._reporters, WITHIN_S)

    def _take(self, line: dict[str, Any]) -> list[Any]:
        if "stylus_tracker" in line["text"]:
            self.lines.append((line["level"], line["text"]))
        return []

    def after(self, count: int) -> tuple[str, str]:
        self.ros.spin_until(lambda: len(self.lines) >= count, WITHIN_S, lambda: self.lines)
        assert len(self.lines) == count, "one line for each change"
        return self.lines[-1]

    def end(self) -> None:
        self.program.kill()
        self.program.wait()


@pytest.fixture
def console(ros: Any, domain: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Console]:
    monkeypatch.setenv(HANGING_VARIABLE, str(tmp_path / "hanging.json"))
    found = Console(ros, domain, monkeypatch)
    yield found
    found.end()


def test_a_stopped_node_is_late_reports_again_and_has_ended_only_when_it_was_killed(console: Console) -> None:
    console.program.send_signal(signal.SIGSTOP)
    level, text = console.after(1)
    assert level == "warn" and re.match(r"no report for [56] s, late: /stylus_tracker; load \d", text), text
    assert " on " in text.partition("load ")[2], "the programs that use the processor are named"
    console.program.send_signal(signal.SIGCONT)
    assert console.after(2) == ("info", "/stylus_tracker reports again")
    console.program.kill()
    console.program.wait()
    assert console.after(3) == ("error", "/stylus_tracker has ended")


def test_a_node_hangs_when_bring_up_has_found_it_blocked(console: Console, tmp_path: Path) -> None:
    write_hanging(tmp_path / "hanging.json", [console.program.pid])
    console.program.send_signal(signal.SIGSTOP)
    assert console.after(1) == ("fatal", "/stylus_tracker hangs: it gives no sign of life")
    write_hanging(tmp_path / "hanging.json", [])
    console.program.kill()
    console.program.wait()
    assert console.after(2) == ("error", "/stylus_tracker has ended")
