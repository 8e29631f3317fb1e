"""Measuring a face from a place to begin at, without a search."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from unit.harris_perception import panel_scene as scene

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.recognition.face_measurement import FaceMeter, RefineConfig
from harris_perception.core.recognition.panel_template import panel_template
from icu_common.core.geometry.geometry import Array, Transform

LAYOUT = scene.bench_layout()
CAMERA = scene.camera()


@cache
def meter() -> FaceMeter:
    templates = [panel_template(LAYOUT, scale) for scale in (4.0, 2.8, 2.0)]
    return FaceMeter(LAYOUT, RefineConfig(), templates, HarrisDetector(HarrisConfig()))


def rectified(truth: Transform, look: scene.Look) -> np.ndarray:
    first, second = CAMERA.rectification_maps()
    picture = scene.picture(LAYOUT, CAMERA, truth, look, seed=5)
    return np.asarray(cv2.remap(picture, first, second, cv2.INTER_LINEAR), np.uint8)


def beside(truth: Transform, turn_deg: tuple[float, float, float], shift_mm: tuple[float, float, float]) -> Transform:
    turn = np.asarray(cv2.Rodrigues(np.radians(turn_deg))[0], dtype=float)
    return Transform(turn @ truth.rotation, truth.translation + np.array(shift_mm) / 1000)


def controls(pose: Transform) -> Array:
    return pose.apply(scene.control_points_m(LAYOUT))


def test_the_pose_is_the_same_wherever_the_measurement_begins() -> None:
    truth = scene.pose(LAYOUT, side_deg=10.0)
    picture, found = rectified(truth, scene.Look()), []
    for turn_deg, shift_mm in (
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((0.5, -0.3, 0.2), (1.5, -1.0, 3.0)),
        ((-0.6, 0.5, -0.2), (-1.0, 1.5, -4.0)),
    ):
        start = meter().by_corners(picture, beside(truth, turn_deg, shift_mm), CAMERA, 0.0)
        assert start is not None
        measured = meter().by_edges(picture, start, CAMERA, 0.0)
        assert measured is not None
        fit, points, line, rms_px = measured
        assert rms_px < 0.3 and len(points.pixels) == len(line) > 500
        assert 20 < len(np.unique(line)) < 200
        found.append(controls(fit.camera_from_panel))
    assert np.linalg.norm(found[0] - controls(truth), axis=1).max() < 0.00015
    for other in found[1:]:
        assert np.linalg.norm(other - found[0], axis=1).max() < 0.00002


@pytest.mark.parametrize(("look_px", "template_px"), [(0.3, (0.6,)), (2.5, (2.3,))])
def test_the_template_is_blurred_as_the_picture_is(look_px: float, template_px: tuple[float, ...]) -> None:
    truth = scene.pose(LAYOUT)
    picture = rectified(truth, scene.Look(blur_px=look_px))
    assert meter().blur(picture, truth, CAMERA, 0.0) in template_px


def test_the_print_agrees_only_where_it_is() -> None:
    truth = scene.pose(LAYOUT)
    picture = rectified(truth, scene.Look())
    there = meter().compared(picture, truth, CAMERA, 1.0)
    aside = meter().compared(picture, beside(truth, (0.0, 0.0, 0.0), (4.0, 5.0, 0.0)), CAMERA, 1.0)
    assert there is not None and there.agreement > 0.85
    assert aside is not None and aside.agreement < 0.2


def test_a_face_that_no_camera_sees_so_is_not_measured() -> None:
    truth = scene.pose(LAYOUT)
    picture = rectified(truth, scene.Look())
    behind = Transform(truth.rotation @ np.diag([-1.0, 1.0, -1.0]), truth.translation)
    far = beside(truth, (0.0, 0.0, 0.0), (0.0, 0.0, 20_000.0))
    for pose in (behind, far):
        assert meter().by_corners(picture, pose, CAMERA, 0.0) is None
        assert meter().by_edges(picture, pose, CAMERA, 0.0) is None
        assert meter().compared(picture, pose, CAMERA, 0.0) is None
        assert meter().blur(picture, pose, CAMERA, 1.6) == 0.0
