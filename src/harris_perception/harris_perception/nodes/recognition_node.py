"""Node that finds the designated panel in the left picture and publishes its pose and controls."""

from __future__ import annotations

import functools
import math
import time
from collections import OrderedDict, deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Float32, Header, String
from visualization_msgs.msg import MarkerArray

from harris_perception.core.face_depth import FaceDepth, height_above_face_m
from harris_perception.core.fiducials import MarkerFinder, SeenMarker
from harris_perception.core.gray import GreyLevels, bgr_of, eight_bits, gray_of, has_color
from harris_perception.core.harris import HarrisConfig, HarrisDetector
from harris_perception.core.panel_state import PanelReader, StateConfig
from harris_perception.core.planar_pose import FACE_POINT_COLUMNS, with_plane
from harris_perception.core.pose_agreement import PoseAgreement
from harris_perception.core.recognition import PanelRecogniser, RecognitionConfig, Sighting
from harris_perception.core.still_panel import StillPanel
from harris_perception.core.tip_record import TipRecord
from harris_perception.nodes.panel_teacher import PanelTeacher
from icu_common.core.camera_model import CameraModel
from icu_common.core.config import Config, ConfigError, nested, setting
from icu_common.core.frames import CAMERA_LEFT, PANEL
from icu_common.core.geometry import Array, Transform
from icu_common.core.panel_layout import LayoutError, PanelLayout, load_layout
from icu_common.nodes import qos
from icu_common.nodes.camera_info import CameraInfoSubscription
from icu_common.nodes.conversions import (
    camera_model,
    check_frame,
    cloud_array,
    cloud_message,
    controls_message,
    covariance_array,
    header,
    image_array,
    panel_state_message,
    point_array,
    pose_message,
    stamp_ns,
    transform_of_pose,
)
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.images import ReceivedImage
from icu_common.nodes.newest import NewestImage
from icu_common.nodes.on_demand import on_demand_setting
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every, seconds_of

