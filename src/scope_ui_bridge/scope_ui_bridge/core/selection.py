"""What the operator has chosen: a control, or a point of the panel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from icu_common.core.geometry import Array, Transform
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.refusal import Refusal
from scope_ui_bridge.core.scene import Scene

GESTURES_OF = {
    "button": ("press", "hold"),
    "knob": ("turn", "press"),
    "touch_area": ("press", "hold"),
    "connector": (),
    "point": ("press", "hold"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """What the operator has chosen, and where the panel was then."""

    number: int
    camera: str
    control: str
    kind: str
    label: str
    pixel: tuple[float, float] | None
    in_panel: Array
    camera_from_panel: Transform

    def message(self) -> dict[str, Any]:
        """Return what the page gets."""
        x_mm, y_mm = (round(float(v) * 1000, 1) for v in self.in_panel[:2])
        return {
            "number": self.number,
            "camera": self.camera,
            "control": self.control,
            "kind": self.kind,
            "label": self.label,
            "pixel": list(self.pixel) if self.pixel else None,
            "panel_mm": [x_mm, y_mm],
            "gestures": list(GESTURES_OF.get(self.kind, ())),
        }

    @property
    def name(self) -> str:
        """What people call it."""
        return self.label or self.control or "({:.1f}, {:.1f}) mm".format(*self.message()["panel_mm"])


def make_selection(number: int, message: wire.Select, scene: Scene, camera_from_panel: Transform) -> Selection:
    """Return the selection that a message asks for.

    Raises
    ------
    Refusal
        ``unknown_control``, ``not_operable``, ``point_needs_left``, ``panel_not_seen`` or ``off_panel``.
    """
    if message.control:
        face = scene.face(message.control)
        if face is None:
            raise Refusal("unknown_control", control=message.control)
        if not GESTURES_OF.get(face.kind):
            raise Refusal("not_operable", control=face.label, kind=face.kind)
        found = (face.name, face.kind, face.label, np.array(face.centre))
    else:
        assert message.point_px is not None
        found = ("", "point", "", _on_panel(message.camera, message.point_px, scene))
    return Selection(
        number=number,
        camera=message.camera,
        control=found[0],
        kind=found[1],
        label=found[2],
        pixel=message.point_px,
        in_panel=found[3],
        camera_from_panel=camera_from_panel,
    )


def _on_panel(camera: str, pixel: tuple[float, float], scene: Scene) -> Array:
    if camera != "left":  # a pixel goal has no other frame than the left camera's
        raise Refusal("point_needs_left")
    point = scene.panel_point(pixel)
    if point is None:
        raise Refusal("panel_not_seen")
    if not scene.on_panel(point):
        raise Refusal("off_panel", x_mm=round(point[0] * 1e3), y_mm=round(point[1] * 1e3))
    return point
