"""JPEG encoder in its own process: the bridge has real-time scheduling, and encoding must not preempt perception.

A thread with ordinary scheduling is no alternative. If it waits for the processor while it holds the interpreter's
lock, it blocks all other threads and so the operator's heartbeat (docs/decisions/operator-page.md).
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import subprocess
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection, Pipe
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.adapters.real_time import give_up_real_time
from scope_ui_bridge.core.video import FORMS, Form

_CONVERSIONS = {"rgb8": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGR, "bgra8": cv2.COLOR_BGRA2BGR}

_START_S = 30.0
_PICTURE_S = 3.0
"""Maximum seconds for an image before the process counts as hung; encoding takes 10 ms on an idle computer."""

Picture = npt.NDArray[Any]


class _Shared:
    """Shared memory with the image to encode: transfer through a pipe took half as long as encoding."""

    def __init__(self, number: int) -> None:
        self.number = number
        self._memory: mmap.mmap | None = None

    def bytes(self, size: int) -> npt.NDArray[np.uint8]:
        """Return the first bytes, (size,)."""
        if self._memory is None or len(self._memory) < size:
            if os.fstat(self.number).st_size < max(size, 1):
                os.ftruncate(self.number, max(size, 1))
            self._memory = mmap.mmap(self.number, 0)
        return np.frombuffer(self._memory, np.uint8, size)

    def close(self) -> None:
        """Release the memory; a second call does nothing, because the descriptor may belong to another file by then."""
        if self.number >= 0:
            os.close(self.number)
        self.number, self._memory = -1, None


class JpegEncoder:
    """Encodes one image at a time; starts its process with the first image, and again if it has died or hangs."""

    def __init__(self) -> None:
        self._asks = ThreadPoolExecutor(1, "jpeg")
        self._process: subprocess.Popen[bytes] | None = None
        self._line: Connection | None = None
        self._shared = _Shared(os.memfd_create("picture"))

    @property
    def pid(self) -> int | None:
        """Process id, None before the first image."""
        return None if self._process is None else self._process.pid

    def __call__(self, picture: Picture, encoding: str, quality: int, form: Form = FORMS[0]) -> Future[bytes]:
        """Encode an image, (H, W) or (H, W, C) uint8, in a form; the future raises as :func:`to_jpeg`, or OSError."""
        return self._asks.submit(self._ask, picture, encoding, quality, form)

    def close(self) -> None:
        """End the process, even while it encodes an image."""
        self._asks.shutdown(wait=False, cancel_futures=True)
        if (process := self._process) is not None:
            process.kill()  # else the shutdown would wait for the running request
        self._asks.shutdown(wait=True)
        self._end()
        self._shared.close()

    def _ask(self, picture: Picture, encoding: str, quality: int, form: Form) -> bytes:
        whole = np.ascontiguousarray(picture)
        try:
            begins, line = self._line is None, self._line or self._start()
            self._shared.bytes(whole.nbytes)[:] = whole.reshape(-1).view(np.uint8)
            line.send((whole.shape, whole.dtype.str, encoding, quality, form))
            if not line.poll(within_s := _START_S if begins else _PICTURE_S):
                raise TimeoutError(f"it hung for {within_s:g} s")
            jpeg: bytes | str = line.recv()
        except (OSError, EOFError) as error:
            self._end()
            raise OSError(f"the process that makes the JPEGs is started anew: {error!r}") from error
        if isinstance(jpeg, str):
            raise ValueError(jpeg)
        return jpeg

    def _start(self) -> Connection:
        self._line, theirs = Pipe()
        numbers = theirs.fileno(), self._shared.number
        path = os.pathsep.join(map(os.path.abspath, sys.path))
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, *map(str, numbers)],
                env={**os.environ, "PYTHONPATH": path},
                pass_fds=numbers,
                start_new_session=True,  # Ctrl-C is for the bridge, which ends this process
            )
        give_up_real_time(self._process.pid)
        return self._line

    def _end(self) -> None:
        line, process, self._line, self._process = self._line, self._process, None, None
        if line is not None:
            line.close()
        if process is not None:
            process.kill()  # it has no data to save
            process.wait()


def to_jpeg(picture: Picture, encoding: str, quality: int, form: Form = FORMS[0]) -> bytes:
    """Encode an image in a form.

    Raises
    ------
    ValueError
        If the encoding cannot be shown to people without processing.
    """
    if encoding in _CONVERSIONS:
        picture = cv2.cvtColor(picture, _CONVERSIONS[encoding])
    elif encoding not in ("bgr8", "mono8"):
        raise ValueError(f"encoding {encoding!r} is none of bgr8, mono8, {', '.join(_CONVERSIONS)}")
    if form.scale < 1:
        picture = cv2.resize(picture, None, fx=form.scale, fy=form.scale, interpolation=cv2.INTER_AREA)
    good, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, round(quality * form.quality)])
    if not good:
        raise ValueError("OpenCV could not encode the picture")
    return jpeg.tobytes()


def serve(line: Connection, shared: _Shared) -> None:
    """Encode the received images until the other end closes."""
    cv2.setNumThreads(1)  # the other cores are for the programs that process the images
    while True:
        shape, kind, encoding, quality, form = line.recv()
        picture = shared.bytes(math.prod(shape) * np.dtype(kind).itemsize).view(kind).reshape(shape)
        try:
            line.send(to_jpeg(picture, encoding, quality, form))
        except (ValueError, cv2.error) as error:
            line.send(str(error))


def main() -> int:
    with contextlib.suppress(EOFError, ConnectionError):
        serve(Connection(int(sys.argv[1])), _Shared(int(sys.argv[2])))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
