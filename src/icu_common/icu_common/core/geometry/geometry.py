"""Rigid transforms, planes and rays, with frames in the names: ``a_from_b`` maps points of frame b into frame a."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """A rigid transform ``a_from_b``: ``p_a = rotation @ p_b + translation``.

    Parameters
    ----------
    rotation
        (3, 3) float64, orthonormal with determinant +1.
    translation
        (3,) float64 in metres.

    Raises
    ------
    ValueError
        If the shapes are wrong, a value is not finite, or the matrix is not a rotation.
    """

    rotation: Array
    translation: Array

    def __post_init__(self) -> None:
        rotation = np.asarray(self.rotation, dtype=np.float64)
        translation = np.asarray(self.translation, dtype=np.float64)
        if rotation.shape != (3, 3) or translation.shape != (3,):
            raise ValueError(f"a transform needs (3, 3) and (3,), not {rotation.shape} and {translation.shape}")
        rows = rotation.tolist()
        if not all(map(math.isfinite, (*rows[0], *rows[1], *rows[2], *translation.tolist()))):
            raise ValueError("a transform must be finite")
        if not _is_rotation(*rows):
            raise ValueError(f"not a rotation matrix: {rows}")
        object.__setattr__(self, "rotation", rotation)
        object.__setattr__(self, "translation", translation)

    @classmethod
    def identity(cls) -> Transform:
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(cls, xyzw: npt.ArrayLike, translation: npt.ArrayLike) -> Transform:
        """Build from a quaternion in ROS order (x, y, z, w), which is normalised here.

        Raises
        ------
        ValueError
            If the quaternion has length 0.
        """
        q = np.asarray(xyzw, dtype=np.float64)
        length = float(np.linalg.norm(q))
        if not length > 1e-9:
            raise ValueError(f"quaternion {q.tolist()} has no direction")
        x, y, z, w = q / length
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        return cls(rotation, np.asarray(translation, dtype=np.float64))

    def quaternion(self) -> Array:
        """Return (4,) x, y, z, w with w >= 0 (Shepperd's method: divide by the largest of the four)."""
        r = self.rotation
        candidates = np.array([r[0, 0], r[1, 1], r[2, 2], np.trace(r)])
        i = int(np.argmax(candidates))
        q = np.empty(4)
        if i == 3:
            q[:] = (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + candidates[3])
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            q[i] = 1 + r[i, i] - r[j, j] - r[k, k]
            q[j] = r[j, i] + r[i, j]
            q[k] = r[k, i] + r[i, k]
            q[3] = r[k, j] - r[j, k]
        q /= np.linalg.norm(q)
        return q if q[3] >= 0 else -q

    def apply(self, points: npt.ArrayLike) -> Array:
        """Map points of frame b, (3,) or (N, 3) in metres, into frame a."""
        result: Array = np.asarray(points, dtype=np.float64) @ self.rotation.T + self.translation
        return result

    def inverse(self) -> Transform:
        """Return ``b_from_a``."""
        return Transform(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, other: Transform) -> Transform:
        """Chain ``a_from_b @ b_from_c`` to ``a_from_c``."""
        return Transform(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)


def _is_rotation(x: Sequence[float], y: Sequence[float], z: Sequence[float]) -> bool:
    """Return whether these are the rows of a rotation: unit length, orthogonal, right-handed.

    Uses plain floats: a moving robot makes thousands of transforms a second, each of nine numbers.
    """
    cross = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    return (
        abs(_dot(x, x) - 1.0) <= 1e-6
        and abs(_dot(y, y) - 1.0) <= 1e-6
        and abs(_dot(z, z) - 1.0) <= 1e-6
        and abs(_dot(x, y)) <= 1e-6
        and abs(_dot(y, z)) <= 1e-6
        and abs(_dot(z, x)) <= 1e-6
        and _dot(cross, z) > 0.0
    )


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Points p with ``normal . p = offset``; normal (3,) of unit length, offset in metres, both in one frame."""

    normal: Array
    offset: float

    @classmethod
    def through(cls, point: npt.ArrayLike, normal: npt.ArrayLike) -> Plane:
        """Build from a point (3,) of the plane in metres and a normal (3,) of any length except 0."""
        n = np.asarray(normal, dtype=np.float64)
        n = n / np.linalg.norm(n)
        return cls(n, float(n @ np.asarray(point, dtype=np.float64)))

    def distance(self, points: npt.ArrayLike) -> Array:
        """Signed distance in metres of (N, 3) or (3,) points, positive on the side of the normal."""
        result: Array = np.asarray(points, dtype=np.float64) @ self.normal - self.offset
        return result

    def intersect_ray(self, origin: npt.ArrayLike, direction: npt.ArrayLike) -> Array:
        """Return the (3,) point where the ray from ``origin`` meets the plane.

        Raises
        ------
        ValueError
            If the ray is parallel to the plane or the plane is behind its origin.
        """
        o = np.asarray(origin, dtype=np.float64)
        d = np.asarray(direction, dtype=np.float64)
        slope = float(self.normal @ d)
        if abs(slope) < 1e-9 * float(np.linalg.norm(d)):
            raise ValueError("the ray is parallel to the plane")
        along = (self.offset - float(self.normal @ o)) / slope
        if along <= 0:
            raise ValueError("the plane lies behind the ray's origin")
        return o + along * d


def nearest_rotation(matrix: npt.ArrayLike) -> Array:
    """Return the rotation (3, 3) nearest to ``matrix`` in the Frobenius norm (orthogonal Procrustes)."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    flip = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))])
    result: Array = u @ flip @ vt
    return result


def mean_pose(poses: Collection[Transform]) -> Transform:
    """Return the mean of nearby poses: mean translation, nearest rotation to the mean matrix."""
    rotation = nearest_rotation(np.mean([p.rotation for p in poses], axis=0))
    return Transform(rotation, np.mean([p.translation for p in poses], axis=0))
