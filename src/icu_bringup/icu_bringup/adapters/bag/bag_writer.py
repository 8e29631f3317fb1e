"""Writes one standard bag; it stays readable whenever its writer ends."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from icu_bringup.adapters.bag.bags import BagError, BagTopic, advice
from icu_bringup.adapters.bag.definitions import describes
from icu_bringup.adapters.bag.writers import PartWriter

STORAGES = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
_CHECKPOINT_S = 1.0
_BETWEEN_DISK_CHECKS = 1 << 20


class BagWriter:
    """Writes one bag; ``close`` makes it complete.

    Parameters
    ----------
    path
        Folder to create.
    storage
        ``sqlite3`` or ``mcap``.
    keep_free
        Bytes that stay free on the disk: with less the writer rejects messages and can still close the bag properly.
    types
        Definitions of the message types; those of Jazzy's common interfaces are known.
    zstd
        Compress the whole file; data that images have in common is then stored once.
    zstd_chunks
        Compress each chunk of an MCAP file during writing.
    split_bytes, split_ns
        Maximum bytes of messages, and maximum time, of one file; None: one file.

    Attributes
    ----------
    due_s
        Time, by ``time.monotonic``, at which the owner must call :meth:`checkpoint` unless a message follows before;
        None if the operating system has everything.

    Raises
    ------
    BagError
        If the folder exists or cannot be created, and from :meth:`write` when the disk is full.
    """

    def __init__(
        self,
        path: Path,
        storage: str = "mcap",
        *,
        keep_free: int = 64 << 20,
        types: Typestore | None = None,
        zstd: bool = False,
        zstd_chunks: bool = False,
        split_bytes: int | None = None,
        split_ns: int | None = None,
    ) -> None:
        if zstd_chunks and (zstd or storage != "mcap"):
            raise BagError(f"compressed chunks need an MCAP bag that is not compressed as a whole, not {storage}")
        if zstd and (split_bytes or split_ns):
            raise BagError("a bag that is compressed as a whole has one file")
        self._split_bytes, self._split_ns = split_bytes or sys.maxsize, split_ns or sys.maxsize
        self._part_bytes, self._part_begun_ns = 0, 0
        self.path, self._keep_free = path, keep_free
        self.types = types or get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Connection] = {}
        self.messages = self.bytes = 0
        self._unchecked = 0
        self.due_s: float | None = None
        self._check_disk(next(place for place in (path.absolute(), *path.absolute().parents) if place.is_dir()))
        try:
            # The version of metadata.yaml that Jazzy writes.
            self._writer = PartWriter(path, version=9, storage_plugin=STORAGES[storage])
            if zstd or zstd_chunks:
                mode = CompressionMode.FILE if zstd else CompressionMode.STORAGE
                self._writer.set_compression(mode, CompressionFormat.ZSTD)
            self._writer.open()
        except (OSError, WriterError, sqlite3.Error) as error:
            raise BagError(f"{path} cannot be made: {error}") from error
        self.checkpoint()  # a file without its header cannot be read

    def add_topic(self, topic: BagTopic) -> None:
        """Announce a topic.

        Raises
        ------
        BagError
            If the definition of its type is not known.
        """
        if not describes(self.types, topic.type):
            raise BagError(f"{topic.name}: the definition of {topic.type} is not known")
        with self._explaining():
            self._connections[topic.name] = self._writer.add_connection(
                topic.name, topic.type, typestore=self.types, offered_qos_profiles=topic.qos
            )
        self._note_change()

    def change_qos(self, topic: str, qos: Sequence[Qos]) -> None:
        """Replace the profiles of a topic: the file keeps the first ones, metadata.yaml gets the last."""
        self._connections[topic] = self._writer.change_qos(self._connections[topic], qos)

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a message that was received at ``stamp_ns``.

        Raises
        ------
        BagError
            If it cannot be written; the bag has been closed before it and stays readable.
        """
        self._unchecked += len(data)
        if self._unchecked >= _BETWEEN_DISK_CHECKS:
            self._check_disk(self.path)
            self._unchecked = 0
        with self._explaining():
            if self._part_bytes and (
                self._part_bytes + len(data) > self._split_bytes or stamp_ns - self._part_begun_ns >= self._split_ns
            ):
                self._writer.next_part()
                self._part_bytes = 0
            if not self._part_bytes:
                self._part_begun_ns = stamp_ns
            self._part_bytes += len(data)
            self._writer.write(self._connections[topic], stamp_ns, data)
        self._note_change()
        self.messages += 1
        self.bytes += len(data)

    def close(self) -> None:
        """Write the index and metadata.yaml.

        Raises
        ------
        BagError
            If that fails; ``repair`` can then restore the bag.
        """
        if self._writer.storage is not None:
            with self._explaining():
                self._writer.close()

    def checkpoint(self) -> None:
        """Give everything to the operating system, so that it outlives this process.

        Writing does so once a second; when no message follows, the owner calls this: see ``due_s``.
        """
        self.due_s = None
        storage = self._writer.storage
        with self._explaining():
            if isinstance(storage, Sqlite3Writer):
                storage.conn.commit()
            elif isinstance(storage, McapWriter):
                if storage.chunk.bio.tell():
                    storage.close_chunk()
                storage.bio.flush()

    def _note_change(self) -> None:
        now_s = time.monotonic()
        if self.due_s is None:
            self.due_s = now_s + _CHECKPOINT_S
        elif now_s >= self.due_s:
            self.checkpoint()

    def _check_disk(self, place: Path) -> None:
        free = shutil.disk_usage(place).free
        if free < self._keep_free:
            raise BagError(
                f"the disk is full: {free / 1e6:.0f} MB are free at {place}, {self._keep_free / 1e6:.0f} MB are kept"
            )

    @contextlib.contextmanager
    def _explaining(self) -> Iterator[None]:
        try:
            yield
        except (OSError, WriterError, sqlite3.Error) as error:
            with contextlib.suppress(OSError, sqlite3.Error):
                self._writer.abort()
            raise BagError(f"{self.path} cannot be written: {error}; {advice(self.path)}") from error

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
