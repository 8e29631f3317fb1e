"""Presses of the controller's core on a bench with surfaces: how deep, and what is answered."""

from __future__ import annotations

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import BASE_FROM_PANEL, Bench

from icu_common.core.goals.results import Felt, Outcome

SEEDS = (1, 2, 3)


def bench_of(seed: int) -> Bench:
    bench = Bench(seed=seed)
    bench.noise_m = np.array([4e-5, 4e-5, 6e-5])
    return bench.start()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_stylus_off_by_less_than_is_corrected_presses_and_is_reported(seed: int) -> None:
    print(f"seed {seed}")
    bench = bench_of(seed)
    bench.tip_offset[2] = 0.0008
    result = bench.do("press:RUN_STOP")
    details = dict(result.details)
    assert result.outcome is Outcome.REACHED and result.touch is Felt.TOUCHED, result
    assert min(p[2] for p in bench.lowest) == pytest.approx(_top(0.003) + 0.002 - bench.stroke_m, abs=2e-5)
    assert details["finding"] == "stylus_offset" and float(details["finding_m"]) == pytest.approx(0.0008, abs=2e-4)
    assert result.reason == "the stylus is 0.8 mm higher than its readings"
    again = bench.do("press:SINGLE")
    assert again.outcome is Outcome.REACHED and "finding" not in dict(again.details), "corrected by now"


@pytest.mark.parametrize("seed", SEEDS)
def test_a_stylus_off_by_more_touches_nothing(seed: int) -> None:
    print(f"seed {seed}")
    bench = bench_of(seed)
    bench.tip_offset[2] = 0.0022
    for _ in range(3):
        result = bench.do("press:RUN_STOP")
        assert result.outcome is Outcome.ABORTED and result.touch is Felt.NOT_TOUCHED, result
        assert result.code == "stylus_offset" and "calibrate again" in result.reason
    assert min(p[2] for p in bench.lowest) > _top(0.003) + 0.002


def test_a_panel_that_is_not_where_the_cameras_see_it_is_not_pressed() -> None:
    """The ball goes on to the largest travel and follows all the time."""
    bench = bench_of(1)
    bench.sunk_m = 0.02
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and result.touch is Felt.NOT_TOUCHED, result
    assert result.code == "not_touched" and "the stylus touched nothing down to" in result.reason
    lowest = min(p[2] for p in bench.lowest)
    assert lowest == pytest.approx(_top(0.003) + 0.002 - bench.controller.config.contact.max_travel_m, abs=3e-4)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_panel_that_is_lower_than_measured_is_pressed_and_reported(seed: int) -> None:
    print(f"seed {seed}")
    bench = bench_of(seed)
    bench.sunk_m = 0.0008
    result = bench.do("press:SCREEN")
    assert result.outcome is Outcome.REACHED and result.touch is Felt.TOUCHED, result
    assert (
        result.reason == "the panel is 0.8 mm lower than measured" and dict(result.details)["finding"] == "panel_depth"
    )
    depth = min(p[2] for p in bench.lowest)
    assert depth == pytest.approx(_top(0.0) + 0.002 - 0.0008, abs=2e-4)


def test_a_key_with_a_long_stroke_is_pressed_to_its_end_and_known_from_then_on() -> None:
    bench = bench_of(2)
    bench.stroke_m = 0.0028
    bench.do("press:RUN_STOP")
    first = len(bench.paths)
    assert min(p[2] for p in bench.lowest) == pytest.approx(_top(0.003) + 0.002 - 0.0028, abs=2e-5)
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    assert len(bench.paths) < 2 * first, "one way down does, as its end is known"


def test_an_arc_is_not_drawn_in_the_air() -> None:
    bench = bench_of(3)
    bench.sunk_m = 0.02
    result = bench.do("drag:0.05,0.06@panel_link:0.12,0.10@panel_link")
    assert result.outcome is Outcome.ABORTED and result.touch is Felt.NOT_TOUCHED, result
    assert result.code == "not_touched"
    x = [p[0] for p in bench.lowest if p[2] < _top(0.0) + 0.004]
    assert np.ptp(x) < 0.001, "it was not moved along"


def test_a_move_has_no_touch() -> None:
    result = bench_of(1).go(0.1, 0.1)
    assert result.outcome is Outcome.REACHED and result.touch is None


def _top(height_m: float) -> float:
    """Return the base z of a surface in the middle of the panel's keys."""
    return float(
        BASE_FROM_PANEL.apply(np.array([0.208 if height_m else 0.1, 0.127 if height_m else 0.082, height_m]))[2]
    )
