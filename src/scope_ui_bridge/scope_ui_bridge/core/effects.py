"""What the desk wants done; the server does it. Frozen values, so that tests can compare them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Now:
    """The clocks, read once per event.

    Attributes
    ----------
    mono_s
        Monotonic seconds, for what guards people: sign-in, control, the page's keep-alives.
    ros_ns
        ROS time in ns.
    wall_s
        The system's time in seconds.
    simulated
        Whether ROS time is simulated or recorded, and may be slower than the others.
    """

    mono_s: float
    ros_ns: int
    wall_s: float
    simulated: bool = False

    @property
    def graph_s(self) -> float:
        """Seconds by which the graph's messages and answers are late; monotonic where ROS time is the system's."""
        return self.ros_ns / 1e9 if self.simulated else self.mono_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Send:
    """A message for one viewer."""

    viewer: str
    message: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Broadcast:
    """A message for all viewers."""

    message: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class End:
    """End the connection of a viewer that was told to slow down and did not."""

    viewer: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Heartbeat:
    """Tell the driver that an operator is there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ping:
    """Ask the browser of a viewer's page whether it is there, below the page's own script."""

    viewer: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StopNow:
    """Stop, before anything else; ``record`` is written afterwards. Log entry ``entry`` is told what is answered."""

    entry: int
    record: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """Something for the audit file that moves nothing (a result, a sign-in)."""

    record: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """Something that may move the machine; ``record`` is on disk before it goes out.

    It is dropped when the desk has stopped, changed hands or given it up in between, or when it goes on being written
    after ``until_s`` (monotonic), see ``Desk.still_wanted``.
    """

    entry: int
    stops: int
    epoch: int
    record: dict[str, Any]
    until_s: float = math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class SendCommand(Order):
    """A gesture for /gantry/command."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SendSequence(Order):
    """A sequence's text for /gantry/sequence."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SendGoal(Order):
    """A point for /gantry/goal: pixels of the left picture, or metres of base_link; ``stamp_ns`` is its name."""

    frame: str
    point: tuple[float, float]
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldPicture:
    """Keep the newest left picture, and tell this viewer which it is."""

    viewer: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SendTeaching(Order):
    """A request to make a panel of what was pointed at in the held picture."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CallService(Order):
    """A service of the graph: home, reset, enable, disable, calibrate."""

    service: str


Effect = Send | Broadcast | End | Heartbeat | Ping | StopNow | Record | Order | HoldPicture
