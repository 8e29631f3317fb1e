"""Counts of published and processed messages in memory that the processes of one graph share.

A process has one row, which only that process writes. For each topic the row holds how many deliveries its publishers
expect, how many messages its callbacks have finished, and how many subscriptions it has. The sum of all rows shows
whether any message is still in transit or being processed; see docs/decisions/simulated-time.md.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import tempfile
import threading
from pathlib import Path

import numpy as np
import numpy.typing as npt

from icu_common.adapters.processes.process_identity import is_alive
from icu_common.adapters.steps.step_layout import (
    BUSY,
    BYTES_READ,
    BYTES_WRITTEN,
    DELIVERIES,
    FINISHED,
    HEAD,
    LEDGER_VARIABLE,
    MATCHED,
    MAX_PROCESSES,
    MAX_TOPICS,
    NAME_BYTES,
    NAMES_BYTES,
    ORIGIN,
    PID,
    SHOWN,
    SIZE,
    SUBSCRIPTIONS,
    TABLE,
    TIME,
    TOPICS,
    locked,
)

__all__ = ["BYTES_READ", "BYTES_WRITTEN", "LEDGER_VARIABLE", "Counts", "StepLedger", "ledger_path"]

Counts = npt.NDArray[np.int64]


def ledger_path(domain: str, namespace: str) -> Path:
    """Return the path of the ledger of this user's graph in a ROS domain and namespace."""
    key = hashlib.sha256(f"{os.getuid()} {domain or '0'} {namespace.strip('/')}".encode()).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"icu_gantry_steps_{key}"


