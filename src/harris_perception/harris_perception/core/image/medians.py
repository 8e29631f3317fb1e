"""Median of few values: the same result as numpy's in a third of the time."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def median(values: npt.NDArray[Any]) -> float:
    """Return the median of all values of an array of any shape, NaN if it is empty; no value may be NaN.

    For a thousand values ``np.median`` spends more time on checking its arguments than on finding the median.
    """
    flat = values.ravel()
    count = flat.size
    if not count:
        return float("nan")
    middle = count // 2
    if count % 2:
        return float(np.partition(flat, middle)[middle])
    below, above = np.partition(flat, (middle - 1, middle))[middle - 1 : middle + 1]
    if flat.dtype.kind != "f":  # the sum of two bytes may overflow
        return (float(below) + float(above)) / 2
    return float((below + above) / 2)
