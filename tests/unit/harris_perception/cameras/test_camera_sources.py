"""Camera sources: pictures, stamps and errors, against real files and sockets and a scripted V4L2 device."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from harris_perception.adapters import camera_sources
from harris_perception.adapters.camera_sources import (
    BenchSource,
    CameraNodeConfig,
    SourceEnded,
    SourceError,
    V4l2Source,
    open_source,
    picture_files,
    require_settings,
)
from icu_common.adapters.frame_link import FrameServer
from icu_common.core.configuration.config import ConfigError

pytestmark = pytest.mark.slow


def numbered(value: int, shape: tuple[int, int] = (24, 32)) -> np.ndarray[Any, Any]:
    return np.full((*shape, 3), value, np.uint8)


def write_folder(folder: Path, values: list[int]) -> Path:
    folder.mkdir()
    for i, value in enumerate(values):
        cv2.imwrite(str(folder / f"picture{i}.png"), numbered(value))
    return folder


class Clock(threading.Event):
    """A recording's clock, and the event that ends its pauses: what waits for it is on time."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now

    def wait(self, timeout: float | None = None) -> bool:
        assert timeout is not None
        self.now += timeout
        return False


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(camera_sources, "time", clock)
    return clock


def opened(config: CameraNodeConfig, now_ns: int = 7) -> Any:
    return open_source(config, now_ns=lambda: now_ns, stop=threading.Event())


def test_images_come_in_natural_order_with_the_clocks_stamp(tmp_path: Path) -> None:
    left = write_folder(tmp_path / "left", list(range(12)))
    right = write_folder(tmp_path / "right", list(range(100, 112)))
    source = opened(CameraNodeConfig(source="images", left_path=str(left), right_path=str(right), rate_hz=240.0))
    frames = [source.read(1.0) for _ in range(13)]
    assert [int(f.pictures[0][0, 0, 0]) for f in frames] == [*range(12), 0]
    assert [int(f.pictures[1][5, 5, 2]) for f in frames] == [*range(100, 112), 100]
    assert frames[0].stamps_ns == (7, 7) and frames[0].pictures[0].shape == (24, 32, 3)


def test_a_recording_without_loop_ends(tmp_path: Path) -> None:
    left = write_folder(tmp_path / "left", [1, 2])
    source = opened(CameraNodeConfig(source="images", left_path=str(left), loop=False, rate_hz=240.0))
    assert [int(source.read(1.0).pictures[0][0, 0, 0]) for _ in range(2)] == [1, 2]
    with pytest.raises(SourceEnded):
        source.read(1.0)


def test_a_recording_keeps_its_rate(tmp_path: Path, clock: Clock) -> None:
    left = write_folder(tmp_path / "left", [1, 2, 3])
    config = CameraNodeConfig(source="images", left_path=str(left), rate_hz=50.0)
    source = open_source(config, now_ns=lambda: 7, stop=clock)
    given = []
    for _ in range(11):
        source.read(1.0)
        given.append(clock.now)
    assert given == pytest.approx(np.arange(11) * 0.02)
    clock.now += 5.0
    for _ in range(11):
        source.read(1.0)
        given.append(clock.now)
    # A late reader gets one at once, and one that was due by then; after these the rate is as before.
    assert given[11:] == pytest.approx([5.2, 5.2, *(5.2 + np.arange(1, 10) * 0.02)])


def test_a_set_stop_event_ends_the_pause_between_pictures(tmp_path: Path) -> None:
    left = write_folder(tmp_path / "left", [1, 2, 3])
    stop = threading.Event()
    config = CameraNodeConfig(source="images", left_path=str(left), rate_hz=0.01)
    source = open_source(config, now_ns=lambda: 0, stop=stop)
    source.read(1.0)
    threading.Timer(0.05, stop.set).start()
    begin = time.monotonic()
    source.read(1.0)
    assert time.monotonic() - begin < 10.0


def test_pattern_picks_one_camera_from_a_shared_folder(tmp_path: Path) -> None:
    for name in ("left10.png", "left9.png", "right9.png", "left1.txt"):
        (tmp_path / name).write_bytes(b"x")
    assert [f.name for f in picture_files(str(tmp_path / "left*"))] == ["left9.png", "left10.png"]


def test_every_format_that_is_read_is_seen_in_a_folder(tmp_path: Path) -> None:
    names = [f"{number}{ending}" for number, ending in enumerate((".png", ".JPG", ".bmp", ".pgm", ".tif", ".webp"))]
    for name in (*names, "notes.txt"):
        (tmp_path / name).touch()
    assert [f.name for f in picture_files(str(tmp_path))] == names


