"""Single keys of a terminal, for programs that may also run in its background.

The kernel stops a program that sets up its terminal, or reads from it, from the background: for one that moves a
machine, or plays a recording, that must not happen.
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
    """Give the keys typed since the last call, without waiting; none in the background, or without a terminal."""
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
    except OSError:  # a terminal that does not control this process stops nobody
        return True


def typed_text() -> str | None:
    """Return the lines entered since the last call, without waiting; None once the terminal has been closed.

    The terminal keeps its settings: it shows what is typed, and a line counts when Enter is pressed. So a program that
    is killed leaves no terminal behind that shows nothing.
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
