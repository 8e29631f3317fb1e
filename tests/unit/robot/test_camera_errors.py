"""The whole robot with cameras that are not those of its calibration files, and the list of effects to be measured."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.virtual_robot import VirtualRobot

from icu_common.core.configuration.config import from_mapping, to_mapping
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.optics import stereo_rig
from icu_simulator.imaging.rig import CameraShift
from icu_simulator.imaging.timing import shots

pytestmark = pytest.mark.long

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


@pytest.fixture
def effect_cases(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    return importlib.import_module("effect_cases")


def test_the_robot_knows_the_calibration_files_and_not_the_true_cameras() -> None:
    robot = VirtualRobot(1, room="workshop")
    nominal = stereo_rig(robot.config.camera)
    assert robot.cameras[0].k[0, 0] == nominal.left.focal_px == 1700.0
    true = robot.renderer.rig
    assert abs(true.left.focal_px - 1700.0) > 0.1
    assert np.abs(true.right.camera_from_base.translation - nominal.right.camera_from_base.translation).max() > 1e-6
    left, right = shots(robot.config, 3.0)
    assert left.stamp_s != right.stamp_s, "free-running"


def test_a_room_is_a_base_on_which_single_values_and_later_changes_lie() -> None:
    robot = VirtualRobot(1, bench={"imaging.exposure.time_ms": 5.0})
    assert robot.config == from_mapping(BenchConfig, {**to_mapping(BenchConfig()), "imaging.exposure.time_ms": 5.0})
    point = np.array([0.15, 0.1, -0.02])
    before = robot.renderer.rig.right.project(point)[0]
    robot.set({"imaging.knock.enabled": True})
    robot.renderer.settle(robot.now)
    turned = robot.renderer.rig.right.project(point)[0] - before
    assert turned == pytest.approx([-0.593, 0.0], abs=0.05)
    robot.renderer.knock("right", CameraShift(turn_deg=(0.0, -0.02, 0.0)))
    robot.renderer.settle(robot.now)
    assert robot.renderer.rig.right.project(point)[0] == pytest.approx(before.tolist(), abs=1e-6)


def test_every_declared_effect_is_a_case_that_the_bench_accepts(effect_cases: Any) -> None:
    cases = effect_cases.cases()
    assert len({(c.effect, c.size) for c in cases}) == len(cases)
    switches = {name.removesuffix(".enabled") for name in to_mapping(BenchConfig()) if name.endswith(".enabled")}
    assert switches - set(effect_cases.PARTS) <= {c.effect for c in cases}
    base = to_mapping(BenchConfig())
    for case in cases:
        changed = from_mapping(BenchConfig, {**base, **case.values})
        assert (changed != BenchConfig()) == (case.effect != "none"), case
        assert len(case.source) > 15, case
    by_size = {(c.effect, c.size): c for c in cases}
    assert by_size["imaging.knock", "twice"].values["imaging.knock.turn_deg"] == (0.0, 0.04, 0.0)
    assert by_size["imaging.knock", "nominal"].later and not by_size["imaging.calibration", "nominal"].later
    assert ("imaging.bayer", "twice") not in by_size, "a mosaic has no size"


def test_results_are_written_as_table_with_sources(
    effect_cases: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bench_effects = importlib.import_module("bench_effects")
    monkeypatch.setattr(bench_effects, "OUT", tmp_path)
    count = bench_effects.Count(
        effect="imaging.bayer",
        size="nominal",
        presses=10,
        pressed=7,
        refused=2,
        false=1,
        error_mm=0.123,
        stated_mm=None,
        note="hidden | by a hand",
        source="a patent",
    )
    bench_effects.write([count], room="ideal", presses=10, seed=1)
    assert "imaging.bayer,nominal,10,7,2,1,0.123,,hidden | by a hand,a patent" in (tmp_path / "effects.csv").read_text()
    row = (tmp_path / "effects.md").read_text().splitlines()[-1]
    assert row == "| `imaging.bayer` | nominal | 7 | 2 | 1 | 0.123 |  | hidden / by a hand | a patent |"
