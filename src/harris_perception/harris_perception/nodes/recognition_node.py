"""Node that finds the designated panel in the left image and publishes its pose and controls."""

from __future__ import annotations

import functools
import time
from collections import OrderedDict
from typing import Any

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Float32
from visualization_msgs.msg import MarkerArray

from harris_perception.adapters.panel_files import read_panel
from harris_perception.core.corners.harris import HarrisDetector
from harris_perception.core.image.gray import eight_bits, gray_of
from harris_perception.core.pose.fiducials import MarkerFinder
from harris_perception.core.pose.planar_pose import FACE_POINT_COLUMNS, with_plane
from harris_perception.core.pose.pose_agreement import PoseAgreement
from harris_perception.core.recognition.panel_reader import PanelReader
from harris_perception.core.recognition.recognition import PanelRecogniser
from harris_perception.core.recognition.sighting import Sighting
from harris_perception.core.recognition.still_panel import StillPanel
from harris_perception.nodes.control_readings import ControlReadings
from harris_perception.nodes.panel_teacher import PanelTeacher
from harris_perception.nodes.pose_alarm import PoseAlarm
from harris_perception.nodes.recognition_config import RecognitionNodeConfig
from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.frames import CAMERA_LEFT, PANEL
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import PanelLayout
from icu_common.nodes import qos
from icu_common.nodes.camera_info import CameraInfoSubscription
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.images import ReceivedImage
from icu_common.nodes.messages.cameras import camera_model, image_array
from icu_common.nodes.messages.clouds import cloud_array, cloud_message
from icu_common.nodes.messages.heads import check_frame, header, stamp_ns
from icu_common.nodes.messages.panels import controls_message
from icu_common.nodes.messages.places import covariance_array, pose_message, transform_of_pose
from icu_common.nodes.newest import NewestImage
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every, seconds_of

_KEPT_CORNERS = 8
_TICK_S = 0.02
_HELD_UP_S, _LONGEST_EXCUSE_S = 0.2, 5.0
"""Interval of ticks above which this process counts as blocked, so that images may still wait for it. It is
also the longest time for which this delays the loss of the panel."""
_TRACKED = 15
"""Number of successive images with the panel after which the node unsubscribes from corners: tracking needs none."""
_UNCHANGED = 4
"""Maximum number of successive images that count as unchanged: at 5 Hz the panel is measured once a second at rest."""
_MIRRORED = "the panel is seen in a mirror: switch off what flips this camera's pictures"


