"""The bridge as a node: topics become what the page shows, and the page's commands become messages."""

from __future__ import annotations

import asyncio
import json
import os
import re
import struct
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped
from rcl_interfaces.msg import Log
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Empty, Float32, Float64MultiArray, Header, String
from std_srvs.srv import SetBool, Trigger
from support.deadlines import wait_until
from support.pinhole import pinhole
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from icu_common.adapters.direct_stop.line import open_stop_socket, received_stop, stop_path
from icu_common.adapters.real_time import BRIDGE
from icu_common.core.configuration.config import ConfigError, settings_of
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, JOINTS, PANEL
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.gesture import parse_gesture
from icu_common.core.panel.panel_layout import load_layout
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen
from icu_common.core.reasons.codes import CODE, DriverCode
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message, image_message
from icu_common.nodes.messages.clouds import cloud_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.joints import joint_message, trajectory_message
from icu_common.nodes.messages.panels import controls_message, panel_state_message
from icu_common.nodes.messages.places import point_message, pose_message, transform_message
from icu_common.nodes.messages.results import diagnostic_status, result_message
from icu_common.nodes.state_codes import code_values
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.control import stop_cause
from scope_ui_bridge.nodes import foxglove_sidecar
from scope_ui_bridge.nodes.bridge_node import BridgeNode

LAYOUT = Path(__file__).resolve().parents[3] / "config" / "scopes" / "dso_bench_4.yaml"
FACE = load_layout(LAYOUT)  # once: read in each round it would leave a busy machine no time for what is published
WITHIN_S = 15.0
LAYERS = ("left/corners", "left/edge_lines")
SERVICES = dict.fromkeys(
    [f"gantry/{name}" for name in ("stop", "home", "reset", "accept_settings")]
    + [f"calibration/{name}" for name in ("run", "add_sample", "solve", "save")],
    Trigger,
)


CAMERA = pinhole(size=(640, 480), focal_px=1000.0)


def panel_pose() -> Transform:
    rotation = np.diag([1.0, -1.0, -1.0])
    return Transform(rotation, np.array([0.0, 0.0, 0.8]) - rotation @ np.array([0.16, 0.075, 0.0]))


class Graph:
    """Everything around the bridge: publishers of the topics that it shows, and lists of the messages that it sends."""

    def __init__(self, ros: Any) -> None:
        self.ros = ros
        self.probe = probe = ros.plain("graph")
        self.publishers = {
            topic: probe.create_publisher(kind, topic, profile)
            for topic, kind, profile in (
                ("left/image_raw", Image, qos.IMAGES),
                ("left/camera_info", CameraInfo, qos.IMAGES),
                ("left/corners", PointCloud2, qos.RESULTS),
                ("left/edge_lines", PointCloud2, qos.RESULTS),
                ("gantry/trajectory", JointTrajectory, qos.COMMAND),
                ("calibration/camera_from_base", TransformStamped, qos.LATCHED),
                ("panel/pose", PoseStamped, qos.LATCHED),
                ("panel/controls", MarkerArray, qos.LATCHED),
                ("panel/confidence", Float32, qos.RESULTS),
                ("panel/state", DiagnosticArray, qos.RESULTS),
                ("stylus/tip", PointStamped, qos.SENSOR),
                ("gantry/target", PointStamped, qos.LATCHED),
                ("gantry/state", String, qos.LATCHED),
                ("gantry/driver_state", String, qos.LATCHED),
                ("gantry/result", DiagnosticArray, qos.RESULTS),
                ("calibration/state", String, qos.LATCHED),
                ("calibration/axes", Float64MultiArray, qos.LATCHED),
                ("joint_states", JointState, qos.RESULTS),
            )
        }
        self.commands = ros.collect(probe, String, "gantry/command", qos.COMMAND)
        self.goals = ros.collect(probe, PointStamped, "gantry/goal", qos.COMMAND)
        self.stops = ros.collect(probe, Empty, "gantry/stop_request", qos.RESULTS)
        self.heartbeats = ros.collect(probe, Header, "heartbeat", qos.SENSOR)
        self.called: list[str] = []
        self.stamps: list[int] = []
        self.shown_ns = 0
        for name, kind in SERVICES.items():
            probe.create_service(kind, name, self._service(name))
        probe.create_service(SetBool, "gantry/enable", self._service("gantry/enable"))

    def _service(self, name: str) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            self.called.append(f"{name} {request.data}" if name == "gantry/enable" else name)
            response.success, response.message = name != "gantry/home", f"{name} answered"
            return response

        return answer

    def publish(self, topic: str, message: Any) -> None:
        self.publishers[topic].publish(message)

    def now(self) -> int:
        return int(self.probe.get_clock().now().nanoseconds)

    def show_all(self) -> None:
        """Publish one round of everything, at most three times a second, so that no queue fills on a loaded machine."""
        stamp = self.now()
        if stamp - self.shown_ns < 300_000_000:
            return
        self.stamps.append(stamp)
        picture = np.full((480, 640, 3), 100, np.uint8)
        self.publish("left/camera_info", camera_info_message(CAMERA, header(stamp, CAMERA_LEFT)))
        self.publish("panel/controls", controls_message(FACE, header(stamp, PANEL)))
        self.publish("panel/pose", pose_message(panel_pose(), header(stamp, CAMERA_LEFT)))
        self.publish("panel/confidence", Float32(data=0.9))
        lit = ControlSeen(name="RUN_STOP", kind="button", lamp="green")
        knob = ControlSeen(name="CH1_SCALE", kind="knob", angle_deg=36.2, detent_deg=18.0, marks=(("X1", 30.0),))
        seen = PanelSeen(stamp_ns=stamp, controls=(lit, knob))
        self.publish("panel/state", panel_state_message(seen, header(stamp, CAMERA_LEFT)))
        self.publish("stylus/tip", point_message([0.0, 0.0, 0.5], header(stamp, CAMERA_LEFT)))
        self.publish("gantry/target", point_message([0.05, 0.0, 0.5], header(stamp, CAMERA_LEFT)))
        self.publish(
            "left/corners", cloud_message(("u", "v", "response"), [[1, 2, 9], [3, 4, 8]], header(stamp, CAMERA_LEFT))
        )
        lines = [[1, 2, 0], [9, 2, 0], [3, 3, 1], [3, 7, 1], [5, 7, 1]]
        self.publish("left/edge_lines", cloud_message(("u", "v", "line"), lines, header(stamp, CAMERA_LEFT)))
        self.publish("calibration/axes", Float64MultiArray(data=[1.0, 0.1, 0.0, 1.0]))
        self.publish("joint_states", joint_message(JOINTS, [0.1, 0.05, 0.02], header(stamp, "")))
        for part, text in (
            ("gantry/state", "ready"),
            ("gantry/driver_state", "idle"),
            ("calibration/state", "calibrated"),
        ):
            self.publish(part, String(data=text))
        self.publish("left/image_raw", image_message(picture, "bgr8", header(stamp, CAMERA_LEFT)))
        self.shown_ns = self.now()


