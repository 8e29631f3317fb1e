"""Hand-eye: exact data give the exact answer, noise the predicted error, and what cannot be solved is refused."""

from __future__ import annotations

import re
from functools import cache

import cv2
import numpy as np
import pytest
from unit.harris_perception.rectified_pair import PAIR as CAMERAS
from unit.harris_perception.rectified_pair import pair_covariance, triangulated

from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.hand_eye.hand_eye import HandEye, calibrate
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Sample
from icu_common.core.geometry.geometry import Transform

TRUE_AXES = np.array([[1.004, -0.003], [0.0, 0.997]])
TRUE_POSE = Transform(
    np.asarray(cv2.Rodrigues(np.array([2.71, 0.05, -0.08]))[0], dtype=float), np.array([-0.17, 0.09, 0.66])
)
TILTED = np.array([0.0015, -0.0011, -1.0])
SIGMA_PX = 0.05
NOISE = pair_covariance(np.array([-0.01, 0.0, 0.66]), SIGMA_PX)


@cache
def covariance_at(x: float, y: float, z: float) -> np.ndarray:
    return pair_covariance(np.array([x, y, z]), SIGMA_PX)


def grid(columns: int = 4, rows: int = 3, stylus: tuple[float, ...] = (0.0, 0.012)) -> np.ndarray:
    x, y = np.linspace(0.03, 0.33, columns), np.linspace(0.03, 0.18, rows)
    return np.array([(a, b, s) for b in y for a in x for s in stylus])


def true_tips(readings: np.ndarray, stylus: np.ndarray = TILTED) -> np.ndarray:
    base = np.column_stack([readings[:, :2] @ TRUE_AXES.T, np.zeros(len(readings))]) + readings[:, 2:] * stylus
    return TRUE_POSE.apply(base)


def samples(readings: np.ndarray, rng: np.random.Generator | None = None, told: float = 1.0) -> list[Sample]:
    """The tip at these readings, with ``told`` times its true covariance."""
    tips = true_tips(readings)
    covariances = [told * covariance_at(*tip) for tip in tips]
    if rng is not None:
        tips = triangulated(tips, rng, SIGMA_PX)
    return [Sample(reading=q, tip=t, covariance=c) for q, t, c in zip(readings, tips, covariances)]


def assert_exact(result: HandEye) -> None:
    np.testing.assert_allclose(result.base_from_reading, TRUE_AXES, atol=1e-12)
    np.testing.assert_allclose(result.camera_from_base.rotation, TRUE_POSE.rotation, atol=1e-12)
    np.testing.assert_allclose(result.camera_from_base.translation, TRUE_POSE.translation, atol=1e-12)


def test_exact_data_give_pose_scale_skew_and_stylus_direction() -> None:
    result = calibrate(samples(grid()), CAMERAS)
    assert_exact(result)
    np.testing.assert_allclose(result.stylus_direction, TILTED, atol=1e-12)
    assert result.fit.rms_m < 1e-12
    assert result.fit.used.all()
    np.testing.assert_allclose(result.tip_in_base(np.array([[0.1, 0.2, 0.03]])), [[0.0998, 0.1994, -0.03]], atol=1e-12)


def test_one_stylus_extension_puts_the_origin_at_the_retracted_tip() -> None:
    readings = grid(stylus=(0.010,))
    base = np.column_stack([readings[:, :2] @ TRUE_AXES.T, -readings[:, 2]])
    result = calibrate(
        [Sample(reading=q, tip=t, covariance=NOISE) for q, t in zip(readings, TRUE_POSE.apply(base))], CAMERAS
    )
    assert_exact(result)


def test_error_is_as_predicted_over_seeds() -> None:
    """Mahalanobis distance of the fitted tip, over its 3 degrees of freedom, has mean one; so has the factor."""
    readings = grid()
    query = np.array([(0.02, 0.02, 0.0), (0.34, 0.19, 0.012), (0.18, 0.1, 0.006), (0.3, 0.05, 0.0)])
    distances, factors, errors, sigmas = [], [], [], []
    exact = HandEyeConfig(tip_sigma_px=1e-4, common_error=0.0, place_error=0.0)
    for seed in range(200):
        # The solver gets three times the true covariance: the residuals must correct it.
        result = calibrate(samples(readings, np.random.default_rng(seed), 3.0), CAMERAS, exact)
        assert result.fit.used.all(), seed
        design = np.column_stack([query, np.ones(len(query))])
        error = design @ result.fit.regression - true_tips(query)
        covariance = result.covariance(query)
        distances += [e @ np.linalg.solve(c, e) / 3 for e, c in zip(error, covariance)]
        factors.append(3.0 * result.fit.variance_factor)
        errors.append(np.mean(np.sum(error**2, axis=1)))
        sigmas.append(result.sigma_m(query) ** 2)
    print(f"chi-square/dof {np.mean(distances):.3f}, factor {np.mean(factors):.3f}")
    assert 0.9 < np.mean(distances) < 1.1
    assert 0.95 < np.mean(factors) < 1.05
    assert np.sqrt(np.mean(errors)) == pytest.approx(np.sqrt(np.mean(sigmas)), rel=0.1)
    assert np.sqrt(np.mean(errors)) < 0.00012


