"""Output of bring-up: on a terminal messages above one block at the bottom, elsewhere plain lines; all goes to the log.

A separate thread writes, so that a terminal that takes no output (Control-S) delays no program.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import TypeAlias

from icu_bringup.adapters.run_log import RunLog
from icu_bringup.core.startup.run_words import Status
from icu_bringup.core.startup.terminal_layout import Box, box_rows, height, moving_line, redraw

FLUSH_TIMEOUT_S = 1.0
"""Maximum seconds at the end to print the remaining output."""
_PLAIN_INTERVAL_S = 10.0
"""Seconds between two lines of progress of one step where there is no terminal."""

_Item: TypeAlias = Callable[[], None]


def is_terminal() -> bool:
    """Return whether standard output is a terminal that can move its cursor."""
    return sys.stdout.isatty() and os.environ.get("TERM", "dumb") not in ("", "dumb")


class Screen:
    """Prints messages, progress and the box.

    Parameters
    ----------
    log
        Log that receives all output.
    terminal
        False for plain lines without control codes.
    on_broken
        Called by the printing thread when standard output can no longer be written: with an empty text if its reader
        has ended, otherwise with the reason.
    """

    def __init__(self, log: RunLog | None, *, terminal: bool, on_broken: Callable[[str], None]) -> None:
        self.terminal = terminal
        self._log = log
        self._on_broken = on_broken
        self._items: SimpleQueue[_Item | None] = SimpleQueue()
        self._block: Status | Box | None = None
        self._drawn = 0
        self._columns = 0
        self._plain_text, self._plain_step, self._plain_at = "", "", 0.0
        self._broken = False
        self._unicode = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
        self._thread = threading.Thread(target=self._print_all, name="printer", daemon=True)
        self._thread.start()

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self._items.put(lambda: self._say(text))

    def log(self, text: str) -> None:
        """Write a line to the log alone."""
        self._items.put(lambda: self._to_log(text))

    def status(self, status: Status) -> None:
        """Show progress: the moving line of a terminal; elsewhere a line for each step, and every ten seconds."""
        self._items.put(lambda: self._status(status))

    def box(self, box: Box) -> None:
        """Keep a box at the bottom of a terminal; no effect elsewhere."""
        self._items.put(lambda: self._show(box))

    def clear(self) -> None:
        """Remove the moving line or the box."""
        self._items.put(lambda: self._show(None))

    def typed(self, newlines: int) -> None:
        """Account for typed text that the terminal has echoed, which has moved its cursor down."""
        self._items.put(lambda: self._typed(newlines))

    def end(self) -> None:
        """Print the remaining output, for at most a second."""
        self._items.put(None)
        self._thread.join(FLUSH_TIMEOUT_S)

    # In the printing thread.

    def _print_all(self) -> None:
        for item in iter(self._items.get, None):
            item()
        if self.terminal and self._drawn:
            self._write("\n")
        if self._log is not None:
            self._log.close()

    def _to_log(self, text: str) -> None:
        if self._log is not None:
            try:
                self._log.write(text)
            except OSError as error:
                self._log = None
                self._say(f"error: the log cannot be written: {error.strerror}; it ends here")

    def _say(self, text: str) -> None:
        self._to_log(text)
        if self.terminal:
            self._draw([text])
        else:
            self._write(f"{text}\n")

    def _status(self, status: Status) -> None:
        if self.terminal:
            self._show(status)
            return
        step = status.text.partition(" ")[0]
        now = time.monotonic()
        if status.text != self._plain_text and (step != self._plain_step or now >= self._plain_at):
            self._plain_text, self._plain_step, self._plain_at = status.text, step, now + _PLAIN_INTERVAL_S
            self._say(f"{'progress':>17} | {status.text}")

    def _show(self, block: Status | Box | None) -> None:
        if self.terminal and block != self._block:
            self._block = block
            self._draw([])

    def _typed(self, newlines: int) -> None:
        if self.terminal and self._drawn:
            self._drawn += newlines
            self._draw([])

    def _draw(self, messages: list[str]) -> None:
        size = shutil.get_terminal_size()
        with contextlib.suppress(OSError):
            size = os.get_terminal_size(sys.stdout.fileno())
        columns, rows = size.columns or 80, size.lines or 24
        if isinstance(self._block, Status):
            block = [moving_line(self._block.text, self._block.done, self._block.total, columns)]
        elif self._block is None:
            block = []
        else:
            block = box_rows(self._block, columns, rows, unicode=self._unicode)
        self._write(redraw(self._drawn, messages, block))
        self._drawn = height(block, columns) if block else 0

    def _write(self, text: str) -> None:
        data = text.encode(errors="backslashreplace")
        try:
            while data and not self._broken:
                data = data[os.write(sys.stdout.fileno(), data) :]
        except BrokenPipeError:
            self._broken = True
            self._on_broken("")
        except OSError as error:  # a full disk, or the terminal is closed
            self._broken = True
            self._on_broken(str(error.strerror))
