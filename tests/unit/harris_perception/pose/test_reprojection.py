"""The joint refinement: exact data stay exact, noise in pixels hurts less than in a regression, wrong points hardly."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from unit.harris_perception.rectified_pair import PAIR, measured_face, triangulated

from harris_perception.core.hand_eye.backlash import measure_backlash
from harris_perception.core.hand_eye.hand_eye import calibrate, tip_place
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Place, Sample
from harris_perception.core.pose.planar_pose import FACE_POINT_COLUMNS, FacePoints, fit_pose
from harris_perception.core.pose.reprojection import RayError, pair_pixels, panel_origin, refine_panel, refine_points
from icu_common.core.geometry.geometry import Transform

TURN = np.asarray(cv2.Rodrigues(np.array([2.71, 0.05, -0.08]))[0], dtype=float)
READINGS = np.array([(x, y, s) for y in (0.03, 0.1, 0.18) for x in (0.03, 0.13, 0.23, 0.33) for s in (0.0, 0.012)])
DESIGN = np.column_stack([READINGS, np.ones(len(READINGS))])
TIP = np.vstack([(TURN @ np.diag([1.004, 0.997, -1.0])).T, [(-0.17, 0.09, 0.66)]])
AWAY = np.column_stack([READINGS[::2, :2], np.ones(12)])
PANEL_AT = np.vstack([-TIP[:2], [(0.02, 0.03, 0.69)]])
PANEL_TURN = TURN @ np.asarray(cv2.Rodrigues(np.array([0.004, -0.003, 0.02]))[0])


def test_pixels_and_their_derivative() -> None:
    points = np.array([(0.1, -0.05, 0.7), (-0.2, 0.03, 0.6)])
    pixels, derivative = pair_pixels(points, PAIR)
    left, right = PAIR.left.project(points) - (640, 360), PAIR.project_right(points) - (640, 360)
    np.testing.assert_allclose(pixels, np.column_stack([left[:, 0], right[:, 0], np.sqrt(2) * left[:, 1]]), atol=1e-9)
    for axis in range(3):
        moved = pair_pixels(points + 1e-6 * np.eye(3)[axis], PAIR)[0]
        np.testing.assert_allclose((moved - pixels) / 1e-6, derivative[:, :, axis], rtol=1e-4, atol=1e-2)


def test_error_along_the_line_of_sight() -> None:
    point = np.array([[0.3, 0.0, 0.4]])
    along = np.array([0.6, 0.0, 0.8])
    expected = 1e-6 * np.eye(3) + (9e-6 - 1e-6) * np.outer(along, along)
    np.testing.assert_allclose(RayError(eye=np.zeros(3), across_m=0.001, along_m=0.003).covariance(point)[0], expected)
    axis = RayError(eye=None, across_m=0.001, along_m=0.003).covariance(point)[0]
    np.testing.assert_allclose(axis, np.diag([1e-6, 1e-6, 9e-6]))


def test_pixels_tell_the_slope_of_depth_better_than_a_regression_of_points() -> None:
    regressed, refined, squares = [], [], []
    query = np.array([(0.02, 0.02, 0.0, 1.0), (0.34, 0.19, 0.012, 1.0)])
    for seed in range(40):
        seen = triangulated(DESIGN @ TIP, np.random.default_rng(seed), 0.05)
        start = np.linalg.lstsq(DESIGN, seen, rcond=None)[0]
        found, spread, sigma = refine_points(DESIGN, seen, start, PAIR)
        regressed.append((query @ (start - TIP))[:, 2])
        refined.append((query @ (found - TIP))[:, 2])
        off = (found - TIP).ravel()
        squares.append(off @ np.linalg.solve(spread, off) / 12)
        assert 0.03 < sigma < 0.07, seed
    better = np.sqrt(np.mean(np.square(refined)) / np.mean(np.square(regressed)))
    print(f"depth error against a regression {better:.2f}, chi-square/dof {np.mean(squares):.2f}")
    assert better < 0.75
    assert 0.8 < np.mean(squares) < 1.3
    exact, _, sigma = refine_points(DESIGN, DESIGN @ TIP, start, PAIR)
    np.testing.assert_allclose(exact, TIP, atol=1e-12)
    assert sigma < 1e-9


def test_points_of_all_views_together_beat_single_poses_where_little_is_seen() -> None:
    """A third of the face in each view, and every fifth point wrong."""
    by_pose, jointly, squares = [], [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        views, origins = [], []
        for row in AWAY:
            pose = Transform(PANEL_TURN, row @ PANEL_AT)
            view = measured_face(pose, rng, 0.2, count=60, part=1 / 3)
            view.pixels[::5] += rng.uniform(-6, 6, (12, 1)) * view.across[::5]
            views.append(view)
            origins.append(fit_pose(pose, view, PAIR.left).camera_from_panel.translation)
        start = np.linalg.lstsq(AWAY, np.array(origins), rcond=None)[0]
        rotation, found, covariance = refine_panel(views, AWAY, PANEL_TURN, start, PAIR.left)
        by_pose.append((AWAY @ (start - PANEL_AT)).ravel())
        jointly.append((AWAY @ (found - PANEL_AT)).ravel())
        off = (found - PANEL_AT).ravel()
        squares.append(off @ np.linalg.solve(covariance, off) / 9)
        assert np.linalg.norm(rotation - PANEL_TURN) < 0.001
        seen, *_ = panel_origin(views[0], PANEL_TURN, origins[0], PAIR.left)
        assert np.linalg.norm(seen - AWAY[0] @ PANEL_AT) < 0.0006
    better = np.sqrt(np.mean(np.square(jointly)) / np.mean(np.square(by_pose)))
    print(f"joint error against poses {better:.2f}, chi-square/dof {np.mean(squares):.2f}")
    assert better < 0.5
    assert np.mean(squares) < 4  # nine unknowns, and a covariance from twelve views


@pytest.mark.parametrize("noise_px", [0.02, 0.3])
def test_the_joint_fit_of_the_panel_errs_as_it_says(noise_px: float) -> None:
    """Also where the noise is so large that Tukey's weights fall: the squares were 1.5 times what was predicted."""
    squares = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        views = [measured_face(Transform(PANEL_TURN, row @ PANEL_AT), rng, noise_px, count=100) for row in AWAY]
        _, found, covariance = refine_panel(views, AWAY, PANEL_TURN, PANEL_AT, PAIR.left)
        off = (found - PANEL_AT).ravel()
        squares.append(off @ np.linalg.solve(covariance, off) / 9)
    print(f"seeds 0 to 149, noise {noise_px} px: chi-square/dof {np.mean(squares):.2f}")
    assert 0.85 < np.mean(squares) < 1.2


