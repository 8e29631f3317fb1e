"""Stereo pairs over a Unix socket: how a simulated camera hands its pictures to the camera node.

One message is a header (magic, count, height, width, channels, stamp) and the raw pixels of ``count`` pictures of
equal size. The server never waits for a slow reader: a reader that has not taken its last pair misses the next one, as
with a real device.
"""

from __future__ import annotations

import math
import os
import selectors
import socket
import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt

from icu_common.adapters.unix_listener import listen_at

_HEADER = struct.Struct("<4sIIIIq")
_MAGIC = b"ICU1"
MAX_BYTES = 64 * 1024 * 1024
FRAMES = "camera:frames"
"""Ledger entry in which a stepped bench and its camera node count pairs (see icu_common.adapters.step_ledger)."""

Picture = npt.NDArray[np.uint8]


class FrameServer:
    """Serves pictures to any number of readers on a Unix socket; all calls return at once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._listener = listen_at(path)
        self._readers: dict[socket.socket, list[memoryview]] = {}
        """What each reader has still to be sent."""

    def reader_count(self) -> int:
        """Accept waiting readers and return how many are connected."""
        while True:
            try:
                reader, _ = self._listener.accept()
            except BlockingIOError:
                return len(self._readers)
            reader.setblocking(False)
            reader.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 8 * 1024 * 1024)
            self._readers[reader] = []

    def send(self, pictures: list[Picture], stamp_ns: int) -> None:
        """Offer pictures of one shape, (H, W, 3) uint8, taken at ``stamp_ns`` (ROS time), to every reader.

        They are not copied: they must not change before :meth:`flush` has returned True.
        """
        height, width, channels = pictures[0].shape
        header = _HEADER.pack(_MAGIC, len(pictures), height, width, channels, stamp_ns)
        parts = [memoryview(header), *(np.ascontiguousarray(p).data.cast("B") for p in pictures)]
        self.reader_count()
        for reader, left in list(self._readers.items()):
            if not left:
                self._readers[reader] = list(parts)
        self.flush()

    def flush(self) -> bool:
        """Push what the readers can take now; return whether everything has gone."""
        for reader, left in list(self._readers.items()):
            try:
                while left:
                    _leave_out(left, reader.sendmsg(left))
            except BlockingIOError:
                continue
            except OSError:
                reader.close()
                del self._readers[reader]
        return not any(self._readers.values())

    def wait_writable(self, timeout_s: float) -> None:
        """Wait until a reader can take more, at most ``timeout_s``."""
        with selectors.DefaultSelector() as selector:
            for reader, left in self._readers.items():
                if left:
                    selector.register(reader, selectors.EVENT_WRITE)
            if selector.get_map():
                selector.select(timeout_s)

    def close(self) -> None:
        for reader in self._readers:
            reader.close()
        self._readers.clear()
        self._listener.close()
        self.path.unlink(missing_ok=True)


def _leave_out(parts: list[memoryview], count: int) -> None:
    """Drop the first ``count`` bytes of the parts."""
    while parts and count >= len(parts[0]):
        count -= len(parts.pop(0))
    if count:
        parts[0] = parts[0][count:]


class FrameClient:
    """Reads pictures from a :class:`FrameServer`.

    Raises
    ------
    OSError
        From the constructor, when nobody serves at ``path``.
    """

    def __init__(self, path: Path) -> None:
        self._head: list[int] | None = None
        self._part, self._done = np.empty(0, np.uint8), 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.settimeout(1.0)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 * 1024 * 1024)
            self._socket.connect(os.fspath(path))
        except OSError:
            self._socket.close()
            raise

    def read(self, timeout_s: float) -> tuple[list[Picture], int]:
        """Return the next pictures, each (H, W, C) uint8, and their stamp in ns.

        Raises
        ------
        TimeoutError
            If nothing arrived for so long; the next call goes on where this one stopped.
        ConnectionError
            If the server has gone or sends something else; the client must be closed.
        """
        self._socket.settimeout(timeout_s)
        if self._head is None:
            magic, *head = _HEADER.unpack(self._receive(_HEADER.size).data)
            count, height, width, channels, _ = head
            if magic != _MAGIC or not 0 < count * height * width * channels <= MAX_BYTES:
                what = f"{count} pictures of {width} x {height} x {channels}"
                raise ConnectionError(f"not a frame: magic {magic!r}, {what}")
            self._head = head
        *shape, stamp_ns = self._head
        body = self._receive(math.prod(shape)).reshape(shape)
        self._head = None
        return list(body), stamp_ns

    def _receive(self, size: int) -> npt.NDArray[np.uint8]:
        if not self._done:
            self._part = np.empty(size, np.uint8)
        view = self._part.data
        while self._done < size:
            got = self._socket.recv_into(view[self._done :])
            if not got:
                raise ConnectionError("the camera has gone")
            self._done += got
        self._done = 0
        return self._part

    def close(self) -> None:
        self._socket.close()
