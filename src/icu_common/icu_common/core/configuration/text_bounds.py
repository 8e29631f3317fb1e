"""Limits of texts from outside: nesting depth, length, and escaped characters.

A text from another program, a browser or a board is cut and escaped once, where it is received. After that it is safe
in the log, on a terminal, in the audit file and on the page.
"""

from __future__ import annotations

import re

MAX_TEXT = 400
"""Maximum number of characters of a text from outside; the longest sentence of this project has 300."""
_BRACKET = re.compile(r"[\[\]{}\n]")
_UNSEEN = re.compile(
    # Control characters (C0, DEL, C1), text direction marks, line separators, unpaired surrogates.
    "[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)


def deepest_line(text: str, limit: int) -> int:
    """Return the first line on which more than ``limit`` brackets are open, 0 if there is none.

    Brackets in quoted texts count as well: this runs before the parser, which may take seconds.
    """
    depth, line = 0, 1
    for found in _BRACKET.finditer(text):
        mark = found[0]
        if mark == "\n":
            line += 1
        elif mark in "[{":
            depth += 1
            if depth > limit:
                return line
        else:
            depth = max(depth - 1, 0)
    return 0


def plain(text: str, limit: int = MAX_TEXT) -> str:
    """Return a text from outside cut to ``limit`` characters, with everything unprintable in it escaped.

    Examples
    --------
    >>> plain("a\\x1b[2Jb")
    'a\\\\x1b[2Jb'
    """
    more = len(text) - limit
    cut = text if more <= 0 else f"{text[:limit]} ({more} more characters)"
    return _UNSEEN.sub(_escaped, cut)


def _escaped(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
