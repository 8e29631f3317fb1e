"""Reads what is whole in an MCAP file that was cut off: the records up to the first that is not complete.

A recording that ends with the power has no summary at its end, and readers refuse the file. Everything that is needed
stands before each message, too (https://mcap.dev/spec, checked with the official library in the tests).
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

MAGIC = b"\x89MCAP0\r\n"
_HEADER = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_MAX_RECORD = 1 << 32


@dataclass(frozen=True, slots=True, kw_only=True)
class McapChannel:
    """A topic: its type, the type's definition, and the offered QoS as YAML text."""

    topic: str
    msgtype: str
    definition: str
    qos: str


class _Fields:
    """Takes the fields of one record from the front."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "little")

    def take(self, size: int) -> bytes:
        if self._at + size > len(self._data):
            raise EOFError
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
    stream: BinaryIO, decompress: Mapping[str, Callable[[bytes], bytes]]
) -> Iterator[tuple[McapChannel, int, bytes]]:
    """Yield (channel, log time in ns, message) in the order of the file, up to the first record that is not whole.

    Parameters
    ----------
    stream
        The file, at its start.
    decompress
        For each compression's name how a chunk is unpacked.

    Raises
    ------
    ValueError
        If this is no MCAP file, or a chunk's compression is unknown.
    """
    if stream.read(len(MAGIC)) != MAGIC:
        raise ValueError("it does not begin as an MCAP file does")
    schemas: dict[int, tuple[str, str]] = {}
    channels: dict[int, McapChannel] = {}
    try:
        yield from _messages(stream, decompress, schemas, channels)
    except EOFError:
        return


def _messages(
    stream: BinaryIO,
    decompress: Mapping[str, Callable[[bytes], bytes]],
    schemas: dict[int, tuple[str, str]],
    channels: dict[int, McapChannel],
) -> Iterator[tuple[McapChannel, int, bytes]]:
    while True:
        kind, data = _record(stream)
        fields = _Fields(data)
        if kind == 0x02:  # footer
            return
        if kind == 0x03:
            key, name, _, definition = fields.number(2), fields.text(), fields.text(), fields.text()
            schemas[key] = (name, definition)
        elif kind == 0x04:
            key, schema, topic, _ = fields.number(2), fields.number(2), fields.text(), fields.text()
            qos = fields.texts().get("offered_qos_profiles", "")
            name, definition = schemas.get(schema, ("", ""))
            channels[key] = McapChannel(topic=topic, msgtype=name, definition=definition, qos=qos)
        elif kind == 0x05:
            key, _, log_ns, _ = _MESSAGE.unpack(fields.take(_MESSAGE.size))
            if key in channels:
                yield channels[key], log_ns, fields.rest()
        elif kind == 0x06:
            fields.take(_CHUNK.size)
            compression = fields.text()
            if compression not in decompress:
                raise ValueError(f"chunks are compressed with {compression!r}; known: {', '.join(decompress)}")
            inner = decompress[compression](fields.take(fields.number(8)))
            with contextlib.suppress(EOFError):
                yield from _messages(BytesIO(inner), decompress, schemas, channels)


def _record(stream: BinaryIO) -> tuple[int, bytes]:
    """Return the next record's kind and content; EOFError if it is not whole."""
    head = stream.read(_HEADER.size)
    if len(head) < _HEADER.size:
        raise EOFError
    kind, size = _HEADER.unpack(head)
    data = stream.read(size) if size <= _MAX_RECORD else b""
    if len(data) < size:
        raise EOFError
    return kind, data
