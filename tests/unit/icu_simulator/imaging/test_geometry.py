"""The true cameras against the calibration files: a board's error, higher orders, warmth, knocks."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from icu_common.core.configuration.config import from_mapping
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.optics import StereoRig, stereo_rig
from icu_simulator.imaging.board import true_cameras
from icu_simulator.imaging.configuration import CalibrationErrorConfig, ImagingConfig, LensConfig
from icu_simulator.imaging.rig import NO_SHIFTS, STEP_PX, CameraShift, Drift, true_rig

NOMINAL = stereo_rig(BenchConfig().camera)
PANEL = np.array([(x, y, -0.03) for x in np.linspace(0.03, 0.35, 6) for y in np.linspace(0.03, 0.2, 5)])
NO_LENS = LensConfig()


def config(**values: object) -> BenchConfig:
    return from_mapping(BenchConfig, {f"imaging.{name}": value for name, value in values.items()})


def differences(rig: StereoRig) -> tuple[np.ndarray, np.ndarray]:
    """Return how far each camera sees the panel from where the calibration files have it, (N, 2) px each."""
    return rig.left.project(PANEL) - NOMINAL.left.project(PANEL), rig.right.project(PANEL) - NOMINAL.right.project(
        PANEL
    )


def test_without_effects_the_calibration_is_the_truth() -> None:
    left, right = differences(true_rig(BenchConfig()))
    assert not left.any() and not right.any()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_board_without_errors_of_its_own_leaves_its_corner_errors_as_rms(seed: int) -> None:
    board = CalibrationErrorConfig(enabled=True, rms_px=0.23, print_scale=0.0, bow_mm=0.0)
    found = true_cameras(BenchConfig().camera, board, NO_LENS, seed)
    # The fit takes a few degrees of freedom: 142 of 3,840.
    assert found.rms_px == pytest.approx((0.23, 0.23), rel=0.05)
    again = true_cameras(BenchConfig().camera, dataclasses.replace(board, views=20), NO_LENS, seed)
    other = true_cameras(BenchConfig().camera, board, NO_LENS, seed + 10)
    assert again.left == again.left and found.left.focal_px == again.left.focal_px != other.left.focal_px


def test_the_error_of_a_calibration_grows_with_its_corner_error_and_cancels_over_the_panel() -> None:
    sizes = []
    for rms_px in (0.23, 0.46):
        board = CalibrationErrorConfig(enabled=True, rms_px=rms_px, print_scale=0.0, bow_mm=0.0)
        found = true_cameras(BenchConfig().camera, board, NO_LENS, 4)
        rig = dataclasses.replace(NOMINAL, left=found.left, right=found.right)
        left, right = differences(rig)
        rows = (left - right)[:, 1]
        assert abs(rows.mean()) < 0.1, "a stereo calibration keeps the rows together"
        centre = np.hypot(*(np.subtract(found.left.centre_px, NOMINAL.left.centre_px)))
        assert (left - right)[:, 0].std() < 0.3 * centre, "errors of single parameters are larger than their effect"
        sizes.append(found.left.focal_px - NOMINAL.left.focal_px)
    assert sizes[1] == pytest.approx(2 * sizes[0], rel=1e-6), "to first order"


def test_a_print_that_is_too_large_makes_the_true_baseline_smaller() -> None:
    board = CalibrationErrorConfig(enabled=True, rms_px=0.0, print_scale=0.01, bow_mm=0.0)
    found = true_cameras(BenchConfig().camera, board, NO_LENS, 1)
    between = np.linalg.norm(found.right.position - found.left.position)
    # The board is called smaller than it is, so the robot believes in a shorter baseline than the true one.
    assert between == pytest.approx(0.12 * 1.01, rel=2e-4)


def test_a_lens_of_higher_order_leaves_a_pattern_that_five_coefficients_cannot_follow() -> None:
    found = true_cameras(BenchConfig().camera, CalibrationErrorConfig(), LensConfig(enabled=True), 1)
    assert 0.01 < found.rms_px[0] < 0.1
    u, v = (grid.astype(float) for grid in np.meshgrid(np.arange(0, 1280, 71), np.arange(0, 720, 71)))
    a, b = found.left.slopes(u, v)
    camera = dataclasses.replace(found.left, camera_from_base=NOMINAL.left.camera_from_base)
    points = camera.camera_from_base.inverse().apply(np.column_stack([a.ravel(), b.ravel(), np.ones(a.size)]))
    np.testing.assert_allclose(camera.project(points), np.column_stack([u.ravel(), v.ravel()]), atol=1e-6)


def test_a_turned_camera_moves_what_it_sees_by_the_predicted_pixels() -> None:
    turned = CameraShift(turn_deg=(0.0, 0.02, 0.0)).of(NOMINAL.right)
    moved = turned.project(PANEL) - NOMINAL.right.project(PANEL)
    # The camera turns to its right (z towards x), so what it sees moves left, by the focal length times the angle.
    assert moved[:, 0].mean() == pytest.approx(-math.radians(0.02) * 1700, rel=0.05)
    assert np.abs(moved[:, 1]).max() < 0.06
    nodded = CameraShift(turn_deg=(0.02, 0.0, 0.0)).of(NOMINAL.right)
    assert (nodded.project(PANEL) - NOMINAL.right.project(PANEL))[:, 1].mean() == pytest.approx(0.593, rel=0.05)


def test_a_lens_that_is_hit_moves_the_whole_image() -> None:
    moved = CameraShift(lens_px=(1.5, -0.5)).of(NOMINAL.left).project(PANEL) - NOMINAL.left.project(PANEL)
    np.testing.assert_allclose(moved, np.tile([1.5, -0.5], (len(PANEL), 1)), atol=1e-9)


def test_knocks_come_at_their_time_and_add_up() -> None:
    drift = Drift(1, 1700.0, 1280)
    imaging = config(**{"knock.enabled": True, "knock.after_s": 5.0}).imaging
    assert drift.at(ImagingConfig(), 100.0) == (CameraShift(), CameraShift())
    assert drift.at(imaging, 101.0) == (CameraShift(), CameraShift())
    assert drift.at(imaging, 105.9) == (CameraShift(), CameraShift())
    assert drift.at(imaging, 106.1) == (CameraShift(), CameraShift(turn_deg=(0.0, 0.02, 0.0)))
    drift.knock("right", CameraShift(turn_deg=(0.01, 0.0, 0.0)))
    drift.knock("left", CameraShift(lens_px=(1.0, 0.0)))
    assert drift.at(imaging, 107.0) == (
        CameraShift(lens_px=(1.0, 0.0)),
        CameraShift(turn_deg=(0.01, 0.02, 0.0)),
    )
    with pytest.raises(ValueError, match="camera 'middle'"):
        drift.knock("middle", CameraShift())


def test_warming_has_not_begun_for_an_exposure_before_the_first_one() -> None:
    """The right image of a free-running pair may be exposed before the left one, which is drawn first."""
    drift = Drift(3, 1700.0, 1280)
    imaging = config(**{"warming.enabled": True, "warming.turn_deg": 0.02, "warming.ramp_s": 100.0}).imaging
    assert [drift.at(imaging, t) for t in (10.0, 9.987, 10.067)] == [NO_SHIFTS] * 3


def test_a_warming_camera_goes_to_its_full_turn_in_small_steps() -> None:
    drift = Drift(3, 1700.0, 1280)
    imaging = config(**{"warming.enabled": True, "warming.turn_deg": 0.02, "warming.ramp_s": 100.0}).imaging
    seen = [drift.at(imaging, 50.0 + t)[1] for t in np.arange(0.0, 140.0, 0.5)]
    assert seen[0] == CameraShift()
    assert np.linalg.norm(seen[-1].turn_deg) == pytest.approx(0.02) and seen[-1].focal_ppm == pytest.approx(200.0)
    places = np.array([shift.of(NOMINAL.right).project(PANEL) for shift in dict.fromkeys(seen)])
    assert len(places) > 20
    assert np.linalg.norm(np.diff(places, axis=0), axis=-1).max() < 1.2 * STEP_PX
    again = Drift(3, 1700.0, 1280)
    again.at(imaging, 0.0)
    assert again.at(imaging, 200.0)[1] == seen[-1]
