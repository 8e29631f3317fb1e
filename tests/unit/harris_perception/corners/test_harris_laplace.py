"""Corners over scales: their scale follows the picture's, and they repeat when it changes."""

from __future__ import annotations

import doctest

import cv2
import numpy as np
import pytest

from harris_perception.core.corners import harris_laplace
from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.harris_laplace import HarrisLaplaceConfig, HarrisLaplaceDetector, ScaledCorners
from harris_perception.core.evaluation.repeatability import HomographyPair, repeatability

GAUSSIAN = HarrisConfig(gradient="gaussian", window="gaussian", relative_threshold=0.001, max_corners=300)
DETECTOR = HarrisLaplaceDetector(HarrisLaplaceConfig(detector=GAUSSIAN))


def blobs(radius: float) -> np.ndarray:
    """Return a grid of soft bright spots whose Laplacian answers most at a scale in proportion to their radius."""
    y, x = np.indices((240, 240))
    spots = [((x - cx) ** 2 + (y - cy) ** 2) / (2 * radius**2) for cx in (60, 120, 180) for cy in (60, 120, 180)]
    return (30 + 180 * np.exp(-np.array(spots)).sum(axis=0)).clip(0, 255).astype(np.uint8)


def test_scale_grows_with_the_structure() -> None:
    scales = []
    for radius in (2.5, 4.0, 6.4):
        corners = DETECTOR.detect(blobs(radius))
        centres = np.array([(cx, cy) for cx in (60, 120, 180) for cy in (60, 120, 180)], float)
        near = np.linalg.norm(corners.xy[:, None] - centres[None], axis=2).min(axis=1) < 2.5
        assert near.sum() >= 7
        scales.append(float(np.median(corners.scale[near])))
    print(scales)
    assert 1.3 < scales[1] / scales[0] < 2.0 and 1.3 < scales[2] / scales[1] < 2.0


def scene(seed: int, size: int = 500) -> np.ndarray:
    rng = np.random.default_rng(seed)
    picture = np.full((size, size), 120, np.uint8)
    for _ in range(160):
        points = rng.uniform(0, size, 2) + rng.uniform(8, 70) * rng.uniform(-1, 1, (5, 2))
        cv2.fillConvexPoly(picture, cv2.convexHull(points.astype(np.int32)), int(rng.integers(0, 256)), cv2.LINE_AA)
    return cv2.GaussianBlur(picture, (0, 0), 0.8)


