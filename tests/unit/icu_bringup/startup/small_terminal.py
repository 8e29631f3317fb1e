"""A terminal of a few control codes: what bring-up writes becomes rows, as a person sees them."""

from __future__ import annotations

import re

_TOKEN = re.compile(r"\x1b\[([0-9;?]*)([A-Za-z])|(\r)|(\n)|([^\x1b\r\n]+)")


class SmallTerminal:
    """Rows of text; the cursor goes up by CSI A, CSI J erases below it, and SGR changes nothing here."""

    def __init__(self, columns: int, rows: int) -> None:
        self.columns, self.height = columns, rows
        self.lines = [""]
        self.row = self.column = 0

    def write(self, text: str) -> SmallTerminal:
        """Apply text with control codes; return this terminal."""
        for arguments, final, back, new, plain in _TOKEN.findall(text):
            if final == "A":
                self.row -= int(arguments or 1)
                # Text that has scrolled off the screen cannot be reached.
                highest = max(len(self.lines) - self.height, 0)
                assert self.row >= highest, f"the cursor left the screen: {self.lines}, {text[-2000:]!r}"
            elif final == "J":
                del self.lines[self.row + 1 :]
                self.lines[self.row] = self.lines[self.row][: self.column]
            elif back:
                self.column = 0
            elif new:
                self._down()
                self.column = 0
            else:
                assert final in ("", "m"), f"unknown code {arguments}{final}"
                for character in plain:
                    self._put(character)
        return self

    def _put(self, character: str) -> None:
        if self.column == self.columns:
            self._down()
            self.column = 0
        line = self.lines[self.row].ljust(self.column)
        self.lines[self.row] = line[: self.column] + character + line[self.column + 1 :]
        self.column += 1

    def _down(self) -> None:
        self.row += 1
        if self.row == len(self.lines):
            self.lines.append("")

    @property
    def screen(self) -> list[str]:
        """The rows that are in view, without blanks at their ends."""
        return [line.rstrip() for line in self.lines[-self.height :]]
