"""Readers based on rosbags that trust the files: metadata.yaml decides the QoS and nothing else.

rosbags joins a topic of metadata.yaml with one of a file only if both have the same QoS, and returns no message of a
topic whose QoS a user has edited. It also trusts the times and counts of metadata.yaml.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Generator, Iterable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from icu_bringup.adapters.bag.mcap_reader import IndexedMcapReader, Times


def in_uri(path: Path) -> Path:
    """Return a path escaped for the URI with which rosbags opens sqlite: ``#``, ``?`` and ``%`` are special there."""
    return Path(quote(os.fsencode(path)))


class UriSqlite3Reader(Sqlite3Reader):
    """Opens files with any name."""

    def __init__(self, path: Path) -> None:
        super().__init__(in_uri(path))

    def times(self) -> dict[int, Times]:
        """Return the times of all messages in ns, sorted, by the id of their connection; no message is read."""
        assert self.dbconn
        found: dict[int, Times] = {}
        for connection in self.connections:
            rows = self.dbconn.execute("SELECT timestamp FROM messages WHERE topic_id = ?", (connection.id,))
            found[connection.id] = np.sort(np.fromiter((time_ns for (time_ns,) in rows), np.int64))
        return found


class JoinedDirectoryReader(DirectoryReader):
    """Joins metadata.yaml and the files by topic and type.

    Attributes
    ----------
    announced
        Messages that metadata.yaml announces, by topic and type.
    """

    STORAGE_PLUGINS = {**DirectoryReader.STORAGE_PLUGINS, "sqlite3": UriSqlite3Reader, "mcap": IndexedMcapReader}  # noqa: RUF012

    def open(self) -> None:
        """Open the files, and read counts and times from them."""
        super().open()
        self.announced = {(c.topic, c.msgtype): c.msgcount for c in self.connections}
        stored = joined(c for storage in self.storages for c in storage.connections)
        described = {key: c for c in self.connections if (key := (c.topic, c.msgtype)) not in stored}
        found = [
            *(
                _described_by(next((c for c in self.connections if (c.topic, c.msgtype) == key), file), file)
                for key, file in stored.items()
            ),
            *(c._replace(msgcount=0) for c in described.values()),
        ]
        self.connections = [c._replace(id=number, owner=self) for number, c in enumerate(found, 1)]
        spans = [s.metadata for s in self.storages if s.metadata.message_count]
        start, end = min((s.start_time for s in spans), default=2**63 - 1), max((s.end_time for s in spans), default=0)
        self.metadata = self.metadata._replace(
            duration=max(0, end - start),
            start_time=start,
            end_time=end,
            message_count=sum(s.message_count for s in spans),
        )

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield the messages of these connections, file by file; see :class:`DirectoryReader`."""
        wanted = {(c.topic, c.msgtype): c for c in connections}
        for storage in self.storages:
            mine = {c.id: wanted[c.topic, c.msgtype] for c in storage.connections if (c.topic, c.msgtype) in wanted}
            if mine:
                chosen = [c for c in storage.connections if c.id in mine]
                for connection, stamp_ns, data in storage.messages(chosen, start, stop):
                    yield mine[connection.id], stamp_ns, data


def _described_by(metadata: Connection, file: Connection) -> Connection:
    """Return a file's connection with the QoS of metadata.yaml, which has none before version 4."""
    assert isinstance(metadata.ext, ConnectionExtRosbag2) and isinstance(file.ext, ConnectionExtRosbag2)
    qos = metadata.ext.offered_qos_profiles or file.ext.offered_qos_profiles
    return file._replace(
        ext=file.ext._replace(offered_qos_profiles=qos),
        digest=file.digest or metadata.digest,
        msgdef=metadata.msgdef if file.msgdef.format is MessageDefinitionFormat.NONE else file.msgdef,
    )


def joined(connections: Iterable[Connection]) -> dict[tuple[str, str], Connection]:
    """Return one connection for each topic and type, with the total message count and all QoS profiles."""
    found: dict[tuple[str, str], Connection] = {}
    for new in connections:
        old = found.setdefault((new.topic, new.msgtype), new)
        if old is not new:
            assert isinstance(old.ext, ConnectionExtRosbag2) and isinstance(new.ext, ConnectionExtRosbag2)
            profiles = old.ext.offered_qos_profiles
            profiles = profiles + [qos for qos in new.ext.offered_qos_profiles if qos not in profiles]
            found[new.topic, new.msgtype] = old._replace(
                msgcount=old.msgcount + new.msgcount, ext=old.ext._replace(offered_qos_profiles=profiles)
            )
    return found


class BagFileReader(Reader):
    """Reads a folder or a single file."""

    STORAGE_PLUGINS = {  # noqa: RUF012
        **Reader.STORAGE_PLUGINS,
        "dir": JoinedDirectoryReader,
        ".db3": UriSqlite3Reader,
        ".mcap": IndexedMcapReader,
    }

    @property
    def announced(self) -> dict[tuple[str, str], int]:
        """Messages that metadata.yaml announces, by topic and type; empty for a single file."""
        storage: Any = self.storage
        return dict(storage.announced) if isinstance(storage, JoinedDirectoryReader) else {}

    def times(self) -> dict[str, Times]:
        """Return the times of all messages in ns, sorted, by topic; message contents are not read."""
        storages: Any = self.storage.storages if isinstance(self.storage, JoinedDirectoryReader) else [self.storage]
        found: dict[str, list[Times]] = {}
        for storage in storages:
            times = storage.times()
            for connection in storage.connections:
                found.setdefault(connection.topic, []).append(times[connection.id])
        return {topic: np.sort(np.concatenate(parts)) for topic, parts in found.items()}
