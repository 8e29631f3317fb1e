"""Starts of the refinement: a closed form, or its rotation by 180 degrees where the poses leave that open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harris_perception.core.wrist.closed_forms import closed_form, translation_for
from harris_perception.core.wrist.rotation_vectors import rotation_vectors
from harris_perception.core.wrist.wrist_refinement import squared_error
from icu_common.core.geometry.geometry import Array, Transform, mean_pose, nearest_rotation

_TOLD_RAD = 0.3
"""Minimum median rotation that contradicts a calibration rotated by 180 degrees; that calibration is then not tried."""


def half_turns(pairs: Sequence[tuple[Transform, Transform]]) -> list[Array]:
    """Return the rotations D by 180 degrees (3, 3), in the gripper, that most motions leave open: D X or X.

    A motion's rotation A' distinguishes them by the angle between D^-1 A' D and A'. It is zero for a rotation about D's
    axis v, and for one by 180 degrees about a perpendicular axis.
    """
    turns = np.array([a.rotation for a, _ in pairs])
    # v is a principal axis of such rotations. With unequal weights, no two axes share an eigenvalue by symmetry.
    axes = np.linalg.svd(rotation_vectors(turns) * np.arange(1, len(turns) + 1)[:, None], full_matrices=False)[2]
    # D^-1 A' D differs from A' by a rotation of 2 arccos |v . A' v|.
    told = 2 * np.arccos(np.minimum(np.abs(np.einsum("vi,nij,vj->vn", axes, turns, axes)), 1.0))
    return [2 * np.outer(v, v) - np.eye(3) for v in axes[np.median(told, axis=1) < _TOLD_RAD]]


def half_turned(
    x: Transform,
    a: Sequence[Transform],
    b: Sequence[Transform],
    pairs: Sequence[tuple[Transform, Transform]],
    halves: Sequence[Array],
) -> list[tuple[Transform, Transform]]:
    """Return X rotated by each of ``halves``, with the matching translation, and Z."""
    xs = [Transform(r, translation_for(pairs, r)) for r in (nearest_rotation(half @ x.rotation) for half in halves)]
    return [(x, _mean_target(a, b, x)) for x in xs]


def best_start(
    method: str,
    a: Sequence[Transform],
    b: Sequence[Transform],
    pairs: Sequence[tuple[Transform, Transform]],
    halves: Sequence[Array],
) -> tuple[float, Transform, Transform]:
    """Return the squared error, X and Z of the closed form or, if better, of the form turned by one of ``halves``."""
    x = closed_form(method, pairs)
    found = [(x, _mean_target(a, b, x)), *half_turned(x, a, b, pairs, halves)]
    return min(((squared_error(a, b, x, z), x, z) for x, z in found), key=lambda start: start[0])


def _mean_target(a: Sequence[Transform], b: Sequence[Transform], x: Transform) -> Transform:
    return mean_pose([p @ x @ q for p, q in zip(a, b)])
