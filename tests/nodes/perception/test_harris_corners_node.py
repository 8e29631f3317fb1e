"""The corners node: pictures of every encoding become the corners that are in them, with their stamp and frame."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from sensor_msgs.msg import Image, PointCloud2

from harris_perception.nodes.corners_node import CornersNode
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_array, image_message
from icu_common.nodes.messages.clouds import cloud_array
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.results import LEVELS

SQUARE = sorted([(10.0, 12.0), (10.0, 31.0), (49.0, 12.0), (49.0, 31.0)])
BAYER = {"bayer_rggb8": "rggb", "bayer_bggr8": "bggr", "bayer_gbrg8": "gbrg", "bayer_grbg8": "grbg"}


def square(encoding: str = "mono8") -> np.ndarray:
    """Return 66x50 px with a bright rectangle from (10, 12) to (49, 31), in the named encoding."""
    gray = np.full((50, 66), 30, np.uint8)
    gray[12:32, 10:50] = 200
    if encoding == "32FC1":
        return np.where(gray == 30, np.float32(0.1), np.float32(0.7))
    deep = gray.astype(np.uint16) * 256 if "16" in encoding else gray
    return np.repeat(deep[:, :, None], 3, axis=2) if encoding[:3] in ("bgr", "rgb") else deep


class Rig:
    """A corners node, a publisher of images and the lists of its results."""

    def __init__(self, ros: Any, parameters: dict[str, Any] | None = None, made_by: Any = CornersNode) -> None:
        self.ros = ros
        self.node = ros.node(made_by, parameters)
        self.probe = ros.plain()
        self.clouds: list[PointCloud2] = ros.collect(self.probe, PointCloud2, "corners", qos.RESULTS)
        self.images = self.probe.create_publisher(Image, "image_raw", qos.IMAGES)
        ros.spin_until(lambda: self.images.get_subscription_count() == 1, 10.0)
        ros.spin_until(lambda: self.probe.count_publishers("corners") == 1, 10.0)

    def corners_of(self, message: Image) -> np.ndarray:
        """Publish and return (N, 3) u, v, response of the answer with this stamp."""
        return cloud_array(self.cloud_of(message), ("u", "v", "response"))

    def cloud_of(self, message: Image) -> PointCloud2:
        """Publish and return the answer with this stamp."""
        self.images.publish(message)
        stamp = stamp_ns(message.header.stamp)
        cloud = self.ros.spin_until(
            lambda: next((c for c in self.clouds if stamp_ns(c.header.stamp) == stamp), None), 10.0
        )
        assert cloud.header.frame_id == message.header.frame_id
        return cloud


def pixels(values: np.ndarray) -> list[tuple[float, float]]:
    return sorted((float(u), float(v)) for u, v in np.rint(values[:, :2]))


def test_each_encoding_gives_the_same_corners_with_stamp_and_frame(ros: Any) -> None:
    rig = Rig(ros)
    others = ("mono8", "mono16", "8UC1", "16UC1", "bgr8", "rgb8", "bgr16", "32FC1")
    for stamp, encoding in enumerate((*others, *BAYER, "bayer_gbrg16"), start=1_500_000_007):
        found = rig.corners_of(image_message(square(encoding), encoding, header(stamp, "camera_left_optical_frame")))
        assert (np.diff(found[:, 2]) <= 0.0).all() and (found[:, 2] > 0.0).all(), encoding
        if encoding in others:
            assert pixels(found) == SQUARE, encoding
        else:  # interpolation of colours rounds the corner off, or moves it by a pixel
            assert len(found) == 4, encoding
            distance = np.linalg.norm(found[:, None, :2] - np.array(SQUARE)[None], axis=2)
            assert distance.min(axis=0).max() < 1.1, encoding


@pytest.mark.parametrize("gain", [1e-30, 1e30])
@pytest.mark.parametrize("method", ["fast", "scales", "repeatable"])
def test_no_unit_of_floats_loses_corners_and_what_float32_does_not_hold_is_its_limit(
    ros: Any, gain: float, method: str
) -> None:
    rig = Rig(ros, {"corner_method": method, "scales.levels": 1})
    picture = np.float32(gain) * (square().astype(np.float32) + np.float32(1.0))
    cloud = rig.cloud_of(image_message(picture, "32FC1", header(1, "c")))
    found = cloud_array(cloud, ("u", "v", "response"))
    assert pixels(found) == SQUARE and cloud.is_dense
    assert (found[:, 2] >= np.finfo(np.float32).tiny).all() and np.isfinite(found[:, 2]).all()


def test_bayer_patterns_are_told_apart(ros: Any) -> None:
    # A red square on black: only the sites under the red filter are bright. Every pattern must show one square whose
    # grey value is red's weight (0.299); a wrong pattern would show green or blue.
    rig = Rig(ros)
    node_view: list[Image] = ros.collect(rig.probe, Image, "corners_image", qos.IMAGES)
    ros.spin_until(lambda: rig.probe.count_publishers("corners_image") == 1, 10.0)
    ros.spin_until(lambda: rig.node.count_subscribers("corners_image") == 1, 10.0)
    for number, (encoding, pattern) in enumerate(BAYER.items(), start=1):
        raw = np.zeros((50, 66), np.uint8)
        red_y, red_x = divmod(pattern.index("r"), 2)
        raw[12 + red_y : 32 : 2, 10 + red_x : 50 : 2] = 200
        rig.corners_of(image_message(raw, encoding, header(number, "c")))
        picture = ros.spin_until(
            lambda wanted=number: next((p for p in node_view if stamp_ns(p.header.stamp) == wanted), None), 10.0
        )
        assert abs(int(image_array(picture)[22, 30, 0]) - 0.299 * 200) <= 2


def test_pictures_without_corners_give_empty_results(ros: Any) -> None:
    rig = Rig(ros)
    seen = {
        topic: ros.collect(rig.probe, kind, topic, profile)
        for topic, kind, profile in (
            ("corners_image", Image, qos.IMAGES),
            ("edges", Image, qos.IMAGES),
            ("edge_lines", PointCloud2, qos.RESULTS),
        )
    }
    for topic in seen:
        ros.spin_until(lambda wanted=topic: rig.node.count_subscribers(wanted) == 1, 10.0)
        ros.spin_until(lambda wanted=topic: rig.probe.count_publishers(wanted) == 1, 10.0)
    unknown = np.where(square() == 30, np.float32(np.nan), np.float32(7.0))
    messages = [
        image_message(picture, "32FC1" if picture.dtype == np.float32 else "mono8", header(1, "c"))
        for picture in (
            np.zeros((1, 1), np.uint8),
            np.zeros((4, 30), np.uint8),
            np.full((40, 40), 99, np.uint8),
            unknown,
        )
    ]
    messages += [Image(encoding=e) for e in ("mono8", "bgr8", "32FC1")] + [Image(encoding="mono8", height=7)]
    messages.append(image_message(np.zeros((0, 5), np.uint8), "mono8", header(1, "c")))
    for stamp, message in enumerate(messages, start=1):
        message.header = header(stamp, "c")
        assert rig.corners_of(message).shape == (0, 3)
        answers = ros.spin_until(
            lambda n=stamp: [m for each in seen.values() for m in each if stamp_ns(m.header.stamp) == n][2:] and seen,
            10.0,
        )
        size = (message.height, message.width)
        assert [(m[-1].height, m[-1].width) for m in answers.values()] == [size, size, (1, 0)]


def test_picture_that_cannot_be_read_is_refused_and_the_next_one_works(ros: Any) -> None:
    rig = Rig(ros)
    reports: list[DiagnosticArray] = ros.collect(rig.probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
    broken = image_message(square(), "mono8", header(1, "c"))
    broken.encoding = "yuv422"
    rig.images.publish(broken)
    told = ros.spin_until(lambda: [s for r in reports for s in r.status if "refused: " in s.message], 10.0)[0]
    assert told.message.startswith("picture refused: encoding 'yuv422' is none of ") and told.level == LEVELS["warn"]
    assert pixels(rig.corners_of(image_message(square(), "mono8", header(2, "c")))) == SQUARE
    assert [stamp_ns(c.header.stamp) for c in rig.clouds] == [2]


def test_bad_values_are_refused_and_the_old_ones_stay(ros: Any) -> None:
    rig = Rig(ros)
    for name, value, word in [
        ("k", 5.0, "k"),
        ("window_px", 4, "odd"),
        ("gradient", "prewitt", "harris, sobel, gaussian"),
        ("relative_threshold", float("nan"), "relative_threshold"),
        ("max_corners", -1, "max_corners"),
    ]:
        result = rig.node.set_parameters([Parameter(name, value=value)])[0]
        assert not result.successful and word in result.reason
    assert pixels(rig.corners_of(image_message(square(), "mono8", header(3, "c")))) == SQUARE


def test_parameters_change_the_next_picture(ros: Any) -> None:
    rig = Rig(ros, {"max_corners": 3})
    message = image_message(square(), "mono8", header(1, "c"))
    assert len(rig.corners_of(message)) == 3
    results = rig.node.set_parameters([Parameter("max_corners", value=0), Parameter("border_px", value=11)])
    assert all(r.successful for r in results)
    message.header = header(2, "c")
    assert pixels(rig.corners_of(message)) == [(49.0, 12.0), (49.0, 31.0)]


def test_corners_are_drawn_only_while_somebody_looks(ros: Any) -> None:
    rig = Rig(ros)
    rig.corners_of(image_message(square("bgr8"), "bgr8", header(1, "c")))
    drawn: list[Image] = ros.collect(rig.probe, Image, "corners_image", qos.IMAGES)
    ros.spin_until(lambda: rig.node.count_subscribers("corners_image") == 1, 10.0)
    ros.spin_until(lambda: rig.probe.count_publishers("corners_image") == 1, 10.0)
    rig.corners_of(image_message(square("bgr8"), "bgr8", header(2, "c")))
    picture = ros.spin_until(lambda: drawn and drawn[-1], 10.0)
    assert [stamp_ns(p.header.stamp) for p in drawn] == [2] and picture.encoding == "bgr8"
    pixel = image_array(picture)
    for x, y in SQUARE:
        blue, green, red = (int(v) for v in pixel[int(y), int(x)])
        assert green > blue + 50 and green > red + 50
    np.testing.assert_array_equal(pixel[22, 30], (200, 200, 200))


def test_only_the_newest_picture_is_worked_on_and_the_others_are_counted(ros: Any) -> None:
    rig = Rig(ros)
    reports: list[DiagnosticArray] = ros.collect(rig.probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
    rig.images.publish(image_message(square(), "mono8", header(1, "c")))
    rig.corners_of(image_message(square(), "mono8", header(2, "c")))
    for stamp in range(3, 10):  # no thread spins meanwhile: the node is "busy"
        rig.images.publish(image_message(square(), "mono8", header(stamp, "c")))
    rig.corners_of(image_message(square(), "mono8", header(10, "c")))
    stamps = [stamp_ns(c.header.stamp) for c in rig.clouds]
    assert stamps == [2, 10]
    dropped = 8

    def told() -> dict[str, str]:
        values = [{v.key: v.value for v in s.values} for r in reports for s in r.status if s.name == "/corners"]
        return values[-1] if values and values[-1]["frames"] == str(len(stamps)) else {}

    values = ros.spin_until(told, 10.0, lambda: reports)
    assert values["dropped"] == str(dropped)
    assert values["corners"] == "4" and float(values["ms_per_frame"]) >= 0.0


@pytest.mark.parametrize(
    "parameters",
    [{}, {"edge_method": "outlines", "edges.max_gap_px": 8.0, "edges.high": 10.0}],
)
def test_edges_are_labelled_only_while_somebody_looks(ros: Any, parameters: dict[str, Any]) -> None:
    rig = Rig(ros, parameters)
    rig.corners_of(image_message(square(), "mono8", header(1, "c")))
    labels: list[Image] = ros.collect(rig.probe, Image, "edges", qos.IMAGES)
    ros.spin_until(lambda: rig.node.count_subscribers("edges") == 1, 10.0)
    ros.spin_until(lambda: rig.probe.count_publishers("edges") == 1, 10.0)
    rig.corners_of(image_message(square(), "mono8", header(2, "c")))
    message = ros.spin_until(lambda: labels and labels[-1], 10.0)
    assert [stamp_ns(m.header.stamp) for m in labels] == [2] and message.encoding == "mono8"
    picture = image_array(message)
    assert sorted(map(tuple, np.argwhere(picture == 255)[:, ::-1].astype(float).tolist())) == SQUARE
    assert set(np.unique(picture).tolist()) == {0, 128, 255}
    assert (picture[11:14, 14:46] == 128).any(axis=0).all()  # the upper side
    assert not picture[18:26, 16:44].any()  # inside
    lines: list[PointCloud2] = ros.collect(rig.probe, PointCloud2, "edge_lines", qos.RESULTS)
    ros.spin_until(lambda: rig.node.count_subscribers("edge_lines") == 1, 10.0)
    ros.spin_until(lambda: rig.probe.count_publishers("edge_lines") == 1, 10.0)
    rig.corners_of(image_message(square(), "mono8", header(3, "c")))
    cloud = ros.spin_until(lambda: lines and lines[-1], 10.0)
    assert stamp_ns(cloud.header.stamp) == 3
    places = cloud_array(cloud, ("u", "v", "line"))
    v, u = places[:, 1].astype(int), places[:, 0].astype(int)
    assert (picture[v, u] > 0).all() and 4 <= len(places) < 24, "the square's sides, in few pieces"
    assert np.ptp(u) >= 28 and np.ptp(v) >= 16, (u, v)
    for refused in (Parameter("edges.high", value=-1.0), Parameter("combined.low_of_high", value=1.5)):
        assert not rig.node.set_parameters([refused])[0].successful


@pytest.mark.parametrize("edge_method", ["combined", "outlines"])
def test_deep_pictures_have_the_edges_of_those_of_8_bits(ros: Any, edge_method: str) -> None:
    soft = cv2.GaussianBlur(square(), (0, 0), 1.2).astype(np.float32)
    soft = np.rint(soft * (255.0 / soft.max()))
    soft[40, :] += np.where(np.arange(66) % 8 < 4, 12, 0)  # too weak for an edge, in any depth
    rig = Rig(ros, {"edge_method": edge_method, "edges.surround": 0.0, "edges.high": 10.0})
    labels: list[Image] = ros.collect(rig.probe, Image, "edges", qos.IMAGES)
    ros.spin_until(lambda: rig.node.count_subscribers("edges") == 1, 10.0)
    ros.spin_until(lambda: rig.probe.count_publishers("edges") == 1, 10.0)
    found = {}
    pictures = {"mono8": soft.astype(np.uint8), "mono16": (soft * 257).astype(np.uint16), "32FC1": soft / 255}
    for stamp, (encoding, picture) in enumerate(pictures.items(), start=1):
        rig.corners_of(image_message(picture.astype(picture.dtype), encoding, header(stamp, "c")))
        message = ros.spin_until(lambda n=stamp: next((m for m in labels if stamp_ns(m.header.stamp) == n), None), 10.0)
        found[encoding] = image_array(message) == 128
    assert 90 < found["mono8"].sum() < 130  # the four sides
    for encoding in ("mono16", "32FC1"):
        assert (found[encoding] != found["mono8"]).sum() <= 4, encoding


def test_outlines_see_colors_of_one_lightness(ros: Any) -> None:
    lab = np.full((60, 80, 3), 128, np.uint8)
    lab[:, 40:, 1] = 160
    picture = cv2.cvtColor(lab, cv2.COLOR_LAB2BGR)
    rig = Rig(ros, {"edge_method": "outlines"})
    labels: list[Image] = ros.collect(rig.probe, Image, "edges", qos.IMAGES)
    ros.spin_until(lambda: rig.node.count_subscribers("edges") == 1, 10.0)
    ros.spin_until(lambda: rig.probe.count_publishers("edges") == 1, 10.0)
    turned = np.ascontiguousarray(picture[:, :, ::-1])
    for stamp, encoding, seen in (
        (1, "bgr8", picture),
        (2, "rgb8", turned),
        (3, "rgb16", turned.astype(np.uint16) * 16),
    ):
        rig.corners_of(image_message(seen, encoding, header(stamp, "c")))
        found = image_array(ros.spin_until(lambda n=stamp: len(labels) == n and labels[-1], 10.0)) == 128
        assert found.any(axis=1).all() and np.abs(np.nonzero(found)[1] - 39.5).max() < 1.0, encoding


def test_outlines_end_at_the_same_corners_in_colored_light_of_16_bits(ros: Any) -> None:
    """The grey image is four times as dark as the colours, so it fills fewer bits."""
    rng = np.random.default_rng(5)
    light = np.kron(rng.integers(40, 220, (4, 5)), np.ones((32, 32))) + rng.normal(0.0, 0.5, (128, 160))
    light += 10.0 * (np.indices((128, 160)) // 8 % 2).prod(axis=0)  # too faint for an edge to end there
    blue = np.dstack([light, light / 6, light / 6]).clip(0, 255).astype(np.uint8)
    rig = Rig(ros, {"edge_method": "outlines", "relative_threshold": 0.0})
    labels: list[Image] = ros.collect(rig.probe, Image, "edges", qos.IMAGES)
    ros.spin_until(lambda: rig.node.count_subscribers("edges") == 1, 10.0)
    ros.spin_until(lambda: rig.probe.count_publishers("edges") == 1, 10.0)
    found = []
    for stamp, encoding, seen in ((1, "bgr8", blue), (2, "bgr16", blue.astype(np.uint16) * 257)):
        rig.corners_of(image_message(seen, encoding, header(stamp, "c")))
        found.append(image_array(ros.spin_until(lambda n=stamp: len(labels) == n and labels[-1], 10.0)) == 128)
    assert found[0].sum() > 500 and (found[0] != found[1]).sum() < 0.05 * found[0].sum()


def test_edges_of_the_corners_pass_need_its_response(ros: Any) -> None:
    rig = Rig(ros)
    answer = rig.node.set_parameters([Parameter("response", value="noble")])[0]
    assert not answer.successful and "edge_method" in answer.reason
    outlines = [Parameter("edge_method", value="outlines"), Parameter("response", value="noble")]
    assert rig.node.set_parameters_atomically(outlines).successful


@pytest.mark.parametrize("edge_method", ["combined", "outlines"])
def test_repeatable_corners_stand_out_from_the_noise(ros: Any, edge_method: str) -> None:
    noisy = (square().astype(np.float64) + np.random.default_rng(3).normal(0.0, 5.0, square().shape)).astype(np.uint8)
    repeatable = {"corner_method": "repeatable", "repeatable.least": 0.0, "relative_threshold": 0.0}
    rig = Rig(ros, {**repeatable, "edge_method": edge_method})
    assert pixels(rig.corners_of(image_message(noisy, "mono8", header(1, "c")))) == SQUARE
    labels: list[Image] = ros.collect(rig.probe, Image, "edges", qos.IMAGES)
    ros.spin_until(lambda: rig.node.count_subscribers("edges") == 1, 10.0)
    ros.spin_until(lambda: rig.probe.count_publishers("edges") == 1, 10.0)
    assert pixels(rig.corners_of(image_message(noisy, "mono8", header(2, "c")))) == SQUARE
    picture = image_array(ros.spin_until(lambda: labels and labels[-1], 10.0))
    assert sorted(map(tuple, np.argwhere(picture == 255)[:, ::-1].astype(float).tolist())) == SQUARE
    assert (picture[11:14, 14:46] == 128).any(axis=0).all(), "the upper side leads from corner to corner"
    refused = rig.node.set_parameters([Parameter("repeatable.least", value=1.5)])[0]
    assert not refused.successful and "1.5" in refused.reason
    assert rig.node.set_parameters([Parameter("corner_method", value="fast")])[0].successful
    assert len(rig.corners_of(image_message(noisy, "mono8", header(3, "c")))) > 20


def test_corners_over_scales_have_the_scale_of_what_they_are_of(ros: Any) -> None:
    y, x = np.indices((240, 300))
    at, radius = np.array([(70.0, 80.0), (200.0, 150.0)]), np.array([2.5, 6.4])
    spots = [180 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * r**2)) for (u, v), r in zip(at, radius)]
    picture = (30 + sum(spots)).astype(np.uint8)
    rig = Rig(ros, {"corner_method": "scales", "gradient": "gaussian", "window": "gaussian"})
    found = cloud_array(rig.cloud_of(image_message(picture, "mono8", header(1, "c"))), ("u", "v", "scale"))
    scales = [found[np.linalg.norm(found[:, :2] - centre, axis=1) < 2.5, 2] for centre in at]
    print(scales)
    assert np.median(scales[1]) / np.median(scales[0]) == pytest.approx(2.5, rel=0.3)
    refused = rig.node.set_parameters([Parameter("scales.factor", value=1.0)])[0]
    assert not refused.successful and "1.05" in refused.reason and "value: 1.0" in refused.reason
    assert rig.node.set_parameters([Parameter("scales.levels", value=1)])[0].successful
    cloud = rig.cloud_of(image_message(picture, "mono8", header(2, "c")))
    assert (cloud_array(cloud, ("scale",)) == 1.0).all() and cloud.width > 0
    assert rig.node.set_parameters([Parameter("corner_method", value="fast")])[0].successful
    cloud = rig.cloud_of(image_message(picture, "mono8", header(3, "c")))
    assert [field.name for field in cloud.fields] == ["u", "v", "response"]


def test_the_benchmarks_peer_is_this_node_with_the_corners_of_opencv(ros: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[3] / "benchmarks"))
    threads = cv2.getNumThreads()
    monkeypatch.setattr(cv2, "setNumThreads", lambda count: None)
    rig = Rig(ros, made_by=importlib.import_module("perception.bench_graph_latency").PeerNode)
    noisy = np.random.default_rng(3).integers(0, 255, (60, 80)).astype(np.uint8)
    found = rig.corners_of(image_message(noisy, "mono8", header(1, "c")))
    expected = cv2.goodFeaturesToTrack(noisy, 2000, 0.01, 0, blockSize=3, useHarrisDetector=True, k=0.04)
    np.testing.assert_array_equal(found[:, :2], expected.reshape(-1, 2))
    assert len(found) > 50 and cv2.getNumThreads() == threads


def test_without_a_reader_no_images_are_taken_and_nothing_is_wrong(ros: Any) -> None:
    probe = ros.plain()
    reports: list[DiagnosticArray] = ros.collect(probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
    images = probe.create_publisher(Image, "image_raw", qos.IMAGES)
    node = ros.node(CornersNode)
    told = ros.spin_until(lambda: [s for r in reports for s in r.status if s.name == "/corners"], 10.0)[0]
    assert (told.message, told.level) == ("idle: no subscriber", LEVELS["ok"])
    assert images.get_subscription_count() == 0
    lines: list[PointCloud2] = ros.collect(probe, PointCloud2, "edge_lines", qos.RESULTS)
    ros.spin_until(lambda: images.get_subscription_count() == 1, 10.0)
    ros.spin_until(lambda: probe.count_publishers("edge_lines") == 1, 10.0)
    images.publish(image_message(square(), "mono8", header(5, "c")))
    assert stamp_ns(ros.spin_until(lambda: lines, 10.0)[0].header.stamp) == 5
    for subscription in [s for s in probe.subscriptions if s.topic_name == "/edge_lines"]:
        probe.destroy_subscription(subscription)
    ros.spin_until(lambda: images.get_subscription_count() == 0, 10.0)
    assert node._frames == 1


def test_in_step_with_a_recording_images_are_taken_without_a_reader(ros: Any) -> None:
    images = ros.plain().create_publisher(Image, "image_raw", qos.IMAGES)
    ros.node(CornersNode, {"on_demand": False})
    ros.spin_until(lambda: images.get_subscription_count() == 1, 10.0)
