"""The bench in real time: motor samples in by one socket, stereo pairs and the truth out by others."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from nodes.small_bench import LAYOUT_FILE, SMALL
from rclpy.parameter import Parameter
from support.line_socket import LineSocket

from icu_common.adapters.frame_link import FrameClient
from icu_common.core.configuration.config import ConfigError, from_mapping
from icu_common.core.panel.panel_layout import load_layout
from icu_common.nodes.qos import RESULTS
from icu_simulator.adapters.bench.motion_client import MotionClient, parse_sample
from icu_simulator.adapters.bench.simulation import Simulation
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.optics import stereo_rig
from icu_simulator.nodes.bench_node import BenchNode

IDEAL = {
    "mechanics.backlash_mm": (0.0, 0.0),
    "mechanics.backlash_z_mm": 0.0,
    "mechanics.scale": 0.0,
    "mechanics.skew_rad": 0.0,
    "mechanics.tilt_rad": 0.0,
}


class Board:
    """Replaces the mock board: serves lines that the test writes to each client that connects."""

    def __init__(self, path: Path) -> None:
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen(2)
        self._listener.settimeout(20.0)
        self.link, _ = None, None
        self.path = path

    def accept(self) -> None:
        self.link, _ = self._listener.accept()

    def say(self, *samples: tuple[float, tuple[float, float, float]]) -> None:
        assert self.link is not None
        lines = [
            json.dumps({"t": t, "mpos": list(mpos), "spindle": 0.0, "coolant": False, "state": "Idle"}) + "\n"
            for t, mpos in samples
        ]
        self.link.sendall("".join(lines).encode())

    def close(self) -> None:
        if self.link is not None:
            self.link.close()
        self._listener.close()
        self.path.unlink(missing_ok=True)


class Bench:
    def __init__(self, folder: Path, **settings: Any) -> None:
        self.folder = folder
        self.config = from_mapping(
            BenchConfig,
            {
                **SMALL,
                "layout": str(LAYOUT_FILE),
                "motion_socket": str(folder / "truth"),
                "frame_socket": str(folder / "frames"),
                "test_socket": str(folder / "bench"),
                "truth_log": str(folder / "log.jsonl"),
                **settings,
            },
        )
        self.simulation = Simulation(load_layout(LAYOUT_FILE), self.config)
        self.stack = contextlib.ExitStack()
        self.stack.callback(self.simulation.stop)
        self.simulation.start()
        self._truth = LineSocket(folder / "bench")
        self.stack.callback(self._truth.close)
        self.ask = self._truth.ask

    def board(self) -> Board:
        board = Board(self.folder / "truth")
        self.stack.callback(board.close)
        board.accept()
        return board

    def camera(self) -> FrameClient:
        client = FrameClient(self.folder / "frames")
        self.stack.callback(client.close)
        return client

    def until(self, condition: Any, within_s: float = 20.0) -> Any:
        """Ask for the truth, one answer after the other, until it fits."""
        deadline = time.monotonic() + within_s
        while not condition(truth := self.ask("truth")):
            assert time.monotonic() < deadline, f"never so: {truth}"
        return truth


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Any]:
    benches: list[Bench] = []

    def make(**settings: Any) -> Bench:
        benches.append(Bench(tmp_path, **settings))
        return benches[-1]

    yield make
    for bench in benches:
        bench.stack.close()


def magenta(picture: np.ndarray) -> np.ndarray:
    """Centre of the ball in pixels."""
    blue, green, red = (picture[..., i].astype(float) for i in range(3))
    share = np.clip(np.minimum(red, blue) - green - 30, 0, None)
    rows, columns = np.mgrid[0 : share.shape[0], 0 : share.shape[1]]
    return np.array([(share * columns).sum(), (share * rows).sum()]) / share.sum()


def test_the_ball_is_where_it_was_at_the_stamp(start: Any) -> None:
    bench = start(**IDEAL)
    board, camera = bench.board(), bench.camera()
    camera.read(20.0)
    # To and fro at 40 mm/s, six seconds each way, sent ahead of time so that a loaded machine cannot delay it.
    begin, speed, count, step = time.monotonic() - 0.05, 40.0, 399, 0.04

    def way_mm(after_s: float) -> float:
        return speed * (6.0 - abs(after_s % 12.0 - 6.0))

    board.say(*((begin + step * i, (-309 + way_mm(step * i), -109.0, -11.0)) for i in range(count)))
    rig = stereo_rig(bench.config.camera)
    seen = 0
    deadline = time.monotonic() + 20.0
    while seen < 6:
        assert time.monotonic() < deadline, f"only {seen} pairs within the way"
        pictures, (stamp_ns, _), _ = camera.read(20.0)
        at = (stamp_ns - time.time_ns()) * 1e-9 + time.monotonic() - begin
        if not 0.1 < at < step * count - 0.1:
            assert at < step * count, "the way ended before enough pairs had come"
            continue
        tip = np.array([0.050 + way_mm(at) / 1000, 0.110, -0.010])
        for picture, view in zip(pictures, (rig.left, rig.right)):
            off = magenta(picture) - view.project(tip)[0]
            # The shading is not quite even and the stem hides a little: half a pixel of 0.74 mm; 15 ms are 0.8 px.
            assert np.abs(off).max() < 0.6, f"{off} px off at {at:.3f} s"
        seen += 1


def test_pairs_have_a_beat_and_an_age(start: Any) -> None:
    bench = start()
    camera = bench.camera()
    stamps = []
    for _ in range(6):
        pictures, (stamp_ns, other_ns), _ = camera.read(20.0)
        assert stamp_ns == other_ns
        assert [p.shape for p in pictures] == [(360, 640, 3)] * 2
        stamps.append(stamp_ns)
        assert 0 < time.time_ns() - stamp_ns < 10e9
    assert min(np.diff(stamps)) > 0


def test_without_readers_nothing_is_rendered(start: Any) -> None:
    bench = start(**{"camera.rate_hz": 60.0})
    for _ in range(20):
        bench.ask("truth")
    assert bench.simulation.health().frames_sent == 0
    camera = bench.camera()
    camera.read(20.0)
    camera.read(20.0)  # the second pair is sent after the first was counted
    assert bench.simulation.health().frames_sent > 0


def test_touching_run_stop_is_told_in_truth_and_log(start: Any, tmp_path: Path) -> None:
    bench = start(**IDEAL)
    board = bench.board()
    truth = bench.ask("truth")
    rotation = np.array(truth["base_from_panel"]["rotation"])
    base = (rotation @ [0.208, 0.127, 0.0034] + truth["base_from_panel"]["translation_m"]) * 1000
    begin = time.monotonic() + 0.05
    board.say((begin, (base[0] - 359, base[1] - 219, -1.0)))
    board.say(*((begin + 0.01 * i, (base[0] - 359, base[1] - 219, -1 + base[2] * i / 100)) for i in range(1, 101)))
    truth = bench.until(lambda t: t["contact"] == "RUN_STOP" and not t["instrument"]["running"])
    assert truth["tip_panel_mm"][:2] == pytest.approx([208, 127], abs=0.2)
    records = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    kinds = [r["event"] for r in records]
    assert kinds.index("contact") < kinds.index("press") <= kinds.index("instrument")
    contact = records[kinds.index("contact")]
    assert contact["control"] == "RUN_STOP"
    assert contact["t"] == pytest.approx(time.time() - (time.monotonic() - begin), abs=1.2)


def test_truth_has_the_cameras_pose(start: Any) -> None:
    bench = start()
    truth = bench.ask("truth")
    camera_from_base, camera_from_panel, base_from_panel = (
        (np.array(truth[key]["rotation"]), np.array(truth[key]["translation_m"]))
        for key in ("camera_from_base", "camera_from_panel", "base_from_panel")
    )
    point = np.array([0.1, 0.05, 0.0])
    in_base = base_from_panel[0] @ point + base_from_panel[1]
    chained = camera_from_base[0] @ in_base + camera_from_base[1]
    assert camera_from_panel[0] @ point + camera_from_panel[1] == pytest.approx(chained.tolist(), abs=1e-12)
    assert truth["ok"] is True
    assert truth["instrument"]["running"] is True


STILL_PX = 360
"""First column of the pictures that is right of all that moves by itself."""


def shift_px(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return how far the scene has moved between two images, x and y."""
    gray = [cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32) for image in (before, after)]
    window = cv2.createHanningWindow(gray[0].shape[::-1], cv2.CV_32F)
    return np.array(cv2.phaseCorrelate(*gray, window)[0])


