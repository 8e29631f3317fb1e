"""Identity of a process, by which another process on the same host checks whether it still exists (proc(5))."""

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
    """Return whether a process exists, stopped or not; an ended process that was not waited for does not count."""
    with contextlib.suppress(OSError, IndexError):
        state = Path(f"/proc/{number}/stat").read_text(errors="replace").rpartition(")")[2].split()[0]
        return state not in "ZX"
    return False


@functools.cache
def _place() -> str:
    # Each container has its own process numbers, although containers may have the host's name.
    return f"{socket.gethostname()} {Path('/proc/self/ns/pid').readlink()}"


class ParticipantProcesses:
    """Checks by the identifier of a DDS participant whether its process exists.

    Fast DDS identifiers begin with the vendor (2 bytes), the host (2) and the lower half of the process number (2,
    little-endian).
    """

    def __init__(self) -> None:
        self._own_host = b""

    @property
    def known(self) -> bool:
        """Whether the identifier of this process's own participant is known."""
        return bool(self._own_host)

    def learn(self, own: bytes) -> None:
        """Store the identifier of this process's own participant, if it has this form."""
        if own[4:6] == (os.getpid() & 0xFFFF).to_bytes(2, "little"):
            self._own_host = own[:4]

    def is_alive(self, participant: bytes) -> bool | None:
        """Return whether a participant's process exists; None if that cannot be known, for example on another host."""
        if not self.known or participant[:4] != self._own_host:
            return None
        low = int.from_bytes(participant[4:6], "little")
        return any(is_alive(number) for number in range(low, _process_numbers(), 0x10000) if number)


@functools.cache
def _process_numbers() -> int:
    return int(Path("/proc/sys/kernel/pid_max").read_text())
