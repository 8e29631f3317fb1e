"""Matches between a picture and its warp by a known homography, and between pictures that have nothing in common."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.harris_laplace import HarrisLaplaceConfig, HarrisLaplaceDetector
from harris_perception.core.corners.matching import (
    Described,
    MatchConfig,
    describe,
    describe_over_scales,
    match,
    orientations_deg,
)
from icu_common.core.configuration.config import ConfigError


def scene(seed: int, size: int = 260) -> np.ndarray:
    """Return overlapping polygons of random grey with a little noise."""
    rng = np.random.default_rng(seed)
    picture = np.full((size, size), 120, np.uint8)
    for _ in range(90):
        centre = rng.uniform(0, size, 2)
        points = centre + rng.uniform(6, 30) * rng.uniform(-1, 1, (5, 2))
        cv2.fillConvexPoly(picture, cv2.convexHull(points.astype(np.int32)), int(rng.integers(0, 256)), cv2.LINE_AA)
    return np.clip(cv2.GaussianBlur(picture, (0, 0), 0.9) + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)


def corners(picture: np.ndarray) -> np.ndarray:
    config = HarrisConfig(gradient="gaussian", window="gaussian", sigma_i_px=1.5, max_corners=400)
    return HarrisDetector(config).detect(picture).xy


def warp(angle_deg: float, scale: float) -> np.ndarray:
    h = np.vstack((cv2.getRotationMatrix2D((130.0, 130.0), angle_deg, scale), (0.0, 0.0, 1.0)))
    h[2, :2] = 2e-4, -1e-4
    return h


def error_px(a: np.ndarray, b: np.ndarray, h: np.ndarray) -> np.ndarray:
    return np.linalg.norm(cv2.perspectiveTransform(a[None].astype(np.float64), h)[0] - b, axis=1)


@pytest.mark.parametrize(
    ("settings", "angle_deg", "scale", "least"),
    [
        ({"descriptor": "patch", "ratio": 0.9}, 3.0, 1.0, 60),
        ({"descriptor": "orb"}, 40.0, 1.0, 45),
        ({"descriptor": "sift"}, 100.0, 1.0, 80),
        ({"descriptor": "sift", "oriented": False}, 5.0, 0.95, 80),
    ],
)
def test_matches_of_a_warped_picture_are_right(
    settings: dict[str, Any], angle_deg: float, scale: float, least: int
) -> None:
    first, h = scene(1), warp(angle_deg, scale)
    second = cv2.warpPerspective(first, h, first.shape[::-1], flags=cv2.INTER_CUBIC)
    a, b = corners(first), corners(second)
    config = MatchConfig(**settings)
    found = match(describe(first, a, config), describe(second, b, config), config)
    assert len(found.pairs) >= least and found.tentative >= len(found.pairs)
    assert (error_px(a[found.pairs[:, 0]], b[found.pairs[:, 1]], h) < 3.0).mean() > 0.97
    assert found.model is not None
    square = np.array([(60.0, 60.0), (200.0, 60.0), (200.0, 200.0), (60.0, 200.0)])
    assert error_px(square, cv2.perspectiveTransform(square[None], found.model)[0], h).max() < 1.5
    assert len(set(found.pairs[:, 0].tolist())) == len(set(found.pairs[:, 1].tolist())) == len(found.pairs)


@pytest.mark.parametrize("scale", [0.5, 0.63, 1.7])
def test_corners_over_scales_match_a_picture_of_another_size(scale: float) -> None:
    first = scene(8, 400)
    side = round(400 * scale)
    second = cv2.resize(first, (side, side), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    ratio = side / 400
    h = np.array([[ratio, 0.0, 0.5 * ratio - 0.5], [0.0, ratio, 0.5 * ratio - 0.5], [0.0, 0.0, 1.0]])
    config = MatchConfig()
    counts = []
    for levels in (8, 1):
        detector = HarrisLaplaceDetector(HarrisLaplaceConfig(levels=levels, select=False))
        a, b = detector.detect(first), detector.detect(second)
        found = match(describe_over_scales(first, a, config), describe_over_scales(second, b, config), config)
        right = np.zeros(0, bool)
        if len(found.pairs) > 0:
            right = error_px(a.xy[found.pairs[:, 0]], b.xy[found.pairs[:, 1]], h) < 3.0
        counts.append(int(right.sum()))
        if levels == 8:
            assert right.mean() > 0.97
            # The scales show the change of size as well, within a level.
            change = b.scale[found.pairs[:, 1]] / a.scale[found.pairs[:, 0]]
            assert np.median(change) == pytest.approx(scale, rel=0.15)
    print("right matches over scales, on one:", counts)
    assert counts[0] > 40 and counts[0] > 1.5 * counts[1]


def test_each_check_removes_wrong_matches() -> None:
    first, h = scene(2), warp(8.0, 1.0)
    second = cv2.warpPerspective(first, h, first.shape[::-1], flags=cv2.INTER_CUBIC)
    a, b = corners(first), corners(second)
    share = []
    for settings in (
        {"mutual": False, "ratio": 1.0, "geometry": "none"},
        {"ratio": 1.0, "geometry": "none"},
        {"geometry": "none"},
        {"geometry": "epipolar"},
        {"geometry": "homography"},
    ):
        config = MatchConfig(descriptor="patch", **settings)
        found = match(describe(first, a, config), describe(second, b, config), config)
        share.append(float((error_px(a[found.pairs[:, 0]], b[found.pairs[:, 1]], h) < 3.0).mean()))
    print("share of right matches:", share)
    assert share[0] < share[1] < share[2] and share[2] <= share[3] + 0.02 and share[4] > 0.97


def test_few_places_seen_several_times_may_have_no_model() -> None:
    """Like the corners of a square on several levels; of some of these OpenCV raises an error of its own."""
    vectors, index = np.eye(12, dtype=np.float32), np.arange(12)
    for seed in range(60):
        rng = np.random.default_rng(seed)
        a = (50.0 * rng.integers(0, 3, (12, 2))).astype(np.float32)
        b = (a + rng.normal(0.0, 0.2, a.shape)).astype(np.float32)
        found = match(Described(a, index, vectors), Described(b, index, vectors), MatchConfig(geometry="epipolar"))
        assert found.tentative == 12 and (found.model is not None or len(found.pairs) == 0), seed


@pytest.mark.parametrize("tolerance_px", [1.0, 3.0])
def test_no_match_is_farther_from_the_epipolar_geometry_than_allowed(tolerance_px: float) -> None:
    """By the distance of P. Sampson, CGIP 18(1), 1982."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (200, 3)) + (0.0, 0.0, 4.0)
    k = np.array([[800.0, 0.0, 320.0], [0.0, 800.0, 240.0], [0.0, 0.0, 1.0]])
    moved = points @ np.asarray(cv2.Rodrigues(np.array([0.05, -0.1, 0.02]))[0]).T + (0.3, -0.1, 0.05)
    a, b = (((p / p[:, 2:]) @ k.T)[:, :2] + rng.normal(0.0, 0.5 * tolerance_px, (200, 2)) for p in (points, moved))
    b[:60] = rng.uniform(0.0, 480.0, (60, 2))
    vectors, index = np.eye(200, dtype=np.float32), np.arange(200)
    config = MatchConfig(geometry="epipolar", tolerance_px=tolerance_px)
    first, second = (Described(xy.astype(np.float32), index, vectors) for xy in (a, b))
    found = match(first, second, config)
    assert found.model is not None and 120 < len(found.pairs) < 160
    ones = np.ones((len(found.pairs), 1))
    left, right = np.hstack((first.xy[found.pairs[:, 0]], ones)), np.hstack((second.xy[found.pairs[:, 1]], ones))
    lines, back = left @ found.model.T, right @ found.model
    squares = (right * lines).sum(axis=1) ** 2 / ((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1))
    assert np.sqrt(squares.max()) <= tolerance_px * 1.001


