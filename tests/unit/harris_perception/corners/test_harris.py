"""The detector against the formula written naively, against OpenCV, and against pictures whose corners are known."""

from __future__ import annotations

import doctest
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harris_perception.core.corners import harris
from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.image import compiled
from icu_common.core.configuration.config import ConfigError

KERNELS = {"harris": (1.0, 1.0, 1.0), "sobel": (1.0, 2.0, 1.0)}


def correlate(picture: np.ndarray, down: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Correlate with the outer product of two odd filters where they fit, in float64."""
    h, w = picture.shape[0] - len(down) + 1, picture.shape[1] - len(right) + 1
    total = np.zeros((h, w))
    for i, d in enumerate(down):
        for j, r in enumerate(right):
            total += float(d) * float(r) * picture[i : i + h, j : j + w]
    return total


def naive(picture: np.ndarray, config: HarrisConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return response and rounding scale by the formulas of the papers; both only where the kernels fit."""
    if config.gradient == "gaussian":
        s = config.sigma_d_px
        t = np.arange(-np.ceil(3 * s), np.ceil(3 * s) + 1)
        smooth = np.exp(-(t**2) / (2 * s * s))
        slope = t * smooth / (t * t * smooth).sum()
        smooth = smooth / smooth.sum()
    else:
        smooth, slope = np.array(KERNELS[config.gradient]), np.array([-1.0, 0.0, 1.0])
    gx, gy = correlate(picture, smooth, slope), correlate(picture, slope, smooth)
    if config.window == "box":
        window = np.ones(config.window_px)
    else:
        t = np.arange(-np.ceil(3 * config.sigma_i_px), np.ceil(3 * config.sigma_i_px) + 1)
        window = np.exp(-(t**2) / (2 * config.sigma_i_px**2))
        window = window / window.sum()
    a, b, c = (correlate(p, window, window) for p in (gx * gx, gy * gy, gx * gy))
    m = np.stack([np.stack([a, c], -1), np.stack([c, b], -1)], -2)
    det, trace = np.linalg.det(m), a + b
    if config.response == "harris":
        return det - config.k * trace**2, a * b + c * c + config.k * trace**2
    if config.response == "shi_tomasi":
        return np.linalg.eigvalsh(m)[..., 0], trace
    if config.response == "geometric":
        det = np.maximum(det, 0.0)
        gate = np.divide(det, det + config.k * trace**2, out=np.zeros_like(det), where=trace > 0)
        return np.sqrt(det) * gate, trace
    return np.divide(det, trace, out=np.zeros_like(det), where=trace > 0), trace


def texture(seed: int, height: int, width: int, dtype: Any = np.uint8) -> np.ndarray:
    """Return noise, blocks or soft blobs."""
    rng = np.random.default_rng(seed)
    kind = seed % 3
    if kind == 0:
        picture = rng.integers(0, 256, (height, width)).astype(np.float64)
    elif kind == 1:
        picture = np.kron(rng.integers(0, 256, (height // 5 + 1, width // 5 + 1)), np.ones((5, 5)))[:height, :width]
    else:
        picture = cv2.GaussianBlur(rng.uniform(0, 255, (height, width)), (0, 0), 1.5)
    return picture.astype(np.uint8).astype(dtype)


configs = st.builds(
    HarrisConfig,
    gradient=st.sampled_from(["harris", "sobel", "gaussian"]),
    sigma_d_px=st.sampled_from([0.7, 1.0, 1.6]),
    window=st.sampled_from(["box", "gaussian"]),
    window_px=st.sampled_from([3, 5, 9]),
    sigma_i_px=st.sampled_from([0.8, 2.0]),
    response=st.sampled_from(["harris", "shi_tomasi", "noble", "geometric"]),
    k=st.floats(0.01, 0.2),
    relative_threshold=st.sampled_from([0.0, 0.01, 0.2]),
    subpixel=st.just(False),
    max_corners=st.just(0),
)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), height=st.integers(1, 50), width=st.integers(1, 60), config=configs)
def test_response_and_corners_follow_the_formula(seed: int, height: int, width: int, config: HarrisConfig) -> None:
    picture = texture(seed, height, width)
    detector = HarrisDetector(config)
    response, corners = detector.response(picture), detector.detect(picture)
    margin = detector.margin_px
    assert response.shape == picture.shape and response.dtype == np.float32
    if min(picture.shape) <= 2 * margin:
        assert not response.any() and len(corners) == 0
        return
    expected, scale = naive(picture.astype(np.float64), config)
    inside = np.s_[margin : height - margin, margin : width - margin]
    tolerance = 3e-5 * scale + 1e-6
    assert (np.abs(response[inside] - expected) <= tolerance).all()
    check_peaks(expected, tolerance, corners, margin, config.relative_threshold)


def check_peaks(
    expected: np.ndarray, tolerance: np.ndarray, corners: harris.Corners, margin: int, relative: float
) -> None:
    """Check both directions, up to rounding: what is found is a peak, and every clear peak is found."""
    h, w = expected.shape
    if min(h, w) < 3:
        assert len(corners) == 0
        return
    centre, slack = expected[1:-1, 1:-1], tolerance.max()
    around = np.stack(
        [expected[1 + i : h - 1 + i, 1 + j : w - 1 + j] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    )
    peak = centre > around.max(axis=0) + 2 * slack
    nearly = centre >= around.max(axis=0) - 2 * slack
    strongest = centre[nearly].max(initial=0.0)
    must = peak & (centre > relative * strongest + 2 * slack)
    may = nearly & (centre > relative * strongest - 2 * slack)
    found = {(int(x) - margin - 1, int(y) - margin - 1) for x, y in corners.xy}
    assert len(found) == len(corners)
    assert {(x, y) for y, x in np.argwhere(must).tolist()} <= found
    assert found <= {(x, y) for y, x in np.argwhere(may).tolist()}
    for (x, y), r in zip(corners.xy.astype(int), corners.response):
        assert abs(r - centre[y - margin - 1, x - margin - 1]) <= slack
    assert (np.diff(corners.response) <= 0).all()


@pytest.mark.parametrize("gradient", ["harris", "sobel"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize(("height", "width"), [(7, 7), (8, 9), (60, 645), (61, 646), (33, 1300), (48, 1283)])
def test_fused_pass_finds_the_peaks_of_the_response(gradient: str, dtype: Any, height: int, width: int) -> None:
    # The strips of columns (640 wide), pairs of rows and both ends of each are all in these sizes.
    config = HarrisConfig(gradient=gradient, max_corners=0, relative_threshold=0.001, subpixel=False)
    picture = texture(3 * height + width, height, width, dtype)
    expected, scale = naive(picture.astype(np.float64), config)
    check_peaks(expected, 1e-6 * scale, HarrisDetector(config).detect(picture), 2, 0.001)


def test_of_a_picture_that_is_full_of_corners_none_is_lost() -> None:
    config = HarrisConfig(max_corners=0, relative_threshold=0.0, k=0.001, subpixel=False)
    picture = np.random.default_rng(6).integers(0, 256, (300, 700), np.uint8)
    corners = HarrisDetector(config).detect(picture)
    assert len(corners) > 2048 + picture.size // 32  # what there is room for at first
    expected, scale = naive(picture.astype(np.float64), config)
    check_peaks(expected, 1e-6 * scale, corners, 2, 0.0)


def test_responses_of_the_1988_kernels_are_exact_up_to_the_last_formula() -> None:
    # The sums are integers below 2^24, so float32 holds them exactly and only the final formula rounds.
    picture = np.kron(np.random.default_rng(5).choice([0, 255], (12, 12)), np.ones((4, 4))).astype(np.uint8)
    corners = HarrisDetector(HarrisConfig(max_corners=0, subpixel=False)).detect(picture)
    expected, scale = naive(picture.astype(np.float64), HarrisConfig())
    x, y = corners.xy.astype(int).T - 2
    assert len(corners) > 20
    assert (np.abs(corners.response - expected[y, x]) <= 2e-7 * scale[y, x]).all()


@pytest.mark.parametrize("window", [3, 5])
def test_response_agrees_with_opencv_where_the_definitions_coincide(window: int) -> None:
    picture = texture(4, 80, 90)
    ours = HarrisDetector(HarrisConfig(gradient="sobel", window_px=window, k=0.06)).response(picture)
    theirs = cv2.cornerHarris(picture, window, 3, 0.06) * (4.0 * window * 255.0) ** 4
    inside = np.s_[8:-8, 8:-8]
    np.testing.assert_allclose(ours[inside], theirs[inside], atol=2e-6 * np.abs(theirs).max())


def test_corners_agree_with_good_features_to_track() -> None:
    picture = texture(2, 300, 400)
    config = HarrisConfig(gradient="sobel", max_corners=0, subpixel=False)
    ours = {(int(x), int(y)) for x, y in HarrisDetector(config).detect(picture).xy}
    found = cv2.goodFeaturesToTrack(picture, 0, 0.01, 0, blockSize=3, useHarrisDetector=True, k=0.04)
    theirs = {(int(x), int(y)) for x, y in found.reshape(-1, 2) if 3 <= x < 397 and 3 <= y < 297}
    assert len(theirs) > 500
    assert len(ours & theirs) >= 0.995 * max(len(ours), len(theirs))


def polygon_picture(polygons: list[tuple[list[tuple[float, float]], int]], size: int = 64) -> np.ndarray:
    """Return polygons with exact area coverage (16x16 samples a pixel); pixel centres are at integers."""
    factor = 16
    big = np.zeros((size * factor, size * factor), np.uint8)
    for points, value in polygons:
        scaled = [((x + 0.5) * factor - 0.5, (y + 0.5) * factor - 0.5) for x, y in points]
        cv2.fillPoly(big, [np.rint(np.array(scaled) * 16).astype(np.int32)], value, lineType=cv2.LINE_8, shift=4)
    return big.reshape(size, factor, size, factor).mean(axis=(1, 3)).astype(np.float32)


def sector(cx: float, cy: float, start_deg: float, end_deg: float, radius: float = 200.0) -> list[tuple[float, float]]:
    angles = np.deg2rad(np.linspace(start_deg, end_deg, 9))
    return [(cx, cy), *((cx + radius * np.cos(t), cy + radius * np.sin(t)) for t in angles)]


@pytest.mark.parametrize(
    ("name", "rays_deg", "values"),
    [
        ("L", [10, 100], [200, 40]),
        ("T", [0, 180, 270], [40, 200, 110]),
        ("Y", [30, 150, 270], [40, 200, 110]),
        ("X", [20, 110, 200, 290], [200, 40, 200, 40]),
    ],
)
def test_junctions_are_one_corner_at_the_right_place(name: str, rays_deg: list[float], values: list[int]) -> None:
    cx, cy = 31.3, 32.6
    ends = [*rays_deg[1:], rays_deg[0] + 360]
    parts = [(sector(cx, cy, a, b), v) for a, b, v in zip(rays_deg, ends, values)]
    picture = cv2.GaussianBlur(polygon_picture(parts), (0, 0), 0.8)
    config = HarrisConfig(gradient="gaussian", window="gaussian", sigma_i_px=3.0, relative_threshold=0.05)
    corners = HarrisDetector(config).detect(picture)
    assert len(corners) == 1, (name, corners.xy)
    assert np.hypot(*(corners.xy[0] - (cx, cy))) < config.sigma_i_px  # it lies inside the wedge, by less than sigma
    assert len(HarrisDetector(HarrisConfig(relative_threshold=0.05)).detect(picture)) >= 1


@pytest.mark.parametrize(("dx", "dy"), [(0.0, 0.0), (0.5, 0.5), (0.25, -0.4), (-0.37, 0.12), (0.49, 0.31)])
def test_checkerboard_crossing_is_found_to_a_tenth_of_a_pixel(dx: float, dy: float) -> None:
    cx, cy = 30.0 + dx, 33.0 + dy
    covered = np.clip(np.arange(64) + 0.5 - cx, 0, 1), np.clip(np.arange(64)[:, None] + 0.5 - cy, 0, 1)
    picture = 20.0 + 200.0 * (covered[0] * covered[1] + (1 - covered[0]) * (1 - covered[1]))
    config = HarrisConfig(gradient="gaussian", window="gaussian", sigma_i_px=3.0, relative_threshold=0.1)
    corners = HarrisDetector(config).detect(picture.round().astype(np.uint8))
    assert len(corners) == 1
    np.testing.assert_allclose(corners.xy[0], (cx, cy), atol=0.1)


def places_of(peaks: list[np.ndarray]) -> np.ndarray:
    """How far from their middle, (N, 2) px, the only corners of responses (3, 3) are set."""
    response = np.zeros((13, 7 * len(peaks) + 6), np.float32)
    for number, peak in enumerate(peaks):
        response[5:8, 7 * number + 5 : 7 * number + 8] = peak
    xy = HarrisDetector(HarrisConfig(relative_threshold=0.0, max_corners=0)).corners_of(response).xy
    assert len(xy) == len(peaks)
    middles = np.column_stack((7 * np.arange(len(peaks)) + 6, np.full(len(peaks), 6)))
    return np.asarray(xy[np.argsort(xy[:, 0])] - middles)


@given(
    flat=st.floats(0.02, 0.1),
    steep=st.floats(0.1, 0.2),
    turn=st.floats(0, np.pi),
    way=st.floats(0, 2 * np.pi),
)
def test_a_place_does_not_jump_where_the_fit_is_ill_conditioned(
    flat: float, steep: float, turn: float, way: float
) -> None:
    """The maximum of a ridge leaves the pixel: once out of it, each axis was taken alone, a quarter of a pixel off."""
    y, x = np.mgrid[-1:2, -1:2]
    along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    ridge = 1.0 - (flat * along**2 + steep * across**2) / 2
    slope = (np.cos(way) * x + np.sin(way) * y) * flat
    peaks = [ridge + amount * slope for amount in np.linspace(0.0, 1.0, 400)]
    places = places_of([peak for peak in peaks if (peak < peak[1, 1]).sum() == 8])
    assert np.abs(np.diff(places, axis=0)).max() < 0.02


@given(seed=st.integers(0, 100_000))
def test_a_place_is_where_the_quadratic_is_greatest_in_its_pixel(seed: int) -> None:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1:2, -1:2]
    hxx, hyy = -rng.uniform(0.05, 0.3, 2)
    hxy = rng.uniform(-0.7, 0.7) * np.sqrt(hxx * hyy)
    gx, gy = rng.uniform(-0.5, 0.5, 2) * (-hxx, -hyy)
    peak = 1.0 + gx * x + gy * y + (hxx * x * x + hyy * y * y) / 2 + hxy * x * y
    if (peak.ravel()[[0, 1, 2, 3, 5, 6, 7, 8]] >= peak[1, 1]).any():
        return
    v, u = np.mgrid[-0.5:0.5:501j, -0.5:0.5:501j]
    value = gx * u + gy * v + (hxx * u * u + hyy * v * v) / 2 + hxy * u * v
    best = np.unravel_index(value.argmax(), value.shape)
    np.testing.assert_allclose(places_of([peak])[0], (u[best], v[best]), atol=0.004)


@pytest.mark.parametrize("response", ["harris", "shi_tomasi", "noble", "geometric"])
@pytest.mark.parametrize("gradient", ["harris", "gaussian"])
def test_ramps_and_straight_edges_have_no_corner(response: str, gradient: str) -> None:
    y, x = np.indices((60, 70)).astype(np.float64)
    detector = HarrisDetector(HarrisConfig(response=response, gradient=gradient))
    for picture in (
        3 * x,
        2 * x + y,
        0.37 * x + 1.713 * y,
        100.0 * (x > 30),
        np.full_like(x, 17.0),
    ):
        assert len(detector.detect(picture.astype(np.float32))) == 0
    assert len(detector.detect((2 * x + y).astype(np.uint8))) == 0


@pytest.mark.parametrize("quarters", [1, 2, 3])
@pytest.mark.parametrize("gradient", ["harris", "sobel", "gaussian"])
def test_corners_turn_with_the_picture(quarters: int, gradient: str) -> None:
    picture = cv2.GaussianBlur(texture(9, 97, 122), (0, 0), 1.0)
    detector = HarrisDetector(HarrisConfig(gradient=gradient, max_corners=0, relative_threshold=0.02))
    straight, turned = detector.detect(picture), detector.detect(np.rot90(picture, quarters).copy())
    xy = straight.xy.astype(np.float64)
    for side in [(picture.shape[1] - 1), (picture.shape[0] - 1), (picture.shape[1] - 1)][:quarters]:
        xy = np.column_stack((xy[:, 1], side - xy[:, 0]))  # np.rot90 turns counter-clockwise on the screen
    assert len(turned) == len(straight) > 30
    nearest = np.linalg.norm(turned.xy[:, None] - xy[None], axis=2)
    assert nearest.min(axis=0).max() < 1e-3 and nearest.min(axis=1).max() < 1e-3


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), gain=st.integers(1, 4), offset=st.integers(0, 50))
def test_gain_and_offset_change_nothing_but_the_response(seed: int, gain: int, offset: int) -> None:
    picture = texture(seed, 40, 50) // 5
    detector = HarrisDetector(HarrisConfig(max_corners=0))
    plain, lit = detector.detect(picture), detector.detect((picture * gain + offset).astype(np.uint8))
    np.testing.assert_allclose(lit.response, plain.response * float(gain) ** 4, rtol=1e-5)
    assert len(plain) == len(lit)
    ours = sorted(map(tuple, plain.xy.round(2).tolist()))
    np.testing.assert_allclose(sorted(map(tuple, lit.xy.round(2).tolist())), ours, atol=0.02)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 1000),
    gain=st.sampled_from([1e-9, 1e-6, 1e-3, 257.0]),
    response=st.sampled_from(["harris", "shi_tomasi", "noble"]),
)
def test_positions_do_not_depend_on_the_unit_of_the_grey_levels(seed: int, gain: float, response: str) -> None:
    picture = texture(seed, 60, 70)
    detector = HarrisDetector(HarrisConfig(max_corners=0, response=response))
    scaled = (picture.astype(np.float64) * gain).astype(np.uint16 if gain > 1.0 else np.float32)
    plain, lit = detector.detect(picture), detector.detect(scaled)
    assert len(plain) == len(lit) > 5
    ours = sorted(map(tuple, plain.xy.round(2).tolist()))
    np.testing.assert_allclose(sorted(map(tuple, lit.xy.round(2).tolist())), ours, atol=0.02)


