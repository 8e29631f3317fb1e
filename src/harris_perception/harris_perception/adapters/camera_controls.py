"""Sets a camera's focus, exposure, gain, white balance and power-line frequency, and reads the actual values back.

Autofocus and automatic exposure change a camera's calibration and colours while the robot works. OpenCV sets all of
these controls except the power-line frequency, for which it has no property. The power-line frequency is set through
the driver (VIDIOC_S_CTRL and VIDIOC_G_CTRL, linux/Documentation/userspace-api/media/v4l/vidioc-g-ctrl.rst).
"""

from __future__ import annotations

import fcntl
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2

from icu_common.core.configuration.config import Config, ConfigError, setting

NOT_SUPPORTED = "not_supported"
"""The camera does not have the control, or refuses to set it."""
NOT_TAKEN = "not_taken"
"""The camera reports another value than the requested one."""

_VIDIOC_G_CTRL, _VIDIOC_S_CTRL = 0xC008561B, 0xC008561C
_POWER_LINE_FREQUENCY = 0x00980918
_POWER_LINE = {50: 1, 60: 2}
_MANUAL_EXPOSURE, _AUTO_EXPOSURE = 1.0, 3.0
"""V4L2_EXPOSURE_MANUAL, and V4L2_EXPOSURE_APERTURE_PRIORITY, the automatic mode of UVC cameras."""
_EXPOSURE_UNIT_MS = 0.1
_SHARE = 0.05
"""Accepted relative deviation of a value; a deviation of one is also accepted, as cameras have steps."""
_NUMBER_PATH = "/dev/video{}"