def test_pictures_without_anything_in_common_do_not_match() -> None:
    config = MatchConfig(descriptor="sift")
    a, b = scene(3), scene(4)
    found = match(describe(a, corners(a), config), describe(b, corners(b), config), config)
    assert len(found.pairs) < 10
    detector = HarrisLaplaceDetector(HarrisLaplaceConfig(select=False))
    found = match(*(describe_over_scales(p, detector.detect(p), config) for p in (a, b)), config)
    assert len(found.pairs) < 10


@pytest.mark.parametrize("descriptor", ["patch", "orb", "sift"])
def test_no_corners_no_matches(descriptor: str) -> None:
    config = MatchConfig(descriptor=descriptor)
    nothing = describe(np.zeros((50, 60), np.uint8), np.empty((0, 2)), config)
    picture = scene(5)
    some = describe(picture, corners(picture), config)
    for one, other in ((nothing, some), (some, nothing), (nothing, nothing)):
        found = match(one, other, config)
        assert found.pairs.shape == (0, 2) and found.model is None and found.tentative == 0


@pytest.mark.parametrize("descriptor", ["patch", "orb", "sift"])
def test_pictures_without_pixels_have_no_descriptors_and_deep_ones_are_refused(descriptor: str) -> None:
    config = MatchConfig(descriptor=descriptor)
    for shape in ((0, 0), (0, 9), (9, 0)):
        found = describe(np.zeros(shape, np.uint8), np.empty((0, 2)), config)
        assert found.xy.shape == (0, 2) and len(found.index) == len(found.vectors) == 0
    for picture in (np.zeros((60, 60), np.uint16), np.zeros((60, 60), np.float32), np.zeros((60, 60, 3), np.uint8)):
        with pytest.raises(ValueError, match=rf"expected uint8, got \(60, 60(, 3)?\) {picture.dtype}"):
            describe(picture, [(30.0, 30.0)], config)


