"""Joint refinement of X and Z over all poses, and the residuals of A X B = Z."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from harris_perception.core.wrist.rotation_vectors import rotation_of, rotation_vectors
from icu_common.core.geometry.geometry import Array, Transform, nearest_rotation


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class WristCamera:
    """A calibration.

    Attributes
    ----------
    gripper_from_camera, base_from_target
        X and Z.
    start
        The closed form at which the refinement started.
    rotation_rms_rad, translation_rms_m
        Misfit of the poses used, per degree of freedom.
    covariance
        (12, 12) of small rotations (rad) and translations (m): X's rotation and translation in its own frame, then Z's.
    used
        (N,) bool, poses used.
    """

    gripper_from_camera: Transform
    base_from_target: Transform
    start: str
    rotation_rms_rad: float
    translation_rms_m: float
    covariance: Array
    used: npt.NDArray[np.bool_]

    def sigmas(self) -> tuple[float, float]:
        """Return the standard deviations of X's rotation (rad) and translation (m), over all axes together."""
        variance = np.diag(self.covariance)
        return float(np.sqrt(variance[:3].sum())), float(np.sqrt(variance[3:6].sum()))


def refined(
    a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform, start: str, used: npt.NDArray[np.bool_]
) -> tuple[WristCamera, Array]:
    """Refine X and Z jointly, by Gauss-Newton with weights from the residuals; also return (2,) the noise of both."""
    count = len(a)
    freedom = np.full(2, 3.0 * count - 6.0)  # of rotations, and of translations

    def noise_of(error: Array) -> Array:
        noise = _rms(error, freedom)
        if count == 3:
            noise = lever * np.sqrt(np.mean((noise / lever) ** 2))
        return np.asarray(np.maximum(noise, 1e-12))

    lever = np.array([1.0, np.sqrt(np.mean([q.translation @ q.translation for q in b])) + 1e-9])
    normal = np.eye(12)
    for turn in range(60):
        error = residuals(a, b, x, z)
        # Rotations and translations have different noise, estimated from the residuals. Some rotations fit three
        # translations exactly, which then seem to be without noise: their noise is set to that of the rotations at the
        # target's distance.
        weight = 1 / noise_of(error) ** 2
        slope = _slopes(a, b, x, z, error).reshape(count, 2, 3, 12)
        parts = weight[:, None, None] * np.einsum("nkis,nkit->kst", slope, slope)
        normal = parts.sum(axis=0)
        pull = np.einsum("k,nkis,nki->s", weight, slope, error.reshape(count, 2, 3))
        step = -np.linalg.solve(normal, pull)
        x, z = _moved(x, step[:6]), _moved(z, step[6:])
        # Each kind loses as many degrees of freedom as unknowns it determines: a few translations fit with any suitable
        # rotation.
        if count > 3:
            freedom = np.maximum(3 * count - np.trace(np.linalg.solve(normal, parts), axis1=1, axis2=2), 1e-3)
        if turn > 2 and np.abs(step).max() < 1e-10:
            break
    error = residuals(a, b, x, z)
    rotation_rms, translation_rms = _rms(error, freedom)
    result = WristCamera(
        gripper_from_camera=x,
        base_from_target=z,
        start=start,
        rotation_rms_rad=float(rotation_rms),
        translation_rms_m=float(translation_rms),
        covariance=np.asarray(np.linalg.inv(normal)),
        used=used,
    )
    return result, np.maximum(noise_of(error), 1e-9)


def _rms(error: Array, freedom: Array) -> Array:
    """Return (2,) rms rotation (rad) and translation (m) of residuals (6 N,), per degree of freedom (2,)."""
    return np.asarray(np.sqrt(np.sum(error.reshape(-1, 2, 3) ** 2, axis=(0, 2)) / freedom))


def residuals(a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform) -> Array:
    """Return (6 N,): rotation (rad) and translation (m) from A X B to Z, in the target's frame."""
    turns_a, shifts_a = np.array([p.rotation for p in a]), np.array([p.translation for p in a])
    turns_b, shifts_b = np.array([q.rotation for q in b]), np.array([q.translation for q in b])
    turns = z.rotation.T @ turns_a @ x.rotation @ turns_b
    ends = (turns_a @ x.apply(shifts_b)[:, :, None])[:, :, 0] + shifts_a
    return np.hstack([rotation_vectors(turns), (ends - z.translation) @ z.rotation]).ravel()


def squared_error(a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform) -> float:
    """Return the sum of the squared residuals."""
    return float(np.sum(residuals(a, b, x, z) ** 2))


def misfit(a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform) -> Array:
    """Return (N, 2): rotation (rad) and translation (m) between each pose and Z."""
    return np.asarray(np.linalg.norm(residuals(a, b, x, z).reshape(-1, 2, 3), axis=2))


def _slopes(a: Sequence[Transform], b: Sequence[Transform], x: Transform, z: Transform, error: Array) -> Array:
    size = 1e-6
    columns = []
    for k in range(12):
        step = np.zeros(12)
        step[k] = size
        columns.append((residuals(a, b, _moved(x, step[:6]), _moved(z, step[6:])) - error) / size)
    return np.column_stack(columns)


def _moved(transform: Transform, step: Array) -> Transform:
    return Transform(
        nearest_rotation(transform.rotation @ rotation_of(step[:3])),
        transform.translation + transform.rotation @ step[3:],
    )
