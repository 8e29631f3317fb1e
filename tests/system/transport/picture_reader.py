"""A process of its own that receives images and prints them, for the test of the transport."""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_array
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.runtime import prepare_transport


def main() -> int:
    """Receive ``count`` pictures on ``topic``, at most ``within_s``, and print number, stamp and age of each."""
    topic, count, within_s, depth = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])
    prepare_transport()
    rclpy.init(args=sys.argv)
    node = Node(f"reader_{sys.argv[5]}")
    rows: list[dict[str, Any]] = []

    def take(message: Image) -> None:
        age_ms = (node.get_clock().now().nanoseconds - stamp_ns(message.header.stamp)) / 1e6
        picture = image_array(message)
        marks = {int(picture[y, x, c]) for y, x, c in ((0, 0, 0), (360, 640, 1), (-1, -1, 2))}
        shape = [message.encoding, *picture.shape]
        rows.append({"marks": sorted(marks), "stamp_ns": stamp_ns(message.header.stamp), "age_ms": age_ms, "is": shape})

    profile = QoSProfile(depth=depth, reliability=qos.IMAGES.reliability, durability=qos.IMAGES.durability)
    node.create_subscription(Image, topic, take, profile)
    executor = EventsExecutor()
    executor.add_node(node)
    deadline = time.monotonic() + within_s
    while len(rows) < count and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.2)
    print(json.dumps(rows), flush=True)
    node.destroy_node()
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
