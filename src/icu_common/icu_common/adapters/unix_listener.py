"""Listening Unix sockets, which have a name in the file system and must not replace a file."""

from __future__ import annotations

import socket
import stat
from pathlib import Path

_LONGEST_PATH = 107
"""Maximum length of a socket's path in bytes; unix(7): 108 with the terminating zero."""
_BACKLOG = 8


def listen_at(path: Path) -> socket.socket:
    """Return a non-blocking socket that listens at ``path``; it replaces a socket that a killed program left there.

    Raises
    ------
    OSError
        If the folder cannot be created, the path is too long for a socket, or the socket cannot be created.
    FileExistsError
        If ``path`` exists and is not a socket.
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
    except OSError as error:  # its text does not name the file
        listener.close()
        raise OSError(f"{path}: {error.strerror}") from error
    listener.listen(_BACKLOG)
    return listener
