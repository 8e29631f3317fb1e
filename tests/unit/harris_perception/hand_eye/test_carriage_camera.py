"""Cameras on the carriage: exact data give the exact answer, and what cannot be solved is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from unit.harris_perception.rectified_pair import PAIR as CAMERAS
from unit.harris_perception.rectified_pair import measured_face, pair_covariance, triangulated

from harris_perception.core.hand_eye.carriage_camera import (
    Contact,
    PanelSample,
    calibrate_on_carriage,
    held_out_on_carriage,
    shifted,
    stylus_offset,
)
from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.hand_eye.hand_eye import HandEye
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Sample
from icu_common.core.geometry.geometry import Transform

AXES = np.array([[1.004, -0.003], [0.0, 0.997]])
TURN = np.asarray(cv2.Rodrigues(np.array([2.71, 0.05, -0.08]))[0], dtype=float)
AT_ZERO = Transform(TURN, np.array([0.01, 0.02, 0.66]))
"""camera_from_base for readings zero: the retracted tip is seen there."""
PANEL = Transform(np.asarray(cv2.Rodrigues(np.array([0.004, -0.003, 0.02]))[0]), np.array([0.02, 0.025, -0.035]))
LEAN = np.array([0.0015, -0.0011, -1.0])
NOISE = pair_covariance(AT_ZERO.translation, 0.05)
SIGMA_PX = 0.15


def places() -> np.ndarray:
    return np.array([(x, y, s) for y in (0.03, 0.1, 0.18) for x in (0.03, 0.13, 0.23, 0.33) for s in (0.0, 0.012)])


def camera_from_base(reading: np.ndarray) -> Transform:
    return shifted(AT_ZERO, AXES, reading)


def panel(reading: np.ndarray, rng: np.random.Generator | None = None) -> PanelSample:
    """Return what one picture shows of the panel: its points, and a pose that is only good enough for a start."""
    pose = camera_from_base(reading) @ PANEL
    if rng is None:
        return PanelSample(reading=reading, camera_from_panel=pose, points=measured_face(pose))
    points = measured_face(pose, rng, SIGMA_PX, count=50)
    # A pose turns about where the panel is seen, in the middle of the picture.
    turn = np.asarray(cv2.Rodrigues(rng.normal(0, 0.0004, 3))[0])
    ahead = np.array([0.0, 0.0, 0.69])
    moved = turn @ (pose.translation - ahead) + ahead + rng.normal(0, (0.00003, 0.00003, 0.00015))
    return PanelSample(reading=reading, camera_from_panel=Transform(turn @ pose.rotation, moved), points=points)


def panels(readings: np.ndarray) -> list[PanelSample]:
    return [panel(q) for q in readings]


@cache
def noisy_panels(seed: int) -> list[PanelSample]:
    rng = np.random.default_rng((seed, 2))
    return [panel(q, rng) for q in places()]


def tips(readings: np.ndarray, rng: np.random.Generator | None = None) -> list[Sample]:
    seen = AT_ZERO.apply(readings[:, 2:] * LEAN)
    if rng is not None:
        seen = triangulated(seen, rng, 0.05)
    return [Sample(reading=q, tip=t, covariance=NOISE) for q, t in zip(readings, seen)]


def contacts(count: int, rng: np.random.Generator | None = None) -> list[Contact]:
    """Touch points of the panel with a stylus that goes straight down."""
    result = []
    for k in range(count):
        reading = np.array([0.05 + 0.05 * k, 0.06 + 0.02 * k, 0.033])
        tip = np.array([*(AXES @ reading[:2]), -reading[2]])
        if rng is not None:
            tip = tip + rng.normal(0, 0.0003, 3)
        result.append(Contact(reading=reading, in_panel=PANEL.inverse().apply(tip)))
    return result


def aim_error(result: HandEye, rng: np.random.Generator | None = None) -> float:
    """Return by how much, in m, the tip misses a point of the panel that was seen from another place."""
    look, point = np.array([0.18, 0.1, 0.0]), np.array([0.29, 0.03, 0.002])
    seen = panel(look, rng).camera_from_panel
    now = shifted(result.camera_from_base, result.base_from_reading, look)
    target = (now.inverse() @ seen).apply(point)
    reading = np.linalg.solve(result.base_from_reading, target[:2])
    truth = PANEL.apply(point)
    return float(np.linalg.norm(AXES @ reading - truth[:2]))


def test_exact_data_give_axes_pose_and_stylus() -> None:
    result = calibrate_on_carriage(panels(places()), tips(places()), CAMERAS)
    assert result.on_carriage
    np.testing.assert_allclose(result.base_from_reading, AXES, atol=1e-9)
    np.testing.assert_allclose(result.camera_from_base.rotation, TURN, atol=1e-9)
    np.testing.assert_allclose(result.camera_from_base.translation, AT_ZERO.translation, atol=1e-9)
    np.testing.assert_allclose(result.stylus_direction, LEAN, atol=1e-9)
    np.testing.assert_allclose(result.tip_in_camera(np.array([0.2, 0.1, 0.0])), [AT_ZERO.translation], atol=1e-9)
    assert aim_error(result) < 1e-9


def test_noise_gives_the_predicted_error_and_aims_well() -> None:
    """A pose's own rotation would move the panel's far origin by 0.1 mm and more; the shared one does not."""
    solver = HandEyeConfig(
        common_error=0.0, place_error=0.0, panel_depth_sigma_m=0.0, panel_sigma_m=0.0, tip_sigma_px=0.05
    )
    errors, squares = [], []
    query = np.array([(0.05, 0.05, 0.0), (0.3, 0.15, 0.0), (0.18, 0.1, 0.006)])
    for seed in range(40):
        rng = np.random.default_rng(seed)
        result = calibrate_on_carriage(noisy_panels(seed), tips(places(), rng), CAMERAS, config=solver)
        errors.append(aim_error(result, rng))
        design = np.column_stack([query[:, :2], np.ones(len(query))])
        truth = np.array([(camera_from_base(q) @ PANEL).translation for q in query])
        tip = np.column_stack([query[:, 2], np.ones(len(query))]) @ result.tip_fit.regression  # type: ignore[union-attr]
        off = design @ result.fit.regression - truth - (tip - AT_ZERO.apply(query[:, 2:] * LEAN))
        squares += [e @ np.linalg.solve(c, e) / 3 for e, c in zip(off, result.covariance(query))]
    print(f"aim p95 {np.percentile(errors, 95) * 1e3:.3f} mm, chi-square/dof {np.mean(squares):.2f}")
    assert np.percentile(errors, 95) < 0.0002
    assert 0.7 < np.mean(squares) < 1.5


@pytest.mark.parametrize(("count", "bound"), [(1, 0.0009), (3, 0.0006), (5, 0.00045)])
def test_one_to_five_contacts_place_a_stylus_that_is_not_seen(count: int, bound: float) -> None:
    exact = calibrate_on_carriage(panels(places()), [], CAMERAS, contacts(count))
    np.testing.assert_allclose(exact.camera_from_base.translation, AT_ZERO.translation, atol=1e-9)
    errors = []
    for seed in range(40):
        rng = np.random.default_rng((seed, 1))
        errors.append(aim_error(calibrate_on_carriage(noisy_panels(seed), [], CAMERAS, contacts(count, rng)), rng))
    rms = float(np.sqrt(np.mean(np.square(errors))))
    print(f"{count} contacts: aim rms {rms * 1e3:.2f} mm, p95 {np.percentile(errors, 95) * 1e3:.2f} mm")
    assert np.percentile(errors, 95) < bound


@pytest.mark.parametrize("machine", [np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0]), np.eye(3)[[1, 0, 2]]])
@pytest.mark.parametrize("touched", [True, False])
def test_an_axis_that_runs_backwards_or_two_that_are_swapped_are_refused(machine: np.ndarray, touched: bool) -> None:
    told = places() * (1.0, 1.0, 0.0)
    found = [replace(panel(q @ machine), reading=q) for q in told]
    seen = [] if touched else tips(told)
    with pytest.raises(DegenerateError, match="one runs backwards, or both have changed places"):
        calibrate_on_carriage(found, seen, CAMERAS, contacts(1) if touched else [])


def test_contacts_measure_the_offset_of_what_is_seen_from_what_touches() -> None:
    result = calibrate_on_carriage(panels(places()), tips(places()), CAMERAS)
    shift = np.array([0.0004, -0.0002, 0.0001])
    moved = [Contact(reading=c.reading, in_panel=c.in_panel + PANEL.rotation.T @ shift) for c in contacts(3)]
    found = stylus_offset(result, AT_ZERO @ PANEL, moved, HandEyeConfig())
    np.testing.assert_allclose(found.offset, shift, atol=1e-6)
    np.testing.assert_allclose(found.sigma, 0.0003 / np.sqrt(3), rtol=1e-6)
    assert found.contacts == 3


def test_held_out_places_see_a_slipping_drive() -> None:
    readings = places()
    result = calibrate_on_carriage(panels(readings), tips(readings), CAMERAS)
    checks = panels(np.array([(0.1, 0.07, 0.0), (0.25, 0.14, 0.0)]))
    assert held_out_on_carriage(result, checks, CAMERAS.left).max() < 1e-9
    slipped = [replace(c, reading=c.reading + (0.002, 0, 0)) for c in checks]
    np.testing.assert_allclose(held_out_on_carriage(result, slipped, CAMERAS.left), 0.002008, atol=1e-6)


def test_one_wrong_panel_is_left_out() -> None:
    rng = np.random.default_rng(2)
    seen = list(noisy_panels(2))
    wrong = Transform(seen[3].camera_from_panel.rotation, seen[3].camera_from_panel.translation + (0.01, 0.0, 0.0))
    seen[3] = PanelSample(reading=seen[3].reading, camera_from_panel=wrong, points=measured_face(wrong))
    result = calibrate_on_carriage(seen, tips(places(), rng), CAMERAS)
    assert np.flatnonzero(~result.fit.used).tolist() == [3]
    assert aim_error(result) < 0.0003
    assert result.panel_rotation is not None
    np.testing.assert_allclose(result.panel_rotation, TURN @ PANEL.rotation, atol=0.0003)


@pytest.mark.parametrize(
    ("readings", "message"),
    [
        (places()[:3], r"3 samples \(at least 6\)"),
        (np.repeat(places()[:1], 8, axis=0), r"the readings do not differ"),
        (places()[:8], r"lie on one line .* add one near x = 180, y = 93 mm"),
        (places() * (0.1, 0.1, 1.0), r"too close together"),
    ],
)
def test_too_little_motion_is_refused_with_the_move_that_helps(readings: np.ndarray, message: str) -> None:
    with pytest.raises(DegenerateError, match=message):
        calibrate_on_carriage(panels(readings), tips(readings), CAMERAS)


def test_a_panel_that_stays_means_a_camera_that_does_not_ride() -> None:
    still = [replace(panel(places()[0]), reading=q) for q in places()]
    with pytest.raises(DegenerateError, match=r"the panel move only 0\.0 mm: .* mounting is another"):
        calibrate_on_carriage(still, tips(places()), CAMERAS)


def test_without_sight_and_touch_the_stylus_is_unknown() -> None:
    with pytest.raises(
        DegenerateError, match=r"the position of the stylus is unknown: .* touch one to five known points"
    ):
        calibrate_on_carriage(panels(places()), [], CAMERAS)
    with pytest.raises(DegenerateError, match=r"6 contacts \(limit 5\)"):
        calibrate_on_carriage(panels(places()), [], CAMERAS, contacts(6))
    wild = contacts(3)
    wild[1] = Contact(reading=wild[1].reading, in_panel=wild[1].in_panel + (0.01, 0.0, 0.0))
    with pytest.raises(DegenerateError, match=r"contacts miss one another by 4\.71 mm rms \(limit 1\.20 mm\)"):
        calibrate_on_carriage(panels(places()), [], CAMERAS, wild)


def test_a_panel_of_which_too_little_was_measured_is_refused() -> None:
    seen = panels(places())
    seen[5] = replace(seen[5], points=seen[5].points.chosen(np.arange(11)))
    with pytest.raises(DegenerateError, match=r"only 11 points .* at x = 230, y = 30 mm \(at least 12"):
        calibrate_on_carriage(seen, tips(places()), CAMERAS)
