"""Pairs of poses, from which Z is eliminated, and other combinations of poses, evenly chosen if there are too many."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from icu_common.core.geometry.geometry import Transform

_MAX_PAIRS = 2000


def relative_motions(a: Sequence[Transform], b: Sequence[Transform]) -> list[tuple[Transform, Transform]]:
    """Return pairs A' X = X B': the motions of the gripper and of the camera between two poses.

    ``a`` is base_from_gripper and ``b`` camera_from_target of each pose.
    """
    # A_i X B_i = A_j X B_j, so (A_j^-1 A_i) X = X (B_j B_i^-1).
    return [
        (a_j.inverse() @ a_i, b_j @ b_i.inverse())
        for (a_i, a_j), (b_i, b_j) in zip(some_pairs(list(a)), some_pairs(list(b)))
    ]


def some_pairs(poses: Sequence[Transform]) -> list[tuple[Transform, Transform]]:
    """Return the pairs of poses, evenly chosen if there are too many."""
    return [(poses[i], poses[j]) for i, j in some_combinations(len(poses), 2, _MAX_PAIRS)]


def some_combinations(count: int, size: int, most: int) -> Iterator[list[int]]:
    """Yield at most ``most`` of the combinations of numbers below ``count``, evenly over their order.

    Each is computed from its position in the order: thousands of poses have billions of triples.
    """
    total = math.comb(count, size)
    for place in range(0, total, max(1, -(-total // most))):
        chosen: list[int] = []
        # Number of following combinations; of those that start later there are comb(later numbers, size).
        behind = total - 1 - place
        for left in range(size, 0, -1):
            later = _most_below(behind, left)
            behind -= math.comb(later, left)
            chosen.append(count - 1 - later)
        yield chosen


def _most_below(value: int, size: int) -> int:
    """Return the largest n with comb(n, size) <= value."""
    low, high = 0, size
    while math.comb(high, size) <= value:
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if math.comb(middle, size) <= value else (low, middle)
    return low
