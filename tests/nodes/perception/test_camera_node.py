"""Camera node: what subscribers get, and what happens when the camera or its calibration is missing."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image

from harris_perception.nodes.camera_node import CameraNode
from icu_common.adapters.frame_link import FrameServer
from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_model, image_array
from icu_common.nodes.messages.heads import stamp_ns

WITHIN_S = 20.0
STAMP_NS = 1_600_000_000_123_456_789


def pair(value: int) -> list[np.ndarray[Any, Any]]:
    left = np.arange(40 * 60 * 3, dtype=np.uint8).reshape(40, 60, 3)
    left[0, 0] = value
    return [left, 255 - left]


def calibration(path: Path, size: tuple[int, int] = (60, 40)) -> str:
    k = np.array([[80.0, 0, 30], [0, 81, 20], [0, 0, 1]])
    p = np.array([[82.0, 0, 31, -8.2], [0, 82, 21, 0], [0, 0, 1, 0]])
    d = np.array([-0.08, 0.01, 0.001, -0.002, 0.0])
    model = CameraModel(name="test", width=size[0], height=size[1], k=k, d=d, r=np.eye(3), p=p)
    path.write_text(yaml.safe_dump(model.to_mapping()), encoding="utf-8")
    return str(path)


class Rig:
    """A frame server, the node that reads it, and what the topics carried."""

    def __init__(self, ros: Any, tmp_path: Path, **parameters: Any) -> None:
        self.ros, self.path = ros, tmp_path / "bench.sock"
        probe = ros.plain()
        self.got = {
            topic: ros.collect(probe, kind, topic, qos.IMAGES)
            for kind, name in ((Image, "image_raw"), (CameraInfo, "camera_info"))
            for topic in (f"left/{name}", f"right/{name}")
        }
        self.diagnostics: list[DiagnosticArray] = ros.collect(probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
        self.node = ros.node(CameraNode, {"source": "bench", "bench_socket": str(self.path), **parameters})
        ros.spin_until(
            lambda: all(self.node.count_subscribers(t) and probe.count_publishers(t) for t in self.got), WITHIN_S
        )

    def serve_until(self, server: FrameServer, condition: Any) -> Any:
        """Send pairs with rising stamps at 50 Hz until the condition holds."""
        sent, due = 0, time.monotonic()

        def step() -> Any:
            nonlocal sent, due
            if time.monotonic() >= due and server.reader_count():
                server.send(pair(sent % 256), STAMP_NS + sent)
                sent, due = sent + 1, time.monotonic() + 0.02
            server.flush()
            return condition()

        return self.ros.spin_until(step, WITHIN_S, lambda: (sent, self.texts()))

    def texts(self) -> list[str]:
        return [s.message for d in self.diagnostics for s in d.status if s.name == "camera"]


def test_pictures_and_calibration_carry_the_sources_stamp_and_pixels(ros: Any, tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "bench.sock")
    path = calibration(tmp_path / "left.yaml")
    rig = Rig(ros, tmp_path, left_calibration=path, right_calibration=path)
    rig.serve_until(server, lambda: all(len(messages) >= 3 for messages in rig.got.values()))
    for side, i in (("left", 0), ("right", 1)):
        for image in rig.got[f"{side}/image_raw"]:
            number = stamp_ns(image.header.stamp) - STAMP_NS
            assert np.array_equal(image_array(image), pair(number % 256)[i])
            assert image.header.frame_id == f"camera_{side}_optical_frame" and image.encoding == "bgr8"
        info = rig.got[f"{side}/camera_info"][-1]
        assert info.header.frame_id == f"camera_{side}_optical_frame"
        assert camera_model(info).k[0, 0] == 80.0 and camera_model(info).p[0, 3] == -8.2
    left, right = ([stamp_ns(m.header.stamp) for m in rig.got[t]] for t in ("left/image_raw", "right/image_raw"))
    assert left == sorted(set(left)) and set(left) & set(right)
    server.close()


def test_a_lost_image_is_missed_by_its_own_camera_only(ros: Any, tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "bench.sock")
    rig = Rig(ros, tmp_path)
    rig.serve_until(server, lambda: rig.got["left/image_raw"] and rig.got["right/image_raw"])
    lone_ns, images = STAMP_NS + 10**9, rig.got["right/image_raw"]

    def lone_comes() -> bool:
        if server.flush():
            server.send(pair(7)[1:], (lone_ns,), (1,))
        return stamp_ns(images[-1].header.stamp) == lone_ns

    ros.spin_until(lone_comes, WITHIN_S, rig.texts)
    assert np.array_equal(image_array(images[-1]), pair(7)[1])
    assert lone_ns not in {stamp_ns(m.header.stamp) for m in rig.got["left/image_raw"]}
    assert lone_ns not in {stamp_ns(m.header.stamp) for m in rig.got["left/camera_info"]}
    server.close()


def test_a_camera_that_comes_late_and_comes_back_is_read(ros: Any, tmp_path: Path) -> None:
    rig = Rig(ros, tmp_path, retry_min_s=0.05, retry_max_s=0.1)
    ros.spin_until(lambda: any("no simulated bench" in t for t in rig.texts()), WITHIN_S, rig.texts)
    levels = [s.level for d in rig.diagnostics for s in d.status if "no simulated bench" in s.message]
    assert set(levels) == {DiagnosticStatus.ERROR}
    images = rig.got["left/image_raw"]
    for wanted in (3, 6):
        server = FrameServer(rig.path)
        rig.serve_until(server, lambda wanted=wanted: len(images) >= wanted)
        server.close()
    ros.spin_until(lambda: any("gone" in t or "no simulated bench" in t for t in rig.texts()[-1:]), WITHIN_S, rig.texts)


def test_a_calibration_of_another_size_is_refused_and_said(ros: Any, tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "bench.sock")
    path = calibration(tmp_path / "left.yaml", (1280, 720))
    rig = Rig(ros, tmp_path, left_calibration=path)
    rig.serve_until(server, lambda: rig.got["left/camera_info"] and rig.got["right/camera_info"])
    rig.serve_until(server, lambda: any("for 60 x 40, it is for 1280 x 720" in t for t in rig.texts()))
    assert "right camera: no calibration" in rig.texts()[-1]
    for topic in ("left/camera_info", "right/camera_info"):
        info = rig.got[topic][-1]
        assert (info.width, info.height) == (60, 40) and not np.any(info.k)
        with pytest.raises(ValueError, match="is not calibrated"):
            camera_model(info)
    server.close()


def test_a_camera_that_has_fallen_silent_is_no_running_one(ros: Any, tmp_path: Path) -> None:
    """It is reopened much later; until then the diagnostics reported that all was well."""
    server = FrameServer(tmp_path / "bench.sock")
    path = calibration(tmp_path / "left.yaml")
    rig = Rig(ros, tmp_path, read_timeout_s=60.0, left_calibration=path, right_calibration=path)
    rig.serve_until(server, lambda: rig.got["left/image_raw"] and "running" in rig.texts())
    ros.spin_until(lambda: "running; no picture for 2 s" in rig.texts(), WITHIN_S, rig.texts)
    last = rig.diagnostics[-1].status[0]
    assert last.level == DiagnosticStatus.WARN
    rig.serve_until(server, lambda: rig.texts()[-1] == "running")
    server.close()


def test_waits_that_are_changed_hold_at_once(ros: Any, tmp_path: Path) -> None:
    server = FrameServer(tmp_path / "bench.sock")
    rig = Rig(ros, tmp_path, read_timeout_s=60.0)
    rig.serve_until(server, lambda: rig.got["left/image_raw"])
    assert rig.node.set_parameters([Parameter("read_timeout_s", value=0.1)])[0].successful
    ros.spin_until(lambda: any("no picture for 0.1 s" in t for t in rig.texts()), WITHIN_S, rig.texts)
    refused = rig.node.set_parameters([Parameter("retry_max_s", value=0.02)])[0]
    assert not refused.successful and refused.reason == "retry_max_s = 0.02 is below retry_min_s = 0.5"
    server.close()


def test_settings_that_cannot_work_end_the_node_at_once(ros: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="bench_socket"):
        ros.node(CameraNode, {"source": "bench"})
    (tmp_path / "folder").mkdir()
    (tmp_path / "broken.yaml").write_text("image_width: 640\n", encoding="utf-8")
    for side in ("left", "right"):
        for name, why in (
            ("absent.yaml", r"No such file or directory; camera_calibration makes it \(docs/how-to/calibration\.md\)"),
            ("folder", "Is a directory"),
            ("broken.yaml", "not a camera calibration: .*'distortion_model'"),
        ):
            said = rf"the {side} camera's {side}_calibration: {tmp_path}/{name}: {why}"
            with pytest.raises(ConfigError, match=said):
                ros.node(CameraNode, {"source": "v4l2", f"{side}_calibration": str(tmp_path / name)})
