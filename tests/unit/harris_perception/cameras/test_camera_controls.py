"""Focus, exposure, gain, white balance and power-line frequency of real cameras: set, read back, and what they lack."""

from __future__ import annotations

from typing import Any

import cv2
import pytest

from harris_perception.adapters.camera_controls import (
    NOT_SUPPORTED,
    NOT_TAKEN,
    ControlFinding,
    ControlsConfig,
    apply_controls,
    power_line,
)
from harris_perception.adapters.v4l2_source import V4l2Source
from icu_common.core.configuration.config import ConfigError

pytestmark = pytest.mark.long

ALL = ControlsConfig(
    left_focus=30.0, right_focus=45.0, exposure_ms=8.0, gain=20.0, white_balance_k=4500, power_line_hz=50
)
HAS = {
    cv2.CAP_PROP_AUTOFOCUS: 1.0,
    cv2.CAP_PROP_FOCUS: 0.0,
    cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
    cv2.CAP_PROP_EXPOSURE: 156.0,
    cv2.CAP_PROP_GAIN: 64.0,
    cv2.CAP_PROP_AUTO_WB: 1.0,
    cv2.CAP_PROP_WB_TEMPERATURE: 4000.0,
}


class Webcam:
    """Stands for cv2.VideoCapture of a UVC camera: has some controls, each with its steps and limits."""

    def __init__(self, controls: dict[int, float] | None = None, **limits: Any) -> None:
        self.values = dict(HAS if controls is None else controls)
        self.largest: dict[int, float] = limits.get("largest", {})
        self.ignored: set[int] = limits.get("ignored", set())
        self.order: list[int] = []
        self.format: dict[int, float] = {}

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        self.order.append(key)
        if key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FPS, cv2.CAP_PROP_FOURCC):
            self.format[key] = min(value, self.largest.get(key, value))
            return True
        if key not in self.values:
            return False
        if key not in self.ignored:
            self.values[key] = min(value, self.largest.get(key, value))
        return True

    def get(self, key: int) -> float:
        return self.format.get(key, self.values.get(key, 0.0))


def line(has: int | None = None) -> Any:
    """A power-line frequency that is taken; one that the driver keeps at ``has``."""
    return lambda device, value: value if has is None else has


def test_what_is_configured_is_in_force_afterwards_and_nothing_is_found() -> None:
    left, right = Webcam(), Webcam()
    asked: list[tuple[str, int]] = []
    for side, camera in (("left", left), ("right", right)):
        found = apply_controls(
            side,
            "/dev/video4",
            camera,
            ALL,
            set_power_line=lambda device, value: asked.append((device, value)) or value,
        )
        assert list(found) == []
    assert left.values[cv2.CAP_PROP_FOCUS] == 30.0 and right.values[cv2.CAP_PROP_FOCUS] == 45.0
    assert left.values[cv2.CAP_PROP_EXPOSURE] == 80.0, "V4L2 counts 0.1 ms"
    assert (left.values[cv2.CAP_PROP_GAIN], left.values[cv2.CAP_PROP_WB_TEMPERATURE]) == (20.0, 4500.0)
    switches = (cv2.CAP_PROP_AUTOFOCUS, cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_AUTO_WB)
    assert [left.values[key] for key in switches] == [0.0, 1.0, 0.0]
    assert asked == [("/dev/video4", 1)] * 2
    # A camera ignores a value while its automatic is on.
    for switch, value in zip(switches, (cv2.CAP_PROP_FOCUS, cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_WB_TEMPERATURE)):
        assert left.order.index(switch) < left.order.index(value)


def test_without_values_the_automatics_stay_on_but_the_focus_is_fixed() -> None:
    camera = Webcam()
    assert list(apply_controls("left", "0", camera, ControlsConfig(power_line_hz=0), set_power_line=line())) == []
    assert camera.values == {**HAS, cv2.CAP_PROP_AUTOFOCUS: 0.0}


