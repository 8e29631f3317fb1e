"""Whether both cameras and the print agree on how far away the panel is."""

from __future__ import annotations

import math

import numpy as np
import pytest
from unit.harris_perception.rectified_pair import POSE

from harris_perception.core.pose.face_depth import LEAST_POINTS, LOOKS, FaceDepth, height_above_face_m
from icu_common.core.geometry.geometry import Array

SIZE_MM = (320.0, 150.0)


def points_on_face(rng: np.random.Generator, count: int, noise_m: float = 0.0004) -> Array:
    """Return points (N, 3) of the face, in the camera's frame."""
    places = np.column_stack([rng.uniform(0.0, 0.32, count), rng.uniform(0.0, 0.15, count), np.zeros(count)])
    return POSE.apply(places) + rng.normal(0, noise_m, (count, 3))


@pytest.mark.parametrize("scale", [0.99, 1.0, 1.005])
def test_a_pose_at_another_scale_is_seen_in_the_height(scale: float) -> None:
    rng = np.random.default_rng(4)
    found = height_above_face_m(points_on_face(rng, 200) * scale, POSE, SIZE_MM)
    eye_m = float(POSE.inverse().translation[2])
    assert found == pytest.approx((1.0 - scale) * eye_m, abs=0.0002)


def test_knobs_and_what_is_beside_the_panel_do_not_count() -> None:
    rng = np.random.default_rng(5)
    knobs = POSE.apply(np.column_stack([rng.uniform(0.02, 0.3, (60, 2)) * (1.0, 0.4), np.full(60, 0.015)]))
    wall = POSE.apply(np.column_stack([rng.uniform(0.5, 2.0, (500, 2)), np.full(500, -0.3)]))
    found = height_above_face_m(np.vstack([points_on_face(rng, 200), knobs, wall]), POSE, SIZE_MM)
    assert found is not None and abs(found) < 0.0004
    assert height_above_face_m(wall, POSE, SIZE_MM) is None
    assert height_above_face_m(points_on_face(rng, LEAST_POINTS - 1), POSE, SIZE_MM) is None


def test_only_looks_that_agree_in_a_row_tell_anything() -> None:
    depth = FaceDepth(2.0)
    for height_m in (0.0, 0.0061) * 2 * LOOKS:
        depth.add(height_m)
    assert depth.text is None, "neither confirmed nor denied"
    for height_m in (0.0, 0.0001, None, -0.0019, 0.0, 0.0):
        depth.add(height_m)
    assert depth.text == ""
    for _ in range(LOOKS):
        depth.add(-0.0063)
    assert depth.text is not None and "see the panel 6.3 mm further away than its print (limit 2 mm" in depth.text
    depth.add(math.nan)
    assert "6.3 mm" in depth.text, "it says the same until it is over"
