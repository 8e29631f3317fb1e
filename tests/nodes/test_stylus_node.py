"""Stylus tracker node: the tip in metres with the picture's stamp, and no tip but that stamp when it is not certain."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header
from unit.harris_perception.rendered_stylus import render, stereo_model

from harris_perception.nodes.stylus_node import StylusNode
from icu_common.nodes import qos
from icu_common.nodes.conversions import camera_info_message, header, image_message, point_array, stamp_ns

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
    # Of each picture that was looked at, one of both says what came of it; the first one came before the calibration.
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
