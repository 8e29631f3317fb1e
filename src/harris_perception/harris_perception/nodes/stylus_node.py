"""Stylus tracker node: publishes where the ball at the stylus's end is, or that this is not certain in a picture."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Header

from harris_perception.core.gray import bgr_of, has_color
from harris_perception.core.pairing import Pairing
from harris_perception.core.stylus import Search, StylusConfig, StylusTracker
from harris_perception.nodes.stereo_calibration import StereoCalibration
from icu_common.core import frames
from icu_common.nodes import qos
from icu_common.nodes.conversions import header, image_array, point_message, stamp_ns
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.images import ReceivedImage, subscribe_to_images
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every


class StylusNode(GraphNode):
    """Subscribes to ``image_raw`` and ``camera_info`` of ``left`` and ``right``; publishes ``tip`` or ``unseen``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("stylus_tracker", **options)
        self._live = LiveParameters(self, StylusConfig, self._configure)
        self._calibration = StereoCalibration(self, lambda: self._configure(self._live.config))
        self._pairs = Pairing(2)
        self._tracker: StylusTracker | None = None
        self._alone: Header | None = None
        self._seen = self._missed = self._reported = 0
        self._last = Search(tip=None, reason="no pictures yet")
        self._configure(self._live.config)
        self._tip = self.create_publisher(PointStamped, "tip", qos.RESULTS)
        self._unseen = self.create_publisher(Header, "unseen", qos.RESULTS)
        self._diagnostics = Diagnostics(self, "stylus_tracker")
        for stream, side in enumerate(("left", "right")):
            take = functools.partial(self._on_image, stream)
            subscribe_to_images(self, f"{side}/image_raw", take, qos.PICTURES)
        every(self, 1.0, self._report)

    def _configure(self, config: StylusConfig) -> None:
        self._pairs.tolerance_ns = round(config.pair_tolerance_s * 1e9)
        stereo = self._calibration.stereo
        self._tracker = StylusTracker(config, stereo) if stereo is not None else None

    def _on_image(self, stream: int, message: ReceivedImage) -> None:
        pair = self._pairs.add(stream, stamp_ns(message.header.stamp), message)
        if stream == 0 and pair is None:
            # One without a right picture is answered when the next one comes: nobody knows earlier.
            if self._alone is not None:
                self._unseen.publish(self._alone)
            self._alone = header(stamp_ns(message.header.stamp), frames.CAMERA_LEFT)
        elif pair is not None:
            self._alone = None
        if pair is None or self._tracker is None:
            return
        try:
            self._last = self._tracker.find(_color(pair[0]), _color(pair[1]))
        except ValueError as error:
            self._last = Search(tip=None, reason=str(error))
        self._seen, self._missed = self._seen + (self._last.tip is not None), self._missed + (self._last.tip is None)
        head = header(stamp_ns(pair[0].header.stamp), frames.CAMERA_LEFT)
        if self._last.tip is not None:
            self._tip.publish(point_message(self._last.tip, head))
        else:
            self._unseen.publish(head)

    def _report(self) -> None:
        last = self._last
        looked = self._seen + self._missed
        silent = "no pairs of pictures in the last second" if looked == self._reported else ""
        self._reported = looked
        reason = self._calibration.complaint or silent or last.reason
        values: list[tuple[str, Any]] = [("seen", self._seen), ("missed", self._missed)]
        values.append(("unpaired", self._pairs.unpaired))
        if last.left is not None and last.right is not None:
            values.append(("row_error_px", f"{last.row_error_px:.3f}"))
            values.append(("fit_error", f"{max(last.left.error, last.right.error):.3f}"))
            values.append(("arc_deg", f"{min(last.left.arc_deg, last.right.arc_deg):.0f}"))
        level, text = ("warn", f"tip not seen: {reason}") if reason else ("ok", "tip seen")
        self._diagnostics.tell(level, text, values)


def _color(image: ReceivedImage) -> npt.NDArray[np.uint8]:
    picture = image_array(image)
    if not has_color(image.encoding):
        raise ValueError(f"encoding {image.encoding!r} has no color, by which the ball is found")
    return bgr_of(picture, image.encoding)


def main() -> int:
    """Run the stylus tracker node."""
    return run(StylusNode)


if __name__ == "__main__":
    raise SystemExit(main())
