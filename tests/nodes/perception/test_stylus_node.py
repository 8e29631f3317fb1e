"""Stylus tracker node: the tip in metres with the picture's stamp, and no tip but that stamp when it is not certain."""

from __future__ import annotations

import time
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from rclpy.parameter import Parameter
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from unit.harris_perception.rendered_stylus import render, stereo_model

from harris_perception.nodes.stylus_node import StylusNode
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message, image_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.places import point_array

WITHIN_S = 30.0
STEREO = stereo_model()
TIPS = [np.array([0.03, -0.02, 0.66]), np.array([0.06, 0.03, 0.6])]


def test_the_tip_is_published_where_it_is_certain(ros: Any) -> None:
    probe = ros.plain()
    models = {"left": STEREO.left, "right": STEREO.right}
    images = {side: probe.create_publisher(Image, f"{side}/image_raw", qos.IMAGES) for side in models}
    infos = {side: probe.create_publisher(CameraInfo, f"{side}/camera_info", qos.IMAGES) for side in models}
    tips: list[PointStamped] = ros.collect(probe, PointStamped, "tip", qos.RESULTS)
    unseen: list[Header] = ros.collect(probe, Header, "unseen", qos.RESULTS)
    diagnostics: list[DiagnosticArray] = ros.collect(probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
    node = ros.node(StylusNode)
    matched = [*images.values(), *infos.values()]
    ros.spin_until(lambda: all(p.get_subscription_count() for p in matched), WITHIN_S)
    ros.spin_until(lambda: all(probe.count_publishers(topic) for topic in ("tip", "unseen")), WITHIN_S)

    def show(stamp: int, pictures: list[Any], encoding: str = "bgr8") -> None:
        for side, picture in zip(models, pictures):
            infos[side].publish(camera_info_message(models[side], header(stamp, f"camera_{side}_optical_frame")))
            images[side].publish(image_message(picture, encoding, header(stamp, f"camera_{side}_optical_frame")))

    def said() -> list[str]:
        return [s.message for d in diagnostics for s in d.status if s.name == "stylus_tracker"]

    rng = np.random.default_rng(2)
    show(1, [np.zeros((480, 800, 3), np.uint8)] * 2)
    ros.spin_until(lambda: node._tracker is not None, WITHIN_S)
    first, second = (render(STEREO, tip, rng) for tip in TIPS)
    hidden = [second[0], np.full_like(second[1], 100)]
    for stamp, pictures in ((1_000_000_000, first), (2_000_000_000, hidden), (3_000_000_000, second)):
        show(stamp, pictures)
    ros.spin_until(lambda: len(tips) >= 2, WITHIN_S, said)
    assert [stamp_ns(t.header.stamp) for t in tips] == [1_000_000_000, 3_000_000_000]
    assert {t.header.frame_id for t in tips} == {"camera_left_optical_frame"}
    for message, truth in zip(tips, TIPS):
        assert np.abs(point_array(message) - truth)[:2].max() < 0.0002
        assert abs(point_array(message) - truth)[2] < 0.0006
    show(4_000_000_000, hidden)
    ros.spin_until(lambda: any("not seen in the right picture" in text for text in said()), WITHIN_S, said)
    show(5_000_000_000, [picture[:100] for picture in first])
    ros.spin_until(lambda: any("(100, 800, 3)" in text for text in said()), WITHIN_S, said)
    ros.spin_until(lambda: "no pairs of pictures in the last second" in said()[-1], WITHIN_S, said)
    assert len(tips) == 2
    # For each evaluated image, one of both has the result; the first one came before the calibration.
    looked = [2_000_000_000, 4_000_000_000, 5_000_000_000]
    assert [stamp_ns(head.stamp) for head in unseen if stamp_ns(head.stamp) > 1] == looked
    before = len(unseen)
    assert {head.frame_id for head in unseen} == {"camera_left_optical_frame"}
    for stamp in (5_200_000_000, 5_400_000_000):  # the right camera's were lost
        images["left"].publish(image_message(first[0], "bgr8", header(stamp, "camera_left_optical_frame")))
    ros.spin_until(lambda: len(unseen) > before and stamp_ns(unseen[-1].stamp) == 5_200_000_000, WITHIN_S)
    show(6_000_000_000, [cv2.cvtColor(picture, cv2.COLOR_BGR2BGRA) for picture in second], "bgra8")
    ros.spin_until(lambda: len(tips) == 3, WITHIN_S, said)
    assert point_array(tips[2]) == pytest.approx(point_array(tips[1]), abs=1e-9)
    show(7_000_000_000, [picture[:, :, 0] for picture in second], "mono8")
    ros.spin_until(lambda: any("'mono8' has no color" in text for text in said()), WITHIN_S, said)
    show(8_000_000_000, [picture[:, :, :2] for picture in second], "yuv422")
    ros.spin_until(lambda: any("'yuv422' is none of mono8, bgr8" in text for text in said()), WITHIN_S, said)


def test_free_running_cameras_give_tips_or_a_code_with_what_to_set(ros: Any) -> None:
    """Two cameras without a trigger, 12 ms apart: there was no tip, and no word about it."""
    probe = ros.plain()
    models = {"left": STEREO.left, "right": STEREO.right}
    images = {side: probe.create_publisher(Image, f"{side}/image_raw", qos.IMAGES) for side in models}
    infos = {side: probe.create_publisher(CameraInfo, f"{side}/camera_info", qos.IMAGES) for side in models}
    tips: list[PointStamped] = ros.collect(probe, PointStamped, "tip", qos.RESULTS)
    diagnostics: list[DiagnosticArray] = ros.collect(probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
    node = ros.node(StylusNode)
    matched = [*images.values(), *infos.values()]
    ros.spin_until(lambda: all(p.get_subscription_count() for p in matched), WITHIN_S)
    ros.spin_until(lambda: probe.count_publishers("tip"), WITHIN_S)
    pictures = dict(zip(models, render(STEREO, TIPS[0], np.random.default_rng(2))))
    shown, sent = [1_000_000_000], [0, 0.0]

    def show(side: str, stamp: int) -> None:
        head = header(stamp, f"camera_{side}_optical_frame")
        infos[side].publish(camera_info_message(models[side], head))
        images[side].publish(image_message(pictures[side], "bgr8", head))

    def show_both() -> None:
        shown[0] += 33_333_333
        show("left", shown[0])
        show("right", shown[0] + 12_000_000)

    def values() -> dict[str, str]:
        own = [s for d in diagnostics for s in d.status if s.name == "stylus_tracker"]
        return {v.key: v.value for v in own[-1].values} | {"text": own[-1].message} if own else {}

    def shows(condition: Any) -> Any:
        def look() -> bool:
            # One pair after the other: a node that is behind would lose images, and see another period.
            if node._received >= sent[0] or time.monotonic() > sent[1]:
                show_both()
                sent[:] = node._received + 1, time.monotonic() + 1.0
            return bool(condition())

        return look

    ros.spin_until(shows(lambda: len(tips) >= 5), WITHIN_S, values)
    assert np.abs(point_array(tips[-1]) - TIPS[0])[:2].max() < 0.0002
    assert (stamp_ns(tips[-1].header.stamp) - 1_000_000_000) % 33_333_333 == 0, "at the left image's instant"
    ros.spin_until(shows(lambda: values().get("pairing") == "interpolated"), WITHIN_S, values)
    assert float(values()["difference_ms"]) == pytest.approx(12.0, abs=0.01)
    node.set_parameters([Parameter("free_running", value=False)])
    ros.spin_until(shows(lambda: values().get("pairing") == "no_pair"), WITHIN_S, values)
    assert values()["parameter"] == "free_running" and values()["tolerance_ms"] == "4"
    assert "left and right images differ by 12.0 ms, tolerance 4 ms: set free_running" in values()["text"]
