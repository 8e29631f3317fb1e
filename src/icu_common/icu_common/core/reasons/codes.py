"""Stable codes of the reasons for a published state; programs decide by them, never by the words of the reason.

A program reports the code of its state on ``/diagnostics``, in the status whose value ``topic`` names the state topic.
This status has the text of the state as its message, and the code and its values by name.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from enum import Enum

CODE, REASON, TOPIC = "code", "reason", "topic"
"""Keys of a status: the code of a state's reason, the text of this reason alone, and the full name of the state's
topic."""
STOP_ASKED = "stop_asked"
"""Key of a goal's answer whose sender has requested a stop of the machine for the reason of the answer."""

MAX_REPORTS = 50
"""Maximum number of texts of a state whose codes are kept."""


class ControllerCode(str, Enum):
    """Why the controller is in its state."""

    READY = "controller.ready"
    WORKING = "controller.working"
    """A goal is in progress."""
    FAILED = "controller.failed"
    """An internal error has ended the controller's work."""
    ENDED = "controller.ended"
    CONFLICT = "sources.conflict"
    """Several programs publish a topic that must have one source."""
    DRIVER_STOPPED = "driver.stopped"
    """The driver is stopped or in alarm: a person must reset it."""
    DRIVER_NOT_READY = "driver.not_ready"
    """The driver is disconnected, connecting, not homed, homing, not enabled, or its settings do not fit."""
    DRIVER_MOVING = "driver.moving"
    """The driver moves, but not for this controller."""
    NO_READINGS = "driver.no_readings"
    STYLUS_LEFT = "stylus.left_extended"
    """The stylus was extended when the controller started."""
    NO_OPERATOR = "operator.absent"
    PANEL_ALARM = "panel.contradicted"
    NOT_CALIBRATED = "calibration.missing"
    NO_IMAGES = "camera.no_images"
    PANEL_NOT_RECOGNISED = "panel.not_recognised"
    PANEL_OLD = "panel.pose_old"
    PANEL_PLANE_DUE = "panel.plane_unknown"
    CAMERA_MOVED = "camera.moved"
    CAMERA_CHANGING = "camera.changing"
    CAMERA_UNCHECKED = "camera.unchecked"

    def __str__(self) -> str:
        return self.value


class DriverCode(str, Enum):
    """Why the driver is in its state, where another program decides by it."""

    STOP_REQUESTED = "driver.stop_requested"
    """A person or a program has requested the stop."""
    HEARTBEAT_LOST = "driver.heartbeat_lost"
    """No operator's heartbeat came for too long."""
    SETTINGS_DIFFER = "driver.settings_differ"
    """Settings of the board are not those of the configuration."""
    HOMED_ELSEWHERE = "driver.homed_elsewhere"
    """The machine homed at another position than its configuration says."""

    def __str__(self) -> str:
        return self.value


NOT_OPERABLE = frozenset(
    {
        ControllerCode.FAILED,
        ControllerCode.CONFLICT,
        ControllerCode.DRIVER_STOPPED,
        ControllerCode.DRIVER_NOT_READY,
        ControllerCode.NO_OPERATOR,
    }
)
"""Codes of a machine that cannot continue, or that no operator watches."""


class StateReports:
    """The newest reports of a state on ``/diagnostics``: its texts, and the code with its values of each.

    Text and code arrive on two topics, and a reader may be late with both. So each text keeps the code that it was
    reported with, also after a newer state.
    """

    def __init__(self) -> None:
        self._values: OrderedDict[str, tuple[Mapping[str, str], str]] = OrderedDict()

    def take(self, text: str, values: Mapping[str, str], message: str = "") -> None:
        """Take the text and the values of a report; ``message`` is the text with its own code and values."""
        self._values[text] = values, message or text
        self._values.move_to_end(text)
        while len(self._values) > MAX_REPORTS:
            self._values.popitem(last=False)

    def values_of(self, text: str) -> Mapping[str, str] | None:
        """Return the values that were last reported with the text of a state, None if there are none yet."""
        return self._values[text][0] if text in self._values else None

    def message_of(self, text: str) -> str:
        """Return the text as a message with its code and values; unchanged without a report of it."""
        return self._values[text][1] if text in self._values else text