class Browser:
    """A page's connections, run in a thread of its own while the test spins the nodes."""

    def __init__(self, ros: Any, url: str) -> None:
        self.ros = ros
        self.url, _, self.token = url.partition("?token=")
        self.origin = self.url.rstrip("/")
        self.heard: list[dict[str, Any]] = []
        self.frames: list[dict[str, Any]] = []
        self.seq = 0
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self.thread.start()
        self.tasks: list[Any] = []
        self.run(self._open())

    def run(self, work: Awaitable[Any]) -> Any:
        future = asyncio.run_coroutine_threadsafe(work, self.loop)  # type: ignore[arg-type]
        self.ros.spin_until(future.done, WITHIN_S)
        return future.result()

    async def _open(self) -> None:
        self.session = aiohttp.ClientSession(self.origin, cookie_jar=aiohttp.CookieJar(unsafe=True))
        async with self.session.get("/", params={"token": self.token}) as answer:
            assert answer.status == 200
        self.control = await self.session.ws_connect("/control", headers={"Origin": self.origin})
        self.video = await self.session.ws_connect("/video", headers={"Origin": self.origin})
        await self.video.send_str('{"camera":"left","corners":true,"edges":true}')
        self.tasks = [self.loop.create_task(self._hear()), self.loop.create_task(self._look())]

    async def _hear(self) -> None:
        async for message in self.control:
            self.heard.append(json.loads(message.data))

    async def _look(self) -> None:
        async for message in self.video:
            (length,) = struct.unpack_from(">I", message.data)
            self.frames.append(json.loads(message.data[4 : 4 + length]))
            await self.video.send_str(json.dumps({"drawn": self.frames[-1]["seq"]}))

    def latest(self, kind: str) -> dict[str, Any]:
        found = [m for m in self.heard if m["type"] == kind]
        return dict(found[-1]) if found else {}

    def state(self) -> dict[str, Any]:
        return self.latest("state")

    def ask(self, **fields: Any) -> dict[str, Any]:
        self.seq += 1
        seq = self.seq
        hello = self.latest("hello")
        epoch = (self.state() or hello["state"])["lease"]["epoch"]
        text = json.dumps({"seq": seq, "boot": hello["boot"], "epoch": epoch, **fields})
        self.run(self.control.send_str(text))
        find = lambda: next((m for m in self.heard if m["type"] == "answer" and m["seq"] == seq), None)  # noqa: E731
        return dict(self.ros.spin_until(find, WITHIN_S, lambda: self.heard[-3:]))

    def alive(self) -> None:
        self.seq += 1
        boot = self.latest("hello")["boot"]
        text = json.dumps({"type": "alive", "seq": self.seq, "boot": boot, "epoch": 0, "client_ms": 1})
        self.run(self.control.send_str(text))

    def close(self) -> None:
        if self.loop.is_closed():
            return

        async def end() -> None:
            for task in self.tasks:
                task.cancel()
            await asyncio.gather(*self.tasks, return_exceptions=True)
            await self.session.close()

        asyncio.run_coroutine_threadsafe(end(), self.loop).result(WITHIN_S)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join(WITHIN_S)
        self.loop.close()


