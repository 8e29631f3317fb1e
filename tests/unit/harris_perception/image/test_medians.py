"""The quick median is numpy's, bit by bit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from harris_perception.core.image.medians import median

SEED = 7


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.uint8, np.int32])
@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (8,), (101,), (1000,), (13, 6), (14, 6, 1)])
def test_it_is_numpys_median(kind: Any, shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(SEED)
    for _ in range(20):
        values = (rng.random(shape) * 255).astype(kind)
        assert median(values) == float(np.median(values)), values
    assert median(np.full(shape, 200, np.uint8)) == 200.0, "two bytes add up to more than a byte"
    assert median(values[::-1]) == float(np.median(values))


def test_of_nothing_it_is_no_number() -> None:
    assert math.isnan(median(np.empty(0)))
