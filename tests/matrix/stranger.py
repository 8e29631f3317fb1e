"""A foreign program: ``python stranger.py flood|garbage TOPIC TYPE SECONDS SEED``; ``clock`` for TOPIC jumps the clock.

``flood`` publishes empty messages as fast as it can, ``garbage`` random bytes. The program prints ``ready`` and begins
when it receives a line.
"""

from __future__ import annotations

import importlib
import random
import sys
import time
from typing import Any

import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

MATCH_S = 3.0
ANY = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.RELIABLE, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
"""An offer that every subscription accepts."""
JUMPS_S = (3600.0, -3600.0, 86400.0 * 365, -30.0)


def main() -> int:
    kind, topic, name, seconds, seed = sys.argv[1:]
    rng = random.Random(seed)
    rclpy.init(args=[])
    node = rclpy.create_node("stranger")
    message_type: Any = _message_type(name)
    print("ready", flush=True)
    sys.stdin.readline()
    publisher = node.create_publisher(message_type, topic, ANY)
    end = time.monotonic() + MATCH_S
    while not publisher.get_subscription_count() and time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.02)
    data = serialize_message(message_type())
    end = time.monotonic() + float(seconds)
    jump_s = rng.choice(JUMPS_S)
    while time.monotonic() < end:
        if kind == "garbage":
            data = rng.randbytes(rng.choice((0, 3, 8, 64, 4096, 65536)))
        elif kind == "clock":
            now = time.time() + jump_s
            data = serialize_message(_clock(max(now, 0.0)))
        publisher.publish(data)
        if kind != "flood":
            time.sleep(0.01)  # the stimulus: a hundred a second
    return 0


def _message_type(name: str) -> Any:
    """Return the class of ``package/msg/Name``."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def _clock(seconds: float) -> Clock:
    message = Clock()
    message.clock.sec, message.clock.nanosec = int(seconds), 0
    return message


if __name__ == "__main__":
    raise SystemExit(main())
