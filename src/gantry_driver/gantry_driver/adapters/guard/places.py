"""Paths of the sockets of the guard, its peers, and the kernel's data on threads of a process."""

from __future__ import annotations

import contextlib
import hashlib
import socket
from pathlib import Path

from gantry_driver.core.guard.silence import ThreadSample
from icu_common.adapters.direct_stop.line import guard_folder


def guard_path(port: str) -> Path:
    """Return the path of a port's guard socket; all links to one device give the same path."""
    path = Path(port)
    name = port if "://" in port else path.resolve() if _is_device(path.resolve()) else path.absolute()
    return guard_folder() / hashlib.sha256(str(name).encode()).hexdigest()[:16]


def stylus_path(port: str) -> Path:
    """Return the path of a port's stylus record if none is configured; it is deleted with the user's session."""
    return guard_path(port).with_suffix(".stylus")


def _is_device(target: Path) -> bool:
    """Return whether a path is a permanent device; a pseudo-terminal gets a new number each time."""
    return Path("/dev") in target.parents and target.parent != Path("/dev/pts")


def peer_process(connection: socket.socket) -> int:
    """Return the process number at the other end of a Unix socket."""
    return int.from_bytes(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)[:4], "little")


def sample_threads(process: int) -> dict[int, ThreadSample]:
    """Return a process's threads; empty when it has ended."""
    found: dict[int, ThreadSample] = {}
    with contextlib.suppress(OSError):
        for thread in Path(f"/proc/{process}/task").iterdir():
            with contextlib.suppress(OSError, ValueError, IndexError):
                state = (thread / "stat").read_text(errors="replace").rpartition(")")[2].split()[0]
                cpu_ns, waited_ns = map(int, (thread / "schedstat").read_text().split()[:2])
                found[int(thread.name)] = ThreadSample(runnable=state in "RD", cpu_ns=cpu_ns, waited_ns=waited_ns)
    return found


def received(connection: socket.socket) -> bytes:
    """Return the received bytes, none at the end; a killed guard with unread bytes ends the connection by a reset."""
    try:
        return connection.recv(1024 * 1024)
    except ConnectionResetError:
        return b""
