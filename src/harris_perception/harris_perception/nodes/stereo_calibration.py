"""Calibration of a stereo pair, assembled from both cameras' ``camera_info`` topics."""

from __future__ import annotations

import functools
from collections.abc import Callable

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo

from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.nodes import qos
from icu_common.nodes.camera_info import CameraInfoSubscription
from icu_common.nodes.messages.cameras import camera_model

SIDES = ("left", "right")


class StereoCalibration:
    """Subscribes to ``left/camera_info`` and ``right/camera_info``.

    Parameters
    ----------
    node
        The node that subscribes.
    on_change
        Called after the pair's calibration has become known, changed or unusable.

    Attributes
    ----------
    stereo
        The pair's calibration; None while it is unknown.
    complaint
        Reason why it is unknown, else empty.
    """

    def __init__(self, node: Node, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._infos: dict[str, CameraInfo] = {}
        self.stereo: StereoModel | None = None
        self.complaint = "no camera_info yet"
        for side in SIDES:
            CameraInfoSubscription(node, f"{side}/camera_info", qos.PICTURES, functools.partial(self._on_info, side))

    def _on_info(self, side: str, info: CameraInfo) -> None:
        self._infos[side] = info
        if len(self._infos) < len(SIDES):
            return
        try:
            left, right = (_model(side, self._infos[side]) for side in SIDES)
            self.stereo, self.complaint = StereoModel(left=left, right=right), ""
        except ValueError as error:
            self.stereo, self.complaint = None, str(error)
        self._on_change()


def _model(side: str, info: CameraInfo) -> CameraModel:
    try:
        return camera_model(info, f"camera_{side}")
    except ValueError as error:
        raise ValueError(f"{side} camera_info: {error}") from error
