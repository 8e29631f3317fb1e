"""Draws the images of an exposure in a thread, while the graph processes those of the one before it."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass

from icu_simulator.core.renderer import Renderer
from icu_simulator.imaging.stream import CameraImage, CameraStream, Exposure


@dataclass(frozen=True, slots=True, kw_only=True)
class _Started:
    """An exposure whose images are being drawn, at its time in s of the bench's clock and its ROS time in ns."""

    exposure_s: float
    stamp_ns: int
    images: Future[list[CameraImage]]


class ImageDrawing:
    """Draws one exposure at a time.

    The scene of an exposure is fixed when it begins. The renderer must not be changed before :meth:`finish`.

    Parameters
    ----------
    stream
        The cameras.

    Attributes
    ----------
    seconds
        Duration of the latest drawing.
    """

    def __init__(self, stream: CameraStream) -> None:
        self._stream = stream
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="draw")
        self._started: _Started | None = None
        self.seconds = 0.0

    def begin(self, exposure: Exposure, renderer: Renderer, exposure_s: float, stamp_ns: int) -> None:
        """Begin to draw an exposure; the images of the one before must have been taken."""
        images = self._thread.submit(self._draw, exposure, renderer)
        self._started = _Started(exposure_s=exposure_s, stamp_ns=stamp_ns, images=images)

    def _draw(self, exposure: Exposure, renderer: Renderer) -> list[CameraImage]:
        begin_s = time.monotonic()
        images = self._stream.render(exposure, renderer)
        self.seconds = time.monotonic() - begin_s
        return images

    def take(self) -> tuple[list[CameraImage], list[int]]:
        """Wait for the images of the exposure that began last, and return them and their stamps in ns."""
        started, self._started = self._started, None
        if started is None:
            return [], []
        images = started.images.result()
        return images, stamps_ns(images, started.exposure_s, started.stamp_ns)

    def finish(self) -> None:
        """Wait until the images are drawn."""
        if self._started is not None:
            wait([self._started.images])

    def close(self) -> None:
        """Wait until the images are drawn, and end the thread."""
        self._thread.shutdown()


def stamps_ns(images: list[CameraImage], exposure_s: float, stamp_ns: int) -> list[int]:
    """Return the ROS stamps of images of an exposure at ``exposure_s``, whose own ROS time is ``stamp_ns``."""
    return [stamp_ns - round((exposure_s - image.stamp_s) * 1e9) for image in images]
