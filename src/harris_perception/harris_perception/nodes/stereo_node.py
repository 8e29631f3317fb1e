"""Stereo node: points in metres from the Harris corners of both images, and the panel's plane through them."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2

from harris_perception.core.image.gray import eight_bits, gray_of
from harris_perception.core.stereo.matches import triangulated
from harris_perception.core.stereo.pairing import Pairing
from harris_perception.core.stereo.plane_fit import PlaneConfig, PlaneFit, fit_plane
from harris_perception.core.stereo.rectifier import Rectifier
from harris_perception.core.stereo.stereo_matching import StereoMatchConfig, disparity_range, match_corners, warm
from harris_perception.nodes.compiling import compiling
from harris_perception.nodes.stereo_calibration import SIDES, StereoCalibration
from icu_common.core.configuration.config import Config, nested, setting
from icu_common.core.geometry import frames
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array
from icu_common.nodes import qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.images import AnyImage, subscribe_to_images
from icu_common.nodes.messages.cameras import image_array
from icu_common.nodes.messages.clouds import cloud_array, cloud_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.places import estimate_message, pose_message
from icu_common.nodes.on_demand import OnDemand, on_demand_setting
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every

COLUMNS = ("x", "y", "z", "sigma")
_SEED = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoConfig(Config):
    """Settings of the stereo node."""

    rate_hz: float = setting(5.0, "Maximum rate of matched pairs", minimum=0.1, maximum=120.0, unit="Hz")
    pair_tolerance_s: float = setting(
        0.004, "Maximum difference between the left and right stamps of a pair", minimum=0.0, maximum=0.1, unit="s"
    )
    matching: StereoMatchConfig = nested(StereoMatchConfig)
    plane: PlaneConfig = nested(PlaneConfig)
    on_demand: bool = on_demand_setting()


class Matcher:
    """Objects that are prepared once for a calibration and a configuration."""

    def __init__(self, stereo: StereoModel, config: StereoConfig) -> None:
        self._stereo, self._config = stereo, config
        self._rectify = [Rectifier(model, stereo.left.size) for model in (stereo.left, stereo.right)]
        self._limits = disparity_range(stereo, config.matching)

    def points(self, images: tuple[AnyImage, AnyImage], corners: tuple[PointCloud2, PointCloud2]) -> Array:
        """Return (N, 4): x, y, z and the depth's standard deviation, metres, left rectified frame."""
        models = (self._stereo.left, self._stereo.right)
        grays = (eight_bits(gray_of(image_array(i), i.encoding)) for i in images)
        left, right = (rectify(gray) for rectify, gray in zip(self._rectify, grays))
        left_px, right_px = (m.rectify(cloud_array(cloud, ("u", "v"))) for m, cloud in zip(models, corners))
        matches = match_corners(left, right, left_px, right_px, self._limits, self._config.matching)
        return triangulated(self._stereo, matches)

    def plane(self, points: Array) -> PlaneFit | None:
        return fit_plane(points[:, :3], points[:, 3], self._config.plane, np.random.default_rng(_SEED))


class StereoNode(GraphNode):
    """Subscribes to ``image_raw``, ``camera_info`` and ``corners`` of both sides; publishes ``points2``,
    ``panel_plane``, and ``panel_plane_estimate``, which is the plane with its covariance.

    Images and corners are subscribed to only while one of the three has a subscriber.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("stereo", **options)
        self._live = LiveParameters(self, StereoConfig, lambda config: self._configure())
        self._calibration = StereoCalibration(self, self._configure)
        self._sets = Pairing(4, depth=6)
        self._matcher: Matcher | None = None
        with compiling(self):
            warm()
        self._configure()
        self._matched = self._reported_ns = 0
        self._values: list[tuple[str, Any]] = []
        self._complaint = ""
        self._inputs: list[Subscription] = []
        self._demand = OnDemand(self, self._listen, self._rest, always=not self._live.config.on_demand)
        self._points = self._demand.publisher(PointCloud2, "points2", qos.RESULTS)
        self._plane = self._demand.publisher(PoseStamped, "panel_plane", qos.RESULTS)
        self._estimate = self._demand.publisher(PoseWithCovarianceStamped, "panel_plane_estimate", qos.RESULTS)
        self._diagnostics = Diagnostics(self, "stereo")
        every(self, 1.0, self._report)
        self._demand.begin()

    def _listen(self) -> None:
        for i, side in enumerate(SIDES):
            take_image = functools.partial(self._on_message, i)
            take_corners = functools.partial(self._on_message, i + 2)
            self._inputs += [
                subscribe_to_images(self, f"{side}/image_raw", take_image, qos.PICTURES),
                self.create_subscription(PointCloud2, f"{side}/corners", take_corners, qos.PICTURES),
            ]

    def _rest(self) -> None:
        while self._inputs:
            self.destroy_subscription(self._inputs.pop())
        self._sets.clear()

    def _configure(self) -> None:
        config, stereo = self._live.config, self._calibration.stereo
        self._sets.tolerance_ns = round(config.pair_tolerance_s * 1e9)
        self._matcher = Matcher(stereo, config) if stereo is not None else None

    def _on_message(self, stream: int, message: Any) -> None:
        complete = self._sets.add(stream, stamp_ns(message.header.stamp), message)
        if complete is None or self._matcher is None or not self._demand.wanted:
            return
        try:
            if self._sets.due(self._live.config.rate_hz):
                self._match(self._matcher, complete)
        except ValueError as error:
            self._complaint = str(error)

    def _match(self, matcher: Matcher, complete: tuple[Any, ...]) -> None:
        start = time.perf_counter()
        points = matcher.points(complete[:2], complete[2:])
        fit = matcher.plane(points)
        head = header(stamp_ns(complete[0].header.stamp), frames.CAMERA_LEFT)
        self._points.publish(cloud_message(COLUMNS, points, head))
        if fit is not None:
            self._plane.publish(pose_message(fit.pose(), head))
            self._estimate.publish(estimate_message(fit.pose(), fit.covariance, head))
        self._note(points, fit, time.perf_counter() - start)

    def _note(self, points: Array, fit: PlaneFit | None, took_s: float) -> None:
        self._matched += 1
        self._complaint = "" if fit is not None else f"no plane through {len(points)} points"
        self._values = [("points", len(points)), ("took_ms", f"{took_s * 1e3:.1f}")]
        if fit is not None:
            self._values += [
                ("plane_share", f"{fit.share:.3f}"),
                ("plane_rms_mm", f"{fit.rms_m * 1e3:.3f}"),
                ("plane_depth_m", f"{fit.centre[2]:.4f}"),
            ]

    def _report(self) -> None:
        still = self._demand.running and self._sets.newest_ns == self._reported_ns
        apart = self._sets.apart_text()
        silent = (apart or "no pictures with corners in the last second") if still else ""
        self._reported_ns = self._sets.newest_ns
        # The last pair's fault is outdated when no more pairs arrive, or no node subscribes to the results.
        wanted = self._demand.wanted
        complaint = self._calibration.complaint or silent or (self._complaint if wanted else "")
        values = [("pairs", self._matched), ("unpaired", self._sets.unpaired), *self._values]
        if apart:
            values += [("code", "no_pair"), ("difference_ms", f"{self._sets.apart_ns * 1e-6:.2f}")]
        level, text = ("warn", complaint) if complaint else ("ok", "matching" if wanted else "idle: no subscriber")
        self._diagnostics.tell(level, text, values)


def main() -> int:
    """Run the stereo node."""
    return run(StereoNode)


if __name__ == "__main__":
    raise SystemExit(main())
