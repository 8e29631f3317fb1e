"""An image of a panel at rest counts as unchanged under noise; whatever moves or covers the panel does not."""

from __future__ import annotations

import numpy as np
import pytest
from unit.harris_perception import panel_scene as scene

from harris_perception.core.recognition.still_panel import StillPanel

LAYOUT = scene.bench_layout()
CAMERA = scene.camera()
POSE = scene.pose(LAYOUT)
LONGEST = 4


def picture(shift_m: float = 0.0, seed: int = 1) -> np.ndarray:
    truth = scene.pose(LAYOUT, shift_m=(shift_m, 0.0))
    return np.asarray(scene.picture(LAYOUT, CAMERA, truth, scene.Look(screen_seed=seed), seed))


STILL = [picture(seed=seed) for seed in (1, 2, 3)]


def measured(longest: int = LONGEST) -> StillPanel:
    still = StillPanel(LAYOUT, longest)
    still.measured(STILL[0], POSE, CAMERA)
    return still


def test_noise_and_another_screen_are_no_change_but_only_so_many_times() -> None:
    still = measured()
    assert [still.unchanged(STILL[1 + n % 2]) for n in range(LONGEST + 1)] == [True] * LONGEST + [False]
    still.measured(STILL[1], POSE, CAMERA)
    assert still.unchanged(STILL[2])
    still.forget()
    assert not still.unchanged(STILL[2])


@pytest.mark.parametrize("shift_m", [1e-4, -1e-4, 1e-3])
def test_a_panel_that_has_moved_by_a_tenth_of_a_millimetre_has_changed(shift_m: float) -> None:
    still = measured()
    assert not still.unchanged(picture(shift_m=shift_m, seed=2))
    assert still.unchanged(STILL[1]), "it is back"


def test_many_small_steps_are_a_change() -> None:
    still = measured(longest=50)
    steps = [still.unchanged(picture(shift_m=2e-5 * n, seed=n)) for n in range(1, 8)]
    assert steps[-1] is False


def test_what_covers_a_corner_or_dims_the_light_is_a_change() -> None:
    still = measured()
    corner = CAMERA.project(POSE.apply(np.array([[0.005, 0.005, 0.0]])))[0].round().astype(int)
    covered = STILL[1].copy()
    covered[corner[1] - 8 : corner[1] + 8, corner[0] - 8 : corner[0] + 8] //= 2
    assert not still.unchanged(covered)
    assert not still.unchanged((STILL[1] * 0.97).astype(np.uint8))
    assert not still.unchanged(STILL[1][:-8]), "another size"
    assert still.unchanged(STILL[1])


def test_a_panel_that_is_hardly_in_view_is_measured_each_time() -> None:
    still = StillPanel(LAYOUT, LONGEST)
    still.measured(STILL[0], scene.pose(LAYOUT, shift_m=(0.5, 0.0)), CAMERA)
    assert not still.unchanged(STILL[0])
