"""The recognition node with publishers of its inputs, and lists of its answers."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Float32
from unit.harris_perception import panel_scene as scene
from visualization_msgs.msg import MarkerArray

from harris_perception.core.corners.harris import HarrisDetector
from harris_perception.core.image.gray import gray_of
from harris_perception.nodes.recognition_node import RecognitionNode
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_info_message, image_message
from icu_common.nodes.messages.clouds import cloud_message
from icu_common.nodes.messages.heads import header

LAYOUT = scene.bench_layout()
CAMERA = scene.camera()
# Between two pictures here much time may pass on a busy machine: no deadline may be near.
PATIENCE = {"silence_s": 20.0, "corners_wait_s": 2.0}
START = 1_700_000_000_000_000_000
PERIOD = 250_000_000


class Rig:
    """The node, publishers of its inputs, and lists of its messages."""

    def __init__(self, ros: Any, camera: CameraModel = CAMERA, **parameters: Any) -> None:
        self.ros = ros
        self.node = ros.node(RecognitionNode, {"layout": str(scene.LAYOUT), **PATIENCE, **parameters})
        self.probe = ros.plain()
        self.poses: list[PoseStamped] = ros.collect(self.probe, PoseStamped, "pose", qos.LATCHED)
        self.confidences: list[Float32] = ros.collect(self.probe, Float32, "confidence", qos.RESULTS)
        self.controls: list[MarkerArray] = ros.collect(self.probe, MarkerArray, "controls", qos.LATCHED)
        self.images = self.probe.create_publisher(Image, "image_raw", qos.IMAGES)
        self.infos = self.probe.create_publisher(CameraInfo, "camera_info", qos.IMAGES)
        self.corners = self.probe.create_publisher(PointCloud2, "corners", qos.RESULTS)
        for publisher in (self.images, self.infos, self.corners):
            ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)
        for topic in ("pose", "confidence", "controls"):
            ros.spin_until(lambda t=topic: self.probe.count_publishers(t) == 1, 10.0)
        self.infos.publish(camera_info_message(camera, header(START, CAMERA_LEFT)))
        ros.spin_until(lambda: self.node._camera is not None, 10.0)

    def show(self, shown: np.ndarray, number: int, with_corners: bool = True, encoding: str = "bgr8") -> float:
        """Publish one picture and return the confidence that answers it."""
        before = len(self.confidences)
        head = header(START + number * PERIOD, CAMERA_LEFT)
        if with_corners:
            corners = HarrisDetector().detect(gray_of(shown, encoding) if shown.ndim == 3 else shown)
            self.corners.publish(cloud_message(("u", "v", "response"), np.c_[corners.xy, corners.response], head))
        packed = shown if encoding == "mono8" or shown.ndim == 3 else np.repeat(shown[..., None], 3, axis=2)
        self.images.publish(image_message(packed, encoding, head))
        self.ros.spin_until(lambda: len(self.confidences) > before, 30.0)
        return float(self.confidences[before].data)  # after it that of a camera that is silent may have come
