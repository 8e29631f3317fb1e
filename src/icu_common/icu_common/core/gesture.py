"""The text of /gantry/command: ``gesture:target[:argument][ id=TEXT]``; see docs/architecture.md for the grammar."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

GESTURES = ("press", "hold", "turn")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_POINT = re.compile(r"([^,@]+),([^,@]+)@([A-Za-z_][A-Za-z0-9_]*)\Z")
MAX_LENGTH = 200


class GestureError(ValueError):
    """The text is not a gesture; the message says what was expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A place: x and y in metres, or in raw pixels when ``frame`` is a camera's optical frame."""

    x: float
    y: float
    frame: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Gesture:
    """What to do (one of GESTURES), where (a control's name or a point), and seconds (hold) or degrees (turn)."""

    kind: str
    target: str | Point
    argument: float = math.nan
    id: str = ""

    def text(self) -> str:
        """Return the command's text; ``parse_gesture(g.text()) == g``."""
        target = self.target
        place = target if isinstance(target, str) else f"{target.x!r},{target.y!r}@{target.frame}"
        argument = "" if math.isnan(self.argument) else f":{self.argument!r}"
        return f"{self.kind}:{place}{argument}" + (f" id={self.id}" if self.id else "")


def parse_gesture(text: str) -> Gesture:
    """Parse a command.

    Raises
    ------
    GestureError
        With what was found and what was expected.

    Examples
    --------
    >>> parse_gesture("press:RUN_STOP").target
    'RUN_STOP'
    >>> parse_gesture("turn:CH1_SCALE:-30 id=a1").argument
    -30.0
    >>> parse_gesture("press:0.12,0.08@base_link").target
    Point(x=0.12, y=0.08, frame='base_link')
    """
    if len(text) > MAX_LENGTH:
        raise GestureError(f"the command has {len(text)} characters, at most {MAX_LENGTH} are allowed")
    body, _, tail = text.strip().partition(" ")
    identifier = ""
    if tail:
        if not re.match(r"id=[\w.-]{1,64}\Z", tail.strip()):
            raise GestureError(f"{tail.strip()!r}: expected id= and up to 64 letters, digits, '.', '-' or '_'")
        identifier = tail.strip()[3:]
    parts = body.split(":")
    if len(parts) not in (2, 3):
        raise GestureError(f"{body!r}: expected gesture:target or gesture:target:argument")
    kind = parts[0]
    if kind not in GESTURES:
        raise GestureError(f"gesture {kind!r} is none of {', '.join(GESTURES)}")
    argument = _finite(parts[2], "argument") if len(parts) == 3 else math.nan
    if kind == "press" and not math.isnan(argument):
        raise GestureError(f"press takes no argument, found {parts[2]!r}")
    if kind == "turn" and (math.isnan(argument) or not 0 < abs(argument) <= 360):
        raise GestureError(f"turn needs an angle in degrees, not zero and at most 360 either way, found {parts[2:]}")
    if kind == "hold" and not 0 < argument <= 30:
        raise GestureError(f"hold needs seconds above 0 and up to 30, found {parts[2:]}")
    return Gesture(kind=kind, target=_target(parts[1]), argument=argument, id=identifier)


def _target(text: str) -> str | Point:
    point = _POINT.match(text)
    if point:
        return Point(x=_finite(point[1], "x"), y=_finite(point[2], "y"), frame=point[3])
    if not _NAME.match(text):
        raise GestureError(f"target {text!r} is neither a control's name nor x,y@frame")
    return text


def _finite(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise GestureError(f"{what} {text!r} is not a number") from None
    if not math.isfinite(value):
        raise GestureError(f"{what} {text!r} is not finite")
    return value
