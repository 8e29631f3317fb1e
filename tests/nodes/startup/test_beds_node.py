"""One page for two robots in two namespaces: each shows its own states and picture, and nothing of the other."""

from __future__ import annotations

import json
import socket
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from sensor_msgs.msg import Image
from std_msgs.msg import String
from support.ros_rig import Ros

from harris_perception.cli.stereo import stereo
from icu_bringup.nodes import beds_node
from icu_bringup.nodes.beds_node import BedsNode
from icu_common.core.configuration.config import ConfigError
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_message
from icu_common.nodes.messages.heads import header

pytestmark = pytest.mark.long


def get(address: str) -> bytes:
    with urllib.request.urlopen(address, timeout=5) as answer:
        return bytes(answer.read())


def test_a_picture_of_the_future_is_no_younger_than_its_time_here(ros: Ros) -> None:
    """By its stamp alone the last image of a camera whose clock is ahead would be live for that long."""
    node = ros.node(BedsNode, {"beds": ["bed_1"], "port": 0})
    eye = ros.plain("robot").create_publisher(Image, "/bed_1/stereo/left/image_raw", qos.IMAGES)
    ros.spin_until(eye.get_subscription_count, 10.0)
    stamp = node.get_clock().now().nanoseconds + 3_600_000_000_000
    eye.publish(image_message(np.zeros((72, 128), np.uint8), "mono8", header(stamp, "eye")))
    ros.spin_until(lambda: node._pictures, 10.0)
    age_s = lambda: json.loads(get(node.server.address + "state"))["bed_1"]["age_s"]  # noqa: E731
    first_s = age_s()
    assert 0 <= first_s < 20
    ros.spin_until(lambda: age_s() > first_s + 0.1, 10.0)


