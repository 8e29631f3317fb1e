"""The area of an image that the robot's own stylus and arm hide, derived from the position of the tip."""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.recognition.state_config import StateConfig
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform

Picture = npt.NDArray[np.uint8]
_NEAREST_M, _FIELD = 0.05, 1.5
"""Minimum depth of the drawn part of a body that extends behind the camera, and its maximum distance from the image
centre, in half image sizes."""


def own_shadow(pose: Transform, camera: CameraModel, tip: Array | None, config: StateConfig) -> Picture:
    """Draw the area hidden by stylus and arm, (H, W) uint8; empty if the tip is not seen."""
    mask = np.zeros((camera.height, camera.width), np.uint8)
    if tip is None:
        return mask
    x, y, z = pose.inverse().apply(tip)
    r, w = config.stylus_radius_m, config.arm_half_width_m
    shaft = [(x + i * r, y + j * r, h) for i in (-1, 1) for j in (-1, 1) for h in (z - r, config.arm_top_m)]
    arm = [
        (x + i * w, y + j, h)
        for i in (-1, 1)
        for j in (-w, 0.5)
        for h in (config.arm_height_m, config.arm_height_m + 0.02)
    ]
    for box in (shaft, arm):
        pixels = camera.project(_before(camera, pose.apply(np.array(box))))
        if len(pixels):
            hull = cv2.convexHull(np.clip(pixels, -4000, 8000).astype(np.float32))
            cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
    return mask


def widened(shadow: Picture, camera: CameraModel, tip: Array | None, wander_m: float) -> Picture:
    """Return the area that may be hidden after the tip (3,) m has moved by ``wander_m``, from its shadow (H, W)."""
    if tip is None or wander_m == 0:
        return shadow
    reach = min(math.ceil(wander_m * camera.k[0, 0] / max(float(tip[2]), _NEAREST_M)), max(camera.size))
    wide = cv2.dilate(shadow, np.ones((1, 2 * reach + 1), np.uint8))
    return np.asarray(cv2.dilate(wide, np.ones((2 * reach + 1, 1), np.uint8)), np.uint8)


def _before(camera: CameraModel, corners: Array) -> Array:
    """Return corners (M, 3) m with the same outline in the image as a convex body with corners (N, 3) m.

    A body that extends behind the camera, where points have no pixel, is cut to the part that may be in the image.
    """
    turned = corners @ camera.r
    depth = turned[:, 2] - _NEAREST_M
    ahead, behind = depth > 0, depth <= 0
    if ahead.all():
        return corners
    # Between each corner in front and each behind: the intersection of their line with the nearest depth.
    share = depth[ahead][:, None] / (depth[ahead][:, None] - depth[behind])
    near, far = turned[behind][None], turned[ahead][:, None]
    left = np.vstack([turned[ahead], (far + share[..., None] * (near - far)).reshape(-1, 3)])
    if not len(left):
        return left
    flat = cv2.convexHull((left[:, :2] / left[:, 2:]).astype(np.float32))
    focal, middle = camera.k[[0, 1], [0, 1]], camera.k[:2, 2]
    low, high = (_FIELD * (edge - middle) / focal for edge in (np.zeros(2), np.array(camera.size)))
    field = np.array([low, (high[0], low[1]), high, (low[0], high[1])], np.float32)
    _, cut = cv2.intersectConvexConvex(flat, field)
    if cut is None:
        return np.empty((0, 3))
    return np.column_stack([np.asarray(cut, np.float64).reshape(-1, 2), np.ones(len(cut))]) @ camera.r.T
