"""Interface of the web server to the graph, implemented by the node. Every call returns at once."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

import numpy.typing as npt

from scope_ui_bridge.core.effects import Now


class GraphUnavailable(RuntimeError):
    """No node of the graph can accept the request; the message is for people."""


class GraphPort(Protocol):
    """Actions of the bridge in the graph; called from the event loop's thread."""

    @property
    def runs_by_simulated_time(self) -> bool:
        """Whether ROS time is simulated or recorded."""
        ...

    def ros_ns(self) -> int:
        """Return ROS time in ns."""
        ...

    def stop(self, answered: Callable[[bool, str], None], cause: str = ...) -> None:
        """Stop by every available path, and log the cause; never raises.

        ``answered`` is called once, in any thread, when the driver has answered or when there is no driver. A driver
        that hangs causes no call.
        """
        ...

    def heartbeat(self) -> None:
        """Publish the operator's heartbeat to the driver."""
        ...

    def send_command(self, text: str) -> None:
        """Publish a gesture; GraphUnavailable if no controller subscribes."""
        ...

    def send_sequence(self, text: str) -> None:
        """Publish a sequence of gestures; GraphUnavailable if no sequencer subscribes."""
        ...

    def send_teaching(self, text: str, stamp_ns: int, encoding: str, picture: npt.NDArray[Any]) -> None:
        """Publish a held image and the points marked in it; GraphUnavailable if no node subscribes."""
        ...

    def send_goal(self, frame: str, point: tuple[float, float], stamp_ns: int) -> None:
        """Publish a goal in a frame: pixels, or metres with the stylus up.

        Raises GraphUnavailable if no controller subscribes.
        """
        ...

    def call(self, service: str, answered: Callable[[bool, str], None]) -> None:
        """Call one of ``core.wire.SERVICES``; GraphUnavailable if the service is not available.

        ``answered`` is called once, in any thread.
        """
        ...


def read_clocks(graph: GraphPort) -> Now:
    """Return the time of one event by all clocks."""
    return Now(
        mono_s=time.monotonic(), ros_ns=graph.ros_ns(), wall_s=time.time(), simulated=graph.runs_by_simulated_time
    )
