"""Reads and writes standard rosbag2 bags (sqlite3 and MCAP) with the rosbags library; its errors state what to do.

Messages stay the bytes that the middleware delivered (CDR). A bag stays readable whenever its writer ends. The writer
closes the bag before the disk is full, and hands received messages to the operating system within a second.
``bag_repair`` repairs a bag that was truncated nevertheless.
"""

from __future__ import annotations

import contextlib
import importlib
import shlex
import shutil
import sqlite3
import struct
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import apsw
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, ReaderError, StoragePlugin, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from scope_bench.adapters.bag.definitions import decode, describes, hash_of, with_definitions
from scope_bench.adapters.bag.mcap_reader import Times
from scope_bench.adapters.bag.readers import BagFileReader, joined
from scope_bench.adapters.bag.ros1 import conversion_advice, is_ros1
from scope_bench.adapters.bag.writers import PartWriter

STORAGES = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
_CHECKPOINT_S = 1.0
_BETWEEN_DISK_CHECKS = 1 << 20
ZSTD: Any = importlib.import_module(
    "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
)  # as rosbags
READ_ERRORS = (
    *(ReaderError, apsw.Error, OSError, ValueError, KeyError, TypeError, AssertionError, EOFError),
    # lz4 raises RuntimeError; the last two come from damaged lengths.
    *(ZSTD.ZstdError, RuntimeError, struct.error, OverflowError, MemoryError),
)
ZIPPED = ".zstd"
_ZSTD_FRAME = b"\x28\xb5\x2f\xfd"
"""Start of a message that was compressed by itself; the first byte of CDR is 0. Only metadata.yaml states the
compression, and a single file or a truncated recording has none."""
T = TypeVar("T")