@pytest.mark.parametrize("doublings", [-140, -100, -40, 13, 22, 30, 60, 119])
@pytest.mark.parametrize(
    "chosen",
    [
        {},
        {"gradient": "sobel", "window_px": 5, "response": "noble"},
        {"gradient": "gaussian", "window": "gaussian", "response": "shi_tomasi"},
        {"gradient": "deriche", "window": "deriche"},
        {"response": "geometric"},
    ],
)
def test_no_unit_of_a_picture_of_floats_loses_corners(doublings: int, chosen: dict[str, Any]) -> None:
    """Responses are of the fourth power of the values, and beyond what float32 holds with them."""
    picture = (texture(2, 60, 70) // 16 * 16).astype(np.float32)  # few bits, which the smallest floats hold, too
    degree = 4 if chosen.get("response", "harris") == "harris" else 2
    scaled, gain = np.ldexp(picture, doublings), 2.0 ** (doublings * degree)
    for relative in (0.0, 0.01):
        usual = HarrisConfig(max_corners=0, relative_threshold=relative, **chosen)
        plain = HarrisDetector(usual).detect(picture)
        weaker = float(np.median(plain.response))
        detector = HarrisDetector(replace(usual, absolute_threshold=weaker * gain))
        found, strong = HarrisDetector(usual).detect(scaled), detector.detect(scaled)
        assert len(plain) > 5
        np.testing.assert_allclose(found.xy, plain.xy, atol=1e-4)
        np.testing.assert_allclose(found.response.astype(np.float64) / gain, plain.response, rtol=1e-5)
        assert len(strong) == (plain.response > weaker).sum()
        strengths = HarrisDetector(usual).strengths_of(found.response)
        ours = HarrisDetector(usual).strengths_of(plain.response)
        np.testing.assert_allclose(np.ldexp(strengths.astype(np.float64), -doublings), ours, rtol=1e-5, atol=2**-7)


@pytest.mark.parametrize("value", [-3.4e38, 1e30])
def test_values_that_stand_for_what_is_unknown_only_hide_their_surroundings(value: float) -> None:
    detector = HarrisDetector(HarrisConfig(relative_threshold=0.0))
    picture = texture(1, 60, 80, np.float32)
    whole = detector.detect(picture)
    picture[:, :20] = value
    holed = detector.detect(picture)
    ours, theirs = ({(float(x), float(y)) for x, y in c.xy if x > 23} for c in (whole, holed))
    assert len(theirs) > 20 and theirs == ours


@pytest.mark.parametrize("value", [0.1, 7.0, 65535.0])
@pytest.mark.parametrize("gradient", ["harris", "gaussian", "deriche"])
@pytest.mark.parametrize("window", ["box", "gaussian", "deriche"])
def test_rounding_on_constant_pictures_is_no_corner(value: float, gradient: str, window: str) -> None:
    picture = np.full((240, 320), value, np.float32)
    for response in ("harris", "shi_tomasi", "noble", "geometric"):
        config = HarrisConfig(gradient=gradient, window=window, response=response)
        assert len(HarrisDetector(config).detect(picture)) == 0, response


@pytest.mark.parametrize("response", ["harris", "shi_tomasi", "noble", "geometric"])
@pytest.mark.parametrize("gradient", ["harris", "deriche"])
def test_a_drawing_has_the_corners_of_the_gaussian_window_by_recursion_too(response: str, gradient: str) -> None:
    """The recursion's remainder of a step far away is below zero; on flat ground both sums of squares are."""
    rng = np.random.default_rng(3)
    picture = np.full((240, 320), 30, np.uint8)
    for y, x, height, width, value in rng.integers((10, 10, 8, 8, 80), (180, 260, 50, 50, 255), (8, 5)):
        picture[y : y + height, x : x + width] = value
    one, other = (
        HarrisDetector(HarrisConfig(gradient=gradient, window=window, response=response))
        for window in ("gaussian", "deriche")
    )
    assert np.isfinite(other.response(picture)).all()
    expected, found = one.detect(picture).xy, other.detect(picture).xy
    assert len(expected) > 15 and abs(len(found) - len(expected)) <= 2
    apart = np.linalg.norm(expected[:, None] - found[None], axis=2).min(axis=1)
    assert (apart < 0.5).sum() >= len(expected) - 2


def test_thresholds_count_and_border() -> None:
    picture = texture(2, 120, 150)

    def corners(**settings_: Any) -> harris.Corners:
        return HarrisDetector(HarrisConfig(**{"max_corners": 0, "subpixel": False, **settings_})).detect(picture)

    everything = corners(relative_threshold=0.0)
    floor = float(everything.response[40])
    assert len(corners(relative_threshold=0.0, absolute_threshold=floor)) == 40
    half = corners(relative_threshold=0.5)
    assert (half.response > 0.5 * everything.response[0]).all()
    assert len(half) == (everything.response > np.float32(0.5) * everything.response[0]).sum()
    strongest = corners(relative_threshold=0.0, max_corners=25)
    np.testing.assert_array_equal(strongest.xy, everything.xy[:25])
    inner = corners(border_px=30, relative_threshold=0.0)
    kept = (everything.xy >= 30).all(axis=1) & (everything.xy < (120, 90)).all(axis=1)
    np.testing.assert_array_equal(inner.xy, everything.xy[kept])


def test_suppression_radius_keeps_the_strongest_of_each_neighbourhood() -> None:
    picture = texture(6, 150, 150)
    base = HarrisConfig(max_corners=0, relative_threshold=0.001)
    everything = HarrisDetector(base).detect(picture)
    radius = 9.0
    apart = HarrisDetector(HarrisConfig(max_corners=0, relative_threshold=0.001, suppression_radius_px=radius)).detect(
        picture
    )
    taken: list[np.ndarray] = []
    for point in everything.xy:  # the naive way
        if all(np.hypot(*(point - other)) >= radius for other in taken):
            taken.append(point)
    assert len(taken) > 30
    np.testing.assert_array_equal(apart.xy, np.array(taken))


def test_even_spread_covers_the_picture() -> None:
    # Strong texture in one quarter, weak in the others: the strongest crowd there, spread ones do not.
    picture = texture(2, 200, 200).astype(np.float32) * 0.2
    picture[:100, :100] *= 5
    crowded = HarrisDetector(HarrisConfig(relative_threshold=0.0, max_corners=80)).detect(picture)
    spread = HarrisDetector(HarrisConfig(relative_threshold=0.0, max_corners=80, even_spread=True)).detect(picture)
    assert len(crowded) == len(spread) == 80
    assert (crowded.xy < 100).all(axis=1).mean() > 0.9
    for left in (0, 100):
        for top in (0, 100):
            inside = ((spread.xy >= (left, top)) & (spread.xy < (left + 100, top + 100))).all(axis=1)
            assert 10 <= inside.sum() <= 30
    assert (np.diff(spread.response) <= 0).all()


@pytest.mark.parametrize("config", [HarrisConfig(), HarrisConfig(response="noble"), HarrisConfig(window="gaussian")])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_pictures_without_corners_give_an_empty_result(config: HarrisConfig, dtype: Any) -> None:
    detector = HarrisDetector(config)
    for shape in ((0, 0), (0, 10), (10, 0), (1, 1), (3, 200), (6, 6), (40, 40)):
        corners = detector.detect(np.full(shape, 55, dtype))
        assert corners.xy.shape == (0, 2) and corners.response.shape == (0,)
        assert corners.xy.dtype == corners.response.dtype == np.float32


@pytest.mark.parametrize(
    "config", [HarrisConfig(), HarrisConfig(response="shi_tomasi"), HarrisConfig(window="gaussian")]
)
def test_pixels_that_are_not_finite_only_hide_their_surroundings(config: HarrisConfig) -> None:
    detector = HarrisDetector(config)
    for value in (np.nan, np.inf, -np.inf):
        assert len(detector.detect(np.full((50, 60), value, np.float32))) == 0
        picture = texture(1, 60, 80, np.float32)
        whole = detector.detect(picture)
        picture[:, :20] = value
        holed = detector.detect(picture)
        far = lambda c: {(float(x), float(y)) for x, y in c.xy if x > 32}  # noqa: E731
        assert np.isfinite(holed.xy).all() and np.isfinite(holed.response).all()
        assert (holed.xy[:, 0] > 20).all()
        if np.argmax(whole.response) >= 0 and whole.xy[0, 0] > 32:
            assert far(whole) == far(holed)


@pytest.mark.parametrize(("gradient", "window"), [("deriche", "box"), ("harris", "deriche"), ("deriche", "deriche")])
def test_one_unknown_pixel_hides_as_much_of_recursive_filters_as_of_direct_ones(gradient: str, window: str) -> None:
    picture = texture(2, 90, 200, np.float32)
    detector = HarrisDetector(HarrisConfig(gradient=gradient, window=window))
    whole = detector.response(picture)
    picture[40, 60] = np.nan
    holed = detector.response(picture)
    reach = detector.margin_px
    unknown = np.zeros(whole.shape, bool)
    unknown[40 - reach : 41 + reach, 60 - reach : 61 + reach] = True
    np.testing.assert_array_equal(np.isnan(holed), unknown)
    beside = 6 * reach  # what is known is as without the hole, but for what recursion brings from farther away
    assert np.abs(holed - whole)[:, 60 + beside :].max() < 1e-5 * np.abs(whole).max()
    assert len(detector.detect(picture)) > 10


@pytest.mark.parametrize(
    ("picture", "word"),
    [
        (np.zeros((10, 10, 3), np.uint8), "(10, 10, 3)"),
        (np.zeros(10, np.uint8), "(10,)"),
        (np.zeros((10, 10), np.int64), "int64"),
        (np.zeros((10, 10), np.float64), "float64"),
    ],
)
def test_what_is_no_grey_picture_is_refused(picture: np.ndarray, word: str) -> None:
    with pytest.raises(ValueError, match="needed") as error:
        HarrisDetector().detect(picture)
    assert word in str(error.value)


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"window_px": 4}, "odd"),
        ({"k": 0.5}, "0.24"),
        ({"gradient": "prewitt"}, "sobel"),
        ({"even_spread": True, "max_corners": 0}, "max_corners"),
    ],
)
def test_bad_settings_are_refused_with_value_and_bound(values: dict[str, Any], word: str) -> None:
    with pytest.raises(ConfigError, match=word):
        HarrisConfig(**values)


