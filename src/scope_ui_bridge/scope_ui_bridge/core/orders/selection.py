"""The operator's selection (a control, a point, a line on a touch screen), and the gestures possible there."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from icu_common.core.geometry.frames import CAMERA_LEFT, PANEL
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult
from icu_common.core.panel.gesture import Gesture, GestureError, Point, parse_gesture
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen
from icu_common.core.reasons.message import Message
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.video import Face, VideoScene, moved_m
from scope_ui_bridge.core.wire import Refusal

_TOUCHES = ("press", "double", "long", "hold")
GESTURES_OF = {
    "button": _TOUCHES,
    "knob": ("turn", "click", "set", *_TOUCHES),
    "touch_area": _TOUCHES,
    "connector": (),
    "point": _TOUCHES,
    "line": ("drag",),
}
SHORTEST_LINE_M = 0.002


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The operator's selection, with the panel's pose and controls at that time.

    ``anchors`` are (N, 3) m in panel_link: the position of the control or point, or a line's two ends. ``pixels`` are
    those of a point or a line in the image of ``camera``. ``base_from_panel`` is the panel's pose by the calibration:
    cameras on the carriage may have moved since; a control is still the same then, but a pixel is not.
    """

    number: int
    camera: str
    control: str
    kind: str
    label: str
    anchors: Array
    camera_from_panel: Transform
    faces: tuple[Face, ...]
    gestures: tuple[str, ...]
    pixels: tuple[tuple[float, float], ...] = ()
    size_m: tuple[float, float] = (0.0, 0.0)
    base_from_panel: Transform | None = None

    def message(self) -> dict[str, Any]:
        """Return the message for the page."""
        places = [[round(float(v) * 1000, 1) for v in anchor[:2]] for anchor in self.anchors]
        return {
            "number": self.number,
            "camera": self.camera,
            "control": self.control,
            "kind": self.kind,
            "label": self.label,
            "pixel": list(self.pixels[0]) if self.pixels else None,
            "to_pixel": list(self.pixels[1]) if self.pixels[1:] else None,
            "panel_mm": places[0],
            "to_mm": places[1] if places[1:] else None,
            "size_mm": [round(side * 1000, 1) for side in self.size_m],
            "gestures": list(self.gestures),
        }

    @property
    def name(self) -> str:
        """Name of the selection as shown to people."""
        places = " → ".join(f"({x * 1e3:.1f}, {y * 1e3:.1f})" for x, y, _ in self.anchors)
        return self.label or self.control or f"{places} mm"

    def moved_m(self, camera_from_panel: Transform, camera_from_base: Transform | None) -> float:
        """Return the anchors' largest movement since then: a control's in base_link, else relative to the camera."""
        before, now = self.camera_from_panel, camera_from_panel
        if self.control and self.base_from_panel is not None and camera_from_base is not None:
            before, now = self.base_from_panel, camera_from_base.inverse() @ camera_from_panel
        return max(moved_m(before, now, anchor) for anchor in self.anchors)


def make_selection(
    number: int, message: wire.Select, scene: VideoScene, camera_from_panel: Transform, seen: PanelSeen | None
) -> Selection:
    """Return the selection requested by a message.

    Raises
    ------
    Refusal
        ``unknown_control``, ``not_operable``, ``point_needs_left``, ``off_picture``, ``panel_not_seen``,
        ``off_panel``; for a line also ``line_off_screen``, ``line_leaves_screen``, ``line_short``.
    """
    control, kind, label, size = "", "point", "", (0.0, 0.0)
    pixels: tuple[tuple[float, float], ...] = ()
    if message.control:
        face = scene.face(message.control)
        if face is None:
            raise Refusal("unknown_control", control=message.control)
        if not GESTURES_OF.get(face.kind):
            raise Refusal("not_operable", control=face.label, kind=face.kind)
        control, kind, label, size = face.name, face.kind, face.label, face.size
        anchors = np.array([face.centre])
    elif message.line_m is not None:
        kind, anchors = "line", _line_on_panel(message.line_m, scene)
        shown = scene.project(message.camera, camera_from_panel.apply(anchors))
        pixels = tuple((round(float(u), 1), round(float(v), 1)) for u, v in (() if shown is None else shown))
    elif message.to_px is not None:
        assert message.point_px is not None
        kind, pixels = "line", (message.point_px, message.to_px)
        anchors = _line_in_picture(message.camera, pixels, scene)
    else:
        assert message.point_px is not None
        pixels = (message.point_px,)
        anchors = _on_panel(message.camera, message.point_px, scene)[np.newaxis]
    base = scene.camera_from_base
    return Selection(
        number=number,
        camera=message.camera,
        control=control,
        kind=kind,
        label=label,
        anchors=anchors,
        camera_from_panel=camera_from_panel,
        faces=scene.faces,
        gestures=_gestures(kind, seen.control(control) if seen is not None else None),
        pixels=pixels,
        size_m=size,
        base_from_panel=None if base is None else base.inverse() @ camera_from_panel,
    )


def _gestures(kind: str, seen: ControlSeen | None) -> tuple[str, ...]:
    """Return the possible gestures; a knob's clicks and positions depend on what recognition sees of it."""
    clicks, marker = seen is not None and seen.detent_deg > 0, seen is not None
    able = {"click": clicks, "set": marker}
    return tuple(gesture for gesture in GESTURES_OF[kind] if able.get(gesture, True))