def test_each_control_that_is_lacking_is_named_with_its_value() -> None:
    bare = Webcam({cv2.CAP_PROP_AUTO_EXPOSURE: 3.0, cv2.CAP_PROP_EXPOSURE: 156.0, cv2.CAP_PROP_AUTO_WB: 1.0})

    def refuses(device: str, value: int) -> int:
        raise OSError(25, "Inappropriate ioctl for device")

    found = list(apply_controls("right", "2", bare, ALL, set_power_line=refuses))
    assert {(f.name, f.code, f.wanted) for f in found} == {
        ("right_focus", NOT_SUPPORTED, "45"),
        ("gain", NOT_SUPPORTED, "20"),
        ("white_balance_k", NOT_SUPPORTED, "4500"),
        ("power_line_hz", NOT_SUPPORTED, "50"),
    }
    assert "right camera does not support gain = 20" in [f.text for f in found]


def test_a_value_that_was_not_taken_is_named_with_the_cameras_own() -> None:
    camera = Webcam(largest={cv2.CAP_PROP_EXPOSURE: 50.0}, ignored={cv2.CAP_PROP_AUTOFOCUS, cv2.CAP_PROP_GAIN})
    found = list(apply_controls("left", "0", camera, ALL, set_power_line=line(2)))
    assert {(f.name, f.code, f.wanted, f.got) for f in found} == {
        ("autofocus", NOT_TAKEN, "0", "1"),
        ("exposure_ms", NOT_TAKEN, "8", "5"),
        ("gain", NOT_TAKEN, "20", "64"),
        ("power_line_hz", NOT_TAKEN, "50", "60"),
    }
    assert "left camera has exposure_ms = 5, configured 8" in [f.text for f in found]


def test_a_step_of_the_camera_is_no_finding() -> None:
    camera = Webcam(largest={cv2.CAP_PROP_EXPOSURE: 78.0, cv2.CAP_PROP_WB_TEMPERATURE: 4480.0})
    assert list(apply_controls("left", "0", camera, ALL, set_power_line=line())) == []


def test_the_source_keeps_what_both_cameras_lack_also_of_the_format() -> None:
    cameras = [Webcam(), Webcam({}, largest={cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FPS: 15.0})]
    source = V4l2Source(
        ["0", "2"],
        now_ns=lambda: 0,
        width=1280,
        rate_hz=30.0,
        fourcc="MJPG",
        open_device=lambda device, api: cameras.pop(0),
        controls=ControlsConfig(exposure_ms=5.0),
        set_power_line=line(),
    )
    assert {(f.side, f.name, f.code, f.wanted, f.got) for f in source.findings} == {
        ("right", "width", NOT_TAKEN, "1280", "640"),
        ("right", "rate_hz", NOT_TAKEN, "30", "15"),
        ("right", "auto_exposure", NOT_SUPPORTED, "1", ""),
        ("right", "exposure_ms", NOT_SUPPORTED, "5", ""),
        ("right", "auto_white_balance", NOT_SUPPORTED, "1", ""),
    }


def test_another_pixel_format_is_named() -> None:
    class Yuyv(Webcam):
        def get(self, key: int) -> float:
            return float(cv2.VideoWriter.fourcc(*"YUYV")) if key == cv2.CAP_PROP_FOURCC else super().get(key)

    source = V4l2Source(["0"], now_ns=lambda: 0, fourcc="MJPG", open_device=lambda device, api: Yuyv())
    assert source.findings == (ControlFinding(side="left", name="fourcc", code=NOT_TAKEN, wanted="MJPG", got="YUYV"),)


def test_the_power_line_of_what_is_no_camera_is_an_error(tmp_path: Any) -> None:
    (tmp_path / "video").touch()
    for device in (str(tmp_path / "video"), str(tmp_path / "none")):
        with pytest.raises(OSError):
            power_line(device, 1)


def test_frequencies_other_than_the_mains_are_rejected() -> None:
    with pytest.raises(ConfigError, match="power_line_hz = 55"):
        ControlsConfig(power_line_hz=55)