def test_free_running_cameras_have_two_stamps(start: Any) -> None:
    bench = start(
        **{"imaging.free_running.enabled": True, "imaging.free_running.phase_ms": 20.0, "camera.rate_hz": 12.5}
    )
    bench.ask("set", values={"imaging.free_running.drift_ppm": 0.0})
    camera = bench.camera()
    for _ in range(3):
        _, stamps_ns, cameras = camera.read(20.0)
        assert cameras == (0, 1)
        assert stamps_ns[0] - stamps_ns[1] == pytest.approx(20_000_000, abs=1000)


def test_a_camera_can_be_knocked_and_effects_switched_on_while_the_bench_runs(start: Any) -> None:
    bench = start()
    camera = bench.camera()
    before = camera.read(20.0).pictures
    truth = bench.ask("truth")["camera_from_base"]
    assert bench.ask("knock", camera="right", turn_deg=[0.0, 0.2, 0.0])["ok"]

    def moved() -> list[np.ndarray]:
        # Right of the oscilloscope's screen, whose trace moves by itself: with it, shifts differed by up to 0.2 px.
        return [shift_px(a[:, STILL_PX:], b[:, STILL_PX:]) for a, b in zip(before, camera.read(20.0).pictures)]

    deadline = time.monotonic() + 20.0
    while abs((shifts := moved())[1][0]) < 1.0:
        assert time.monotonic() < deadline, f"never moved: {shifts}"
    # The camera looks 0.2 degrees further to its right: 850 px times the angle, 2.97 px in the middle of the picture.
    # Off the axis the image plane is oblique to the rays; the lens compensates a part of it: 3.08 px on average there.
    assert shifts[1] == pytest.approx([-3.08, 0.0], abs=0.08)
    assert shifts[0] == pytest.approx([0.0, 0.0], abs=0.01)
    assert bench.ask("truth")["camera_from_base"] == truth, "the left camera stays"
    bench.ask("knock", camera="left", turn_deg=[0.1, 0.0, 0.0])
    assert bench.ask("truth")["camera_from_base"] != truth
    assert "camera 'top'" in bench.ask("knock", camera="top", turn_deg=[0.1, 0.0, 0.0])["error"]
    assert "limit 5 degrees" in bench.ask("knock", camera="left", turn_deg=[9.0, 0.0, 0.0])["error"]
    sharp = camera.read(20.0).pictures[0]
    bench.ask("set", values={"imaging.jpeg.enabled": True, "imaging.jpeg.quality": 10})
    deadline = time.monotonic() + 20.0
    while np.array_equal(seen := camera.read(20.0).pictures[0], sharp) or blockiness(seen) < 1.3 * blockiness(sharp):
        assert time.monotonic() < deadline, "never compressed"


