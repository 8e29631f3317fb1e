"""Where pictures come from: the simulated bench's socket, V4L2 devices, video files, folders of pictures.

Every source hands out the pictures of one moment together with the time they were taken; how to go on after a failure
is the business of :mod:`harris_perception.adapters.capture`.
"""

from __future__ import annotations

import math
import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.adapters.picture_files import SUFFIXES, decoded
from icu_common.adapters.frame_link import FrameClient
from icu_common.core.config import WALL_TIME, Config, ConfigError, setting

Picture = npt.NDArray[np.uint8]
Clock = Callable[[], int]

SIDES = ("left", "right")
_DRIVER_STAMP_MAX_AGE_NS = 1_000_000_000
_FROZEN_NS = 1_000_000_000
_PATIENCE_VARIABLE = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"
"""So many whole seconds OpenCV waits for a device's picture (else ten); it looks once in a process."""
_SAMPLED = (slice(None, None, 16), slice(None, None, 16))
"""Of two pictures of a sensor already these pixels differ, by its noise; only those that do not are compared whole."""


class SourceError(Exception):
    """The source cannot be opened or has stopped giving pictures; opening it again may help."""


class SourceEnded(Exception):
    """A recording that is not repeated is over."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraConfig(Config):
    """Settings of the camera node."""

    source: str = setting(
        "bench",
        "Where pictures come from.",
        choices=("bench", "v4l2", "video", "images"),
        read_only=True,
    )
    bench_socket: str = setting("", "Path of the simulated bench's frame socket (source bench).", read_only=True)
    left_device: str = setting("0", "Left V4L2 device, path or number (source v4l2).", read_only=True)
    right_device: str = setting("", "Right V4L2 device; empty: one camera only.", read_only=True)
    left_path: str = setting(
        "", "Video file, or folder or pattern (folder/left*.png) of pictures (sources video, images).", read_only=True
    )
    right_path: str = setting("", "The same for the right camera; empty: one camera only.", read_only=True)
    loop: bool = setting(True, "Start a recording again at its end.", read_only=True)
    rate_hz: float = setting(
        0.0,
        "Rate asked of a device or of a recording; 0: the device's or the file's own, 15 Hz for a folder.",
        minimum=0.0,
        maximum=240.0,
        unit="Hz",
        read_only=True,
    )
    width: int = setting(0, "Width asked of a device; 0: the device's own.", minimum=0, maximum=8192, read_only=True)
    height: int = setting(0, "Height asked of a device; 0: the device's own.", minimum=0, maximum=8192, read_only=True)
    fourcc: str = setting(
        "MJPG", "Pixel format asked of a device: USB 2 carries 1280x720 at 30 Hz only as MJPG.", read_only=True
    )
    left_calibration: str = setting("", "YAML file of the left camera's calibration; empty: none.", read_only=True)
    right_calibration: str = setting("", "YAML file of the right camera's calibration; empty: none.", read_only=True)
    read_timeout_s: float = setting(
        2.0,
        "A live source that is silent for longer is opened again; a device after whole seconds, as asked at the start.",
        minimum=0.1,
        maximum=60.0,
        unit="s",
    )
    retry_min_s: float = setting(
        0.5, "First pause before opening again.", minimum=0.01, maximum=60.0, unit="s", clock=WALL_TIME
    )
    retry_max_s: float = setting(
        5.0, "Longest pause before opening again.", minimum=0.01, maximum=60.0, unit="s", clock=WALL_TIME
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.retry_max_s < self.retry_min_s:
            raise ConfigError(f"retry_max_s = {self.retry_max_s} is below retry_min_s = {self.retry_min_s}")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Frames:
    """The pictures of one moment, left first, each (H, W, 3) BGR or (H, W) grey, and when each was taken."""

    pictures: tuple[Picture, ...]
    stamps_ns: tuple[int, ...]


class CameraSource(Protocol):
    """An open source of pictures."""

    def read(self, timeout_s: float) -> Frames:
        """Return the next pictures.

        Raises
        ------
        TimeoutError
            If nothing came in time; the next call may succeed.
        SourceError
            If the source is broken and must be closed.
        SourceEnded
            If the recording is over.
        """

    def close(self) -> None: ...


class BenchSource:
    """Pairs of the simulated bench, with the bench's stamps."""

    def __init__(self, path: Path) -> None:
        try:
            self._client = FrameClient(path)
        except OSError as error:
            raise SourceError(f"no simulated bench at {path}: {error.strerror or error}") from error

    def read(self, timeout_s: float) -> Frames:
        try:
            pictures, stamp_ns = self._client.read(timeout_s)
        except TimeoutError:
            raise
        except OSError as error:
            raise SourceError(f"simulated bench: {error}") from error
        return Frames(pictures=tuple(pictures), stamps_ns=(stamp_ns,) * len(pictures))

    def close(self) -> None:
        self._client.close()


