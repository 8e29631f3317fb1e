"""Stylus tracker node: publishes the position of the ball at the stylus's end, or that it is uncertain in an image."""

from __future__ import annotations

import functools
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Header

from harris_perception.colour.soft_fit import warm
from harris_perception.core.image.gray import bgr_of, has_color
from harris_perception.core.stylus.stylus import StylusTracker
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from harris_perception.nodes.alignment.panel_check import PanelCheck
from harris_perception.nodes.compiling import compiling
from harris_perception.nodes.stereo_calibration import StereoCalibration
from harris_perception.pairing.free_pairs import FreePairs, ImagePair
from harris_perception.pairing.free_tips import FreeTips
from harris_perception.pairing.offset import Offset
from harris_perception.pairing.report import pairing_report, pairing_values
from harris_perception.pairing.search import Search
from icu_common.core.geometry import frames
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.nodes import qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.images import ReceivedImage, subscribe_to_images
from icu_common.nodes.messages.cameras import image_array
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.places import point_message
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every


class StylusNode(GraphNode):
    """Subscribes to ``image_raw`` and ``camera_info`` of ``left`` and ``right``; publishes ``tip`` or ``unseen``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("stylus_tracker", **options)
        self._live = LiveParameters(self, StylusSearchConfig, self._configure)
        self._calibration = StereoCalibration(self, lambda: self._configure(self._live.config))
        self._pairs = FreePairs(tolerance_ns=0)
        self._check = PanelCheck(self, self._live.config, self._correct)
        self._tracker: StylusTracker | None = None
        self._tips: FreeTips | None = None
        self._apart = False
        self._alone_ns = 0
        self._seen = self._missed = self._reported = 0
        self._received = self._reported_images = 0
        self._last = Search(tip=None, reason="no pictures yet")
        self._configure(self._live.config)
        self._tip = self.create_publisher(PointStamped, "tip", qos.RESULTS)
        self._unseen = self.create_publisher(Header, "unseen", qos.RESULTS)
        self._diagnostics = Diagnostics(self, "stylus_tracker")
        for stream, side in enumerate(("left", "right")):
            take = functools.partial(self._on_image, stream)
            subscribe_to_images(self, f"{side}/image_raw", take, qos.PICTURES)
        every(self, 1.0, self._report)

    def _configure(self, config: StylusSearchConfig) -> None:
        self._pairs.tolerance_ns = round(config.pair_tolerance_s * 1e9)
        self._pairs.free_running = config.free_running
        self._pairs.right_late_ns = 0
        stereo = self._calibration.stereo
        self._tracker = StylusTracker(config, stereo) if stereo is not None else None
        self._tips = FreeTips(self._tracker) if self._tracker is not None else None
        self._check.use(config, stereo)

    def _correct(self, cameras: StereoModel) -> None:
        if self._tracker is not None:
            self._tracker.recalibrate(cameras)
        if self._tips is not None:
            self._tips.forget()  # the same outlines now mean another position

    def _on_image(self, stream: int, message: ReceivedImage) -> None:
        self._received += stream
        pair = self._pairs.add(stream, stamp_ns(message.header.stamp), message)
        if pair is not None and pair.left_ns == self._alone_ns:
            self._alone_ns = 0
        if stream == 0:
            # A left image without a right one is reported when the next one arrives: only then is it certain.
            if self._alone_ns:
                self._unseen.publish(header(self._alone_ns, frames.CAMERA_LEFT))
            own = stamp_ns(message.header.stamp)
            self._alone_ns = own if pair is None or pair.left_ns != own else 0
        if pair is not None and self._tips is not None:
            self._look(self._tips, pair)

    def _look(self, tips: FreeTips, pair: ImagePair) -> None:
        self._apart = pair.apart
        images: tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]] | None = None
        try:
            left, right = _color(pair.left), _color(pair.right)
            self._last = tips.find(pair, left, right, self._pairs.right_late_ns)
            images = left, right
        except ValueError as error:
            self._last = Search(tip=None, reason=str(error))
        self._seen, self._missed = self._seen + (self._last.tip is not None), self._missed + (self._last.tip is None)
        head = header(stamp_ns(pair.left.header.stamp), frames.CAMERA_LEFT)
        if self._last.tip is not None:
            self._tip.publish(point_message(self._last.tip, head))
        else:
            self._unseen.publish(head)
        # After the tip is published, for which other nodes wait.
        if images is not None and self._check.due(stamp_ns(head.stamp)):
            grey = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) for image in images]
            self._check.look(grey[0], grey[1], stamp_ns(head.stamp))

    def _report(self) -> None:
        last = self._last
        looked = self._seen + self._missed
        silent = "no pairs of pictures in the last second" if looked == self._reported else ""
        self._reported = looked
        config, phase = self._live.config, self._pairs.phase()
        report = pairing_report(
            phase,
            config.pair_tolerance_s,
            paired=not silent,
            interpolated=self._apart,
            free_running=config.free_running,
        )
        apart = report.text if report is not None and self._received > self._reported_images else ""
        self._reported_images = self._received
        reason = self._calibration.complaint or apart or silent or last.reason
        values: list[tuple[str, Any]] = [("seen", self._seen), ("missed", self._missed)]
        values.append(("unpaired", self._pairs.unpaired))
        values += pairing_values(report, phase, self._tips.offset if self._tips is not None else Offset())
        if self._tips is not None:
            self._pairs.right_late_ns = self._tips.right_late_ns()
        if last.left is not None and last.right is not None:
            values.append(("row_error_px", f"{last.row_error_px:.3f}"))
            values.append(("fit_error", f"{max(last.left.error, last.right.error):.3f}"))
            values.append(("arc_deg", f"{min(last.left.arc_deg, last.right.arc_deg):.0f}"))
        values += self._check.values()
        level, text = ("warn", f"tip not seen: {reason}") if reason else ("ok", "tip seen")
        self._diagnostics.tell(level, text, values)


def _color(image: ReceivedImage) -> npt.NDArray[np.uint8]:
    picture = image_array(image)
    if not has_color(image.encoding):
        raise ValueError(f"encoding {image.encoding!r} has no color, by which the ball is found")
    return bgr_of(picture, image.encoding)


def preload() -> None:
    """Load the machine code of the fit; the server that forks programs does this once for all programs."""
    with compiling(None):
        warm()


def main() -> int:
    """Run the stylus tracker node."""
    return run(StylusNode)


if __name__ == "__main__":
    raise SystemExit(main())
