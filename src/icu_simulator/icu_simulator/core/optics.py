"""The bench's own cameras: projection with plumb-bob distortion, viewing rays, and the perfect calibration.

Written for the bench alone, so that an error in the perception's geometry cannot cancel against the same error here.
The centre of the first pixel is (0, 0); camera frames have z forward, x right, y down.
Source of the distortion: D. C. Brown, "Decentering Distortion of Lenses" (1966), in the form of sensor_msgs/CameraInfo.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array, Transform
from icu_simulator.core.configuration import BenchCameraConfig

_DIGITS = 13


def turn(axis: int, degrees: float) -> Array:
    """Return the (3, 3) rotation by ``degrees`` about coordinate axis 0, 1 or 2."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


_PIECE = 4096
"""Number of rays computed at a time."""
_SLOPES: OrderedDict[Any, tuple[Array, Array]] = OrderedDict()
"""Slopes of the last two lenses."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """One camera: its pose (``camera_from_base``, not rectified) and its projection."""

    name: str
    width: int
    height: int
    focal_px: float
    centre_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    camera_from_base: Transform
    extra: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """k4 and a trefoil of two components, which no calibration of the robot contains."""

    def project(self, points_base: npt.ArrayLike) -> Array:
        """Project (N, 3) or (3,) points in metres in base_link, all in front of the camera, to (N, 2) raw pixels."""
        points = np.atleast_2d(np.asarray(points_base, dtype=np.float64))
        x, y, z = self.camera_from_base.apply(points).T
        a, b = self._distorted(x / z, y / z)
        return np.column_stack([self.focal_px * a + self.centre_px[0], self.focal_px * b + self.centre_px[1]])

    def _distorted(self, a: Array, b: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3 = self.distortion
        k4, t1, t2 = self.extra
        q = a**2 + b**2
        radial = 1 + q * (k1 + q * (k2 + q * (k3 + q * k4 if k4 else k3)))
        x = a * radial + 2 * p1 * a * b + p2 * (q + 2 * a**2)
        y = b * radial + p1 * (q + 2 * b**2) + 2 * p2 * a * b
        if t1 or t2:
            square, product = a**2 - b**2, 2 * a * b
            x, y = x + t1 * square + t2 * product, y + t2 * square - t1 * product
        return x, y

    def slopes(self, u: npt.ArrayLike, v: npt.ArrayLike) -> tuple[Array, Array]:
        """Return (a, b) = (x / z, y / z) in the camera frame of the rays through raw pixels, any one shape.

        Newton's method on the distortion; the residual is below 1e-12 after a few iterations for such lenses. The
        derivative ignores the trefoil, which is small enough.
        """
        u, v = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
        result = np.empty((2, u.size))
        # In pieces that stay in the processor's cache: a whole image at once takes twice as long.
        for start in range(0, u.size, _PIECE):
            piece = slice(start, start + _PIECE)
            result[:, piece] = self._undistorted(
                (u.reshape(-1)[piece] - self.centre_px[0]) / self.focal_px,
                (v.reshape(-1)[piece] - self.centre_px[1]) / self.focal_px,
            )
        return result[0].reshape(u.shape), result[1].reshape(u.shape)

    def _undistorted(self, target_a: Array, target_b: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3 = self.distortion
        k4 = self.extra[0]
        a, b = target_a.copy(), target_b.copy()
        for _ in range(6):
            q = a**2 + b**2
            radial = 1 + q * (k1 + q * (k2 + q * (k3 + q * k4 if k4 else k3)))
            slope = k1 + q * (2 * k2 + q * (3 * k3 + q * 4 * k4 if k4 else 3 * k3))
            da, db = self._distorted(a, b)
            j_aa = radial + 2 * a**2 * slope + 2 * p1 * b + 6 * p2 * a
            j_bb = radial + 2 * b**2 * slope + 6 * p1 * b + 2 * p2 * a
            j_ab = 2 * a * b * slope + 2 * p1 * a + 2 * p2 * b
            ra, rb = target_a - da, target_b - db
            det = j_aa * j_bb - j_ab**2
            a = a + (j_bb * ra - j_ab * rb) / det
            b = b + (j_aa * rb - j_ab * ra) / det
        return a, b

    def pixel_slopes(self) -> tuple[Array, Array]:
        """Return the slopes of all pixels' rays, (H, W) each; a rotation of the camera does not change them."""
        lens = (self.width, self.height, self.focal_px, self.centre_px, self.distortion, self.extra)
        slopes = _SLOPES.get(lens)
        if slopes is None:
            v, u = np.mgrid[0 : self.height, 0 : self.width].astype(np.float64)
            slopes = self.slopes(u, v)
            while len(_SLOPES) > 1:
                _SLOPES.popitem(last=False)
            _SLOPES[lens] = slopes
        return slopes

    @property
    def position(self) -> Array:
        """(3,) position of the camera in base_link, metres."""
        return self.camera_from_base.inverse().translation


