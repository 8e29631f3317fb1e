"""Pose of a plane from what was measured of it: points, or edges of which only the distance across is known.

Pictures are rectified: no distortion, intrinsics from the camera's projection matrix.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.camera_model import CameraModel
from icu_common.core.geometry import Array, Transform, nearest_rotation

# Tukey's biweight at 95 % efficiency, and the median absolute deviation of a normal distribution.
_TUKEY, _MAD = 4.685, 1.4826


def inverse(homography: Array) -> Array:
    """Return the inverse of a (3, 3) homography."""
    return np.asarray(np.linalg.inv(homography), dtype=np.float64)


def map_points(homography: Array, points: npt.NDArray[Any]) -> Array:
    """Map (N, 2) points by a (3, 3) homography; those at infinity become inf or NaN."""
    mapped = np.column_stack([points, np.ones(len(points))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def pose_of_homography(rectified_from_mm: Array, size_mm: tuple[float, float], camera: CameraModel) -> Transform | None:
    """Return camera_from_panel from a homography of a face of ``size_mm``, or None when it is no camera's."""
    x, y = (np.linspace(0.0, side, 5) for side in size_mm)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixels = map_points(rectified_from_mm, points)
    return planar_pose(points * 1e-3, pixels, camera) if np.isfinite(pixels).all() else None


def homography_of_pose(camera_from_panel: Transform, camera: CameraModel) -> Array:
    """Return rectified_from_mm (3, 3), its last element one."""
    columns = np.column_stack([camera_from_panel.rotation[:, :2] * 1e-3, camera_from_panel.translation])
    homography = camera.p[:, :3] @ columns
    return np.asarray(homography / homography[2, 2])


def planar_pose(points_m: Array, pixels: Array, camera: CameraModel) -> Transform | None:
    """Return camera_from_panel of at least four points (N, 2) m on a plane, seen at (N, 2) px; None without one.

    Infinitesimal plane-based pose estimation (T. Collins, A. Bartoli, IJCV 109(3), 2014); of its two solutions the one
    that fits better.
    """
    world = np.column_stack([points_m, np.zeros(len(points_m))])
    shift = world.mean(axis=0)  # the method wants the points around the origin of their plane
    try:
        count, turns, moves, errors = cv2.solvePnPGeneric(
            world - shift, pixels, camera.p[:, :3], np.zeros(5), flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return None
    if not count:
        return None
    best = int(np.argmin(np.ravel(errors)))
    rotation = nearest_rotation(cv2.Rodrigues(turns[best])[0])
    translation = np.ravel(moves[best]) - rotation @ shift
    if not (np.isfinite(translation).all() and translation[2] > 0):
        return None
    return Transform(rotation, translation)


def fit_pose(
    start: Transform,
    points_m: Array,
    pixels: Array,
    camera: CameraModel,
    across: Array | None = None,
    floor_px: float = 0.1,
) -> tuple[Transform, Array]:
    """Refine a pose by robust Gauss-Newton; return it and the residuals.

    Parameters
    ----------
    start
        camera_from_panel.
    points_m
        (N, 2) m on the plane.
    pixels
        (N, 2) where they are seen.
    camera
        Gives the intrinsics of the rectified picture.
    across
        (N, 2) unit vectors in the picture: only the distance along them counts (edges). Without it both directions do.
    floor_px
        Residuals below a few times this are never outliers.

    Returns
    -------
    camera_from_panel and residuals, (N,) px with ``across``, else (2 N,).
    """
    world = np.column_stack([points_m, np.zeros(len(points_m))])
    focal = np.array([camera.p[0, 0], camera.p[1, 1]])
    pose = start

    def residuals(candidate: Transform) -> tuple[Array, Array]:
        seen = candidate.apply(world)
        error = pixels - (focal * seen[:, :2] / seen[:, 2:] + camera.p[:2, 2])
        return (error.ravel() if across is None else np.einsum("ni,ni->n", across, error)), seen

    for _ in range(20):
        error, seen = residuals(pose)
        x, y, z = seen.T
        zero = np.zeros(len(z))
        by_point = np.stack(
            [
                np.column_stack([focal[0] / z, zero, -focal[0] * x / z**2]),
                np.column_stack([zero, focal[1] / z, -focal[1] * y / z**2]),
            ],
            axis=1,
        )
        # Turn about the seen centre, so that rotation and translation hardly disturb one another.
        centre = seen.mean(axis=0)
        jacobian = np.concatenate([by_point @ -_cross(seen - centre), by_point], axis=2)
        rows = jacobian.reshape(-1, 6) if across is None else np.einsum("ni,nij->nj", across, jacobian)
        weight = _weights(error, floor_px)
        step = np.linalg.lstsq(rows * weight[:, None], error * weight, rcond=None)[0]
        turn = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64)
        pose = Transform(nearest_rotation(turn @ pose.rotation), turn @ (pose.translation - centre) + centre + step[3:])
        if np.abs(step).max() < 1e-9:
            break
    return pose, residuals(pose)[0]


def _weights(error: Array, floor: float) -> Array:
    """Return square roots of Tukey's weights for residuals around zero."""
    scale = max(_MAD * float(np.median(np.abs(error))), floor)
    return np.asarray(1 - np.minimum(np.abs(error) / (_TUKEY * scale), 1.0) ** 2)


def _cross(vectors: Array) -> Array:
    x, y, z = vectors.T
    zero = np.zeros(len(x))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
