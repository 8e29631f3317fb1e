"""Extends free ends of edges to the corner that they miss, so that edges meet in the corner; compiled by numba.

All functions work on bitmaps (see bitmap.py). Pairs of an end and a corner are searched from the corners, which are
fewer than pixels. The path to the corner is appended to the chain, not drawn. Two drawn lines that meet at a sharp
angle touch some pixels earlier: chains would end there, with another chain of two pixels from there to the corner.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.bitmap import MARGIN, has, lowest, ones, put
from harris_perception.core.image.compiled import called

Array = npt.NDArray[Any]
# Result of ``leads``.
Lead = tuple[Array, Array, Array, Array]

# Distance from a corner, in px, within which an edge may pass by it, rounding it off.
_ROUNDED_OFF = 6.0

_ONE = np.uint64(1)

# Number of columns that a word starting at any byte contains completely.
_BLOCK = 57


@called
def _disc(radius: float) -> Array:
    """Return the rows of a disc, (2 R + 1, N): bit i of block j is the column 57 j + i - R."""
    reach = int(radius)
    side = 2 * reach + 1
    rows = np.zeros((side, (side + _BLOCK - 1) // _BLOCK), np.uint64)
    for y in range(side):
        for x in range(side):
            if (x - reach) ** 2 + (y - reach) ** 2 <= radius * radius:
                rows[y, x // _BLOCK] |= _ONE << np.uint64(x % _BLOCK)
    return rows


@called
def cut(words: Array, corners: Array, row: int, farthest: float) -> None:
    """Clear the pixels within three quarters of the reach of a corner (N, 2) px, at most within ``_ROUNDED_OFF``.

    Edges round corners off on the outside. ``row`` is the number of bytes per row.
    """
    radius = min(0.75 * farthest, _ROUNDED_OFF)
    height = len(words) // row - 2
    disc = _disc(radius)
    reach = len(disc) // 2
    for i in range(len(corners)):
        x, y = corners[i, 0] - reach + MARGIN, corners[i, 1] - reach
        for block in range(disc.shape[1]):
            left = x + block * _BLOCK
            for j in range(max(-y, 0), min(height - y, len(disc))):
                words[np.uint64((y + j + 1) * row + (left >> 3))] &= ~(disc[j, block] << np.uint64(left & 7))


@called
def _near(words: Array, corners: Array, row: int, radius: float) -> Array:
    """Return pairs (N, 2) of a set place within a radius of a corner, and that corner; the nearest first."""
    height = len(words) // row - 2
    disc = _disc(radius)
    reach = len(disc) // 2
    most = len(corners) * disc.size  # unwritten memory costs nothing, a growing list does
    remains, begins = np.empty(most, np.uint64), np.empty((most, 3), np.int32)
    count = filled = 0
    for i in range(len(corners)):
        x, y = corners[i, 0] - reach, corners[i, 1] - reach
        for block in range(disc.shape[1]):
            left = x + block * _BLOCK
            shift, first = np.uint64((left + MARGIN) & 7), (y + 1) * row + ((left + MARGIN) >> 3)
            for j in range(max(-y, 0), min(height - y, len(disc))):
                word = (words[np.uint64(first + j * row)] >> shift) & disc[j, block]
                if word:
                    remains[filled] = word
                    begins[filled, 0], begins[filled, 1], begins[filled, 2] = i, left, y + j
                    filled += 1
                    count += ones(word)
    found, squares = np.empty((count, 2), np.int32), np.empty(count, np.int32)
    starts = np.zeros(int(radius * radius) + 2, np.int32)
    count = 0
    for number in range(filled):
        i, left, y = begins[number]
        word = remains[number]
        while word:
            x = left + lowest(word)
            word &= word - _ONE
            found[count, 0], found[count, 1] = (y + 1) * 8 * row + x + MARGIN, i
            squares[count] = (x - corners[i, 0]) ** 2 + (y - corners[i, 1]) ** 2
            starts[squares[count] + 1] += 1
            count += 1
    for square in range(1, len(starts)):
        starts[square] += starts[square - 1]
    pairs = np.empty((count, 2), np.int32)
    for i in range(count):
        at = starts[squares[i]]
        pairs[at, 0], pairs[at, 1] = found[i, 0], found[i, 1]
        starts[squares[i]] += 1
    return pairs


@called
def _rank(flags: Array, before: Array, place: int) -> int:
    """Return the number of bits set before a place; ``before`` has this number for each word."""
    word = np.uint64(place) >> np.uint64(6)
    below = (_ONE << (np.uint64(place) & np.uint64(63))) - _ONE
    return int(before[word]) + ones(flags[word] & below)


@called
def leads(end_words: Array, corners: Array, row: int, farthest: float, led: Array) -> Lead:
    """Find for each free end the two nearest corners (N, 2) px within reach.

    Parameters
    ----------
    end_words
        Bitmap of the free ends, as words that start at every byte; ``row`` is the number of bytes per row.
    corners
        (N, 2) int32 px.
    farthest
        Reach, px.
    led
        Empty bitmap as words of 64, in which all ends with such a corner are set.

    Returns
    -------
    tuple
        ``led``; the number of ends before each of its words; (2, ends), in order of places, the nearest corner of each
        end and the next one or -1; ``corners``.
    """
    pairs = _near(end_words, corners, row, farthest)
    for i in range(len(pairs)):
        put(led, pairs[i, 0])
    before, count = np.empty(len(led), np.int32), 0
    for i in range(len(led)):
        before[i] = count
        count += ones(led[i])
    nearest = np.full((2, count), -1, np.int32)
    for i in range(len(pairs) - 1, -1, -1):  # the nearest comes last
        end = _rank(led, before, pairs[i, 0])
        nearest[1, end], nearest[0, end] = nearest[0, end], pairs[i, 1]
    return led, before, nearest, corners


@called
def _way(bits: Array, chain: Array, filled: int, end: int, corner: Array, stride: int, back: bool) -> int:
    """Append the straight path from an end to a corner, x and y, or ``back``; see ``way_to_corner``."""
    y = int((end + 0.5) / stride)
    dx, dy = corner[0] - (end - y * stride - MARGIN), corner[1] - (y - 1)
    length = max(abs(dx), abs(dy))
    if has(bits, end + int(np.rint(dx / length)) + int(np.rint(dy / length)) * stride):
        return filled
    for j in range(1, length + 1):
        part = (length + 1 - j if back else j) / length
        chain[np.uint64(filled)] = end + int(np.rint(dx * part)) + int(np.rint(dy * part)) * stride
        filled += 1
    return filled


@called
def way_to_corner(bits: Array, chain: Array, filled: int, end: int, lead: Lead, stride: int, back: bool) -> int:
    """Append to ``chain`` the straight path from an end with a corner (see ``leads``) to this corner, or ``back``.

    The end itself is not appended. If the path would run back along the line, the line's other end is nearer, and
    nothing is appended. Returns the new number of pixels.
    """
    led, before, nearest, corners = lead
    return _way(bits, chain, filled, end, corners[nearest[0, _rank(led, before, end)]], stride, back)


@called
def bridge(bits: Array, chain: Array, filled: int, here: int, lead: Lead, stride: int) -> int:
    """Append to ``chain`` the path from a corner to a single pixel near it, and on to the next corner within reach.

    Returns the new number of pixels.
    """
    led, before, nearest, corners = lead
    one, other = nearest[:, _rank(led, before, here)]
    filled = _way(bits, chain, filled, here, corners[one], stride, True)
    chain[filled] = here
    return filled + 1 if other < 0 else _way(bits, chain, filled + 1, here, corners[other], stride, False)
