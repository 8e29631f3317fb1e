"""Reads the intact part of a truncated or damaged MCAP file: the records up to the first incomplete one.

A recording that ends with a power failure has no summary at its end, and readers reject the file. All required data
also precedes each message (https://mcap.dev/spec, checked with the official library in the tests). A damaged record,
mostly a chunk, is left out: its length shows where the next record begins.
"""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"
_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_FOOTER = struct.Struct("<BQQQI8s")
_MAX_RECORD = 1 << 32


@dataclass(frozen=True, slots=True, kw_only=True)
class McapChannel:
    """A topic: its type, the definition of the type as .msg text (empty for another form), and the QoS as YAML."""

    topic: str
    msgtype: str
    definition: str
    qos: str


class _Fields:
    """Reads the fields of one record from its start."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def take(self, size: int) -> bytes:
        if self._at + size > len(self._data):
            raise EOFError("it is too short")
        self._at += size
        return self._data[self._at - size : self._at]

    def text(self) -> str:
        return self.take(self.number(4)).decode()

    def texts(self) -> dict[str, str]:
        inner = _Fields(self.take(self.number(4)))
        result = {}
        while inner._at < len(inner._data):
            key = inner.text()
            result[key] = inner.text()
        return result

    def rest(self) -> bytes:
        return self._data[self._at :]


def whole_messages(
    stream: BinaryIO, decompress: Mapping[str, Callable[[bytes], bytes]], ends: list[str]
) -> Iterator[tuple[McapChannel, int, bytes]]:
    """Yield (channel, log time in ns, message) in the order of the file, up to the first incomplete record.

    Parameters
    ----------
    stream
        The file, at its start.
    decompress
        Functions that unpack a chunk, by name of the compression; they raise ValueError for a damaged chunk.
    ends
        Gets the parts left out before the end of the file, with reasons.

    Raises
    ------
    ValueError
        If this is not an MCAP file.
    """
    if stream.read(len(MAGIC)) != MAGIC:
        raise ValueError("it does not begin as an MCAP file does")
    reading = _Reading(decompress)
    reading.learn_from_the_end(stream)
    stream.seek(len(MAGIC))
    yield from reading.messages(stream)
    ends += reading.complaints()


class _Reading:
    """State of a file while its records are read."""

    def __init__(self, decompress: Mapping[str, Callable[[bytes], bytes]]) -> None:
        self._decompress = decompress
        self._schemas: dict[int, tuple[str, str]] = {}
        self._channels: dict[int, McapChannel] = {}
        self._damaged: list[str] = []
        self._whole = self._unknown = self._announced = 0
        self._read_until = self._records_end = 0

    def learn_from_the_end(self, stream: BinaryIO) -> None:
        """Read topics and message count from the summary: the chunk that declares a topic may be damaged."""
        start = stream.seek(0, 2) - _FOOTER.size
        if start < len(MAGIC):
            return
        stream.seek(start)
        _, _, summary, _, _, magic = _FOOTER.unpack(stream.read(_FOOTER.size))
        if magic != MAGIC:
            return
        self._records_end = start + _FOOTER.size - len(MAGIC)
        if 0 < summary < start:
            stream.seek(summary)
            with contextlib.suppress(EOFError, ValueError):
                while stream.tell() < start:
                    self._take(*_record(stream))
        self._unknown = 0

    def messages(self, stream: BinaryIO) -> Iterator[tuple[McapChannel, int, bytes]]:
        """Yield the messages of all records up to the first incomplete one."""
        while True:
            self._read_until = stream.tell()
            try:
                kind, data = _record(stream)
            except EOFError:
                return
            try:
                for inner in self._unpacked(data) if kind == 0x06 else [(kind, data)]:
                    if (message := self._take(*inner)) is not None:
                        self._whole += 1
                        yield message
            except (EOFError, ValueError) as error:
                self._damaged.append(f"at byte {self._read_until} ({error})")

    def _unpacked(self, chunk: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield the records in a chunk, none if size or checksum are wrong."""
        fields = _Fields(chunk)
        _, _, size, checksum = _CHUNK.unpack(fields.take(_CHUNK.size))
        compression = fields.text()
        if compression not in self._decompress:
            raise ValueError(f"it is compressed with {compression!r}; known: {', '.join(self._decompress)}")
        data = self._decompress[compression](fields.take(fields.number(8)))
        if len(data) != size:
            raise ValueError(f"it has {len(data)} bytes, not {size}")
        if checksum and zlib.crc32(data) != checksum:  # 0: its writer computed none
            raise ValueError("its checksum is wrong")
        records = BytesIO(data)
        while records.tell() < size:
            yield _record(records)

    def _take(self, kind: int, data: bytes) -> tuple[McapChannel, int, bytes] | None:
        """Process a record, and return its message if its topic is known."""
        fields = _Fields(data)
        if kind == 0x03:
            key, name, form, definition = fields.number(2), fields.text(), fields.text(), fields.text()
            self._schemas[key] = (name, definition if form == "ros2msg" else "")
        elif kind == 0x04:
            key, schema, topic, _ = fields.number(2), fields.number(2), fields.text(), fields.text()
            qos = fields.texts().get("offered_qos_profiles", "")
            name, definition = self._schemas.get(schema, ("", ""))
            self._channels[key] = McapChannel(topic=topic, msgtype=name, definition=definition, qos=qos)
        elif kind == 0x05:
            key, _, log_ns, _ = _MESSAGE.unpack(fields.take(_MESSAGE.size))
            if key in self._channels:
                return self._channels[key], log_ns, fields.rest()
            self._unknown += 1
        elif kind == 0x0B:
            self._announced = fields.number(8)
        return None

    def complaints(self) -> Iterator[str]:
        """Yield the missing parts of a file; truncation is no complaint, as everything before it has been read."""
        if self._damaged:
            count = len(self._damaged)
            yield f"damaged and left out: {count} of its records, the first {self._damaged[0]}"
        if self._read_until < self._records_end:
            yield f"nothing can be read after byte {self._read_until}"
        if self._unknown:
            yield f"of {self._unknown} messages the topic is not known"
        # Only this detects damage that turned a record, such as a chunk, into a record of another kind.
        if self._whole < self._announced:
            yield f"{self._whole} of {self._announced} messages are whole"


def _record(stream: BinaryIO) -> tuple[int, bytes]:
    """Return kind and content of the next record; EOFError if it is incomplete."""
    head = stream.read(_HEADER.size)
    if len(head) < _HEADER.size:
        raise EOFError("a record in it is not complete")
    kind, size = _HEADER.unpack(head)
    data = stream.read(size) if size <= _MAX_RECORD else b""
    if len(data) < size:
        raise EOFError("a record in it is not complete")
    return kind, data
