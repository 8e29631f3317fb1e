"""Reads and writes standard rosbag2 bags (sqlite3 and MCAP) by the rosbags library, with errors that say what to do.

Messages stay the bytes that the middleware delivered (CDR). A bag is written so that it can be read whenever its writer
ends: the disk is watched and the bag closed before it is full, and all that was received is handed to the operating
system within a second. What was cut off nevertheless is made whole by :func:`repair`.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import shlex
import shutil
import sqlite3
import struct
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import apsw
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, ReaderError, StoragePlugin, Writer, WriterError
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from scope_bench.core.mcap_records import whole_messages

STORAGES = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
_CHECKPOINT_S = 1.0
_BETWEEN_DISK_CHECKS = 1 << 20
_CHECKSUM_AT = 9 + 3 * 8  # in a chunk's record, after its kind and length, two times and a size
_ZSTD: Any = importlib.import_module(
    "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
)  # as rosbags
_READ_ERRORS = (
    *(ReaderError, apsw.Error, OSError, ValueError, KeyError, TypeError, AssertionError, EOFError),
    # RuntimeError is lz4's; the last two come of lengths that are damaged.
    *(_ZSTD.ZstdError, RuntimeError, struct.error, OverflowError, MemoryError),
)
_ZIPPED, _PIECE = ".zstd", 1 << 16
_ZSTD_FRAME = b"\x28\xb5\x2f\xfd"
"""What begins so is no CDR, of which the first byte is 0: a message that was compressed by itself. Only metadata.yaml
says that messages are, which a single file and a recording that was cut off have not."""
T = TypeVar("T")


class BagError(Exception):
    """A bag cannot be read or written; the text says why, and what can be done."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagTopic:
    """One topic of a bag.

    Parameters
    ----------
    name, type
        As in ROS, the type as ``package/msg/Name``.
    count
        Messages.
    qos
        The profiles that its publishers offered.
    """

    name: str
    type: str
    count: int = 0
    qos: tuple[Qos, ...] = ()


def is_known(kind: str) -> bool:
    """Return whether a bag can describe messages of this type without being given its definition."""
    return kind in _known_types().types


@functools.cache
def _known_types() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


class _McapWriter(McapWriter):
    """Writes the checksum of each chunk, by which damage is seen later; rosbags leaves it out."""

    def close_chunk(self) -> None:
        if not self.chunk.msgs:
            self.chunk.message_start_time = 0  # as the format wants it; rosbags leaves the end of all times there
        start, checksum = self.bio.tell(), zlib.crc32(self.chunk.bio.getvalue())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _CHECKSUM_AT)
        self.bio.write(checksum.to_bytes(4, "little"))
        self.bio.seek(end)


class _Writer(Writer):
    STORAGE_PLUGINS = {**Writer.STORAGE_PLUGINS, StoragePlugin.MCAP: _McapWriter}  # noqa: RUF012


