"""One progress line on a terminal; elsewhere an occasional line."""

from __future__ import annotations

import sys

_ON_TERMINAL_S, _ELSEWHERE_S = 0.1, 10.0


class ProgressLine:
    """Shows the newest text, ten times per second on a terminal and every ten seconds in a log."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._next_s = 0.0

    def show(self, now_s: float, text: str) -> None:
        """Show ``text`` if the interval has passed."""
        if now_s >= self._next_s:
            self._next_s = now_s + (_ON_TERMINAL_S if self._terminal else _ELSEWHERE_S)
            print(f"\r\033[K{text}" if self._terminal else text, end="" if self._terminal else "\n", file=sys.stderr)
            sys.stderr.flush()

    def end(self) -> None:
        """End the line."""
        if self._terminal:
            print(file=sys.stderr)
