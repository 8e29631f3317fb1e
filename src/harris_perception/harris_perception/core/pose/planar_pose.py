"""Pose of a plane from measured points, or from points on edges, of which only the distance across is known.

Images are rectified: no distortion, intrinsics from the camera's projection matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.image.medians import median
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform, nearest_rotation

# Tukey's biweight at 95 % efficiency, and the median absolute deviation of a normal distribution.
_TUKEY, _MAD = 4.685, 1.4826
# Standard deviation, px, of the error shared by edge points of one line, independent of scale, noise and blur. Corners
# of one word also share an error: the variance of a plane fitted to corners is this many times that for independent
# points. Measured on renders with known truth (docs/decisions/recognition.md).
_SHARED_PX, _CORNERS_SHARE = 0.055, 4.0
# Prior standard deviation of a pose: half a radian, half a metre.
_UNMEASURED = 0.5
# Maximum difference, in standard deviations, to a plane measured by other means.
_MOST_OFF = 3.0
# Maximum distance of a point from a line, as a share of the line's length, to count as on it.
_ON_A_LINE = 1e-6

FACE_POINT_COLUMNS = ("x", "y", "u", "v", "across_u", "across_v")
"""Columns of a face's points in messages."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FacePoints:
    """Points of a face and their positions in one image.

    Attributes
    ----------
    in_face
        (N, 2) m, on the plane.
    pixels
        (N, 2) px, rectified.
    across
        (N, 2) unit vectors in the image: only the distance along them was measured, as at an edge; a corner is two
        points, one for each direction.
    """

    in_face: Array
    pixels: Array
    across: Array

    @classmethod
    def joined(cls, parts: Sequence[FacePoints]) -> FacePoints:
        """Return the points of all parts, in order."""
        empty = np.empty((0, 2))
        return cls(
            in_face=np.concatenate([empty, *(part.in_face for part in parts)]),
            pixels=np.concatenate([empty, *(part.pixels for part in parts)]),
            across=np.concatenate([empty, *(part.across for part in parts)]),
        )

    @classmethod
    def of_corners(cls, in_face: Array, pixels: Array) -> FacePoints:
        """Return 2 N points for (N, 2) points that were measured in both directions, along u and v alternately."""
        across = np.tile(np.eye(2), (len(in_face), 1))
        return cls(in_face=np.repeat(in_face, 2, axis=0), pixels=np.repeat(pixels, 2, axis=0), across=across)

    @classmethod
    def of_rows(cls, rows: npt.NDArray[Any]) -> FacePoints:
        """Return points from (N, 6), in the order of FACE_POINT_COLUMNS; raises ValueError unless all are finite."""
        values = np.asarray(rows, dtype=np.float64)
        if not np.isfinite(values).all():
            raise ValueError("a point is not finite")
        return cls(in_face=values[:, :2], pixels=values[:, 2:4], across=values[:, 4:])

    @property
    def rows(self) -> Array:
        """(N, 6), in the order of FACE_POINT_COLUMNS."""
        return np.column_stack([self.in_face, self.pixels, self.across])

    def chosen(self, which: npt.NDArray[Any]) -> FacePoints:
        """Return a subset of the points."""
        return FacePoints(in_face=self.in_face[which], pixels=self.pixels[which], across=self.across[which])

    @property
    def in_space(self) -> Array:
        """(N, 3) m in the face's frame."""
        return np.column_stack([self.in_face, np.zeros(len(self.in_face))])

    def residuals(self, in_camera: Array, camera: CameraModel) -> tuple[Array, Array]:
        """Return the residuals (N,) px of points in the camera's frame (N, 3) m, and their derivative (N, 3) px/m.

        The derivative is that of the predicted position, along ``across``.
        """
        x, y, z = in_camera.T
        right, down, nearer = x / z, y / z, 1.0 / z
        (du, dv), (u, v) = self.across.T, self.pixels.T
        (fx, fy), (cx, cy) = camera.p[(0, 1), (0, 1)], camera.p[:2, 2]
        error = du * (u - (fx * right + cx)) + dv * (v - (fy * down + cy))
        by_x, by_y = du * (fx * nearer), dv * (fy * nearer)
        return error, np.stack([by_x, by_y, -(by_x * right + by_y * down)], axis=1)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseFit:
    """A fitted pose and its accuracy.

    Attributes
    ----------
    camera_from_panel
        The pose.
    error_px
        (N,) residuals of the points across.
    centre
        (3,) m in the camera's frame: centre of the rotation in ``covariance``.
    covariance
        (6, 6) of a small rotation about ``centre`` [rad] and a translation [m], in the camera's frame.
    """

    camera_from_panel: Transform
    error_px: Array
    centre: Array
    covariance: Array

    def deviation_px(self, points_m: Array, camera: CameraModel) -> Array:
        """Return the standard deviation (N,) of the image positions of points (N, 3) m of the panel, px.

        It is that of the direction with the largest standard deviation.
        """
        jacobian = _by_motion(self.camera_from_panel.apply(points_m), self.centre, camera)
        spread = jacobian @ self.covariance @ jacobian.transpose(0, 2, 1)
        # The larger eigenvalue of a symmetric (2, 2) matrix.
        half, apart = (spread[:, 0, 0] + spread[:, 1, 1]) / 2, (spread[:, 0, 0] - spread[:, 1, 1]) / 2
        return np.asarray(np.sqrt(half + np.hypot(apart, spread[:, 0, 1])))


