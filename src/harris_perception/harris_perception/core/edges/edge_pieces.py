"""Hysteresis: keeps connected pieces that contain a strong pixel and are large enough; compiled by numba.

Pieces grow in bitmaps (see bitmap.py) by words of 64 pixels, because most pixels of an edge are adjacent in a word or
in the word of the next row.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.bitmap import MARGIN, lowest, ones
from harris_perception.core.image.compiled import called, inlined

Array = npt.NDArray[Any]

_ONE, _LAST = np.uint64(1), np.uint64(63)
_OUTERMOST = _ONE | (_ONE << _LAST)


@inlined
def _grown(bits: Any, row: int, seed: int, found: Any, places: Any, reached: Any, count: int) -> tuple[int, int]:
    """Clear the piece that contains the pixels ``found`` of word ``seed``; return the new ``count`` and its size.

    Its words are stored after the first ``count`` of ``places`` and ``reached``. Pending words are stacked at the end
    of these arrays, as ``~place`` if they grow upwards. The two parts never meet, because their pixels differ.
    """
    line, size, end = np.uint64(row), 0, len(places)
    waiting, here, step = end, np.uint64(seed), line
    while True:
        while found:  # next row at once: its word can be read before this one is done
            free = bits[here] | found
            found |= free & ~(free + found)  # upwards by the carry of a sum, downwards step by step
            more = free & (found >> _ONE) & ~found
            while more:
                found |= more
                more = free & (more >> _ONE)
            bits[here] = free & ~found
            at = np.uint64(count)
            places[at], reached[at] = here, found
            count += 1
            size += ones(found)
            wide = found | (found << _ONE) | (found >> _ONE)
            back = here - step
            more = wide & bits[back]
            if more:
                bits[back] &= ~more
                waiting -= 1
                at = np.uint64(waiting)
                places[at], reached[at] = ~back if step == line else back, more
            if found & _OUTERMOST:
                for side in range(2):
                    there = found >> _LAST if side else (found & _ONE) << _LAST
                    beside = here + np.uint64(2 * side - 1)
                    for beyond in (beside - line, beside, beside + line):  # a range by ``row`` would be a division
                        more = there & bits[beyond]
                        if more:
                            bits[beyond] &= ~more
                            waiting -= 1
                            at = np.uint64(waiting)
                            places[at], reached[at] = beyond, more
            here += step
            found = wide & bits[here]
        if waiting == end:
            return count, size
        at = np.uint64(waiting)
        place, found = places[at], reached[at]
        here, step = (np.uint64(place), line) if place >= 0 else (np.uint64(~place), np.uint64(-row))
        waiting += 1


@called
def connected(bits: Array, strong: Array, strength: Array, row: int, least: int, weight: float) -> int:
    """Clear all pixels except those of connected pieces with a strong pixel; return the number of remaining pixels.

    A piece grows by words of 64 pixels; ``row`` is the number of words per row.
    """
    # Growing lists, or counting the pixels first, would slow down the flood fill; unwritten memory costs nothing.
    places, reached = np.empty(64 * len(bits), np.int32), np.empty(64 * len(bits), np.uint64)
    left = kept = 0
    for i in range(len(strong)):
        while strong[i] & bits[i]:
            seeds = strong[i] & bits[i]
            count, size = _grown(bits, row, i, seeds & (~seeds + _ONE), places, reached, kept)
            total = 0.0
            if weight > 0.0:
                for j in range(kept, count):
                    found = reached[j]
                    while found:
                        x = 64 * (places[j] % row) + lowest(found) - MARGIN
                        total += strength[places[j] // row - 1, x]
                        found &= found - _ONE
            stays = size >= least and total >= weight
            left += size * stays
            kept = count if stays else kept  # no branch: most pieces are small, but many are not
    for i in range(len(bits)):
        bits[i] = 0
    for i in range(kept):
        bits[np.uint64(places[i])] |= reached[i]
    return left
