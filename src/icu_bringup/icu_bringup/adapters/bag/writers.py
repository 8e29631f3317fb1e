"""Writers based on rosbags, with checksums, several files, and QoS profiles that change during a recording."""

from __future__ import annotations

import struct
import zlib
from collections import defaultdict
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag2, Qos
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from icu_bringup.adapters.bag.readers import in_uri

_CHUNK_BYTES = 1 << 20
# Records of MCAP: https://mcap.dev/spec
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQI")
_INDEX = struct.Struct("<BQHI")
_ENTRY = struct.Struct("<QQ")
_OFFSET = struct.Struct("<HQ")
_SPAN = struct.Struct("<QQQQ")


class ChecksumMcapWriter(McapWriter):
    """Writes the checksum of each chunk, so that readers detect damage, and copies a message once.

    rosbags writes no checksum, and copies each message five times.
    """

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Append a message to the chunk."""
        self.message_start_time = min(timestamp, self.message_start_time)
        self.message_end_time = max(timestamp, self.message_end_time)
        self.channel_stats[connection.id] += 1
        chunk = self.chunk
        chunk.message_start_time = min(timestamp, chunk.message_start_time)
        chunk.message_end_time = max(timestamp, chunk.message_end_time)
        chunk.msgs[connection.id].append((timestamp, chunk.bio.tell()))
        chunk.bio.write(_MESSAGE.pack(0x05, _MESSAGE.size - 9 + len(data), connection.id, 0, timestamp, timestamp))
        chunk.bio.write(data)
        if chunk.bio.tell() > _CHUNK_BYTES:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Write the chunk and its indexes."""
        chunk, size = self.chunk, self.chunk.bio.tell()
        # The format requires times of 0 for a chunk without messages.
        first = chunk.message_start_time if chunk.msgs else 0
        last = chunk.message_end_time
        content = chunk.bio.getbuffer()
        packed = self.compressor(chunk.bio.getvalue()) if self.compression else content
        name = _text(self.compression)
        head = _CHUNK.pack(first, last, size, zlib.crc32(content)) + name + _U64.pack(len(packed))
        start = self.bio.tell()
        self.bio.write(b"\x06" + _U64.pack(len(head) + len(packed)) + head)
        self.bio.write(packed)
        indexes_at = end = start + 9 + len(head) + len(packed)
        offsets = []
        for number, messages in chunk.msgs.items():
            offsets.append(_OFFSET.pack(number, end))
            index = b"".join(_ENTRY.pack(*entry) for entry in messages)
            record = _INDEX.pack(0x07, _INDEX.size - 9 + len(index), number, len(index)) + index
            self.bio.write(record)
            end += len(record)
        summary = _SPAN.pack(first, last, start, indexes_at - start) + _U32.pack(len(offsets) * _OFFSET.size)
        summary += b"".join(offsets) + _U64.pack(end - indexes_at) + name + _ENTRY.pack(len(packed), size)
        record_of_chunk = BytesIO()
        record_of_chunk.write(summary)
        self.chunks.append(record_of_chunk)
        self.chunk = PendingChunk(2**63 - 1, 0, BytesIO(), defaultdict(list))


def _text(value: str) -> bytes:
    return _U32.pack(len(value.encode())) + value.encode()


class UriSqlite3Writer(Sqlite3Writer):
    """Creates files with any name."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(in_uri(path), compression)
        self.path = path / f"{path.name}.db3"


class PartWriter(Writer):
    """Writes a bag of one file, or of several numbered like those of ``ros2 bag``."""

    STORAGE_PLUGINS = {  # noqa: RUF012
        StoragePlugin.MCAP: ChecksumMcapWriter,
        StoragePlugin.SQLITE3: UriSqlite3Writer,
    }

    def __init__(self, path: Path, **options: Any) -> None:
        super().__init__(path, **options)
        self._parts: list[dict[str, Any]] = []
        self._span_ns = (self.min_timestamp, self.max_timestamp)

    def change_qos(self, connection: Connection, qos: Sequence[Qos]) -> Connection:
        """Return the connection with other profiles, which are written to metadata.yaml."""
        assert isinstance(connection.ext, ConnectionExtRosbag2)
        changed = connection._replace(ext=connection.ext._replace(offered_qos_profiles=list(qos)))
        self.connections[self.connections.index(connection)] = changed
        return changed

    def next_part(self) -> None:
        """Close the file, and start the next one with the same topics."""
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
        # The new connections differ in the texts of definitions, which callers compare.
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
        """Write the rest of the last file, and metadata.yaml."""
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
