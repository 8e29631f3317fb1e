"""Decides what the ball touches: surfaces with heights, buttons that sink, sides that are run into.

Everything is in panel millimetres; z is the height of the ball's centre above the face. The stylus is sprung: where a
surface stops the ball, the drive goes on and the difference is the overtravel, a measure of the force.

A ball in a knob's dimple slides on the bottom until it meets the wall, and takes the knob along from there; where the
wall goes another way than the ball, the ball climbs over the rim.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from icu_common.core.geometry import Array
from icu_common.core.panel_layout import Control, PanelLayout

FACE = "FACE"
"""Name of the bare face in events."""
BUTTON_TRAVEL_MM = 1.5
ACTUATION_MM = 0.7
"""A button acts when it is this deep, and has come up when it is above half of it."""
GRIP_MM = 0.05
"""Overtravel from which the ball turns a knob along."""
GRIP_RADIUS_MM = 1.0
"""Nearer to a knob's middle the ball only slides."""
STEP_MM = 0.1
DRAG_MM = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchEvent:
    """Something the ball did.

    ``kind``: contact, release, press, unpress, drag (a touch moved on), turn (``degrees``, counter-clockwise positive),
    collision, clear. ``tip_mm`` is the ball's true centre, ``overtravel_mm`` the greatest since contact for a release.
    """

    kind: str
    control: str
    time_s: float
    tip_mm: tuple[float, float, float]
    overtravel_mm: float = 0.0
    degrees: float = 0.0


@dataclass(slots=True)
class _Surface:
    control: Control
    sunk_mm: float = 0.0
    pressed: bool = False
    collided: bool = False
    distance_mm: float = math.inf

    def distance(self, x: float, y: float) -> float:
        """How far (x, y) is from the control's outline, 0 inside."""
        dx, dy = x - self.control.position_mm[0], y - self.control.position_mm[1]
        half_x, half_y = self.control.size_mm[0] / 2, self.control.size_mm[1] / 2
        if self.control.shape == "circle":
            return max(math.hypot(dx, dy) - half_x, 0.0)
        return math.hypot(max(abs(dx) - half_x, 0.0), max(abs(dy) - half_y, 0.0))

    @property
    def travel_mm(self) -> float:
        return min(BUTTON_TRAVEL_MM, self.control.height_mm) if self.control.kind == "button" else 0.0


@dataclass(slots=True)
class _Contact:
    name: str
    surface: _Surface | None
    overtravel_mm: float = 0.0
    turned_deg: float = 0.0
    reported_xy: tuple[float, float] = (0.0, 0.0)


