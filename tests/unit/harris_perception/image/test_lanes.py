"""Comparisons by eight against numpy's, one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from numba import njit
from numba.core.errors import TypingError

from harris_perception.core.image import lanes


@njit
def compared(one: Any, other: Any, value: Any, first: int, second: int) -> Any:
    return (
        lanes.exceed(one, first, other, second),
        lanes.reach(one, first, other, second),
        lanes.reach_in_magnitude(one, first, other, second),
        lanes.above(one, first, value),
        lanes.below(one, first, value),
    )


@njit
def compared_with_chosen(choice: Any, one: Any, other: Any, than: Any, places: Any) -> Any:
    first, second, third = places
    return (
        lanes.chosen_exceed(choice, one, first, other, second, than, third),
        lanes.chosen_reach(choice, one, first, other, second, than, third),
    )


def bits(holds: npt.NDArray[np.bool_]) -> int:
    return sum(1 << i for i, it in enumerate(holds) if it)


@pytest.mark.parametrize("dtype", [np.int16, np.float32])
def test_every_bit_is_the_comparison_of_its_elements(dtype: Any) -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        one, other = rng.integers(-3, 4, (2, 24)).astype(dtype)
        if dtype is np.float32:
            one[rng.integers(24)] = other[rng.integers(24)] = np.nan
            one[rng.integers(24)] = rng.choice([np.inf, -np.inf, -0.0])
        value = dtype(rng.integers(-3, 4))
        first, second = (int(place) for place in rng.integers(0, 17, 2))
        a, b = one[first : first + 8], other[second : second + 8]
        expected = [a > b, a >= b, abs(a) >= abs(b), a > value, a < value]
        assert list(compared(one, other, value, first, second)) == [bits(holds) for holds in expected]


@pytest.mark.parametrize("dtype", [np.int16, np.float32])
def test_each_bit_chooses_which_element_is_compared(dtype: Any) -> None:
    rng = np.random.default_rng(4)
    for _ in range(300):
        one, other, than = rng.integers(-3, 4, (3, 24)).astype(dtype)
        if dtype is np.float32:
            one[rng.integers(24)] = other[rng.integers(24)] = than[rng.integers(24)] = np.nan
        places = tuple(int(place) for place in rng.integers(0, 17, 3))
        a, b, c = (row[place : place + 8] for row, place in zip((one, other, than), places, strict=True))
        choice = rng.integers(0, 2, 8).astype(bool)
        chosen = np.where(choice, a, b)
        found = compared_with_chosen(np.uint8(bits(choice)), one, other, than, places)
        assert list(found) == [bits(chosen > c), bits(chosen >= c)]


def test_elements_that_do_not_lie_side_by_side_are_refused() -> None:
    apart = np.zeros(48, np.float32)[::2]
    with pytest.raises(TypingError, match="eight elements side by side are compared"):
        compared(apart, apart, np.float32(0.0), 0, 0)
    with pytest.raises(TypingError, match="eight elements side by side are compared"):
        compared_with_chosen(np.uint8(0), apart, apart, apart, (0, 0, 0))
