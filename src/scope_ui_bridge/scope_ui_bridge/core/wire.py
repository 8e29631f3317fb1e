"""Control messages between page and bridge: strict JSON in, typed values out, and back.

Python's decoder accepts NaN, Infinity and 1e999; this one refuses them, as well as repeated keys, unknown fields and
texts of more than 32 KiB.
"""

from __future__ import annotations

import json
import math
import re
import unicodedata
from dataclasses import dataclass
from typing import Any, NoReturn

from icu_common.core.configuration.text_bounds import deepest_line
from icu_common.core.goals.sequence import MAX_STEPS
from icu_common.core.panel.gesture import GESTURES
from scope_ui_bridge.core.refusal import Refusal

MAX_BYTES = 32 * 1024
"""Maximum size of a message; the longest sequences and lessons within the other limits fit."""
MAX_STOP = 512
"""Maximum size of a stop, which is read even on a connection that sends too much."""
MAX_DEPTH = 8
"""Maximum number of open brackets, including those in texts; the rows of a lesson need three."""
MAX_TEXT = 64
_MAX_INTEGER = 2**53
_SEQ_WITHIN = 300  # the page writes the number after the type
_SEQ = re.compile(r'"seq": ?([0-9]{1,15})[,}]')


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """Fields of every message from a page.

    ``seq`` increases with each message of a connection; ``boot`` is the id of the server's run, ``epoch`` of the lease.
    """

    seq: int
    boot: str
    epoch: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Alive(Message):
    """Keep-alive of a page that draws; ``client_ms`` is returned with the bridge's clock, for the round-trip time."""

    client_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Hidden(Message):
    """The page has just been hidden, for example by another tab or a locked screen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Blind(Message):
    """Something moves, and the page has shown no new image for ``silence_ms``."""

    silence_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop(Message):
    """Stop everything; ``press`` identifies one press of the button, which arrives by two paths."""

    press: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lease(Message):
    """``step``: take, release, request, grant (hand over) or decline; the last two name the requesting page."""

    step: str
    to: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Select(Message):
    """A control's name, a point or a line, on the image with this stamp; none of them = clear the selection.

    Points are raw pixels. A line goes from ``point_px`` to ``to_px``, or is given on the face as ``line_m`` (x, y to x,
    y).
    """

    camera: str
    stamp_ns: int
    control: str = ""
    point_px: tuple[float, float] | None = None
    to_px: tuple[float, float] | None = None
    line_m: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Act(Message):
    """Confirm a gesture at the selection, based on the image with this stamp.

    ``argument`` is NaN if the gesture has none; ``mark`` is a knob's marked position, in place of an argument.
    """

    gesture: str
    argument: float
    selection: int
    camera: str
    stamp_ns: int
    mark: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Move(Message):
    """Move to a point in base_link (metres) with the stylus up, based on the image with this stamp."""

    x_m: float
    y_m: float
    camera: str
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Jog(Message):
    """Jog in small steps while this message is repeated; ``dx``, ``dy`` are -1, 0 or 1; both 0 = released."""

    dx: int
    dy: int
    step_m: float
    camera: str
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSequence(Message):
    """Start a sequence: the ``stored`` one of this name, or these steps as on a command line."""

    stored: str
    steps: tuple[str, ...]
    camera: str
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Hold(Message):
    """Hold the newest left image, to mark a new panel in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointedControl:
    """A control in the held image: centre of its foot in raw pixels, its size and its height above the face in mm."""

    name: str
    kind: str
    pixel: tuple[float, float]
    size_mm: tuple[float, float]
    proud_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Teach(Message):
    """Make a panel from the points marked in the held image: corners from the lower left, counter-clockwise."""

    stamp_ns: int
    model: str
    title: str
    size_mm: tuple[float, float]
    corners: tuple[tuple[float, float], ...]
    controls: tuple[PointedControl, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Call(Message):
    """Call one of SERVICES; ``sent_s`` is the time of sending by the page's estimate of the bridge's clock."""

    service: str
    sent_s: float = math.inf


LEASE_STEPS = ("take", "release", "request", "grant", "decline")
SERVICES = (
    *("home", "reset", "enable", "disable", "calibrate", "add_sample", "solve", "save", "accept_settings"),
    *("record", "end_record"),
)
KINDS = (
    *("alive", "hidden", "blind", "stop", "lease", "select", "act", "move", "jog"),
    *("sequence", "hold", "teach", "call"),
)
CAMERAS = ("left", "right")
_WITH_ARGUMENT = ("hold", "turn", "click")
_LINE = ("x_mm", "y_mm", "to_x_mm", "to_y_mm")


def decode(text: str | bytes) -> Message:
    """Parse one message of the page.

    Raises
    ------
    Refusal
        ``malformed`` with the problem, or ``oversized``; ``text`` may be anything.
    """
    size = len(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
    if size > MAX_BYTES:
        raise Refusal("oversized", size=size, limit=MAX_BYTES)
    return _typed(decode_object(text))


def seq_of(text: str | bytes) -> int | None:
    """Return the number of an invalid message, for the answer to it; None if it has none."""
    begin = text[:_SEQ_WITHIN]
    found = _SEQ.search(begin if isinstance(begin, str) else begin.decode("utf-8", "replace"))
    return int(found[1]) if found else None


def decode_object(text: str | bytes) -> dict[str, Any]:
    """Parse a JSON object strictly: no NaN, no infinity, no repeated key, limited depth."""
    if deepest_line(text if isinstance(text, str) else text.decode("utf-8", "replace"), MAX_DEPTH):
        raise Refusal("malformed", what=f"more than {MAX_DEPTH} open brackets")
    try:
        value = json.loads(
            text, parse_constant=_no_constant, parse_float=_finite, parse_int=_integer, object_pairs_hook=_unique
        )
    except (ValueError, RecursionError) as error:  # JSONDecodeError and UnicodeDecodeError are ValueErrors
        raise Refusal("malformed", what=str(error)[:120] or type(error).__name__) from error
    if not isinstance(value, dict):
        raise Refusal("malformed", what=f"an object is needed, not {type(value).__name__}")
    return value


def encode(message: dict[str, Any]) -> str:
    """Return JSON; NaN and infinity become null, because JSON has neither."""
    return json.dumps(_without_nan(message), separators=(",", ":"), allow_nan=False)


def _without_nan(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _without_nan(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(part) for part in value]
    return value


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not JSON")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is too large")
    return value


def _integer(text: str) -> int:
    if len(text) > 20:
        raise ValueError(f"an integer of {len(text)} digits is too large")
    return int(text)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError("a key stands twice")
    return value


def _typed(raw: dict[str, Any]) -> Message:
    read = _Reader(raw)
    kind = read.choice("type", KINDS)
    head: dict[str, Any] = {"seq": read.integer("seq"), "boot": read.text("boot"), "epoch": read.integer("epoch")}
    message: Message
    if kind == "alive":
        message = Alive(**head, client_ms=read.number("client_ms"))
    elif kind == "hidden":
        message = Hidden(**head)
    elif kind == "blind":
        message = Blind(**head, silence_ms=read.number("silence_ms"))
    elif kind == "stop":
        message = Stop(**head, press=read.text("press") if "press" in raw else "")
    elif kind == "lease":
        step = read.choice("step", LEASE_STEPS)
        message = Lease(**head, step=step, to=read.text("to") if step in ("grant", "decline") else "")
    elif kind == "select":
        control = read.text("control") if "control" in raw else ""
        point = (read.number("u"), read.number("v")) if "u" in raw else None
        to = (read.number("to_u"), read.number("to_v")) if point and "to_u" in raw else None
        x, y, to_x, to_y = (read.length(name) if _LINE[0] in raw else math.nan for name in _LINE)
        line = None if math.isnan(x) else (x, y, to_x, to_y)
        if bool(control) + bool(point) + bool(line) > 1:
            read.wrong("control", control, "either a control, a point or a line")
        message = Select(**head, **read.picture(), control=control, point_px=point, to_px=to, line_m=line)
    elif kind == "act":
        gesture = read.choice("gesture", GESTURES)
        mark = read.text("mark") if gesture == "set" and "mark" in raw else ""
        wants = gesture in _WITH_ARGUMENT or (gesture == "set" and not mark)
        message = Act(
            **head,
            gesture=gesture,
            argument=read.number("argument") if wants else math.nan,
            mark=mark,
            selection=read.integer("selection"),
            **read.picture(),
        )
    elif kind == "move":
        message = Move(**head, x_m=read.length("x_mm"), y_m=read.length("y_mm"), **read.picture())
    elif kind == "jog":
        message = Jog(**head, dx=read.sign("dx"), dy=read.sign("dy"), step_m=read.length("step_mm"), **read.picture())
    elif kind == "sequence":
        stored = read.text("stored") if "stored" in raw else ""
        steps = () if stored else read.texts("steps")
        message = RunSequence(**head, **read.picture(), stored=stored, steps=steps)
    elif kind == "hold":
        message = Hold(**head)
    elif kind == "teach":
        message = _teach(head, read)
    else:
        sent_s = read.number("sent_ms") / 1e3 if "sent_ms" in raw else math.inf
        message = Call(**head, service=read.choice("service", SERVICES), sent_s=sent_s)
    read.finish()
    return message


def _teach(head: dict[str, Any], read: _Reader) -> Teach:
    controls = []
    for row in read.rows("controls", 7, texts=2):
        name, kind, u, v, width, height, proud = row
        controls.append(PointedControl(name=name, kind=kind, pixel=(u, v), size_mm=(width, height), proud_mm=proud))
    corners = read.rows("corners", 2)
    if len(corners) != 4:
        read.wrong("corners", len(corners), "four corners")
    (size,) = read.rows("size_mm", 2, single=True)
    return Teach(
        **head,
        stamp_ns=read.stamp("stamp"),
        model=read.text("model"),
        title=read.text("title"),
        size_mm=size,
        corners=tuple(corners),
        controls=tuple(controls),
    )


class _Reader:
    """Reads fields of an object; its errors contain the field's name."""

    def __init__(self, raw: dict[str, Any]) -> None:
        self._raw = dict(raw)

    def wrong(self, name: str, value: Any, needed: str) -> NoReturn:
        raise Refusal("malformed", what=f"{name} = {str(value)[:40]!r}: {needed} is needed")

    def integer(self, name: str) -> int:
        value = self._raw.pop(name, None)
        if type(value) is not int or not 0 <= value < _MAX_INTEGER:
            self.wrong(name, value, "an integer from 0 to 2^53")
        return value

    def number(self, name: str) -> float:
        value = self._raw.pop(name, None)
        if type(value) not in (int, float) or not abs(value) < 1e15:
            self.wrong(name, value, "a number")
        return float(value)

    def length(self, name: str) -> float:
        """Return a field given in mm as metres; at most 1 m, because no distance on the bench is longer."""
        value = self.number(name)
        if abs(value) > 1000:
            self.wrong(name, value, "a length of at most 1000 mm")
        return value * 1e-3

    def sign(self, name: str) -> int:
        value = self._raw.pop(name, None)
        if type(value) is not int or value not in (-1, 0, 1):
            self.wrong(name, value, "-1, 0 or 1")
        return value

    def picture(self) -> dict[str, Any]:
        return {"camera": self.choice("camera", CAMERAS), "stamp_ns": self.stamp("stamp")}

    def text(self, name: str) -> str:
        """Return a text with composed letters, as names are stored."""
        value = self._raw.pop(name, None)
        composed = unicodedata.normalize("NFC", value) if isinstance(value, str) else ""
        if not isinstance(value, str) or len(composed) > MAX_TEXT or not composed.isprintable():
            self.wrong(name, value, "a text of up to 64 characters")
        return composed

    def texts(self, name: str) -> tuple[str, ...]:
        value = self._raw.pop(name, None)
        if not isinstance(value, list) or not 0 < len(value) <= MAX_STEPS:
            self.wrong(name, len(value) if isinstance(value, list) else value, f"1 to {MAX_STEPS} texts")
        for number, text in enumerate(value, 1):
            if not (isinstance(text, str) and len(text) <= 300 and text.isprintable()):
                self.wrong(f"{name} {number}", text, "a text of up to 300 characters, each of which can be seen,")
        return tuple(value)

    def rows(self, name: str, length: int, *, texts: int = 0, single: bool = False) -> list[Any]:
        """Return lists of ``length`` values as tuples: first ``texts`` short texts, then numbers."""
        value = self._raw.pop(name, None)
        rows = [value] if single else value
        if not isinstance(rows, list) or len(rows) > 100:
            self.wrong(name, value, "a list")
        for row in rows:
            good = isinstance(row, list) and len(row) == length
            good = good and all(isinstance(v, str) and len(v) <= 40 and v.isprintable() for v in row[:texts])
            if not good or not all(type(v) in (int, float) and abs(v) < 1e6 for v in row[texts:]):
                self.wrong(name, row, f"{texts} texts and {length - texts} numbers" if texts else f"{length} numbers")
        return [(*row[:texts], *map(float, row[texts:])) for row in rows]

    def choice(self, name: str, choices: tuple[str, ...]) -> str:
        value = self._raw.pop(name, None)
        if not isinstance(value, str) or value not in choices:
            self.wrong(name, value, "one of " + ", ".join(choices))
        return value

    def stamp(self, name: str) -> int:
        # Nanoseconds do not fit into a double, so the page returns them as the text it received.
        value = self.text(name)
        if not (value.isascii() and value.isdigit() and len(value) <= 20):
            self.wrong(name, value, "nanoseconds as a text of digits")
        return int(value)

    def finish(self) -> None:
        if self._raw:
            raise Refusal("malformed", what=f"unknown field {', '.join(sorted(self._raw))[:60]}")
