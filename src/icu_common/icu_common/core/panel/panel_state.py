"""Visible state of a panel's controls at one moment (lamps, knob markers, screens), as values for any package."""

from __future__ import annotations

import math
from dataclasses import dataclass

from icu_common.core.reasons.message import Message

HIDDEN_BY = ("", "stylus", "something", "edge")
"""Causes that hide a control: none, the robot's own stylus or arm, something else such as a hand, or the edge of the
image. Cameras on the carriage see a control beyond the edge after they have moved to it."""

LAMPS = ("off", "white", "red", "amber", "yellow", "green", "cyan", "blue", "violet")
"""Visible states of a lamp."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlSeen:
    """One control in one image.

    Parameters
    ----------
    name, kind
        As in the layout.
    hidden_by
        One of HIDDEN_BY; a hidden control is not read.
    lamp
        One of LAMPS; empty if there is no lamp or it cannot be read.
    angle_deg
        Direction of a knob's marker, counter-clockwise from up, -180 to 180; NaN if it cannot be read.
    changed_ns
        Stamp of the image in which a screen last began to differ by more than its own changes; 0 for never.
    detent_deg
        Angle between a knob's clicks, 0 without clicks.
    marks
        A knob's marked positions: names and degrees.
    """

    name: str
    kind: str
    hidden_by: str = ""
    lamp: str = ""
    angle_deg: float = math.nan
    changed_ns: int = 0
    detent_deg: float = 0.0
    marks: tuple[tuple[str, float], ...] = ()

    def text(self) -> str:
        """Return the state as text for people."""
        if self.hidden_by == "edge":
            return Message("panel.not_picture")
        if self.hidden_by:
            return Message(
                "panel.hidden", hidden_by=Message("panel.stylus") if self.hidden_by == "stylus" else self.hidden_by
            )
        if self.lamp:
            return Message("panel.lamp", lamp=self.lamp)
        if not math.isnan(self.angle_deg):
            return Message("panel.degrees", angle_deg=self.angle_deg)
        return "seen"


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelSeen:
    """All controls in the image of ``stamp_ns``."""

    stamp_ns: int
    controls: tuple[ControlSeen, ...]

    def control(self, name: str) -> ControlSeen | None:
        """Return the control with this name, None if it is not known."""
        return next((c for c in self.controls if c.name == name), None)

    def changed_ns(self) -> int:
        """Return the stamp of the newest change of any screen, 0 for never."""
        return max((c.changed_ns for c in self.controls), default=0)


def angle_between(a_deg: float, b_deg: float) -> float:
    """Return the turn from a to b, -180 to 180 degrees."""
    return math.remainder(b_deg - a_deg, 360.0)