def test_the_console_of_a_robot_shows_what_its_own_programs_say(ros: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """All robots of a domain write to one /rosout, and the stop of bed_2 is no news at bed_1."""
    node = ros.node(BridgeNode, {"port": 0, "token_file": ""}, namespace="/bed_1")
    heard: list[dict[str, Any]] = []
    monkeypatch.setattr(node._desk, "said", heard.append)
    out = ros.plain("others").create_publisher(Log, "/rosout", qos.RESULTS)
    ros.spin_until(out.get_subscription_count, WITHIN_S)
    for name in ("bed_2.gantry.serial_driver", "bed_10.ui_bridge", "bed_1.gantry.serial_driver"):
        out.publish(Log(level=30, name=name, msg="stop"))
    ros.spin_until(lambda: any(line["text"] == "stop" for line in heard), WITHIN_S)
    assert [line["name"] for line in heard if line["text"] == "stop"] == ["bed_1.gantry.serial_driver"]


def test_a_token_file_that_cannot_be_written_does_not_end_the_bridge_in_disorder(
    ros: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """As in a folder that is no folder, or on a disk that has become read-only."""
    (tmp_path / "file").touch()
    node = ros.node(BridgeNode, {"port": 0, "token_file": str(tmp_path / "file" / "token")})
    said = ""

    def told() -> str:
        nonlocal said
        said += capfd.readouterr().err
        return said

    ros.spin_until(lambda: f"could not be written to {tmp_path}/file/token" in told(), WITHIN_S, told)
    node.close()
    assert not node._server.alive


def test_a_state_under_another_name_stays_while_somebody_tells_it(ros: Any) -> None:
    remapped = ["--ros-args", "-r", "gantry/state:=other/state"]
    node = ros.node(BridgeNode, {"port": 0, "token_file": ""}, cli_args=remapped)
    ros.plain("controller").create_publisher(String, "other/state", qos.LATCHED).publish(String(data="ready"))
    ros.spin_until(lambda: node._desk.machine.state("controller")[0] == "ready", WITHIN_S)
    checked: list[str] = []
    count = node.count_publishers
    node.count_publishers = lambda topic: (checked.append(topic), count(topic))[1]
    ros.spin_until(lambda: len(checked) > 4, WITHIN_S)  # who has died is looked for every second
    ros.spin_until(lambda: len(checked) > 8, WITHIN_S)
    assert node._desk.machine.state("controller")[0] == "ready"


def test_recorders_that_somebody_else_has_started_are_told(ros: Any) -> None:
    node = ros.node(BridgeNode, {"port": 0, "token_file": ""}, namespace="/bed_1")
    told = lambda: [one["program"] for one in node._desk.recordings.message(1e9)]  # noqa: E731
    others = {name: ros.plain(name) for name in ("bag_recorder", "rosbag2_recorder", "bag_player")}
    ros.plain(node._server.recorder.node_name)  # its own names the user who started it
    ros.spin_until(lambda: len(told()) == 2, WITHIN_S, told)
    assert sorted(told()) == ["/bag_recorder", "/rosbag2_recorder"]
    gone = others["bag_recorder"]
    ros.executor.remove_node(gone)
    gone.destroy_node()
    ros.spin_until(lambda: told() == ["/rosbag2_recorder"], WITHIN_S, told)


@pytest.fixture
def bridge(ros: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Any:
    """The bridge, connected with its graph, and a page that is signed in and receives the state."""
    graph = Graph(ros)
    parameters = {"port": 0, "token_file": str(tmp_path / "token"), "audit_file": str(tmp_path / "audit.jsonl")}
    patient = {
        "lease_timeout_s": 30.0,
        "silence_stop_s": 2.0,
        "frame_max_age_s": 5.0,
        "recognition_max_age_s": 10.0,
    }  # a loaded machine
    node = ros.node(BridgeNode, {**parameters, **patient, "layout": str(LAYOUT)})
    ros.spin_until((tmp_path / "token").exists, WITHIN_S)
    url = re.search(r"http://127\.0\.0\.1:\d+/\?token=\S+", capfd.readouterr().out)
    assert url
    assert url[0].endswith((tmp_path / "token").read_text().strip())
    assert (tmp_path / "token").stat().st_mode & 0o777 == 0o600
    # Corners and edges are asked for only while a page shows them, images while one is connected.
    shown = (*LAYERS, "left/image_raw")
    always = [p for topic, p in graph.publishers.items() if topic not in shown]
    ros.spin_until(lambda: all(p.get_subscription_count() for p in always), WITHIN_S)
    assert not any(graph.publishers[topic].get_subscription_count() for topic in shown)
    outlets = (node.outlets._command, node.outlets._goal)
    ros.spin_until(lambda: all(outlet.get_subscription_count() for outlet in outlets), WITHIN_S)
    browser = Browser(ros, url[0])
    try:
        ros.spin_until(lambda: browser.latest("hello"), WITHIN_S)
        yield graph, browser, node, tmp_path
    finally:
        browser.close()


def shown(ros: Any, graph: Graph, browser: Browser) -> dict[str, Any]:
    """Publish until the page has a picture with its overlay and may act; return the last picture's data."""

    def ready() -> bool:
        graph.show_all()
        good = any("panel" in f and f["panel"]["controls"] for f in browser.frames)
        return bool(good and browser.state().get("refusal", 1) is None)

    ros.spin_until(ready, WITHIN_S, lambda: (browser.state(), len(browser.frames)))
    return browser.frames[-1]


def test_the_way_of_the_tip_is_shown_while_it_moves(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge
    shown(ros, graph, browser)
    base = Transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.7]))
    graph.publish("calibration/camera_from_base", transform_message(base, header(graph.now(), CAMERA_LEFT), BASE))
    way = trajectory_message(JOINTS[::-1], [[0.0, 0.02, 0.03], [0.01, 0.02, 0.04]], [1.0, 2.0], header(0, ""))
    driven = [[0.105, 0.05, -0.02], [0.032, 0.02, 0.0], [0.042, 0.02, -0.01]]  # of readings with the axes' skew

    def seen() -> Any:
        graph.publish("gantry/driver_state", String(data="moving"))
        graph.publish("gantry/trajectory", way)
        stamp = header(graph.now(), CAMERA_LEFT)
        graph.publish("left/image_raw", image_message(np.full((480, 640, 3), 90, np.uint8), "bgr8", stamp))
        return next((f for f in browser.frames[::-1] if f["path"] and not f["planned"]), None)

    frame = ros.spin_until(seen, WITHIN_S, lambda: browser.state())
    assert np.allclose(frame["path"], CAMERA.project(base.apply(np.array(driven))), atol=0.06)


def test_a_camera_that_is_not_calibrated_is_told_once_and_draws_nothing(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge
    said: list[Log] = ros.collect(graph.probe, Log, "/rosout", qos.RESULTS)
    shown(ros, graph, browser)
    missing = lambda: [f["panel"]["missing"] for f in browser.frames if "panel" in f]  # noqa: E731
    assert missing()[-1] == ""

    def look() -> Any:
        head = header(graph.now(), CAMERA_LEFT)
        graph.publish("left/camera_info", CameraInfo(header=head, width=640, height=480))
        graph.publish("left/image_raw", image_message(np.full((480, 640, 3), 90, np.uint8), "bgr8", head))
        told = [line for line in said if line.name.endswith("ui_bridge") and "camera" in line.msg]
        return missing()[-1] == "camera" and told

    ros.spin_until(look, WITHIN_S, lambda: (missing(), said))
    seen = len(browser.frames)
    ros.spin_until(lambda: look() and len(browser.frames) > seen + 5, WITHIN_S)
    assert [(line.level, line.msg) for line in look()] == [
        (20, "the left camera is not calibrated: no control is drawn in its picture")
    ]


def test_nothing_is_drawn_by_a_calibration_that_was_withdrawn(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge
    base = Transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.7]))
    transform = transform_message(base, header(graph.now(), CAMERA_LEFT), BASE)
    graph.publish("calibration/camera_from_base", transform)
    graph.publish("gantry/target", point_message([0.1, 0.05, 0.0], header(0, BASE)))

    def look(axes: list[float], position: list[float], drawn: bool) -> Any:
        graph.publish("calibration/axes", Float64MultiArray(data=axes))
        graph.publish("joint_states", joint_message(JOINTS, [0.1, 0.05, 0.02], header(graph.now(), "")))
        graph.publish("left/camera_info", camera_info_message(CAMERA, header(graph.now(), CAMERA_LEFT)))
        stamp = header(graph.now(), CAMERA_LEFT)
        graph.publish("left/image_raw", image_message(np.full((480, 640, 3), 90, np.uint8), "bgr8", stamp))
        return browser.frames and (browser.frames[-1]["target"], browser.state().get("position_mm")) == (
            [462.4, 168.1] if drawn else None,
            position,
        )

    told = lambda: (browser.frames[-1:], browser.state())  # noqa: E731
    ros.spin_until(lambda: look([1.0, 0.1, 0.0, 1.0], [105.0, 50.0, 20.0], True), WITHIN_S, told)
    ros.spin_until(lambda: look([], [100.0, 50.0, 20.0], False), WITHIN_S, told)
    graph.publish("calibration/camera_from_base", transform)  # it is latched, and may come after the withdrawal
    came = len(browser.frames) + 5
    ros.spin_until(lambda: look([], [100.0, 50.0, 20.0], False) and len(browser.frames) > came, WITHIN_S, told)
    ros.spin_until(lambda: look([1.0, 0.0, 0.0, 1.0], [100.0, 50.0, 20.0], True), WITHIN_S, told)


