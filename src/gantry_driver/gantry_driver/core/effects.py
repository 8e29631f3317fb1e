"""What a gesture did, by what is seen of the panel before and after: lamps, screens, and where a knob stands."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gantry_driver.core.scene import Refused
from gantry_driver.core.targets import MOST_BIAS_DEG
from icu_common.core.gesture import Gesture
from icu_common.core.panel_state import ControlSeen, PanelSeen, angle_between

PART_DEG = 150.0
"""What is lost of a turn, or too much of it, may be nearly half a turn then."""


def effect(before: PanelSeen, after: PanelSeen, name: str, since_ns: int, left_ns: int) -> tuple[str, bool]:
    """Return what has changed since ``since_ns``, before the contact, and whether that is all there is to tell.

    Empty when nothing is seen to have changed. The control's own lamp tells more than a screen: while the stylus hides
    it, the screen's change is not all. Until the stylus leaves it, at ``left_ns``, a ball that is not seen before
    something of its own colour may be taken for a part of the lamp.
    """
    if after.stamp_ns <= since_ns:
        return "", False
    old, new = before.control(name), after.control(name)
    hidden = False
    if old is not None and new is not None and old.lamp:
        hidden = not new.lamp or after.stamp_ns <= left_ns
        if not hidden and old.lamp != new.lamp:
            return f"lamp {old.lamp} -> {new.lamp}", True
    changed = after.changed_ns() > since_ns
    return "screen changed" if changed else "", changed and not hidden


@dataclass(slots=True, kw_only=True)
class Knob:
    """One knob on its way to a place: look, turn, look, until it stands there.

    A marker does not tell whole turns, so a turn whose end is looked at is made in parts of less than a half: one that
    slipped altogether is told from one that came around. A turn that came out short, because play had to be taken up
    first, makes the next one in the same direction longer.

    Parameters
    ----------
    way_deg
        The next turn.
    goal_deg, seen_deg
        Where its marker is to point, and does; NaN while it cannot be read.
    off_deg
        How far it is still to turn.
    part_deg
        The longest turn.
    turns
        How often it was turned.
    """

    name: str
    way_deg: float
    goal_deg: float = math.nan
    seen_deg: float = math.nan
    off_deg: float = math.nan
    part_deg: float = PART_DEG
    turns: int = 0

    def look(self, angle_deg: float) -> None:
        """Take its marker's angle, after a turn or as the first that is seen of it, and decide on the next one."""
        before, self.seen_deg = self.seen_deg, angle_deg
        lost = 0.0
        if math.isnan(self.goal_deg):
            self.goal_deg, self.off_deg = angle_deg + self.way_deg, self.way_deg
        elif self.turns and not math.isnan(before):
            lost = angle_between(angle_between(before, angle_deg), self.way_deg)
            self.off_deg -= self.way_deg - lost
        else:
            self.off_deg = angle_between(angle_deg, self.goal_deg)
        off = self.off_deg
        bias = lost if abs(lost) <= MOST_BIAS_DEG and lost * off > 0 and self.way_deg * off > 0 else 0.0
        self._next(off + bias)

    def _next(self, way_deg: float) -> None:
        self.way_deg = min(max(way_deg, -self.part_deg), self.part_deg)

    @classmethod
    def seen(cls, name: str, angle_deg: float, way_deg: float, detent_deg: float = 0.0) -> Knob:
        """Return a knob whose marker is at an angle, to be turned by a way: whole clicks at a time where it has any."""
        part = PART_DEG // detent_deg * detent_deg if 0 < detent_deg <= PART_DEG else PART_DEG
        knob = cls(
            name=name,
            way_deg=way_deg,
            goal_deg=angle_deg + way_deg,
            seen_deg=angle_deg,
            off_deg=way_deg if not math.isnan(angle_deg) else math.nan,
            part_deg=part,
        )
        if not math.isnan(angle_deg):
            knob._next(way_deg)
        return knob


def knob_of(gesture: Gesture, name: str, seen: ControlSeen | None) -> Knob:
    """Return the knob's way for a turn, click or set, as far as it can be told from what is seen of it.

    Raises
    ------
    Refused
        If it has no clicks or no such mark, or nothing is seen of it that would tell.
    """
    angle = seen.angle_deg if seen is not None else math.nan
    detent = seen.detent_deg if seen is not None else 0.0
    if gesture.kind == "turn":
        return Knob.seen(name, angle, gesture.argument, detent)
    if seen is None:
        raise Refused(f"nothing is seen of {name}: {gesture.kind} needs recognition's state of the panel")
    if gesture.kind == "click":
        if not detent:
            raise Refused(f"{name} has no clicks (detent_deg in its layout)")
        way = -gesture.argument * detent
        if abs(way) > 360:
            raise Refused(f"{gesture.argument:g} clicks of {detent:g} degrees are more than a whole turn")
        return Knob.seen(name, angle, way, detent)
    goal = gesture.argument
    if gesture.mark:
        marks = dict(seen.marks)
        if gesture.mark not in marks:
            raise Refused(f"{name} has no mark {gesture.mark!r}; it has {', '.join(marks) or 'none'}")
        goal = marks[gesture.mark]
    knob = Knob.seen(name, angle, angle_between(angle, goal), detent)
    knob.goal_deg = goal
    return knob