PowerLine = Callable[[str, int], int]


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlsConfig(Config):
    """Controls of a V4L2 camera that are set when it is opened."""

    left_focus: float = setting(
        -1.0,
        "Focus of the left camera in the device's units, with autofocus off; -1: autofocus off, focus unchanged",
        minimum=-1.0,
        maximum=100_000.0,
        read_only=True,
    )
    right_focus: float = setting(
        -1.0,
        "Focus of the right camera in the device's units, with autofocus off; -1: autofocus off, focus unchanged",
        minimum=-1.0,
        maximum=100_000.0,
        read_only=True,
    )
    exposure_ms: float = setting(
        0.0, "Exposure time; 0: automatic", minimum=0.0, maximum=1000.0, unit="ms", read_only=True
    )
    gain: float = setting(
        -1.0, "Gain in the device's units; -1: unchanged", minimum=-1.0, maximum=100_000.0, read_only=True
    )
    white_balance_k: int = setting(
        0, "Colour temperature of the white balance; 0: automatic", minimum=0, maximum=20_000, unit="K", read_only=True
    )
    power_line_hz: int = setting(
        50,
        "Mains frequency, to suppress flicker bands: 50 or 60; 0: unchanged",
        minimum=0,
        maximum=60,
        unit="Hz",
        read_only=True,
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.power_line_hz not in (0, *_POWER_LINE):
            raise ConfigError(f"power_line_hz = {self.power_line_hz}: expected 0, 50 or 60")


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlFinding:
    """One control whose value differs from the configured one.

    Attributes
    ----------
    side
        left or right.
    name
        Name of the parameter.
    code
        ``not_supported`` or ``not_taken``.
    wanted, got
        Configured value and actual value, in the parameter's unit; ``got`` is empty if the camera reports none.
    """

    side: str
    name: str
    code: str
    wanted: str
    got: str = ""

    @property
    def text(self) -> str:
        """The finding as a sentence for people."""
        if self.code == NOT_SUPPORTED:
            return f"{self.side} camera does not support {self.name} = {self.wanted}"
        return f"{self.side} camera has {self.name} = {self.got}, configured {self.wanted}"


def power_line(device: str, value: int) -> int:
    """Set the power-line frequency (0 off, 1 50 Hz, 2 60 Hz) of a device (path or number), and return the actual value.

    Raises
    ------
    OSError
        If the device has no such control.
    """
    path = _NUMBER_PATH.format(device) if device.isdigit() else device
    descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    try:
        fcntl.ioctl(descriptor, _VIDIOC_S_CTRL, struct.pack("=Ii", _POWER_LINE_FREQUENCY, value))
        answer = fcntl.ioctl(descriptor, _VIDIOC_G_CTRL, struct.pack("=Ii", _POWER_LINE_FREQUENCY, 0))
    finally:
        os.close(descriptor)
    return int(struct.unpack("=Ii", answer)[1])


def check_format(
    side: str, capture: Any, *, width: int, height: int, rate_hz: float, fourcc: str
) -> Iterator[ControlFinding]:
    """Yield the properties of the requested image format that a camera did not accept; 0 and empty are not checked."""
    for name, key, wanted in (
        ("width", cv2.CAP_PROP_FRAME_WIDTH, float(width)),
        ("height", cv2.CAP_PROP_FRAME_HEIGHT, float(height)),
        ("rate_hz", cv2.CAP_PROP_FPS, rate_hz),
    ):
        if wanted and not _near(got := float(capture.get(key)), wanted, 0.5):
            yield ControlFinding(side=side, name=name, code=NOT_TAKEN, wanted=f"{wanted:g}", got=f"{got:g}")
    if fourcc:
        number = int(capture.get(cv2.CAP_PROP_FOURCC))
        got_code = "".join(chr(number >> shift & 0xFF) for shift in (0, 8, 16, 24))
        if number != cv2.VideoWriter.fourcc(*fourcc):
            shown = got_code if got_code.isprintable() else hex(number)
            yield ControlFinding(side=side, name="fourcc", code=NOT_TAKEN, wanted=fourcc, got=shown)


def apply_controls(
    side: str, device: str, capture: Any, config: ControlsConfig, *, set_power_line: PowerLine = power_line
) -> Iterator[ControlFinding]:
    """Set a camera's controls and yield those whose actual value differs.

    Parameters
    ----------
    side
        left or right.
    device
        The camera's path or number.
    capture
        The open capture, as cv2.VideoCapture.
    config
        Values to set.
    set_power_line
        Sets the power-line frequency; see :func:`power_line`.
    """
    focus = config.left_focus if side == "left" else config.right_focus
    yield from _switched(side, "autofocus", capture, cv2.CAP_PROP_AUTOFOCUS, 0.0)
    if focus >= 0:
        yield from _value(side, f"{side}_focus", capture, cv2.CAP_PROP_FOCUS, focus)
    by_hand = config.exposure_ms > 0
    mode = _MANUAL_EXPOSURE if by_hand else _AUTO_EXPOSURE
    yield from _switched(side, "auto_exposure", capture, cv2.CAP_PROP_AUTO_EXPOSURE, mode)
    if by_hand:
        yield from _value(
            side, "exposure_ms", capture, cv2.CAP_PROP_EXPOSURE, config.exposure_ms, unit=_EXPOSURE_UNIT_MS
        )
    if config.gain >= 0:
        yield from _value(side, "gain", capture, cv2.CAP_PROP_GAIN, config.gain)
    fixed = config.white_balance_k > 0
    yield from _switched(side, "auto_white_balance", capture, cv2.CAP_PROP_AUTO_WB, 0.0 if fixed else 1.0)
    if fixed:
        yield from _value(side, "white_balance_k", capture, cv2.CAP_PROP_WB_TEMPERATURE, float(config.white_balance_k))
    if config.power_line_hz:
        yield from _power_line(side, device, config.power_line_hz, set_power_line)


def _switched(side: str, name: str, capture: Any, key: int, wanted: float) -> Iterator[ControlFinding]:
    """Set a switch. A camera without autofocus has a fixed focus anyway: that is no finding."""
    if not capture.set(key, wanted):
        if name != "autofocus":
            yield ControlFinding(side=side, name=name, code=NOT_SUPPORTED, wanted=f"{wanted:g}")
        return
    got = float(capture.get(key))
    if got != wanted:
        yield ControlFinding(side=side, name=name, code=NOT_TAKEN, wanted=f"{wanted:g}", got=f"{got:g}")


def _value(side: str, name: str, capture: Any, key: int, wanted: float, unit: float = 1.0) -> Iterator[ControlFinding]:
    """Set a value; the camera's unit is ``unit`` times the parameter's unit."""
    asked = wanted / unit
    if not capture.set(key, asked):
        yield ControlFinding(side=side, name=name, code=NOT_SUPPORTED, wanted=f"{wanted:g}")
        return
    got = float(capture.get(key))
    if not _near(got, asked, 1.0):
        yield ControlFinding(side=side, name=name, code=NOT_TAKEN, wanted=f"{wanted:g}", got=f"{got * unit:g}")


def _power_line(side: str, device: str, hertz: int, set_power_line: PowerLine) -> Iterator[ControlFinding]:
    try:
        got = set_power_line(device, _POWER_LINE[hertz])
    except OSError:
        yield ControlFinding(side=side, name="power_line_hz", code=NOT_SUPPORTED, wanted=str(hertz))
        return
    if got != _POWER_LINE[hertz]:
        has = {number: str(value) for value, number in _POWER_LINE.items()}.get(got, "0")
        yield ControlFinding(side=side, name="power_line_hz", code=NOT_TAKEN, wanted=str(hertz), got=has)


def _near(got: float, wanted: float, least: float) -> bool:
    return abs(got - wanted) <= max(least, _SHARE * abs(wanted))
