"""The camera and the detector as nodes on real photographs: a chessboard in front of a real stereo camera."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import Image, PointCloud2

from harris_perception.nodes.camera_node import CameraNode
from harris_perception.nodes.corners_node import CornersNode
from icu_common.nodes import qos
from icu_common.nodes.conversions import cloud_array, image_array, stamp_ns

BOARDS = Path(os.environ.get("ICU_TEST_DATA", "")) / "boards"
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
