"""Repairs a truncated or damaged bag: writes all readable messages into a new bag."""

from __future__ import annotations

import contextlib
import functools
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import yaml
from rosbags.rosbag2.metadata import parse_qos
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS
from rosbags.typesys.store import Typestore

from icu_bringup.adapters.bag.bag_reader import message_of, storage_files
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import READ_ERRORS, ZIPPED, ZSTD, BagError, BagTopic, plain_name, reason_of
from icu_bringup.adapters.bag.definitions import describes, with_definitions
from icu_bringup.core.bag.mcap_records import whole_messages
from icu_common.core.configuration.yaml_text import UNREADABLE

_PIECE = 1 << 16


def repair(path: Path, out: Path) -> tuple[int, str]:
    """Write all readable messages of a broken bag into a new bag.

    Parameters
    ----------
    path
        The bag's folder, or its .db3 or .mcap file.
    out
        The new bag.

    Returns
    -------
    count, end
        Number of saved messages, and the omitted parts with reasons (empty if the file was intact up to its end).

    Raises
    ------
    BagError
        If no message can be read, or ``out`` cannot be written.
    """
    if out.exists():
        raise BagError(f"{out} exists already")
    found = storage_files(path)
    # A writer that died while compressing leaves both files; the uncompressed one is complete.
    files = [p for p in found if p.suffix != ZIPPED or p.with_suffix("") not in found]
    if not files:
        raise BagError(f"{path} has no .db3 or .mcap file, compressed (.zstd) or not")
    ends = [
        f"{name} is missing"
        for name in _listed(path)
        if not {name, name.removesuffix(ZIPPED)} & {p.name for p in found}
    ]
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
                            known[topic.name] = describes(types, topic.type)
                            if known[topic.name]:
                                writer.add_topic(topic)
                            else:
                                missing.append(f"{topic.name}: the definition of {topic.type} is not known")
                        if known[topic.name]:
                            writer.write(topic.name, stamp_ns, data)
                except (*READ_ERRORS, sqlite3.Error) as error:
                    missing.append(reason_of(error))
                ends += [f"{name}: {reason}" for reason in missing]
            count = writer.messages
    return count, "; ".join(ends)


def _listed(path: Path) -> list[str]:
    """Return the names of the files in a bag's metadata.yaml; none if it cannot be read."""
    try:
        described = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))
        return [Path(name).name for name in described["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (OSError, ValueError, LookupError, TypeError, *UNREADABLE):
        return []


def _unpacked(file: Path, folder: Path, ends: list[str]) -> Path:
    """Return the unpacked file, or its readable part; ``ends`` gets the reason for an incomplete file."""
    if file.suffix != ZIPPED:
        return _filled_up(file, folder, ends)
    plain = folder / plain_name(file)
    unzip = ZSTD.ZstdDecompressor()
    with file.open("rb") as source, plain.open("wb") as target:
        try:
            # In small pieces: the damaged piece yields no data.
            while not unzip.eof and (piece := source.read(_PIECE)):
                target.write(unzip.decompress(piece))
        except (ZSTD.ZstdError, OSError) as error:
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
    """Return the page size and the total size stated in a sqlite file; zeros for any other file."""
    with plain.open("rb") as file:
        head = file.read(32)
    if not head.startswith(b"SQLite format 3\0") or len(head) < 32:
        return 0, 0
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    return page, page * int.from_bytes(head[28:32], "big")


def _fill_up(plain: Path) -> None:
    """Extend a truncated sqlite file to the size in its header, so that its existing pages can be read.

    A second copy next to it has other bytes in place of the missing ones: values that differ between both are invented.
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
    """Return the file, or a copy of full size for a truncated sqlite file."""
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
    """Yield the messages; ``missing`` gets the omitted parts and their reasons."""
    damaged = 0
    try:
        for topic, stamp_ns, stored in _stored(file, missing):
            try:
                data = message_of(stored)
            except (ZSTD.ZstdError, MemoryError):  # from a damaged length
                damaged += 1
                continue
            yield topic, stamp_ns, data
    finally:
        if damaged:
            missing.append(f"{damaged} messages cannot be unpacked")


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
    except (RuntimeError, EOFError, ZSTD.ZstdError) as error:
        raise ValueError(f"it cannot be unpacked: {error}") from error


_UNPACK: dict[str, Callable[[bytes], bytes]] = {
    name: functools.partial(_unpacked_chunk, name) for name in ("", "lz4", "zstd")
}


def _rolled_back(file: Path) -> sqlite3.Connection:
    # Opening for writing lets sqlite roll back an unfinished transaction (its journal is next to the file).
    database = sqlite3.connect(f"{file.absolute().as_uri()}?mode=rw", uri=True)
    database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    return database


def _types_in(files: Sequence[Path]) -> Typestore:
    """Return the known types and those defined in the files."""
    definitions: dict[str, str] = {}
    for file in files:
        with contextlib.suppress(*READ_ERRORS, sqlite3.Error):
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
    return with_definitions(definitions)
