"""Topics, services and parameters of every node of the graph: other programs depend on them, so a change is deliberate.

`make interfaces` writes the file again. Its diff shows users what they have to change.
"""

from __future__ import annotations

import difflib
import json
import os
import select
import time
from pathlib import Path
from typing import Any

import pytest
from support.ros_rig import participant
from system.graph.node_interfaces import Interfaces, interfaces_of, seen_in, text_of, with_those_at_times

from icu_bringup.core.startup.graph_description import load_graph

ROOT = Path(__file__).resolve().parents[3]
REFERENCE = Path(__file__).with_name("interfaces.json")
SETTLED_WITHIN_S = 30.0
"""Nodes subscribe to images while a program reads their results, such as a page of the test before."""

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(600)]


def test_nodes_have_the_interfaces_of_the_reference(started_graph: Any) -> None:
    programs = load_graph(ROOT / "config", "test", run=started_graph.run_dir, state=started_graph.folder)
    nodes = [f"{program.namespace.rstrip('/')}/{program.name}" for program in programs if program.is_node]

    def hide(value: Any) -> Any:
        """Replace what is this run's own."""
        if value == started_graph.port:
            return "PORT"
        if isinstance(value, str):
            return value.replace(str(started_graph.folder), "FOLDER").replace(str(ROOT), "PROJECT")
        return value

    renew = os.environ.get("RENEW_INTERFACES") == "1"
    reference: Interfaces = {} if renew else json.loads(REFERENCE.read_text())
    with participant(int(started_graph.environment["ROS_DOMAIN_ID"])) as ros:
        ros.plain("interfaces")
        started_graph.page_address()  # the page's node is the last to start
        reads, deadline = [interfaces_of(ros, nodes, hide)], time.monotonic() + SETTLED_WITHIN_S
        while with_those_at_times(reads[-1], reference) != reference and time.monotonic() < deadline:
            select.select([], [], [], 0.5)
            reads.append(interfaces_of(ros, nodes, hide))
    if renew:
        REFERENCE.write_text(text_of(seen_in(reads)))
        return
    found = with_those_at_times(reads[-1], reference)
    lines = difflib.unified_diff(text_of(reference).split("\n"), text_of(found).split("\n"), "reference", "graph", n=1)
    changed = "\n".join(lines)
    assert not changed, f"{changed}\nif this is intended: make interfaces, and commit {REFERENCE.relative_to(ROOT)}"
