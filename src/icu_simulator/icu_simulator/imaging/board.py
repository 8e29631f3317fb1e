"""Result of a calibration with a printed board, to first order: its difference from the true cameras.

The board's images by both cameras give a linear least-squares problem in all parameters of a stereo calibration. These
are the focal length, principal point and five distortion coefficients of each camera, the right camera's pose, and each
board's pose. Its right side contains the errors that the model lacks: corner errors, scale of the print, bow of the
sheet, and higher orders of the lens. The solution has the strong correlations of a real calibration, whose errors
cancel at the positions of the boards. Source of the model: Z. Zhang, "A Flexible New Technique for Camera Calibration",
PAMI 22 (2000).
"""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np

from icu_common.core.geometry.geometry import Array, Transform
from icu_simulator.core.configuration import BenchCameraConfig
from icu_simulator.core.optics import Camera, StereoRig, stereo_rig, turn
from icu_simulator.imaging.configuration import CalibrationErrorConfig, LensConfig

COLUMNS, ROWS, SQUARE_M = 8, 6, 0.025
"""Columns and rows of corners, and square size, of a chessboard on a sheet of A4."""
NEAR_M, FAR_M, TILT_DEG = 0.5, 0.8, 35.0
_INTRINSICS = 8
_STEP = 1e-6
_RADIUS_M = 0.11
_TRIES = 400


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardResult:
    """True cameras of calibration files with the values of ``BenchCameraConfig``, and the residual error of the fit.

    ``rms_px`` (2,) of the left and the right camera, over both coordinates of all corners as in OpenCV.
    """

    left: Camera
    right: Camera
    rms_px: tuple[float, float]


@functools.lru_cache(maxsize=8)
def true_cameras(
    camera: BenchCameraConfig, calibration: CalibrationErrorConfig, lens: LensConfig, seed: int
) -> BoardResult:
    """Return the cameras for which a board calibration would result in the calibration files of ``camera``.

    Parameters
    ----------
    camera
        The nominal cameras, which are in the calibration files.
    calibration
        The board and its errors.
    lens
        Distortion orders beyond the model.
    seed
        Draws the board's poses and the corners' errors.
    """
    nominal = stereo_rig(camera)
    extra = (lens.k4, lens.trefoil[0], lens.trefoil[1]) if lens.enabled else (0.0, 0.0, 0.0)
    bent = [dataclasses.replace(c, extra=extra) for c in (nominal.left, nominal.right)]
    rng = np.random.default_rng((seed, 46))
    poses = _board_poses(nominal, calibration.views, rng)
    flat = np.array([((c - 3.5) * SQUARE_M, (r - 2.5) * SQUARE_M, 0.0) for r in range(ROWS) for c in range(COLUMNS)])
    printed = flat
    if calibration.enabled:
        bow = calibration.bow_mm / 1000 * (1 - (flat[:, :1] ** 2 + flat[:, 1:2] ** 2) / _RADIUS_M**2)
        printed = flat * (1 + calibration.print_scale) + bow * (0.0, 0.0, 1.0)
    seen = np.concatenate([[c.project(pose.apply(printed)) for pose in poses] for c in bent])
    meant = np.concatenate([[c.project(pose.apply(flat)) for pose in poses] for c in (nominal.left, nominal.right)])
    error = (seen - meant).ravel()
    noise = rng.standard_normal(error.size) * (calibration.rms_px / np.sqrt(2))
    if calibration.enabled:
        error = error + noise
    jacobian = _jacobian(nominal, poses, flat)
    scale = np.linalg.norm(jacobian, axis=0)
    found, *_ = np.linalg.lstsq(jacobian / scale, error, rcond=None)
    found = found / scale
    left_over = (error - jacobian @ found).reshape(2, -1, 2)
    rms = np.sqrt((left_over**2).sum(axis=2).mean(axis=1))
    # The calibration gives the truth plus `found`, which are the nominal values: the truth is nominal minus `found`.
    cameras = [_changed(c, -found[_INTRINSICS * i : _INTRINSICS * (i + 1)]) for i, c in enumerate((bent[0], bent[1]))]
    right_from_left = nominal.right.camera_from_base @ nominal.left.camera_from_base.inverse()
    moved = _moved(right_from_left, -found[2 * _INTRINSICS : 2 * _INTRINSICS + 6])
    right = dataclasses.replace(cameras[1], camera_from_base=moved @ nominal.left.camera_from_base)
    return BoardResult(left=cameras[0], right=right, rms_px=(float(rms[0]), float(rms[1])))


