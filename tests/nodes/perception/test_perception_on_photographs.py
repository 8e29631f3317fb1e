"""The perception nodes on real photographs: a chessboard, a box on a cluttered table, a motorcycle in stereo."""

from __future__ import annotations

import itertools
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from support.pinhole import pinhole

from harris_perception.nodes.camera_node import CameraNode
from harris_perception.nodes.corners_node import CornersNode
from harris_perception.nodes.recognition_node import RecognitionNode
from harris_perception.nodes.stereo_node import StereoNode
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message, image_array, image_message
from icu_common.nodes.messages.clouds import cloud_array
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.places import transform_of_pose

PHOTOGRAPHS = Path(os.environ.get("ICU_TEST_DATA", ""))
BOARDS = PHOTOGRAPHS / "boards"
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 250_000_000
REACH_PX = 3.0
"""The board finder's own corners are good to a pixel or two."""

needs_photographs = pytest.mark.skipif(
    "ICU_TEST_DATA" not in os.environ or not BOARDS.is_dir(), reason="ICU_TEST_DATA does not name a folder with boards"
)


@needs_photographs
def test_the_corners_of_a_photographed_board_are_found(ros: Any) -> None:
    ros.node(
        CameraNode,
        {
            "source": "images",
            "left_path": str(BOARDS / "left*.jpg"),
            "right_path": str(BOARDS / "right*.jpg"),
            "rate_hz": 5.0,
        },
    )
    probe = ros.plain()
    images = ros.collect(probe, Image, "left/image_raw", qos.SENSOR)
    clouds = ros.collect(probe, PointCloud2, "left/corners", qos.RESULTS)
    ros.node(
        CornersNode,
        {"relative_threshold": 0.01},
        cli_args=["--ros-args", "-r", "image_raw:=left/image_raw", "-r", "corners:=left/corners"],
    )

    def pairs() -> list[tuple[Image, PointCloud2]]:
        by_stamp = {stamp_ns(image.header.stamp): image for image in images}
        stamped = [(by_stamp.get(stamp_ns(cloud.header.stamp)), cloud) for cloud in clouds]
        return [(image, cloud) for image, cloud in stamped if image is not None]

    ros.spin_until(lambda: len(pairs()) >= 5, 30.0, lambda: f"{len(images)} pictures, {len(clouds)} clouds")
    shares = []
    for image, cloud in pairs():
        gray = cv2.cvtColor(image_array(image), cv2.COLOR_BGR2GRAY)
        seen, board = cv2.findChessboardCorners(gray, (9, 6))
        if not seen:
            continue
        corners = cloud_array(cloud, ("u", "v"))
        distances = np.linalg.norm(board.reshape(-1, 1, 2) - corners[None], axis=2).min(axis=1)
        shares.append(float((distances < REACH_PX).mean()))
    assert len(shares) >= 3
    assert min(shares) > 0.95, f"shares of the board's 54 inner corners that have a Harris corner near: {shares}"


@needs_photographs
def test_a_photographed_box_is_recognised(ros: Any, tmp_path: Path) -> None:
    """Its face is the template; where it lies is what OpenCV's SIFT and RANSAC find in the same picture."""
    face, table = (cv2.imread(str(PHOTOGRAPHS / "object" / name), 0) for name in ("box.png", "box_in_scene.png"))
    (height, width), sift = face.shape, cv2.SIFT.create()
    (points_a, a), (points_b, b) = sift.detectAndCompute(face, None), sift.detectAndCompute(table, None)
    pairs = [m for m, n in cv2.BFMatcher().knnMatch(a, b, k=2) if m.distance < 0.75 * n.distance]
    there = [np.array([points[i].pt for i in which]) for points, which in
             ((points_a, [m.queryIdx for m in pairs]), (points_b, [m.trainIdx for m in pairs]))]  # fmt: skip
    truth, _ = cv2.findHomography(*there, method=cv2.RANSAC, ransacReprojThreshold=2.0)

    # One millimetre a pixel. The camera is not known; a lens of 53 degrees fits the perspective to 0.2 px.
    layout = tmp_path / "box.yaml"
    layout.write_text(
        f"model: box\ntitle: A box\nsize_mm: [{width}, {height}]\ncolour: '#000000'\ncontrols:\n"
        "  - {name: LABEL, kind: connector, position_mm: [160, 110], size_mm: [9, 9]}\n"
    )
    rows, columns = table.shape
    camera = pinhole(size=(columns, rows), focal_px=columns)
    ros.node(
        RecognitionNode,
        {
            "layout": str(layout),
            "template": str(PHOTOGRAPHS / "object" / "box.png"),
            "template_px_per_mm": 1.0,
            "corners_wait_s": 0.0,
            "recognition.search.px_per_mm": 1.26,
            "recognition.refine.min_agreement": 0.2,
            "harris.relative_threshold": 0.001,
        },
    )
    probe = ros.plain()
    poses: list[PoseStamped] = ros.collect(probe, PoseStamped, "pose", qos.LATCHED)
    images = probe.create_publisher(Image, "image_raw", qos.IMAGES)
    infos = probe.create_publisher(CameraInfo, "camera_info", qos.IMAGES)
    ros.spin_until(lambda: images.get_subscription_count() and infos.get_subscription_count(), 30.0)
    infos.publish(camera_info_message(camera, header(START_NS, "photo")))
    stamps = itertools.count(START_NS + PERIOD_NS, PERIOD_NS)
    probe.create_timer(0.25, lambda: images.publish(image_message(table, "mono8", header(next(stamps), "photo"))))
    pose = ros.spin_until(lambda: poses, 60.0, lambda: f"now at {next(stamps)} ns")[-1]
    outline = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    seen = camera.project(transform_of_pose(pose.pose).apply(np.column_stack([outline / 1e3, np.zeros(4)])))
    pixels = outline * (1.0, -1.0) + (-0.5, height - 0.5)
    errors = np.linalg.norm(seen - cv2.perspectiveTransform(pixels[:, None], truth)[:, 0], axis=1)
    print("errors of the box's corners, px:", errors)
    assert errors.max() < 4.0