def test_two_beds_on_one_page(ros: Ros) -> None:
    beds = ["bed_1=http://127.0.0.1:8080", "bed_2=http://127.0.0.1:8081"]
    node = ros.node(BedsNode, {"beds": beds, "port": 0})
    robots = ros.plain("robots")
    states = {b: robots.create_publisher(String, f"/{b}/gantry/state", qos.LATCHED) for b in ("bed_1", "bed_2")}
    eyes = {b: robots.create_publisher(Image, f"/{b}/stereo/left/image_raw", qos.IMAGES) for b in ("bed_1", "bed_2")}
    ros.spin_until(lambda: all(p.get_subscription_count() for p in (*states.values(), *eyes.values())), 10.0)
    states["bed_1"].publish(String(data="ready"))
    states["bed_2"].publish(String(data="alarm: limit"))
    for bed, gray in (("bed_1", 40), ("bed_2", 200)):
        pixels = np.full((72, 128, 3), gray, np.uint8)
        eyes[bed].publish(image_message(pixels, "bgr8", header(node.get_clock().now().nanoseconds, "eye")))
    ros.spin_until(lambda: len(node._pictures) == 2, 10.0)
    ros.spin_until(lambda: all(s["controller"] for s in node._states.values()), 10.0)

    shown = json.loads(get(node.server.address + "state"))
    assert {b: v["states"]["controller"] for b, v in shown.items()} == {"bed_1": "ready", "bed_2": "alarm: limit"}
    assert all(0 <= v["age_s"] < 20 for v in shown.values())
    for bed, gray in (("bed_1", 40), ("bed_2", 200)):
        picture = cv2.imdecode(np.frombuffer(get(f"{node.server.address}{bed}.jpg"), np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (72, 128, 3) and abs(float(picture.mean()) - gray) < 2
    page = get(node.server.address).decode()
    assert 'id="bed_1"' in page and 'href="http://127.0.0.1:8081"' in page
    port = node.server.address.split("/")[2]
    assert port.startswith("127.0.0.1:")
    with socket.create_connection(("127.0.0.1", int(port.partition(":")[2])), 10.0) as raw:
        raw.sendall("GET /wr\xf6ng/state HTTP/1.0\r\n\r\n".encode("latin-1"))
        assert raw.recv(100).split()[1] == b"404"
    for path in ("/", "/state", "/wrong/state", "/wrong/bed_1.jpg"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(f"http://{port}{path}")


def test_a_bed_whose_programs_have_ended_shows_no_state(ros: Ros) -> None:
    node = ros.node(BedsNode, {"beds": ["bed_1"], "port": 0})
    robot = ros.plain("robot")
    driver, controller = (
        robot.create_publisher(String, f"/bed_1/{topic}", qos.LATCHED)
        for topic in ("gantry/driver_state", "gantry/state")
    )
    driver.publish(String(data="moving"))
    controller.publish(String(data="ready"))
    states = node._states["bed_1"]
    ros.spin_until(lambda: (states["driver"], states["controller"]) == ("moving", "ready"), 10.0)
    robot.destroy_publisher(driver)
    ros.spin_until(lambda: states["driver"] == "", 10.0, lambda: states)
    shown = json.loads(get(node.server.address + "state"))["bed_1"]["states"]
    assert (shown["driver"], shown["controller"]) == ("", "ready")


@pytest.mark.parametrize("encoding", ["rgb8", "rgba8"])
def test_a_bed_has_its_colours_whatever_its_camera_sends(ros: Ros, encoding: str) -> None:
    node = ros.node(BedsNode, {"beds": ["bed_1"], "port": 0})
    pixels = np.full((72, 128, len(encoding) - 1), 255, np.uint8)
    pixels[..., :3] = (200, 60, 20)
    node._pictures["bed_1"] = image_message(pixels, encoding, header(1, "eye"))
    picture = cv2.imdecode(np.frombuffer(get(f"{node.server.address}bed_1.jpg"), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (72, 128, 3)
    assert np.abs(picture.mean(axis=(0, 1)) - (20, 60, 200)).max() < 4


BAYER = ("rggb", "bggr", "gbrg", "grbg")


def picture_of(encoding: str, color: tuple[int, int, int], top: int) -> NDArray[Any]:
    """Return 72 x 128 pixels of one color (r, g, b of 255) as a camera sends them, ``top`` for 255."""
    r, g, b = (round(value * top / 255) for value in color)
    deep = np.uint16 if encoding.endswith("16") else np.uint8
    if encoding.startswith("bayer"):
        tile = np.array([{"r": r, "g": g, "b": b}[letter] for letter in encoding[6:10]], deep).reshape(2, 2)
        return np.tile(tile, (36, 64))
    if encoding.startswith("mono"):
        return np.tile(np.repeat(np.array([g, top], deep), 64), (72, 1))
    pixel = [{"r": r, "g": g, "b": b, "a": top}[letter] for letter in encoding.rstrip("168")]
    return np.full((72, 128, len(pixel)), pixel, deep)


@pytest.mark.parametrize("deep", ["8", "16"])
@pytest.mark.parametrize("name", ["mono", "bgr", "rgb", "bgra", "rgba", *(f"bayer_{p}" for p in BAYER)])
def test_a_bed_shows_every_encoding_of_its_cameras(ros: Ros, name: str, deep: str) -> None:
    node = ros.node(BedsNode, {"beds": ["bed_1"], "port": 0})
    color, top = (255, 60, 20), 4095 if deep == "16" else 255  # a camera of 12 bits
    sent = picture_of(name + deep, color, top)
    if name == "mono":
        color = (158, 158, 158)  # half of it is white
    node._pictures["bed_1"] = image_message(sent, name + deep, header(1, "eye"))
    picture = cv2.imdecode(np.frombuffer(get(f"{node.server.address}bed_1.jpg"), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape == (72, 128, 3)
    assert np.abs(picture[8:-8, 8:-8].mean(axis=(0, 1)) - color[::-1]).max() < 6


def test_a_bed_whose_picture_is_empty_or_of_an_unknown_kind_has_none(ros: Ros) -> None:
    node = ros.node(BedsNode, {"beds": ["bed_1"], "port": 0})
    for message in (image_message(np.zeros((0, 0), np.uint8), "mono8", header(1, "eye")), Image(encoding="yuv422")):
        node._pictures["bed_1"] = message
        with pytest.raises(urllib.error.HTTPError, match="404"):
            get(f"{node.server.address}bed_1.jpg")


@pytest.mark.parametrize("program", [beds_node.main, stereo])
def test_who_asks_a_node_for_help_gets_it_and_no_node(
    program: Callable[[], int], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["ros2_ws/lib/icu_bringup/beds", "--help"])
    monkeypatch.setattr("icu_common.nodes.runtime.ros_session", lambda arguments: pytest.fail("a node was started"))
    assert program() == 0
    shown = capsys.readouterr().out
    assert shown.startswith("usage: beds --ros-args") and "ros2 param describe" in shown
    assert (
        ("shows several robots on one page" in shown)
        if program is beds_node.main
        else ("stereo evaluate FOLDER" in shown)
    )


def test_wrong_names_are_refused(ros: Ros) -> None:
    with pytest.raises(ConfigError, match=r"'bed 1' is not NAMESPACE"):
        ros.node(BedsNode, {"beds": ["bed 1"], "port": 0})
