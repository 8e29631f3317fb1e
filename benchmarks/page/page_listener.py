"""Receive the operator's heartbeat and the left corners; for each input line, print the arrivals since the last line.

The output is a JSON list of the times of the heartbeats and of the ages of the corners, in ms.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from icu_common.adapters.real_time import BRIDGE, ask_for_real_time
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.runtime import prepare_transport


def main() -> None:
    ask_for_real_time(BRIDGE + 1)  # else it would measure its own waiting time
    prepare_transport()
    rclpy.init()
    node = Node("page_listener")
    beats: list[float] = []
    ages: list[float] = []
    now_ns = lambda: node.get_clock().now().nanoseconds  # noqa: E731
    take = lambda cloud: ages.append((now_ns() - stamp_ns(cloud.header.stamp)) / 1e6)  # noqa: E731
    node.create_subscription(PointCloud2, "stereo/left/corners", take, qos.SENSOR)
    node.create_subscription(Header, "operator/heartbeat", lambda _: beats.append(1e3 * time.monotonic()), qos.RESULTS)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    for _ in sys.stdin:
        print(json.dumps([beats, ages]), flush=True)
        beats.clear()
        ages.clear()
    os._exit(0)


if __name__ == "__main__":
    main()
