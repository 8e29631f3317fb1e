"""Layout of the step ledger, and a writer without numpy for processes that must not load numpy.

Everything else is in :mod:`icu_common.adapters.steps.step_ledger`.
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
"""Environment variable with the path of the ledger; without it a process uses its own clock and counts nothing."""
BYTES_READ, BYTES_WRITTEN = "serial:read", "serial:written"
"""Ledger entries for the bytes that a driver has processed and sent."""
MAX_PROCESSES, MAX_TOPICS, NAME_BYTES = 64, 512, 160
HEAD, DELIVERIES, FINISHED, SUBSCRIPTIONS, MATCHED = range(5)
PID, BUSY, TIME, TOPICS, ORIGIN, SHOWN = range(6)
NAMES_BYTES = MAX_TOPICS * NAME_BYTES
TABLE = (5, MAX_PROCESSES, MAX_TOPICS)
SIZE = NAMES_BYTES + 8 * TABLE[0] * TABLE[1] * TABLE[2]
_CELL = struct.Struct("=q")


@contextlib.contextmanager
def locked(descriptor: int) -> Iterator[None]:
    """Lock the ledger's file."""
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        yield
    finally:
        fcntl.flock(descriptor, fcntl.LOCK_UN)


class StepCounts:
    """Reads the time of a ledger and counts the messages that this process has finished on the ledger's topics.

    Parameters
    ----------
    path
        The ledger's file.

    Raises
    ------
    OSError
        If the file does not exist or has another size.
    """

    def __init__(self, path: Path) -> None:
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            if os.fstat(descriptor).st_size != SIZE:
                raise OSError(f"{path} is not a step ledger")
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
        """Count finished messages of a topic; a topic that is not in the ledger is ignored."""
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
