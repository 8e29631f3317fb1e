"""Runs a program in the background of a terminal that controls it, as ``program &`` in a shell does."""

from __future__ import annotations

import os
import pty
import shlex
import subprocess
import sys
from collections.abc import Mapping


def output_in_background(*command: str, environment: Mapping[str, str] | None = None, within_s: float = 60.0) -> str:
    """Return what a Python module with arguments has printed until it ended, or was stopped by the kernel."""
    program = shlex.join([sys.executable, "-m", *command])
    shell = ["bash", "-c", f"set -m; {program} & wait $!; kill -9 $!"]
    # The terminal must be the session's own, or the kernel stops no process.
    start = f"import fcntl, os, termios; fcntl.ioctl(0, termios.TIOCSCTTY); os.execvp('bash', {shell})"
    master, slave = pty.openpty()
    with os.fdopen(master, "rb"), os.fdopen(slave, "rb") as terminal:
        done = subprocess.run(
            [sys.executable, "-c", start],
            env={**os.environ, **(environment or {})},
            stdin=terminal,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            text=True,
            timeout=within_s,
        )
    return done.stdout