class BagWriter:
    """Writes one bag; ``close`` makes it complete.

    Parameters
    ----------
    path
        Folder that will be made.
    storage
        ``sqlite3`` or ``mcap``.
    keep_free
        Bytes that stay free on the disk: with less the writer refuses, and the bag can still be closed properly.
    types
        Definitions of the message types; those of Jazzy's common interfaces are known.
    zstd
        Compress the whole file; what pictures have in common is then kept once.

    Attributes
    ----------
    due_s
        When, by ``time.monotonic``, somebody has to call :meth:`checkpoint`, unless a message follows before; None: all
        was given to the operating system.

    Raises
    ------
    BagError
        If the folder exists or cannot be made, and from :meth:`write` when the disk is full.
    """

    def __init__(
        self,
        path: Path,
        storage: str = "mcap",
        *,
        keep_free: int = 64 << 20,
        types: Typestore | None = None,
        zstd: bool = False,
    ) -> None:
        self.path, self._keep_free = path, keep_free
        self.types = types or get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Connection] = {}
        self.messages = self.bytes = 0
        self._unchecked = 0
        self.due_s: float | None = None
        self._check_disk(next(place for place in (path.absolute(), *path.absolute().parents) if place.is_dir()))
        try:
            # The version of metadata.yaml that Jazzy writes.
            self._writer = _Writer(path, version=9, storage_plugin=STORAGES[storage])
            if zstd:
                self._writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
            self._writer.open()
        except (OSError, WriterError, sqlite3.Error) as error:
            raise BagError(f"{path} cannot be made: {error}") from error
        self.checkpoint()  # a file that has not even its beginning is none

    def add_topic(self, topic: BagTopic) -> None:
        """Announce a topic.

        Raises
        ------
        BagError
            If the definition of its type is not known.
        """
        if not _describes(self.types, topic.type):
            raise BagError(f"{topic.name}: the definition of {topic.type} is not known")
        with self._explaining():
            self._connections[topic.name] = self._writer.add_connection(
                topic.name, topic.type, typestore=self.types, offered_qos_profiles=topic.qos
            )
        self._note_change()

    def write(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Append a message that was received at ``stamp_ns``.

        Raises
        ------
        BagError
            If it could not be written; the bag was ended before it and stays readable.
        """
        self._unchecked += len(data)
        if self._unchecked >= _BETWEEN_DISK_CHECKS:
            self._check_disk(self.path)
            self._unchecked = 0
        with self._explaining():
            self._writer.write(self._connections[topic], stamp_ns, data)
        self._note_change()
        self.messages += 1
        self.bytes += len(data)

    def close(self) -> None:
        """Write the index and metadata.yaml.

        Raises
        ------
        BagError
            If that fails; ``repair`` makes the bag whole.
        """
        if self._writer.storage is not None:
            with self._explaining():
                self._writer.close()

    def checkpoint(self) -> None:
        """Give everything to the operating system, so that it outlives this process; done once a second anyway.

        Not where nothing is written any more: see ``due_s``.
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
        If it cannot be read; with advice where it was only cut off.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        _storage_files(path)
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            raise BagError(f"{path} has no metadata.yaml: its recording was cut off; {_advice(path)}")
        self._reader = self._explained(lambda: Reader(path))
        self._explained(self._reader.open)
        self.types = _types_of(self._reader)

    def _explained(self, call: Callable[[], T]) -> T:
        try:
            return call()
        except _READ_ERRORS as error:
            raise BagError(f"{self.path} is broken: {_reason(error)}; {_advice(self.path)}") from error

    @property
    def topics(self) -> list[BagTopic]:
        """All topics, by name."""
        found = [
            BagTopic(name=c.topic, type=c.msgtype, count=c.msgcount, qos=_qos_of(c)) for c in self._reader.connections
        ]
        return sorted(found, key=lambda topic: topic.name)

    @property
    def start_ns(self) -> int:
        """When the first message was received."""
        return self._reader.start_time if self._reader.message_count else 0

    @property
    def duration_ns(self) -> int:
        """Time from the first to the last message."""
        return max(0, self._reader.duration - 1)

    @property
    def count(self) -> int:
        """Messages."""
        return self._reader.message_count

    def messages(self, topics: Sequence[str] | None = None, start_ns: int = 0) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time of reception in ns, CDR bytes) in the order of time, of all topics or the named ones.

        Raises
        ------
        BagError
            Where the bag is broken, after the messages before that place.
        """
        wanted = [c for c in self._reader.connections if topics is None or c.topic in topics]
        if not wanted:
            return
        rows = self._reader.messages(wanted, start=start_ns or None)
        done = 0
        while True:
            try:
                connection, stamp_ns, stored = next(rows)
                data = _message(bytes(stored))
            except StopIteration:
                return
            except _READ_ERRORS as error:
                where = f"{self.path} is broken after {done} messages"
                raise BagError(f"{where}: {_reason(error)}; {_advice(self.path)}") from error
            done += 1
            yield connection.topic, stamp_ns, data

    def check(self) -> int:
        """Read every message, and return how many there are.

        Raises
        ------
        BagError
            If the bag is broken, also where its index is so and does not lead to all messages.
        """
        count = sum(1 for _ in self.messages())
        if count != self.count:
            raise BagError(f"{self.path} is broken: {count} of {self.count} messages are found; {_advice(self.path)}")
        return count

    def decode(self, data: bytes, msgtype: str) -> Any:
        """Return the message as rosbags' own object, without ROS."""
        return self.types.deserialize_cdr(data, msgtype)

    def close(self) -> None:
        self._reader.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def repair(path: Path, out: Path) -> tuple[int, str]:
    """Write all that can be read of a broken bag into a new one.

    Parameters
    ----------
    path
        The bag's folder, or its .db3 or .mcap file.
    out
        The new bag.

    Returns
    -------
    count, end
        Messages that were saved, and what was left out and why (empty if all up to the file's end was whole).

    Raises
    ------
    BagError
        If there is nothing to read, or ``out`` cannot be written.
    """
    if out.exists():
        raise BagError(f"{out} exists already")
    found = _storage_files(path)
    # A writer that died while it compressed leaves both; the plain one is whole.
    files = [p for p in found if p.suffix != _ZIPPED or p.with_suffix("") not in found]
    if not files:
        raise BagError(f"{path} has no .db3 or .mcap file, compressed (.zstd) or not")
    ends: list[str] = []
    place = next(folder for folder in out.absolute().parents if folder.is_dir())
    try:
        unpacked = tempfile.TemporaryDirectory(prefix=f"{out.name}.unpacked", dir=place)
    except OSError as error:
        raise BagError(f"{out} cannot be made: {error}") from error
    with unpacked as folder:
        plain = {_unpacked(file, Path(folder), ends): file.name for file in files}
        types = _types_in(list(plain))
        with BagWriter(out, "sqlite3" if next(iter(plain)).suffix == ".db3" else "mcap", types=types) as writer:
            known: dict[str, bool] = {}
            for file, name in plain.items():
                missing: list[str] = []
                try:
                    for topic, stamp_ns, data in _salvaged(file, missing):
                        if topic.name not in known:
                            known[topic.name] = _describes(types, topic.type)
                            if known[topic.name]:
                                writer.add_topic(topic)
                            else:
                                missing.append(f"{topic.name}: the definition of {topic.type} is not known")
                        if known[topic.name]:
                            writer.write(topic.name, stamp_ns, data)
                except (*_READ_ERRORS, sqlite3.Error) as error:
                    missing.append(_reason(error))
                ends += [f"{name}: {reason}" for reason in missing]
            count = writer.messages
    return count, "; ".join(ends)


