"""Log file of bring-up: all output of the programs, one file for each run; the oldest files are removed."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import IO

KEPT_RUNS = 5
MAX_BYTES = 8 * 1024 * 1024


class RunLog:
    """Writes ``bring_up.log``; ``bring_up.1.log`` is the run before it, or the earlier part of a long run.

    Parameters
    ----------
    folder
        Folder of the log; created if it does not exist.
    max_bytes
        Maximum size of a file, after which a new file starts.

    Raises
    ------
    OSError
        If the file cannot be created.
    """

    def __init__(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / "bring_up.log"
        self._max_bytes = max_bytes
        self._file: IO[bytes] | None = None
        self._size = 0
        self._open()

    def _open(self) -> None:
        names = [self.path, *(self.path.with_name(f"bring_up.{n}.log") for n in range(1, KEPT_RUNS))]
        if self.path.exists():
            for older, newer in zip(names[:0:-1], names[-2::-1]):
                if newer.exists():
                    newer.replace(older)
        # The log contains the page's one-time sign-in, which is only for this user.
        descriptor = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        self._file, self._size = os.fdopen(descriptor, "wb", buffering=0), 0

    def write(self, line: str) -> None:
        """Write a line with the time of day.

        Raises
        ------
        OSError
            If the disk is full. Later lines are dropped.
        """
        if self._file is None:
            return
        data = f"{time.strftime('%Y-%m-%d %H:%M:%S')} {line}\n".encode(errors="backslashreplace")
        try:
            if self._size and self._size + len(data) > self._max_bytes:
                self._file.close()
                self._open()
            self._size += len(data)
            self._file.write(data)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
