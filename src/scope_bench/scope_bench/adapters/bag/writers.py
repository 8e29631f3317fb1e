"""The writers of rosbags, with checksums, several files, and QoS profiles that change during a recording."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag2, Qos
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from scope_bench.adapters.bag.readers import in_uri

_CHECKSUM_AT = 9 + 3 * 8  # in a chunk's record, after its kind and length, two times and a size


class ChecksumMcapWriter(McapWriter):
    """Writes the checksum of each chunk, by which damage is seen later; rosbags leaves it out."""

    def close_chunk(self) -> None:
        """Write the chunk."""
        if not self.chunk.msgs:
            self.chunk.message_start_time = 0  # as the format wants it; rosbags leaves the end of all times there
        start, checksum = self.bio.tell(), zlib.crc32(self.chunk.bio.getbuffer())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _CHECKSUM_AT)
        self.bio.write(checksum.to_bytes(4, "little"))
        self.bio.seek(end)


class UriSqlite3Writer(Sqlite3Writer):
    """Makes files of any name."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(in_uri(path), compression)
        self.path = path / f"{path.name}.db3"


class PartWriter(Writer):
    """Writes a bag of one file, or of several that follow each other, numbered like those of ``ros2 bag``."""

    STORAGE_PLUGINS = {  # noqa: RUF012
        StoragePlugin.MCAP: ChecksumMcapWriter,
        StoragePlugin.SQLITE3: UriSqlite3Writer,
    }

    def __init__(self, path: Path, **options: Any) -> None:
        super().__init__(path, **options)
        self._parts: list[dict[str, Any]] = []
        self._span_ns = (self.min_timestamp, self.max_timestamp)

    def change_qos(self, connection: Connection, qos: Sequence[Qos]) -> Connection:
        """Return the connection with other profiles, which metadata.yaml will have."""
        assert isinstance(connection.ext, ConnectionExtRosbag2)
        changed = connection._replace(ext=connection.ext._replace(offered_qos_profiles=list(qos)))
        self.connections[self.connections.index(connection)] = changed
        return changed

    def next_part(self) -> None:
        """End the file, and begin the next one with the same topics."""
        assert self.storage is not None
        self.storage.close(self.version, "")
        self._end_part(self.storage.path)
        self.storage = self.STORAGE_PLUGINS[self.storage_plugin](self.path, self.compression_mode)
        topics, counts = self.connections, self.counts
        self.connections, self.counts, self.added_types = [], {}, set()
        for topic in topics:
            assert isinstance(topic.ext, ConnectionExtRosbag2)
            self.add_connection(
                topic.topic,
                topic.msgtype,
                msgdef=topic.msgdef.data,
                rihs01=topic.digest,
                offered_qos_profiles=topic.ext.offered_qos_profiles,
            )
        # What add_connection has made is equal but for the texts of definitions, which callers compare.
        self.connections, self.counts = topics, counts

    def _end_part(self, file: Path) -> None:
        first_ns, last_ns = min(self._span_ns[0], self.min_timestamp), max(self._span_ns[1], self.max_timestamp)
        count = sum(self.counts.values()) - sum(part["message_count"] for part in self._parts)
        numbered = file.with_name(f"{file.stem}_{len(self._parts)}{file.suffix}")
        file.rename(numbered)
        self._parts.append(
            {
                "path": numbered.name,
                "starting_time": {"nanoseconds_since_epoch": self.min_timestamp},
                "duration": {"nanoseconds": max(0, self.max_timestamp - self.min_timestamp)},
                "message_count": count,
            }
        )
        self._span_ns = first_ns, last_ns
        self.min_timestamp, self.max_timestamp = 2**63 - 1, 0

    def close(self) -> None:
        """Write what is missing, and metadata.yaml."""
        assert self.storage is not None
        file = self.storage.path
        super().close()
        if not self._parts:
            return
        self._end_part(file)
        described = yaml.safe_load(self.metapath.read_text("utf-8"))
        first_ns, last_ns = self._span_ns
        described["rosbag2_bagfile_information"] |= {
            "relative_file_paths": [part["path"] for part in self._parts],
            "files": self._parts,
            "starting_time": {"nanoseconds_since_epoch": first_ns},
            "duration": {"nanoseconds": max(0, last_ns - first_ns)},
        }
        new = self.metapath.with_suffix(".yaml.tmp")
        new.write_text(yaml.safe_dump(described), "utf-8")
        new.replace(self.metapath)