def blockiness(image: np.ndarray) -> float:
    """Return the steps at the borders of JPEG's blocks over those elsewhere."""
    steps = np.abs(np.diff(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(float), axis=1)).mean(axis=0)
    at_border = np.arange(1, len(steps) + 1) % 8 == 0
    return float(steps[at_border].mean() / steps[~at_border].mean())


def test_the_board_may_come_late_and_come_again(start: Any) -> None:
    bench = start(**IDEAL)
    assert bench.ask("truth")["board_connected"] is False
    for x in (-300.0, -200.0):
        board = bench.board()
        board.say((time.monotonic(), (x, -119.0, -1.0)))
        bench.until(lambda t, x=x: t["board_connected"] and abs(t["tip_base_m"][0] - (359 + x) / 1000) < 1e-6)
        board.close()
        bench.until(lambda t: not t["board_connected"])


def test_faults_of_camera_and_light(start: Any) -> None:
    bench = start()
    camera = bench.camera()
    bright = camera.read(20.0)[0][0].mean()
    assert bench.ask("set", values={"light.level": 0.3})["ok"]
    deadline = time.monotonic() + 20
    while camera.read(20.0)[0][0].mean() > 0.6 * bright:
        assert time.monotonic() < deadline
    assert bench.ask("camera", state="frozen")["ok"]
    with pytest.raises(TimeoutError):
        for _ in range(10):
            camera.read(2.0)
    assert bench.ask("camera", state="unplugged")["ok"]
    with pytest.raises(ConnectionError):
        for _ in range(10):
            camera.read(20.0)
    with pytest.raises(OSError):
        FrameClient(bench.folder / "frames")
    assert bench.ask("camera", state="ok")["ok"]
    bench.camera().read(20.0)