def test_the_page_shows_what_the_topics_say(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge

    def seen() -> Any:
        graph.show_all()
        complete = [f for f in browser.frames if f["tip"] and f["target"] and f.get("corners") and f.get("edges")]
        return browser.state().get("position_mm") and complete

    frame = ros.spin_until(seen, WITHIN_S, lambda: (browser.state(), [sorted(f) for f in browser.frames[-3:]]))[-1]
    assert int(frame["stamp"]) in graph.stamps
    assert (frame["width"], frame["height"], frame["corners"]) == (640, 480, [1.0, 2.0, 3.0, 4.0])
    assert frame["edges"] == [[1, 2, 9, 2], [3, 3, 3, 7, 5, 7]]
    assert frame["tip"] == [319.5, 239.5]
    assert frame["target"] == [419.5, 239.5]
    panel = [f["panel"] for f in browser.frames if "panel" in f][-1]
    (run_stop,) = [c for c in panel["controls"] if c["name"] == "RUN_STOP"]
    depth = 0.8 - 0.003
    left, right = 319.5 + 1000 * (0.200 - 0.16) / depth, 319.5 + 1000 * (0.216 - 0.16) / depth
    top = 239.5 - 1000 * (0.1315 - 0.075) / depth
    assert run_stop["label"] == "Run / Stop"
    assert run_stop["box"][:3] == pytest.approx([left, top, right - left], abs=0.11)
    # base_from_reading = [[1, 0.1], [0, 1]]: x = 100 + 0.1 * 50 mm
    assert browser.state()["position_mm"] == [105.0, 50.0, 20.0]
    assert browser.state()["confidence"] == 0.9
    lit, knob = ros.spin_until(lambda: browser.latest("panel"), WITHIN_S)["controls"]
    assert (lit["name"], lit["lamp"]) == ("RUN_STOP", "green")
    assert (knob["angle_deg"], knob["detent_deg"], knob["marks"]) == (36, 18.0, {"X1": 30.0})


def test_the_other_camera_is_heard_only_while_a_page_shows_it(ros: Any, bridge: Any) -> None:
    """Each reader of a camera costs it and the bridge a tenth of a processor, which delays the heartbeat."""
    graph, browser, _, _ = bridge
    shown(ros, graph, browser)
    right = graph.probe.create_publisher(Image, "right/image_raw", qos.IMAGES)
    seen = lambda camera: [f for f in browser.frames if f["camera"] == camera]  # noqa: E731

    def look(camera: str) -> None:
        before = len(seen(camera))
        browser.run(browser.video.send_str(json.dumps({"camera": camera})))

        def come() -> bool:
            graph.show_all()
            if right.get_subscription_count():
                right.publish(image_message(np.full((480, 640, 3), 90, np.uint8), "bgr8", header(graph.now(), "right")))
            return len(seen(camera)) > before

        ros.spin_until(come, WITHIN_S, lambda: browser.frames[-1:])

    assert right.get_subscription_count() == 0
    look("right")
    assert seen("right")[-1]["width"] == 640
    assert graph.publishers["left/image_raw"].get_subscription_count() == 1, "who moves without pictures is stopped"
    look("left")
    ros.spin_until(lambda: right.get_subscription_count() == 0, WITHIN_S)
    look("right")


def test_no_images_are_taken_once_no_page_is_connected(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge
    shown(ros, graph, browser)
    images = graph.publishers["left/image_raw"]
    assert images.get_subscription_count() == 1
    browser.close()
    ros.spin_until(lambda: images.get_subscription_count() == 0, WITHIN_S)


def test_the_program_is_scheduled_before_ordinary_ones_or_says_why_not(tmp_path: Path) -> None:
    """Every thread of it: one that waits for its turn with the interpreter's lock would hold up the others."""
    module = "scope_ui_bridge.nodes.bridge_node"
    count = f"import os, {module}; print(len(os.listdir('/proc/self/task')) - 1)"
    librarys_own = int(subprocess.run([sys.executable, "-c", count], capture_output=True, check=True).stdout)
    command = [sys.executable, "-m", module, "--ros-args", "-p", "port:=0", "-p", f"token_file:={tmp_path / 'token'}"]
    with (tmp_path / "said").open("w+") as said:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said)
        try:
            ready = lambda: (tmp_path / "token").exists() or process.poll() is not None  # noqa: E731
            wait_until(ready, "the bridge writes its token", 60.0)
            threads = [int(path.name) for path in Path(f"/proc/{process.pid}/task").iterdir()]
            found = Counter((os.sched_getscheduler(n), os.sched_getparam(n).sched_priority) for n in threads)
        finally:
            process.terminate()
            process.wait(WITHIN_S)
        said.seek(0)
        refused = "ui_bridge: real-time scheduling is not allowed (" in said.read()
    assert found.pop((os.SCHED_RR, BRIDGE), 0) == (0 if refused else len(threads) - librarys_own)
    assert found == {(os.SCHED_OTHER, 0): len(threads) if refused else librarys_own}


def test_texts_of_others_are_cut_and_escaped_for_audit_file_page_and_console(ros: Any, bridge: Any) -> None:
    graph, browser, _, folder = bridge
    shown(ros, graph, browser)
    foul = "\x1b[2J\n" + 100_000 * "x"  # a larger message is dropped before it is unpacked
    result = GoalResult(goal_id="a", goal="press:\x1b[31m", outcome=Outcome.ACCEPTED)
    for answer in (result, replace(result, outcome=Outcome.ABORTED, reason=foul)):
        graph.publish("gantry/result", result_message(answer, graph.now()))
    graph.publish("gantry/state", String(data=f"waiting: {foul}"))
    aborted = lambda: (browser.latest("log") or {}).get("entry", {}).get("status") == "aborted"  # noqa: E731
    ros.spin_until(aborted, WITHIN_S)
    ros.spin_until(lambda: browser.state()["controller"]["state"] == "waiting", WITHIN_S)
    texts = [browser.latest("log")["entry"]["reason"], browser.state()["controller"]["reason"]]
    for text in texts:
        assert text.startswith("\\x1b[2J\\x0axxx") and text.isprintable() and len(text) < 500, text[:80]
    written = lambda: [x for x in (folder / "audit.jsonl").read_text().splitlines() if "aborted" in x]  # noqa: E731
    (line,) = ros.spin_until(written, WITHIN_S)
    assert len(line) < 1500 and "(99605 more characters)" in line


def test_what_has_ended_is_in_no_state_any_more(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge
    shown(ros, graph, browser)
    parts = {"driver": "gantry/driver_state", "controller": "gantry/state", "calibration": "calibration/state"}
    assert [browser.state()[part]["state"] for part in parts] == ["idle", "ready", "calibrated"]
    for topic in parts.values():
        graph.probe.destroy_publisher(graph.publishers.pop(topic))
    gone = lambda: not any(browser.state()[part]["state"] for part in parts)  # noqa: E731
    ros.spin_until(gone, WITHIN_S, browser.state)
    graph.publishers["gantry/state"] = graph.probe.create_publisher(String, "gantry/state", qos.LATCHED)
    graph.publish("gantry/state", String(data="waiting: not homed"))
    back = lambda: browser.state()["controller"] == {"state": "waiting", "reason": "not homed"}  # noqa: E731
    ros.spin_until(back, WITHIN_S, browser.state)


def test_stop_of_the_driver_is_explained_by_the_code_on_the_diagnostics(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge
    shown(ros, graph, browser)
    text = "stopped: operator's heartbeat lost: 0.61 s old (limit 0.6 s)"
    values = code_values("/gantry/driver_state", {CODE: DriverCode.HEARTBEAT_LOST.value})
    report = DiagnosticArray(status=[diagnostic_status("driver: board", "warn", text, values)])
    reports = graph.probe.create_publisher(DiagnosticArray, "/diagnostics", qos.RESULTS)
    ros.spin_until(lambda: reports.get_subscription_count() > 0, WITHIN_S)
    reports.publish(report)
    graph.publish("gantry/driver_state", String(data=text))
    explained = lambda: (browser.state()["stop_cause"] or {}).get("code") == "stopped_heartbeat"  # noqa: E731
    ros.spin_until(explained, WITHIN_S, browser.state)


def test_state_of_a_foreign_program_is_replaced_once_it_has_left(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge
    shown(ros, graph, browser)
    foreign = ros.plain("foreign")
    outlet = foreign.create_publisher(String, "gantry/state", qos.LATCHED)
    outlet.publish(String(data="waiting: foreign"))
    state = lambda: browser.state()["controller"]  # noqa: E731
    ros.spin_until(lambda: state() == {"state": "waiting", "reason": "foreign"}, WITHIN_S, state)
    foreign.destroy_publisher(outlet)
    ros.spin_until(lambda: state()["state"] == "ready", WITHIN_S, state)


def test_a_control_is_pressed_and_the_result_comes_back(ros: Any, bridge: Any) -> None:
    graph, browser, _, folder = bridge
    assert browser.ask(type="lease", step="take")["ok"]
    frame = shown(ros, graph, browser)
    answer = browser.ask(type="select", camera="left", stamp=frame["stamp"], control="RUN_STOP")
    assert answer["ok"], answer
    number = browser.latest("selection")["selection"]["number"]
    frame = shown(ros, graph, browser)
    act = {"type": "act", "gesture": "press", "selection": number, "camera": "left", "stamp": frame["stamp"]}
    answer = browser.ask(**act)
    assert answer["ok"], answer
    (command,) = ros.spin_until(lambda: graph.commands, WITHIN_S, lambda: browser.latest("log"))
    gesture = parse_gesture(command.data)
    assert (gesture.kind, gesture.target) == ("press", "RUN_STOP")
    for outcome, error in ((Outcome.ACCEPTED, float("nan")), (Outcome.REACHED, 0.00031)):
        result = GoalResult(goal_id=gesture.id, goal=command.data, outcome=outcome, error_m=error)
        graph.publish("gantry/result", result_message(result, graph.now()))
    ros.spin_until(lambda: browser.latest("log")["entry"]["status"] == "reached", WITHIN_S)
    assert browser.latest("log")["entry"]["error_mm"] == 0.31
    records = [json.loads(line) for line in (folder / "audit.jsonl").read_text().splitlines()]
    assert command.data in [record["command"] for record in records]
    begins = [record for record in records if record["command"] == "start"]
    assert [(line["n"], line["who"]) for line in begins] == [(1, "the bridge")], "nobody has control before"


def test_a_point_becomes_a_pixel_goal(ros: Any, bridge: Any) -> None:
    graph, browser, _, _ = bridge
    assert browser.ask(type="lease", step="take")["ok"]
    frame = shown(ros, graph, browser)
    assert browser.ask(type="select", camera="left", stamp=frame["stamp"], u=330.5, v=250.25)["ok"]
    number = browser.latest("selection")["selection"]["number"]
    frame = shown(ros, graph, browser)
    before = graph.now()
    act = {"type": "act", "gesture": "press", "selection": number, "camera": "left", "stamp": frame["stamp"]}
    assert browser.ask(**act)["ok"]
    (goal,) = ros.spin_until(lambda: graph.goals, WITHIN_S, lambda: browser.latest("log"))
    assert goal.header.frame_id == CAMERA_LEFT
    assert (goal.point.x, goal.point.y) == (330.5, 250.25)
    assert before <= stamp_ns(goal.header.stamp) <= graph.now()


def test_stop_goes_out_as_message_and_as_service(ros: Any, bridge: Any) -> None:
    graph, browser, node, _ = bridge
    ros.spin_until(lambda: node.outlets._stop_service.service_is_ready(), WITHIN_S)
    ros.spin_until(lambda: node.outlets._stop_request.get_subscription_count(), WITHIN_S)
    assert browser.ask(type="stop")["ok"], "without the lease"
    ros.spin_until(lambda: graph.stops and "gantry/stop" in graph.called, WITHIN_S)
    ros.spin_until(lambda: browser.latest("log")["entry"]["status"] == "done", WITHIN_S)


def test_a_stop_reaches_the_guard_past_the_graph(ros: Any) -> None:
    """It does so also after the driver's node has ended: its guard still holds and lifts."""
    node = ros.node(BridgeNode, {"port": 0, "token_file": ""})
    answers: list[tuple[bool, str]] = []
    path = stop_path(ros.context.get_domain_id(), "/gantry/stop_request")
    with open_stop_socket(path) as guard:
        node.outlets.stop(lambda done, text: answers.append((done, text)))
        assert received_stop(guard) == "stop requested" and received_stop(guard) is None
        assert answers == [(True, "")]
    path.unlink()


def test_a_stop_without_a_driver_is_told_to_be_heard_by_nobody(ros: Any) -> None:
    node = ros.node(BridgeNode, {"port": 0, "token_file": ""})
    answers: list[tuple[bool, str]] = []
    node.outlets.stop(lambda done, text: answers.append((done, text)))
    assert answers == [(False, "no driver is running")]


def test_heartbeats_are_published_only_with_the_operators_keep_alives(
    ros: Any, bridge: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    graph, browser, node, _ = bridge
    monkeypatch.setattr(stop_cause, "HELD_UP_S", WITHIN_S)  # this process may be, which is another cause of a stop
    ros.spin_until(lambda: node.outlets._heartbeat.get_subscription_count(), WITHIN_S)
    browser.alive()
    assert browser.ask(type="lease", step="take")["ok"]

    def beating() -> bool:
        browser.alive()
        return len(graph.heartbeats) >= 3

    ros.spin_until(beating, WITHIN_S)
    stamps = [stamp_ns(beat.stamp) for beat in graph.heartbeats]
    assert stamps == sorted(stamps)
    graph.publish("gantry/driver_state", String(data="moving"))
    ros.spin_until(lambda: graph.stops, WITHIN_S)  # no keep-alive any more
    count = len(graph.heartbeats)
    ros.spin_until(lambda: browser.state()["lease"]["holder"] == "", WITHIN_S)
    browser.alive()
    assert browser.ask(type="call", service="home")["code"] == "no_lease"
    assert len(graph.heartbeats) == count
    assert browser.latest("log")["entry"]["target"] == "stopped_page_frozen"


@pytest.mark.parametrize(
    ("service", "called", "status"),
    [
        ("home", "gantry/home", "rejected"),
        ("reset", "gantry/reset", "done"),
        ("enable", "gantry/enable True", "done"),
        ("disable", "gantry/enable False", "done"),
        ("calibrate", "calibration/run", "done"),
    ],
)
def test_services_are_called_and_their_answer_is_shown(
    ros: Any, bridge: Any, service: str, called: str, status: str
) -> None:
    graph, browser, node, _ = bridge
    clients = [node.outlets._enable_service, *node.outlets._triggers.values()]
    ros.spin_until(lambda: all(client.service_is_ready() for client in clients), WITHIN_S)
    assert browser.ask(type="lease", step="take")["ok"]
    assert browser.ask(type="call", service=service)["ok"]
    ros.spin_until(lambda: browser.latest("log")["entry"]["status"] not in ("sent",), WITHIN_S)
    assert graph.called == [called]
    entry = browser.latest("log")["entry"]
    assert (entry["status"], entry["reason"]) == (status, f"{called.split()[0]} answered")


def test_limits_change_while_it_runs_and_addresses_do_not(ros: Any, bridge: Any) -> None:
    _, _, node, _ = bridge
    (bad,) = node.set_parameters([Parameter("silence_stop_s", value=0.2)])
    assert not bad.successful
    assert "keepalive_fresh_s" in bad.reason
    (good,) = node.set_parameters([Parameter("min_confidence", value=0.8)])
    assert good.successful
    ros.spin_until(lambda: node._desk.config.min_confidence == 0.8, WITHIN_S)
    (fixed,) = node.set_parameters([Parameter("host", value="localhost")])
    assert not fixed.successful


def test_change_of_a_parameter_is_shown_on_the_page_and_in_the_audit_file(
    ros: Any, bridge: Any, tmp_path: Path
) -> None:
    _, browser, node, _ = bridge
    assert node.set_parameters([Parameter("lease_timeout_s", value=20.0)])[0].successful
    text = "lease_timeout_s = 20.0"

    def shown() -> dict[str, Any]:
        return dict(browser.latest("log").get("entry", {}))

    ros.spin_until(lambda: shown().get("target") == text, WITHIN_S, shown)
    entry = shown()
    assert (entry["who"], entry["action"], entry["status"]) == ("/ui_bridge", "parameter", "done")

    def lines() -> list[dict[str, Any]]:
        return [json.loads(line) for line in (tmp_path / "audit.jsonl").read_text().splitlines()]

    ros.spin_until(lambda: lines()[-1].get("target") == text, WITHIN_S)
    assert (lines()[-1]["who"], lines()[-1]["command"]) == ("/ui_bridge", "parameter")


@pytest.mark.parametrize("extended", [False, True])
def test_safety_settings_stay_while_the_machine_moves_or_presses(ros: Any, bridge: Any, extended: bool) -> None:
    graph, _, node, _ = bridge

    def unrest() -> str:
        if extended:  # a position is forgotten soon
            stamp = header(int(node.get_clock().now().nanoseconds), "")
            graph.publish("joint_states", joint_message(JOINTS, (0.1, 0.1, 0.03), stamp))
        else:
            graph.publish("gantry/driver_state", String(data="moving"))
        return str(node._desk.machine.unrest())

    before = node._desk.config
    for item in (i for i in settings_of(BridgeConfig) if i.setting.guards):
        low, high, now = item.setting.minimum, item.setting.maximum, getattr(before, item.name)
        value = 0.0 if item.name == "min_confidence" else high if high != now else (low + high) / 2
        why = ros.spin_until(unrest, WITHIN_S)
        (answer,) = node.set_parameters([Parameter(item.name, value=value)])
        assert not answer.successful
        assert answer.reason == f"{item.name} can change only while the machine is at rest: {why}"
    assert node._desk.config == before


def test_a_new_token_voids_the_old_one(ros: Any, bridge: Any, capfd: pytest.CaptureFixture[str]) -> None:
    _, browser, node, folder = bridge
    before = (folder / "token").read_text()
    node.issue_token()
    ros.spin_until(lambda: (folder / "token").read_text() != before, WITHIN_S)
    token = (folder / "token").read_text().strip()
    assert f"?token={token}" in capfd.readouterr().out

    async def status(value: str) -> int:
        query = {"token": value}
        async with aiohttp.ClientSession(browser.origin) as session, session.get("/", params=query) as answer:
            return answer.status

    assert browser.run(status(token)) == 200


@pytest.mark.parametrize(
    ("parameters", "named"),
    [
        ({"host": "0.0.0.0"}, "not loopback"),
        ({"layout": "/nonexistent/x.yaml"}, "layout"),
        ({"audit_file": "/proc/nonexistent/audit"}, "audit_file"),
    ],
)
def test_a_wrong_configuration_is_refused_by_name(ros: Any, parameters: dict[str, Any], named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        BridgeNode(
            context=ros.context,
            parameter_overrides=[Parameter(k, value=v) for k, v in {"port": 0, "token_file": "", **parameters}.items()],
        )


@pytest.mark.parametrize("port", ["-1", "65536", "99999999999"])
def test_foxglove_sidecar_refuses_what_is_no_port(port: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert foxglove_sidecar.main(["foxglove_sidecar", "--port", port]) == 2
    assert capsys.readouterr().err == f"error: --port {float(port):g}; expected 0 to 65535\n"


def test_a_port_that_foxglove_cannot_have_is_named(ros: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def start_server(**_: Any) -> None:
        raise RuntimeError("FoxgloveError: Failed to bind port: Address already in use (os error 98)")

    monkeypatch.setitem(sys.modules, "foxglove", SimpleNamespace(start_server=start_server))
    with pytest.raises(ConfigError, match=r"--port 8765: FoxgloveError: .* Address already in use"):
        ros.node(lambda **options: foxglove_sidecar.FoxgloveSidecar(8765, **options))
