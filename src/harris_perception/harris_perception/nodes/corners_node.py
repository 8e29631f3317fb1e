"""Node that detects Harris corners in images; one instance per camera."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import Image, PointCloud2

from harris_perception.core.corners.harris import Corners, HarrisConfig, HarrisDetector
from harris_perception.core.corners.harris_laplace import (
    HarrisLaplaceConfig,
    HarrisLaplaceDetector,
    PyramidConfig,
    ScaledCorners,
)
from harris_perception.core.corners.repeatable import RepeatableConfig, RepeatableDetector
from harris_perception.core.edges import edge_lines
from harris_perception.core.edges.combined_detector import CombinedDetector
from harris_perception.core.edges.edges import EdgeConfig, EdgeDetector, Edges, TracingConfig
from harris_perception.core.image.gray import bgr_of, bgr_of_gray, gray_of, grey_level_of, has_color
from harris_perception.core.image.overlay import draw_corners
from harris_perception.nodes.compiling import compiling
from icu_common.core.configuration.config import ConfigError, nested, setting
from icu_common.nodes import qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.images import ReceivedImage
from icu_common.nodes.messages.cameras import image_array, image_message
from icu_common.nodes.messages.clouds import cloud_message
from icu_common.nodes.newest import NewestImage
from icu_common.nodes.on_demand import OnDemand, on_demand_setting
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every

COLUMNS = ("u", "v", "response")
SCALE = "scale"
"""Additional column for corners over scales: factor by which the corner's pyramid level is coarser than the image."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CornersNodeConfig(HarrisConfig):
    """Settings of the corner detectors (three methods) and of the edge detectors (two methods).

    Edges are detected only while a node subscribes to them. Edge strengths are in grey levels of 8 bits;
    core/image/gray.py explains them for images with more bits.
    """

    corner_method: str = setting(
        "fast",
        "Corner detector: fast is the detector of 1988 with the settings of this node. scales (Harris-Laplace) is the "
        "same over a pyramid, and gives scales. repeatable keeps corners that exceed noise and surroundings. The last "
        "two take several times as long",
        choices=("fast", "scales", "repeatable"),
    )
    scales: PyramidConfig = nested(PyramidConfig)
    repeatable: RepeatableConfig = nested(RepeatableConfig)
    edge_method: str = setting(
        "combined",
        "Edge detector: combined uses the pass of the corner detector, outlines uses two scales and colours "
        "and follows objects",
        choices=("combined", "outlines"),
    )
    combined: TracingConfig = nested(TracingConfig)
    edges: EdgeConfig = nested(EdgeConfig)
    on_demand: bool = on_demand_setting()

    def __post_init__(self) -> None:
        HarrisConfig.__post_init__(self)
        if self.edge_method == "combined" and self.response != "harris":
            raise ConfigError(f"response = {self.response!r}: edge_method 'combined' needs 'harris'")


