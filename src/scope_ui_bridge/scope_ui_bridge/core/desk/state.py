"""State that several parts of the desk read or write."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.control import HeldJog, OperatorLease, StopCauses
from scope_ui_bridge.core.desk.pages import Pages
from scope_ui_bridge.core.orders import HeldPicture
from scope_ui_bridge.core.records import CommandLog
from scope_ui_bridge.core.status import MachineView, PanelView, Recordings, SequenceView
from scope_ui_bridge.core.video import VideoScene


@dataclass(slots=True, kw_only=True)
class DeskState:
    """State of the desk, with the jog and the image that are held.

    Attributes
    ----------
    config
        Limits; replaced when a parameter changes.
    boot_id
        Id of this run of the server.
    stops
        Number of stops since the start; an order from before a stop is void.
    stop_wanted_s
        Monotonic seconds of the last stop that was no repetition.
    jog
        Direction that a page holds; a stop ends it.
    held
        Image that an engineer marks.
    ticked_s, now_s, ros_ns
        Clocks of the last tick, in monotonic seconds and in ns of ROS time; ``ticked_s`` is infinite before the first.
    """

    config: BridgeConfig
    boot_id: str
    scene: VideoScene = field(default_factory=VideoScene)
    machine: MachineView = field(default_factory=MachineView)
    panel: PanelView = field(default_factory=PanelView)
    sequence: SequenceView = field(default_factory=SequenceView)
    recordings: Recordings = field(default_factory=Recordings)
    lease: OperatorLease = field(default_factory=OperatorLease)
    causes: StopCauses = field(default_factory=StopCauses)
    log: CommandLog = field(default_factory=CommandLog)
    pages: Pages = field(default_factory=Pages)
    stops: int = 0
    stop_wanted_s: float = -math.inf
    jog: HeldJog | None = None
    held: HeldPicture | None = None
    ticked_s: float = math.inf
    now_s: float = 0.0
    ros_ns: int = 0

    @property
    def moving(self) -> bool:
        """Whether the machine moves or a motion has been ordered."""
        return self.machine.active or self.log.motion_waiting
