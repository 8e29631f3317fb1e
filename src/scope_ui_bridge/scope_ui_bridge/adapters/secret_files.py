"""Files that only their owner may read, and records that are on disk before anything moves."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from typing import Any

from scope_ui_bridge.core.audit import BAD_BYTES, AuditError, chain_line, verify
from scope_ui_bridge.core.passwords import User, parse_users


def read_users(path: Path) -> dict[str, User]:
    """Read the file of passwords.

    Raises
    ------
    OSError
        If it cannot be read, or others than its owner may read it.
    PasswordError
        If a line is no good.
    """
    mode = path.stat().st_mode & 0o777
    if mode & 0o077:
        raise PermissionError(f"{path} has mode {mode:o}; 600 is needed: it holds hashed passwords")
    with path.open(encoding="utf-8") as lines:
        return parse_users(lines)


def write_secret(path: Path, text: str) -> None:
    """Put a text into ``path`` with mode 0600, replacing the file as a whole.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    fresh.unlink(missing_ok=True)
    # O_EXCL: never through a link that somebody else has put there.
    descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(text + "\n")
    fresh.replace(path)


class AuditFile:
    """Appends chained records; each call returns when the record is on disk.

    Raises
    ------
    AuditError
        When the existing file's chain is broken: it must be looked at and moved away by a person.
    OSError
        If the file cannot be opened, or another bridge writes it.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), "wb", buffering=0)
        try:
            self._begin(path)
        except (OSError, AuditError):
            self._file.close()
            raise

    def _begin(self, path: Path) -> None:
        try:
            # Records of two writers would follow the same one. The lock ends with the process.
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise BlockingIOError(f"{path} is written by another bridge") from error
        except OSError:  # a file system without locks
            pass
        with path.open(encoding="utf-8", errors=BAD_BYTES) as lines:
            self._count, self._previous = verify(lines)
        if path.read_bytes()[-1:] not in (b"", b"\n"):  # a whole record whose end of line was lost with the power
            self._file.write(b"\n")

    def append(self, record: dict[str, Any]) -> None:
        """Write one record and wait for the disk; one that could not be written (OSError) leaves nothing behind."""
        line, digest = chain_line(self._count + 1, self._previous, record)
        rest, end = (line + "\n").encode(), os.fstat(self._file.fileno()).st_size
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(end)  # a part of it would break the chain for all that follow
            raise
        self._count, self._previous = self._count + 1, digest

    def close(self) -> None:
        self._file.close()