def inverse(matrix: Array) -> Array:
    """Return the inverse of a square matrix (N, N)."""
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def map_points(homography: Array, points: npt.NDArray[Any]) -> Array:
    """Map (N, 2) points by a (3, 3) homography; those at infinity become inf or NaN."""
    mapped = np.column_stack([points, np.ones(len(points))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(mapped[:, :2] / mapped[:, 2:])


def homography_of_pose(camera_from_panel: Transform, camera: CameraModel) -> Array:
    """Return rectified_from_mm (3, 3), its last element one."""
    columns = np.column_stack([camera_from_panel.rotation[:, :2] * 1e-3, camera_from_panel.translation])
    homography = camera.p[:, :3] @ columns
    return np.asarray(homography / homography[2, 2])


def planar_poses(points_m: npt.NDArray[Any], pixels: npt.NDArray[Any], camera: CameraModel) -> list[Transform]:
    """Return the one or two poses that explain points (N, 2) m on a plane, seen at (N, 2) px, the better first.

    There is none for fewer than four points, for points or pixels that are not finite or collinear, or if the points
    would be behind the camera.

    Infinitesimal plane-based pose estimation (T. Collins, A. Bartoli, IJCV 109(3), 2014). If the points are close
    together, noise determines which of its two solutions fits better.
    """
    if len(points_m) < 4 or not (_fill_a_plane(points_m) and _fill_a_plane(pixels)):
        return []
    world = np.column_stack([points_m, np.zeros(len(points_m))])
    shift = world.mean(axis=0)  # the method requires points around the origin of their plane
    try:
        count, turns, moves, errors = cv2.solvePnPGeneric(
            world - shift, pixels.astype(np.float64), camera.p[:, :3], np.zeros(5), flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return []
    found = []
    for number in np.argsort(np.ravel(errors)) if count else ():
        if not (np.isfinite(turns[number]).all() and np.isfinite(moves[number]).all()):
            continue
        rotation = nearest_rotation(cv2.Rodrigues(turns[number])[0])
        pose = Transform(rotation, np.ravel(moves[number]) - rotation @ shift)
        if pose.apply(world)[:, 2].min() > 0:
            found.append(pose)
    return found


def _fill_a_plane(points: npt.NDArray[Any]) -> bool:
    """Return whether points (N, 2) are finite and not collinear."""
    if not np.isfinite(points).all():
        return False
    along, across = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(across > _ON_A_LINE * along)


def fit_pose(
    start: Transform, points: FacePoints, camera: CameraModel, floor_px: float = 0.1, prior: PoseFit | None = None
) -> PoseFit:
    """Refine a pose by robust Gauss-Newton.

    Parameters
    ----------
    start
        Initial camera_from_panel.
    points
        The measurements.
    camera
        Intrinsics of the rectified image.
    floor_px
        Lower limit of the measurements' standard deviation; residuals below a few times this are never outliers.
    prior
        Estimate of the pose from another source, weighted by its covariance.
    """
    world, pose = points.in_space, start
    for _ in range(20):
        seen = pose.apply(world)
        error, by_point = points.residuals(seen, camera)
        # Rotate about the measured centre, so that rotation and translation are nearly uncorrelated.
        centre = seen.mean(axis=0)
        weight = tukey(error, floor_px) / _scale(error, floor_px)
        weighted = weight * _by_turn_and_shift(by_point, seen - centre)
        information, pull, known = weighted @ weighted.T, weighted @ (error * weight), np.zeros((6, 6))
        if prior is not None:
            off, known = _from_prior(prior, pose, centre)
            information, pull = information + known, pull + known @ off
        if not (np.isfinite(information).all() and np.isfinite(pull).all()):
            information = known = np.zeros((6, 6))  # the start diverged: nothing is known of such a pose
            break
        step = np.linalg.lstsq(information, pull, rcond=None)[0]
        turn = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64)
        pose = Transform(nearest_rotation(turn @ pose.rotation), turn @ (pose.translation - centre) + centre + step[3:])
        if np.abs(step).max() < 1e-9:
            break
    error = points.residuals(pose.apply(world), camera)[0]
    certain = (_scale(error, floor_px) / _deviation(error, floor_px)) ** 2
    return PoseFit(
        camera_from_panel=pose,
        error_px=error,
        centre=centre,
        covariance=inverse(certain * (information - known) + known + np.eye(6) / _UNMEASURED**2),
    )


def sharing(fit: PoseFit, points: FacePoints, line: npt.NDArray[np.intp], camera: CameraModel) -> PoseFit:
    """Return the fit with a covariance that includes a common error of the points of each ``line`` (N,)."""
    seen = fit.camera_from_panel.apply(points.in_space)
    slopes = _by_turn_and_shift(points.residuals(seen, camera)[1], seen - fit.centre)
    sums = np.zeros((int(line.max()) + 1, 6))
    np.add.at(sums, line, slopes.T)
    # Information of points with errors of 1 px each, and the share of each line's error that affects the pose.
    information = slopes @ slopes.T + (_SHARED_PX / _UNMEASURED) ** 2 * np.eye(6)
    taken = _SHARED_PX * np.linalg.solve(information, sums.T)
    return replace(fit, covariance=fit.covariance + taken @ taken.T)


def with_plane(fit: PoseFit, plane_pose: Transform, covariance: Array) -> PoseFit | None:
    """Improve a pose by a plane measured by other means, each weighted by its covariance.

    Returns None if they differ too much: it is then another plane.

    Parameters
    ----------
    fit
        The pose and its covariance.
    plane_pose
        camera_from_plane: a point of the plane, z along its normal.
    covariance
        (6, 6) of ``plane_pose``, as in :class:`~harris_perception.core.stereo.plane_fit.PlaneFit`.
    """
    normal, point = plane_pose.rotation[:, 2], plane_pose.translation
    before, covariance = fit.covariance, _CORNERS_SHARE * covariance
    # The planes are compared at three points, 0.1 m apart.
    places = point + 0.1 * np.array([np.zeros(3), plane_pose.rotation[:, 0], plane_pose.rotation[:, 1]])
    measured = np.column_stack([np.tile(normal, (3, 1)), np.cross(places - point, normal)])
    noise = measured @ covariance @ measured.T
    pose = fit.camera_from_panel
    face = pose.rotation[:, 2]
    jacobian = -np.column_stack([np.cross(places - fit.centre, face), np.tile(face, (3, 1))])
    apart = (places - pose.translation) @ face
    expected = jacobian @ before @ jacobian.T + noise
    if float(apart @ np.linalg.solve(expected, apart)) > 3 * _MOST_OFF**2:
        return None
    gain = np.linalg.solve(expected, jacobian @ before).T
    step = -gain @ apart
    turn = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64)
    moved = Transform(
        nearest_rotation(turn @ pose.rotation), turn @ (pose.translation - fit.centre) + fit.centre + step[3:]
    )
    return PoseFit(
        camera_from_panel=moved,
        error_px=fit.error_px,
        centre=fit.centre + step[3:],
        covariance=before - gain @ jacobian @ before,
    )


def _from_prior(prior: PoseFit, pose: Transform, centre: Array) -> tuple[Array, Array]:
    """Return the step (6,) from ``pose`` to the prior's pose, and its information (6, 6), about ``centre``."""
    turn = prior.camera_from_panel.rotation @ pose.rotation.T
    move = prior.camera_from_panel.translation - turn @ (pose.translation - centre) - centre
    # A rotation w about the prior's centre moves ``centre`` by w x (centre - prior.centre).
    shift = np.eye(6)
    shift[3:, :3] = -cross((centre - prior.centre)[None])[0]
    step = np.concatenate([cv2.Rodrigues(turn)[0][:, 0], move]).astype(np.float64)
    return step, np.asarray(np.linalg.inv(shift @ prior.covariance @ shift.T), np.float64)


def _by_motion(seen: Array, centre: Array, camera: CameraModel) -> Array:
    """Return (N, 2, 6) derivatives of the pixels of points (N, 3) by a rotation about ``centre`` and a translation."""
    focal = np.array([camera.p[0, 0], camera.p[1, 1]])
    by_point = np.zeros((len(seen), 2, 3))
    by_point[:, (0, 1), (0, 1)] = focal / seen[:, 2:]
    by_point[:, :, 2] = -focal * seen[:, :2] / seen[:, 2:] ** 2
    return np.concatenate([by_point @ -cross(seen - centre), by_point], axis=2)


def _by_turn_and_shift(by_point: Array, arm: Array) -> Array:
    """Return derivatives (6, N) by rotation and translation, from those by the points (N, 3) at ``arm`` (N, 3)."""
    (bx, by, bz), (x, y, z) = by_point.T, arm.T
    return np.stack([y * bz - z * by, z * bx - x * bz, x * by - y * bx, bx, by, bz])


def _scale(error: Array, floor: float) -> float:
    """Return a robust standard deviation of residuals around zero, at least ``floor``."""
    return max(_MAD * median(np.abs(error)), floor)


def _deviation(error: Array, floor: float) -> float:
    """Return the standard deviation of a measurement with Tukey's weights as it affects the pose, at least ``floor``.

    It is that of the M-estimator (P. J. Huber, "Robust Statistics", 1981, 7.6): outliers increase ``_scale``, but not
    the scatter of the measurements that have weight. The pose used up six of their degrees of freedom.
    """
    far = np.minimum(np.abs(error) / (_TUKEY * _scale(error, floor)), 1.0) ** 2
    weight, slope = (1 - far) ** 2, (1 - far) * (1 - 5 * far)
    count, steep = float(weight.sum()), float(slope.sum())
    if steep <= 0:
        return _scale(error, floor)
    spread = float(np.sqrt(((weight * error) ** 2).sum() * count)) / steep
    return max(spread, floor) * float(np.sqrt(max(count, 1.0) / max(count - 6, 1.0)))


def tukey(error: Array, floor: float) -> Array:
    """Return square roots of Tukey's weights, in the shape of ``error``, for residuals around zero.

    ``floor`` is the lower limit of their standard deviation.
    """
    return np.asarray(1 - np.minimum(np.abs(error) / (_TUKEY * _scale(error, floor)), 1.0) ** 2)


def cross(vectors: Array) -> Array:
    """Return (N, 3, 3) matrices that apply the cross product with vectors (N, 3) from the left."""
    x, y, z = vectors.T
    zero = np.zeros(len(x))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
