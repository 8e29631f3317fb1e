"""Reads the controls in the images that the stylus tracker has processed, and publishes their state."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from std_msgs.msg import Header

from harris_perception.core.image.gray import GreyLevels, bgr_of, has_color
from harris_perception.core.recognition.panel_reader import PanelReader
from harris_perception.core.recognition.sighting import Sighting
from harris_perception.core.stylus.tip_record import TipRecord
from harris_perception.nodes.recognition_config import RecognitionNodeConfig
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.nodes import qos
from icu_common.nodes.images import ReceivedImage
from icu_common.nodes.messages.cameras import image_array
from icu_common.nodes.messages.heads import check_frame, stamp_ns
from icu_common.nodes.messages.panels import panel_state_message
from icu_common.nodes.messages.places import point_array
from icu_common.nodes.timers import seconds_of

_KEPT_UNREAD = 8
_GIVEN_UP = 10.0
"""Maximum time that an image waits for a tracker that reports only other images, as a multiple of ``tip_wait_s``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Unread:
    """An image in which the panel was found, and whose controls have not been read yet; waiting since ``since_s``."""

    message: ReceivedImage
    sighting: Sighting
    pose: Transform
    since_s: float


class ControlReadings:
    """Subscribes to ``tip`` and ``unseen``, publishes ``state``; keeps each image until the tracker has processed it.

    Parameters
    ----------
    node
        The node that has these topics.
    reader, camera, config
        Return the reader, the left camera, which is known while images wait, and the settings.

    Attributes
    ----------
    busy_s
        Time spent on reading; the node sets it to zero when it has reported it.
    """

    def __init__(
        self,
        node: Node,
        reader: Callable[[], PanelReader],
        camera: Callable[[], CameraModel | None],
        config: Callable[[], RecognitionNodeConfig],
    ) -> None:
        self._node, self._reader, self._camera, self._config = node, reader, camera, config
        self._seconds = seconds_of(node)
        self._levels = GreyLevels()
        self._tips, self._tracker_s = TipRecord(), -math.inf
        self._unread: deque[_Unread] = deque()
        self.busy_s = 0.0
        self._state = node.create_publisher(DiagnosticArray, "state", qos.RESULTS)
        # Both topics report on single images: where the tip is, or that it is not certain.
        node.create_subscription(PointStamped, "tip", self._on_tip, qos.PICTURES)
        node.create_subscription(Header, "unseen", self._on_unseen, qos.PICTURES)

    def add(self, message: ReceivedImage, sighting: Sighting, pose: Transform) -> None:
        """Add an image in which the panel was found.

        If the tracker is far behind, fewer images are read: read without their own tips they would give wrong states.
        """
        if len(self._unread) < _KEPT_UNREAD:
            self._unread.append(_Unread(message=message, sighting=sighting, pose=pose, since_s=self._seconds()))

    def forget(self) -> None:
        """Discard the images that wait."""
        self._unread.clear()

    def read(self) -> None:
        """Read the images that the stylus tracker has processed, in order: screens are compared with earlier images.

        The node waits for a tracker that is late, but not for one that sends no messages.
        """
        while self._unread:
            first, now_s = self._unread[0], self._seconds()
            silent = now_s - self._tracker_s >= self._config().tip_wait_s
            if silent or self._tips.is_complete(stamp_ns(first.message.header.stamp)):
                self._read(self._unread.popleft())
            elif now_s - first.since_s > _GIVEN_UP * self._config().tip_wait_s:
                self._unread.popleft()  # the tracker has skipped this image
            else:
                return

    def _on_tip(self, message: PointStamped) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
        except ValueError as error:
            self._node.get_logger().error(f"tip: {error}", throttle_duration_sec=5.0)
            return
        self._take(message.header, point_array(message))

    def _on_unseen(self, message: Header) -> None:
        self._take(message, None)

    def _take(self, head: Header, tip: Array | None) -> None:
        self._tips.add(stamp_ns(head.stamp), tip)
        self._tracker_s = self._seconds()
        self.read()

    def _read(self, unread: _Unread) -> None:
        camera = self._camera()
        assert camera is not None
        start = time.perf_counter()
        message = unread.message
        stamp = stamp_ns(message.header.stamp)
        tip, age_ns = self._tips.at(stamp, 1e9 * self._config().tip_max_age_s)
        seen = self._reader().read(
            bgr_of(image_array(message), message.encoding, self._levels),
            unread.pose,
            camera,
            stamp,
            patches=unread.sighting.patches,
            tip=tip,
            wander_m=age_ns * 1e-9 * self._config().tip_speed_m_s,
            coloured=has_color(message.encoding),
        )
        self._state.publish(panel_state_message(seen, message.header))
        self.busy_s += time.perf_counter() - start
