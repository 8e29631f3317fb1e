"""The acceptance test on the simulated bench, with the command for hardware: it measures the errors of the bench."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from icu_simulator.core.configuration import MechanicsConfig
from icu_simulator.core.mechanics import draw_errors

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(600)]

TOUCHES = 8
"""Fewer than the program's default of 20, which takes 89 simulated seconds; one touch takes about three."""


def test_simulated_bench_is_accepted_with_its_known_errors(running_graph: Any, tmp_path: Path) -> None:
    start = len(running_graph.truth_log())
    done = running_graph.command(
        "gantry_driver", "gantry_accept", "--out", str(tmp_path), "--touches", str(TOUCHES), within_s=500.0
    )
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["passed"] is True
    values = {(check["group"], check["name"]): check["value"] for check in report["checks"]}
    errors = draw_errors(MechanicsConfig(), np.random.default_rng(1))  # seed of bench.yaml
    lengths = np.linalg.norm(errors.base_from_carriage, axis=0)
    cosine = float(np.prod(errors.base_from_carriage, axis=1).sum() / lengths.prod())
    for number, axis in enumerate(("x axis", "y axis")):
        assert values["scale", axis] == pytest.approx(100 * (lengths[number] - 1), abs=0.05)
        assert values["backlash", axis] == pytest.approx(errors.play_mm[number], abs=0.06)
    square = values["squareness", "angle between the axes less 90 deg"]
    assert square == pytest.approx(np.degrees(np.arccos(cosine)) - 90, abs=0.03)
    assert values["camera", "left: blur of edges"] == pytest.approx(0.65, abs=0.2), "bench.yaml: light.blur_px = 0.55"
    assert values["limits", "goals outside the limits rejected"] == 4

    events = running_graph.truth_log()[start:]
    touched = np.array([e["tip_panel_mm"][:2] for e in events if e["event"] == "contact"])
    ordered = np.array([touch["panel_m"] for touch in report["touches"]]) * 1e3
    assert len(touched) == TOUCHES and np.hypot(*(touched - ordered).T).max() < 0.5
    assert not [e for e in events if e["event"] == "press"], "no control was touched"
    page = (tmp_path / "report.html").read_text()
    assert page.count("<svg") == 2 and page.count("data:image/jpeg") == 2
