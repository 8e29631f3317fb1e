"""Sources of images: the simulated bench's socket, V4L2 devices, video files and image folders.

Each source returns the images of one instant with the time at which they were taken.
:mod:`harris_perception.adapters.capture` handles failures.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from harris_perception.adapters.camera_controls import ControlsConfig
from harris_perception.adapters.camera_frames import (
    SIDES,
    CameraSource,
    Clock,
    Frames,
    Picture,
    SourceEnded,
    SourceError,
)
from harris_perception.adapters.picture_files import SUFFIXES, decoded
from harris_perception.adapters.v4l2_source import V4l2Source
from icu_common.adapters.frame_link import FrameClient
from icu_common.core.configuration.config import WALL_TIME, Config, ConfigError, nested, setting

__all__ = ["CameraNodeConfig", "CameraSource", "Frames", "Picture", "SourceEnded", "SourceError", "V4l2Source"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraNodeConfig(Config):
    """Settings of the camera node."""

    source: str = setting(
        "bench",
        "Source of the images",
        choices=("bench", "v4l2", "video", "images"),
        read_only=True,
    )
    bench_socket: str = setting("", "Path of the simulated bench's frame socket (source bench)", read_only=True)
    left_device: str = setting("0", "Left V4L2 device, path or number (source v4l2)", read_only=True)
    right_device: str = setting(
        "", "Right V4L2 device, path or number (source v4l2); empty: one camera only", read_only=True
    )
    left_path: str = setting(
        "",
        "Left camera's video file, image folder or file pattern (folder/left*.png) (sources video, images)",
        read_only=True,
    )
    right_path: str = setting(
        "", "Right camera's video file, image folder or file pattern; empty: one camera only", read_only=True
    )
    loop: bool = setting(True, "Restart a recording at its end", read_only=True)
    rate_hz: float = setting(
        0.0,
        "Rate requested from a device or for a recording; 0: the rate of the device or file, 15 Hz for a folder",
        minimum=0.0,
        maximum=240.0,
        unit="Hz",
        read_only=True,
    )
    width: int = setting(
        0, "Image width requested from a device; 0: the device's own", minimum=0, maximum=8192, read_only=True
    )
    height: int = setting(
        0, "Image height requested from a device; 0: the device's own", minimum=0, maximum=8192, read_only=True
    )
    fourcc: str = setting(
        "MJPG", "Pixel format requested from a device; USB 2 carries 1280x720 at 30 Hz only as MJPG", read_only=True
    )
    controls: ControlsConfig = nested(ControlsConfig)
    left_calibration: str = setting("", "YAML file of the left camera's calibration; empty: none", read_only=True)
    right_calibration: str = setting("", "YAML file of the right camera's calibration; empty: none", read_only=True)
    read_timeout_s: float = setting(
        2.0,
        "Time without an image after which a live source is reopened; a device rounds it up to whole seconds "
        "and uses the value at startup",
        minimum=0.1,
        maximum=60.0,
        unit="s",
    )
    retry_min_s: float = setting(
        0.5, "First pause before reopening a source", minimum=0.01, maximum=60.0, unit="s", clock=WALL_TIME
    )
    retry_max_s: float = setting(
        5.0, "Longest pause before reopening a source", minimum=0.01, maximum=60.0, unit="s", clock=WALL_TIME
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.retry_max_s < self.retry_min_s:
            raise ConfigError(f"retry_max_s = {self.retry_max_s} is below retry_min_s = {self.retry_min_s}")


class BenchSource:
    """Images of the simulated bench, each with the stamp set by the bench."""

    def __init__(self, path: Path) -> None:
        try:
            self._client = FrameClient(path)
        except OSError as error:
            raise SourceError(f"no simulated bench at {path}: {error.strerror or error}") from error

    def read(self, timeout_s: float) -> Frames:
        try:
            received = self._client.read(timeout_s)
        except TimeoutError:
            raise
        except OSError as error:
            raise SourceError(f"simulated bench: {error}") from error
        if max(received.cameras) >= len(SIDES):
            raise SourceError(f"simulated bench: an image of camera {max(received.cameras)}, there are {len(SIDES)}")
        return Frames(pictures=tuple(received.pictures), stamps_ns=received.stamps_ns, cameras=received.cameras)

    def close(self) -> None:
        self._client.close()


class RecordedSource:
    """Images from files at a constant rate; the stamp is the time at which an image is due and returned.

    Parameters
    ----------
    open_streams
        Opens the recording at its start; returns one iterator over images per camera, left first.
    rate_hz
        Images per second.
    loop
        Restart at the end.
    stop
        Event that ends the pause between two images.
    now_ns
        ROS time in nanoseconds.
    """

    def __init__(
        self,
        open_streams: Callable[[], Sequence[Iterator[Picture]]],
        *,
        rate_hz: float,
        loop: bool,
        stop: threading.Event,
        now_ns: Clock,
    ) -> None:
        self._open_streams, self._loop, self._stop, self._now_ns = open_streams, loop, stop, now_ns
        self._period_s = 1.0 / rate_hz
        self._streams = list(open_streams())
        self._fresh = True
        self._due_s = time.monotonic()

    def read(self, timeout_s: float) -> Frames:
        pictures = self._next_pictures()
        while (left_s := self._due_s - time.monotonic()) > 0 and not self._stop.wait(left_s):
            pass
        # A reader more than one period late continues from now and does not try to catch up with the schedule.
        self._due_s = max(self._due_s, time.monotonic() - self._period_s) + self._period_s
        return Frames(pictures=pictures, stamps_ns=(self._now_ns(),) * len(pictures))

    def _next_pictures(self) -> tuple[Picture, ...]:
        pictures = tuple(next(stream, None) for stream in self._streams)
        if any(picture is None for picture in pictures):
            if self._fresh:
                raise SourceError("the recording has no pictures")
            if not self._loop:
                raise SourceEnded("the recording is over")
            self._streams, self._fresh = list(self._open_streams()), True
            return self._next_pictures()
        self._fresh = False
        return tuple(picture for picture in pictures if picture is not None)

    def close(self) -> None:
        self._streams = []


def picture_files(place: str | Path) -> list[Path]:
    """Return the image files of a folder, or of a pattern such as ``folder/left*.png``, in natural order.

    Raises
    ------
    SourceError
        If there are none.
    """
    path = Path(place).expanduser()
    found = path.iterdir() if path.is_dir() else path.parent.glob(path.name) if path.parent.is_dir() else ()
    files = [file for file in found if file.suffix.lower() in SUFFIXES]
    if not files:
        raise SourceError(f"{place}: no pictures ({', '.join(SUFFIXES)})")
    return sorted(files, key=lambda file: [int(t) if t.isdigit() else t for t in re.split(r"(\d+)", file.name)])


def _read_files(files: Sequence[Path]) -> Iterator[Picture]:
    for file in files:
        try:
            picture = decoded(file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)  # as in the calibration
        except ValueError as error:
            raise SourceError(str(error)) from error
        if picture is None:
            raise SourceError(f"{file} is not a picture that can be read")
        yield np.asarray(picture, np.uint8)


def _read_video(capture: Any) -> Iterator[Picture]:
    try:
        while True:
            good, picture = capture.read()
            if not good:
                return
            yield np.asarray(picture, np.uint8)
    finally:
        capture.release()


def _images(places: Sequence[str], **options: Any) -> RecordedSource:
    files = [picture_files(place) for place in places]
    counts = [len(part) for part in files]
    if len(set(counts)) != 1:
        raise SourceError(f"{counts[0]} left and {counts[1]} right pictures in {places[0]} and {places[1]}")
    return RecordedSource(lambda: [_read_files(part) for part in files], **options)


def _open_video(place: str) -> Any:
    file = str(Path(place).expanduser())
    try:
        file.encode()
    except UnicodeEncodeError:  # OpenCV would terminate the process
        raise SourceError(f"a video's name {file!r} is no UTF-8: rename it") from None
    capture = cv2.VideoCapture(file)
    if not capture.isOpened():
        raise SourceError(f"{place} is not a video that can be read")
    return capture


def _videos(places: Sequence[str], rate_hz: float, **options: Any) -> RecordedSource:
    probe = [_open_video(place) for place in places]
    file_rate = float(probe[0].get(cv2.CAP_PROP_FPS))
    for capture in probe:
        capture.release()
    if not rate_hz:
        rate_hz = file_rate if 0 < file_rate <= 240 else 30.0
    return RecordedSource(lambda: [_read_video(_open_video(place)) for place in places], rate_hz=rate_hz, **options)


def require_settings(config: CameraNodeConfig) -> None:
    """Reject a configuration whose source has no path, device or socket.

    Raises
    ------
    ConfigError
        With the name of the setting that is missing.
    """
    needed = {"bench": "bench_socket", "v4l2": "left_device", "video": "left_path", "images": "left_path"}
    name = needed[config.source]
    if not getattr(config, name):
        raise ConfigError(f"source = {config.source!r} needs {name}, which is empty")
    if config.fourcc and len(config.fourcc) != 4:
        raise ConfigError(f"fourcc = {config.fourcc!r}; expected four characters")


def open_source(config: CameraNodeConfig, *, now_ns: Clock, stop: threading.Event) -> CameraSource:
    """Open the configured source.

    Raises
    ------
    SourceError
        If it does not exist or cannot be read.
    """
    places = [place for place in (config.left_path, config.right_path) if place]
    recorded: dict[str, Any] = {"loop": config.loop, "stop": stop, "now_ns": now_ns}
    if config.source == "bench":
        return BenchSource(Path(config.bench_socket).expanduser())
    if config.source == "v4l2":
        return V4l2Source(
            [device for device in (config.left_device, config.right_device) if device],
            now_ns=now_ns,
            width=config.width,
            height=config.height,
            rate_hz=config.rate_hz,
            fourcc=config.fourcc,
            silence_s=config.read_timeout_s,
            controls=config.controls,
        )
    if config.source == "video":
        return _videos(places, config.rate_hz, **recorded)
    return _images(places, rate_hz=config.rate_hz or 15.0, **recorded)
