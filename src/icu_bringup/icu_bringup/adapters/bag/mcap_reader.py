"""MCAP reader that returns the times of messages without their contents, and reads files without a complete index."""

from __future__ import annotations

import heapq
import struct
from collections.abc import Collection, Generator, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Connection
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, Msg, msgsrc

Times = npt.NDArray[np.int64]
_MESSAGE, _CHUNK, _MESSAGE_INDEX = 0x05, 0x06, 0x07
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_INDEX_HEAD = struct.Struct("<BQHI")
_LENGTH = struct.Struct("<Q")
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])


class IndexedMcapReader(McapReader):
    """Reads MCAP files of any writer.

    rosbags returns no message of a chunk without a message index, and rejects a file without chunks whose messages are
    not in the order of their times. rosbag2 writes such files with its storage options ``noMessageIndex``,
    ``noChunking`` and ``noSummary``.
    """

    def times(self) -> dict[int, Times]:
        """Return the times of all messages in ns, sorted, by the id of their connection.

        Reads only the indexes, if the file has them.
        """
        found: dict[int, list[Times]] = {c.id: [] for c in self.connections}
        chunks, loose = self._parts()
        for chunk in chunks:
            indexed = self._index_of(chunk)
            if indexed is None:
                for connection, time_ns, _ in self._read([chunk], [], {c.id: c for c in self.connections}, None, None):
                    found[connection.id].append(np.array([time_ns], np.int64))
                continue
            for channel, times in indexed:
                found.setdefault(channel, []).append(times)
        for time_ns, _, _, channel in loose:
            found.setdefault(channel, []).append(np.array([time_ns], np.int64))
        return {i: np.sort(np.concatenate(parts)) if parts else np.zeros(0, np.int64) for i, parts in found.items()}

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield (connection, time in ns, CDR) of these connections in the order of time."""
        chunks, loose = self._parts()
        yield from self._read(chunks, loose, {c.id: c for c in connections}, start, stop)

    def _read(
        self,
        chunks: Collection[ChunkInfo],
        loose: Collection[tuple[int, int, int, int]],
        wanted: dict[int, Connection],
        start: int | None,
        stop: int | None,
    ) -> Iterator[tuple[Connection, int, bytes]]:
        assert self.bio
        first, end = 0 if start is None else start, 2**63 - 1 if stop is None else stop
        sources: list[Iterator[Msg]] = [
            msgsrc(
                chunk,
                wanted,
                # A message outside the times of its chunk means a damaged index: it is left out, and the count differs.
                chunk.message_start_time if start is None else start,
                chunk.message_end_time + 1 if stop is None else stop,
                self.bio,
            )
            for chunk in chunks
            if first <= chunk.message_end_time
            and chunk.message_start_time < end
            # A chunk without a message index may have messages of any topic.
            and (not chunk.channel_count or any(chunk.channel_count.get(i, 0) for i in wanted))
        ]
        chosen = sorted(row for row in loose if row[3] in wanted and first <= row[0] < end)
        sources.append(Msg(t, at, wanted[channel], self._payload(at, size)) for t, at, size, channel in chosen)
        for time_ns, _, connection, data in heapq.merge(*sources, key=lambda one: one.timestamp):
            if connection is not None and data is not None:
                yield connection, time_ns, data

    def _payload(self, at: int, size: int) -> bytes:
        assert self.bio
        self.bio.seek(at)
        return self.bio.read(size)

    def _parts(self) -> tuple[list[ChunkInfo], list[tuple[int, int, int, int]]]:
        """Return the chunks, and (time, position, size, channel) of each message outside of them."""
        if self.chunks:
            return self.chunks, []
        chunks: list[ChunkInfo] = []
        loose: list[tuple[int, int, int, int]] = []
        assert self.bio
        at = self.data_start
        while at + _RECORD.size <= self.data_end:
            self.bio.seek(at)
            kind, length = _RECORD.unpack(self.bio.read(_RECORD.size))
            body = at + _RECORD.size
            if body + length > self.data_end:
                raise ReaderError(f"Truncated record at offset {at}: it ends beyond the data.")
            if kind == _MESSAGE:
                channel, _, time_ns, _ = _MESSAGE_HEAD.unpack(self.bio.read(_MESSAGE_HEAD.size))
                loose.append((time_ns, body + _MESSAGE_HEAD.size, length - _MESSAGE_HEAD.size, channel))
            elif kind == _CHUNK:
                chunks.append(self._chunk(at, length))
            at = body + length
        return chunks, loose

    def _chunk(self, at: int, length: int) -> ChunkInfo:
        assert self.bio
        first_ns, last_ns, size, _, name = _CHUNK_HEAD.unpack(self.bio.read(_CHUNK_HEAD.size))
        compression = self.bio.read(name).decode()
        (packed,) = _LENGTH.unpack(self.bio.read(_LENGTH.size))
        return ChunkInfo(first_ns, last_ns, at, _RECORD.size + length, {}, 0, compression, packed, size, {})

    def _index_of(self, chunk: ChunkInfo) -> list[tuple[int, Times]] | None:
        """Return channel and times of each message index of a chunk, None if it has none."""
        if not chunk.message_index_length:
            return None
        assert self.bio
        self.bio.seek(chunk.chunk_start_offset + chunk.chunk_length)
        block: Any = self.bio.read(chunk.message_index_length)
        found, at = [], 0
        while at + _INDEX_HEAD.size <= len(block):
            kind, length, channel, size = _INDEX_HEAD.unpack_from(block, at)
            begin = at + _INDEX_HEAD.size
            if kind != _MESSAGE_INDEX or size % _ENTRY.itemsize or begin + size > len(block):
                raise ReaderError(f"The message index of the chunk at {chunk.chunk_start_offset} is invalid.")
            entries = np.frombuffer(block, _ENTRY, size // _ENTRY.itemsize, begin)
            found.append((channel, entries["time"].astype(np.int64)))
            at += _RECORD.size + length
        return found
