"""A page's text to a typed message: unknown fields and texts of more than 32 KiB are refused."""

from __future__ import annotations

import math
import re
from typing import Any

from icu_common.core.panel.gesture import GESTURES
from icu_common.core.reasons.message import Message
from scope_ui_bridge.core.wire.fields import Fields
from scope_ui_bridge.core.wire.refusal import Refusal
from scope_ui_bridge.core.wire.requests import (
    KINDS,
    LEASE_STEPS,
    SERVICES,
    Act,
    Alive,
    Blind,
    Call,
    Hidden,
    Hold,
    Jog,
    Lease,
    MoveTo,
    PageMessage,
    PointedControl,
    RunSequence,
    Select,
    StopAll,
    Teach,
)
from scope_ui_bridge.core.wire.strict_json import decode_object

MAX_BYTES = 32 * 1024
"""Maximum size of a message; the longest sequences and lessons within the other limits fit."""
MAX_STOP = 512
"""Maximum size of a stop, which is read even on a connection that sends too much."""
_SEQ_WITHIN = 300  # the page writes the number after the type
_SEQ = re.compile(r'"seq": ?([0-9]{1,15})[,}]')
_WITH_ARGUMENT = ("hold", "turn", "click")
_LINE = ("x_mm", "y_mm", "to_x_mm", "to_y_mm")


def decode(text: str | bytes) -> PageMessage:
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


def _typed(raw: dict[str, Any]) -> PageMessage:
    read = Fields(raw)
    kind = read.choice("type", KINDS)
    head: dict[str, Any] = {"seq": read.integer("seq"), "boot": read.text("boot"), "epoch": read.integer("epoch")}
    message: PageMessage
    if kind == "alive":
        message = Alive(**head, client_ms=read.number("client_ms"))
    elif kind == "hidden":
        message = Hidden(**head)
    elif kind == "blind":
        message = Blind(**head, silence_ms=read.number("silence_ms"))
    elif kind == "stop":
        message = StopAll(**head, press=read.text("press") if "press" in raw else "")
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
            read.wrong("control", control, Message("request.either_control_point_line"))
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
        message = MoveTo(**head, x_m=read.length("x_mm"), y_m=read.length("y_mm"), **read.picture())
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


def _teach(head: dict[str, Any], read: Fields) -> Teach:
    controls = []
    for row in read.rows("controls", 7, texts=2):
        name, kind, u, v, width, height, proud = row
        controls.append(PointedControl(name=name, kind=kind, pixel=(u, v), size_mm=(width, height), proud_mm=proud))
    corners = read.rows("corners", 2)
    if len(corners) != 4:
        read.wrong("corners", len(corners), Message("request.four_corners"))
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
