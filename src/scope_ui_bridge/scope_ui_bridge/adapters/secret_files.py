"""Files that only their owner may read, and records that are on disk before anything moves."""

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

from scope_ui_bridge.core.audit import BAD_BYTES, AuditError, Gap, chain_line, line_before, verify
from scope_ui_bridge.core.passwords import User, parse_users

_LOG = logging.getLogger(__name__)


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

    A file that has become as large as ``max_bytes`` gets the next number behind its name, and the chain goes on in a
    new one. None is ever deleted or written again.

    Raises
    ------
    AuditError
        When the existing file's chain is broken: it must be looked at and moved away by a person.
    OSError
        If the file cannot be opened, or another bridge writes it.
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
        if files and files[-1].samefile(path):  # the power went while it was put aside: it is whole under its own name
            files.pop().unlink()
        with path.open(encoding="utf-8", errors=BAD_BYTES) as lines:
            first = next(lines, "")
            # The files before may have been taken to an archive; `page_admin audit` looks at all that are there.
            before = line_before(first) if first or not files else _end_of(files[-1])
            self._count, self._previous = verify(chain([first] if first else [], lines), *before)
        if path.read_bytes()[-1:] not in (b"", b"\n"):  # a whole record whose end of line was lost with the power
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
            self._file.truncate(end)  # a part of it would break the chain for all that follow
            raise
        self._count, self._previous = self._count + 1, digest

    def _put_aside(self) -> None:
        """Begin a new file; where that cannot be done the old one goes on, as a record is worth more than a bound.

        The file's own name always leads to one that this bridge has locked: first the full one, from one moment to the
        next the new one.
        """
        files = older_files(self._path)
        number = int(files[-1].suffix[1:]) + 1 if files else 1
        older, fresh = (self._path.with_name(name.format(self._path.name)) for name in (f"{{}}.{number}", ".{}.new"))
        try:
            fresh.unlink(missing_ok=True)  # of one whose power went
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
    """Return the files that were put aside full, the oldest first: their numbers rise."""
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
    """Whether this program alone writes it from now on, until it closes it or ends: records of two would follow one."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        pass
    return True


def _sync_folder(path: Path) -> None:
    """Wait until the names of the files in its folder are on disk."""
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