def _on_panel(camera: str, pixel: tuple[float, float], scene: VideoScene, height_m: float = 0.0) -> Array:
    if camera != "left":  # the only frame of a pixel goal is the left camera's
        raise Refusal("point_needs_left")
    if scene.left is not None:
        width, height = scene.left.size
        # Outside the image the distortion polynomial is meaningless; its result may not even be a number.
        if not (-0.5 <= pixel[0] <= width - 0.5 and -0.5 <= pixel[1] <= height - 0.5):
            raise Refusal("off_picture", u=pixel[0], v=pixel[1], width=width, height=height)
    point = scene.panel_point(pixel, height_m)
    if point is None:
        raise Refusal("panel_not_seen")
    if not scene.on_panel(point):
        raise Refusal("off_panel", x_mm=round(point[0] * 1e3), y_mm=round(point[1] * 1e3))
    return point


def _line_in_picture(camera: str, ends: tuple[tuple[float, float], ...], scene: VideoScene) -> Array:
    face = _screen(_on_panel(camera, ends[0], scene), scene)
    return _checked_line(np.array([_on_panel(camera, end, scene, face.centre[2]) for end in ends]), face)


def _line_on_panel(line_m: tuple[float, float, float, float], scene: VideoScene) -> Array:
    face = _screen(np.array(line_m[:2]), scene)
    return _checked_line(np.array([[*line_m[:2], face.centre[2]], [*line_m[2:], face.centre[2]]]), face)


def _screen(point: Array, scene: VideoScene) -> Face:
    found = [face for face in scene.faces if face.kind == "touch_area" and face.contains(point)]
    if not found:
        raise Refusal("line_off_screen", x_mm=round(point[0] * 1e3, 1), y_mm=round(point[1] * 1e3, 1))
    return found[0]


def _checked_line(ends: Array, face: Face) -> Array:
    for end in ends:
        if not face.contains(end):
            place = {"x_mm": round(end[0] * 1e3, 1), "y_mm": round(end[1] * 1e3, 1)}
            raise Refusal("line_leaves_screen", control=face.label, **place)
    length = float(np.linalg.norm(ends[1] - ends[0]))
    if length < SHORTEST_LINE_M:
        raise Refusal("line_short", length_mm=round(length * 1e3, 1), limit_mm=SHORTEST_LINE_M * 1e3)
    return ends


def make_gesture(selection: Selection, message: wire.Act, seen: PanelSeen | None, goal_id: str) -> Gesture:
    """Return the controller's command for a confirmation.

    Raises
    ------
    Refusal
        ``wrong_gesture``, ``unknown_mark``, or ``bad_gesture`` with the value and the limit.
    """
    if message.gesture not in selection.gestures:
        raise Refusal("wrong_gesture", gesture=message.gesture, kind=selection.kind)
    knob = seen.control(selection.control) if seen is not None else None
    if message.mark and (knob is None or message.mark not in dict(knob.marks)):
        known = ", ".join(name for name, _ in knob.marks) if knob is not None else ""
        raise Refusal("unknown_mark", mark=message.mark, known=known or "-")
    gesture = Gesture(
        kind=message.gesture,
        target=selection.control or _place(selection, 0),
        argument=message.argument,
        mark=message.mark,
        to=_place(selection, 1) if message.gesture == "drag" else None,
        id=goal_id,
    )
    try:
        return parse_gesture(gesture.text())
    except GestureError as error:
        raise Refusal("bad_gesture", what=str(error)) from error


def _place(selection: Selection, end: int) -> Point:
    # A line lies on the panel and moves with it; a point is the clicked pixel, on top of whatever is there.
    if selection.kind == "line":
        x, y = (round(float(v), 5) for v in selection.anchors[end][:2])
        return Point(x=x, y=y, frame=PANEL)
    u, v = selection.pixels[end]
    return Point(x=u, y=v, frame=CAMERA_LEFT)


def action_text(gesture: Gesture) -> str:
    """Return the gesture and its argument as shown in the command log."""
    if gesture.mark:
        return f"{gesture.kind} {gesture.mark}"
    return gesture.kind if math.isnan(gesture.argument) else f"{gesture.kind} {gesture.argument:g}"


def goal_words(goal: str, faces: Iterable[Face]) -> tuple[str, str]:
    """Return action and target of another client's goal, worded as a page's; unchanged without a control."""
    try:
        gesture = parse_gesture(goal.partition(" id=")[0])
    except GestureError:
        return goal if isinstance(goal, Message) else goal.partition(" id=")[0], ""
    label = next((face.label for face in faces if face.name == gesture.target), "")
    return (action_text(gesture), label) if label else (goal.partition(" id=")[0], "")


def result_words(result: GoalResult, faces: Iterable[Face]) -> GoalResult:
    """Return the result with the control's label in place of its name in reason and effect."""
    try:
        target = parse_gesture(result.goal.partition(" id=")[0]).target
    except GestureError:
        return result
    face = next((face for face in faces if face.name == target), None)
    if face is None:
        return result

    def labelled(text: str) -> str:
        if isinstance(text, Message):
            values = {name: labelled(value) if isinstance(value, str) else value for name, value in text.values.items()}
            return Message(text.code, **values)
        return re.sub(rf"\b{re.escape(face.name)}\b", lambda _: face.label, text)

    details = tuple((key, labelled(value) if key == "effect" else value) for key, value in result.details)
    return replace(result, reason=labelled(result.reason), details=details)
