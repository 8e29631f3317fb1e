"""The default room of `make demo`, with the errors of ordinary webcams: a new machine is calibrated, and presses."""

from __future__ import annotations

import math
from typing import Any

import pytest

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(900)]


def test_a_new_machine_in_the_default_room_presses_its_keys(workshop_graph: Any) -> None:
    workshop_graph.prepare(within_s=600.0)
    bench = workshop_graph.bench()
    running = bench.ask(do="truth")["instrument"]["running"]
    for name in ("RUN_STOP", "SAVE"):
        start = len(workshop_graph.truth_log())
        done = workshop_graph.command("gantry_driver", "gantry_goal", "--control", name, within_s=120.0)
        print(done.stdout)
        assert done.returncode == 0 and "reached" in done.stdout, done.stdout + done.stderr
        events = workshop_graph.truth_log()[start:]
        assert [event["control"] for event in events if event["event"] == "press"] == [name]
        contact = next(event for event in events if event["event"] == "contact")
        assert math.dist(contact["tip_panel_mm"][:2], contact["control_mm"][:2]) < 0.5
    assert bench.ask(do="truth")["instrument"]["running"] is (not running)
