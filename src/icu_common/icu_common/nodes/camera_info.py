"""Subscription to a camera's ``camera_info`` that unpacks a message only when the calibration has changed.

A camera repeats its calibration with every image. Unpacking it costs ten times as much as comparing its bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo

from icu_common.nodes.messages.cameras import same_camera

_STAMP_AT, _STAMP_END = 4, 12
"""Bounds of the stamp in CDR: 4 bytes of encapsulation, the header's stamp (int32, uint32), then the calibration."""

_DROPPED_S = 5.0
"""Minimum interval between two log entries on messages that cannot be unpacked."""


class CameraInfoSubscription:
    """Calls back when a camera's calibration differs from the one before.

    Parameters
    ----------
    node, topic, profile
        As for ``Node.create_subscription``.
    on_change
        Called with the first message and with each that differs in more than its header.
    on_each
        Called with each message's stamp in ns, after ``on_change``.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        profile: QoSProfile,
        on_change: Callable[[CameraInfo], None],
        on_each: Callable[[int], None] | None = None,
    ) -> None:
        self._node, self._on_change, self._on_each = node, on_change, on_each
        self._bytes = b""
        self._known: CameraInfo | None = None
        self._subscription: Any = node.create_subscription(CameraInfo, topic, self._on_bytes, profile, raw=True)

    def again(self) -> None:
        """Report the next message even if it is equal: the last one could not be used, and that is reported again."""
        self._bytes, self._known = b"", None

    def end(self) -> None:
        """Cancel the subscription."""
        self._node.destroy_subscription(self._subscription)

    def _on_bytes(self, data: bytes) -> None:
        if data[_STAMP_END:] != self._bytes:
            try:
                message = deserialize_message(data, CameraInfo)
            except RuntimeError as error:  # RMWError, which rclpy does not export
                text = f"camera_info: message of {len(data)} bytes dropped: {error}"
                self._node.get_logger().error(text, throttle_duration_sec=_DROPPED_S)
                return
            self._bytes = data[_STAMP_END:]
            self._compare(message)
        if self._on_each is not None:
            seconds, nanoseconds = struct.unpack_from("<iI" if data[1] else ">iI", data, _STAMP_AT)
            self._on_each(seconds * 1_000_000_000 + nanoseconds)

    def _compare(self, message: CameraInfo) -> None:
        # Equal messages may differ in their bytes: the padding between aligned fields is undefined.
        if not same_camera(self._known, message):
            self._known = message  # before the callback, which may call again()
            self._on_change(message)
