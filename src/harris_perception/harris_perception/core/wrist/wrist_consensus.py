"""Poses that agree with one another: least median of squares over triples, and those that fit a calibration."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.wrist.pose_pairs import relative_motions, some_combinations
from harris_perception.core.wrist.wrist_motion import WristConfig, check_turns
from harris_perception.core.wrist.wrist_refinement import WristCamera, misfit
from harris_perception.core.wrist.wrist_starts import best_start, half_turns
from icu_common.core.geometry.geometry import Array, Transform

_SUBSETS = 100
"""Number of triples of poses that are tried: if three of ten poses are wrong, a third of the triples is right."""


def consistent_poses(
    a: list[Transform], b: list[Transform], config: WristConfig
) -> tuple[npt.NDArray[np.bool_], list[tuple[str, Transform, Transform]]]:
    """Return the poses that agree with the best of many triples, and its method, X and Z.

    A mean would hide wrong poses that agree with one another.

    This is least median of squares, as in :mod:`harris_perception.core.hand_eye.robust_regression`. Rotations and
    translations have no common unit, so the product of both medians counts.
    """
    best, used = np.inf, np.ones(len(a), dtype=bool)
    found: list[tuple[str, Transform, Transform]] = []
    # Any three poses nearly fit themselves, so the median of five would be one of them, and right poses would stand
    # out.
    keep = (len(a) + 4) // 2
    for triple in some_combinations(len(a), 3, _SUBSETS):
        some_a, some_b = [a[i] for i in triple], [b[i] for i in triple]
        try:
            check_turns(some_a, config)
        except DegenerateError:
            continue
        pairs = relative_motions(some_a, some_b)
        _, x, z = best_start("park", some_a, some_b, pairs, half_turns(pairs))
        size = misfit(a, b, x, z)
        middle = np.maximum(np.sort(size, axis=0)[keep - 1], 1e-9)
        if (product := float(np.prod(middle))) < best:
            best, used = product, _near(size, middle * (1 + 5 / max(1, len(a) - 3)), config)
            found = [("park", x, z)]
    return used, found


def fitting_poses(
    a: list[Transform], b: list[Transform], result: WristCamera, config: WristConfig
) -> npt.NDArray[np.bool_]:
    """Return the poses (N,) bool that fit a calibration."""
    size = misfit(a, b, result.gripper_from_camera, result.base_from_target)
    return _near(size, np.median(size, axis=0), config)


def _near(size: Array, middle: Array, config: WristConfig) -> npt.NDArray[np.bool_]:
    # The median length of a three-dimensional normal variable is 1.538 times its standard deviation.
    sigma = np.maximum(middle / 1.538, 1e-9)
    return np.asarray((size <= config.outlier_sigmas * 1.5 * sigma).all(axis=1))