_KEPT_CORNERS = 8
_KEPT_UNREAD = 8
_GIVEN_UP = 10.0
"""A picture waits no longer than so many ``tip_wait_s`` for a tracker that speaks of others only."""
_TICK_S = 0.02
_TRACKED = 15
"""Images in a row in which the panel was found, after which corners are no longer subscribed to: following it needs
none."""
_UNCHANGED = 4
"""Images in a row that may count as unchanged: at 5 Hz the panel is measured once a second at rest."""
_MIRRORED = "the panel is seen in a mirror: switch off what flips this camera's pictures"
_STEREO_AGE_NS = 3_000_000_000
"""Stereo looks at other pictures, on a busy computer a second later; a panel that stands still is as far in them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognitionNodeConfig(Config):
    """What is searched, how often, and how."""

    layout: str = setting("", "Layout file of the designated panel", read_only=True)
    template: str = setting("", "Picture of its face, straight on; empty: drawn from the layout", read_only=True)
    template_px_per_mm: float = setting(
        4.0, "Scale of that picture", minimum=0.1, maximum=100.0, unit="px/mm", read_only=True
    )
    teach_folder: str = setting(
        "", "Folder for layouts of panels that are taught by messages, empty = none", read_only=True
    )
    rate_hz: float = setting(5.0, "Pictures that are looked at", minimum=0.1, maximum=60.0, unit="Hz")
    corners_wait_s: float = setting(
        0.1, "A picture waits so long for its published corners", minimum=0.0, maximum=2.0, unit="s"
    )
    silence_s: float = setting(
        1.0, "Without pictures for so long the panel counts as lost", minimum=0.1, maximum=60.0, unit="s"
    )
    tip_wait_s: float = setting(
        1.0,
        "Lamps, knobs and screens of a picture are read once the stylus tracker has looked at it, or has said nothing "
        "for so long",
        minimum=0.0,
        maximum=60.0,
        unit="s",
    )
    tip_max_age_s: float = setting(
        0.3,
        "Where the tip is not certain in a picture, it is near where it was seen so little before or after, or else "
        "the stylus is not in view",
        minimum=0.0,
        maximum=5.0,
        unit="s",
    )
    tip_speed_m_s: float = setting(
        0.2, "The stylus is never faster: so near it may hide lamps then", minimum=0.0, maximum=2.0, unit="m/s"
    )
    plane_max_age_s: float = setting(
        0.0,
        "The pose is improved by a stereo plane of a picture so near in time; 0: by none, and stereo need not run",
        minimum=0.0,
        maximum=5.0,
        unit="s",
        read_only=True,
    )
    marker_bound_mm: float = setting(
        2.0, "The panel by its markers and by its print may differ by so much", minimum=0.1, maximum=100.0, unit="mm"
    )
    stereo_bound_mm: float = setting(
        2.0,
        "The panel by both cameras and by its print may differ so much in depth, where stereo runs; 0: not compared",
        minimum=0.0,
        maximum=100.0,
        unit="mm",
        read_only=True,
    )
    on_demand: bool = on_demand_setting(
        "Subscribe to corners only while the panel is searched, and measure it once a second while it looks the same"
    )
    recognition: RecognitionConfig = nested(RecognitionConfig)
    state: StateConfig = nested(StateConfig)
    harris: HarrisConfig = nested(HarrisConfig)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Unread:
    """A picture in which the panel was found, and whose controls are still to be read; waiting ``since_s``."""

    message: ReceivedImage
    sighting: Sighting
    pose: Transform
    since_s: float


class RecognitionNode(GraphNode):
    """Publishes pose, measured points, controls, confidence and state from pictures, corners and the stylus's tip."""

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
        self._frames = self._with_corners = self._found = self._own_corners = self._tracked = 0
        self._corners_in: Subscription | None = None
        self._busy_s, self._seen, self._refusal = 0.0, (0, 0, 0), ""
        self._sighting: Sighting | None = None
        self._levels = GreyLevels()
        self._tips, self._tracker_s = TipRecord(), -math.inf
        self._unread: deque[_Unread] = deque()
        self._plane: tuple[int, Transform, Array] | None = None
        self._improved = 0
        self._alarm, self._confirmed = "", not self._layout.markers
        self._marker_alarm = ""
        self._depth = FaceDepth(self._live.config.stereo_bound_mm)
        self._stereo_points: Subscription | None = None
        self._alarm_out = self.create_publisher(String, "alarm", qos.LATCHED)
        self._alarm_out.publish(String(data=""))
        self._pose = self.create_publisher(PoseStamped, "pose", qos.LATCHED)
        self._controls = self.create_publisher(MarkerArray, "controls", qos.LATCHED)
        self._state = self.create_publisher(DiagnosticArray, "state", qos.RESULTS)
        self._points = self.create_publisher(PointCloud2, "points", qos.RESULTS)
        self._confidence_out = self.create_publisher(Float32, "confidence", qos.RESULTS)
        self._diagnostics = Diagnostics(self)
        self._controls.publish(controls_message(self._layout, header(self.get_clock().now().nanoseconds, PANEL)))
        self._infos = CameraInfoSubscription(self, "camera_info", qos.SENSOR, self._on_camera)
        self._follow_corners()
        # Each of them says of one picture what is hidden in it.
        self.create_subscription(PointStamped, "tip", self._on_tip, qos.PICTURES)
        self.create_subscription(Header, "unseen", self._on_unseen, qos.PICTURES)
        if self._live.config.plane_max_age_s > 0:
            self.create_subscription(PoseWithCovarianceStamped, "plane", self._on_plane, qos.SENSOR)
        self._compare_depth()
        self._images = NewestImage(self, "image_raw", self._on_image)
        every(self, _TICK_S, self._on_tick)
        every(self, 1.0, self._report)
        self._teacher = PanelTeacher(self, self._live.config.teach_folder, lambda: self._camera)

    def close(self) -> None:
        """Finish what is being taught."""
        self._teacher.close()

    def _prepare(self, config: RecognitionNodeConfig) -> None:
        """Make the recogniser of a configuration, which is refused if the panel cannot be recognised with it."""
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
        # By another camera's calibration the panel would be somewhere else.
        self._still.forget()
        self._camera = self._waiting = None
        self._unread.clear()
        try:
            self._camera = camera_model(message, "left")
            self._compare_depth()
        except ValueError as error:
            self._infos.again()
            self.get_logger().error(f"camera_info: {error}", throttle_duration_sec=5.0)

    def _follow_corners(self) -> None:
        """Subscribe to corners while the panel is searched; they cost as much as all else at rest."""
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
        # A stamp before the last one is a recording that has started anew.
        early = 0 <= stamp - self._last_stamp < 0.9 * period_ns
        if self._camera is None:
            self.get_logger().warning("waiting for camera_info", throttle_duration_sec=5.0)
        elif not early and self._waiting is None:
            if stamp < self._last_stamp:
                self._unread.clear()
            self._last_stamp = stamp
            self._waiting = (message, self._seconds() + self._live.config.corners_wait_s)
            self._try_waiting()

    def _on_tip(self, message: PointStamped) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
        except ValueError as error:
            self.get_logger().error(f"tip: {error}", throttle_duration_sec=5.0)
            return
        self._take_tip(message.header, point_array(message))

    def _on_unseen(self, message: Header) -> None:
        self._take_tip(message, None)

    def _take_tip(self, head: Header, tip: Array | None) -> None:
        self._tips.add(stamp_ns(head.stamp), tip)
        self._tracker_s = self._seconds()
        self._read_unread()

    def _on_plane(self, message: PoseWithCovarianceStamped) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
            plane = transform_of_pose(message.pose.pose)
            self._plane = stamp_ns(message.header.stamp), plane, covariance_array(message)
        except ValueError as error:
            self.get_logger().error(f"plane: {error}", throttle_duration_sec=5.0)

    def _compare_depth(self) -> None:
        """Let stereo tell how far away the panel is, until that and its print have been seen to agree."""
        self._depth.start_anew()
        if self._live.config.stereo_bound_mm > 0 and self._stereo_points is None:
            self._stereo_points = self.create_subscription(PointCloud2, "stereo_points", self._on_stereo, qos.SENSOR)

    def _on_stereo(self, message: PointCloud2) -> None:
        if self._sighting is None or abs(stamp_ns(message.header.stamp) - self._last_stamp) > _STEREO_AGE_NS:
            return
        try:
            check_frame(message.header, CAMERA_LEFT)
            points = cloud_array(message, ("x", "y", "z")).astype(np.float64)
        except ValueError as error:
            self.get_logger().error(f"stereo_points: {error}", throttle_duration_sec=5.0)
            return
        self._depth.add(height_above_face_m(points, self._sighting.camera_from_panel, self._layout.size_mm))
        self._raise()

    def _with_plane(self, sighting: Sighting, stamp: int) -> Transform:
        """Return the sighting's pose, improved by the stereo plane where there is one that goes with it."""
        if self._plane is not None and abs(stamp - self._plane[0]) <= 1e9 * self._live.config.plane_max_age_s:
            better = with_plane(sighting.fit, self._plane[1], self._plane[2])
            if better is not None:
                self._improved += 1
                return better.camera_from_panel
        return sighting.camera_from_panel

    def _on_tick(self) -> None:
        self._try_waiting()
        self._read_unread()
        if self._confidence > 0 and self._seconds() - self._last_seen_s > self._live.config.silence_s:
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
            agreeing = sighting if not self._alarm else None
            stamp = stamp_ns(message.header.stamp)
            pose = self._agreement.add(None if agreeing is None else self._with_plane(agreeing, stamp))
        self._publish(sighting, pose, message)
        # Of a tracker that is far behind fewer pictures are read: without their own tips they tell what is not so.
        if sighting is not None and pose is not None and len(self._unread) < _KEPT_UNREAD:
            self._unread.append(_Unread(message=message, sighting=sighting, pose=pose, since_s=self._seconds()))
        self._frames += 1
        self._found += sighting is not None
        self._tracked = self._tracked + 1 if sighting is not None else 0
        self._follow_corners()
        self._busy_s += time.perf_counter() - start
        self._read_unread()

    def _pose_if_unchanged(self, gray: npt.NDArray[np.uint8]) -> Transform | None:
        """Return the pose that counts if it has settled and the panel looks as when it was measured last.

        Who subscribes to the measured points wants those of each image.
        """
        if not self._live.config.on_demand or self._alarm or self._points.get_subscription_count():
            return None
        settled = self._agreement.settled
        return settled if settled is not None and self._still.unchanged(gray) else None

    def _measured(self, gray: npt.NDArray[np.uint8], corners: npt.NDArray[np.float32] | None) -> Sighting | None:
        """Search or follow the panel in an image, and compare its markers with it."""
        assert self._camera is not None
        camera = self._camera
        self._still.forget()
        markers = self._markers.find(gray, camera)
        xy = functools.partial(self._detected, gray) if corners is None else corners
        self._with_corners += corners is not None
        sighting = self._recogniser.locate(gray, xy, camera, self._markers.poses(markers, camera))
        self._compare(markers, sighting)
        if sighting is not None:
            self._still.measured(gray, sighting.camera_from_panel, camera)
        return sighting

    def _detected(self, gray: npt.NDArray[np.uint8]) -> npt.NDArray[Any]:
        """Return the corners of an image that is searched and whose published ones have not come."""
        self._own_corners += 1
        return self._detector.detect(gray).xy

    def _compare(self, markers: list[SeenMarker], sighting: Sighting | None) -> None:
        """Raise the alarm when the markers contradict the print; only markers that confirm it end it.

        Until they have done so once, the print alone does not tell the panel from one with other labels.
        """
        if sighting is None:
            return
        assert self._camera is not None
        pose, bound_mm = sighting.camera_from_panel, self._live.config.marker_bound_mm
        text = self._markers.disagreement(markers, pose, self._camera, bound_mm)
        if text is None and not (self._confirmed or self._marker_alarm):
            text = "none of the panel's markers has been seen yet"
        if text is None:
            return
        self._confirmed = self._confirmed or not text
        self._marker_alarm = text
        self._raise()

    def _raise(self) -> None:
        """Publish what forbids every motion, once it has changed."""
        text = "; ".join(part for part in (self._marker_alarm, self._depth.text) if part)
        if text == self._alarm:
            return
        if text:
            self.get_logger().error(text, throttle_duration_sec=5.0)
        self._alarm = text
        self._alarm_out.publish(String(data=text))

    def _publish(self, sighting: Sighting | None, pose: Transform | None, message: ReceivedImage | None) -> None:
        self._sighting = sighting
        self._last_seen_s = self._seconds()
        self._confidence = sighting.agreement if sighting is not None and pose is not None else 0.0
        # The pose goes first: who hears a confidence above zero has the pose that it belongs to.
        if pose is not None and message is not None:
            self._pose.publish(pose_message(pose, message.header))
            if sighting is not None and self._points.get_subscription_count():
                self._points.publish(cloud_message(FACE_POINT_COLUMNS, sighting.points.rows, message.header))
        self._confidence_out.publish(Float32(data=self._confidence))

    def _read_unread(self) -> None:
        """Read what the stylus tracker has looked at, too; in order, as a screen is compared with what it was before.

        A tracker that is silent is not waited for; one that is late, but at work, is.
        """
        while self._unread:
            first, now_s = self._unread[0], self._seconds()
            silent = now_s - self._tracker_s >= self._live.config.tip_wait_s
            if silent or self._tips.is_complete(stamp_ns(first.message.header.stamp)):
                self._read(self._unread.popleft())
            elif now_s - first.since_s > _GIVEN_UP * self._live.config.tip_wait_s:
                self._unread.popleft()  # it has left out more than it tells
            else:
                return

    def _read(self, unread: _Unread) -> None:
        assert self._camera is not None
        start = time.perf_counter()
        message = unread.message
        stamp = stamp_ns(message.header.stamp)
        tip, age_ns = self._tips.at(stamp, 1e9 * self._live.config.tip_max_age_s)
        seen = self._reader.read(
            bgr_of(image_array(message), message.encoding, self._levels),
            unread.pose,
            self._camera,
            stamp,
            patches=unread.sighting.patches,
            tip=tip,
            wander_m=age_ns * 1e-9 * self._live.config.tip_speed_m_s,
            coloured=has_color(message.encoding),
        )
        self._state.publish(panel_state_message(seen, message.header))
        self._busy_s += time.perf_counter() - start

    def _report(self) -> None:
        if self._depth.text == "" and self._stereo_points is not None:
            # Matching takes time that others need; a camera that moves later is seen to by the tip.
            self.destroy_subscription(self._stereo_points)
            self._stereo_points = None
        frames, found = self._frames - self._seen[0], self._found - self._seen[1]
        own = self._own_corners - self._seen[2]
        self._seen = (self._frames, self._found, self._own_corners)
        text = "recognised" if self._confidence > 0 else "not recognised"
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
            ("ms_per_frame", f"{1e3 * self._busy_s / frames:.1f}" if frames else "-"),
            ("found_in_last_second", f"{found}/{frames}"),
        ]
        self._busy_s = 0.0
        if self._sighting is not None:
            s = self._sighting
            values += [
                ("agreement", f"{s.agreement:.3f}"),
                ("points", len(s.points.pixels)),
                ("rms_px", f"{s.rms_px:.3f}"),
            ]
        level = "ok" if self._confidence > 0 and not unaided else "warn"
        if self._alarm:
            level, text = "error", self._alarm
        self._diagnostics.tell(level, text, values)


def _designated(config: RecognitionNodeConfig) -> tuple[PanelLayout, npt.NDArray[Any] | None]:
    if not config.layout:
        raise ConfigError("layout: the path of the designated panel's layout file is needed")
    try:
        layout = load_layout(Path(config.layout))
    except (OSError, LayoutError) as error:
        raise ConfigError(f"layout: {error}") from error
    if not config.template:
        return layout, None
    picture = cv2.imread(config.template, cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise ConfigError(f"template: {config.template} is not a picture that can be read")
    return layout, picture


def main() -> int:
    """Run the recognition node."""
    return run(RecognitionNode)


if __name__ == "__main__":
    raise SystemExit(main())