@needs_photographs
def test_a_photographed_motorcycle_is_measured_in_metres(ros: Any) -> None:
    """Depths against those of structured light (Middlebury 2014, quarter size, with its published calibration)."""
    f_px, baseline_m, offset_px = 994.978, 0.193001, 31.086
    folder = PHOTOGRAPHS / "stereo" / "motorcycle"
    pictures = [cv2.imread(str(folder / f"motorcycle_{side}.png")) for side in ("left", "right")]
    with np.load(folder / "motorcycle_disp.npz") as stored:
        disparity = stored[stored.files[0]].astype(float)
    disparity[~np.isfinite(disparity) | (disparity <= 0)] = np.nan
    truth_m = f_px * baseline_m / (disparity + offset_px)
    height, width = pictures[0].shape[:2]
    models = [
        pinhole(size=(width, height), focal_px=f_px, centre_px=(311.193 + shift_px, 254.877), baseline_m=baseline)
        for shift_px, baseline in ((0.0, 0.0), (offset_px, baseline_m))
    ]
    ros.node(StereoNode, {"matching.min_depth_m": 1.5, "matching.max_depth_m": 6.0})
    probe = ros.plain()
    clouds: list[PointCloud2] = ros.collect(probe, PointCloud2, "points2", qos.RESULTS)
    outs = {}
    for side in ("left", "right"):
        ros.node(
            CornersNode,
            {"relative_threshold": 0.001},
            cli_args=["--ros-args", "-r", f"image_raw:={side}/image_raw", "-r", f"corners:={side}/corners"],
        )
        outs[side] = (
            probe.create_publisher(CameraInfo, f"{side}/camera_info", qos.IMAGES),
            probe.create_publisher(Image, f"{side}/image_raw", qos.IMAGES),
        )
    ros.spin_until(lambda: all(o.get_subscription_count() for pair in outs.values() for o in pair), 30.0)
    stamps = itertools.count(START_NS, PERIOD_NS)

    def show() -> None:
        head = header(next(stamps), "camera")
        for (info, image), model, picture in zip(outs.values(), models, pictures):
            info.publish(camera_info_message(model, head))
            image.publish(image_message(picture, "bgr8", head))

    probe.create_timer(0.25, show)
    cloud = cloud_array(ros.spin_until(lambda: clouds, 60.0, lambda: f"now at {next(stamps)} ns")[-1], ("x", "y", "z"))
    pixels = np.round(models[0].project(cloud.astype(float))).astype(int)
    expected = truth_m[pixels[:, 1], pixels[:, 0]]
    known = np.isfinite(expected)
    off_px = np.abs(f_px * baseline_m * (1.0 / cloud[known, 2] - 1.0 / expected[known]))
    right = float((off_px < 1.0).mean())
    relative = np.median(np.abs(cloud[known, 2] / expected[known] - 1.0))
    print(f"{known.sum()} points, {right:.1%} within 1 px, median error of the depth {relative:.2%}")
    assert known.sum() > 150
    assert right > 0.9
    assert relative < 0.005
