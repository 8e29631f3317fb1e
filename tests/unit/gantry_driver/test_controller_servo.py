"""Look-move-touch on a machine with backlash, scale, skew and noise that the controller does not know."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import BASE_FROM_PANEL, PANEL, Bench, RidingBench

from gantry_driver.core.controller import Phase
from icu_common.core.geometry import Transform
from icu_common.core.results import Outcome

SEEDS = range(20)


def sloppy_bench(seed: int, kind: type[Bench] = Bench) -> Bench:
    """Errors as large as the machine is allowed to have; the calibration knows none of them."""
    rng = np.random.default_rng(seed)
    bench = kind(seed=seed)
    scale, skew = rng.uniform(-0.004, 0.004, 2), rng.uniform(-0.003, 0.003)
    bench.true_axes = np.array([[1 + scale[0], skew], [0.0, 1 + scale[1]]])
    bench.backlash = rng.uniform(0.00015, 0.00025, 2)
    bench.noise_m = np.array([4e-5, 4e-5, 1.5e-4])
    return bench


@pytest.mark.parametrize("kind", [Bench, RidingBench])
@pytest.mark.parametrize("seed", SEEDS)
def test_true_error_at_contact(seed: int, kind: type[Bench]) -> None:
    print(f"seed {seed}")
    bench = sloppy_bench(seed, kind).start()
    for name in ("RUN_STOP", "CH1", "CH1_SCALE", "SCREEN"):
        bench.lowest.clear()
        result = bench.do(f"press:{name}")
        assert result.outcome is Outcome.REACHED, result
        control = next(c for c in PANEL.controls if c.name == name)
        surface = BASE_FROM_PANEL.apply([*control.centre, control.height])
        contact = min(bench.lowest, key=lambda p: p[2])
        true_error = float(np.linalg.norm(contact[:2] - surface[:2]))
        # Tolerance 0.15 mm plus the noise of the mean of five looks.
        assert true_error < 0.00025, (name, true_error)
        assert result.error_m < 0.00025
        assert abs(result.error_m - true_error) < 0.0001
        assert contact[2] == pytest.approx(surface[2] + 0.001, abs=2e-5)
        assert int(dict(result.details)["corrections"]) <= 2


def test_without_servoing_the_same_machine_misses() -> None:
    errors = []
    for seed in SEEDS:
        bench = sloppy_bench(seed).start()
        bench.go(*BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])[:2])
        errors.append(np.linalg.norm(bench.tip_in_base()[:2] - BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])[:2]))
    assert np.median(errors) > 0.0004, "the errors are too small to show anything"


def test_every_correction_arrives_from_the_same_side() -> None:
    bench = sloppy_bench(5).start()
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    for path in bench.paths:
        for before, after in itertools.pairwise(path):
            if np.abs(after[:2] - before[:2]).max() > 1e-9:
                assert (after[:2] > before[:2]).all()
    bends = [p for p in bench.paths if len(p) == 2 and p[0][2] == p[1][2]]
    assert bends, "no correction was made"
    for path in bends:
        np.testing.assert_allclose(path[1] - path[0], [0.001, 0.001, 0.0], atol=1e-12)
        assert path[0][2] == bench.paths[0][-1][2], "corrections stay at the hover height"


def test_cameras_on_the_carriage_notice_a_panel_that_moves() -> None:
    bench = RidingBench(seed=3).start()
    assert isinstance(bench, RidingBench)

    def push(running: Bench) -> None:
        assert isinstance(running, RidingBench)
        running.base_from_panel = Transform(BASE_FROM_PANEL.rotation, BASE_FROM_PANEL.translation + (0.004, 0.0, 0.0))

    bench.on_phase[Phase.LOOK] = push
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED
    assert "the panel has moved by 4.0 mm" in result.reason


def test_cameras_on_the_carriage_wait_for_a_panel_seen_from_where_they_are() -> None:
    bench = RidingBench(seed=3).start()
    assert bench.go(0.1, 0.1).outcome is Outcome.REACHED
    bench.talking.discard("panel")
    assert bench.go(0.2, 0.1).outcome is Outcome.REACHED
    refused = bench.do("press:RUN_STOP")
    assert refused.outcome is Outcome.REJECTED and "no pose of the panel yet" in refused.reason
    bench.talking.add("panel")
    bench.run(0.5)
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
