"""Dense stereo node: disparity and coloured points of every pixel, for display; idle without subscribers."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2
from stereo_msgs.msg import DisparityImage

from harris_perception.core.image.gray import GreyLevels, bgr_of, eight_bits, gray_of
from harris_perception.core.stereo.dense_stereo import DELTA_PX, F32, DenseConfig, DenseStereo, SemiGlobalConfig, warm
from harris_perception.core.stereo.pairing import Pairing
from harris_perception.nodes.compiling import compiling
from harris_perception.nodes.stereo_calibration import SIDES, StereoCalibration
from icu_common.core.configuration.config import Config, nested, setting
from icu_common.core.geometry import frames
from icu_common.nodes import qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.images import ReceivedImage, subscribe_to_images
from icu_common.nodes.messages.cameras import disparity_message, image_array
from icu_common.nodes.messages.clouds import organised_cloud_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.on_demand import OnDemand, on_demand_setting
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every


@dataclass(frozen=True, slots=True, kw_only=True)
class DenseStereoConfig(Config):
    """Settings of the dense stereo node."""

    rate_hz: float = setting(10.0, "Maximum rate of matched pairs", minimum=0.1, maximum=120.0, unit="Hz")
    pair_tolerance_s: float = setting(
        0.004,
        "Maximum difference between the left and right stamps of a pair; 0: the stamps must be equal",
        minimum=0.0,
        maximum=0.1,
        unit="s",
    )
    on_demand: bool = on_demand_setting()
    limits: DenseConfig = nested(DenseConfig)
    matching: SemiGlobalConfig = nested(SemiGlobalConfig)


class DenseStereoNode(GraphNode):
    """Publishes ``disparity`` and ``dense_points``; takes ``image_raw`` and ``camera_info`` of both sides.

    The images are subscribed to only while one of the two has a subscriber, so an unused node costs nothing.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("dense_stereo", **options)
        self._live = LiveParameters(self, DenseStereoConfig, lambda config: self._configure())
        self._calibration = StereoCalibration(self, self._configure)
        self._pairs, self._levels = Pairing(2), GreyLevels()
        self._stereo: DenseStereo | None = None
        self._listening: list[Subscription] = []
        self._matched = self._reported_ns = 0
        self._values: list[tuple[str, Any]] = []
        self._complaint = ""
        with compiling(self):
            warm()
        self._configure()
        self._demand = OnDemand(self, self._start, self._rest, always=not self._live.config.on_demand)
        self._disparity = self._demand.publisher(DisparityImage, "disparity", qos.IMAGES)
        self._points = self._demand.publisher(PointCloud2, "dense_points", qos.IMAGES)
        self._diagnostics = Diagnostics(self, "dense_stereo")
        every(self, 1.0, self._report)
        self._demand.begin()

    def _configure(self) -> None:
        config, stereo = self._live.config, self._calibration.stereo
        self._pairs.tolerance_ns = round(config.pair_tolerance_s * 1e9)
        self._stereo, self._complaint = None, ""
        try:
            self._stereo = DenseStereo(stereo, config.limits, config.matching) if stereo is not None else None
        except ValueError as error:
            self._complaint = str(error)

    def _start(self) -> None:
        self._listening = [self._listen(number, side) for number, side in enumerate(SIDES)]

    def _rest(self) -> None:
        while self._listening:
            self.destroy_subscription(self._listening.pop())
        self._pairs.clear()

    def _listen(self, stream: int, side: str) -> Subscription:
        # Queue of one: a matcher that is too slow should skip pairs and not show old ones.
        return subscribe_to_images(self, f"{side}/image_raw", functools.partial(self._on_image, stream), qos.NEWEST)

    def _on_image(self, stream: int, message: ReceivedImage) -> None:
        pair = self._pairs.add(stream, stamp_ns(message.header.stamp), message)
        if (
            pair is None
            or self._stereo is None
            or not self._demand.wanted
            or not self._pairs.due(self._live.config.rate_hz)
        ):
            return
        try:
            self._match(self._stereo, *pair)
        except ValueError as error:
            self._complaint = str(error)

    def _match(self, stereo: DenseStereo, left: ReceivedImage, right: ReceivedImage) -> None:
        start = time.perf_counter()
        grays = [gray_of(image_array(i), i.encoding) for i in (left, right)]
        level = self._levels.of(*grays)
        disparity = stereo.disparity(*(eight_bits(gray, level) for gray in grays))
        head = header(stamp_ns(left.header.stamp), frames.CAMERA_LEFT)
        if self._disparity.get_subscription_count() > 0:
            searched = stereo.least_px, stereo.largest_px
            self._disparity.publish(
                disparity_message(
                    disparity, stereo.focal_px, stereo.baseline_m, searched, DELTA_PX, head, stereo.first_column
                )
            )
        if self._points.get_subscription_count() > 0:
            colours = stereo.rectified(0, bgr_of(image_array(left), left.encoding))
            self._points.publish(organised_cloud_message(stereo.points(disparity), colours, head))
        self._note(disparity, time.perf_counter() - start)

    def _note(self, disparity: F32, took_s: float) -> None:
        self._matched, self._complaint = self._matched + 1, ""
        known = float(np.isfinite(disparity).mean())
        self._values = [("known_share", f"{known:.3f}"), ("took_ms", f"{took_s * 1e3:.1f}")]

    def _report(self) -> None:
        apart = self._pairs.apart_text()
        quiet = self._pairs.newest_ns == self._reported_ns
        silent = (apart or "no pairs of pictures in the last second") if quiet else ""
        self._reported_ns = self._pairs.newest_ns
        complaint = self._calibration.complaint or silent or self._complaint
        state = "matching" if self._listening else "idle: no subscriber"
        values = [("pairs", self._matched), ("unpaired", self._pairs.unpaired), *self._values]
        if apart:
            values += [("code", "no_pair"), ("difference_ms", f"{self._pairs.apart_ns * 1e-6:.2f}")]
        level, text = ("warn", complaint) if complaint and self._listening else ("ok", state)
        self._diagnostics.tell(level, text, values)


def main() -> int:
    """Run the dense stereo node."""
    return run(DenseStereoNode)


if __name__ == "__main__":
    raise SystemExit(main())
