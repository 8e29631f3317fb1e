"""Effects: actions that the desk returns and the server carries out. Frozen values, so that tests can compare them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from icu_common.core.reasons.message import Message


@dataclass(frozen=True, slots=True, kw_only=True)
class Now:
    """The clocks, read once per event.

    Attributes
    ----------
    mono_s
        Monotonic seconds, for limits that protect people: sign-in, control, the page's keep-alives.
    ros_ns
        ROS time in ns.
    wall_s
        The system's time in seconds.
    simulated
        Whether ROS time is simulated or recorded, and may be slower than the other clocks.
    """

    mono_s: float
    ros_ns: int
    wall_s: float
    simulated: bool = False

    @property
    def graph_s(self) -> float:
        """Seconds for delays of the graph's messages and answers: ROS time if it is simulated, else monotonic."""
        return self.ros_ns / 1e9 if self.simulated else self.mono_s


@dataclass(frozen=True, slots=True, kw_only=True)
class SendToViewer:
    """A message for one viewer."""

    viewer: str
    message: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Broadcast:
    """A message for all viewers."""

    message: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class End:
    """End the connection of a viewer that ignored the request to slow down."""

    viewer: str


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishHeartbeat:
    """Publish the operator's heartbeat to the driver."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ping:
    """Ping the browser of a viewer's page; browsers answer without the page's script."""

    viewer: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StopNow:
    """Stop, before all other effects; ``record`` is written afterwards. The answer belongs to log entry ``entry``.

    ``cause`` is the text for the log.
    """

    entry: int
    cause: Message
    record: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """A record for the audit file about something that moves nothing (a result, a sign-in)."""

    record: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineOrder:
    """An order that may move the machine; ``record`` is on disk before it is sent.

    It is dropped if, before it is sent, the desk has stopped, control has changed, the desk has given the order up, or
    ``until_s`` (monotonic) has passed, see ``Desk.still_wanted``.
    """

    entry: int
    stops: int
    epoch: int
    record: dict[str, Any]
    until_s: float = math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class SendCommand(MachineOrder):
    """A gesture for /gantry/command."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SendSequence(MachineOrder):
    """A sequence's text for /gantry/sequence."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SendGoal(MachineOrder):
    """A point for /gantry/goal: pixels of the left image, or metres in base_link; ``stamp_ns`` is its id."""

    frame: str
    point: tuple[float, float]
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldPicture:
    """Hold the newest left image, and send its stamp to this viewer."""

    viewer: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SendTeaching(MachineOrder):
    """A request to make a panel layout from the points marked in the held image."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class CallService(MachineOrder):
    """A service of the graph: home, reset, enable, disable, calibrate."""

    service: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatOrder:
    """An order that was sent before, and whose record is on disk; the same events drop it."""

    order: MachineOrder


Effect = (
    SendToViewer
    | Broadcast
    | End
    | PublishHeartbeat
    | Ping
    | StopNow
    | Record
    | MachineOrder
    | RepeatOrder
    | HoldPicture
)
