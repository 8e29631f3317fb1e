"""Clean exit of command-line programs (Ctrl-C, closed pipe, full disk) and their --help text."""

from __future__ import annotations

import errno
import functools
import io
import os
import re
import signal
import sys
from collections.abc import Callable
from types import TracebackType
from typing import ParamSpec

INTERRUPTED, UNREAD, UNWRITTEN = 130, 141, os.EX_IOERR
"""Exit codes: 128 plus the number of SIGINT or SIGPIPE, as in shells; standard output could not be written."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
_OF_ROS = re.compile(r"(rclpy|rpyutils|rosidl_\w+|ament_\w+|\w+_(msgs|srvs|interfaces))(\.|$)")
"""Modules that come with ROS 2; other modules of a distribution cannot be recognised by their names."""

P = ParamSpec("P")


def end_signals() -> list[signal.Signals]:
    """Return the signals that end a program: SIGINT, SIGTERM, and a terminal's SIGHUP unless ``nohup`` ignores it."""
    ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]


def help_text(documentation: str | None) -> str:
    """Return a module's documentation as a terminal shows it, without the marks for names and code."""
    return re.sub(r":\w+:`~?([^`]*)`", r"\1", documentation or "").replace("``", "")


def starts_in_one_line() -> None:
    """End a failed start with one line instead of a traceback, while this process imports what its ``main`` needs.

    Causes are Ctrl-C, and a shell in which ROS is not sourced.
    """
    usual = sys.excepthook

    def told(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if issubclass(kind, KeyboardInterrupt):
            print("interrupted", file=sys.stderr)
        elif isinstance(error, ImportError) and _OF_ROS.match(error.name or ""):
            print(
                f"error: {str(error).partition(chr(10))[0]} for {sys.executable}: source ROS 2 first "
                "(source /opt/ros/jazzy/setup.bash), or use the programs of scripts/setup.sh in ros2_ws/install",
                file=sys.stderr,
            )
        else:
            usual(kind, error, trace)

    sys.excepthook = told


def ends_quietly(main: Callable[P, int]) -> Callable[P, int]:
    """End a program without a traceback on Ctrl-C, a reader that has gone (such as ``head``), or a full disk.

    Its ``main`` then returns ``INTERRUPTED``, ``UNREAD`` or ``UNWRITTEN``; its cleanup belongs in a ``finally``.
    """

    @functools.wraps(main)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> int:
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="backslashreplace")  # as on standard error: file names may not be UTF-8
        code: int | None = None
        try:
            try:
                code = main(*args, **kwargs)
            finally:
                if sys.stdout is not None:
                    sys.stdout.flush()
            return code
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return INTERRUPTED
        except BrokenPipeError:
            _print_no_more()
            return UNREAD if code is None else code
        except OSError as error:
            if error.errno not in _FULL or not _was_of_output():
                raise
            _print_no_more()
            print(f"error: standard output: {error.strerror}", file=sys.stderr)
            return code or UNWRITTEN

    return wrapped


def _was_of_output() -> bool:
    """Return whether standard output cannot be written: its buffer or, if it is unbuffered, an empty line."""
    try:
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.write_through:
            sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _print_no_more() -> None:
    """Redirect standard output to /dev/null, as the interpreter flushes it again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
