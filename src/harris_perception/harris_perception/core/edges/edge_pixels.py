"""Classifies pixels of a thinned edge by their neighbours: ends, branches, redundant pixels, holes; compiled by numba.

For a single pixel, the eight neighbours are read from three rows of a bitmap (see bitmap.py) as the bits of a byte,
which index a table of 256 patterns. In whole images 64 pixels are classified at a time, by counting the bits of all
rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.bitmap import lowest, ones, window
from harris_perception.core.image.compiled import called, inlined

Array = npt.NDArray[Any]

_ONE = np.uint64(1)

# Neighbours in circular order; even ones share a side with the pixel.
DX = np.array([1, 1, 0, -1, -1, -1, 0, 1], np.int32)
DY = np.array([0, 1, 1, 1, 0, -1, -1, -1], np.int32)


def _tables() -> tuple[npt.NDArray[Any], ...]:
    """Return five tables over all patterns of neighbours (bit i is the i-th).

    They are: the number of neighbours, the first one, whether the pixel is redundant, whether it certainly is, and the
    neighbours to which a line continues.

    A pixel is redundant if at least two neighbours are set and stay connected without it (Yokoi's number, 8-connected).
    It is certainly redundant if it is not the end of a line wider than a pixel, which has two adjacent neighbours.
    While there are other redundant pixels, such ends would be removed one by one.
    """
    full = np.array([[pattern >> i & 1 for i in range(8)] for pattern in range(256)])
    empty = 1 - full
    sides, after, beyond = empty[:, 0::2], empty[:, 1::2], np.roll(empty, -2, axis=1)[:, 0::2]
    pieces = (sides - sides * after * beyond).sum(axis=1)
    count = full.sum(axis=1)
    needless = (count >= 2) & (pieces == 1)
    certain = needless & ((count > 2) | (full[:, 0::2].sum(axis=1) == 2))
    # A pixel that is also reached through a neighbour with a common side needs no diagonal step.
    direct = full.copy()
    direct[:, 1::2] &= empty[:, 0::2] & np.roll(empty, -2, axis=1)[:, 0::2]
    steps = (direct << np.arange(8)).sum(axis=1).astype(np.uint8)
    return count.astype(np.uint8), full.argmax(axis=1).astype(np.uint8), needless, certain, steps


COUNT, FIRST, NEEDLESS, CERTAIN, _DIRECT = _tables()

# The neighbours in circular order, indexed by the nine bits of a 3x3 window in row order.
_NEIGHBOURS = (((np.arange(512)[:, None] >> (3 * DY + DX + 4)) & 1) << np.arange(8)).sum(axis=1).astype(np.uint8)
STEPS = _DIRECT[_NEIGHBOURS]


@called
def pattern_of(octets: Array, here: int, row: int) -> np.uint8:
    """Return the set neighbours of the eight as bits in circular order; ``row`` is the number of bytes per row."""
    return np.uint8(_NEIGHBOURS[window(octets, here, row)])


# No Python ints: numba would compile all four functions again for each value.
HOLES, CROWDED, ENDS, NODES = np.arange(4, dtype=np.int64)


@inlined
def _counted(one: Any, other: Any, third: Any, fourth: Any) -> tuple[Any, Any, Any]:
    """Return which bits of four words are set at least once, at least twice, and more often."""
    either, both, neither, all_of = one | other, one & other, third | fourth, third & fourth
    return either | neither, both | all_of | (either & neither), (both & neither) | (either & all_of)


@inlined
def _classified_words(above: Any, here: Any, below: Any, kind: Any, result: Any, n: int) -> None:
    first, last = np.uint64(1), np.uint64(63)
    for i in range(1, n - 1):
        north, middle, south = above[i], here[i], below[i]
        west, east = (middle << first) | (here[i - 1] >> last), (middle >> first) | (here[i + 1] << last)
        if kind == HOLES:
            result[i] = north & south & west & east & ~middle
            continue
        nw, ne = (north << first) | (above[i - 1] >> last), (north >> first) | (above[i + 1] << last)
        sw, se = (south << first) | (below[i - 1] >> last), (south >> first) | (below[i + 1] << last)
        if kind == NODES:
            nw, ne = nw & ~(north | west), ne & ~(north | east)
            sw, se = sw & ~(south | west), se & ~(south | east)
        once, twice, often = _counted(west, east, north, south)
        aslant, two, more = _counted(nw, ne, sw, se)
        both, many = twice | two | (once & aslant), often | more | (twice & aslant) | (once & two)
        if kind == ENDS:
            result[i] = middle & ~both
        elif kind == CROWDED:
            beside = ((west | east) & (north | south)) | (north & (nw | ne)) | (south & (sw | se))
            result[i] = middle & (many | beside | (west & (nw | sw)) | (east & (ne | se)))
        else:
            result[i] = middle & (~both | many)


@called
def classified(bits: Array, row: int, kind: np.int64, result: Array) -> None:
    """Set ``result`` to the pixels of a kind, 64 at a time; ``row`` is the words per row, the first is margin.

    Holes are empty pixels between four set ones. Crowded pixels have three or more neighbours, or are redundant. Ends
    have at most one neighbour. Nodes are pixels at which a line does not simply continue: their number of steps to
    other pixels, without redundant diagonal ones, is not two.

    All rows are one loop, as the rows of small images are too short to be vectorised separately.
    """
    n = len(bits) - 2 * row
    above, here, below, out = bits[:n], bits[row : row + n], bits[2 * row :], result[row : row + n]
    if kind == HOLES:
        _classified_words(above, here, below, HOLES, out, n)
    elif kind == CROWDED:
        _classified_words(above, here, below, CROWDED, out, n)
    elif kind == ENDS:
        _classified_words(above, here, below, ENDS, out, n)
    else:
        _classified_words(above, here, below, NODES, out, n)


@called
def close_holes(bits: Array, row: int, spare: Array) -> int:
    """Set empty pixels between four set ones, so that a line does not split around one pixel; return their number.

    At a step between two columns, noise makes either column the stronger one, or both next to it.
    """
    classified(bits, row, HOLES, spare)
    count = 0
    for i in range(len(bits)):
        bits[i] |= spare[i]
        count += ones(spare[i])
    return count


@called
def places_of(bits: Array, most: int) -> Array:
    """Return the places of all set pixels, (N,) int32; there may be ``most``."""
    places, words = np.empty(most, np.int32), np.empty(len(bits), np.int32)
    count = filled = 0
    for i in range(len(bits)):  # always write, sometimes advance: avoids a mispredicted branch
        words[np.uint64(filled)] = i
        filled += bits[i] != 0
    for i in range(filled):
        word = bits[words[i]]
        while True:  # most have one pixel
            places[count] = 64 * words[i] + lowest(word)
            count += 1
            word &= word - _ONE
            if word == 0:
                break
    return places[:count]
