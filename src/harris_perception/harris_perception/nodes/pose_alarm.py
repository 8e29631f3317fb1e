"""The alarm that forbids every motion: markers or stereo contradict the pose of the panel by its print."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String

from harris_perception.core.pose.face_depth import FaceDepth, height_above_face_m
from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.core.geometry.geometry import Transform
from icu_common.core.panel.panel_layout import PanelLayout
from icu_common.core.reasons.message import Message, joined
from icu_common.nodes import qos
from icu_common.nodes.messages.clouds import cloud_array
from icu_common.nodes.messages.heads import check_frame, stamp_ns

_STEREO_AGE_NS = 3_000_000_000
"""Maximum difference of stamps between stereo and recognition, which use different images; on a busy computer stereo is
a second late. The distance of a panel at rest is the same in both."""


class PoseAlarm:
    """Publishes ``alarm``; subscribes to ``stereo_points`` until stereo has been found to agree with the print.

    Parameters
    ----------
    node
        The node that has these topics.
    layout
        The designated panel.
    stereo_bound_mm
        Maximum difference in depth; 0: not compared.
    seen
        Returns the panel's pose in the last image with its stamp; None while the panel is not seen.

    Attributes
    ----------
    text
        Why no motion is allowed; empty if it is.
    """

    def __init__(
        self,
        node: Node,
        layout: PanelLayout,
        stereo_bound_mm: float,
        seen: Callable[[], tuple[Transform, int] | None],
    ) -> None:
        self._node, self._layout, self._stereo_bound_mm, self._seen = node, layout, stereo_bound_mm, seen
        self.text, self._confirmed = "", not layout.markers
        self._marker_text = ""
        self._depth = FaceDepth(stereo_bound_mm)
        self._stereo_points: Subscription | None = None
        self._alarm = node.create_publisher(String, "alarm", qos.LATCHED)
        self._alarm.publish(String(data=""))
        self.compare_depth()

    def compare_depth(self) -> None:
        """Measure the panel's distance by stereo until it has been found to agree with the print."""
        self._depth.start_anew()
        if self._stereo_bound_mm > 0 and self._stereo_points is None:
            self._stereo_points = self._node.create_subscription(
                PointCloud2, "stereo_points", self._on_stereo, qos.SENSOR
            )

    def end_agreed(self) -> None:
        """Unsubscribe from stereo if it agrees with the print."""
        if self._depth.text == "" and self._stereo_points is not None:
            # Matching takes time that other nodes need; a camera that moves later shows in the tip.
            self._node.destroy_subscription(self._stereo_points)
            self._stereo_points = None

    def compare_markers(self, text: str | None) -> None:
        """Take how the markers contradict the print: empty if they confirm it, None if none is seen.

        Only markers that confirm the print clear the alarm. Before the first confirmation the print alone cannot
        distinguish the panel from one with other labels.
        """
        if text is None and not (self._confirmed or self._marker_text):
            text = Message("panel.none_panel_markers_seen_yet")
        if text is None:
            return
        self._confirmed = self._confirmed or not text
        self._marker_text = text
        self._raise()

    def _on_stereo(self, message: PointCloud2) -> None:
        seen = self._seen()
        if seen is None or abs(stamp_ns(message.header.stamp) - seen[1]) > _STEREO_AGE_NS:
            return
        try:
            check_frame(message.header, CAMERA_LEFT)
            points = cloud_array(message, ("x", "y", "z")).astype(np.float64)
        except ValueError as error:
            self._node.get_logger().error(f"stereo_points: {error}", throttle_duration_sec=5.0)
            return
        self._depth.add(height_above_face_m(points, seen[0], self._layout.size_mm))
        self._raise()

    def _raise(self) -> None:
        """Publish the reason that forbids every motion, if it has changed."""
        text = joined(part for part in (self._marker_text, self._depth.text) if part)
        if text == self.text:
            return
        if text:
            self._node.get_logger().error(text, throttle_duration_sec=5.0)
        self.text = text
        self._alarm.publish(String(data=text))
