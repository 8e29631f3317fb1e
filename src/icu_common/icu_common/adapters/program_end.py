"""How a command line program ends when its user has had enough of it."""

from __future__ import annotations

import functools
import io
import os
import signal
import sys
from collections.abc import Callable
from typing import ParamSpec

INTERRUPTED, UNREAD = 130, 141
"""Exit codes as shells have them: 128 and the number of SIGINT or SIGPIPE."""

P = ParamSpec("P")


def end_signals() -> list[signal.Signals]:
    """Return what asks a program to end: SIGINT, SIGTERM, and a terminal's SIGHUP, which ``nohup`` lets it ignore."""
    ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if ignored else [signal.SIGHUP])]


def ends_quietly(main: Callable[P, int]) -> Callable[P, int]:
    """Let Ctrl-C, and a reader that has gone (as ``head`` does), end a program without a traceback.

    Its ``main`` then returns ``INTERRUPTED`` or ``UNREAD``; what it must tidy up belongs in its ``finally``.
    """

    @functools.wraps(main)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> int:
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="backslashreplace")  # as on standard error: names of files may be no UTF-8
        code = UNREAD
        try:
            try:
                code = main(*args, **kwargs)
            finally:
                print(end="", flush=True)
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
            return INTERRUPTED
        except BrokenPipeError:  # the interpreter's end must not flush to it again
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return code

    return wrapped