def test_orientation_points_to_the_bright_side() -> None:
    y, x = np.indices((80, 80))
    for angle in (0, 45, 90, 200, 300):
        t = np.deg2rad(angle)
        picture = (125 + 75 * np.tanh((x - 40) * np.cos(t) + (y - 40) * np.sin(t))).round().astype(np.uint8)
        turned = (orientations_deg(picture, [(40.0, 40.0)])[0] - angle + 180) % 360 - 180
        assert abs(turned) < 3.0


def test_patch_ignores_gain_and_offset() -> None:
    picture = scene(6)
    xy = corners(picture)
    plain = describe(picture, xy, MatchConfig(descriptor="patch"))
    dim = describe((picture // 2 + 40).astype(np.uint8), xy, MatchConfig(descriptor="patch"))
    np.testing.assert_array_equal(plain.index, dim.index)
    assert (plain.vectors * dim.vectors).sum(axis=1).min() > 0.98


def test_bad_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="odd"):
        MatchConfig(patch_px=8)
    with pytest.raises(ConfigError, match="patch, orb, sift"):
        MatchConfig(descriptor="surf")


@pytest.mark.parametrize("descriptor", ["patch", "orb"])
def test_corners_may_be_more_than_opencv_takes_at_once(descriptor: str) -> None:
    picture = np.random.default_rng(6).integers(0, 256, (400, 400), np.uint8)
    y, x = np.mgrid[60:340:1.5, 60:340:1.5]
    xy = np.column_stack((x.ravel(), y.ravel()))
    assert len(xy) > 32_768
    config = MatchConfig(descriptor=descriptor)
    found = describe(picture, xy, config)
    few = describe(picture, xy[-1000:], config)
    assert len(found.vectors) == len(xy)
    np.testing.assert_array_equal(found.vectors[-1000:], few.vectors)
