"""Pinhole camera with plumb-bob distortion and rectification, as in sensor_msgs/CameraInfo (REP-104).

Raw pixels are those of ``image_raw``. Rectified coordinates are those after the rotation R, where the rows of a
stereo pair are aligned. Three-dimensional points are in the rectified frame of the camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from icu_common.core.configuration.yaml_text import UNREADABLE, Loader
from icu_common.core.geometry.geometry import Array

_STANDS_STILL = 1e-4
"""Convergence limit as the tangent of a ray's angle; about a tenth of a pixel."""

_FREE, _NOTHING = np.nan, 1e-6
_FORMS = (
    ("k", ((_FREE, _FREE, _FREE), (0, _FREE, _FREE), (0, 0, 1)), "[[fx, skew, cx], [0, fy, cy], [0, 0, 1]]"),
    (
        "p",
        ((_FREE, 0, _FREE, _FREE), (0, _FREE, _FREE, 0), (0, 0, 1, 0)),
        "[[fx, 0, cx, tx], [0, fy, cy, 0], [0, 0, 1, 0]]",
    ),
)
"""Required forms of the matrices; other values would be ignored silently."""

_MOST_PX = 32_767
"""Maximum number of rows or columns of an image in OpenCV."""
_AT_A_TIME = 8192
"""Number of pixels that stay in the cache while their distortion is inverted."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraModel:
    """One calibrated camera.

    Parameters
    ----------
    name
        The camera's name, as in the calibration file.
    width, height
        Size of the raw image in pixels.
    k
        (3, 3) intrinsic matrix of the raw image, pixels.
    d
        (5,) plumb-bob distortion k1, k2, p1, p2, k3.
    r
        (3, 3) rotation rectified_from_raw.
    p
        (3, 4) projection of the rectified image; ``p[0, 3] = -fx * baseline`` for the right camera of a pair.

    Raises
    ------
    ValueError
        If the size or a shape is wrong, a value is not finite, or a focal length is not above 0. Also if ``r`` is no
        rotation, or ``k`` or ``p`` (which has no skew) is not a pinhole's.
    """

    name: str
    width: int
    height: int
    k: Array
    d: Array
    r: Array
    p: Array

    def __post_init__(self) -> None:
        if not (0 < self.width <= _MOST_PX and 0 < self.height <= _MOST_PX):
            raise ValueError(
                f"camera {self.name}: pictures of {self.width} x {self.height} px; expected 1 to {_MOST_PX} each way"
            )
        for field_name, shape in (("k", (3, 3)), ("d", (5,)), ("r", (3, 3)), ("p", (3, 4))):
            value = np.asarray(getattr(self, field_name), dtype=np.float64)
            if value.shape != shape:
                raise ValueError(f"camera {self.name}: {field_name} has shape {value.shape}; expected {shape}")
            if not np.isfinite(value).all():
                raise ValueError(f"camera {self.name}: {field_name} is not finite")
            object.__setattr__(self, field_name, value)
        if not (self.k[0, 0] > 0 and self.k[1, 1] > 0):
            raise ValueError(f"camera {self.name} is not calibrated: focal length {self.k[0, 0]}, {self.k[1, 1]}")
        if np.abs(self.r @ self.r.T - np.eye(3)).max() > 1e-3 or np.linalg.det(self.r) < 0:
            raise ValueError(f"camera {self.name}: r {self.r.tolist()} is not a rotation; of a single camera it is 1")
        if not (self.p[0, 0] > 0 and self.p[1, 1] > 0):
            raise ValueError(f"camera {self.name}: p has focal length {self.p[0, 0]}, {self.p[1, 1]}; expected above 0")
        for field_name, fixed, form in _FORMS:
            value = getattr(self, field_name)
            if np.nanmax(np.abs(value - fixed)) > _NOTHING:
                raise ValueError(f"camera {self.name}: {field_name} is {value.tolist()}; expected {form}")

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.width, self.height

    def rectify(self, raw_px: npt.ArrayLike) -> Array:
        """Map raw pixels (N, 2) to rectified pixels (N, 2); NaN where the distortion has no ray for a pixel.

        That happens in the image corners if the polynomial turns back before it reaches them.
        """
        xy = self._undistort(np.asarray(raw_px, dtype=np.float64).reshape(-1, 2))
        turned = np.column_stack([xy, np.ones(len(xy))]) @ self.r.T @ self.p[:, :3].T
        return np.asarray(turned[:, :2] / turned[:, 2:])

    def _undistort(self, raw_px: Array) -> Array:
        v = (raw_px[:, 1] - self.k[1, 2]) / self.k[1, 1]
        u = (raw_px[:, 0] - self.k[0, 2]) / self.k[0, 0] - self.k[0, 1] / self.k[0, 0] * v
        xy = np.empty((len(raw_px), 2))
        for first in range(0, len(xy), _AT_A_TIME):
            part = slice(first, first + _AT_A_TIME)
            xy[part, 0], xy[part, 1] = self._inverted(u[part], v[part])
        return xy

    def _inverted(self, u: Array, v: Array) -> tuple[Array, Array]:
        # Fixed-point inversion of the distortion, iterated until it converges: OpenCV's default of five iterations
        # leaves 0.01 px in the image corners, and its two major versions name the longer form differently.
        x, y = u, v
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(50):
                du, dv = self._distort(x, y)
                du, dv = u - du, v - dv
                x, y = x + du, y + dv
                step = np.maximum(np.abs(du), np.abs(dv))
                if np.fmax.reduce(step, initial=0.0) < 1e-12:  # NaN counts as no step
                    break
            lost = ~(step < _STANDS_STILL)
        x[lost] = y[lost] = np.nan
        return x, y

    def _distort(self, a: Array, b: Array) -> tuple[Array, Array]:
        k1, k2, p1, p2, k3 = self.d.tolist()
        aa, bb, ab = a * a, b * b, 2 * a * b
        r2 = aa + bb
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return a * radial + p1 * ab + p2 * (r2 + 2 * aa), b * radial + p1 * (r2 + 2 * bb) + p2 * ab

    def rays(self, raw_px: npt.ArrayLike) -> Array:
        """Return (N, 3) directions with z = 1, in the rectified frame, for raw pixels (N, 2)."""
        uv = self.rectify(raw_px)
        x = (uv[:, 0] - self.p[0, 2]) / self.p[0, 0]
        y = (uv[:, 1] - self.p[1, 2]) / self.p[1, 1]
        return np.column_stack([x, y, np.ones(len(x))])

    def project(self, points: npt.ArrayLike) -> Array:
        """Project (N, 3) points in metres, in this camera's rectified frame, to raw pixels (N, 2).

        Points behind the camera give NaN.
        """
        xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3) @ self.r
        x, y, z = xyz.T
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = np.where(z > 0, x / z, np.nan), np.where(z > 0, y / z, np.nan)
        u, v = self._distort(a, b)
        return np.column_stack([self.k[0, 0] * u + self.k[0, 1] * v + self.k[0, 2], self.k[1, 1] * v + self.k[1, 2]])

    def rectification_maps(self, size: tuple[int, int] | None = None) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return the two maps with which ``cv2.remap`` rectifies the raw image.

        It has the raw image's size, or ``size`` (width, height), as the other camera may have another sensor.
        """
        slant = np.float32(self.k[0, 1] / self.k[1, 1])
        kind = cv2.CV_32FC1 if slant else cv2.CV_16SC2
        maps = cv2.initUndistortRectifyMap(self.k, self.d, self.r, self.p[:, :3], size or self.size, kind)
        if slant:  # OpenCV ignores it
            u, v = maps
            maps = cv2.convertMaps(u + slant * (v - np.float32(self.k[1, 2])), v, cv2.CV_16SC2)
        return np.asarray(maps[0]), np.asarray(maps[1])

    @classmethod
    def load(cls, path: Path) -> CameraModel:
        """Read the YAML form that ROS's camera_info_manager and camera_calibration write.

        Raises
        ------
        ValueError
            If it is not YAML, lacks a key, a matrix has the wrong size, or the distortion model is not plumb_bob.
        """
        try:
            return cls.from_mapping(yaml.load(path.read_text(encoding="utf-8"), Loader))
        except (KeyError, TypeError, ValueError, OverflowError, *UNREADABLE) as error:
            raise ValueError(f"{path}: not a camera calibration: {error!r}") from error

    @classmethod
    def from_mapping(cls, document: Mapping[str, Any]) -> CameraModel:
        """Build from the document that :meth:`load` reads.

        Raises
        ------
        KeyError, TypeError, ValueError
            If a key is missing, or its value has another type or size, or is wrong.
        """
        model = document["distortion_model"]
        if model != "plumb_bob":
            raise ValueError(f"distortion_model {model!r}: only plumb_bob is known")

        def matrix(key: str, rows: int, columns: int) -> Array:
            part = document[key]
            given = part.get("data") if isinstance(part, Mapping) else part
            try:
                data = np.asarray(given if isinstance(part, Mapping) else (), dtype=np.float64)
            except (TypeError, ValueError):
                data = np.empty(0)
            if data.size != rows * columns:
                raise ValueError(f"{key} = {given!r}; expected {rows * columns} numbers")
            return data.reshape(rows, columns)

        def pixels(key: str) -> int:
            given = document[key]
            if isinstance(given, bool) or not isinstance(given, int | float) or given not in range(1, _MOST_PX + 1):
                raise ValueError(f"{key} = {given!r}; expected a whole number from 1 to {_MOST_PX}")
            return int(given)

        return cls(
            name=str(document["camera_name"]),
            width=pixels("image_width"),
            height=pixels("image_height"),
            k=matrix("camera_matrix", 3, 3),
            d=matrix("distortion_coefficients", 1, 5)[0],
            r=matrix("rectification_matrix", 3, 3),
            p=matrix("projection_matrix", 3, 4),
        )

    def to_mapping(self) -> dict[str, Any]:
        """Return the document that :meth:`load` reads."""

        def matrix(value: Array) -> dict[str, Any]:
            rows = np.atleast_2d(value)
            return {"rows": rows.shape[0], "cols": rows.shape[1], "data": [float(x) for x in rows.ravel()]}

        return {
            "image_width": self.width,
            "image_height": self.height,
            "camera_name": self.name,
            "camera_matrix": matrix(self.k),
            "distortion_model": "plumb_bob",
            "distortion_coefficients": matrix(self.d),
            "rectification_matrix": matrix(self.r),
            "projection_matrix": matrix(self.p),
        }


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StereoModel:
    """A calibrated pair; points are in the left camera's rectified frame.

    Raises
    ------
    ValueError
        If the projections do not belong to one rectified pair (focal lengths or rows differ, no baseline, or the left
        camera is not the origin).
    """

    left: CameraModel
    right: CameraModel

    def __post_init__(self) -> None:
        if abs(self.left.p[0, 0] - self.right.p[0, 0]) > 1e-6 * self.left.p[0, 0]:
            raise ValueError(f"focal lengths differ: {self.left.p[0, 0]} and {self.right.p[0, 0]} px")
        rows = [model.p[1, 1:3].tolist() for model in (self.left, self.right)]
        if np.abs(np.subtract(*rows)).max() > 0.01:
            raise ValueError(f"rows differ: fy and cy of P are {rows[0]} left and {rows[1]} px right")
        if abs(self.left.p[0, 3]) > _NOTHING:
            raise ValueError(f"left camera's P[0, 3] is {self.left.p[0, 3]}; expected 0: points are in its frame")
        if not self.baseline > 0:
            raise ValueError(f"baseline {self.baseline} m: the right camera's P[0, 3] must be negative")

    @property
    def focal_px(self) -> float:
        return float(self.left.p[0, 0])

    @property
    def baseline(self) -> float:
        """Distance between the cameras in metres."""
        return float(-self.right.p[0, 3] / self.right.p[0, 0])

    def triangulate(self, left_rectified_px: npt.ArrayLike, right_rectified_px: npt.ArrayLike) -> Array:
        """Return (N, 3) points in metres from rectified pixels (N, 2) of both images.

        Depth is ``focal * baseline / disparity``; a disparity that is not positive gives NaN. The row is the mean of
        the rows of both images.
        """
        left = np.asarray(left_rectified_px, dtype=np.float64).reshape(-1, 2)
        right = np.asarray(right_rectified_px, dtype=np.float64).reshape(-1, 2)
        disparity = (left[:, 0] - self.left.p[0, 2]) - (right[:, 0] - self.right.p[0, 2])
        with np.errstate(divide="ignore"):
            z = np.where(disparity > 0, self.focal_px * self.baseline / disparity, np.nan)
        x = (left[:, 0] - self.left.p[0, 2]) / self.left.p[0, 0] * z
        row = 0.5 * ((left[:, 1] - self.left.p[1, 2]) + (right[:, 1] - self.right.p[1, 2]))
        return np.column_stack([x, row / self.left.p[1, 1] * z, z])

    def project_right(self, points: npt.ArrayLike) -> Array:
        """Project (N, 3) points of the left rectified frame to raw pixels (N, 2) of the right image."""
        shifted = np.asarray(points, dtype=np.float64).reshape(-1, 3) - np.array([self.baseline, 0.0, 0.0])
        return self.right.project(shifted)
