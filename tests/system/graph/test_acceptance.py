"""The acceptance test on the simulated bench, with the command for hardware: it measures the errors of the bench."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(600)]

TOUCHES = 20


def test_simulated_bench_is_accepted_with_its_known_errors(running_graph: Any, tmp_path: Path) -> None:
    start = len(running_graph.truth_log())
    done = running_graph.command(
        "gantry_driver", "gantry_accept", "--out", str(tmp_path), "--touches", str(TOUCHES), within_s=500.0
    )
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["passed"] is True
    values = {(check["group"], check["name"]): check["value"] for check in report["checks"]}
    assert abs(values["scale", "x axis"]) == pytest.approx(0.4, abs=0.15), "bench.yaml: mechanics.scale = 0.004"
    assert abs(values["squareness", "angle between the axes less 90 deg"]) == pytest.approx(0.172, abs=0.08)
    assert values["backlash", "x axis"] == pytest.approx(0.15, abs=0.09)
    assert values["backlash", "y axis"] == pytest.approx(0.25, abs=0.09)
    assert values["limits", "goals outside the limits rejected"] == 4

    events = running_graph.truth_log()[start:]
    touched = np.array([e["tip_panel_mm"][:2] for e in events if e["event"] == "contact"])
    ordered = np.array([touch["panel_m"] for touch in report["touches"]]) * 1e3
    assert len(touched) == TOUCHES and np.hypot(*(touched - ordered).T).max() < 0.5
    assert not [e for e in events if e["event"] == "press"], "no control was touched"
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == 2 and page.count("data:image/jpeg") == 2
