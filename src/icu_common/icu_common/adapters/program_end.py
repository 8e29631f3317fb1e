"""How a command line program ends when its user has had enough of it, and what it says of itself."""

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
"""Exit codes: as shells have them, 128 and the number of SIGINT or SIGPIPE; standard output could not be written."""
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EIO)
_OF_ROS = re.compile(r"(rclpy|rpyutils|rosidl_\w+|ament_\w+|\w+_(msgs|srvs|interfaces))(\.|$)")
"""Modules that come with ROS 2; what a distribution brings beside them is not told by its name."""

P = ParamSpec("P")


def end_signals() -> list[signal.Signals]:
    """Return what asks a program to end: SIGINT, SIGTERM, and a terminal's SIGHUP, which ``nohup`` lets it ignore."""
    ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]


def help_text(documentation: str | None) -> str:
    """Return a module's documentation as a terminal shows it, without the marks for names and code."""
    return re.sub(r":\w+:`~?([^`]*)`", r"\1", documentation or "").replace("``", "")


def starts_in_one_line() -> None:
    """Let a start that cannot be end by one line, while this process imports what its ``main`` needs.

    That is Ctrl-C, and a shell in which ROS is not sourced.
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
    """Let Ctrl-C, a reader that has gone (as ``head`` does), and a full disk, end a program without a traceback.

    Its ``main`` then returns ``INTERRUPTED``, ``UNREAD`` or ``UNWRITTEN``; what it must tidy up belongs in its
    ``finally``.
    """

    @functools.wraps(main)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> int:
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="backslashreplace")  # as on standard error: names of files may be no UTF-8
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
    """Tell whether standard output takes nothing: what is left in it, or, where nothing is ever left, an empty line."""
    try:
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.write_through:
            sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return True
    return False


def _print_no_more() -> None:
    """Let the interpreter's end not flush again to what takes nothing."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
