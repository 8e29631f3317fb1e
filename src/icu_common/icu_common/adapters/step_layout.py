"""The layout of the ledger of steps, and a writer of it without numpy, for a process that may not load that.

See :mod:`icu_common.adapters.step_ledger`, which has everything else.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import struct
from collections.abc import Iterator
from pathlib import Path

LEDGER_VARIABLE = "ICU_STEP_LEDGER"
"""Environment variable with the path of the ledger; without it a process runs by its own clock and counts nothing."""
BYTES_READ, BYTES_WRITTEN = "serial:read", "serial:written"
"""Entries in which a driver counts the bytes that it has processed and sent."""
MAX_PROCESSES, MAX_TOPICS, NAME_BYTES = 64, 512, 160
HEAD, DELIVERIES, FINISHED, SUBSCRIPTIONS, MATCHED = range(5)
PID, BUSY, TIME, TOPICS, ORIGIN = range(5)
NAMES_BYTES = MAX_TOPICS * NAME_BYTES
TABLE = (5, MAX_PROCESSES, MAX_TOPICS)
SIZE = NAMES_BYTES + 8 * TABLE[0] * TABLE[1] * TABLE[2]
_CELL = struct.Struct("=q")


@contextlib.contextmanager
def locked(descriptor: int) -> Iterator[None]:
    """Hold the ledger's file locked."""
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        yield
    finally:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


class StepCounts:
    """Reads the time of a ledger, and counts what this process has finished of topics that the ledger knows.

    Parameters
    ----------
    path
        The ledger's file, which must be there.

    Raises
    ------
    OSError
        If it is not, or has another size.
    """

    def __init__(self, path: Path) -> None:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            if os.fstat(descriptor).st_size != SIZE:
                raise OSError(f"{path} is no ledger of steps")
            self._map = mmap.mmap(descriptor, SIZE)
        except OSError:
            os.close(descriptor)
            raise
        self._descriptor = descriptor
        self._row = -1

    @property
    def time_s(self) -> float:
        """Newest time of the simulation in seconds; 0 before the first."""
        return self._read(HEAD, 0, TIME) / 1e9

    def finish(self, topic: str, count: int) -> None:
        """Count what this process has dealt with; a topic that the ledger does not know is left out."""
        column = self._column(topic)
        if column < 0 or (self._row < 0 and not self._register()):
            return
        self._write(FINISHED, self._row, column, self._read(FINISHED, self._row, column) + count)

    def _register(self) -> bool:
        with locked(self._descriptor):
            free = (row for row in range(MAX_PROCESSES) if not self._read(HEAD, row, PID))
            self._row = next(free, -1)
            if self._row >= 0:
                self._write(HEAD, self._row, PID, os.getpid())
        return self._row >= 0

    def _column(self, topic: str) -> int:
        name = topic.encode().ljust(NAME_BYTES, b"\0")
        begins = range(0, self._read(HEAD, 0, TOPICS) * NAME_BYTES, NAME_BYTES)
        return next((at // NAME_BYTES for at in begins if self._map[at : at + NAME_BYTES] == name), -1)

    @staticmethod
    def _at(kind: int, row: int, column: int) -> int:
        return NAMES_BYTES + 8 * ((kind * MAX_PROCESSES + row) * MAX_TOPICS + column)

    def _read(self, kind: int, row: int, column: int) -> int:
        return int(_CELL.unpack_from(self._map, self._at(kind, row, column))[0])

    def _write(self, kind: int, row: int, column: int, value: int) -> None:
        _CELL.pack_into(self._map, self._at(kind, row, column), value)
