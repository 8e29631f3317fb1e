"""Closed forms of AX = XB: by Park and Martin, by Horaud and Dornaika, and by Daniilidis (see ``wrist_camera``)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harris_perception.core.wrist.rotation_vectors import cross_matrix, rotation_vectors
from icu_common.core.geometry.geometry import Array, Transform, nearest_rotation

METHODS = ("park", "horaud", "daniilidis")


def closed_form(method: str, pairs: Sequence[tuple[Transform, Transform]]) -> Transform:
    """Return gripper_from_camera by one of ``METHODS``, unrefined, from the pairs of ``relative_motions``."""
    if method == "daniilidis":
        return _daniilidis(pairs)
    rotation = _park(pairs) if method == "park" else _horaud(pairs)
    return Transform(rotation, translation_for(pairs, rotation))


def _park(pairs: Sequence[tuple[Transform, Transform]]) -> Array:
    turns_a, turns_b = (rotation_vectors(np.array([pair[k].rotation for pair in pairs])) for k in (0, 1))
    return nearest_rotation(turns_a.T @ turns_b)  # (M^T M)^-1/2 M^T of the paper, by singular values


def _horaud(pairs: Sequence[tuple[Transform, Transform]]) -> Array:
    total = np.zeros((4, 4))
    for a, b in pairs:
        difference = _left(_quaternion(a)) - _right(_quaternion(b))
        total += difference.T @ difference
    w, x, y, z = np.linalg.eigh(total)[1][:, 0]
    return Transform.from_quaternion((x, y, z, w), np.zeros(3)).rotation


def translation_for(pairs: Sequence[tuple[Transform, Transform]], rotation: Array) -> Array:
    """Return gripper_from_camera's translation (3,) m for its rotation (3, 3), by least squares."""
    matrix = np.vstack([a.rotation - np.eye(3) for a, _ in pairs])
    right = np.concatenate([rotation @ b.translation - a.translation for a, b in pairs])
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def _daniilidis(pairs: Sequence[tuple[Transform, Transform]]) -> Transform:
    rows = []
    for a, b in pairs:
        (qa, da), (qb, db) = _dual(a), _dual(b)
        top = np.hstack([(qa - qb)[1:, None], cross_matrix((qa + qb)[1:]), np.zeros((3, 4))])
        low = np.hstack(
            [(da - db)[1:, None], cross_matrix((da + db)[1:]), (qa - qb)[1:, None], cross_matrix((qa + qb)[1:])]
        )
        rows += [top, low]
    # Only the right singular vectors count. The left ones of 2000 pairs would be 12000 x 12000.
    v = np.linalg.svd(np.linalg.qr(np.vstack(rows), mode="r"))[2]
    (u1, v1), (u2, v2) = ((v[k][:4], v[k][4:]) for k in (6, 7))
    # q = l1 u1 + l2 u2 with |q| = 1 and q . d = 0: a quadratic in l1 / l2.
    roots = np.roots([u1 @ v1, u1 @ v2 + u2 @ v1, u2 @ v2]) if abs(u1 @ v1) > 1e-15 else np.zeros(1)
    best, scale = 0.0, 0.0
    for s in roots.real:
        length = float(s * s * (u1 @ u1) + 2 * s * (u1 @ u2) + u2 @ u2)
        if length > scale:
            best, scale = float(s), length
    q = (best * u1 + u2) / np.sqrt(scale)
    d = (best * v1 + v2) / np.sqrt(scale)
    return Transform.from_quaternion((*q[1:], q[0]), 2 * (_right(_conjugate(q)) @ d)[1:])


def _quaternion(transform: Transform) -> Array:
    """Return (4,) w, x, y, z with w >= 0; AX = XB gives A and B the same w, so the signs agree."""
    return np.roll(transform.quaternion(), 1)


def _dual(transform: Transform) -> tuple[Array, Array]:
    q = _quaternion(transform)
    return q, 0.5 * _left(np.array([0.0, *transform.translation])) @ q


def _left(q: Array) -> Array:
    """Return (4, 4) L(q) with L(q) p = q p; quaternions are w, x, y, z."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])


def _right(q: Array) -> Array:
    """Return (4, 4) R(q) with R(q) p = p q."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]])


def _conjugate(q: Array) -> Array:
    return q * (1.0, -1.0, -1.0, -1.0)
