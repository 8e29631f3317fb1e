"""Text that bring-up draws at the bottom of a terminal: one moving line, or a box with the address.

Everything here returns strings; :mod:`icu_bringup.adapters.screen` writes them.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

QR_BORDER = 2
"""Number of white modules around the code; ISO/IEC 18004 requires 4, and readers work with 2."""
_BAR = 20
_BLACK_ON_WHITE, _NORMAL = "\x1b[38;5;16;48;5;231m", "\x1b[0m"
_HALVES = {(0, 0): " ", (1, 0): "▀", (0, 1): "▄", (1, 1): "█"}
"""Characters for two modules, one above the other: a terminal's cell is about twice as high as wide."""
_CONTROL = re.compile(r"\x1b\[[0-9;?]*[ -/]*[@-~]|[\x00-\x08\x0b-\x1f\x7f]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Content of the box.

    Parameters
    ----------
    address
        Address on its own row, for copying; empty if no page is served.
    notes
        Sentences, each its own paragraph.
    footer
        Text on its own row below, for copying; empty for none.
    qr
        Modules of the address as a QR code, 1 is dark; empty for none.
    """

    address: str
    notes: tuple[str, ...]
    footer: str = ""
    qr: tuple[tuple[int, ...], ...] = ()


def without_controls(text: str) -> str:
    """Return a text without escape sequences and control characters, which would move the cursor."""
    return _CONTROL.sub("", text).expandtabs(4)


def moving_line(text: str, done: int, total: int, columns: int) -> str:
    """Return one row, with a bar if there is a total; it never reaches the last column, where terminals wrap."""
    filled = _BAR * done // total if total else 0
    bar = f"[{'#' * filled}{'.' * (_BAR - filled)}] " if total else ""
    return f"{bar}{' '.join(without_controls(text).split())}"[: max(columns - 1, 1)]


def qr_rows(modules: Sequence[Sequence[int]]) -> list[str]:
    """Return a QR code as rows of half blocks, black on white whatever the terminal's colors are."""
    if not modules:
        return []
    width = len(modules[0]) + 2 * QR_BORDER
    blank = [0] * width
    side = [0] * QR_BORDER
    grid = [blank] * QR_BORDER + [[*side, *map(int, row), *side] for row in modules] + [blank] * QR_BORDER
    grid += [blank] * (len(grid) % 2)
    halves = ("".join(_HALVES[pair] for pair in zip(upper, lower)) for upper, lower in zip(grid[::2], grid[1::2]))
    return [f"{_BLACK_ON_WHITE}{row}{_NORMAL}" for row in halves]


def box_rows(box: Box, columns: int, rows: int, *, unicode: bool = True) -> list[str]:
    """Return the rows of a box that fit into a terminal; the code is omitted if it does not fit.

    An address or footer that is wider than the box gets a row without borders, which the terminal may wrap, so that it
    can still be copied in one piece.
    """
    inner = max(columns - 5, 8)  # two borders, two blanks, and the last column
    code = qr_rows(box.qr) if unicode else []
    code_width = len(box.qr[0]) + 2 * QR_BORDER if code else 0
    beside = inner - code_width - 2
    notes = _paragraphs(box.notes, beside) if code else []
    whole = [text for text in (box.address, box.footer) if text]
    fits = max(len(code), len(notes)) + height(whole, columns) + 2 <= rows
    if not code or beside < 16 or not fits:
        content = [(note, len(note)) for note in _paragraphs(box.notes, inner)]
    else:
        count = max(len(code), len(notes))
        code += [" " * code_width] * (count - len(code))
        notes += [""] * (count - len(notes))
        content = [(f"{left}  {right}", code_width + 2 + len(right)) for left, right in zip(code, notes)]
    inner = max(min(inner, max([*map(len, whole), *(width for _, width in content)])), 8)
    across, down, corners = ("─", "│", "┌┐└┘") if unicode else ("-", "|", "++++")

    def row(text: str, width: int) -> str:
        return f"{down} {text}{' ' * (inner - width)} {down}" if width <= inner else text

    return [
        f"{corners[0]}{across * (inner + 2)}{corners[1]}",
        *([row(box.address, len(box.address))] if box.address else []),
        *(row(text, width) for text, width in content),
        *([row(box.footer, len(box.footer))] if box.footer else []),
        f"{corners[2]}{across * (inner + 2)}{corners[3]}",
    ]


def _paragraphs(notes: Sequence[str], width: int) -> list[str]:
    lines: list[str] = []
    for note in notes:
        lines += [""] if lines else []
        lines += textwrap.wrap(without_controls(note), max(width, 8), break_on_hyphens=False)
    return lines


def height(rows: Sequence[str], columns: int) -> int:
    """Return how many rows of the terminal these rows take, including wrapped ones."""
    return sum(max(1, -(-len(without_controls(row)) // max(columns, 1))) for row in rows)


def redraw(drawn: int, messages: Sequence[str], block: Sequence[str]) -> str:
    """Return the output that replaces a block at the bottom by messages and another block below them.

    Parameters
    ----------
    drawn
        Height of the present block; the cursor is in its last row. 0 for none: the cursor is in an empty row.
    messages
        Lines that scroll up and stay.
    block
        Rows of the new block; the cursor stays at the end of the last one.
    """
    up = f"\x1b[{drawn - 1}A" if drawn > 1 else ""
    lines = "".join(f"{without_controls(text)}\n" for message in messages for text in message.split("\n"))
    return f"\r{up}\x1b[J{lines}" + "\n".join(block)