def _changed(camera: Camera, by: Array) -> Camera:
    """Return the camera with changed focal length, principal point and distortion; ``by`` is (8,)."""
    d = [a + float(b) for a, b in zip(camera.distortion, by[3:8])]
    return dataclasses.replace(
        camera,
        focal_px=camera.focal_px + float(by[0]),
        centre_px=(camera.centre_px[0] + float(by[1]), camera.centre_px[1] + float(by[2])),
        distortion=(d[0], d[1], d[2], d[3], d[4]),
    )


def _moved(transform: Transform, by: Array) -> Transform:
    """Return the transform rotated by ``by[:3]`` (rad, in its target frame) and shifted by ``by[3:]`` (m)."""
    size = float(np.linalg.norm(by[:3]))
    if size == 0.0:
        return Transform(transform.rotation, transform.translation + by[3:])
    x, y, z = by[:3] / size
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation = np.eye(3) + np.sin(size) * cross + (1 - np.cos(size)) * cross @ cross
    return Transform(rotation @ transform.rotation, transform.translation + by[3:])


def _board_poses(rig: StereoRig, count: int, rng: np.random.Generator) -> list[Transform]:
    """Draw ``base_from_board`` of boards fully visible to both cameras, facing the left one, all over its image."""
    corners = np.array([(x * 0.1, y * 0.075, 0.0) for x in (-1, 1) for y in (-1, 1)])
    base_from_left = rig.left.camera_from_base.inverse()
    poses: list[Transform] = []
    for _ in range(_TRIES * count):
        if len(poses) == count:
            return poses
        u, v = rng.uniform(0, rig.left.width), rng.uniform(0, rig.left.height)
        depth = rng.uniform(NEAR_M, FAR_M)
        tilt = turn(0, rng.uniform(-TILT_DEG, TILT_DEG)) @ turn(1, rng.uniform(-TILT_DEG, TILT_DEG))
        rotation = tilt @ turn(2, rng.uniform(-20, 20) + 180 * int(rng.integers(2)))
        a, b = ((p - c) / rig.left.focal_px for p, c in zip((u, v), rig.left.centre_px))
        pose = base_from_left @ Transform(rotation, depth * np.array([a, b, 1.0]))
        seen = np.concatenate([camera.project(pose.apply(corners)) for camera in (rig.left, rig.right)])
        if (seen > 0).all() and (seen < (rig.left.width, rig.left.height)).all():
            poses.append(pose)
    raise ValueError(f"only {len(poses)} of {count} views of the board are seen by both cameras")


def _jacobian(rig: StereoRig, poses: list[Transform], flat: Array) -> Array:
    """Return the (2 V N 2, 22 + 6 V) derivatives of all corners' pixels by all parameters, by central differences."""
    views, corners = len(poses), len(flat)
    result = np.zeros((2, views, corners, 2, 2 * _INTRINSICS + 6 + 6 * views))
    points = [pose.apply(flat) for pose in poses]
    left_from_base = rig.left.camera_from_base
    right_from_left = rig.right.camera_from_base @ left_from_base.inverse()
    for index, camera in enumerate((rig.left, rig.right)):
        for n in range(_INTRINSICS):
            step = np.zeros(_INTRINSICS)
            step[n] = _STEP * (1000.0 if n < 3 else 1.0)
            high, low = _changed(camera, step), _changed(camera, -step)
            for v, p in enumerate(points):
                result[index, v, :, :, _INTRINSICS * index + n] = (high.project(p) - low.project(p)) / (2 * step[n])
    for n in range(6):
        step = np.zeros(6)
        step[n] = _STEP
        high, low = (
            dataclasses.replace(rig.right, camera_from_base=_moved(right_from_left, s) @ left_from_base)
            for s in (step, -step)
        )
        for v, p in enumerate(points):
            result[1, v, :, :, 2 * _INTRINSICS + n] = (high.project(p) - low.project(p)) / (2 * _STEP)
            column = 2 * _INTRINSICS + 6 + 6 * v + n
            moved = [_moved(poses[v], s).apply(flat) for s in (step, -step)]
            for index, camera in enumerate((rig.left, rig.right)):
                pair = [camera.project(m) for m in moved]
                result[index, v, :, :, column] = (pair[0] - pair[1]) / (2 * _STEP)
    return result.reshape(2 * views * corners * 2, -1)
