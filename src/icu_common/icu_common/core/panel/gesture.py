"""The text of /gantry/command: ``gesture:target[:argument][ id=TEXT]``; see docs/reference/goals.md for the grammar."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from icu_common.core.reasons.message import Message, quoted

GESTURES = ("press", "long", "double", "hold", "turn", "click", "set", "drag")
TURNING = ("turn", "click", "set")
"""Gestures that turn a knob."""
MAX_CLICKS = 60
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_NUMBERS = ("nan", "inf", "infinity")
_POINT = re.compile(r"([^,@]+),([^,@]+)@([A-Za-z_][A-Za-z0-9_]*)\Z")
MAX_LENGTH = 200


class GestureError(ValueError):
    """The text is not a gesture; the message states what was expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A point: x and y in metres, or in raw pixels if ``frame`` is a camera's optical frame."""

    x: float
    y: float
    frame: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Gesture:
    """A gesture: kind, target and amount.

    Parameters
    ----------
    kind
        One of GESTURES.
    target
        A control's name or a point.
    argument
        Seconds (hold), degrees counter-clockwise (turn), clicks clockwise (click), or degrees counter-clockwise from up
        (set).
    mark
        The marked position of a knob, for a set without degrees.
    to
        End point of a drag.
    """

    kind: str
    target: str | Point
    argument: float = math.nan
    mark: str = ""
    to: Point | None = None
    id: str = ""

    def text(self) -> str:
        """Return the command's text; ``parse_gesture(g.text()) == g``."""
        parts = [self.kind, self.target if isinstance(self.target, str) else _text(self.target)]
        if self.to is not None:
            parts.append(_text(self.to))
        elif self.mark:
            parts.append(self.mark)
        elif not math.isnan(self.argument):
            parts.append(repr(self.argument))
        return ":".join(parts) + (f" id={self.id}" if self.id else "")


def is_name(text: str) -> bool:
    """Return whether a control of this name can be the target of a gesture."""
    return _NAME.match(text) is not None


def is_mark(text: str) -> bool:
    """Return whether a knob can be set to a marked position of this name."""
    return is_name(text) and text.lower() not in _NUMBERS


def parse_gesture(text: str) -> Gesture:
    """Parse a command.

    Raises
    ------
    GestureError
        With the text found and the text expected.

    Examples
    --------
    >>> parse_gesture("press:RUN_STOP").target
    'RUN_STOP'
    >>> parse_gesture("turn:CH1_SCALE:-30 id=a1").argument
    -30.0
    >>> parse_gesture("set:MODE:AUTO").mark
    'AUTO'
    >>> parse_gesture("press:0.12,0.08@base_link").target
    Point(x=0.12, y=0.08, frame='base_link')
    """
    if len(text) > MAX_LENGTH:
        raise GestureError(Message("gesture.command_characters_most_allowed", text=len(text), max_length=MAX_LENGTH))
    body, _, tail = text.strip().partition(" ")
    identifier = ""
    if tail:
        if not re.match(r"id=[\w.-]{1,64}\Z", tail.strip()):
            raise GestureError(Message("gesture.expected_id_up_64_letters", tail=quoted(tail.strip())))
        identifier = tail.strip()[3:]
    parts = body.split(":")
    if len(parts) not in (2, 3):
        raise GestureError(Message("gesture.expected_gesture_target_gesture_target", body=quoted(body)))
    kind = parts[0]
    if kind not in GESTURES:
        raise GestureError(Message("gesture.gesture_none", kind=quoted(kind), gestures=", ".join(GESTURES)))
    target, argument, mark, to = _target(parts[1]), math.nan, "", None
    if kind in ("press", "long", "double"):
        if len(parts) == 3:
            raise GestureError(Message("gesture.takes_no_argument_found", kind=kind, parts=quoted(parts[2])))
    elif len(parts) == 2:
        raise GestureError(Message("gesture.needs_found_nothing", kind=kind, needs=_NEEDS[kind]))
    elif kind == "drag":
        to = _point(parts[2])
    elif kind == "set" and is_mark(parts[2]):
        mark = parts[2]
    else:
        argument = _finite(parts[2], "argument")
        if not _fits(kind, argument):
            raise GestureError(Message("gesture.needs_found", kind=kind, needs=_NEEDS[kind], parts=quoted(parts[2])))
    return Gesture(kind=kind, target=target, argument=argument, mark=mark, to=to, id=identifier)


_NEEDS = {
    "hold": Message("gesture.seconds_above_0_up_30"),
    "turn": Message("gesture.angle_degrees_not_zero_most"),
    "click": Message("gesture.whole_number_clicks_not_zero", max_clicks=MAX_CLICKS),
    "set": Message("gesture.marked_position_name_degrees_180"),
    "drag": Message("gesture.point_where_ends"),
}


def _fits(kind: str, argument: float) -> bool:
    return {
        "hold": 0 < argument <= 30,
        "turn": 0 < abs(argument) <= 360,
        "click": 0 < abs(argument) <= MAX_CLICKS and argument == round(argument),
        "set": -180 <= argument <= 180,
    }[kind]


def _text(point: Point) -> str:
    return f"{point.x!r},{point.y!r}@{point.frame}"


def _point(text: str) -> Point:
    found = _target(text)
    if not isinstance(found, Point):
        raise GestureError(Message("gesture.drag_needs_found", drag=_NEEDS["drag"], text=quoted(text)))
    return found


def _target(text: str) -> str | Point:
    point = _POINT.match(text)
    if point:
        return Point(x=_finite(point[1], "x"), y=_finite(point[2], "y"), frame=point[3])
    if not is_name(text):
        raise GestureError(Message("gesture.target_neither_control_name_nor", text=quoted(text)))
    return text


def _finite(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise GestureError(Message("gesture.not_number", what=what, text=quoted(text))) from None
    if not math.isfinite(value):
        raise GestureError(Message("gesture.not_finite", what=what, text=quoted(text)))
    return value
