"""Measures the right camera's rotation relative to its calibration, from the panel's print in one stereo pair.

Both images show the same plane. The rows of its print give the right camera's pitch and roll. A yaw shifts all columns
alike, and so does a change of the panel's distance; the panel's size in each image separates the two. Pose and rotation
are therefore fitted jointly by robust Gauss-Newton, with the views linked as in bundle adjustment (B. Triggs et al.,
"Bundle Adjustment - A Modern Synthesis", 2000).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.pose.planar_pose import FacePoints, tukey
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array, Transform, nearest_rotation

_FLOOR_PX = 0.1
"""Size of residuals; only those beyond a few times this are outliers."""
_SHARED_PX = 0.055
"""Standard deviation of the error shared by the points of one printed line (docs/decisions/recognition.md)."""
_ROUNDS = 12
_STEP = 1e-9
_DETERMINED = 1e15
"""Maximum condition number of the normal equations; above it the print leaves one direction undetermined."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SideView:
    """The panel's print in one rectified image: its points, and the printed line (N,) of each."""

    points: FacePoints
    line: npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PairRotation:
    """Rotation of the right camera, measured in one pair.

    Attributes
    ----------
    rotation_rad
        (3,) rotation vector in the rectified right frame: x pitch, y yaw, z roll. It rotates a ray of the calibration
        to the true ray.
    covariance
        (3, 3) rad^2 of ``rotation_rad``.
    camera_from_panel
        Pose of the panel in the left rectified frame that both images agree on.
    """

    rotation_rad: Array
    covariance: Array
    camera_from_panel: Transform


def measure_rotation(left: SideView, right: SideView, start: Transform, cameras: StereoModel) -> PairRotation:
    """Fit the panel's pose and the right camera's rotation to the print in both images.

    Parameters
    ----------
    left, right
        The print in each rectified image; see :class:`SideView`.
    start
        Pose of the panel in the left rectified frame, measured in the left image.
    cameras
        Calibration without correction.

    Raises
    ------
    ValueError
        If the points do not determine the rotation.
    """
    pose, rotation = start, np.zeros(3)
    for _ in range(_ROUNDS):
        system = _system(left, right, pose, rotation, cameras)
        weighted = system.rows * system.root[:, None]
        information = weighted.T @ weighted
        if not np.isfinite(information).all() or not np.linalg.cond(information) < _DETERMINED:
            raise ValueError("the print does not determine the rotation of the right camera")
        step = np.linalg.solve(information, weighted.T @ (system.error * system.root))
        turn, centre = np.asarray(cv2.Rodrigues(step[:3])[0], dtype=np.float64), system.centre
        moved = turn @ (pose.translation - centre) + centre + step[3:6]
        pose, rotation = Transform(nearest_rotation(turn @ pose.rotation), moved), rotation + step[6:]
        if np.abs(step).max() < _STEP:
            break
    covariance = _covariance(left, right, system, information)
    return PairRotation(rotation_rad=rotation, covariance=covariance, camera_from_panel=pose)


def _covariance(left: SideView, right: SideView, system: _System, information: Array) -> Array:
    """Return (3, 3) rad^2: from the scatter of the points, and from an error of each printed line."""
    inverse, root = np.linalg.inv(information), system.root
    variance = float(np.sum((root * system.error) ** 2) / max(int((root > 0).sum()) - 9, 1))
    first_right = int(left.line.max()) + 1
    sums = np.zeros((first_right + int(right.line.max()) + 1, 9))
    lines = np.concatenate([left.line, right.line + first_right])
    np.add.at(sums, lines, system.rows * (root**2)[:, None])
    taken = _SHARED_PX * sums @ inverse
    return np.asarray((variance * inverse + taken.T @ taken)[6:, 6:])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _System:
    """Derivatives (N, 9) by pose and rotation, residuals (N,) px, roots of weights (N,), centre of rotation (3,) m."""

    rows: Array
    error: Array
    root: Array
    centre: Array


def _system(left: SideView, right: SideView, pose: Transform, rotation: Array, cameras: StereoModel) -> _System:
    seen_left, in_face = pose.apply(left.points.in_space), pose.apply(right.points.in_space)
    centre = seen_left.mean(axis=0)
    back = np.asarray(cv2.Rodrigues(-rotation)[0], dtype=np.float64)
    turned = (in_face - (cameras.baseline, 0.0, 0.0)) @ back.T
    error_left, by_left = left.points.residuals(seen_left, cameras.left)
    error_right, by_right = right.points.residuals(turned, cameras.right)
    rows = np.zeros((len(error_left) + len(error_right), 9))
    rows[: len(error_left), :6] = _by_motion(by_left, seen_left - centre)
    rows[len(error_left) :, :6] = _by_motion(by_right @ back, in_face - centre)
    # A further rotation by w moves a point of the calibrated frame by -(w x point).
    rows[len(error_left) :, 6:] = -np.cross(turned, by_right)
    root = np.concatenate([tukey(error_left, _FLOOR_PX), tukey(error_right, _FLOOR_PX)])
    return _System(rows=rows, error=np.concatenate([error_left, error_right]), root=root, centre=centre)


def _by_motion(by_point: Array, arm: Array) -> Array:
    """Return derivatives (N, 6) by a rotation about the centre and a translation, from those by the point (N, 3)."""
    return np.concatenate([np.cross(arm, by_point), by_point], axis=1)


def turned_right(cameras: StereoModel, rotation_rad: Array) -> StereoModel:
    """Return the pair with the right camera rotated by a rotation vector (3,) rad in its rectified frame."""
    turn = np.asarray(cv2.Rodrigues(np.asarray(rotation_rad, dtype=np.float64))[0], dtype=np.float64)
    return StereoModel(left=cameras.left, right=replace(cameras.right, r=nearest_rotation(turn @ cameras.right.r)))