class BagError(Exception):
    """A bag cannot be read or written; the text states the reason and a remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagTopic:
    """One topic of a bag.

    Parameters
    ----------
    name, type
        Name as in ROS; type as ``package/msg/Name``.
    count
        Number of messages in the files.
    qos
        The profiles that its publishers offered.
    announced
        Number of messages according to metadata.yaml.
    hash
        Hash of the type's definition in the bag (RIHS01), "" if the bag has none.
    """

    name: str
    type: str
    count: int = 0
    qos: tuple[Qos, ...] = ()
    announced: int = 0
    hash: str = ""


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
            raise BagError(f"{self.path} cannot be written: {error}; {_advice(self.path)}") from error

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


class BagReader:
    """An open bag, as a context manager.

    Parameters
    ----------
    path
        The folder with metadata.yaml, or a single .db3 or .mcap file.

    Raises
    ------
    BagError
        If it cannot be read; with advice if it was only truncated.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        storage_files(path)
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            raise BagError(f"{path} has no metadata.yaml: its recording was cut off; {_advice(path)}")
        self._reader = self._explained(lambda: BagFileReader(path))
        self._explained(self._reader.open)
        self.types = _types_of(self._reader)

    def _explained(self, call: Callable[[], T]) -> T:
        try:
            return call()
        except READ_ERRORS as error:
            raise BagError(f"{self.path} is broken: {reason_of(error)}; {_advice(self.path)}") from error

    @property
    def topics(self) -> list[BagTopic]:
        """All topics, by name."""
        announced = self._reader.announced
        found = [
            BagTopic(
                name=c.topic,
                type=c.msgtype,
                count=c.msgcount,
                qos=_qos_of(c),
                announced=announced.get(key, 0),
                hash=c.digest or hash_of(c.msgtype, c.msgdef),
            )
            for key, c in joined(self._reader.connections).items()
        ]
        return sorted(found, key=lambda topic: (topic.name, topic.type))

    @property
    def start_ns(self) -> int:
        """Time in ns at which the first message was received."""
        return self._reader.start_time if self._reader.message_count else 0

    @property
    def duration_ns(self) -> int:
        """Time in ns from the first to the last message."""
        return max(0, self._reader.duration - 1)

    @property
    def count(self) -> int:
        """Number of messages."""
        return self._reader.message_count

    def messages(
        self, topics: Collection[str | BagTopic] | None = None, start_ns: int = 0, stop_ns: int = 0
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time of reception in ns, CDR bytes) of all topics or the named ones, in order of time.

        Parameters
        ----------
        topics
            Names, or topics if a name has several types; None: all.
        start_ns, stop_ns
            Only messages from, and before, these times; 0: no limit.

        Raises
        ------
        BagError
            If the bag is broken, after the messages before the damage.
        """
        kinds = {(t.name, t.type) for t in topics or () if isinstance(t, BagTopic)}
        wanted = [
            c for c in self._reader.connections if topics is None or c.topic in topics or (c.topic, c.msgtype) in kinds
        ]
        if not wanted:
            return
        rows = self._reader.messages(wanted, start=start_ns or None, stop=stop_ns or None)
        done = 0
        while True:
            try:
                connection, stamp_ns, stored = next(rows)
                data = message_of(bytes(stored))
            except StopIteration:
                return
            except READ_ERRORS as error:
                where = f"{self.path} is broken after {done} messages"
                raise BagError(f"{where}: {reason_of(error)}; {_advice(self.path)}") from error
            done += 1
            yield connection.topic, stamp_ns, data

    def times(self) -> dict[str, Times]:
        """Return the times of reception in ns of all messages, sorted, by topic; contents are not read.

        Raises
        ------
        BagError
            If the index is broken.
        """
        return {topic: times for topic, times in self._explained(self._reader.times).items() if times.size}

    def check(self) -> int:
        """Read every message, and return how many there are.

        Raises
        ------
        BagError
            If the bag is broken, or its index does not lead to all messages.
        """
        count, there = sum(1 for _ in self.messages()), sum(self._reader.announced.values()) or self.count
        if count != there:
            raise BagError(f"{self.path} is broken: {count} of {there} messages found; {_advice(self.path)}")
        return count

    def decode(self, data: bytes, msgtype: str) -> Any:
        """Return the message as rosbags' own object, without ROS."""
        return decode(self.types, data, msgtype)

    def close(self) -> None:
        self._reader.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def storage_files(path: Path) -> list[Path]:
    """Return the .db3 and .mcap files of a bag, compressed or not; there may be none next to metadata.yaml."""
    try:
        if not path.exists():
            raise BagError(f"{path} does not exist")
        if is_ros1(path):
            raise BagError(conversion_advice(path))
        inside = sorted(path.iterdir()) if path.is_dir() else [path]
        found = [p for p in inside if plain_name(p).endswith((".db3", ".mcap"))]
        described = [p for p in inside if p != path and p.name == "metadata.yaml"]
        for file in (*found, *described):
            with file.open("rb"):
                pass
    except OSError as error:
        raise BagError(f"{error.filename} cannot be read: {error.strerror}") from error
    if not found and not described:
        raise BagError(f"{path} is no bag: a folder with one, or a .mcap or .db3 file, is needed")
    return found


def plain_name(file: Path) -> str:
    return file.name.removesuffix(ZIPPED)


def message_of(stored: bytes) -> bytes:
    """Return a stored message, decompressed if it was compressed by itself."""
    return bytes(ZSTD.decompress(stored)) if stored.startswith(_ZSTD_FRAME) else stored


def _types_of(reader: Reader) -> Typestore:
    texts = {c.msgtype: c.msgdef.data for c in reader.connections if c.msgdef.format is MessageDefinitionFormat.MSG}
    return with_definitions(texts)


def _qos_of(connection: Connection) -> tuple[Qos, ...]:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    return tuple(connection.ext.offered_qos_profiles)


def reason_of(error: BaseException) -> str:
    """Return the text of an error in one line: that of metadata.yaml has several lines, others have none."""
    return " ".join(str(error).split()) or repr(error)


def _advice(path: Path) -> str:
    return f"save what can be read with: bag_info {shlex.quote(str(path))} --repair NEW_BAG"
