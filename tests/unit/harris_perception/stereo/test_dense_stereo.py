"""Dense matching: made planes of known disparity, the left strip, holes, limits, metres."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from unit.harris_perception.rendered_stylus import stereo_model

from harris_perception.core.stereo.dense_stereo import (
    DenseConfig,
    DenseStereo,
    SemiGlobalConfig,
    SemiGlobalMatcher,
    fill_holes,
)
from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.camera_model import CameraModel, StereoModel

CAMERAS = Path(__file__).resolve().parents[4] / "config" / "cameras"
SHAPE = (200, 360)
CONFIG = SemiGlobalConfig()


def texture(seed: int, shape: tuple[int, int] = SHAPE) -> Any:
    """Return a picture with detail of several sizes everywhere, (H, W) float32."""
    rng = np.random.default_rng(seed)
    layers = [cv2.GaussianBlur(rng.normal(0, 1, shape), (0, 0), size) * size for size in (1.2, 2.5, 6.0)]
    return (128 + 45 * sum(layers)).astype(np.float32)


def pair(disparity: Any, seed: int = 0) -> list[Any]:
    """Return left and right uint8 pictures; the left pixel (x, y) shows the right one at x - disparity(x, y)."""
    print(f"seed {seed}")
    rng = np.random.default_rng(seed)
    right = texture(seed, disparity.shape)
    y, x = np.mgrid[0 : disparity.shape[0], 0 : disparity.shape[1]].astype(np.float32)
    left = cv2.remap(right, x - disparity.astype(np.float32), y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return [np.clip(p + rng.normal(0, 0.5, p.shape) + 0.5, 0, 255).astype(np.uint8) for p in (left, right)]


def plane(at_zero: float, slope_x: float = 0.0, slope_y: float = 0.0) -> Any:
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]]
    return at_zero + slope_x * x + slope_y * y


@pytest.mark.parametrize("truth", [(20.0,), (31.3,), (17.5, 0.02, 0.01), (44.75, -0.05, 0.0)])
@pytest.mark.parametrize("low", [0, 9])
def test_planes_are_measured_to_a_tenth_of_a_pixel(truth: tuple[float, ...], low: int) -> None:
    expected = plane(*truth)
    found = SemiGlobalMatcher(low, 63, CONFIG)(*pair(expected))
    x = np.arange(SHAPE[1])
    seen_twice = x - expected > 4
    error = (found - expected)[seen_twice]
    assert np.isfinite(error).mean() > 0.95
    assert abs(np.nanmedian(error)) < 0.08 and np.nanmedian(np.abs(error)) < 0.1
    assert np.sqrt(np.nanmean(error[np.abs(error) < 1] ** 2)) < 0.1 and np.nanmean(np.abs(error) > 1) < 0.005


def test_the_left_strip_is_kept_where_the_right_picture_shows_it() -> None:
    disparity = np.full(SHAPE, 12.0)
    left, right = pair(disparity, 1)
    found = SemiGlobalMatcher(0, 79, CONFIG)(left, right)
    plain = cv2.StereoSGBM_create(0, 80, 3, 72, 288, 1, 31, 5, 100, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    assert (plain.compute(left, right)[:, :80] < 0).all()  # what is mended here
    strip = found[4:-4, 16:80]
    assert (np.abs(strip - 12) < 0.5).mean() > 0.97
    # The first columns have their partners outside of the right image: nothing is known there, and nothing invented.
    assert np.isnan(found[:, :10]).mean() > 0.9
    seen = np.argwhere(np.isfinite(found))
    assert (seen[:, 1] - found[seen[:, 0], seen[:, 1]] >= -0.5).all()


def test_the_search_may_start_below_zero_and_far_above() -> None:
    behind = SemiGlobalMatcher(-20, -5, CONFIG)
    assert (behind.least_px, behind.count) == (-21, 32)
    found = behind(*pair(np.full(SHAPE, -12.0), 2))
    assert (np.abs(found[4:-4, 4:-16] + 12) < 0.25).mean() > 0.97
    near = SemiGlobalMatcher(150, 170, CONFIG)
    found = near(*pair(np.full(SHAPE, 160.25), 3))
    assert near.count == 32 and np.isnan(found[:, :150]).all()
    assert (np.abs(found[4:-4, 166:] - 160.25) < 0.25).mean() > 0.97


def test_what_one_camera_does_not_see_is_unknown_or_filled_from_behind() -> None:
    rng = np.random.default_rng(4)
    back, front = texture(5), texture(6, (100, 90))
    truth = np.full(SHAPE, 10.0)
    truth[50:150, 160:250] = 40.0
    left, right = np.roll(back, 5, axis=1), np.roll(back, -5, axis=1)
    left[50:150, 160:250] = front
    right[50:150, 120:210] = front
    left, right = (np.clip(p + rng.normal(0, 0.5, p.shape), 0, 255).astype(np.uint8) for p in (left, right))
    hidden = np.zeros(SHAPE, bool)
    hidden[54:146, 132:158] = True  # behind the square in the right image, to the left of it in the left one
    open_, filled = (SemiGlobalMatcher(0, 63, replace(CONFIG, fill_holes=f))(left, right) for f in (False, True))
    assert np.isnan(open_[hidden]).mean() > 0.8
    assert np.isfinite(filled).all() and (np.abs(filled[hidden] - 10) < 1).mean() > 0.75
    assert (np.abs(filled[54:146, 166:244] - 40) < 0.5).mean() > 0.97


def test_holes_take_the_farther_neighbour_of_their_row() -> None:
    nan = np.nan
    rows = np.array([[nan, 5, nan, nan, 3], [7, nan, nan, nan, nan], [nan] * 5, [1, 2, 3, 4, 5]], np.float32)
    fill_holes(rows)
    assert rows[[0, 1, 3]].tolist() == [[5, 5, 3, 3, 3], [7] * 5, [1, 2, 3, 4, 5]]
    assert np.isnan(rows[2]).all()


def test_one_step_takes_away_what_draws_fractions_to_whole_pixels() -> None:
    left, right = pair(np.full(SHAPE, 31.3), 9)
    plain, better = (SemiGlobalMatcher(0, 63, replace(CONFIG, refine=r))(left, right) for r in (False, True))
    assert (np.isfinite(plain) == np.isfinite(better)).all()
    assert np.nanmedian(np.abs(better - 31.3)) < 0.6 * np.nanmedian(np.abs(plain - 31.3))
    darker = np.clip(0.9 * right.astype(float) - 5, 0, 255).astype(np.uint8)
    assert np.nanmedian(np.abs(SemiGlobalMatcher(0, 63, CONFIG)(left, darker) - 31.3)) < 0.1
    assert np.nanmax(np.abs(better - plain)) < 0.5


def test_no_texture_is_unknown() -> None:
    flat = np.full(SHAPE, 90, np.uint8)
    assert np.isnan(SemiGlobalMatcher(2, 40, CONFIG)(flat, flat)).all()


def test_bad_input_is_refused_with_its_value() -> None:
    matcher = SemiGlobalMatcher(100, 150, CONFIG)
    gray = np.zeros((50, 90), np.uint8)
    with pytest.raises(ValueError, match=r"90 px wide .* 99 px"):
        matcher(gray, gray)
    with pytest.raises(ValueError, match=r"\(50, 89\)"):
        matcher(gray, gray[:, :89])
    with pytest.raises(ValueError, match="uint16"):
        matcher(gray.astype(np.uint16), gray)
    with pytest.raises(ValueError, match="from 5 to 4"):
        SemiGlobalMatcher(5, 4, CONFIG)
    with pytest.raises(ConfigError, match="block_px = 4"):
        SemiGlobalConfig(block_px=4)
    with pytest.raises(ConfigError, match="p2 = 72"):
        SemiGlobalConfig(p2=72)
    with pytest.raises(ConfigError, match="max_depth_m"):
        DenseConfig(min_depth_m=2.0)
    with pytest.raises(ValueError, match=r"max_depth_m = 0.22"):
        DenseStereo(stereo_model(), DenseConfig(max_depth_m=0.22), CONFIG)
    with pytest.raises(ValueError, match=r"\(480, 800\)"):
        DenseStereo(stereo_model(), DenseConfig(), CONFIG).rectified(0, gray)


def moved_centre(stereo: StereoModel, by_px: float) -> StereoModel:
    """Return the pair with the right principal point moved to the left: disparities grow by it."""
    projection = stereo.right.p.copy()
    projection[0, 2] -= by_px
    return StereoModel(left=stereo.left, right=replace(stereo.right, p=projection))


@pytest.mark.parametrize("binning", [1, 2, 3])
@pytest.mark.parametrize(("offset_px", "finer"), [(0.0, 1.0), (24.0, 1.0), (24.0, 1.25), (0.0, 0.8)])
def test_points_are_metric_whatever_the_binning_the_principal_points_and_the_right_cameras_size(
    binning: int, offset_px: float, finer: float
) -> None:
    stereo = moved_centre(stereo_model(), offset_px)
    right = stereo.right
    sensor = replace(
        right,
        width=round(right.width * finer),
        height=round(right.height * finer),
        k=np.diag([finer, finer, 1]) @ right.k,
    )
    stereo = StereoModel(left=stereo.left, right=sensor)
    rng = np.random.default_rng(7)
    normal = np.array([0.1, -0.3, -1.0]) / np.linalg.norm([0.1, -0.3, -1.0])
    centre = np.array([0.06, 0.0, 0.62])
    drawing = texture(8, (900, 1200))
    pictures = []
    for model, eye in ((stereo.left, 0.0), (stereo.right, stereo.baseline)):
        v, u = np.mgrid[0 : model.height, 0 : model.width]
        rays = model.rays(np.column_stack([u.ravel(), v.ravel()]))
        origin = np.array([eye, 0.0, 0.0])
        spot = origin + rays * (((centre - origin) @ normal) / (rays @ normal))[:, None] - centre
        at = [(size / 2 + 2500 * spot[:, k]).astype(np.float32).reshape(v.shape) for k, size in ((0, 1200), (1, 900))]
        picture = cv2.remap(drawing, *at, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        pictures.append(np.clip(picture + rng.normal(0, 0.5, picture.shape), 0, 255).astype(np.uint8))
    dense = DenseStereo(stereo, DenseConfig(min_depth_m=0.5, max_depth_m=0.8, binning=binning), CONFIG)
    disparity = dense.disparity(*pictures)
    assert disparity.shape == (480 // binning, 800 // binning)
    known = disparity[np.isfinite(disparity)]
    assert known.min() >= dense.least_px and known.max() <= dense.largest_px
    assert dense.focal_px * dense.baseline_m / 0.5 <= dense.largest_px
    points = dense.points(disparity)
    off = (points.reshape(-1, 3) - centre) @ normal
    assert np.isfinite(off).mean() > 0.4
    assert np.nanmedian(np.abs(off)) < 0.0004 * binning and abs(np.nanmedian(off)) < 0.0002 * binning
    # The point of a pixel lies on this pixel's ray: projected, it meets the middle of the raw pixels that it covers.
    row, column = np.argwhere(np.isfinite(disparity)).T[:, ::997]
    middle = (np.column_stack([column, row]) + 0.5) * binning - 0.5
    back = stereo.left.rectify(stereo.left.project(points[row, column]))
    assert np.abs(back - middle).max() < 0.02


@pytest.mark.parametrize("binning", [1, 2])
def test_nothing_is_searched_beyond_the_picture_however_near_a_thing_may_be(binning: int) -> None:
    """At 1 cm the disparity would be 20,400 px; searching so far takes most of a minute for one pair."""
    dense = DenseStereo(stereo_model(), DenseConfig(min_depth_m=0.01, binning=binning), CONFIG)
    width = 800 // binning
    assert width <= dense.largest_px < width + 20
    assert dense.least_px <= dense.focal_px * dense.baseline_m / 1.5


def test_the_black_borders_of_turned_pictures_stay_unknown() -> None:
    stereo = stereo_model()
    turned = cv2.Rodrigues(np.array([0.05, 0.0, 0.0]))[0]  # both cameras nod: 85 rows come from outside
    nodding = StereoModel(left=replace(stereo.left, r=turned), right=replace(stereo.right, r=turned))
    dense = DenseStereo(nodding, DenseConfig(min_depth_m=0.5, max_depth_m=0.8, binning=2), CONFIG)
    drawing = texture(10, (480, 1200))
    pictures = [drawing[:, start : start + 800].clip(0, 255).astype(np.uint8) for start in (0, 330)]
    black = dense.rectified(0, np.full((480, 800), 255, np.uint8)) < 255
    assert 30 * 400 < black.sum() < 60 * 400
    disparity = dense.disparity(*pictures)
    assert np.isnan(disparity[black]).all() and np.isfinite(disparity[~black]).mean() > 0.3


@pytest.mark.parametrize("grey", [0, 90, 255])
def test_a_lens_that_shows_nothing_gives_no_disparity(grey: int) -> None:
    """Covered, or blinded: the turned pictures' black borders were all edges, of which 64 % got a disparity."""
    left, right = (CameraModel.load(CAMERAS / f"bench_{side}.yaml") for side in ("left", "right"))
    dense = DenseStereo(StereoModel(left=left, right=right), DenseConfig(min_depth_m=0.4, binning=2), CONFIG)
    picture = np.full((left.height, left.width), grey, np.uint8)
    assert np.isnan(dense.disparity(picture, picture)).all()