class Rays:
    """The viewing rays of a camera through its pixel centres; they do not change when the panel moves.

    ``lean`` (2, H, W) is the displacement of a ray along x and y of base_link per metre downwards; ``eye`` (3,) is the
    common origin, in metres in base_link.
    """

    def __init__(self, camera: Camera) -> None:
        a, b = camera.pixel_slopes()
        direction = camera.camera_from_base.rotation.T @ np.stack([a.ravel(), b.ravel(), np.ones(a.size)])
        self.camera = camera
        self.eye = camera.position
        self.lean: Array = (direction[:2] / -direction[2]).reshape(2, camera.height, camera.width)
        self.lean.flags.writeable = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoRig:
    """The camera pair, and the rectification of a perfect calibration.

    ``rectified_from_camera`` are the two (3, 3) rotations; ``rectified_focal_px`` keeps the column of every raw pixel
    inside the rectified image.
    """

    left: Camera
    right: Camera
    rectified_from_camera: tuple[Array, Array]
    rectified_focal_px: float
    baseline_m: float

    def rectified_left_from_base(self) -> Transform:
        """Return ``camera_left_optical_frame`` (rectified) from base_link."""
        rotation = self.rectified_from_camera[0]
        return Transform(rotation, np.zeros(3)) @ self.left.camera_from_base

    def calibration(self, side: str) -> dict[str, Any]:
        """Return the calibration of ``left`` or ``right`` in the YAML form of camera_info_manager."""
        index = ("left", "right").index(side)
        camera = (self.left, self.right)[index]
        focal = self.rectified_focal_px
        cx, cy = (camera.width - 1) / 2, (camera.height - 1) / 2
        projection = [[focal, 0.0, cx, -focal * self.baseline_m * index], [0.0, focal, cy, 0.0], [0.0, 0.0, 1.0, 0.0]]
        k = [[camera.focal_px, 0.0, camera.centre_px[0]], [0.0, camera.focal_px, camera.centre_px[1]], [0.0, 0.0, 1.0]]

        def matrix(rows: Any) -> dict[str, Any]:
            values = np.atleast_2d(np.asarray(rows, dtype=np.float64))
            # Processors differ in the last digits. Adding 0.0 turns a negative zero into a positive one.
            data = [round(float(x), _DIGITS) + 0.0 for x in values.ravel()]
            return {"rows": values.shape[0], "cols": values.shape[1], "data": data}

        return {
            "image_width": camera.width,
            "image_height": camera.height,
            "camera_name": f"bench_{side}",
            "camera_matrix": matrix(k),
            "distortion_model": "plumb_bob",
            "distortion_coefficients": matrix(camera.distortion),
            "rectification_matrix": matrix(self.rectified_from_camera[index]),
            "projection_matrix": matrix(projection),
        }


def stereo_rig(config: BenchCameraConfig) -> StereoRig:
    """Mount the two cameras on their bar."""
    # A bar with its line of sight along -z and x to the right, then raised towards -y, rotated about z, and rolled.
    base_from_bar = turn(2, config.azimuth_deg) @ turn(0, config.elevation_deg) @ np.diag([1.0, -1.0, -1.0])
    base_from_bar = base_from_bar @ turn(2, config.roll_deg)
    middle = np.asarray(config.aim_m) - config.distance_m * base_from_bar[:, 2]
    cameras = []
    for index, side in enumerate(("left", "right")):
        inward = turn(1, config.toe_in_deg * (1 - 2 * index))
        error = turn(0, config.skew_deg[0]) @ turn(1, config.skew_deg[1]) @ turn(2, config.skew_deg[2])
        base_from_camera = Transform(
            base_from_bar @ inward @ (error if index else np.eye(3)),
            middle + (index - 0.5) * config.baseline_m * base_from_bar[:, 0],
        )
        cx, cy = config.centre_px[2 * index : 2 * index + 2]
        k1, k2, p1, p2, k3 = config.distortion[5 * index : 5 * index + 5]
        cameras.append(
            Camera(
                name=side,
                width=config.width_px,
                height=config.height_px,
                focal_px=config.focal_px,
                centre_px=(cx, cy),
                distortion=(k1, k2, p1, p2, k3),
                camera_from_base=base_from_camera.inverse(),
            )
        )
    return _rectified(cameras[0], cameras[1], config.baseline_m)


def _rectified(left: Camera, right: Camera, baseline_m: float) -> StereoRig:
    """Rotate both cameras virtually: x axes along the baseline, equal z axes (Fusiello 2000)."""
    axes = [c.camera_from_base.rotation for c in (left, right)]
    x = (right.position - left.position) / np.linalg.norm(right.position - left.position)
    z = axes[0][2] + axes[1][2]
    z = z - (z @ x) * x
    z = z / np.linalg.norm(z)
    rectified_from_base = np.array([x, np.cross(z, x), z])
    rotations = [rectified_from_base @ axis.T for axis in axes]
    widest = 0.0
    for camera, rotation in zip((left, right), rotations):
        v = np.linspace(0, camera.height - 1, 50)
        for u in (0.0, camera.width - 1.0):
            a, b = camera.slopes(np.full_like(v, u), v)
            turned = rotation @ np.array([a, b, np.ones_like(a)])
            widest = max(widest, float(np.abs(turned[0] / turned[2]).max()))
    focal = float(np.floor((left.width - 1) / 2 / widest))
    return StereoRig(
        left=left,
        right=right,
        rectified_from_camera=(rotations[0], rotations[1]),
        rectified_focal_px=focal,
        baseline_m=baseline_m,
    )
