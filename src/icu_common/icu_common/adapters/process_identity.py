"""Names a process so that another one on the same host can see whether it still exists (proc(5))."""

from __future__ import annotations

import contextlib
import functools
import os
import socket
from pathlib import Path


def own_process() -> str:
    """Return this process as text: host, namespace of process numbers, number."""
    return f"{_place()} {os.getpid()}"


def process_number(identity: str) -> int | None:
    """Return the number of a process on this host, None for another host, another container, or no process."""
    place, _, number = identity.rpartition(" ")
    return int(number) if place == _place() and number.isdecimal() else None


def is_alive(number: int) -> bool:
    """Return whether a process exists, stopped or not; one that has ended and was not waited for does not."""
    with contextlib.suppress(OSError, IndexError):
        state = Path(f"/proc/{number}/stat").read_text(errors="replace").rpartition(")")[2].split()[0]
        return state not in "ZX"
    return False


@functools.cache
def _place() -> str:
    # Of containers with the host's name each has its own process numbers.
    return f"{socket.gethostname()} {Path('/proc/self/ns/pid').readlink()}"
