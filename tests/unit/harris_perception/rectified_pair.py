"""A pair of cameras without distortion, and what it measures of a tip and of a panel, with noise in pixels."""

from __future__ import annotations

import cv2
import numpy as np
from support.pinhole import pinhole

from harris_perception.core.hand_eye.calibration_file import StoredCalibration
from harris_perception.core.pose.planar_pose import FacePoints
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Transform


def camera(focal_px: float = 1700.0, baseline_m: float = 0.0) -> CameraModel:
    return pinhole(focal_px=focal_px, centre_px=(640.0, 360.0), baseline_m=baseline_m)


PAIR = StereoModel(left=camera(), right=camera(baseline_m=0.12))


def stored_calibration(camera_from_base: Transform, base_from_reading: np.ndarray) -> StoredCalibration:
    """Return a good calibration of the pair, of a machine named bench."""
    return StoredCalibration(
        camera_from_base=camera_from_base,
        base_from_reading=base_from_reading,
        stylus_direction=np.array([0.0, 0.0, -1.0]),
        left=PAIR.left,
        right=PAIR.right,
        machine="bench",
        rms_m=0.00004,
        sigma_m=0.00002,
        held_out_m=0.0001,
        samples=24,
        made_at="2026-03-04T05:06:07+00:00",
    )


def triangulated(tips: np.ndarray, rng: np.random.Generator, sigma_px: float) -> np.ndarray:
    """Return points (N, 3) m as both pictures see them with an error of ``sigma_px``."""
    left, right = PAIR.left.project(tips), PAIR.project_right(tips)
    return PAIR.triangulate(left + rng.normal(0, sigma_px, left.shape), right + rng.normal(0, sigma_px, right.shape))


def pair_covariance(tip: np.ndarray, sigma_px: float) -> np.ndarray:
    """Return (3, 3) m^2 of a point (3,) m that :func:`triangulated` gives."""
    left, right = PAIR.left.project(tip)[0], PAIR.project_right(tip)[0]
    pixels, step = np.array([*left, *right]), 1e-3
    moved = pixels + step * np.eye(4)
    by_pixel = (PAIR.triangulate(moved[:, :2], moved[:, 2:]) - tip).T / step
    return np.asarray(sigma_px**2 * by_pixel @ by_pixel.T)


def measured_face(
    pose: Transform, rng: np.random.Generator | None = None, sigma_px: float = 0.0, count: int = 80, part: float = 1.0
) -> FacePoints:
    """Return points of a face of 0.32 m by 0.15 m, measured across one direction; a ``part`` in x of it is seen."""
    rng = np.random.default_rng(11) if rng is None else rng
    places = rng.uniform((0.0, 0.0), (0.32 * part, 0.15), (count, 2)) + (rng.uniform(0, 0.32 * (1 - part)), 0.0)
    angle = rng.uniform(0, np.pi, count)
    across = np.column_stack([np.cos(angle), np.sin(angle)])
    pixels = PAIR.left.project(pose.apply(np.column_stack([places, np.zeros(count)])))
    return FacePoints(in_face=places, pixels=pixels + rng.normal(0, sigma_px, (count, 1)) * across, across=across)


AXES = np.array([[1.003, -0.002], [0.0, 0.998]])
POSE = Transform(
    np.asarray(cv2.Rodrigues(np.array([2.71, 0.05, -0.08]))[0], dtype=float), np.array([-0.17, 0.09, 0.66])
)
