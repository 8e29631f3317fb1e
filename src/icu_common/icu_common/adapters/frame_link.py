"""Stereo pairs over a Unix socket, from a simulated camera to the camera node.

One message is a header (magic, count, height, width, channels), an entry for each image (the camera's index and the
image's stamp), and the raw pixels of ``count`` images of equal size. A message has one image if the other camera
lost its image. The server never waits for a slow reader: a reader that has not read its last pair misses the next one,
as with a real device.
"""

from __future__ import annotations

import math
import os
import selectors
import socket
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from icu_common.adapters.unix_listener import listen_at

_HEADER = struct.Struct("<4sIIII")
_ENTRY = struct.Struct("<Iq")
_MAGIC = b"ICU2"
MAX_CAMERAS = 8
MAX_BYTES = 64 * 1024 * 1024
FRAMES = "camera:frames"
"""Ledger entry in which a stepped bench and its camera node count pairs (see icu_common.adapters.steps.step_ledger)."""

Picture = npt.NDArray[np.uint8]


class Received(NamedTuple):
    """Images of one message, (H, W, C) uint8, the stamp of each in ns, and the index of the camera of each."""

    pictures: list[Picture]
    stamps_ns: tuple[int, ...]
    cameras: tuple[int, ...]


class FrameServer:
    """Serves images to any number of readers on a Unix socket; all calls return at once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._listener = listen_at(path)
        self._readers: dict[socket.socket, list[memoryview]] = {}
        """Data that is still to be sent to each reader."""

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

    def send(
        self, pictures: Sequence[Picture], stamps_ns: int | Sequence[int], cameras: Sequence[int] | None = None
    ) -> None:
        """Offer images of one shape to every reader.

        Parameters
        ----------
        pictures
            Each (H, W, C) uint8. They are not copied: they must not change before :meth:`flush` has returned True.
        stamps_ns
            ROS time of each image, or one time for all.
        cameras
            Index of each image's camera; by default the images are those of the cameras 0, 1, ...

        Raises
        ------
        ValueError
            If shapes or counts do not match.
        """
        height, width, channels = pictures[0].shape
        stamps = (stamps_ns,) * len(pictures) if isinstance(stamps_ns, int) else tuple(stamps_ns)
        indices = tuple(range(len(pictures))) if cameras is None else tuple(cameras)
        if not len(stamps) == len(indices) == len(pictures) <= MAX_CAMERAS:
            raise ValueError(f"{len(pictures)} images, {len(stamps)} stamps, {len(indices)} cameras")
        if any(picture.shape != (height, width, channels) for picture in pictures):
            raise ValueError(f"images of unequal shapes: {[picture.shape for picture in pictures]}")
        header = _HEADER.pack(_MAGIC, len(pictures), height, width, channels)
        header += b"".join(_ENTRY.pack(index, stamp) for index, stamp in zip(indices, stamps))
        parts = [memoryview(header), *(np.ascontiguousarray(p).data.cast("B") for p in pictures)]
        self.reader_count()
        for reader, left in list(self._readers.items()):
            if not left:
                self._readers[reader] = list(parts)
        self.flush()

    def flush(self) -> bool:
        """Send what the readers can take now; return whether everything has been sent."""
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
    """Reads images from a :class:`FrameServer`.

    Raises
    ------
    OSError
        From the constructor, if no server listens at ``path``.
    """

    def __init__(self, path: Path) -> None:
        self._shape: tuple[int, int, int, int] | None = None
        self._entries: list[tuple[int, int]] | None = None
        self._part, self._done = np.empty(0, np.uint8), 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.settimeout(1.0)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 * 1024 * 1024)
            self._socket.connect(os.fspath(path))
        except OSError:
            self._socket.close()
            raise

    def read(self, timeout_s: float) -> Received:
        """Return the next images.

        Raises
        ------
        TimeoutError
            If no data arrived within the time; the next call continues where this one stopped.
        ConnectionError
            If the server has ended or sends invalid data; the client must be closed.
        """
        self._socket.settimeout(timeout_s)
        if self._shape is None:
            magic, count, height, width, channels = _HEADER.unpack(self._receive(_HEADER.size).data)
            if magic != _MAGIC or not 0 < count * height * width * channels <= MAX_BYTES or count > MAX_CAMERAS:
                what = f"{count} images of {width} x {height} x {channels}"
                raise ConnectionError(f"not a frame: magic {magic!r}, {what}")
            self._shape = count, height, width, channels
        if self._entries is None:
            self._entries = list(_ENTRY.iter_unpack(self._receive(self._shape[0] * _ENTRY.size).data))
        body = self._receive(math.prod(self._shape)).reshape(self._shape)
        cameras, stamps_ns = zip(*self._entries)
        self._shape = self._entries = None
        return Received(list(body), stamps_ns, cameras)

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
