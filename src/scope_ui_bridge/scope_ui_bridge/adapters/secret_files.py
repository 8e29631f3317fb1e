"""Files that only their owner may read, and audit records that are on disk before a motion starts."""

from __future__ import annotations

import fcntl
import glob
import io
import logging
import math
import os
import time
from collections import deque
from itertools import chain
from pathlib import Path
from typing import Any

from scope_ui_bridge.core.access import User, parse_users
from scope_ui_bridge.core.records import BAD_BYTES, AuditError, Gap, chain_line, line_before, verify

_LOG = logging.getLogger(__name__)


def read_users(path: Path) -> dict[str, User]:
    """Read the passwords file.

    Raises
    ------
    OSError
        If it cannot be read, or if users other than its owner may read it.
    PasswordError
        If a line is invalid.
    """
    mode = path.stat().st_mode & 0o777
    if mode & 0o077:
        raise PermissionError(f"{path} has mode {mode:o}; 600 is needed: it holds hashed passwords")
    with path.open(encoding="utf-8") as lines:
        return parse_users(lines)


def write_secret(path: Path, text: str) -> None:
    """Write a text to ``path`` with mode 0600; the file is replaced as a whole.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    fresh.unlink(missing_ok=True)
    # O_EXCL: never write through a link that another user has created.
    descriptor = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(text + "\n")
    fresh.replace(path)


class AuditFile:
    """Hash-chained audit file; each call returns when its record is on disk.

    A file of ``max_bytes`` or more is renamed with the next number as suffix, and the chain continues in a new file. No
    file is deleted or written again.

    Raises
    ------
    AuditError
        If the existing file's chain is broken: a person must inspect the file and move it away.
    OSError
        If the file cannot be opened, or if another bridge writes it.
    """

    def __init__(self, path: Path, max_bytes: float = math.inf) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path, self._max_bytes = path, max_bytes
        self._told = False
        self._gap: Gap | None = None
        self._file = _open_to_append(path)
        try:
            self._begin(path)
        except (OSError, AuditError):
            self._file.close()
            raise

    def _begin(self, path: Path) -> None:
        if not _lock(self._file) or not os.path.samestat(os.fstat(self._file.fileno()), path.stat()):
            raise BlockingIOError(f"{path} is written by another bridge")
        files = older_files(path)
        if files and files[-1].samefile(path):  # power failed in the rename: the complete file has both names
            files.pop().unlink()
        with path.open(encoding="utf-8", errors=BAD_BYTES) as lines:
            first = next(lines, "")
            # Earlier files may have been archived; `page_admin audit` checks all that exist.
            before = line_before(first) if first or not files else _end_of(files[-1])
            self._count, self._previous = verify(chain([first] if first else [], lines), *before)
        # Power failed before the end of line was written: the record is complete.
        if path.read_bytes()[-1:] not in (b"", b"\n"):
            self._file.write(b"\n")
        _sync_folder(path)

    def append(self, record: dict[str, Any]) -> None:
        """Write one record and wait for the disk.

        A record that cannot be written (OSError) leaves no bytes in the file. The next successful write is preceded by
        a line with the number of lost records and the times of the first and the last.
        """
        try:
            if self._gap is not None:
                self._write(self._gap.record())
                self._gap = None
            self._write(record)
        except OSError:
            wall_s = float(record.get("wall_s", round(time.time(), 3)))
            self._gap = (self._gap or Gap(count=0, from_s=wall_s, until_s=wall_s)).with_one_more(wall_s)
            raise

    def _write(self, record: dict[str, Any]) -> None:
        if os.fstat(self._file.fileno()).st_size >= self._max_bytes:
            self._put_aside()
        line, digest = chain_line(self._count + 1, self._previous, record)
        rest, end = (line + "\n").encode(), os.fstat(self._file.fileno()).st_size
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(end)  # a partial record would break the chain for all later ones
            raise
        self._count, self._previous = self._count + 1, digest

    def _put_aside(self) -> None:
        """Start a new file; if that fails, continue the old one, because a record is worth more than a size limit.

        The file's own name always leads to a file that this bridge has locked: the full one, then, replaced atomically,
        the new one.
        """
        files = older_files(self._path)
        number = int(files[-1].suffix[1:]) + 1 if files else 1
        older, fresh = (self._path.with_name(name.format(self._path.name)) for name in (f"{{}}.{number}", ".{}.new"))
        try:
            fresh.unlink(missing_ok=True)  # left over from a power failure
            file = _open_to_append(fresh)
            _lock(file)
            try:
                os.link(self._path, older)
                try:
                    fresh.replace(self._path)
                except OSError:
                    older.unlink()
                    raise
            except OSError:
                file.close()
                fresh.unlink()
                raise
        except OSError as error:
            if not self._told:
                _LOG.error("%s is full and cannot be put aside, so it grows: %s", self._path, error)
            self._told = True
            return
        self._file.close()
        self._file, self._told = file, False
        _sync_folder(self._path)

    def close(self) -> None:
        """Close the file, after a last try to note lost records."""
        if self._gap is not None and not self._file.closed:
            try:
                self._write(self._gap.record())
            except OSError as error:
                _LOG.error("records lost and not noted in %s: %d: %s", self._path, self._gap.count, error)
        self._file.close()


def older_files(path: Path) -> list[Path]:
    """Return the renamed full files, oldest first: their numbers rise."""
    numbered = (file for file in path.parent.glob(f"{glob.escape(path.name)}.*") if file.suffix[1:].isdecimal())
    return sorted(numbered, key=lambda file: int(file.suffix[1:]))


def _end_of(path: Path) -> tuple[int, str]:
    """Return number and hash of a file's last line."""
    with path.open(encoding="utf-8", errors=BAD_BYTES) as lines:
        last = "".join(deque(lines, maxlen=1))
    try:
        return verify([last], *line_before(last))
    except AuditError as error:
        raise AuditError(f"the last line of {path} is damaged") from error


def _open_to_append(path: Path) -> io.FileIO:
    return os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), "wb", buffering=0)


def _lock(file: io.FileIO) -> bool:
    """Lock a file until it is closed or the program ends; return False if another program has it."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # this file system has no locks
        pass
    return True


def _sync_folder(path: Path) -> None:
    """Write the folder's file names to disk."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
