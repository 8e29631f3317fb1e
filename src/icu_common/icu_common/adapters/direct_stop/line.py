"""Socket on which a machine's guard receives stops, independent of the graph.

Its name follows from the ROS domain and the resolved name of the machine's topic ``stop_request``, so a publisher of
that topic finds the socket without a parameter.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import socket
import stat
import tempfile
from pathlib import Path

from icu_common.core.configuration.text_bounds import plain

STOP_BYTES = 200
"""Maximum size of a reason in bytes."""


def guard_folder() -> Path:
    """Return this user's folder for the guard's sockets, created if necessary; no other user can enter it.

    Raises
    ------
    OSError
        If it cannot be created, or is open to other users.
    """
    folder = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()) / f"icu_gantry_guard_{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode) or found.st_mode & 0o077:
        raise PermissionError(f"{folder} is open to other users, or is not a folder")
    return folder


def stop_path(domain: int, topic: str) -> Path:
    """Return the path of the stop socket of the machine with this ``stop_request`` topic in a ROS domain."""
    return guard_folder() / f"stop_{hashlib.sha256(f'{domain} {topic}'.encode()).hexdigest()[:16]}"


def open_stop_socket(path: Path) -> socket.socket:
    """Return a non-blocking socket that receives stops; it replaces a socket that a killed program has left behind.

    Raises
    ------
    OSError
        If the socket cannot be created.
    """
    path.unlink(missing_ok=True)
    made = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    made.setblocking(False)
    try:
        made.bind(bytes(path))
    except OSError:
        made.close()
        raise
    return made


def received_stop(stops: socket.socket) -> str | None:
    """Return the reason of the next waiting stop, cut and escaped; None if there is none."""
    with contextlib.suppress(BlockingIOError):
        return plain(stops.recv(STOP_BYTES).decode("ascii", "replace"))
    return None


def send_stop(path: Path, reason: str) -> bool:
    """Request a stop; return whether a guard received it. Never waits."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender, contextlib.suppress(OSError):
        sender.setblocking(False)
        sender.sendto(reason.encode("ascii", "replace")[:STOP_BYTES], bytes(path))
        return True
    return False