class StepLedger:
    """The shared table; a counting process calls :meth:`register` first.

    Parameters
    ----------
    path
        The file; it is created empty if it does not exist.

    Raises
    ------
    OSError
        If the file cannot be created or has another size.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            with locked(descriptor):
                size = os.fstat(descriptor).st_size
                if size not in (0, SIZE):
                    raise OSError(f"{path}: {size} bytes, a step ledger has {SIZE}; delete it")
                os.truncate(descriptor, SIZE)
            self._map = mmap.mmap(descriptor, SIZE)
        except OSError:
            os.close(descriptor)
            raise
        self._descriptor = descriptor
        self._table: Counts = np.frombuffer(self._map, np.int64, offset=NAMES_BYTES).reshape(TABLE)
        # A view of the same memory: access to one element costs a third of numpy's, and each callback counts.
        self._cells = memoryview(self._map)[NAMES_BYTES:].cast("q")
        self._columns: dict[str, int] = {}
        self._row = -1
        self._busy = 0
        self._lock = threading.Lock()

    # --- what a process counts ---------------------------------------------------------------------------------------

    def register(self) -> None:
        """Take a free row for this process.

        Raises
        ------
        OSError
            If no row is free.
        """
        with locked(self._descriptor):
            free = np.flatnonzero(self._table[HEAD, :, PID] == 0)
            if not free.size:
                raise OSError(f"{self.path}: {MAX_PROCESSES} processes are registered, more cannot be")
            self._row = int(free[0])
            self.forget(self._row)
            self._table[HEAD, self._row, PID] = os.getpid()

    def expect(self, topic: str, count: int = 1) -> None:
        """Count published messages, each once for every subscription that receives it."""
        self._add(DELIVERIES, topic, count)

    def finish(self, topic: str, count: int = 1) -> None:
        """Count messages whose callback has returned."""
        self._add(FINISHED, topic, count)

    def begin_callback(self) -> None:
        """Mark this process as being in a callback."""
        with self._lock:
            self._busy += 1
            self._cells[self._cell(HEAD, BUSY)] = self._busy

    def end_callback(self, topic: str) -> None:
        """Remove the mark of :meth:`begin_callback`, and count its message as finished."""
        finished = self._cell(FINISHED, self._column(topic))
        with self._lock:
            self._busy -= 1
            self._cells[self._cell(HEAD, BUSY)] = self._busy
            self._cells[finished] += 1

    def finish_all(self, topic: str) -> None:
        """Count as finished the lost messages of a topic to which only this process subscribes."""
        column = self._column(topic)
        missing = self._table[DELIVERIES, :, column].sum() - self._table[FINISHED, :, column].sum()
        self._add(FINISHED, topic, int(missing))

    def subscribe(self, topic: str, change: int = 1) -> None:
        """Count a new subscription, or one that has been destroyed (-1)."""
        self._add(SUBSCRIPTIONS, topic, change)

    def leave(self) -> None:
        """Stop expecting messages, as this process is ending; messages that it still publishes count."""
        self._table[SUBSCRIPTIONS, self._row] = 0

    def match(self, topic: str, count: int) -> None:
        """Set how many subscriptions this process's publisher of a topic has found."""
        self._table[MATCHED, self._row, self._column(topic)] = count + 1  # 0 means no publisher

    def show(self) -> None:
        """Declare that :meth:`match` has been called for every publisher of this process."""
        self._cells[self._cell(HEAD, SHOWN)] = 1

    def subscriptions(self, topic: str) -> int:
        """Return how many subscriptions of a topic all registered processes have."""
        return int(self._table[SUBSCRIPTIONS, :, self._column(topic)].sum())

    def finished(self, topic: str) -> int:
        """Return how many messages of a topic all registered processes have finished."""
        return int(self._table[FINISHED, :, self._column(topic)].sum())

    def _add(self, kind: int, topic: str, change: int) -> None:
        cell = self._cell(kind, self._column(topic))
        with self._lock:
            self._cells[cell] += change

    def _cell(self, kind: int, column: int) -> int:
        return (kind * MAX_PROCESSES + self._row) * MAX_TOPICS + column

    def _column(self, topic: str) -> int:
        column = self._columns.get(topic)
        if column is None:
            column = self._columns[topic] = self._find_column(topic)
        return column

    def _find_column(self, topic: str) -> int:
        name = topic.encode()
        if len(name) >= NAME_BYTES:
            raise ValueError(f"topic {topic!r}: {len(name)} bytes, a ledger takes {NAME_BYTES - 1}")
        with locked(self._descriptor):
            names = self.topics()
            if topic in names:
                return names.index(topic)
            if len(names) == MAX_TOPICS:
                raise ValueError(f"topic {topic!r}: the ledger has {MAX_TOPICS} topics, more cannot be")
            begin = len(names) * NAME_BYTES
            self._map[begin : begin + len(name)] = name
            self._table[HEAD, 0, TOPICS] = len(names) + 1
            return len(names)

    # --- what an observer reads --------------------------------------------------------------------------------------

    def topics(self) -> list[str]:
        """Return the names of all topics, in the order of the columns."""
        data = self._map[:NAMES_BYTES]
        begins = range(0, self._topic_count() * NAME_BYTES, NAME_BYTES)
        return [data[begin : begin + NAME_BYTES].rstrip(b"\0").decode() for begin in begins]

    def processes(self) -> dict[int, int]:
        """Return row -> process number of all registered processes."""
        return {int(row): int(self._table[HEAD, row, PID]) for row in np.flatnonzero(self._table[HEAD, :, PID])}

    def is_busy(self, row: int) -> bool:
        """Return whether the process of a row is in a callback."""
        return bool(self._table[HEAD, row, BUSY])

    def suspend(self, row: int) -> Counts:
        """Expect nothing from a process any more; return its subscription counts for :meth:`resume`."""
        counts: Counts = self._table[SUBSCRIPTIONS, row].copy()
        self._table[SUBSCRIPTIONS, row] = 0
        return counts

    def resume(self, row: int, counts: Counts) -> None:
        """Expect deliveries to a process again: for the subscriptions in ``counts`` and those made since."""
        self._table[SUBSCRIPTIONS, row] += counts

    def is_shown(self, row: int) -> bool:
        """Return whether the process of a row has written the subscription counts of all of its publishers."""
        return bool(self._table[HEAD, row, SHOWN])

    def progress(self, row: int) -> int:
        """Return how many messages a process has finished."""
        return int(self._table[FINISHED, row].sum())

    def forget(self, row: int) -> None:
        """Free the row of a process that has ended."""
        self._table[1:, row] = 0
        self._table[HEAD, row, [PID, BUSY, SHOWN]] = 0

    def forget_ended(self) -> None:
        """Free the rows of all processes that have ended."""
        for row, process in self.processes().items():
            if not is_alive(process):
                self.forget(row)

    def restart(self, time_ns: int = 0) -> None:
        """Start a new run: forget ended processes and the previous time; ``time_ns`` is 0 if there is no time yet."""
        self.forget_ended()
        self._table[HEAD, 0, [TIME, ORIGIN]] = time_ns

    @property
    def time_ns(self) -> int:
        """Newest time that was published on ``/clock``, in ns; 0 before the first."""
        return int(self._table[HEAD, 0, TIME])

    @time_ns.setter
    def time_ns(self, value: int) -> None:
        if not self._table[HEAD, 0, TIME]:
            self._table[HEAD, 0, ORIGIN] = value
        self._table[HEAD, 0, TIME] = value

    @property
    def origin_ns(self) -> int:
        """First time that was set, in ns: the common origin of a restarted bench and the board, which continues."""
        return int(self._table[HEAD, 0, ORIGIN])

    def totals(self) -> tuple[Counts, Counts, Counts]:
        """Return finished, expected and subscription counts of each topic, (topics,), of all processes together.

        Finished counts are read first, so messages published meanwhile count as outstanding, never as finished.
        """
        count = self._topic_count()
        finished = self._table[FINISHED, :, :count].sum(axis=0)
        return (
            finished,
            self._table[DELIVERIES, :, :count].sum(axis=0),
            self._table[SUBSCRIPTIONS, :, :count].sum(axis=0),
        )

    def by_process(self) -> tuple[Counts, Counts, Counts]:
        """Return copies, (processes, topics), of finished, subscription and matched counts. A matched count is 0 for no
        publisher, otherwise the number of subscriptions found plus 1."""
        count = self._topic_count()
        finished, subscriptions, matched = (
            self._table[kind, :, :count].copy() for kind in (FINISHED, SUBSCRIPTIONS, MATCHED)
        )
        return finished, subscriptions, matched

    def _topic_count(self) -> int:
        return int(self._table[HEAD, 0, TOPICS])

    def close(self) -> None:
        """Release the row and close the file."""
        if self._row >= 0:
            self.forget(self._row)
            self._row = -1
        os.close(self._descriptor)
