"""Matching of corners: known shifts on made pictures, truth of photographs, limits and empty input."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from unit.harris_perception.rendered_stylus import stereo_model

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.stereo.matches import triangulated
from harris_perception.core.stereo.rectifier import Rectifier
from harris_perception.core.stereo.stereo_matching import StereoMatchConfig, disparity_range, match_corners
from icu_common.core.configuration.config import ConfigError

LIMITS = (2.0, 80.0)


def texture(seed: int = 0, shape: tuple[int, int] = (240, 360)) -> Any:
    """Return a picture of squares, (H, W) float32, with many corners."""
    rng = np.random.default_rng(seed)
    picture = np.full(shape, 120.0, np.float32)
    for _ in range(220):
        x, y = rng.integers(0, shape[1]), rng.integers(0, shape[0])
        picture[y : y + rng.integers(6, 30), x : x + rng.integers(6, 30)] = rng.uniform(20, 235)
    return cv2.GaussianBlur(picture, (0, 0), 0.8)


def shifted(picture: Any, disparity: Any, rng: np.random.Generator, noise: float = 1.0) -> list[Any]:
    """Return left and right uint8 pictures; a right pixel (x, y) shows the left one at x + disparity(x, y)."""
    height, width = picture.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    right = cv2.remap(picture, x + disparity.astype(np.float32), y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return [np.clip(p + rng.normal(0, noise, p.shape) + 0.5, 0, 255).astype(np.uint8) for p in (picture, right)]


def corners(*pictures: Any, count: int = 1500) -> list[Any]:
    detector = HarrisDetector(HarrisConfig(max_corners=count))
    return [detector.detect(p).xy for p in pictures]


@pytest.mark.parametrize(
    ("at_zero", "slope_x", "slope_y"), [(31.3, 0.0, 0.0), (20.0, 0.03, -0.08), (44.75, -0.05, 0.0)]
)
def test_disparity_is_measured_to_a_fraction_of_a_pixel(at_zero: float, slope_x: float, slope_y: float) -> None:
    rng = np.random.default_rng(1)
    picture = texture()
    y, x = np.mgrid[0 : picture.shape[0], 0 : picture.shape[1]]
    left, right = shifted(picture, at_zero + slope_x * x + slope_y * y, rng)
    a, b = corners(left, right)
    matches = match_corners(left, right, a, b, LIMITS, StereoMatchConfig())
    # left x = x + d(x, y) with d linear in the right x
    u, v = matches.left_px.T
    truth = (at_zero + slope_x * u + slope_y * v) / (1 + slope_x)
    inside = (u - truth > 8) & (u < picture.shape[1] - 8)
    error = (matches.disparity_px - truth)[inside]
    print(f"{len(error)} matches, rms {np.sqrt((error**2).mean()):.3f} px")
    assert len(error) > 150
    assert (np.abs(error) < 1.0).mean() > 0.97
    assert np.sqrt((error[np.abs(error) < 1] ** 2).mean()) < 0.12
    assert np.median(np.abs(error) / matches.sigma_px[inside]) < 1.5
    assert matches.correlation[matches.index[:, 1] >= 0].min() >= 0.8


def test_the_partner_is_the_corner_of_the_right_picture() -> None:
    left, right = shifted(texture(), np.full((240, 360), 25.0), np.random.default_rng(2))
    a, b = corners(left, right)
    matches = match_corners(left, right, a, b, LIMITS, StereoMatchConfig(guided=False))
    assert (matches.index >= 0).all() and len(set(matches.index[:, 1])) == len(matches)
    assert np.allclose(a[matches.index[:, 0]], matches.left_px)
    assert np.abs(b[matches.index[:, 1]] + [25, 0] - matches.left_px).max() < 2.0
    guided = match_corners(left, right, a, b[::2], LIMITS, StereoMatchConfig())
    alone = guided.index[:, 1] < 0
    assert alone.sum() > 30 and np.abs(guided.disparity_px[alone] - 25).max() < 1.0


def test_repeated_texture_is_left_out() -> None:
    stripes = np.tile(np.repeat([40.0, 200.0], 8), 23)[:360].astype(np.float32)
    picture = np.where((np.arange(240) // 8 % 2 == 0)[:, None], stripes, 240 - stripes).astype(np.float32)
    left, right = shifted(cv2.GaussianBlur(picture, (0, 0), 0.8), np.full((240, 360), 32.0), np.random.default_rng(3))
    a, b = corners(left, right, count=0)
    assert len(a) > 1000
    for probable in (0.6, 0.0):
        assert len(match_corners(left, right, a, b, LIMITS, StereoMatchConfig(min_probability=probable))) < 0.1 * len(a)


def test_disparity_stays_inside_its_limits() -> None:
    left, right = shifted(texture(), np.full((240, 360), 50.0), np.random.default_rng(4))
    a, b = corners(left, right)
    wrong = match_corners(left, right, a, b, (2.0, 40.0), StereoMatchConfig())
    assert len(wrong) < 0.15 * len(a) and (wrong.disparity_px <= 40).all()
    found = match_corners(left, right, a, b, (45.0, 55.0), StereoMatchConfig())
    assert len(found) > 150 and found.disparity_px.min() >= 45 and found.disparity_px.max() <= 55


@pytest.mark.parametrize("side", [0, 1])
def test_no_corners_no_matches(side: int) -> None:
    left, right = shifted(texture(), np.full((240, 360), 25.0), np.random.default_rng(5))
    points = corners(left, right)
    points[side] = np.empty((0, 2), np.float32)
    matches = match_corners(left, right, *points, LIMITS, StereoMatchConfig())
    assert len(matches) == 0 and matches.left_px.shape == (0, 2) and matches.index.shape == (0, 2)
    flat = np.full((240, 360), 90, np.uint8)
    assert len(match_corners(flat, flat, *corners(left, right), LIMITS, StereoMatchConfig())) == 0


@pytest.mark.parametrize("cut", [np.s_[:120], np.s_[:, :200]])
def test_pictures_of_different_sizes_are_refused_and_nothing_beside_them_is_read(cut: Any) -> None:
    left, right = shifted(texture(), np.full((240, 360), 25.0), np.random.default_rng(5))
    smaller = np.ascontiguousarray(right[cut])
    a, b = corners(left, smaller)
    with pytest.raises(ValueError, match=rf"\(240, 360\) and \({smaller.shape[0]}, {smaller.shape[1]}\)"):
        match_corners(left, smaller, a, b, LIMITS, StereoMatchConfig())


def test_points_are_metric_and_their_uncertainty_grows_with_depth() -> None:
    stereo = stereo_model()
    left, right = shifted(texture(shape=(480, 800)), np.full((480, 800), 300.0), np.random.default_rng(6))
    a, b = corners(left, right)
    low, high = disparity_range(stereo, StereoMatchConfig())
    assert low == pytest.approx(1700 * 0.12 / 1.5) and high == pytest.approx(1700 * 0.12 / 0.2)
    matches = match_corners(left, right, a, b, (low, high), StereoMatchConfig())
    points = triangulated(stereo, matches)
    assert np.median(points[:, 2]) == pytest.approx(1700 * 0.12 / 300, rel=1e-3)
    assert np.allclose(points[:, 0] / points[:, 2] * 1700 + 399.5, matches.left_px[:, 0])
    assert np.allclose(points[:, 3], points[:, 2] ** 2 / (1700 * 0.12) * matches.sigma_px)


def test_rectified_pictures_and_rectified_corners_agree() -> None:
    stereo = stereo_model()
    raw = np.full((480, 800), 40, np.uint8)
    centres = np.stack(np.meshgrid(np.arange(60, 760, 110), np.arange(60, 440, 90)), axis=-1).reshape(-1, 2)
    for x, y in centres:
        cv2.circle(raw, (int(x), int(y)), 6, 220, -1, cv2.LINE_AA)
    rectified = Rectifier(stereo.left)(raw).astype(float) - 40
    for u, v in stereo.left.rectify(centres):
        box = rectified[round(v) - 10 : round(v) + 11, round(u) - 10 : round(u) + 11]
        rows, columns = np.mgrid[-10:11, -10:11]
        assert (box * columns).sum() / box.sum() + round(u) == pytest.approx(u, abs=0.1)
        assert (box * rows).sum() / box.sum() + round(v) == pytest.approx(v, abs=0.1)
    smaller = Rectifier(stereo.left, (700, 400))(raw)
    assert smaller.shape == (400, 700) and np.abs(smaller - rectified[:400, :700] - 40).max() <= 1
    with pytest.raises(ValueError, match=r"\(480, 800\)"):
        Rectifier(stereo.left)(raw[:100])
    with pytest.raises(ValueError, match=r"\(480, 800\) uint16: \(480, 800\) uint8 is calibrated"):
        Rectifier(stereo.left)(raw.astype(np.uint16))  # type: ignore[arg-type]


def test_turning_the_pictures_costs_no_precision_and_sigma_tells_the_error() -> None:
    stereo, rng, picture = stereo_model(), np.random.default_rng(8), texture(shape=(480, 800))
    y, x = np.mgrid[0:480, 0:800].astype(np.float32)
    at_zero, slope_x, slope_y = 300.3, 0.02, -0.03
    across = (x + at_zero + slope_x * x + slope_y * y).astype(np.float32)
    seen = cv2.remap(picture, across, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    raws = []
    for model, rectified in ((stereo.left, picture), (stereo.right, seen)):
        u, v = model.rectify(np.column_stack([x.ravel(), y.ravel()])).astype(np.float32).T.reshape(2, 480, 800)
        raw = cv2.remap(rectified, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        raws.append(np.clip(raw + rng.normal(0, 1, raw.shape) + 0.5, 0, 255).astype(np.uint8))
    at = (model.rectify(xy) for model, xy in zip((stereo.left, stereo.right), corners(*raws)))
    turned = (Rectifier(model)(raw) for model, raw in zip((stereo.left, stereo.right), raws))
    matches = match_corners(*turned, *at, (100.0, 700.0), StereoMatchConfig())
    u, v = matches.left_px.T
    error = matches.disparity_px - (at_zero + slope_x * u + slope_y * v) / (1 + slope_x)
    right = np.abs(error) < 0.6
    rms = float(np.sqrt((error[right] ** 2).mean()))
    print(f"{right.sum()} of {len(error)} matches, rms {rms:.3f} px, sigma {matches.sigma_px[right].mean():.3f} px")
    assert right.sum() > 150 and right.mean() > 0.95
    assert rms < 0.06
    assert np.sqrt((error[right] ** 2 / matches.sigma_px[right] ** 2).mean()) < 1.0


def test_settings_that_contradict_are_refused() -> None:
    with pytest.raises(ConfigError, match="window_px = 10"):
        StereoMatchConfig(window_px=10)
    with pytest.raises(ConfigError, match="max_depth_m"):
        StereoMatchConfig(min_depth_m=2.0)


def photographs() -> list[tuple[str, Any, Any, Any, tuple[float, float]]]:
    place = os.environ.get("ICU_TEST_DATA")
    if not place or not (Path(place) / "stereo").is_dir():
        pytest.skip("ICU_TEST_DATA names no folder with stereo/: photographs with known disparity")
    folder = Path(place) / "stereo"
    aloe = [cv2.imread(str(folder / "aloe" / f"aloe{part}"), 0) for part in ("L.jpg", "R.jpg", "GT.png")]
    aloe = [
        cv2.resize(aloe[0], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
        cv2.resize(aloe[1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
        aloe[2][::2, ::2] / 2,
    ]
    moto = [cv2.imread(str(folder / "motorcycle" / f"motorcycle_{side}.png"), 0) for side in ("left", "right")]
    moto.append(np.load(folder / "motorcycle" / "motorcycle_disp.npz")["arr_0"].astype(float))
    return [("aloe", *aloe, (1.0, 130.0)), ("motorcycle", *moto, (1.0, 90.0))]


def visible(truth: Any) -> Any:
    """Return where the left image shows the same as the right one: nothing nearer lands on the same column."""
    height, width = truth.shape
    y, x = np.nonzero(truth > 0)
    d = truth[y, x]
    there = np.round(x - d).astype(int)
    inside = there >= 0
    y, x, d, there = y[inside], x[inside], d[inside], there[inside]
    front = np.zeros((height, width + 1))
    for step in (0, 1):
        np.maximum.at(front, (y, there + step), d)
    result = np.zeros(truth.shape, bool)
    result[y, x] = d >= front[y, there] - 1.5
    return result


def photograph_rates(config: StereoMatchConfig) -> list[tuple[float, float]]:
    rates: list[tuple[float, float]] = []
    for name, left, right, truth, limits in photographs():
        truth = np.where(np.isfinite(truth), truth, 0.0)
        a, b = corners(left, right)
        matches = match_corners(left, right, a, b, limits, config)
        assert len(set(matches.index[:, 0])) == len(matches), "a corner was matched twice"
        assert np.allclose(a[matches.index[:, 0]], matches.left_px)
        u, v = np.round(matches.left_px).astype(int).T
        known = truth[v, u] > 0
        right_ones = known & (np.abs(matches.disparity_px - truth[v, u]) <= 1)
        i = np.round(a).astype(int)
        rates.append((right_ones.sum() / known.sum(), right_ones.sum() / visible(truth)[i[:, 1], i[:, 0]].sum()))
        print(f"{name}: {len(matches)} matches, precision {rates[-1][0]:.3f}, recall {rates[-1][1]:.3f}")
    return rates


def test_photographs_with_known_disparity() -> None:
    rates = photograph_rates(StereoMatchConfig())
    precision, recall = np.mean(rates, axis=0)
    assert precision >= 0.93 and recall >= 0.62
    assert min(rate[0] for rate in rates) >= 0.92
    assert min(rate[1] for rate in rates) >= 0.82
    assert precision >= 0.95 and recall >= 0.84
    # Every corner that may be right: many more wrong ones.
    everything = photograph_rates(StereoMatchConfig(min_probability=0.0))
    for (before, _), (precise, found) in zip(rates, everything):
        assert found >= 0.85 and 0.85 <= precise < before - 0.03
