"""Teaches a new panel by messages: an image and a request in, a layout and its template written, a result out."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import String

from harris_perception.adapters.panel_files import how_to_start, write_panel
from harris_perception.core.image.gray import bgr_of
from harris_perception.core.recognition.panel_teaching import TeachingError, TeachingRequest, parse_request, teach
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.reasons.message import Message, quoted
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_array
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.messages.results import result_message
from icu_common.nodes.timers import every

_PICTURE_WAIT_S = 5.0


class PanelTeacher:
    """Subscribes to ``teach/image_raw`` and ``teach/request``, publishes ``teach/result``; works in its own thread.

    Parameters
    ----------
    node
        The node that has these topics.
    folder
        Folder for layouts; if empty, all requests are rejected.
    camera
        Returns the left camera, whose distortion is removed from the image; None while it is unknown.
    """

    def __init__(self, node: Node, folder: str, camera: Callable[[], CameraModel | None]) -> None:
        self._node, self._folder, self._camera = node, folder, camera
        self._worker = ThreadPoolExecutor(1, "teacher")
        self._picture: tuple[int, npt.NDArray[np.uint8]] | None = None
        self._waiting: tuple[TeachingRequest, float] | None = None
        self._answers = node.create_publisher(DiagnosticArray, "teach/result", qos.RESULTS)
        node.create_subscription(Image, "teach/image_raw", self._on_picture, qos.RESULTS)
        node.create_subscription(String, "teach/request", self._on_request, qos.RESULTS)
        every(node, 0.5, self._on_tick)

    def close(self) -> None:
        """Stop the thread; a file being written is completed."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    def _on_picture(self, message: Image) -> None:
        try:
            picture = bgr_of(image_array(message), message.encoding)
        except ValueError as error:
            self._node.get_logger().error(f"teach/image_raw: {error}")
            return
        self._picture = stamp_ns(message.header.stamp), np.array(picture)
        self._try()

    def _on_request(self, message: String) -> None:
        try:
            request = parse_request(message.data)
        except TeachingError as error:
            self._answer(error.goal_id, "teach", Outcome.REJECTED, str(error))
            return
        if not self._folder:
            self._refuse(request, Message("teach.teach_folder_not_set_nowhere"))
            return
        if self._waiting is not None:
            before = self._waiting[0]
            self._refuse(before, Message("teach.another_panel_taught_before_picture", stamp_ns=before.stamp_ns))
        self._waiting = request, self._seconds() + _PICTURE_WAIT_S
        self._try()

    def _on_tick(self) -> None:
        if self._waiting is not None and self._seconds() > self._waiting[1]:
            request, self._waiting = self._waiting[0], None
            self._refuse(
                request,
                Message("teach.picture_did_not_come_within", stamp_ns=request.stamp_ns, picture_wait_s=_PICTURE_WAIT_S),
            )

    def _try(self) -> None:
        if self._waiting is None or self._picture is None or self._picture[0] != self._waiting[0].stamp_ns:
            return
        (request, _), self._waiting = self._waiting, None
        picture, self._picture = self._picture[1], None
        self._worker.submit(self._teach, request, picture, self._camera())

    def _teach(self, request: TeachingRequest, picture: npt.NDArray[np.uint8], camera: CameraModel | None) -> None:
        try:
            taught = teach(picture, request.lesson, camera)
            layout, template = write_panel(taught, Path(self._folder).expanduser(), "the operator's page")
        except (ValueError, OSError) as error:
            self._refuse(request, str(error))
            return
        except Exception as error:
            # An uncaught error would end the work silently, and the client would wait forever; OpenCV has error types
            # of its own.
            self._refuse(request, Message("teach.error_while_teaching", error=quoted(error)))
            return
        details = {"layout": str(layout), "template": str(template), "start": how_to_start(taught, template)}
        text = Message("teach.wrote", layout=layout, template=template)
        self._answer(request.goal_id, request.lesson.model, Outcome.REACHED, text, details)

    def _refuse(self, request: TeachingRequest, why: str) -> None:
        self._answer(request.goal_id, request.lesson.model, Outcome.REJECTED, why)

    def _answer(
        self, goal_id: str, model: str, outcome: Outcome, reason: str, details: dict[str, Any] | None = None
    ) -> None:
        result = GoalResult(
            goal_id=goal_id, goal=model, outcome=outcome, reason=reason, details=tuple((details or {}).items())
        )
        self._node.get_logger().info(f"teaching {model}: {outcome.value}: {reason}")
        self._answers.publish(result_message(result, int(self._node.get_clock().now().nanoseconds)))

    def _seconds(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) / 1e9
