"""Numbers as the firmware reads, stores and prints them: 32 bits, eight digits, halves rounded away from zero.

Source: read_float() and printFloat() of GRBL 1.1h (nuts_bolts.c, print.c).
"""

from __future__ import annotations

import math
import re
import struct
from functools import lru_cache

MAX_NUMBER = 3.4e38
"""Largest 32-bit number; the firmware's numbers would be infinite beyond it."""
READ_DIGITS = 8
MAX_PRINTED = 2**31
"""Maximum printed number, in units of the last decimal: the limit of a conversion to 32 bits."""
_SINGLE = struct.Struct("<f")
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)")


def float32(value: float) -> float:
    """Return the nearest 32-bit number, or the largest one."""
    kept: float = _SINGLE.unpack(_SINGLE.pack(min(max(value, -MAX_NUMBER), MAX_NUMBER)))[0]
    return kept


def one_byte(value: float) -> int:
    """Return the lowest byte of a number's integer part."""
    return int(value) & 0xFF


def read_number(text: str, index: int = 0) -> tuple[float, int] | None:
    """Return a number of digits and a point, and the index of its end; None without one.

    Digits after the eighth count as zeros, even if the first ones are zeros.

    Examples
    --------
    >>> read_number("-1.5X2")
    (-1.5, 4)
    >>> read_number("0000000012")
    (0.0, 10)
    """
    match = _NUMBER.match(text, index)
    if match is None:
        return None
    whole, _, decimals = match[0].lstrip("+-").partition(".")
    digits = (whole + decimals)[:READ_DIGITS]
    exponent = len(whole) - len(digits)
    value = float32(int(digits))
    while exponent < 0 and value:
        step = min(2, -exponent)
        value = float32(value * float32((0.1, 0.01)[step - 1]))
        exponent += step
    while exponent > 0 and value:
        value = float32(value * 10.0)
        exponent -= 1
    return -value if match[0][0] == "-" else value, match.end()


@lru_cache(maxsize=1024)  # a board at rest prints the same numbers again and again
def print_number(value: float, decimals: int) -> str:
    """Return a number as it is printed; one slightly below 0 keeps its sign.

    Examples
    --------
    >>> print_number(1000.5, 0)
    '1001'
    >>> print_number(-0.0001, 3)
    '-0.000'
    """
    kept = float32(value)
    scaled, left = abs(kept), decimals
    while left > 0:
        step = min(2, left)
        scaled = float32(scaled * 10**step)
        left -= step
    digits = str(min(math.floor(float32(scaled + 0.5)), MAX_PRINTED)).rjust(decimals + 1, "0")
    sign = "-" if kept < 0.0 else ""
    return f"{sign}{digits[:-decimals]}.{digits[-decimals:]}" if decimals else sign + digits