def _storage_files(path: Path) -> list[Path]:
    """Return the .db3 and .mcap files of a bag, compressed or not; there may be none where metadata.yaml is."""
    try:
        if not path.exists():
            raise BagError(f"{path} does not exist")
        inside = sorted(path.iterdir()) if path.is_dir() else [path]
        found = [p for p in inside if _plain_name(p).endswith((".db3", ".mcap"))]
        described = [p for p in inside if p != path and p.name == "metadata.yaml"]
        for file in (*found, *described):
            with file.open("rb"):
                pass
    except OSError as error:
        raise BagError(f"{error.filename} cannot be read: {error.strerror}") from error
    if not found and not described:
        raise BagError(f"{path} is no bag: a folder with one, or a .mcap or .db3 file, is needed")
    return found


def _plain_name(file: Path) -> str:
    return file.name.removesuffix(_ZIPPED)


def _unpacked(file: Path, folder: Path, ends: list[str]) -> Path:
    """Return the file in its full size, or what can be unpacked of it; ``ends`` gets why that is not all."""
    if file.suffix != _ZIPPED:
        return _filled_up(file, folder, ends)
    plain = folder / _plain_name(file)
    unzip = _ZSTD.ZstdDecompressor()
    with file.open("rb") as source, plain.open("wb") as target:
        try:
            # In small pieces: of the one with the damage nothing comes out.
            while not unzip.eof and (piece := source.read(_PIECE)):
                target.write(unzip.decompress(piece))
        except (_ZSTD.ZstdError, OSError) as error:
            ends.append(f"{file.name} could not be unpacked further than {target.tell()} bytes: {error}")
        else:
            if not unzip.eof:
                ends.append(f"{file.name} was cut off")
    if not unzip.eof:
        try:
            _fill_up(plain)
        except OSError as error:
            raise BagError(f"{file} cannot be unpacked: {error}") from error
    return plain


def _sqlite_size(plain: Path) -> tuple[int, int]:
    """Return the size of a page, and the whole that a sqlite file says it has; zeros for any other file."""
    with plain.open("rb") as file:
        head = file.read(32)
    if not head.startswith(b"SQLite format 3\0") or len(head) < 32:
        return 0, 0
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    return page, page * int.from_bytes(head[28:32], "big")


def _fill_up(plain: Path) -> None:
    """Give a sqlite file that is too short the size in its header: the pages that are there can then be read.

    A second one beside it has other bytes in place of those that are missing: what differs between both is made up.
    """
    page, size = _sqlite_size(plain)
    if size <= (there := plain.stat().st_size):
        return
    there -= there % page
    with plain.open("r+b") as file:
        file.truncate(there)
    with Path(shutil.copyfile(plain, _twin(plain))).open("ab") as file:
        for begin in range(there, size, _PIECE):
            file.write(b"\xff" * min(_PIECE, size - begin))
    with plain.open("r+b") as file:
        file.truncate(size)


def _twin(plain: Path) -> Path:
    return plain.with_name(f"twin of {plain.name}")


def _filled_up(file: Path, folder: Path, ends: list[str]) -> Path:
    """Return the file, or a copy in its full size of a sqlite file that was cut off."""
    journals = (file.with_name(file.name + end) for end in ("-journal", "-wal"))
    if _sqlite_size(file)[1] <= file.stat().st_size or any(path.exists() for path in journals):
        return file
    ends.append(f"{file.name} was cut off")
    try:
        copy = Path(shutil.copyfile(file, folder / file.name))
        _fill_up(copy)
    except OSError as error:
        raise BagError(f"{file} cannot be copied: {error}") from error
    return copy


