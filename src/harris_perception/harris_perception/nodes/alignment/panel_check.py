"""Compares both cameras with each other, and the panel with its layout, in some of the pairs that a node receives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.node import Node
from std_msgs.msg import Float32

from harris_perception.adapters.panel_files import read_panel
from harris_perception.core.alignment.layout_watch import LayoutWatch, text_of
from harris_perception.core.alignment.pair_watch import PairWatch
from harris_perception.core.recognition.face_measurement import FaceMeter
from harris_perception.core.recognition.recognition import RecognitionConfig, face_meter
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from icu_common.core.alignment.pair import PairCode, PairState
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.core.geometry.geometry import Transform
from icu_common.core.panel.panel_layout import PanelLayout
from icu_common.nodes import qos
from icu_common.nodes.alignment.layout_message import layout_message
from icu_common.nodes.alignment.pair_message import pair_message
from icu_common.nodes.messages.heads import check_frame, header
from icu_common.nodes.messages.places import transform_of_message, transform_of_pose

Gray = npt.NDArray[np.uint8]
_CONFIDENCE = 0.3
"""Minimum confidence of the recognition for its pose to start a measurement."""


class PanelCheck:
    """Subscribes to the panel's pose and to the hand-eye calibration; publishes ``pair`` and ``layout``.

    Parameters
    ----------
    node
        The node that receives the pairs.
    config
        Layout and limits; nothing is measured without a layout, or with a period of 0.
    on_change
        Called with the pair's calibration when its correction has changed.
    """

    def __init__(self, node: Node, config: StylusSearchConfig, on_change: Callable[[StereoModel], None]) -> None:
        self._node, self._config, self._on_change = node, config, on_change
        self._layout: PanelLayout | None = None
        self._picture: npt.NDArray[Any] | None = None
        if config.layout:
            self._layout, self._picture = read_panel(config.layout, config.template)
        self._meter: FaceMeter | None = None
        self._cameras: StereoModel | None = None
        self._pair: PairWatch | None = None
        self._controls: LayoutWatch | None = None
        self._pose: Transform | None = None
        self._confidence = 0.0
        self._calibration: Transform | None = None
        self._next_ns = 0
        self._pair_out = node.create_publisher(DiagnosticArray, "pair", qos.LATCHED)
        self._layout_out = node.create_publisher(DiagnosticArray, "layout", qos.LATCHED)
        self._pair_out.publish(pair_message(self.state, header(node.get_clock().now().nanoseconds, CAMERA_LEFT)))
        if self._layout is not None:
            node.create_subscription(PoseStamped, "panel/pose", self._on_pose, qos.LATCHED)
            node.create_subscription(Float32, "panel/confidence", self._on_confidence, qos.SENSOR)
            node.create_subscription(
                TransformStamped, "calibration/camera_from_base", self._on_calibration, qos.LATCHED
            )

    @property
    def state(self) -> PairState:
        """State of the right camera."""
        return PairState() if self._pair is None else self._pair.state

    def use(self, config: StylusSearchConfig, cameras: StereoModel | None) -> None:
        """Apply new settings or a new calibration of the cameras."""
        self._config, self._cameras = config, cameras
        self._pair = self._controls = None

    def due(self, stamp: int) -> bool:
        """Return whether the pair with this stamp is to be measured."""
        period_s = self._config.pair.period_s
        known = self._pose is not None and self._cameras is not None and self._confidence >= _CONFIDENCE
        # Stamps more than a period ahead belong to another recording.
        waiting = 0 < self._next_ns - stamp <= 1e9 * period_s
        return period_s > 0 and known and not waiting

    def look(self, left: Gray, right: Gray, stamp: int) -> None:
        """Measure a pair of raw grey images (H, W) that is due."""
        if self._pose is None or self._cameras is None or self._layout is None:
            return
        pair, controls = self._watches(self._cameras, self._layout)
        # A camera that moves is measured twice as often.
        hurry = 0.5 if pair.state.code is PairCode.CHANGING else 1.0
        self._next_ns = stamp + round(1e9 * hurry * self._config.pair.period_s)
        head = header(stamp, CAMERA_LEFT)
        if pair.unchanged(left, right, stamp):
            self._pair_out.publish(pair_message(pair.state, head))
            return
        if not pair.look(left, right, self._pose, stamp):
            return
        self._on_change(pair.cameras)
        self._pair_out.publish(pair_message(pair.state, head))
        if pair.views is not None and pair.camera_from_panel is not None and pair.state.known:
            controls.look(pair.views, pair.camera_from_panel, pair.state.rotation_rad)
            self._layout_out.publish(layout_message(controls.deviations(), head))

    def values(self) -> list[tuple[str, Any]]:
        """Return the values for the diagnostics."""
        state = self.state
        values: list[tuple[str, Any]] = [("pair", state.code.value)]
        if state.stamp_ns:
            values += [("pair_turn_deg", f"{state.turn_deg:.4f}"), ("pair_turn_px", f"{state.turn_px:.3f}")]
            values.append(("pair_sigma_px", f"{state.focal_px * float(state.sigma_rad[:2].max()):.3f}"))
        if self._controls is not None:
            values.append(("controls_off_layout", text_of(self._controls.deviations())))
        return values

    def _watches(self, cameras: StereoModel, layout: PanelLayout) -> tuple[PairWatch, LayoutWatch]:
        if self._pair is None or self._controls is None:
            if self._meter is None:
                scale = self._config.template_px_per_mm
                self._meter = face_meter(layout, RecognitionConfig(), None, self._picture, scale)
            self._pair = PairWatch(self._config.pair, self._meter, cameras)
            self._controls = LayoutWatch(self._config.controls, layout, cameras)
        return self._pair, self._controls

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            check_frame(message.header, CAMERA_LEFT)
            self._pose = transform_of_pose(message.pose)
        except ValueError as error:
            self._node.get_logger().error(f"panel/pose: {error}", throttle_duration_sec=5.0)

    def _on_confidence(self, message: Float32) -> None:
        self._confidence = float(message.data)

    def _on_calibration(self, message: TransformStamped) -> None:
        try:
            calibration = transform_of_message(message)
        except ValueError as error:
            self._node.get_logger().error(f"calibration/camera_from_base: {error}", throttle_duration_sec=5.0)
            return
        before, self._calibration = self._calibration, calibration
        # A repeated message is no new calibration. A calibration received before the first measured pair was loaded
        # from a file and is no evidence of today's state.
        if self._pair is None or (before is not None and _same(before, calibration)):
            return
        self._pair.accept()
        self._pair_out.publish(pair_message(self.state, header(self.state.stamp_ns, CAMERA_LEFT)))


def _same(a: Transform, b: Transform) -> bool:
    return bool(np.allclose(a.rotation, b.rotation) and np.allclose(a.translation, b.translation))
