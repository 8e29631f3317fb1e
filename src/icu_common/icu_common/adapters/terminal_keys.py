"""Single keys of a terminal, for programs that may also run in the background.

The kernel stops a background program that configures or reads its terminal. That must not happen to a program that
moves a machine or plays a recording.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def terminal_keys() -> Iterator[Callable[[], str]]:
    """Provide a function that returns the keys typed since its last call, none in the background, without waiting."""
    if not _in_front():
        yield lambda: ""
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    tty.setcbreak(fd)
    try:
        yield lambda: _typed(fd)
    finally:
        if _in_front():
            termios.tcsetattr(fd, termios.TCSADRAIN, before)


def _typed(fd: int) -> str:
    if not _in_front() or not select.select([fd], [], [], 0)[0]:
        return ""
    return os.read(fd, 64).decode("ascii", "replace")


def _in_front() -> bool:
    if not sys.stdin.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # a terminal that does not control this process stops no program
        return True


def typed_text() -> str | None:
    """Return the lines entered since the last call, without waiting; None once the terminal has been closed.

    The terminal keeps its settings: it echoes the input, and a line is complete when Enter is pressed. A killed program
    therefore never leaves a terminal without echo.
    """
    if not _in_front():
        return ""
    fd = sys.stdin.fileno()
    try:
        if not select.select([fd], [], [], 0)[0]:
            return ""
        return os.read(fd, 256).decode("ascii", "replace") or None
    except OSError:
        return None