WARMED = """
import numpy as np
from harris_perception.core.stereo import dense_stereo as dense
from harris_perception.core.stereo import stereo_kernels as loops
from harris_perception.core.stereo import stereo_matching as sparse
from unit.harris_perception.rendered_stylus import stereo_model
kernels = {n: kernel for core in (dense, loops) for n, kernel in vars(core).items() if hasattr(kernel, "signatures")}
known = lambda: {name: len(kernel.signatures) for name, kernel in kernels.items()}
dense.warm()
sparse.warm()
warmed = known()
stereo = stereo_model()
picture = np.random.default_rng(0).integers(0, 256, (stereo.left.height, stereo.left.width), np.uint8)
matcher = dense.DenseStereo(stereo, dense.DenseConfig(), dense.SemiGlobalConfig())
matcher.points(matcher.disparity(picture, picture))
at = np.random.default_rng(1).uniform(60, 400, (300, 2))
moved = np.roll(picture, -30, axis=1)
found = sparse.match_corners(picture, moved, at, at[::2] - (30, 0), (2.0, 80.0), sparse.StereoMatchConfig())
assert len(found) > 250, len(found)
assert known() == warmed, (known(), warmed)
for name in ("_accept", "_refine", "_keep_covered", "_spread_out"):
    assert warmed[name] == 1, warmed
for name in ("best_partners", "nearest", "slid", "along_rows", "gauss_newton"):
    assert warmed[name] == 1, warmed
"""


@pytest.mark.timeout(480)  # the first time all is compiled, on a busy computer
def test_after_warming_no_pair_waits_for_the_compiler() -> None:
    tests = str(Path(__file__).resolve().parents[3])
    ran = subprocess.run(
        [sys.executable, "-c", WARMED],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([tests, *sys.path])},
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
