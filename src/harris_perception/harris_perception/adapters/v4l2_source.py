"""V4L2 devices (UVC cameras) as a source of images, each with the driver's stamp."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from harris_perception.adapters.camera_controls import ControlFinding, ControlsConfig, apply_controls, check_format
from harris_perception.adapters.camera_frames import SIDES, Clock, Frames, Picture, SourceError

_DRIVER_STAMP_MAX_AGE_NS = 1_000_000_000
_FROZEN_NS = 1_000_000_000
_PATIENCE_VARIABLE = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"
"""Environment variable: whole seconds that OpenCV waits for an image (default 10); OpenCV reads it once per process."""
_SAMPLED = (slice(None, None, 16), slice(None, None, 16))
"""Sampled pixels. Noise makes them differ between two images; only images with equal samples are compared fully."""


class V4l2Source:
    """One or two V4L2 devices (UVC cameras); images are grabbed together and decoded afterwards.

    Parameters
    ----------
    devices
        Paths or numbers, left first.
    width, height, rate_hz, fourcc
        Format requested from the devices; 0 or empty keeps the device's own.
    silence_s
        Seconds without an image after which a device counts as failed; rounded up to whole seconds.
    now_ns
        ROS time in nanoseconds.
    monotonic_ns
        Clock of the driver's stamps, CLOCK_MONOTONIC (linux/Documentation/userspace-api/media/v4l/buffer.rst).
    open_device
        Opens a capture of a path or number.
    controls
        Focus, exposure, white balance and so on; None leaves all unchanged.
    options
        Further arguments of :func:`apply_controls`.

    Attributes
    ----------
    findings
        Settings that the cameras do not support or did not accept.
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
        controls: ControlsConfig | None = None,
        **options: Any,
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
            (cv2.CAP_PROP_BUFFERSIZE, 2),  # a longer queue in the driver would only add delay
        )
        findings: list[ControlFinding] = []
        for side, name, device in zip(SIDES, self._names, devices):
            capture = open_device(int(device) if device.isdigit() else device, cv2.CAP_V4L2)
            self._captures.append(capture)
            if not capture.isOpened():
                self.close()
                raise SourceError(f"{name} cannot be opened: not there, in use, or no permission")
            for key, value in wanted:
                if value:
                    capture.set(key, value)
            findings += check_format(side, capture, width=width, height=height, rate_hz=rate_hz, fourcc=fourcc)
            if controls is not None:
                findings += apply_controls(side, device, capture, controls, **options)
        self.findings = tuple(findings)

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
        """Reject a camera that repeats one image with new stamps."""
        last, since_ns = self._changed.get(name, (None, 0))
        same = last is not None and np.array_equal(picture[_SAMPLED], last[_SAMPLED]) and np.array_equal(picture, last)
        if not same:
            self._changed[name] = picture, self._monotonic_ns()
        elif self._monotonic_ns() - since_ns > _FROZEN_NS:
            seconds = (self._monotonic_ns() - since_ns) / 1e9
            raise SourceError(f"{name} has given the very same picture for {seconds:.1f} s: it is frozen, or covered")

    def _stamp_ns(self, name: str, driver_ms: float) -> int:
        # OpenCV passes v4l2_buffer.timestamp on, 0 if the backend has none. A stamp on another clock than
        # CLOCK_MONOTONIC gives an impossible age; the time of the grab is then the best estimate. If a camera has used
        # this clock before, an old image really is old: it waited while the computer was busy.
        now, age = self._now_ns(), self._monotonic_ns() - round(driver_ms * 1e6)
        if driver_ms <= 0 or age < 0:
            return now
        if age < _DRIVER_STAMP_MAX_AGE_NS:
            self._monotonic.add(name)
        return now - age if name in self._monotonic else now

    def close(self) -> None:
        for capture in self._captures:
            capture.release()