@pytest.mark.parametrize("seed", [1, 2])
def test_corners_of_a_halved_picture_have_half_the_scale_and_repeat(seed: int) -> None:
    first = scene(seed)
    second = cv2.resize(first, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    h = np.array([[0.5, 0.0, -0.25], [0.0, 0.5, -0.25], [0.0, 0.0, 1.0]])
    pair = HomographyPair("scale", 2.0, first, second, h)
    a, b = DETECTOR.detect(first), DETECTOR.detect(second)
    ours = repeatability(pair, a.xy, b.xy, (1.5,))
    print(ours)
    assert ours.rates[0] > 0.5 > 5 * ours.chance[0]
    distance = np.linalg.norm((0.5 * a.xy - 0.25)[:, None] - b.xy[None], axis=2)
    i = distance.argmin(axis=1)
    close = (distance.min(axis=1) < 1.0) & (a.scale > 2.0) & (a.scale < 4.0)
    assert close.sum() >= 5
    assert 1.4 < np.median(a.scale[close] / b.scale[i[close]]) < 2.8


def test_count_order_and_dtype() -> None:
    corners = DETECTOR.detect(scene(3))
    assert 50 < len(corners) <= 300 + 8
    assert (np.diff(corners.response) <= 0).all() and (corners.scale >= 1.0).all() and corners.scale.max() > 1.5
    assert corners.xy.dtype == corners.scale.dtype == corners.response.dtype == np.float32
    assert (corners.xy > 0).all() and (corners.xy < 500).all()


def test_all_scales_together_give_as_many_as_asked_for() -> None:
    few = HarrisLaplaceConfig(select=False, detector=HarrisConfig(max_corners=50))
    corners = HarrisLaplaceDetector(few).detect(scene(3))
    counts = [int(np.isclose(corners.scale, 1.26**level).sum()) for level in range(3)]
    assert len(corners) == 50 and counts[0] > counts[1] > counts[2] > 0, counts


@pytest.mark.parametrize("count", [50, 200, 400])
def test_as_many_selected_corners_as_asked_for_where_there_are(count: int) -> None:
    picture, every = scene(3), HarrisConfig(relative_threshold=0.0, max_corners=0)
    there = HarrisLaplaceDetector(HarrisLaplaceConfig(detector=every)).detect(picture)
    assert len(there) > 400
    few = HarrisLaplaceConfig(detector=HarrisConfig(relative_threshold=0.0, max_corners=count))
    found = HarrisLaplaceDetector(few).detect(picture)
    assert len(found) == count and (np.diff(found.response) <= 0).all()
    known = {(*map(float, xy), float(scale)) for xy, scale in zip(there.xy, there.scale)}
    assert {(*map(float, xy), float(scale)) for xy, scale in zip(found.xy, found.scale)} <= known
    finest = [int(np.isclose(corners.scale, 1.0).sum()) for corners in (found, there)]
    assert finest[0] == min(finest[1], count) or finest[0] < count, "coarse levels have their share"


@pytest.mark.parametrize("shape", [(60, 33_000), (33_000, 60)])
def test_a_picture_may_be_longer_than_opencv_takes(shape: tuple[int, int]) -> None:
    tile = scene(4)[:60, :500]
    long = np.tile(tile, 66)
    assert long.shape == (60, 33_000)
    picture = long if shape == long.shape else np.ascontiguousarray(long.T)
    config = HarrisLaplaceConfig(levels=2, detector=HarrisConfig(max_corners=0))
    xy = HarrisLaplaceDetector(config).detect(picture).xy
    along = xy[:, 0] if shape == long.shape else xy[:, 1]
    counts = np.bincount((along // 500).astype(int), minlength=66)
    assert counts.min() > 5 and np.ptp(counts[1:-1]) <= 2, counts


@pytest.mark.parametrize("select", [True, False])
def test_an_even_spread_covers_the_picture_at_all_scales_together(select: bool) -> None:
    """A quarter has strong texture, the others a weak one: the strongest are all there."""
    picture = scene(3).astype(np.float32)
    picture[:250, :250] *= 5.0

    def quarters(even_spread: bool, count: int = 200) -> list[int]:
        detector = HarrisConfig(relative_threshold=0.0, max_corners=count, even_spread=even_spread)
        xy = HarrisLaplaceDetector(HarrisLaplaceConfig(select=select, detector=detector)).detect(picture).xy
        return [int(n) for n in np.bincount((xy[:, 0] >= 250) * 1 + (xy[:, 1] >= 250) * 2, minlength=4)]

    assert quarters(False, 100)[0] > 0.8 * sum(quarters(False, 100))
    assert sum(quarters(True)) == 200 and min(quarters(True)) >= 40, quarters(True)


def squares() -> np.ndarray:
    """Return a grid of squares of 7 px, which have a corner each on some level, and none on others."""
    picture = np.full((300, 400), 40, np.uint8)
    for x in range(20, 380, 18):
        for y in range(20, 280, 18):
            picture[y : y + 7, x : x + 7] = 200
    return picture


@pytest.mark.parametrize("select", [True, False])
@pytest.mark.parametrize("levels", [3, 30])
@pytest.mark.parametrize("radius_px", [1.0, 3.0])
@pytest.mark.parametrize("count", [1, 50, 1000, 5000])
def test_an_even_spread_gives_as_many_as_asked_for_where_there_are(
    select: bool, levels: int, radius_px: float, count: int
) -> None:
    """However few a level has: what it leaves of its share, others give."""
    for picture in (squares(), scene(3)):

        def found(most: int, even_spread: bool, picture: np.ndarray = picture) -> ScaledCorners:
            detector = HarrisConfig(max_corners=most, even_spread=even_spread, suppression_radius_px=radius_px)
            config = HarrisLaplaceConfig(select=select, levels=levels, detector=detector)
            return HarrisLaplaceDetector(config).detect(picture)

        there, even = found(0, False), found(count, True)
        assert len(even) == min(count, len(there)) and (np.diff(even.response) <= 0).all()
        known = {(*map(float, xy), float(scale)) for xy, scale in zip(there.xy, there.scale)}
        chosen = {(*map(float, xy), float(scale)) for xy, scale in zip(even.xy, even.scale)}
        assert chosen <= known and len(chosen) == len(even)
        levels_there, levels_chosen = (len(np.unique(corners.scale)) for corners in (there, even))
        assert levels_chosen >= min(levels_there, count // 100), "coarse levels have their share"


def test_corners_may_be_more_than_opencv_takes_at_once() -> None:
    picture = np.random.default_rng(6).integers(0, 256, (700, 800), np.uint8)
    everything = HarrisLaplaceConfig(levels=2, detector=HarrisConfig(max_corners=0, relative_threshold=0.0))
    assert len(HarrisDetector(everything.detector).detect(picture)) > 32_768
    assert len(HarrisLaplaceDetector(everything).detect(picture)) > 1000


@pytest.mark.parametrize("doublings", [-100, 40, 100])
def test_no_unit_of_a_picture_of_floats_loses_corners(doublings: int) -> None:
    picture = scene(4).astype(np.float32)
    plain, found = DETECTOR.detect(picture), DETECTOR.detect(np.ldexp(picture, doublings))
    assert len(found) == len(plain) > 100
    np.testing.assert_allclose(found.xy, plain.xy, atol=1e-3)
    np.testing.assert_array_equal(found.scale, plain.scale)
    np.testing.assert_allclose(found.response * 2.0 ** (-4 * doublings), plain.response, rtol=1e-5)


@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (30, 7), (60, 60)])
def test_pictures_without_corners(shape: tuple[int, int]) -> None:
    for value in (9.0, np.nan):
        corners = DETECTOR.detect(np.full(shape, value, np.float32))
        assert corners.xy.shape == (0, 2) and len(corners.scale) == len(corners) == 0


@pytest.mark.parametrize("value", [0.1, 0.3, 7.0, 255.0])
@pytest.mark.parametrize("config", [HarrisLaplaceConfig(), HarrisLaplaceConfig(levels=30, select=False)])
def test_rounding_on_constant_pictures_is_no_corner(value: float, config: HarrisLaplaceConfig) -> None:
    assert len(HarrisLaplaceDetector(config).detect(np.full((200, 300), value, np.float32))) == 0


def test_colour_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(9, 9, 3\)"):
        DETECTOR.detect(np.zeros((9, 9, 3), np.uint8))


def test_examples_in_docstrings_run() -> None:
    result = doctest.testmod(harris_laplace)
    assert result.attempted > 0 and result.failed == 0
