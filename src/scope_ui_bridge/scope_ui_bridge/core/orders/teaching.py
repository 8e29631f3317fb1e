"""Teaching a panel from the page: an engineer's points in a held image, checked before a layout is written."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass

from icu_common.core.panel.panel_layout import CONTROL_KINDS
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.wire import Refusal

SIZE_MM = (20.0, 2000.0)
PROUD_MM = (0.0, 100.0)
SMALLEST_CONTROL_MM = 1.0
MAX_CONTROLS = 60
_MODEL = re.compile(r"[a-z][a-z0-9_]{0,31}\Z")
_CONTROL = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}\Z")


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldPicture:
    """The held image: its stamp, and its size in pixels."""

    stamp_ns: int
    width: int
    height: int


def teaching_text(message: wire.Teach, held: HeldPicture | None, request_id: str) -> str:
    """Return the request for perception.

    Raises
    ------
    Refusal
        ``teach_no_picture``, ``teach_name``, ``teach_kind``, ``teach_twice``, ``teach_number`` or ``teach_outside``.
    """
    if held is None or held.stamp_ns != message.stamp_ns:
        raise Refusal("teach_no_picture")
    if not _MODEL.match(message.model):
        raise Refusal("teach_name", field="model", found=message.model, example="pump_2")
    width, height = message.size_mm
    _within("width", width, *SIZE_MM)
    _within("height", height, *SIZE_MM)
    _within("controls", len(message.controls), 1, MAX_CONTROLS)
    for number, corner in enumerate(message.corners, 1):
        _inside(f"{number}", corner, held)
    names: set[str] = set()
    for control in message.controls:
        if not _CONTROL.match(control.name):
            raise Refusal("teach_name", field="control", found=control.name, example="RUN_STOP")
        if control.name in names:
            raise Refusal("teach_twice", control=control.name)
        names.add(control.name)
        if control.kind not in CONTROL_KINDS:
            raise Refusal("teach_kind", found=control.kind, known=", ".join(CONTROL_KINDS))
        _inside(control.name, control.pixel, held)
        _within("width", control.size_mm[0], SMALLEST_CONTROL_MM, width, control.name)
        _within("height", control.size_mm[1], SMALLEST_CONTROL_MM, height, control.name)
        _within("proud", control.proud_mm, *PROUD_MM, control.name)
    return json.dumps(
        {
            "id": request_id,
            "stamp": str(message.stamp_ns),
            "model": message.model,
            "title": message.title or message.model,
            "size_mm": [width, height],
            "corners": message.corners,
            "controls": [[c.name, c.kind, *c.pixel, *c.size_mm, c.proud_mm] for c in message.controls],
        }
    )


def _within(field: str, found: float, low: float, high: float, control: str = "") -> None:
    if not low <= found <= high:
        raise Refusal("teach_number", field=field, control=control, found=found, low=low, high=high)


def _inside(place: str, pixel: tuple[float, float], held: HeldPicture) -> None:
    u, v = pixel
    if not (0 <= u <= held.width - 1 and 0 <= v <= held.height - 1):
        raise Refusal("teach_outside", place=place, u=u, v=v, width=held.width, height=held.height)