def test_exact_points_give_the_exact_panel() -> None:
    views = [measured_face(Transform(PANEL_TURN, row @ PANEL_AT)) for row in AWAY]
    turned = np.asarray(cv2.Rodrigues(np.array([0.002, -0.003, 0.001]))[0]) @ PANEL_TURN
    rotation, found, _ = refine_panel(views, AWAY, turned, PANEL_AT + 0.002, PAIR.left)
    np.testing.assert_allclose(rotation, PANEL_TURN, atol=1e-9)
    np.testing.assert_allclose(found, PANEL_AT, atol=1e-9)
    again = FacePoints.of_rows(views[0].rows.astype(np.float32))
    assert len(FACE_POINT_COLUMNS) == views[0].rows.shape[1]
    np.testing.assert_allclose(again.pixels, views[0].pixels, atol=1e-4)


def test_backlash_is_the_difference_of_two_neighbours() -> None:
    rng = np.random.default_rng(3)
    seen = triangulated(DESIGN @ TIP, rng, 0.02)
    samples = [Sample(reading=q, tip=t, covariance=np.zeros((3, 3))) for q, t in zip(READINGS, seen)]
    result = calibrate(samples, PAIR, HandEyeConfig())
    light = np.array([0.00005, -0.00003, 0.0002])  # what the place itself makes wrong
    pairs: list[tuple[Place, Place]] = []
    for y in (0.08, 0.13):
        below, above = np.array([0.006, y, 0.0]), np.array([0.0, y, 0.0])
        tips = [np.append(below, 1.0) @ TIP + light, np.append(above + (0.0002, 0, 0), 1.0) @ TIP + light]
        pair = [Sample(reading=q, tip=t, covariance=np.zeros((3, 3))) for q, t in zip((below, above), tips)]
        pairs.append((tip_place(result, pair[0], PAIR), tip_place(result, pair[1], PAIR)))
    found = measure_backlash(result, 0, pairs)
    print(found.text())
    assert found.places == 2
    assert abs(found.play_m - 0.0002 * 1.004) < 2e-6
    assert 3e-6 < found.sigma_m < 2e-5
    one, two = (measure_backlash(result, 0, pairs[:n]).sigma_m for n in (1, 2))
    assert two / one == pytest.approx(np.sqrt(0.5), rel=0.2)


