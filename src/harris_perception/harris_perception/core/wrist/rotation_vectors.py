"""Rotation vectors (axis times angle) of rotation matrices, and the reverse."""

from __future__ import annotations

import numpy as np

from icu_common.core.geometry.geometry import Array


def rotation_vectors(rotations: Array) -> Array:
    """Return the rotation vectors (N, 3) rad of matrices (N, 3, 3)."""
    r = rotations
    # Four times q q^T of each quaternion x, y, z, w; the row with the largest diagonal is divided by no small number.
    products = np.empty((len(r), 4, 4))
    products[:, :3, :3] = r + r.transpose(0, 2, 1)
    trace = np.trace(r, axis1=1, axis2=2)
    for i in range(3):
        products[:, i, i] += 1 - trace
        j, k = (i + 1) % 3, (i + 2) % 3
        products[:, i, 3] = products[:, 3, i] = r[:, k, j] - r[:, j, k]
    products[:, 3, 3] = 1 + trace
    best = np.argmax(np.diagonal(products, axis1=1, axis2=2), axis=1)
    q = products[np.arange(len(r)), best]
    q *= np.where(q[:, 3:] < 0, -1.0, 1.0) / np.linalg.norm(q, axis=1, keepdims=True)
    sine = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
    return np.asarray(q[:, :3] * np.where(sine > 1e-12, 2 * np.arctan2(sine, q[:, 3:]) / np.maximum(sine, 1e-12), 2.0))


def rotation_of(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) rad."""
    angle = float(np.linalg.norm(vector))
    k = cross_matrix(vector)
    if angle < 1e-12:
        return np.asarray(np.eye(3) + k)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * k + (1 - np.cos(angle)) / angle**2 * (k @ k))


def cross_matrix(v: Array) -> Array:
    """Return (3, 3) M with M p = v x p."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
