"""Images of one bit per pixel: small enough for the cache, and eight pixels are tested at once.

Pixel (x, y) is bit ``MARGIN + x`` of row y + 1; its *place* is its index among all bits. All bits around the image are
zero. There is one row above, one below, and between rows a margin so wide that no window around a pixel reaches pixels
of the neighbouring row. One more row at the end allows whole words to be read there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import called, inlined

Array = npt.NDArray[Any]

MARGIN = 64

_ONE, _LAST = np.uint64(1), np.uint64(63)


def blank(count: int, height: int, width: int) -> npt.NDArray[np.uint8]:
    """Return empty bitmaps for images of one size: (N, H + 3, B) uint8, eight bits to a byte, the lowest first."""
    return np.zeros((count, height + 3, (MARGIN + width + 63) // 64 * 8), np.uint8)


def wide(bits: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint64]:
    """Return the same memory as words of 64 bits, one starting at each byte."""
    return np.ndarray(bits.size - 7, np.uint64, bits, strides=(1,))


@inlined
def pack(words: Any, count: int, out: Any) -> None:
    """Set the bits of ``out``, uint8, that are marked in ``count`` words of eight bytes, each 0 or 1."""
    for i in range(count):
        word = words[i]
        word = (word | (word >> np.uint64(7))) & np.uint64(0x0003000300030003)
        word = (word | (word >> np.uint64(14))) & np.uint64(0x0000000F0000000F)
        out[i] |= np.uint8((word | (word >> np.uint64(28))) & np.uint64(0xFF))


@called
def ones(word: np.uint64) -> int:
    """Return the number of set bits (H. Warren, "Hacker's Delight", 5-1); the compiler makes one instruction of it."""
    word -= (word >> _ONE) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return int((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@called
def lowest(word: np.uint64) -> int:
    """Return the index of the lowest set bit, 64 if none is set."""
    return ones(~word & (word - _ONE))


@called
def window(octets: Array, here: int, row: int) -> np.uint64:
    """Return the bits of a 3x3 window, in row order; ``row`` is the number of bytes per row.

    Two bytes of each row contain them; the compiler loads both at once.
    """
    before = np.uint64(here - 1)
    shift, middle = before & np.uint64(7), before >> np.uint64(3)
    above, below = middle - np.uint64(row), middle + np.uint64(row)
    seven, eight = np.uint64(7), np.uint64(8)
    north = np.uint64(octets[above]) | (np.uint64(octets[above + _ONE]) << eight)
    same = np.uint64(octets[middle]) | (np.uint64(octets[middle + _ONE]) << eight)
    south = np.uint64(octets[below]) | (np.uint64(octets[below + _ONE]) << eight)
    seen = ((north >> shift) & seven) | (((same >> shift) & seven) << np.uint64(3))
    return np.uint64(seen | (((south >> shift) & seven) << np.uint64(6)))


@called
def has(flags: Array, place: int) -> np.uint64:
    """Return whether a bit is set in words of 64."""
    return np.uint64((flags[np.uint64(place) >> np.uint64(6)] >> (np.uint64(place) & _LAST)) & _ONE)


@called
def put(flags: Array, place: int) -> None:
    """Set a bit."""
    flags[np.uint64(place) >> np.uint64(6)] |= _ONE << (np.uint64(place) & _LAST)


@called
def clear(flags: Array, place: int) -> None:
    """Clear a bit."""
    flags[np.uint64(place) >> np.uint64(6)] &= ~(_ONE << (np.uint64(place) & _LAST))