def test_pictures_whose_names_are_not_utf8_are_read(tmp_path: Path) -> None:
    """OpenCV ends the process by such a name."""
    folder = write_folder(tmp_path / "left", [7, 9])
    for path in list(folder.iterdir()):
        path.rename(os.fsdecode(os.fsencode(path.with_suffix("")) + b"\xe9.png"))
    source = opened(CameraNodeConfig(source="images", left_path=str(folder)))
    assert [int(source.read(1.0).pictures[0][0, 0, 0]) for _ in range(2)] == [7, 9]


def test_errors_name_the_place(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="nowhere"):
        opened(CameraNodeConfig(source="images", left_path=str(tmp_path / "nowhere")))
    left, right = write_folder(tmp_path / "l", [1, 2, 3]), write_folder(tmp_path / "r", [1, 2])
    with pytest.raises(SourceError, match="3 left and 2 right"):
        opened(CameraNodeConfig(source="images", left_path=str(left), right_path=str(right)))
    (left / "picture0.png").write_bytes(b"not a picture")
    with pytest.raises(SourceError, match=r"picture0\.png"):
        opened(CameraNodeConfig(source="images", left_path=str(left))).read(1.0)
    with pytest.raises(SourceError, match=r"absent\.avi"):
        opened(CameraNodeConfig(source="video", left_path=str(tmp_path / "absent.avi")))
    with pytest.raises(SourceError, match=r"'caf\\udce9\.avi' is no UTF-8"):  # which ends the process in OpenCV
        opened(CameraNodeConfig(source="video", left_path="caf\udce9.avi"))
    with pytest.raises(SourceError, match=r"left camera .*video-that-is-not-there"):
        opened(CameraNodeConfig(source="v4l2", left_device=str(tmp_path / "video-that-is-not-there")))
    with pytest.raises(SourceError, match="no simulated bench"):
        opened(CameraNodeConfig(source="bench", bench_socket=str(tmp_path / "none.sock")))


def test_video_gives_every_picture_once_at_the_files_rate(tmp_path: Path, clock: Clock) -> None:
    path = tmp_path / "movie.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 100.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write MJPG")
    for value in range(0, 250, 25):
        writer.write(numbered(value, (48, 64)))
    writer.release()
    config = CameraNodeConfig(source="video", left_path=str(path), loop=False)
    source = open_source(config, now_ns=lambda: 7, stop=clock)
    levels = [float(source.read(1.0).pictures[0].mean()) for _ in range(10)]
    assert clock.now == pytest.approx(0.09)
    assert np.allclose(levels, range(0, 250, 25), atol=4)
    with pytest.raises(SourceEnded):
        source.read(1.0)


def test_bench_frames_keep_pixels_and_stamp(tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "bench.sock")
    source = BenchSource(tmp_path / "bench.sock")
    with pytest.raises(TimeoutError):
        source.read(0.01)
    rng = np.random.default_rng(5)
    pair = [rng.integers(0, 256, (30, 40, 3), np.uint8) for _ in range(2)]
    server.send(pair, 123_456_789_000)
    frames = source.read(1.0)
    assert frames.stamps_ns == (123_456_789_000,) * 2 and frames.cameras == (0, 1)
    assert all(np.array_equal(a, b) for a, b in zip(frames.pictures, pair))
    server.send(pair[1:], (124_000_000_000,), (1,))  # the left camera lost its image
    frames = source.read(1.0)
    assert frames.stamps_ns == (124_000_000_000,) and frames.cameras == (1,)
    assert np.array_equal(frames.pictures[0], pair[1])
    server.close()
    with pytest.raises(SourceError, match="gone"):
        source.read(1.0)
    source.close()


class ScriptedDevice:
    """Stands for cv2.VideoCapture: answers grabs with pictures and driver stamps until it is unplugged."""

    def __init__(self, driver_ms: float, *, there: bool = True, grabs: int = 1_000_000) -> None:
        self.driver_ms, self.there, self.grabs = driver_ms, there, grabs
        self.asked: dict[int, float] = {}
        self.released = False

    def isOpened(self) -> bool:
        return self.there

    def set(self, key: int, value: float) -> bool:
        self.asked[key] = value
        return True

    def get(self, key: int) -> float:
        return self.driver_ms if key == cv2.CAP_PROP_POS_MSEC else self.asked.get(key, 0.0)

    def grab(self) -> bool:
        self.grabs -= 1
        return self.grabs >= 0

    def retrieve(self) -> tuple[bool, Any]:
        return True, numbered(9)

    def release(self) -> None:
        self.released = True


def v4l2(*devices: ScriptedDevice, monotonic_ns: int = 5_000_000_000) -> V4l2Source:
    waiting = list(devices)
    return V4l2Source(
        ["/dev/video0", "2"][: len(devices)],
        now_ns=lambda: 1_700_000_000_000_000_000,
        monotonic_ns=lambda: monotonic_ns,
        width=1280,
        height=720,
        rate_hz=30.0,
        fourcc="MJPG",
        open_device=lambda device, api: waiting.pop(0),
    )