@pytest.mark.parametrize("wrong", [1, 3, 6])
def test_wrong_detections_are_left_out(wrong: int) -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        data = samples(grid(), rng)
        bad = rng.choice(len(data), wrong, replace=False)
        for i in bad:
            shift = rng.normal(size=3)
            shift *= rng.uniform(0.002, 0.2) / np.linalg.norm(shift)
            data[i] = Sample(reading=data[i].reading, tip=data[i].tip + shift, covariance=NOISE)
        result = calibrate(data, CAMERAS)
        assert set(np.flatnonzero(~result.fit.used)) == set(bad), seed
        np.testing.assert_allclose(result.camera_from_base.translation, TRUE_POSE.translation, atol=0.0004)


def test_what_is_left_out_does_not_change_what_is_told_of_the_rest() -> None:
    """A tip that was seen at the tracker's greatest depth once raised the reported noise by half."""
    data = samples(grid(), np.random.default_rng(1))
    query, places = grid(2, 2), (2, 9, 15, 20)
    rest = [sample for number, sample in enumerate(data) if number not in places]
    for number in places:
        far = data[number].tip * 1.5 / data[number].tip[2]
        data[number] = Sample(reading=data[number].reading, tip=far, covariance=pair_covariance(far, SIGMA_PX))
    alone, found = calibrate(rest, CAMERAS), calibrate(data, CAMERAS)
    assert set(np.flatnonzero(~found.fit.used)) == set(places)
    assert found.sigma_m(query) == pytest.approx(alone.sigma_m(query), rel=0.01)
    assert found.fit.variance_factor == pytest.approx(alone.fit.variance_factor, rel=0.05)


@pytest.mark.parametrize("wrong", [0, 1, 4])
@pytest.mark.parametrize("seed", range(3))
def test_of_many_samples_the_first_ones_count_no_more_than_others(seed: int, wrong: int) -> None:
    rng = np.random.default_rng(seed)
    readings = np.column_stack([rng.uniform((0.03, 0.03), (0.33, 0.18), (300, 2)), rng.choice([0.0, 0.012], 300)])
    data = samples(readings, rng)
    for i in range(wrong):
        data[i] = Sample(reading=data[i].reading, tip=data[i].tip + (0.02, 0.01, 0.0), covariance=NOISE)
    result = calibrate(data, CAMERAS)
    left_out = np.flatnonzero(~result.fit.used)
    assert left_out[:wrong].tolist() == list(range(wrong)) and len(left_out) <= wrong + 2
    np.testing.assert_allclose(result.camera_from_base.translation, TRUE_POSE.translation, atol=0.0002)


def test_the_misfit_is_that_of_the_fit_that_is_used() -> None:
    for seed in range(5):
        data = samples(grid(), np.random.default_rng(seed))
        fit = calibrate(data, CAMERAS).fit
        design = np.column_stack([grid(), np.ones(len(grid()))])
        off = (np.array([s.tip for s in data]) - design @ fit.regression)[fit.used]
        freedom = off.size - fit.regression.size
        assert fit.rms_m == pytest.approx(np.sqrt(3 * np.sum(off**2) / freedom), rel=1e-9), seed


def line(count: int, step: tuple[float, float, float]) -> np.ndarray:
    return np.array([0.1, 0.05, 0.0]) + np.arange(count)[:, None] * np.array(step)


@pytest.mark.parametrize(
    ("readings", "message"),
    [
        (grid()[:3], r"3 samples \(at least 6\): move to another position"),
        (
            line(8, (0.0, 0.0, 0.0)),
            r"the readings do not differ \(0\.00 mm\): the gantry did not move; move at least 60 mm",
        ),
        (line(8, (0.004, 0.001, 0.0)), r"too close together \(28\.\d mm\): move at least 60 mm in x and in y"),
        (
            line(8, (0.02, 0.0, 0.0)),
            r"lie on one line \(140 mm long, 0\.0 mm across\): add one near x = 170, y = 113 mm",
        ),
        (line(8, (0.0, 0.015, 0.0)), r"lie on one line .* add one near x = 163, y = 10[23] mm"),
        (
            np.vstack([line(6, (0.03, 0.0, 0.0)), [(0.2, 0.07, 0.0)]]),
            r"hardly leave one line .*21\.\d mm across.*at least 60 mm off",
        ),
        (
            grid(stylus=(0.0,)) @ np.array([[1, 0, 0.04], [0, 1, 0.01], [0, 0, 0]]),
            r"extension changes together with x and y \(own part 0\.00 mm\): add a sample at the same x and y",
        ),
    ],
)
def test_what_cannot_be_solved_is_refused_with_the_move_that_helps(readings: np.ndarray, message: str) -> None:
    with pytest.raises(DegenerateError, match=message):
        calibrate(samples(readings), CAMERAS)