def test_hand_and_pushed_panel(start: Any) -> None:
    bench = start()
    camera = bench.camera()
    before = camera.read(20.0)[0][0]
    assert bench.ask("hide", rectangle_mm=[190, 30, 120, 110])["ok"]

    def differs() -> bool:
        return bool(np.abs(camera.read(20.0)[0][0].astype(int) - before).mean() > 5)

    deadline = time.monotonic() + 20
    while not differs():
        assert time.monotonic() < deadline
    assert bench.ask("hide", rectangle_mm=None)["ok"]
    truth = bench.ask("truth")["base_from_panel"]["translation_m"]
    assert bench.ask("move_panel", dx_m=0.004, dy_m=-0.002, turn_deg=0.5)["ok"]
    moved = bench.ask("truth")["base_from_panel"]["translation_m"]
    assert np.subtract(moved, truth) == pytest.approx([0.004, -0.002, 0.0])


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"do": "nonsense"}, "do = one of truth"),
        ({"do": "set", "values": {"light.level": 9.0}}, "level = 9.0 is above its maximum 3"),
        ({"do": "set", "values": {"colour": 1}}, "has no setting colour"),
        ({"do": "hide", "rectangle_mm": [1, 2, -3, 4]}, "must be positive"),
        ({"do": "move_panel", "dx_m": 5.0}, "at most 0.1 m"),
        ({"do": "camera", "state": "broken"}, "none of ok, frozen, unplugged"),
    ],
)
def test_bad_requests_are_answered_with_the_reason(start: Any, request_: dict[str, Any], message: str) -> None:
    bench = start()
    answer = bench.ask(**request_)
    assert answer["ok"] is False
    assert message in answer["error"]
    assert bench.ask("truth")["ok"] is True


def test_stopping_removes_the_sockets(start: Any) -> None:
    bench = start()
    assert (bench.folder / "frames").exists()
    bench.simulation.stop()
    assert not (bench.folder / "frames").exists()
    assert not (bench.folder / "bench").exists()
    bench.simulation.stop()


def test_samples_are_checked() -> None:
    sample = parse_sample(b'{"t": 1.5, "mpos": [1, 2, 3], "spindle": 0, "coolant": true, "state": "Run"}')
    assert sample.mpos_mm == (1.0, 2.0, 3.0)
    assert sample.coolant is True
    for line in (b"[]", b"{}", b'{"t": 1, "mpos": [1, 2], "spindle": 0, "coolant": 0, "state": "x"}', b"\xff"):
        with pytest.raises(ValueError):
            parse_sample(line)


def test_garbage_from_the_board_is_counted(tmp_path: Path) -> None:
    board = Board(tmp_path / "truth")
    client = MotionClient(tmp_path / "truth")
    assert client.connect()
    board.accept()
    assert board.link is not None
    board.link.sendall(b'garbage\n{"t": 1, "mpos": [1, 2, 3], "spindle": 0, "coolant": false, "state": "I')
    assert client.read() == []
    assert client.bad_lines == 1
    board.link.sendall(b'dle"}\n')
    assert [s.mpos_mm for s in client.read()] == [(1.0, 2.0, 3.0)]
    board.close()
    assert client.read() == []
    assert client.socket is None


def node_parameters(folder: Path) -> dict[str, Any]:
    values = {
        "layout": str(LAYOUT_FILE),
        "motion_socket": str(folder / "truth"),
        "frame_socket": str(folder / "frames"),
    }
    return {**{key: list(v) if isinstance(v, tuple) else v for key, v in SMALL.items()}, **values}


def test_node_reports_its_health_and_takes_parameters(ros: Any, tmp_path: Path) -> None:
    node = ros.node(BenchNode, node_parameters(tmp_path))
    received = ros.collect(ros.plain(), DiagnosticArray, "/diagnostics", RESULTS)

    def statuses() -> list[tuple[bytes, str]]:
        return [(s.level, s.message) for m in received for s in m.status if s.name == "/bench"]

    ros.spin_until(
        lambda: (b"\x01", "no motor positions: the mock board does not answer") in statuses(), 20.0, statuses
    )
    board = Board(tmp_path / "truth")
    threading.Thread(target=board.accept, daemon=True).start()
    ros.spin_until(lambda: (b"\x00", "running") in statuses(), 20.0, statuses)
    camera = FrameClient(tmp_path / "frames")
    bright = camera.read(20.0)[0][0].mean()
    assert node.set_parameters([Parameter("light.level", value=0.3)])[0].successful
    deadline = time.monotonic() + 20.0
    while camera.read(20.0)[0][0].mean() > 0.6 * bright:
        assert time.monotonic() < deadline
    refused = node.set_parameters([Parameter("light.glare_at_mm", value=[1.0])])[0]
    assert not refused.successful
    assert "glare_at_mm" in refused.reason
    assert not node.set_parameters([Parameter("seed", value=5)])[0].successful, "the seed is read-only"
    camera.close()
    board.close()
    topics = {name for name, _ in node.get_publisher_names_and_types_by_node("bench", "/")}
    assert topics <= {"/diagnostics", "/parameter_events", "/rosout"}, "nothing of the truth goes to a topic"


def test_node_refuses_to_start_without_a_layout(ros: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="layout is empty"):
        ros.node(BenchNode, {})
    broken = tmp_path / "broken.yaml"
    broken.write_text("model: x\n")
    with pytest.raises(ConfigError, match=r"broken.yaml:1"):
        ros.node(BenchNode, {"layout": str(broken)})