def test_non_contiguous_and_big_endian_pictures() -> None:
    picture = texture(2, 90, 110)
    corners = HarrisDetector().detect(picture)
    for other in (np.asfortranarray(picture), np.repeat(picture, 2, axis=1)[:, ::2], picture.astype(">u2")):
        np.testing.assert_array_equal(HarrisDetector().detect(other).xy, corners.xy)


def test_a_pair_and_bands_of_rows_give_the_same_corners() -> None:
    left, right = texture(2, 211, 700), texture(5, 130, 300)
    config = HarrisConfig(max_corners=0)
    expected = [HarrisDetector(config).detect(p) for p in (left, right)]
    with ThreadPoolExecutor(2) as pool:
        for bands, run in ((1, map), (3, map), (2, pool.map)):
            pair = HarrisDetector(config, bands=bands, run=run).detect([left, right])
            for ours, wanted in zip(pair, expected):
                np.testing.assert_array_equal(ours.xy, wanted.xy)
                np.testing.assert_array_equal(ours.response, wanted.response)
    assert HarrisDetector(config).detect([]) == []
    with pytest.raises(ValueError, match="bands = 0"):
        HarrisDetector(config, bands=0)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_bands_do_not_change_how_sums_are_rounded(dtype: Any) -> None:
    rng = np.random.default_rng(4)
    picture = rng.integers(0, 65536, (101, 131)).astype(dtype) / dtype(1 if dtype == np.uint16 else 65535)
    picture = picture.astype(dtype)
    expected = HarrisDetector(HarrisConfig(max_corners=0)).detect(picture)
    for bands in (2, 3, 4, 5):
        found = HarrisDetector(HarrisConfig(max_corners=0), bands=bands).detect(picture)
        np.testing.assert_array_equal(found.xy, expected.xy)
        np.testing.assert_array_equal(found.response, expected.response)