class RecognitionNode(GraphNode):
    """Publishes pose, measured points, controls, confidence and state from images, corners and the stylus's tip."""

    def __init__(self, **options: Any) -> None:
        super().__init__("recognition", **options)
        self._seconds = seconds_of(self)
        self._live = LiveParameters(self, RecognitionNodeConfig, self._use, self._prepare)
        self._layout, self._picture = _designated(self._live.config)
        self._prepare(self._live.config)
        self._use(self._live.config)
        self._camera: CameraModel | None = None
        self._corners: OrderedDict[int, npt.NDArray[np.float32]] = OrderedDict()
        self._waiting: tuple[Image, float] | None = None
        self._last_stamp, self._last_seen_s, self._confidence = 0, 0.0, 0.0
        self._ticked_s = self._in_time_since_s = 0.0
        self._frames = self._with_corners = self._found = self._own_corners = self._tracked = 0
        self._corners_in: Subscription | None = None
        self._busy_s, self._seen, self._refusal = 0.0, (0, 0, 0), ""
        self._sighting: Sighting | None = None
        self._plane: tuple[int, Transform, Array] | None = None
        self._improved = 0
        self._alarm = PoseAlarm(self, self._layout, self._live.config.stereo_bound_mm, self._last_seen)
        self._pose = self.create_publisher(PoseStamped, "pose", qos.LATCHED)
        self._controls = self.create_publisher(MarkerArray, "controls", qos.LATCHED)
        self._points = self.create_publisher(PointCloud2, "points", qos.RESULTS)
        self._confidence_out = self.create_publisher(Float32, "confidence", qos.RESULTS)
        self._diagnostics = Diagnostics(self)
        self._controls.publish(controls_message(self._layout, header(self.get_clock().now().nanoseconds, PANEL)))
        self._infos = CameraInfoSubscription(self, "camera_info", qos.SENSOR, self._on_camera)
        self._follow_corners()
        self._readings = ControlReadings(self, lambda: self._reader, lambda: self._camera, lambda: self._live.config)
        if self._live.config.plane_max_age_s > 0:
            self.create_subscription(PoseWithCovarianceStamped, "plane", self._on_plane, qos.SENSOR)
        self._images = NewestImage(self, "image_raw", self._on_image)
        every(self, _TICK_S, self._on_tick)
        every(self, 1.0, self._report)
        self._teacher = PanelTeacher(self, self._live.config.teach_folder, lambda: self._camera)

    def close(self) -> None:
        """Complete the panel that is being taught."""
        self._teacher.close()

    def _prepare(self, config: RecognitionNodeConfig) -> None:
        """Create the recogniser of a configuration; reject a configuration that cannot recognise the panel."""
        scale = config.template_px_per_mm
        try:
            self._next = PanelRecogniser(self._layout, config.recognition, config.harris, self._picture, scale)
        except ValueError as error:
            raise ConfigError(str(error)) from error

    def _use(self, config: RecognitionNodeConfig) -> None:
        self._recogniser = self._next
        self._agreement = PoseAgreement(config.recognition.agreement, self._layout.size_mm)
        self._reader = PanelReader(self._layout, config.state)
        self._detector = HarrisDetector(config.harris)
        self._markers = MarkerFinder(self._layout)
        self._still = StillPanel(self._layout, _UNCHANGED)

    def _on_camera(self, message: CameraInfo) -> None:
        # With another camera's calibration the panel would have another pose.
        self._still.forget()
        self._camera = self._waiting = None
        self._readings.forget()
        try:
            self._camera = camera_model(message, "left")
            self._alarm.compare_depth()
        except ValueError as error:
            self._infos.again()
            self.get_logger().error(f"camera_info: {error}", throttle_duration_sec=5.0)

    def _follow_corners(self) -> None:
        """Subscribe to corners while the panel is searched; they cost as much as everything else at rest."""
        tracked = self._live.config.on_demand and self._tracked >= _TRACKED
        if tracked and self._corners_in is not None:
            self.destroy_subscription(self._corners_in)
            self._corners_in = None
            self._corners.clear()
        elif not tracked and self._corners_in is None:
            self._corners_in = self.create_subscription(PointCloud2, "corners", self._on_corners, qos.SENSOR)

    def _on_corners(self, message: PointCloud2) -> None:
        try:
            self._corners[stamp_ns(message.header.stamp)] = cloud_array(message, ("u", "v"))
        except ValueError as error:
            self.get_logger().error(f"corners: {error}", throttle_duration_sec=5.0)
        while len(self._corners) > _KEPT_CORNERS:
            self._corners.popitem(last=False)
        self._try_waiting()

    def _on_image(self, message: ReceivedImage) -> None:
        stamp, period_ns = stamp_ns(message.header.stamp), 1e9 / self._live.config.rate_hz
        # A stamp before the last one comes from a recording that has restarted.
        early = 0 <= stamp - self._last_stamp < 0.9 * period_ns
        if self._camera is None:
            self.get_logger().warning("waiting for camera_info", throttle_duration_sec=5.0)
        elif not early and self._waiting is None:
            if stamp < self._last_stamp:
                self._readings.forget()
            self._last_stamp = stamp
            self._waiting = (message, self._seconds() + self._live.config.corners_wait_s)
            self._try_waiting()

    def _on_plane(self, message: PoseWithCovarianceStamped) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
            plane = transform_of_pose(message.pose.pose)
            self._plane = stamp_ns(message.header.stamp), plane, covariance_array(message)
        except ValueError as error:
            self.get_logger().error(f"plane: {error}", throttle_duration_sec=5.0)

    def _last_seen(self) -> tuple[Transform, int] | None:
        return None if self._sighting is None else (self._sighting.camera_from_panel, self._last_stamp)

    def _with_plane(self, sighting: Sighting, stamp: int) -> Transform:
        """Return the sighting's pose, improved by the stereo plane if there is one near enough in time."""
        if self._plane is not None and abs(stamp - self._plane[0]) <= 1e9 * self._live.config.plane_max_age_s:
            better = with_plane(sighting.fit, self._plane[1], self._plane[2])
            if better is not None:
                self._improved += 1
                return better.camera_from_panel
        return sighting.camera_from_panel

    def _on_tick(self) -> None:
        now_s = self._seconds()
        if now_s - self._ticked_s > _HELD_UP_S:
            self._in_time_since_s = now_s
        self._ticked_s = now_s
        self._try_waiting()
        self._readings.read()
        since_s = max(self._last_seen_s, min(self._in_time_since_s, self._last_seen_s + _LONGEST_EXCUSE_S))
        if self._confidence > 0 and now_s - since_s > self._live.config.silence_s:
            self.get_logger().warning("no pictures: the panel counts as lost")
            self._recogniser.forget()
            self._still.forget()
            self._publish(None, self._agreement.add(None), None)

    def _try_waiting(self) -> None:
        if self._waiting is None:
            return
        message, deadline_s = self._waiting
        corners = self._corners.get(stamp_ns(message.header.stamp))
        if corners is not None or self._corners_in is None or self._seconds() >= deadline_s:
            self._waiting = None
            self._look(message, corners)

    def _look(self, message: ReceivedImage, corners: npt.NDArray[np.float32] | None) -> None:
        assert self._camera is not None
        start = time.perf_counter()
        sighting, known, refusal = None, None, ""
        try:
            gray = eight_bits(gray_of(image_array(message), message.encoding))
            known = self._pose_if_unchanged(gray)
            sighting = self._sighting if known is not None else self._measured(gray, corners)
        except ValueError as error:
            refusal = f"picture refused: {error}"
            self.get_logger().error(refusal, throttle_duration_sec=5.0)
        self._refusal = refusal
        if self._recogniser.mirrored:
            self.get_logger().error(_MIRRORED, throttle_duration_sec=30.0)
        pose = known
        if known is None:
            agreeing = sighting if not self._alarm.text else None
            stamp = stamp_ns(message.header.stamp)
            pose = self._agreement.add(None if agreeing is None else self._with_plane(agreeing, stamp))
        self._publish(sighting, pose, message)
        if sighting is not None and pose is not None:
            self._readings.add(message, sighting, pose)
        self._frames += 1
        self._found += sighting is not None
        self._tracked = self._tracked + 1 if sighting is not None else 0
        self._follow_corners()
        self._busy_s += time.perf_counter() - start
        self._readings.read()

    def _pose_if_unchanged(self, gray: npt.NDArray[np.uint8]) -> Transform | None:
        """Return the accepted pose if it has settled and the panel looks the same as when it was last measured.

        With subscribers to the measured points, each image is measured.
        """
        if not self._live.config.on_demand or self._alarm.text or self._points.get_subscription_count():
            return None
        settled = self._agreement.settled
        return settled if settled is not None and self._still.unchanged(gray) else None

    def _measured(self, gray: npt.NDArray[np.uint8], corners: npt.NDArray[np.float32] | None) -> Sighting | None:
        """Search or track the panel in an image, and compare its markers with the result."""
        assert self._camera is not None
        camera = self._camera
        self._still.forget()
        markers = self._markers.find(gray, camera)
        xy = functools.partial(self._detected, gray) if corners is None else corners
        self._with_corners += corners is not None
        sighting = self._recogniser.locate(gray, xy, camera, self._markers.poses(markers, camera))
        if sighting is not None:
            bound_mm = self._live.config.marker_bound_mm
            self._alarm.compare_markers(
                self._markers.disagreement(markers, sighting.camera_from_panel, camera, bound_mm)
            )
            self._still.measured(gray, sighting.camera_from_panel, camera)
        return sighting

    def _detected(self, gray: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
        """Detect the corners of an image that is searched and whose published corners have not arrived."""
        self._own_corners += 1
        return self._detector.detect(gray).xy

    def _publish(self, sighting: Sighting | None, pose: Transform | None, message: ReceivedImage | None) -> None:
        self._sighting = sighting
        self._last_seen_s = self._seconds()
        self._confidence = sighting.agreement if sighting is not None and pose is not None else 0.0
        # The pose goes first: a node that receives a confidence above zero then has the matching pose.
        if pose is not None and message is not None:
            self._pose.publish(pose_message(pose, message.header))
            if sighting is not None and self._points.get_subscription_count():
                self._points.publish(cloud_message(FACE_POINT_COLUMNS, sighting.points.rows, message.header))
        self._confidence_out.publish(Float32(data=self._confidence))

    def _report(self) -> None:
        self._alarm.end_agreed()
        frames, found = self._frames - self._seen[0], self._found - self._seen[1]
        own = self._own_corners - self._seen[2]
        self._seen = (self._frames, self._found, self._own_corners)
        text = "recognised" if self._confidence > 0 else "not recognised"
        busy_s = self._busy_s + self._readings.busy_s
        unaided = frames > 0 and own == frames
        if self._refusal:
            text += f": {self._refusal}"
        elif self._recogniser.mirrored:
            text += f": {_MIRRORED}"
        if unaided:
            text += ", no published corners: they are detected here"
        values: list[tuple[str, Any]] = [
            ("panel", self._layout.model),
            ("frames", self._frames),
            ("frames_with_published_corners", self._with_corners),
            ("poses_improved_by_stereo", self._improved),
            ("ms_per_frame", f"{1e3 * busy_s / frames:.1f}" if frames else "-"),
            ("found_in_last_second", f"{found}/{frames}"),
        ]
        self._busy_s = self._readings.busy_s = 0.0
        if self._sighting is not None:
            s = self._sighting
            values += [
                ("agreement", f"{s.agreement:.3f}"),
                ("points", len(s.points.pixels)),
                ("rms_px", f"{s.rms_px:.3f}"),
            ]
        level = "ok" if self._confidence > 0 and not unaided else "warn"
        if self._alarm.text:
            level, text = "error", self._alarm.text
        self._diagnostics.tell(level, text, values)


def _designated(config: RecognitionNodeConfig) -> tuple[PanelLayout, npt.NDArray[Any] | None]:
    if not config.layout:
        raise ConfigError("layout: the path of the designated panel's layout file is needed")
    return read_panel(config.layout, config.template)


def main() -> int:
    """Run the recognition node."""
    return run(RecognitionNode)


if __name__ == "__main__":
    raise SystemExit(main())