def test_the_suggested_place_makes_the_samples_sufficient() -> None:
    for step in ((0.02, 0.0, 0.0), (0.0, 0.015, 0.0), (0.02, 0.013, 0.0)):
        collinear = line(8, step)
        with pytest.raises(DegenerateError) as refusal:
            calibrate(samples(collinear), CAMERAS)
        x, y = re.search(r"near x = (\d+), y = (\d+) mm", str(refusal.value)).groups()  # type: ignore[union-attr]
        assert_exact(calibrate(samples(np.vstack([collinear, [(float(x) / 1e3, float(y) / 1e3, 0.0)]])), CAMERAS))


def test_tip_that_stays_while_the_gantry_moves_is_refused() -> None:
    still = [Sample(reading=q, tip=np.array([0.0, 0.0, 0.6]), covariance=NOISE) for q in grid()]
    with pytest.raises(
        DegenerateError, match=r"moved 30\d mm but the cameras saw the tip move only 0\.0 mm: they track another object"
    ):
        calibrate(still, CAMERAS)


def test_too_many_misfits_are_refused_with_their_numbers() -> None:
    rng = np.random.default_rng(4)
    data = samples(grid(), rng)
    for i in range(0, 24, 3):
        data[i] = Sample(reading=data[i].reading, tip=data[i].tip + rng.normal(0, 0.02, 3), covariance=NOISE)
    with pytest.raises(DegenerateError, match=r"8 of 24 samples do not fit the rest \(numbers 1, 4, 7, 10"):
        calibrate(data, CAMERAS)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        (np.array([[1.2, 0.0], [0.0, 1.0]]), r"the x axis moves 1\.200 m per metre of reading"),
        (np.array([[1.0, 0.0], [0.0, 0.5]]), r"the y axis moves 0\.500 m per metre"),
        (np.array([[1.0, 0.1], [0.0, 1.0]]), r"miss a right angle by 5\.7 degrees \(limit 2\.9\)"),
    ],
)
def test_axes_that_no_machine_has_are_refused(axes: np.ndarray, message: str) -> None:
    readings = grid()
    base = np.column_stack([readings[:, :2] @ axes.T, -readings[:, 2]])
    data = [Sample(reading=q, tip=t, covariance=NOISE) for q, t in zip(readings, TRUE_POSE.apply(base))]
    with pytest.raises(DegenerateError, match=message):
        calibrate(data, CAMERAS)


@pytest.mark.parametrize(
    ("off_m", "message"),
    [
        (
            (0.0, 0.0, 0.006),
            r"the stylus moves \d\.\d{3} m towards the panel per metre of extension, 0\.95 to 1\.05 are",
        ),
        ((0.006, 0.0, 0.0), r"the stylus leans by 2\d\.\d degrees \(limit 2\.9\): add samples"),
    ],
)
def test_a_wrong_tip_that_alone_tells_of_the_stylus_is_refused(off_m: tuple[float, ...], message: str) -> None:
    data = samples(np.vstack([grid(stylus=(0.0,)), (0.13, 0.08, 0.012)]))
    last = data[-1]
    data[-1] = Sample(reading=last.reading, tip=last.tip + off_m, covariance=NOISE)
    with pytest.raises(DegenerateError, match=message):
        calibrate(data, CAMERAS)


@pytest.mark.parametrize(
    "machine", [np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0]), np.eye(3)[[1, 0, 2]], np.diag([1.0, 1.0, -1.0])]
)
def test_an_axis_that_runs_backwards_or_two_that_are_swapped_are_refused_as_such(machine: np.ndarray) -> None:
    found = samples(grid())
    tips = true_tips(grid() @ machine.T)
    mirrored = [Sample(reading=s.reading, tip=tip, covariance=s.covariance) for s, tip in zip(found, tips)]
    with pytest.raises(DegenerateError, match="x or y runs backwards, both have changed places, or the stylus rises"):
        calibrate(mirrored, CAMERAS)


@pytest.mark.parametrize("machine", [np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0]), np.eye(3)[[1, 0, 2]]])
def test_they_are_also_where_the_stylus_was_at_one_extension(machine: np.ndarray) -> None:
    readings = grid(stylus=(0.0,))
    mirrored = [Sample(reading=q, tip=tip, covariance=NOISE) for q, tip in zip(readings, true_tips(readings @ machine))]
    with pytest.raises(DegenerateError, match="one runs backwards, or both have changed places"):
        calibrate(mirrored, CAMERAS)


def test_noise_beyond_the_limit_is_refused() -> None:
    rng = np.random.default_rng(0)
    data = [Sample(reading=s.reading, tip=s.tip + rng.normal(0, 0.001, 3), covariance=NOISE) for s in samples(grid())]
    with pytest.raises(DegenerateError, match=r"miss one another by 1\.\d\d mm rms \(limit 0\.70 mm\)"):
        calibrate(data, CAMERAS)


def test_a_reading_that_is_no_number_is_refused() -> None:
    data = samples(grid())
    data[2] = Sample(reading=data[2].reading, tip=np.array([0.0, np.nan, 0.5]), covariance=NOISE)
    with pytest.raises(DegenerateError, match="not finite"):
        calibrate(data, CAMERAS)
