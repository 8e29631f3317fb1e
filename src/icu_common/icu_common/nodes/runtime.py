"""How a process of the graph starts and ends: transport profile, executor, signals, a safe way out.

Fast DDS's default shared memory segment (512 kB) loses pictures, so a profile with a larger one is set before rclpy
starts; see docs/decisions/transport.md.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
from collections.abc import Callable, Sequence
from importlib import resources
from types import FrameType
from typing import Protocol

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from icu_common.core.config import ConfigError

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


class Closable(Protocol):
    """A node that brings its part of the world into the safe state when the process ends."""

    def close(self) -> None: ...


def prepare_transport() -> None:
    """Choose the transport profile, loopback-only discovery and a malloc that keeps picture-sized blocks.

    What the user has set in the environment stays.
    """
    profile = resources.files("icu_common") / "fastdds_profile.xml"
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # mallopt(3): without it each picture is mapped and unmapped anew (1080p: 6.9 instead of 0.4 ms to serialise).
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, 1 << 30)
        libc.mallopt(_M_TRIM_THRESHOLD, (1 << 31) - 1)


def run(make_node: Callable[[], Node], arguments: Sequence[str] | None = None) -> int:
    """Start rclpy, make the node, spin until SIGINT or SIGTERM, close it, and return the exit code.

    The node's ``close`` (if it has one) runs while topics still work, so that a last state can be published.
    """
    prepare_transport()
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    stopping = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal stopping
        stopping = True

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    node: Node | None = None
    try:
        node = make_node()
        executor = EventsExecutor()
        executor.add_node(node)
        # EventsExecutor.spin() does not see signals; short turns do.
        while rclpy.ok() and not stopping:
            executor.spin_once(timeout_sec=0.1)
        return 0
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        if node is not None:
            if hasattr(node, "close"):
                node.close()
            node.destroy_node()
        rclpy.shutdown()
