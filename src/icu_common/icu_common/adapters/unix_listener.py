"""Listening on a Unix socket, which is a name in the file system, without taking the place of a file."""

from __future__ import annotations

import socket
import stat
from pathlib import Path

_LONGEST_PATH = 107
"""Bytes; unix(7): 108 with the zero at the end."""
_BACKLOG = 8


def listen_at(path: Path) -> socket.socket:
    """Return a socket that listens at ``path`` and blocks nobody; one that a killed program left there goes.

    Raises
    ------
    OSError
        If the folder cannot be made, the path is too long for a socket, or there can be no socket.
    FileExistsError
        If something else than a socket is there.
    """
    if len(bytes(path)) > _LONGEST_PATH:
        raise OSError(f"{path}: a socket's path may have {_LONGEST_PATH} bytes")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not stat.S_ISSOCK(path.stat().st_mode):
        raise FileExistsError(f"{path} exists and is not a socket")
    path.unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.setblocking(False)
    try:
        listener.bind(bytes(path))
    except OSError as error:  # which names no file
        listener.close()
        raise OSError(f"{path}: {error.strerror}") from error
    listener.listen(_BACKLOG)
    return listener
