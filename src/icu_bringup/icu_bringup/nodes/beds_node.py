"""Node that shows several robots on one page; it publishes nothing."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from sensor_msgs.msg import Image
from std_msgs.msg import String

from icu_bringup.adapters.beds_server import BedsServer
from icu_common.core.configuration.config import Config, ConfigError, setting
from icu_common.nodes import qos
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.cameras import image_array
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.newest import NewestSubscription
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.timers import every

STATES = {"controller": "gantry/state", "driver": "gantry/driver_state", "calibration": "calibration/state"}
_WIDTH = 640
# OpenCV names a Bayer pattern by the second row's second and third pixel, ROS by the first row's first two.
_TO_BGR = {
    "rgb": cv2.COLOR_RGB2BGR,
    "rgba": cv2.COLOR_RGBA2BGR,
    "bgra": cv2.COLOR_BGRA2BGR,
    "bayer_rggb": cv2.COLOR_BayerBG2BGR,
    "bayer_bggr": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg": cv2.COLOR_BayerGR2BGR,
    "bayer_grbg": cv2.COLOR_BayerGB2BGR,
}
_BED = re.compile(r"(?P<name>[a-zA-Z]\w*)(=(?P<url>https?://\S+))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class BedsConfig(Config):
    """Robots that the page shows, and its port."""

    beds: tuple[str, ...] = setting(
        ("bed_1", "bed_2"), "Namespaces of the beds, each followed by =ADDRESS of its own page, if any", read_only=True
    )
    port: int = setting(8090, "TCP port of this page; 0 chooses a free port", minimum=0, maximum=65535, read_only=True)


class BedsNode(GraphNode):
    """Subscribes to each bed's states and left picture."""

    def __init__(self, **options: Any) -> None:
        super().__init__("beds", **options)
        config = LiveParameters(self, BedsConfig).config
        links = dict(_bed(text) for text in config.beds)
        self._states: dict[str, dict[str, str]] = {name: dict.fromkeys(STATES, "") for name in links}
        self._pictures: dict[str, Image] = {}
        self._seen_ns: dict[str, int] = {}
        for name in links:
            for what, topic in STATES.items():
                self.create_subscription(String, f"/{name}/{topic}", self._hear(name, what), qos.LATCHED)
            NewestSubscription(self, Image, f"/{name}/stereo/left/image_raw", self._see(name))
        try:
            self.server = BedsServer(config.port, links, tuple(STATES), self._state, self._picture)
        except OSError as error:
            raise ConfigError(f"port = {config.port}: {error}") from error
        every(self, 1.0, self._check_states)
        self.get_logger().warning(f"beds: {self.server.address}")

    def _hear(self, name: str, what: str) -> Callable[[String], None]:
        def heard(message: String) -> None:
            self._states[name][what] = message.data

        return heard

    def _check_states(self) -> None:
        # An ended program leaves its last state behind, although it does nothing any more.
        for name, states in self._states.items():
            for what, topic in STATES.items():
                if self.count_publishers(f"/{name}/{topic}") == 0:
                    states[what] = ""

    def _see(self, name: str) -> Callable[[Image], None]:
        def seen(message: Image) -> None:
            # At most the present time: a camera's clock may be ahead.
            self._seen_ns[name] = min(stamp_ns(message.header.stamp), self._now_ns())
            self._pictures[name] = message

        return seen

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _state(self) -> dict[str, object]:
        now_ns = self._now_ns()
        seen = dict(self._seen_ns)  # the node's thread may add one meanwhile
        ages = {name: (now_ns - seen_ns) / 1e9 for name, seen_ns in seen.items()}
        return {name: {"states": states, "age_s": ages.get(name)} for name, states in self._states.items()}

    def _picture(self, name: str) -> bytes:
        message = self._pictures.get(name)
        if message is None:
            return b""
        try:
            return _jpeg(image_array(message), message.encoding)
        except (ValueError, cv2.error) as error:
            self.get_logger().error(f"{name}: {error}", throttle_duration_sec=60.0)
            return b""

    def close(self) -> None:
        """Stop the page's server."""
        self.server.close()


def _jpeg(pixels: npt.NDArray[Any], encoding: str) -> bytes:
    code = _TO_BGR.get(encoding.rstrip("168"))
    if pixels.dtype != np.uint8:
        # Scaled to the largest value: most cameras of high bit depth use 10 or 12 of the 16 bits.
        finite = np.nan_to_num(pixels.astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        pixels = np.clip(finite * (255.0 / max(float(finite.max(initial=0.0)), 1e-9)), 0.0, 255.0).astype(np.uint8)
    if code is not None:
        pixels = cv2.cvtColor(np.ascontiguousarray(pixels), code)
    scale = min(1.0, _WIDTH / max(pixels.shape[1], 1))
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(small))
    return data.tobytes() if done else b""


def _bed(text: str) -> tuple[str, str]:
    match = _BED.fullmatch(text)
    if match is None:
        raise ConfigError(f"beds: {text!r} is not NAMESPACE or NAMESPACE=http://...")
    return match["name"], match["url"] or ""


def main() -> int:
    """Run the node."""
    return run(BedsNode)


if __name__ == "__main__":
    raise SystemExit(main())