def _salvaged(file: Path, missing: list[str]) -> Iterator[tuple[BagTopic, int, bytes]]:
    """Yield the messages; ``missing`` gets what was left out, and why."""
    damaged = 0
    try:
        for topic, stamp_ns, stored in _stored(file, missing):
            try:
                data = _message(stored)
            except (_ZSTD.ZstdError, MemoryError):  # of a length that is damaged
                damaged += 1
                continue
            yield topic, stamp_ns, data
    finally:
        if damaged:
            missing.append(f"{damaged} messages cannot be unpacked")


def _message(stored: bytes) -> bytes:
    return bytes(_ZSTD.decompress(stored)) if stored.startswith(_ZSTD_FRAME) else stored


def _stored(file: Path, missing: list[str]) -> Iterator[tuple[BagTopic, int, bytes]]:
    if file.suffix == ".mcap":
        with file.open("rb") as stream:
            for channel, stamp_ns, data in whole_messages(stream, _UNPACK, missing):
                yield _topic(channel.topic, channel.msgtype, channel.qos), stamp_ns, data
        return
    with contextlib.closing(_rolled_back(file)) as database:
        rows = _rows(database)
        if _twin(file).exists():
            with contextlib.closing(_rolled_back(_twin(file))) as other:
                yield from (row for row, again in zip(rows, _rows(other)) if row == again)
        else:
            yield from rows


def _rows(database: sqlite3.Connection) -> Iterator[tuple[BagTopic, int, bytes]]:
    rows = database.execute(
        "SELECT name, type, offered_qos_profiles, timestamp, data "
        "FROM messages JOIN topics ON topics.id = messages.topic_id ORDER BY messages.id"
    )
    for name, kind, qos, stamp_ns, data in rows:
        yield _topic(name, kind, qos), stamp_ns, data


@functools.cache
def _topic(name: str, kind: str, qos: str) -> BagTopic:
    return BagTopic(name=name, type=kind, qos=tuple(parse_qos(qos)))


def _unpacked_chunk(compression: str, data: bytes) -> bytes:
    try:
        return DECOMPRESSORS[compression](data, 0)
    except (RuntimeError, EOFError, _ZSTD.ZstdError) as error:
        raise ValueError(f"it cannot be unpacked: {error}") from error


_UNPACK: dict[str, Callable[[bytes], bytes]] = {
    name: functools.partial(_unpacked_chunk, name) for name in ("", "lz4", "zstd")
}


def _rolled_back(file: Path) -> sqlite3.Connection:
    # Opening for writing lets sqlite undo what a dead writer had begun (its journal lies beside the file).
    database = sqlite3.connect(f"{file.absolute().as_uri()}?mode=rw", uri=True)
    database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    return database


def _types_in(files: Sequence[Path]) -> Typestore:
    """Return the known types and those that the files define themselves."""
    definitions: dict[str, str] = {}
    for file in files:
        with contextlib.suppress(*_READ_ERRORS, sqlite3.Error):
            if file.suffix == ".mcap":
                with file.open("rb") as stream:
                    definitions |= {c.msgtype: c.definition for c, _, _ in whole_messages(stream, _UNPACK, [])}
            else:
                with contextlib.closing(_rolled_back(file)) as database:
                    rows = database.execute(
                        "SELECT topic_type, encoded_message_definition FROM message_definitions "
                        "WHERE encoding = 'ros2msg'"
                    )
                    definitions |= dict(rows.fetchall())
    return _with_definitions(definitions)


def _types_of(reader: Reader) -> Typestore:
    texts = {c.msgtype: c.msgdef.data for c in reader.connections if c.msgdef.format is MessageDefinitionFormat.MSG}
    return _with_definitions(texts)


def _with_definitions(definitions: dict[str, str]) -> Typestore:
    types = get_typestore(Stores.ROS2_JAZZY)
    for name, text in definitions.items():
        if name not in types.types and text:
            # One that cannot be understood makes only its own topics unknown.
            with contextlib.suppress(TypesysError):
                new = get_types_from_msg(text, name)
                types.register({key: value for key, value in new.items() if key not in types.types})
    return types


def _describes(types: Typestore, kind: str) -> bool:
    """Return whether a type is known with all that it consists of, as a bag's metadata needs it."""
    try:
        types.generate_msgdef(kind, ros_version=2)
        types.hash_rihs01(kind)
    except (TypesysError, KeyError, RecursionError):  # a type may say that it contains itself
        return False
    return True


def _qos_of(connection: Connection) -> tuple[Qos, ...]:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    return tuple(connection.ext.offered_qos_profiles)


def _reason(error: BaseException) -> str:
    """Return the error's text in one line: that of metadata.yaml has several, others have none."""
    return " ".join(str(error).split()) or repr(error)


def _advice(path: Path) -> str:
    return f"save what can be read with: bag_info {shlex.quote(str(path))} --repair NEW_BAG"
