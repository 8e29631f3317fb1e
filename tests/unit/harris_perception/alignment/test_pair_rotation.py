"""The rotation of the right camera from points of the print, with known truth; no images."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from support.pinhole import pinhole

from harris_perception.core.alignment.pair_rotation import SideView, measure_rotation, turned_right
from harris_perception.core.pose.planar_pose import FacePoints
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array, Transform

BASELINE_M = 0.12


def cameras() -> StereoModel:
    left = pinhole()
    p = left.p.copy()
    p[0, 3] = -p[0, 0] * BASELINE_M
    return StereoModel(left=left, right=dataclasses.replace(left, p=p))


def pose() -> Transform:
    c, s = np.cos(np.radians(155)), np.sin(np.radians(155))
    return Transform(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.array([-0.16, 0.07, 0.62]))


def seen(pair: StereoModel, side: str, in_face: Array, across: Array, noise: Array) -> SideView:
    """Return points as a camera sees them that has its true rotation, in the rectified image of the calibration."""
    points = pose().apply(np.column_stack([in_face, np.zeros(len(in_face))]))
    if side == "left":
        raw, model = pair.left.project(points), pair.left
    else:
        raw, model = pair.project_right(points), cameras().right
    pixels = model.rectify(raw) + noise[:, None] * across
    line = np.arange(len(in_face)) // 20
    return SideView(points=FacePoints(in_face=in_face, pixels=pixels, across=across), line=line)


def views(rotation: Array, rng: np.random.Generator, noise_px: float) -> tuple[SideView, SideView]:
    true = turned_right(cameras(), rotation)
    sides = []
    for side in ("left", "right"):
        in_face = rng.uniform((0, 0), (0.32, 0.15), (600, 2))
        across = np.where(rng.random(600)[:, None] < 0.5, (1.0, 0.0), (0.0, 1.0))
        sides.append(seen(true, side, in_face, across, noise_px * rng.standard_normal(600)))
    return sides[0], sides[1]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_each_angle_is_found(axis: int) -> None:
    rotation = np.zeros(3)
    rotation[axis] = np.radians(0.02)
    left, right = views(rotation, np.random.default_rng(axis), 0.0)
    found = measure_rotation(left, right, pose(), cameras())
    assert found.rotation_rad == pytest.approx(rotation, abs=2e-9)


def test_wrong_points_do_not_count() -> None:
    rotation = np.radians([0.01, -0.02, 0.03])
    rng = np.random.default_rng(4)
    left, right = views(rotation, rng, 0.02)
    pixels = right.points.pixels.copy()
    pixels[::10] += 4.0
    right = dataclasses.replace(right, points=dataclasses.replace(right.points, pixels=pixels))
    found = measure_rotation(left, right, pose(), cameras())
    assert np.degrees(found.rotation_rad)[:2] == pytest.approx([0.01, -0.02], abs=0.001)


def test_the_covariance_is_that_of_the_noise() -> None:
    """With noise of each point for itself the stated deviation is not below the scatter, and not far above it."""
    rng, found = np.random.default_rng(5), []
    for _ in range(40):
        left, right = views(np.zeros(3), rng, 0.2)
        found.append(measure_rotation(left, right, pose(), cameras()))
    scatter = np.std([f.rotation_rad for f in found], axis=0)
    stated = np.sqrt(np.diag(found[0].covariance))
    assert (stated > 0.75 * scatter).all()
    assert (stated < 3.0 * scatter).all()


def test_a_turned_pair_triangulates_what_the_turned_camera_sees() -> None:
    rotation = np.radians([0.02, -0.04, 0.03])
    true, point = turned_right(cameras(), rotation), np.array([[0.03, -0.02, 0.6]])
    left, right = true.left.project(point), true.project_right(point)
    off = cameras().triangulate(cameras().left.rectify(left), cameras().right.rectify(right)) - point
    assert np.linalg.norm(off) > 0.001
    assert true.triangulate(true.left.rectify(left), true.right.rectify(right)) == pytest.approx(point, abs=1e-7)


def test_points_on_one_line_determine_nothing() -> None:
    across = np.tile((0.0, 1.0), (50, 1))
    in_face = np.column_stack([np.linspace(0.0, 0.3, 50), np.full(50, 0.05)])
    sides = [seen(cameras(), side, in_face, across, np.zeros(50)) for side in ("left", "right")]
    with pytest.raises(ValueError, match="does not determine"):
        measure_rotation(sides[0], sides[1], pose(), cameras())
