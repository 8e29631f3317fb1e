"""Order of peaks by falling response, compiled by numba."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import called, compiled

Array = npt.NDArray[Any]


@called
def _reading_order(peak: Any) -> float:
    """Return a number that increases with the row of a peak, and within a row with the column."""
    return float(np.floor(np.float64(peak[1]) + 0.5) * 2.0**20 + np.float64(peak[0]))


@compiled
def ranked(peaks: Array, floor: float, limit: int) -> tuple[Array, Array]:
    """Return xy (N, 2) and response (N,) of the ``limit`` strongest peaks (M, 3) above ``floor``, by falling response.

    This is a radix sort over the bits of the responses, which as positive floats sort like integers. Equal responses
    are sorted by row, then column, independently of strips and bands.
    """
    keys, moved = np.empty(len(peaks), np.uint64), np.empty(len(peaks), np.uint64)
    bits, half, last = peaks.view(np.uint32), np.uint64(32), np.uint64(2047)
    count = 0
    for i in range(len(peaks)):  # key: inverted response, then index
        keys[count] = (np.uint64(~bits[i, 2]) << half) | np.uint64(i)
        count += peaks[i, 2] > floor
    first, second, third = np.zeros(2048, np.int32), np.zeros(2048, np.int32), np.zeros(2048, np.int32)
    for i in range(count):
        key = keys[i] >> half
        first[key & last] += 1
        second[(key >> np.uint64(11)) & last] += 1
        third[key >> np.uint64(22)] += 1
    for digit, starts in enumerate((first, second, third)):
        total = 0
        for value in range(2048):
            here = starts[value]
            starts[value] = total
            total += here
        shift = half + np.uint64(11 * digit)
        for i in range(count):
            value = (keys[i] >> shift) & last
            moved[np.uint64(starts[value])] = keys[i]
            starts[value] += 1
        keys, moved = moved, keys
    places = keys[:count].astype(np.uint32)  # the lower half
    kept = min(limit, count)
    start = 0
    while start < kept:
        end, in_order = start + 1, True
        while end < count and keys[end] >> half == keys[start] >> half:
            in_order &= _reading_order(peaks[places[end - 1]]) < _reading_order(peaks[places[end]])
            end += 1
        if not in_order:
            equal = places[start:end].copy()
            order = np.empty(len(equal), np.float64)
            for i in range(len(equal)):
                order[i] = _reading_order(peaks[equal[i]])
            sorted_places = np.argsort(order)
            for i in range(len(equal)):  # setting a slice takes seconds to compile
                places[start + i] = equal[sorted_places[i]]
        start = end
    xy, response = np.empty((kept, 2), np.float32), np.empty(kept, np.float32)
    for i in range(kept):
        j = places[i]
        xy[i, 0], xy[i, 1], response[i] = peaks[j, 0], peaks[j, 1], peaks[j, 2]
    return xy, response