class CornersNode(GraphNode):
    """Publishes the ``corners`` of each ``image_raw`` while they have a subscriber.

    Likewise ``corners_image``, ``edges`` (labels) and ``edge_lines`` (few points, for overlays).
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("corners", **options)
        self._live = LiveParameters(self, CornersNodeConfig, self._use)
        with compiling(self):
            self._use(self._live.config)
        self._frames = self._refused = self._found = self._reported = self._dropped = self._dropped_before = 0
        self._busy_s, self._refusal = 0.0, ""
        self._images: NewestImage | None = None
        self._demand = OnDemand(self, self._listen, self._rest, always=not self._live.config.on_demand)
        self._corners = self._demand.publisher(PointCloud2, "corners", qos.RESULTS)
        self._picture = self._demand.publisher(Image, "corners_image", qos.IMAGES)
        self._labels = self._demand.publisher(Image, "edges", qos.IMAGES)
        self._lines = self._demand.publisher(PointCloud2, "edge_lines", qos.RESULTS)
        self._diagnostics = Diagnostics(self)
        every(self, 1.0, self._report)
        self._demand.begin()

    def _listen(self) -> None:
        self._images = NewestImage(self, "image_raw", self._on_image)

    def _rest(self) -> None:
        if self._images is not None:
            self._images.end()
            self._dropped_before += self._images.dropped
            self._images = None

    def _use(self, config: CornersNodeConfig) -> None:
        self._corner_detector = _corner_detector(config)
        self._corner_detector.warm()
        self._combined = CombinedDetector(config, config.combined)
        self._outlines = EdgeDetector(config.edges)
        (self._combined if config.edge_method == "combined" else self._outlines).warm()

    def _on_image(self, message: ReceivedImage) -> None:
        start = time.perf_counter()
        try:
            gray = _gray(message)
        except ValueError as error:
            self._refused, self._refusal = self._refused + 1, f"picture refused: {error}"
            self.get_logger().warning(self._refusal, throttle_duration_sec=5.0)
            return
        corners, edges = self._found_in(gray, message)
        self._publish(corners, gray, message)
        if edges is not None:
            self._publish_edges(edges, message)
        self._frames, self._refusal = self._frames + 1, ""
        self._found = len(corners)
        self._busy_s += time.perf_counter() - start

    def _found_in(self, gray: npt.NDArray[Any], message: ReceivedImage) -> tuple[Corners | ScaledCorners, Edges | None]:
        config = self._live.config
        looked_at = self._labels.get_subscription_count() + self._lines.get_subscription_count() > 0
        fast, combined = config.corner_method == "fast", config.edge_method == "combined"
        if looked_at and fast and combined:
            return self._combined.detect(gray, grey_level=grey_level_of(gray))
        corners = self._corner_detector.detect(gray)
        if not looked_at:
            return corners, None
        level, strengths = grey_level_of(gray), self._corner_detector.strengths_of(corners.response)
        if combined:
            return corners, self._combined.detect(gray, corners.xy, strengths, level)[1]
        if has_color(message.encoding) and gray.size > 0:
            colors = image_array(message)  # one channel may be brighter than the grey image
            strengths = strengths / np.float32(grey_level_of(colors))
            return corners, self._outlines.detect(bgr_of(colors, message.encoding), corners.xy, strengths)
        return corners, self._outlines.detect(gray, corners.xy, strengths, level)

    def _publish(self, corners: Corners | ScaledCorners, gray: npt.NDArray[Any], message: ReceivedImage) -> None:
        held = np.finfo(np.float32)
        columns, values = [*COLUMNS], [corners.xy, np.clip(corners.response, held.tiny, held.max)]
        if isinstance(corners, ScaledCorners):
            columns, values = [*columns, SCALE], [*values, corners.scale]
        self._corners.publish(cloud_message(columns, np.column_stack(values), message.header))
        if self._picture.get_subscription_count() > 0:
            drawn = bgr_of_gray(gray)
            draw_corners(drawn, corners.xy)
            self._picture.publish(image_message(drawn, "bgr8", message.header))

    def _publish_edges(self, edges: Edges, message: ReceivedImage) -> None:
        if self._labels.get_subscription_count() > 0:
            self._labels.publish(image_message(edges.labels, "mono8", message.header))
        if self._lines.get_subscription_count() > 0:
            self._lines.publish(cloud_message(edge_lines.COLUMNS, edge_lines.edge_lines(edges), message.header))

    def _report(self) -> None:
        total = self._dropped_before + (self._images.dropped if self._images is not None else 0)
        new, dropped = self._frames - self._reported, total - self._dropped
        self._reported, self._dropped = self._frames, total
        per_frame_ms = 1e3 * self._busy_s / new if new else 0.0
        self._busy_s = 0.0
        text = self._refusal or f"{new} pictures in the last second" + (f", {dropped} dropped" if dropped else "")
        if idle := self._images is None:
            text = "idle: no subscriber"
        values = [
            ("frames", self._frames),
            ("dropped", total),
            ("refused", self._refused),
            ("ms_per_frame", f"{per_frame_ms:.2f}"),
            ("corners", self._found),
        ]
        self._diagnostics.tell("ok" if idle or (new and not self._refusal) else "warn", text, values)


def _corner_detector(config: CornersNodeConfig) -> HarrisDetector | HarrisLaplaceDetector | RepeatableDetector:
    if config.corner_method == "repeatable":
        return RepeatableDetector(config.repeatable)
    if config.corner_method == "fast":
        return HarrisDetector(config)
    pyramid = {item.name: getattr(config.scales, item.name) for item in fields(PyramidConfig)}
    return HarrisLaplaceDetector(HarrisLaplaceConfig(detector=config, **pyramid))


def _gray(message: ReceivedImage) -> npt.NDArray[Any]:
    picture = image_array(message)
    if message.encoding == "32FC1":
        return picture.astype(np.float32, copy=False)
    return gray_of(picture, message.encoding)


def preload() -> None:
    """Load the default detectors' machine code; the server that forks programs does this once for all programs."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # a fork has none of its parent's threads, and OpenCV would wait for them
    config = CornersNodeConfig()
    with compiling(None):
        HarrisDetector(config).warm()
        CombinedDetector(config, config.combined).warm()
    cv2.setNumThreads(threads)


def main() -> int:
    """Run the corners node."""
    return run(CornersNode)


if __name__ == "__main__":
    raise SystemExit(main())