class V4l2Source:
    """One or two V4L2 devices (UVC cameras), grabbed together and decoded afterwards.

    Parameters
    ----------
    devices
        Paths or numbers, left first.
    width, height, rate_hz, fourcc
        What is asked of the devices; 0 or empty leaves their own.
    silence_s
        A device without pictures for so long has failed, in whole seconds.
    now_ns
        ROS time in nanoseconds.
    monotonic_ns
        The clock of the driver's stamps, CLOCK_MONOTONIC (linux/Documentation/userspace-api/media/v4l/buffer.rst).
    open_device
        What makes a capture of a path or number.
    """

    def __init__(
        self,
        devices: Sequence[str],
        *,
        now_ns: Clock,
        width: int = 0,
        height: int = 0,
        rate_hz: float = 0.0,
        fourcc: str = "",
        silence_s: float = 2.0,
        monotonic_ns: Clock = time.monotonic_ns,
        open_device: Callable[..., Any] = cv2.VideoCapture,
    ) -> None:
        self._now_ns, self._monotonic_ns = now_ns, monotonic_ns
        self._names = [f"{side} camera {device}" for side, device in zip(SIDES, devices)]
        self._captures: list[Any] = []
        self._changed: dict[str, tuple[Picture, int]] = {}
        self._monotonic: set[str] = set()
        os.environ.setdefault(_PATIENCE_VARIABLE, str(math.ceil(silence_s)))
        wanted = (
            (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*fourcc) if fourcc else 0),
            (cv2.CAP_PROP_FRAME_WIDTH, width),
            (cv2.CAP_PROP_FRAME_HEIGHT, height),
            (cv2.CAP_PROP_FPS, rate_hz),
            (cv2.CAP_PROP_BUFFERSIZE, 2),  # a longer queue in the driver would only make the pictures older
        )
        for name, device in zip(self._names, devices):
            capture = open_device(int(device) if device.isdigit() else device, cv2.CAP_V4L2)
            self._captures.append(capture)
            if not capture.isOpened():
                self.close()
                raise SourceError(f"{name} cannot be opened: not there, in use, or no permission")
            for key, value in wanted:
                if value:
                    capture.set(key, value)

    def read(self, timeout_s: float) -> Frames:
        stamps: list[int] = []
        for name, capture in zip(self._names, self._captures):
            if not capture.grab():
                raise SourceError(f"{name} gives no pictures any more: unplugged?")
            stamps.append(self._stamp_ns(name, capture.get(cv2.CAP_PROP_POS_MSEC)))
        pictures: list[Picture] = []
        for name, capture in zip(self._names, self._captures):
            good, picture = capture.retrieve()
            if not good or picture is None:
                raise SourceError(f"{name} gave a picture that cannot be decoded")
            self._check_alive(name, picture)
            pictures.append(picture)
        return Frames(pictures=tuple(pictures), stamps_ns=tuple(stamps))

    def _check_alive(self, name: str, picture: Picture) -> None:
        """Refuse a camera that hands out one picture again and again, with stamps as if it were alive."""
        last, since_ns = self._changed.get(name, (None, 0))
        same = last is not None and np.array_equal(picture[_SAMPLED], last[_SAMPLED]) and np.array_equal(picture, last)
        if not same:
            self._changed[name] = picture, self._monotonic_ns()
        elif self._monotonic_ns() - since_ns > _FROZEN_NS:
            seconds = (self._monotonic_ns() - since_ns) / 1e9
            raise SourceError(f"{name} has given the very same picture for {seconds:.1f} s: it is frozen, or covered")

    def _stamp_ns(self, name: str, driver_ms: float) -> int:
        # OpenCV hands on v4l2_buffer.timestamp, 0 when the backend has none. A stamp on another clock than
        # CLOCK_MONOTONIC shows as an impossible age; then the time of the grab is the best that is known. Of a camera
        # that has been seen to keep this clock an old picture is old: it has waited while the computer was busy.
        now, age = self._now_ns(), self._monotonic_ns() - round(driver_ms * 1e6)
        if driver_ms <= 0 or age < 0:
            return now
        if age < _DRIVER_STAMP_MAX_AGE_NS:
            self._monotonic.add(name)
        return now - age if name in self._monotonic else now

    def close(self) -> None:
        for capture in self._captures:
            capture.release()


class RecordedSource:
    """Pictures from files at a steady rate; the stamp is the time at which a picture is due and handed out.

    Parameters
    ----------
    open_streams
        Opens the recording at its beginning: one iterator over pictures per camera, left first.
    rate_hz
        Pictures per second.
    loop
        Start again at the end.
    stop
        Ends the pause between two pictures.
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
        # A reader that fell behind by more than a period goes on from now instead of hurrying after the schedule.
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
    """Return the picture files of a folder, or of a pattern such as ``folder/left*.png``, in natural order.

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
            picture = decoded(file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)  # as the calibration's
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
    except UnicodeEncodeError:  # OpenCV would end the process
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


def require_settings(config: CameraConfig) -> None:
    """Refuse a configuration whose source lacks its place.

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
        raise ConfigError(f"fourcc = {config.fourcc!r}: four characters are needed")


def open_source(config: CameraConfig, *, now_ns: Clock, stop: threading.Event) -> CameraSource:
    """Open the configured source.

    Raises
    ------
    SourceError
        If it is not there or cannot be read.
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
        )
    if config.source == "video":
        return _videos(places, config.rate_hz, **recorded)
    return _images(places, rate_hz=config.rate_hz or 15.0, **recorded)
