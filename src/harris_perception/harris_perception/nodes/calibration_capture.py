"""Node that keeps useful images of a calibration board from live topics and reports how to hold the board next."""

from __future__ import annotations

import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import Image
from std_msgs.msg import String

from harris_perception.adapters.picture_files import write_picture
from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.board_detection import BoardDetector
from harris_perception.core.cameras.view_collection import ViewCollection
from harris_perception.core.image.gray import eight_bits, gray_of
from icu_common.adapters.processes.program_end import end_signals
from icu_common.core.reasons.message import Message
from icu_common.nodes import qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.cameras import image_array
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.runtime import ros_session
from icu_common.nodes.timers import every

_MAX_APART_NS = 2_000_000
_MANY = 10
"""Number of images without a partner that is no accident."""


class CalibrationCaptureNode(GraphNode):
    """Subscribes to one image topic per camera and writes the images it keeps as PNG.

    Progress and missing views go to ``calibration/camera_coverage`` as one line, and to ``/diagnostics`` with one value
    per direction.

    Parameters
    ----------
    topics
        One, or left and right; images within 2 ms of each other form one view.
    folders
        Folder for each topic's images, which are named by number.
    collection
        Decides which views to keep, and holds them.
    say
        Receives a line whenever the progress changes.
    """

    def __init__(
        self,
        topics: Sequence[str],
        folders: Sequence[Path],
        collection: ViewCollection,
        say: Callable[[str], None],
        **options: Any,
    ) -> None:
        super().__init__("calibration_capture", **options)
        self.collection = collection
        self._say, self._said = say, ""
        self._hint: str = Message("views.no_pictures_yet")
        self._detector = BoardDetector(collection.board, quick=True)
        self._folders = [Path(folder) for folder in folders]
        self._newest: list[tuple[int, npt.NDArray[np.uint8]] | None] = [None] * len(topics)
        self._apart_ns: deque[int] = deque(maxlen=30)
        self._coverage = self.create_publisher(String, "calibration/camera_coverage", qos.LATCHED)
        self._diagnostics = Diagnostics(self)
        every(self, 1.0, self._report)
        for side, topic in enumerate(topics):
            self.create_subscription(Image, topic, lambda m, side=side: self._on_image(side, m), qos.NEWEST)

    def _on_image(self, side: int, message: Image) -> None:
        try:
            gray = np.array(eight_bits(gray_of(image_array(message), message.encoding)))
        except ValueError as error:
            self._hint = Message("views.picture_refused", error=error)
            return
        self._newest[side] = stamp_ns(message.header.stamp), gray
        moment = [item for item in self._newest if item is not None]
        stamps = [stamp for stamp, _ in moment]
        if len(moment) < len(self._newest):
            return
        self._apart_ns.append(max(stamps) - min(stamps))
        if self._apart_ns[-1] <= _MAX_APART_NS:
            self._newest = [None] * len(self._newest)
            self._apart_ns.clear()
            self._look([gray for _, gray in moment])
        elif len(self._apart_ns) >= _MANY:
            best, most = min(self._apart_ns) / 1e6, _MAX_APART_NS / 1e6
            self._hint = Message("views.both_cameras_pictures_apart_most", best_ms=best, most=most)

    def _look(self, pictures: Sequence[npt.NDArray[np.uint8]]) -> None:
        number = len(self.collection.kept)
        self._hint = self.collection.offer([self._detector.detect(gray, f"view{number:03d}") for gray in pictures])
        if not self._hint:
            for folder, gray in zip(self._folders, pictures):
                write_picture(folder / f"view{number:03d}.png", gray)
        self._tell()

    def _tell(self) -> None:
        line = self.collection.progress + (f" [{self._hint}]" if self._hint else "")
        if line != self._said:
            self._said = line
            self._say(line)
            self._coverage.publish(String(data=line))

    def _report(self) -> None:
        self._tell()
        level = "ok" if self.collection.complete else "warn"
        values: list[tuple[str, Any]] = [("progress", self._said)]
        values += [("views", len(self.collection.kept)), ("wanted", self.collection.wanted)]
        for reach in self.collection.reaches:
            values.append((reach.name, f"{reach.low:.2f} to {reach.high:.2f}"))
            values.append((f"{reach.name}_missing", reach.missing))
        self._diagnostics.tell(level, self._said, values)


def capture(
    board: CalibrationBoard,
    topics: Sequence[str],
    folders: Sequence[Path],
    *,
    wanted: int,
    within_s: float,
    say: Callable[[str], None],
) -> ViewCollection:
    """Collect views from topics until there are enough, a signal arrives or the time is over; return the collection."""
    collection = ViewCollection(board, wanted)
    before = {number: signal.getsignal(number) for number in end_signals()}
    try:
        with ros_session([]) as session:
            node = CalibrationCaptureNode(topics, folders, collection, say)
            session.executor.add_node(node)
            deadline = time.monotonic() + within_s
            try:
                while session.goes_on and not collection.complete and time.monotonic() < deadline:
                    session.spin()
            finally:
                session.end(node)
    finally:
        for number, handler in before.items():  # the calibration has no loop that could check a flag
            signal.signal(number, handler)
    return collection
