"""What the web server needs of the graph; the node provides it. Every call returns at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy.typing as npt


class GraphError(RuntimeError):
    """Nobody in the graph can take this; the message is for people."""


class GraphPort(Protocol):
    """The bridge's hands in the graph; called from the event loop's thread."""

    @property
    def runs_by_simulated_time(self) -> bool:
        """Whether ROS time is simulated or recorded."""
        ...

    def ros_ns(self) -> int:
        """Return ROS time in ns."""
        ...

    def stop(self, answered: Callable[[bool, str], None]) -> None:
        """Stop by every way there is; never raises.

        ``answered`` is called once, in any thread, when the driver has answered or when there is none; not at all by
        one that hangs.
        """
        ...

    def heartbeat(self) -> None:
        """Tell the driver that an operator is there."""
        ...

    def send_command(self, text: str) -> None:
        """Publish a gesture; GraphError when no controller listens."""
        ...

    def send_sequence(self, text: str) -> None:
        """Publish a sequence of gestures; GraphError when no sequencer listens."""
        ...

    def send_teaching(self, text: str, stamp_ns: int, encoding: str, picture: npt.NDArray[Any]) -> None:
        """Publish a held picture and what was pointed at in it; GraphError when nobody listens."""
        ...

    def send_goal(self, frame: str, point: tuple[float, float], stamp_ns: int) -> None:
        """Publish a goal in a frame (pixels, or metres with the stylus up); GraphError when no controller listens."""
        ...

    def call(self, service: str, answered: Callable[[bool, str], None]) -> None:
        """Call one of ``core.wire.SERVICES``; GraphError when the service is not there.

        ``answered`` is called once, in any thread.
        """
        ...
