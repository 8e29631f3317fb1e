"""Camera node: publishes the images of a source with their stamps, and the cameras' calibration.

The capture thread itself publishes the images: rcl_publish is thread-safe for distinct messages, and a detour through
the executor only adds a wake-up; see docs/decisions/transport.md.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path
from threading import Event
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from harris_perception.adapters.camera_controls import ControlFinding
from harris_perception.adapters.camera_sources import (
    CameraNodeConfig,
    CameraSource,
    Frames,
    Picture,
    V4l2Source,
    open_source,
    require_settings,
)
from harris_perception.adapters.capture import Capture
from icu_common.adapters.frame_link import FRAMES
from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry import frames as frame_names
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.nodes import qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode, this_process
from icu_common.nodes.images import image_bytes
from icu_common.nodes.messages.cameras import camera_info_message
from icu_common.nodes.messages.heads import header
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every, seconds_of


class Eye:
    """Publishers and calibration of one camera."""

    def __init__(self, node: Node, side: str, frame: str, calibration: str) -> None:
        self._frame = frame
        self._side, self._model = side, _load(side, calibration)
        self.complaint = ""
        self._images = node.create_publisher(Image, f"{side}/image_raw", qos.IMAGES)
        self._infos = node.create_publisher(CameraInfo, f"{side}/camera_info", qos.IMAGES)

    def publish(self, picture: Picture, stamp_ns: int) -> None:
        head = header(stamp_ns, self._frame)
        self._infos.publish(self._info(picture, head))
        # Packing and sending an image without subscribers costs as much as with one.
        if self._images.get_subscription_count():
            self._images.publish(image_bytes(picture, "bgr8" if picture.ndim == 3 else "mono8", head))

    def _info(self, picture: Picture, head: Any) -> CameraInfo:
        height, width = picture.shape[:2]
        model = self._model
        if model is not None and model.size == (width, height):
            self.complaint = ""
            return camera_info_message(model, head)
        self.complaint = f"{self._side} camera: no calibration"
        if model is not None:
            self.complaint += f" for {width} x {height}, it is for {model.width} x {model.height}"
        return CameraInfo(header=head, width=width, height=height)  # K = 0 means "uncalibrated" (CameraInfo.msg)


def _load(side: str, calibration: str) -> CameraModel | None:
    if not calibration:
        return None
    file, which = Path(calibration).expanduser(), f"the {side} camera's {side}_calibration"
    try:
        return CameraModel.load(file)
    except FileNotFoundError as error:
        raise ConfigError(
            f"{which}: {file}: {error.strerror}; camera_calibration makes it (docs/how-to/calibration.md), "
            "and without one an empty text is needed"
        ) from error
    except OSError as error:
        raise ConfigError(f"{which}: {file}: {error.strerror}") from error
    except ValueError as error:
        raise ConfigError(f"{which}: {error}") from error


def _waits(config: CameraNodeConfig) -> dict[str, float]:
    names = ("read_timeout_s", "retry_min_s", "retry_max_s")
    return {name: getattr(config, name) for name in names}


class CameraNode(GraphNode):
    """Publishes ``left/image_raw``, ``left/camera_info`` and the same for ``right``."""

    def __init__(self, **options: Any) -> None:
        super().__init__("camera", **options)
        config = LiveParameters(self, CameraNodeConfig, self._on_config).config
        require_settings(config)
        self._source = config.source
        self._quiet_after_s = max(1.0, 2.0 / config.rate_hz if config.rate_hz else 0.0)
        self._eyes = [
            Eye(self, "left", frame_names.CAMERA_LEFT, config.left_calibration),
            Eye(self, "right", frame_names.CAMERA_RIGHT, config.right_calibration),
        ]
        self._ages_ms: deque[float] = deque(maxlen=100)
        self._seen, self._quiet_s = 0, 0.0
        clock = self.get_clock()
        self._now_ns = lambda: int(clock.now().nanoseconds)
        self._ledger = this_process.ledger if config.source == "bench" else None
        if self._ledger is not None:
            self._ledger.subscribe(FRAMES)
        self._config = config
        self._findings: tuple[ControlFinding, ...] = ()
        self._capture = Capture(
            self._open,
            self._on_frames,
            on_failure=self._on_failure,
            clock=seconds_of(self),
            **_waits(config),
        )
        self._diagnostics = Diagnostics(self, "camera")
        self._period_s = 1.0
        every(self, self._period_s, self._report)
        self._capture.start()

    def _open(self, stop: Event) -> CameraSource:
        source = open_source(self._config, now_ns=self._now_ns, stop=stop)
        findings = source.findings if isinstance(source, V4l2Source) else ()
        if findings != self._findings:
            self._findings = findings
            for finding in findings:
                self.get_logger().warning(finding.text)
        return source

    def _on_config(self, config: CameraNodeConfig) -> None:
        self._capture.set_waits(**_waits(config))

    def _on_failure(self, text: str) -> None:
        self.get_logger().error(text, throttle_duration_sec=5.0)
        if self._ledger is not None:
            self._ledger.finish_all(FRAMES)

    def _on_frames(self, frames: Frames) -> None:
        cameras = frames.cameras or range(len(frames.pictures))
        for index, picture, stamp_ns in zip(cameras, frames.pictures, frames.stamps_ns):
            self._eyes[index].publish(picture, stamp_ns)
        self._ages_ms.append((self._now_ns() - frames.stamps_ns[0]) / 1e6)
        if self._ledger is not None:
            self._ledger.finish(FRAMES)

    def _report(self) -> None:
        status = self._capture.status
        rate_hz, self._seen = (status.pictures - self._seen) / self._period_s, status.pictures
        self._quiet_s = 0.0 if rate_hz or status.state != "running" else self._quiet_s + self._period_s
        complaints = [eye.complaint for eye in self._eyes if eye.complaint]
        complaints += [finding.text for finding in self._findings]
        if self._quiet_s >= self._quiet_after_s:
            complaints.insert(0, f"no picture for {self._quiet_s:.0f} s")
        text = "; ".join([f"{status.state}: {status.reason}" if status.reason else status.state, *complaints])
        failing = status.reason and status.state in ("waiting", "opening")
        level = "error" if failing else "warn" if complaints or status.state != "running" else "ok"
        values: list[tuple[str, Any]] = [
            ("source", self._source),
            ("pictures", status.pictures),
            ("rate_hz", f"{rate_hz:.1f}"),
            ("age_when_published_ms", f"{max(self._ages_ms, default=0.0):.1f}"),
            ("failures", status.failures),
        ]
        for finding in self._findings:
            name = f"{finding.side}.{finding.name}"
            values += [(f"{name}.code", finding.code), (f"{name}.wanted", finding.wanted), (f"{name}.got", finding.got)]
        self._diagnostics.tell(level, text, values)

    def close(self) -> None:
        """Stop the capture, so that a node that is being destroyed publishes nothing."""
        if not self._capture.stop():
            self.get_logger().error("the capture thread did not end in time")


def main() -> int:
    """Run the camera node."""
    return run(CameraNode)


if __name__ == "__main__":
    raise SystemExit(main())