def test_v4l2_stamps_are_the_drivers_on_the_ros_clock() -> None:
    left, right = ScriptedDevice(4980.0), ScriptedDevice(4970.0)
    frames = v4l2(left, right).read(1.0)
    assert frames.stamps_ns == (1_699_999_999_980_000_000, 1_699_999_999_970_000_000)
    assert left.asked[cv2.CAP_PROP_FRAME_WIDTH] == 1280 and left.asked[cv2.CAP_PROP_FPS] == 30.0
    assert left.asked[cv2.CAP_PROP_FOURCC] == cv2.VideoWriter.fourcc(*"MJPG")


def test_opencv_is_told_how_long_a_device_may_be_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of its own it waits ten seconds, in which nothing says that the camera has fallen silent."""
    name = "OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT"
    told: list[str] = []

    def open_device(device: Any, api: int) -> ScriptedDevice:
        told.append(os.environ[name])
        return ScriptedDevice(0.0)

    for own, silence_s, expected in (("", 2.0, "2"), ("", 0.1, "1"), ("", 2.5, "3"), ("7", 2.0, "7")):
        monkeypatch.setenv(name, own)
        if not own:
            monkeypatch.delenv(name)
        V4l2Source(["0"], now_ns=lambda: 0, silence_s=silence_s, open_device=open_device)
        assert told.pop() == expected


@pytest.mark.parametrize("driver_ms", [0.0, -1.0, 1000.0, 6000.0, 1.7e12])
def test_v4l2_without_a_usable_driver_stamp_takes_the_time_of_the_grab(driver_ms: float) -> None:
    assert v4l2(ScriptedDevice(driver_ms)).read(1.0).stamps_ns == (1_700_000_000_000_000_000,)


def test_v4l2_unplugged_names_the_camera() -> None:
    source = v4l2(ScriptedDevice(4990.0), ScriptedDevice(4990.0, grabs=1))
    source.read(1.0)
    with pytest.raises(SourceError, match="right camera 2"):
        source.read(1.0)
    left = ScriptedDevice(0.0)
    with pytest.raises(SourceError, match="right camera 2 cannot be opened"):
        v4l2(left, ScriptedDevice(0.0, there=False))
    assert left.released


class NoisyDevice(ScriptedDevice):
    """A sensor whose pictures differ by one pixel, until it is frozen."""

    frozen = False
    pictures = 0

    def retrieve(self) -> tuple[bool, Any]:
        self.pictures += not self.frozen
        picture = numbered(9, (64, 64))
        picture[37, 21] = self.pictures % 256
        return True, picture


def test_v4l2_pictures_that_waited_while_the_computer_was_busy_keep_their_time() -> None:
    """An image from before a motion must not get a time after it."""
    left, right, now = NoisyDevice(0.0), NoisyDevice(0.0), [5_000_000_000]
    waiting = [left, right]
    source = V4l2Source(
        ["0", "2"], now_ns=lambda: now[0], monotonic_ns=lambda: now[0], open_device=lambda device, api: waiting.pop(0)
    )
    for age_ms in (20.0, 1500.0, 3000.0, 20.0):
        now[0] += 4_000_000_000
        left.driver_ms = now[0] / 1e6 - age_ms
        assert source.read(1.0).stamps_ns == (now[0] - round(age_ms * 1e6), now[0]), "the right one has no stamps"


def test_v4l2_that_repeats_one_picture_with_new_stamps_is_no_live_camera() -> None:
    left, right, now = NoisyDevice(0.0), NoisyDevice(0.0), [0]
    waiting = [left, right]
    source = V4l2Source(
        ["0", "2"], now_ns=lambda: now[0], monotonic_ns=lambda: now[0], open_device=lambda device, api: waiting.pop(0)
    )
    for frame in range(90):
        right.frozen = 30 < frame < 55  # less than a second is no reason
        now[0] = frame * 33_000_000
        source.read(1.0)
    right.frozen = True
    with pytest.raises(SourceError, match=r"right camera 2 has given the very same picture for 1\.0 s: it is frozen"):
        for frame in range(90, 125):
            now[0] = frame * 33_000_000
            source.read(1.0)
    assert frame in (120, 121)


def test_settings_that_belong_together() -> None:
    with pytest.raises(ConfigError, match="bench_socket"):
        require_settings(CameraNodeConfig())
    with pytest.raises(ConfigError, match="left_path"):
        require_settings(CameraNodeConfig(source="video"))
    with pytest.raises(ConfigError, match="'MJ'"):
        require_settings(CameraNodeConfig(source="v4l2", fourcc="MJ"))
    with pytest.raises(ConfigError, match="retry_max_s"):
        require_settings(CameraNodeConfig(source="v4l2", retry_min_s=2.0, retry_max_s=1.0))
