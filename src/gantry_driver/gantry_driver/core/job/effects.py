"""Effects of a gesture, from the seen panel before and after it: lamps, screens, and the angle of a knob."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from gantry_driver.core.motion.scene import Refused
from gantry_driver.core.motion.targets import MOST_BIAS_DEG
from icu_common.core.goals.results import EFFECT, EFFECT_MISSING, EffectMissing
from icu_common.core.panel.gesture import Gesture
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen, angle_between
from icu_common.core.reasons.message import Message, quoted

PART_DEG = 150.0
"""Maximum angle of one turn: a turn that is too short or too long by nearly half a turn is then still unambiguous."""


class EffectKind(Enum):
    """Kind of a gesture's seen effect."""

    LAMP = "lamp"
    """The control's own lamp has changed."""
    SCREEN = "screen"
    """A screen has changed."""
    KNOB = "knob"
    """The knob's marker was read at the end of the gesture."""
    NONE = "none"
    """The panel was read, and nothing has changed."""
    UNREAD = "unread"
    """The panel was not read since the touch."""
    NOT_LOOKED_FOR = "not_looked_for"
    """The goal ended before its effect could be seen, or nothing can show one."""


_MISSING = {
    EffectKind.NONE: EffectMissing.NONE,
    EffectKind.UNREAD: EffectMissing.UNREAD,
    EffectKind.NOT_LOOKED_FOR: EffectMissing.NOT_LOOKED_FOR,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """Seen effect of a gesture, and its text for people."""

    kind: EffectKind
    text: str

    @property
    def seen(self) -> bool:
        """Whether something has changed."""
        return self.kind not in _MISSING

    @property
    def of_control(self) -> bool:
        """Whether the touched control itself shows it: a screen may also change by itself."""
        return self.kind in (EffectKind.LAMP, EffectKind.KNOB)

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the effect as pairs for ``GoalResult.details``."""
        missing = _MISSING.get(self.kind)
        return ((EFFECT, self.text), *(() if missing is None else ((EFFECT_MISSING, missing.value),)))


SCREEN_CHANGED = Message("effect.screen_changed")
NONE_SEEN = Effect(kind=EffectKind.NONE, text=Message("effect.none_seen"))
NOT_LOOKED_FOR = Effect(kind=EffectKind.NOT_LOOKED_FOR, text=Message("sequence.not_looked"))


def effect(before: PanelSeen, after: PanelSeen, name: str, since_ns: int, left_ns: int) -> tuple[Effect | None, bool]:
    """Return the change since ``since_ns``, before the contact, and whether this result is final.

    The change is None if nothing has visibly changed. The control's own lamp is better evidence than a screen: while
    the stylus hides the lamp, a change of the screen is not final. Until the stylus leaves the control, at ``left_ns``,
    recognition may mistake a ball in front of something of its own colour for a part of the lamp.
    """
    if after.stamp_ns <= since_ns:
        return None, False
    old, new = before.control(name), after.control(name)
    hidden = False
    if old is not None and new is not None and old.lamp:
        hidden = not new.lamp or after.stamp_ns <= left_ns
        if not hidden and old.lamp != new.lamp:
            return Effect(kind=EffectKind.LAMP, text=Message("effect.lamp", lamp=old.lamp, lamp_2=new.lamp)), True
    changed = after.changed_ns() > since_ns
    screen = Effect(kind=EffectKind.SCREEN, text=SCREEN_CHANGED) if changed else None
    return screen, changed and not hidden


@dataclass(slots=True, kw_only=True)
class Knob:
    """One knob that is turned to an angle: look, turn, look, until its marker is there.

    A marker does not show whole turns, so a turn whose end is looked at is divided into parts of less than half a turn.
    This distinguishes a turn that slipped completely from a complete one. If a turn is short because of play, the next
    turn in the same direction is longer.

    Parameters
    ----------
    way_deg
        Angle of the next turn.
    goal_deg, seen_deg
        Wanted and seen angle of the marker; NaN while it cannot be read.
    off_deg
        Remaining angle.
    part_deg
        Maximum angle of one turn.
    turns
        Number of turns made.
    """

    name: str
    way_deg: float
    goal_deg: float = math.nan
    seen_deg: float = math.nan
    off_deg: float = math.nan
    part_deg: float = PART_DEG
    turns: int = 0

    def look(self, angle_deg: float) -> None:
        """Take the marker's angle, first or after a turn, and determine the next turn."""
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
        """Return a knob with its marker at an angle and the angle to turn; a knob with clicks turns by whole clicks."""
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
    """Return the knob for a turn, click or set, from its seen state.

    Raises
    ------
    Refused
        If it has no clicks or no such mark, or if nothing is seen of it.
    """
    angle = seen.angle_deg if seen is not None else math.nan
    detent = seen.detent_deg if seen is not None else 0.0
    if gesture.kind == "turn":
        return Knob.seen(name, angle, gesture.argument, detent)
    if seen is None:
        raise Refused(Message("effect.nothing_seen_needs_recognition_state", name=name, kind=gesture.kind))
    if gesture.kind == "click":
        if not detent:
            raise Refused(Message("effect.no_clicks_detent_deg_layout", name=name))
        way = -gesture.argument * detent
        if abs(way) > 360:
            raise Refused(
                Message("effect.clicks_degrees_more_whole_turn", argument=gesture.argument, detent_deg=detent)
            )
        return Knob.seen(name, angle, way, detent)
    goal = gesture.argument
    if gesture.mark:
        marks = dict(seen.marks)
        if gesture.mark not in marks:
            raise Refused(
                Message("effect.no_mark", name=name, mark=quoted(gesture.mark), marks=", ".join(marks) or "none")
            )
        goal = marks[gesture.mark]
    knob = Knob.seen(name, angle, angle_between(angle, goal), detent)
    knob.goal_deg = goal
    return knob
