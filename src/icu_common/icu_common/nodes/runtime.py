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
from collections.abc import Callable, Iterator, Sequence
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


class Session:
    """rclpy between its start and its end: an executor, and whether SIGINT or SIGTERM has come."""

    def __init__(self) -> None:
        self.executor = EventsExecutor()
        self.stopping = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._stop)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.stopping = True

    @property
    def goes_on(self) -> bool:
        """False once the process is to end."""
        return rclpy.ok() and not self.stopping

    def spin(self, timeout_s: float = 0.1) -> None:
        """Serve what is due; EventsExecutor.spin() does not see signals, short turns do."""
        self.executor.spin_once(timeout_sec=timeout_s)

    def end(self, node: Node) -> None:
        """Close a node, if it can be closed, and destroy it."""
        if hasattr(node, "close"):
            node.close()
        node.destroy_node()


@contextlib.contextmanager
def ros_session(arguments: Sequence[str] | None = None) -> Iterator[Session]:
    """Start rclpy with the graph's transport, and shut it down at the end."""
    prepare_transport()
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield Session()
    finally:
        rclpy.shutdown()


def run(make_node: Callable[[], Node], arguments: Sequence[str] | None = None) -> int:
    """Start rclpy, make the node, spin until SIGINT or SIGTERM, close it, and return the exit code.

    The node's ``close`` (if it has one) runs while topics still work, so that a last state can be published.
    """
    with ros_session(arguments) as session:
        try:
            node = make_node()
        except ConfigError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        try:
            session.executor.add_node(node)
            while session.goes_on:
                session.spin()
        except ConfigError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
        finally:
            session.end(node)
    return 0