@dataclass(slots=True)
class Touch:
    """The ball over one panel; :meth:`move` follows it."""

    layout: PanelLayout
    radius_mm: float
    on_event: Callable[[TouchEvent], None]
    knob_deg: Callable[[str], float]
    tip_mm: tuple[float, float, float] = (0.0, 0.0, 1000.0)
    _commanded: Array | None = None
    _surfaces: list[_Surface] = field(default_factory=list)
    _contact: _Contact | None = None
    _ceiling_mm: float = 0.0

    def __post_init__(self) -> None:
        self._surfaces = [_Surface(control) for control in self.layout.controls]
        self._ceiling_mm = max(c.height_mm for c in self.layout.controls) + self.radius_mm

    def sunk_mm(self) -> tuple[tuple[str, float], ...]:
        """Return the buttons that are down and by how much."""
        return tuple((s.control.name, s.sunk_mm) for s in self._surfaces if s.sunk_mm > 0)

    @property
    def contact(self) -> str:
        """What is touched now, "" when nothing is."""
        return self._contact.name if self._contact else ""

    def place(self, commanded_mm: Array, time_s: float) -> None:
        """Put the ball somewhere without a way, as after a gap in the motion samples."""
        self._commanded = np.array(commanded_mm, dtype=np.float64)
        for surface in self._surfaces:
            surface.distance_mm = math.inf
        self._settle(self._commanded, time_s, placed=True)

    def move(self, commanded_mm: Array, time_s: float, since_s: float) -> None:
        """Move the drive on a straight way to ``commanded_mm`` between two times; the ball follows as far as it can."""
        if self._commanded is None:
            self.place(commanded_mm, time_s)
            return
        start, way = self._commanded, np.asarray(commanded_mm, dtype=np.float64) - self._commanded
        low = min(start[2], start[2] + way[2])
        self._commanded = start + way
        if low > self._ceiling_mm and self._contact is None and not any(s.collided for s in self._surfaces):
            self.tip_mm = (float(commanded_mm[0]), float(commanded_mm[1]), float(commanded_mm[2]))
            for surface in self._surfaces:
                surface.distance_mm = math.inf
            return
        count = max(1, math.ceil(float(np.abs(way).max()) / STEP_MM))
        for i in range(1, count + 1):
            self._settle(start + way * (i / count), since_s + (time_s - since_s) * i / count)

    def _settle(self, commanded: Array, time_s: float, placed: bool = False) -> None:
        x, y, z = (float(v) for v in commanded)
        radius = self.radius_mm
        self._push_walls(x, y, z, time_s)
        width, height = self.layout.size_mm
        on_panel = -radius <= x <= width + radius and -radius <= y <= height + radius
        # What stops the ball (rigid) and what it feels first (free), as heights of its centre.
        rigid = radius if on_panel else -math.inf
        felt: tuple[float, _Surface | None] = (radius - z, None) if on_panel else (-math.inf, None)
        for surface in self._surfaces:
            control = surface.control
            distance = surface.distance(x, y)
            entered, surface.distance_mm = surface.distance_mm >= radius, distance
            surface_sunk = 0.0
            if distance < radius:
                # The ball's underside lies this high above its lowest point at the control's edge.
                free = control.height_mm + math.sqrt(radius**2 - distance**2) - self._recess_mm(control, x, y)
                if entered and not placed and control.height_mm > 0 and z < control.height_mm:
                    surface.collided = True
                    self._tell("collision", control.name, time_s, (x, y, z))
                if surface.collided and z >= control.height_mm + radius:
                    surface.collided = False
                if not surface.collided:
                    surface_sunk = min(max(free - z, 0.0), surface.travel_mm)
                    rigid = max(rigid, free - surface.travel_mm)
                    # Of two surfaces at one height the control is felt, not the face it lies in.
                    if free - z >= felt[0]:
                        felt = free - z, surface
            elif surface.collided:
                surface.collided = False
                self._tell("clear", control.name, time_s, (x, y, z))
            surface.sunk_mm = surface_sunk
        tip = (x, y, max(z, rigid))
        before, self.tip_mm = self.tip_mm, tip
        self._update_contact(felt[1], felt[0] > 0, before, tip, rigid - z, time_s)
        self._update_buttons(tip, rigid - z, time_s)

    def _update_contact(
        self,
        surface: _Surface | None,
        touching: bool,
        before: tuple[float, float, float],
        tip: tuple[float, float, float],
        overtravel: float,
        time_s: float,
    ) -> None:
        name = (surface.control.name if surface else FACE) if touching else ""
        contact = self._contact
        if contact is not None and contact.name != name:
            self._tell("release", contact.name, time_s, tip, contact.overtravel_mm, contact.turned_deg)
            contact = self._contact = None
        if not name:
            return
        if contact is None:
            self._contact = _Contact(name=name, surface=surface, reported_xy=tip[:2])
            self._tell("contact", name, time_s, tip, max(overtravel, 0.0))
            return
        contact.overtravel_mm = max(contact.overtravel_mm, overtravel)
        if surface is None:
            return
        if surface.control.kind == "knob" and overtravel >= GRIP_MM and not self._recess_mm(surface.control, *tip[:2]):
            degrees = _turned(surface.control, before, tip)
            if degrees:
                contact.turned_deg += degrees
                self._tell("turn", name, time_s, tip, overtravel, degrees)
        elif surface.control.kind == "touch_area" and math.dist(contact.reported_xy, tip[:2]) >= DRAG_MM:
            contact.reported_xy = tip[:2]
            self._tell("drag", name, time_s, tip, overtravel)

    def _dimple_at(self, knob: Control) -> tuple[float, float]:
        """Return where a knob's dimple is now."""
        assert knob.dimple is not None
        angle = math.radians(self.knob_deg(knob.name))
        x, y = knob.dimple.place_mm
        return (
            knob.position_mm[0] + x * math.cos(angle) - y * math.sin(angle),
            knob.position_mm[1] + x * math.sin(angle) + y * math.cos(angle),
        )

    def _recess_mm(self, control: Control, x: float, y: float) -> float:
        """Return how much deeper than on the control's top the ball can go at (x, y)."""
        if control.dimple is None:
            return 0.0
        to_rim = control.dimple.diameter_mm / 2 - math.dist((x, y), self._dimple_at(control))
        if to_rim <= 0:
            return 0.0
        over_rim = math.sqrt(self.radius_mm**2 - to_rim**2) if to_rim < self.radius_mm else -math.inf
        return self.radius_mm - max(over_rim, self.radius_mm - control.dimple.depth_mm)

    def _push_walls(self, x: float, y: float, z: float, time_s: float) -> None:
        """Turn the knob in whose dimple the ball is pressed, so far that its wall is where the ball goes."""
        contact = self._contact
        if contact is None or contact.surface is None or contact.surface.control.dimple is None:
            return
        knob = contact.surface.control
        sunk = knob.height_mm + self.radius_mm - self.tip_mm[2]
        if sunk < GRIP_MM or self.tip_mm[2] - z < GRIP_MM or not self._recess_mm(knob, *self.tip_mm[:2]):
            return
        # So deep the ball is so wide at the rim.
        wide = math.sqrt(self.radius_mm**2 - max(self.radius_mm - sunk, 0.0) ** 2)
        play = max(contact.surface.control.dimple.diameter_mm / 2 - wide, 0.0)
        cx, cy = knob.position_mm
        place = self._dimple_at(knob)
        arm, reach = math.dist(place, (cx, cy)), math.dist((x, y), (cx, cy))
        if not arm * reach:
            return
        behind = math.atan2(y - cy, x - cx) - math.atan2(place[1] - cy, place[0] - cx)
        behind = math.remainder(behind, 2 * math.pi)
        free = math.acos(min(max((arm**2 + reach**2 - play**2) / (2 * arm * reach), -1.0), 1.0))
        if abs(behind) > free:
            degrees = math.degrees(math.copysign(abs(behind) - free, behind))
            contact.turned_deg += degrees
            self._tell("turn", knob.name, time_s, self.tip_mm, self.tip_mm[2] - z, degrees)

    def _update_buttons(self, tip: tuple[float, float, float], overtravel: float, time_s: float) -> None:
        for surface in self._surfaces:
            if not surface.pressed and surface.sunk_mm >= min(ACTUATION_MM, surface.travel_mm) > 0:
                surface.pressed = True
                self._tell("press", surface.control.name, time_s, tip, max(overtravel, 0.0))
            elif surface.pressed and surface.sunk_mm < ACTUATION_MM / 2:
                surface.pressed = False
                self._tell("unpress", surface.control.name, time_s, tip)

    def _tell(
        self,
        kind: str,
        control: str,
        time_s: float,
        tip: tuple[float, float, float],
        overtravel: float = 0.0,
        degrees: float = 0.0,
    ) -> None:
        self.on_event(
            TouchEvent(kind=kind, control=control, time_s=time_s, tip_mm=tip, overtravel_mm=overtravel, degrees=degrees)
        )


def _turned(knob: Control, before: tuple[float, float, float], after: tuple[float, float, float]) -> float:
    """Return by how many degrees a knob goes along with the ball that grips its face."""
    cx, cy = knob.position_mm
    if min(math.hypot(before[0] - cx, before[1] - cy), math.hypot(after[0] - cx, after[1] - cy)) < GRIP_RADIUS_MM:
        return 0.0
    angle = math.atan2(after[1] - cy, after[0] - cx) - math.atan2(before[1] - cy, before[0] - cx)
    return math.degrees(math.remainder(angle, 2 * math.pi))
