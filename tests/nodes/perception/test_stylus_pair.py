"""Stylus tracker node: a right camera that has turned is reported, and the tip is measured with the turn corrected."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Float32
from support.parameter_files import CONFIG, parameters

from harris_perception.nodes.stylus_node import StylusNode
from icu_common.core.alignment.layout import DeviationCode
from icu_common.core.alignment.pair import PairCode
from icu_common.core.configuration.config import from_mapping
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT
from icu_common.core.panel.panel_layout import load_layout
from icu_common.nodes import qos
from icu_common.nodes.alignment.layout_message import layout_message, layout_of_message
from icu_common.nodes.alignment.pair_message import pair_message, pair_of_message
from icu_common.nodes.messages.cameras import camera_info_message, image_message
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.places import point_array, pose_message, transform_message
from icu_simulator.core.bench import Bench
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.optics import stereo_rig
from icu_simulator.core.renderer import Moment, Renderer

pytestmark = pytest.mark.long

WITHIN_S = 60.0
TIP = (0.16, 0.06, 0.0)
LAYOUT = CONFIG / "scopes" / "dso_bench_4.yaml"


@pytest.mark.timeout(300)
def test_a_turn_of_the_right_camera_is_published_and_corrected(ros: Any) -> None:
    layout = load_layout(LAYOUT)
    config = from_mapping(BenchConfig, parameters("bench"))
    bench = Bench(layout, config)
    rig = stereo_rig(config.camera)
    models = {side: CameraModel.from_mapping(rig.calibration(side)) for side in ("left", "right")}
    probe = ros.plain()
    images = {side: probe.create_publisher(Image, f"{side}/image_raw", qos.IMAGES) for side in models}
    infos = {side: probe.create_publisher(CameraInfo, f"{side}/camera_info", qos.IMAGES) for side in models}
    pose = probe.create_publisher(PoseStamped, "panel/pose", qos.LATCHED)
    confidence = probe.create_publisher(Float32, "panel/confidence", qos.RESULTS)
    calibration = probe.create_publisher(TransformStamped, "calibration/camera_from_base", qos.LATCHED)
    pairs: list[DiagnosticArray] = ros.collect(probe, DiagnosticArray, "pair", qos.LATCHED)
    layouts: list[DiagnosticArray] = ros.collect(probe, DiagnosticArray, "layout", qos.LATCHED)
    tips: list[PointStamped] = ros.collect(probe, PointStamped, "tip", qos.RESULTS)
    node = ros.node(StylusNode, {"layout": str(LAYOUT)})
    matched = [*images.values(), *infos.values(), pose, confidence, calibration]
    ros.spin_until(lambda: all(p.get_subscription_count() for p in matched), WITHIN_S)
    camera_from_base = rig.rectified_left_from_base()
    pose.publish(pose_message(camera_from_base @ bench.panel_from, header(1, CAMERA_LEFT)))
    confidence.publish(Float32(data=0.9))
    for side, model in models.items():
        infos[side].publish(camera_info_message(model, header(1, f"camera_{side}_optical_frame")))
    ros.spin_until(lambda: node._tracker is not None and node._check.due(1), WITHIN_S)
    ros.spin_until(lambda: bool(pairs), WITHIN_S)
    assert pair_of_message(pairs[0]).code is PairCode.UNKNOWN

    def show(turn_deg: float, first_s: int, count: int) -> None:
        camera = config.camera
        skew = (camera.skew_deg[0], camera.skew_deg[1] + turn_deg, camera.skew_deg[2])
        turned = dataclasses.replace(config, camera=dataclasses.replace(camera, skew_deg=skew))
        renderer = Renderer(layout, turned, bench.panel_from)
        for second in range(first_s, first_s + count):
            drawn = renderer.render(Moment(tip=TIP, state=bench.state, now_s=float(second)))
            before, seen = len(pairs), len(tips)
            for side, image in zip(models, drawn):
                head = header(second * 1_000_000_000, f"camera_{side}_optical_frame")
                images[side].publish(image_message(image, "bgr8", head))
            ros.spin_until(lambda: len(pairs) > before and len(tips) > seen, WITHIN_S)  # noqa: B023

    truth = camera_from_base.apply(np.array(TIP))
    show(0.0, 1, 3)
    assert pair_of_message(pairs[-1]).code is PairCode.ALIGNED
    assert np.linalg.norm(point_array(tips[-1]) - truth) < 0.0003
    show(0.02, 4, 1)
    assert pair_of_message(pairs[-1]).code is PairCode.CHANGING
    assert np.linalg.norm(point_array(tips[-1]) - truth) > 0.0008
    show(0.02, 5, 2)
    state = pair_of_message(pairs[-1])
    assert state.code is PairCode.CORRECTED and state.turn_deg == pytest.approx(0.02, abs=0.002)
    assert np.linalg.norm(point_array(tips[-1]) - truth) < 0.0003
    show(0.2, 7, 3)
    state = pair_of_message(pairs[-1])
    assert state.code is PairCode.MOVED and state.turn_deg == pytest.approx(0.2, abs=0.005)
    calibration.publish(transform_message(camera_from_base, header(10, CAMERA_LEFT), BASE))
    ros.spin_until(lambda: pair_of_message(pairs[-1]).code is PairCode.CORRECTED, WITHIN_S)
    assert pair_of_message(pairs[-1]).turn_deg == 0.0

    deviations = layout_of_message(layouts[-1])
    assert {name for name, d in deviations.items() if d.code is DeviationCode.UNMEASURED} <= {"SCREEN", "AUTO_SET"} | {
        c.name for c in layout.controls if c.lit_colour
    }
    again = layout_of_message(layout_message(deviations, header(1, CAMERA_LEFT)))
    assert again.keys() == deviations.keys()
    assert all(math.dist(again[n].offset_mm, deviations[n].offset_mm) < 1e-3 for n in again)
    assert pair_of_message(pair_message(state, header(5, CAMERA_LEFT))).stamp_ns == 5
    with pytest.raises(ValueError, match="not the state"):
        pair_of_message(DiagnosticArray())