@pytest.mark.parametrize(("axis", "spots"), [(0, (0.08, 0.13)), (1, (0.13, 0.23))])
def test_backlash_errs_as_predicted_at_the_edge_of_the_picture(axis: int, spots: tuple[float, ...]) -> None:
    """There the line of sight leans against the rail, and the depth error must not count as play."""
    nothing = np.zeros((3, 3))
    squares, errors = [], []
    for seed in range(100, 120):
        rng = np.random.default_rng(seed)
        seen = triangulated(DESIGN @ TIP, rng, 0.05)
        result = calibrate([Sample(reading=q, tip=t, covariance=nothing) for q, t in zip(READINGS, seen)], PAIR)
        for _ in range(15):
            pairs = []
            for spot in spots:
                places = [np.insert([near, 0.0], 1 - axis, spot) for near in (0.006, 0.0)]
                tips = triangulated(np.array([np.append(q, 1.0) for q in places]) @ TIP, rng, 0.05)
                pair = [Sample(reading=q, tip=t, covariance=nothing) for q, t in zip(places, tips)]
                pairs.append((tip_place(result, pair[0], PAIR), tip_place(result, pair[1], PAIR)))
            found = measure_backlash(result, axis, pairs)
            errors.append(found.play_m)
            squares.append((found.play_m / found.sigma_m) ** 2)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    print(f"rms {rms * 1e6:.1f} um, chi-square {np.mean(squares):.2f}")
    assert 0.8 < np.mean(squares) < 1.2
    assert rms < 0.8 * 0.05 * 0.66 / 1700  # four images determine each position


def test_a_view_of_the_panel_errs_as_its_lines_of_print_tell() -> None:
    """The points of a flat line err together, those of upright edges each for itself, and the prediction knows it."""
    rng = np.random.default_rng(8)
    flat = np.array([(x, y) for y in np.linspace(0.01, 0.14, 36) for x in np.linspace(0.01, 0.31, 10)])
    upright = rng.uniform((0.0, 0.0), (0.32, 0.15), (360, 2))
    places = np.vstack([flat, upright])
    across = np.repeat([(0.0, 1.0), (1.0, 0.0)], 360, axis=0)
    turn = np.diag([1.0, -1.0, -1.0])
    truth = np.array([-0.16, 0.08, 0.66])
    pixels = PAIR.left.project(np.column_stack([places, np.zeros(720)]) @ turn.T + truth)
    errors, squares = [], []
    for _ in range(150):
        off = np.concatenate([np.repeat(rng.normal(0, 0.1, 36), 10), rng.normal(0, 0.1, 360)])
        view = FacePoints(in_face=places, pixels=pixels + off[:, None] * across, across=across)
        found, _, covariance = panel_origin(view, turn, truth, PAIR.left)
        errors.append(found - truth)
        squares.append((found - truth) ** 2 / np.diag(covariance))
    rms = np.sqrt(np.mean(np.square(errors), axis=0)) * 1e6
    print(f"x, y, z rms {rms.round(1)} um, chi-square {np.mean(squares, axis=0).round(2)}")
    assert rms[1] > 2 * rms[0], "flat lines are few, whatever their points"
    assert all(0.75 < value < 1.35 for value in np.mean(squares, axis=0))
