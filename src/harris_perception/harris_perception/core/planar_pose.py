"""Pose of a plane from what was measured of it: points, or edges of which only the distance across is known.

Pictures are rectified: no distortion, intrinsics from the camera's projection matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.camera_model import CameraModel
from icu_common.core.geometry import Array, Transform, nearest_rotation

# Tukey's biweight at 95 % efficiency, and the median absolute deviation of a normal distribution.
_TUKEY, _MAD = 4.685, 1.4826

FACE_POINT_COLUMNS = ("x", "y", "u", "v", "across_u", "across_v")
"""How points of a face travel."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FacePoints:
    """Points of a face and where one picture shows them.

    Attributes
    ----------
    in_face
        (N, 2) m, on the plane.
    pixels
        (N, 2) px, rectified.
    across
        (N, 2) unit vectors in the picture: only the distance along them was measured, as at an edge; a corner is two
        points, one for each direction.
    """

    in_face: Array
    pixels: Array
    across: Array

    @classmethod
    def joined(cls, parts: Sequence[FacePoints]) -> FacePoints:
        """Return the points of all parts, in their order."""
        empty = np.empty((0, 2))
        return cls(
            in_face=np.concatenate([empty, *(part.in_face for part in parts)]),
            pixels=np.concatenate([empty, *(part.pixels for part in parts)]),
            across=np.concatenate([empty, *(part.across for part in parts)]),
        )

    @classmethod
    def of_rows(cls, rows: npt.NDArray[Any]) -> FacePoints:
        """Return points from (N, 6), in the order of FACE_POINT_COLUMNS."""
        values = np.asarray(rows, dtype=np.float64)
        if not np.isfinite(values).all():
            raise ValueError("a point is not finite")
        return cls(in_face=values[:, :2], pixels=values[:, 2:4], across=values[:, 4:])

    @property
    def rows(self) -> Array:
        """(N, 6), in the order of FACE_POINT_COLUMNS."""
        return np.column_stack([self.in_face, self.pixels, self.across])

    def chosen(self, which: npt.NDArray[Any]) -> FacePoints:
        """Return some of the points."""
        return FacePoints(in_face=self.in_face[which], pixels=self.pixels[which], across=self.across[which])

    @property
    def in_space(self) -> Array:
        """(N, 3) m in the face's frame."""
        return np.column_stack([self.in_face, np.zeros(len(self.in_face))])

    def residuals(self, in_camera: Array, camera: CameraModel) -> tuple[Array, Array]:
        """Return by how much (N,) px points in the camera's frame (N, 3) m miss, and its derivative (N, 3) px/m.

        The derivative is that of the predicted place, along ``across``.
        """
        focal = np.array([camera.p[0, 0], camera.p[1, 1]])
        slopes = in_camera[:, :2] / in_camera[:, 2:]
        error = np.einsum("ni,ni->n", self.across, self.pixels - (focal * slopes + camera.p[:2, 2]))
        scaled = self.across * focal / in_camera[:, 2:]
        return error, np.column_stack([scaled, -np.einsum("ni,ni->n", scaled, slopes)])


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
    start: Transform, points: FacePoints, camera: CameraModel, floor_px: float = 0.1
) -> tuple[Transform, Array]:
    """Refine a pose by robust Gauss-Newton; return camera_from_panel and the residuals (N,) px.

    Residuals below a few times ``floor_px`` are never outliers.
    """
    world, pose = points.in_space, start
    for _ in range(20):
        seen = pose.apply(world)
        error, by_point = points.residuals(seen, camera)
        # Turn about the seen centre, so that rotation and translation hardly disturb one another.
        centre = seen.mean(axis=0)
        rows = np.column_stack([np.einsum("nj,njk->nk", by_point, -cross(seen - centre)), by_point])
        weight = tukey(error, floor_px)
        step = np.linalg.lstsq(rows * weight[:, None], error * weight, rcond=None)[0]
        turn = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64)
        pose = Transform(nearest_rotation(turn @ pose.rotation), turn @ (pose.translation - centre) + centre + step[3:])
        if np.abs(step).max() < 1e-9:
            break
    return pose, points.residuals(pose.apply(world), camera)[0]


def tukey(error: Array, floor: float) -> Array:
    """Return square roots of Tukey's weights for residuals around zero."""
    scale = max(_MAD * float(np.median(np.abs(error))), floor)
    return np.asarray(1 - np.minimum(np.abs(error) / (_TUKEY * scale), 1.0) ** 2)


def cross(vectors: Array) -> Array:
    """Return (N, 3, 3) matrices that multiply by the cross product with vectors (N, 3) from the left."""
    x, y, z = vectors.T
    zero = np.zeros(len(x))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
