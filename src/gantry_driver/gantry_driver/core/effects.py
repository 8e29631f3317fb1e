"""What a gesture did, by what is seen of the panel before and after: lamps, screens, and where a knob stands."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gantry_driver.core.targets import MOST_BIAS_DEG, Refused
from icu_common.core.gesture import Gesture
from icu_common.core.panel_state import ControlSeen, PanelSeen, angle_between


def effect(before: PanelSeen, after: PanelSeen, name: str, since_ns: int) -> tuple[str, bool]:
    """Return what has changed since ``since_ns``, before the contact, and whether that is all there is to tell.

    Empty when nothing is seen to have changed. The control's own lamp tells more than a screen: while the stylus hides
    it, the screen's change is not all.
    """
    if after.stamp_ns <= since_ns:
        return "", False
    old, new = before.control(name), after.control(name)
    hidden = False
    if old is not None and new is not None and old.lamp:
        if new.lamp and old.lamp != new.lamp:
            return f"lamp {old.lamp} -> {new.lamp}", True
        hidden = not new.lamp
    changed = after.changed_ns() > since_ns
    return "screen changed" if changed else "", changed and not hidden


@dataclass(slots=True, kw_only=True)
class Knob:
    """One knob on its way to a place: look, turn, look, until it stands there.

    ``goal_deg`` and ``seen_deg`` are NaN while its marker cannot be read; ``way_deg`` is the next turn. A turn that
    came out short, because play had to be taken up first, makes the next one in the same direction longer.
    """

    name: str
    way_deg: float
    goal_deg: float = math.nan
    seen_deg: float = math.nan
    turns: int = 0

    @property
    def off_deg(self) -> float:
        """How far it is still to turn."""
        return angle_between(self.seen_deg, self.goal_deg)

    def look(self, angle_deg: float) -> None:
        """Take its marker's angle, after a turn or as the first that is seen of it, and decide on the next one."""
        if math.isnan(self.goal_deg):
            self.goal_deg = angle_deg + self.way_deg
        before, self.seen_deg = self.seen_deg, angle_deg
        off = self.off_deg
        bias = 0.0
        if self.turns and not math.isnan(before):
            lost = angle_between(angle_between(before, angle_deg), self.way_deg)
            if abs(lost) <= MOST_BIAS_DEG and lost * off > 0 and self.way_deg * off > 0:
                bias = lost
        self.way_deg = off + bias


def knob_of(gesture: Gesture, name: str, seen: ControlSeen | None) -> Knob:
    """Return the knob's way for a turn, click or set, as far as it can be told from what is seen of it.

    Raises
    ------
    Refused
        If it has no clicks or no such mark, or nothing is seen of it that would tell.
    """
    angle = seen.angle_deg if seen is not None else math.nan
    if gesture.kind == "turn":
        return _by(name, gesture.argument, angle)
    if seen is None:
        raise Refused(f"nothing is seen of {name}: {gesture.kind} needs recognition's state of the panel")
    if gesture.kind == "click":
        if not seen.detent_deg:
            raise Refused(f"{name} has no clicks (detent_deg in its layout)")
        way = -gesture.argument * seen.detent_deg
        if abs(way) > 360:
            raise Refused(f"{gesture.argument:g} clicks of {seen.detent_deg:g} degrees are more than a whole turn")
        return _by(name, way, angle)
    goal = gesture.argument
    if gesture.mark:
        marks = dict(seen.marks)
        if gesture.mark not in marks:
            raise Refused(f"{name} has no mark {gesture.mark!r}; it has {', '.join(marks) or 'none'}")
        goal = marks[gesture.mark]
    return Knob(name=name, way_deg=angle_between(angle, goal), goal_deg=goal, seen_deg=angle)


def _by(name: str, way_deg: float, angle_deg: float) -> Knob:
    return Knob(name=name, way_deg=way_deg, goal_deg=angle_deg + way_deg, seen_deg=angle_deg)