@pytest.mark.parametrize("chosen", [{}, {"gradient": "gaussian"}, {"suppression_radius_px": 40.0}])
def test_of_equal_corners_the_same_are_kept_in_any_bands(chosen: dict[str, Any]) -> None:
    """A picture wider than a strip, with more equal corners than are wanted: the upper ones are kept."""
    y, x = np.indices((200, 1400))
    picture = ((x // 16 + y // 16) % 2 * 100 + 50).astype(np.uint8)
    config = HarrisConfig(max_corners=100, **chosen)
    expected = HarrisDetector(config).detect(picture)
    assert len(expected) == 100 and expected.xy[:, 1].max() < (170 if "suppression_radius_px" in chosen else 40)
    for bands in (2, 3, 5):
        np.testing.assert_array_equal(HarrisDetector(config, bands=bands).detect(picture).xy, expected.xy)


def test_examples_in_docstrings_run() -> None:
    assert doctest.testmod(harris).attempted > 0
    assert doctest.testmod(harris).failed == 0


def test_without_a_place_for_the_cache_functions_still_compile() -> None:
    names: dict[str, Any] = {}
    exec(compile("def twice(x):\n    return 2 * x\n", "<no file>", "exec"), names)
    with pytest.warns(RuntimeWarning, match="twice is compiled in every process"):
        assert compiled.compiled(names["twice"])(21) == 42


def test_missing_numba_is_told_plainly() -> None:
    code = "import sys; sys.modules['numba'] = None; import harris_perception.core.corners.harris"
    search = os.pathsep.join(p for p in sys.path if p)
    ended = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": search},
        timeout=60,
    )
    assert ended.returncode == 1 and "harris_perception needs numba" in ended.stderr


WARMED = """
import numpy as np
from numba.core.registry import CPUDispatcher
from harris_perception.core.image import deriche
from harris_perception.core.image import diffusion
from harris_perception.core.edges import edge_kernels
from harris_perception.core.edges import edge_tracing
from harris_perception.core.corners import harris_kernels, peak_kernels, ranking, response_kernels, spacing, structure
from harris_perception.core.edges.combined_detector import CombinedDetector
from harris_perception.core.edges.edges import EdgeDetector
from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.repeatable import RepeatableDetector

def compiled():
    modules = (
        *(deriche, diffusion, edge_kernels, edge_tracing),
        *(harris_kernels, peak_kernels, ranking, response_kernels, spacing, structure),
    )
    return {
        f"{module.__name__}.{name}": len(value.signatures)
        for module in modules for name, value in vars(module).items() if isinstance(value, CPUDispatcher)
    }

rng = np.random.default_rng(1)
for config in (HarrisConfig(), HarrisConfig(gradient="gaussian", window="gaussian"), HarrisConfig(even_spread=True)):
    for detector in (RepeatableDetector(), HarrisDetector(config), CombinedDetector(config), EdgeDetector()):
        detector.warm()
        before = compiled()
        for shape in ((90, 121), (8, 9), (2, 3)):
            noise = rng.integers(0, 256, shape)
            for dtype in (np.uint8, np.uint16, np.float32):
                received = np.frombuffer(noise.astype(dtype).tobytes(), dtype).reshape(shape)  # not to be written
                turned = noise.astype(dtype)[:, ::-1]
                for picture in (noise.astype(dtype), turned, np.zeros(shape, dtype), received):
                    detector.detect(picture)
            if isinstance(detector, EdgeDetector):
                detector.detect(np.dstack([noise] * 3).astype(np.uint8))
        late = {name: count for name, count in compiled().items() if count != before[name]}
        assert not late, (type(detector).__name__, config, late)
"""


def test_a_response_that_lies_in_memory_in_another_order_has_the_same_corners() -> None:
    detector = HarrisDetector()
    response = detector.response(np.random.default_rng(5).integers(0, 256, (60, 90), dtype=np.uint8))
    expected = detector.corners_of(response)
    apart = np.zeros((120, 180), np.float32)
    apart[::2, ::2] = response
    assert len(expected.xy) > 100
    for same in (np.asfortranarray(response), apart[::2, ::2]):
        found = detector.corners_of(same)
        assert np.array_equal(found.xy, expected.xy) and np.array_equal(found.response, expected.response)


@pytest.mark.long
@pytest.mark.timeout(480)  # the first time all is compiled, on a busy computer
def test_after_warming_no_picture_waits_for_the_compiler() -> None:
    search = os.pathsep.join(p for p in sys.path if p)
    ended = subprocess.run(
        [sys.executable, "-c", WARMED],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": search},
        timeout=460,
    )
    assert ended.returncode == 0, ended.stderr[-2000:]


DATA = Path(os.environ.get("ICU_TEST_DATA", ""))
needs_data = pytest.mark.skipif(not os.environ.get("ICU_TEST_DATA"), reason="ICU_TEST_DATA names no folder of pictures")


@needs_data
def test_corners_of_a_photograph_come_back_under_another_view() -> None:
    first, second = (cv2.imread(str(DATA / f"sequences/graf/img{i}.png"), cv2.IMREAD_GRAYSCALE) for i in (1, 2))
    h = np.loadtxt(DATA / "sequences/graf/H1to2p")
    detector = HarrisDetector(HarrisConfig(gradient="gaussian", window="gaussian", max_corners=1000))
    a, b = detector.detect(first).xy, detector.detect(second).xy
    mapped = cv2.perspectiveTransform(a[None].astype(np.float64), h)[0]
    inside = ((mapped > 5) & (mapped < (second.shape[1] - 5, second.shape[0] - 5))).all(axis=1)

    def repeated(points: np.ndarray) -> float:
        return float((np.linalg.norm(points[:, None] - b[None], axis=2).min(axis=1) < 2.0).mean())

    assert inside.sum() > 300
    by_chance = repeated(mapped[inside] + (17.0, 13.0))
    assert repeated(mapped[inside]) > 0.5 > 2 * by_chance


@needs_data
def test_all_corners_of_a_flat_box_are_found() -> None:
    picture = cv2.imread(str(DATA / "object/box.png"), cv2.IMREAD_GRAYSCALE)
    config = HarrisConfig(gradient="sobel", max_corners=0, subpixel=False)
    ours = {(int(x), int(y)) for x, y in HarrisDetector(config).detect(picture).xy}
    found = cv2.goodFeaturesToTrack(picture, 0, 0.01, 0, blockSize=3, useHarrisDetector=True, k=0.04)
    h, w = picture.shape
    theirs = {(int(x), int(y)) for x, y in found.reshape(-1, 2) if 3 <= x < w - 3 and 3 <= y < h - 3}
    assert len(theirs) > 300 and len(ours & theirs) >= 0.99 * max(len(ours), len(theirs))
