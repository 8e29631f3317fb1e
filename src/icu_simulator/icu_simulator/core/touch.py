"""Contact of the ball: surfaces with heights, buttons that sink, collisions with sides.

Everything is in panel millimetres; z is the height of the ball's centre above the face. The stylus is sprung: when a
surface stops the ball, the drive continues, and the difference is the overtravel, which is the spring's compression. A
key stops the ball as far as its force exceeds the spring's; see :mod:`icu_simulator.keys`.

A ball in a knob's dimple slides on the bottom until it reaches the wall, and then turns the knob. If the wall moves in
another direction than the ball, the ball climbs over the rim.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import Control, PanelLayout
from icu_simulator.keys.configuration import KeysConfig
from icu_simulator.keys.curve import ForceCurve
from icu_simulator.mechanisms.configuration import MechanismsConfig
from icu_simulator.mechanisms.contact import HeldBall, knob_turns, runs_on_deg, share_push, stiffness_n_mm
from icu_simulator.mechanisms.spring import SpringConfig

FACE = "FACE"
"""Name of the bare face in events."""
GRIP_MM = 0.05
"""Minimum overtravel in mm with which the ball turns a knob."""
GRIP_RADIUS_MM = 1.0
"""Minimum distance in mm from a knob's middle to turn it; nearer the ball only slides."""
STILL_S = 0.02
"""Seconds without a turn after which a knob counts as at rest."""
STEP_MM = 0.1
DRAG_MM = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchEvent:
    """Event of the ball.

    ``kind``: contact, release, press, unpress, drag (a touch moved), turn (``degrees``, counter-clockwise positive),
    collision, clear. ``tip_mm`` is the ball's true centre, ``overtravel_mm`` for a release the maximum since contact;
    ``force_n`` is the spring's force at this overtravel.
    """

    kind: str
    control: str
    time_s: float
    tip_mm: tuple[float, float, float]
    overtravel_mm: float = 0.0
    degrees: float = 0.0
    force_n: float = 0.0


@dataclass(slots=True)
class _Surface:
    control: Control
    curve: ForceCurve
    sunk_mm: float = 0.0
    pressed: bool = False
    collided: bool = False
    distance_mm: float = math.inf

    def distance(self, x: float, y: float) -> float:
        """Distance of (x, y) from the control's outline, 0 inside."""
        dx, dy = x - self.control.position_mm[0], y - self.control.position_mm[1]
        half_x, half_y = self.control.size_mm[0] / 2, self.control.size_mm[1] / 2
        if self.control.shape == "circle":
            return max(math.hypot(dx, dy) - half_x, 0.0)
        return math.hypot(max(abs(dx) - half_x, 0.0), max(abs(dy) - half_y, 0.0))

    @property
    def travel_mm(self) -> float:
        return self.curve.travel_mm


@dataclass(slots=True)
class _Contact:
    name: str
    surface: _Surface | None
    overtravel_mm: float = 0.0
    turned_deg: float = 0.0
    reported_xy: tuple[float, float] = (0.0, 0.0)
    _turned_s: float = -math.inf
    _speed_deg_s: float = 0.0

    def turn(self, degrees: float, time_s: float) -> None:
        """Record a part of a turn, for the knob's speed."""
        dt = time_s - self._turned_s
        self._speed_deg_s = degrees / dt if 0 < dt < STILL_S else 0.0
        self._turned_s = time_s

    def speed_deg_s(self, time_s: float) -> float:
        """Return the knob's speed at a time in degrees per second."""
        return self._speed_deg_s if time_s - self._turned_s < STILL_S else 0.0


@dataclass(slots=True)
class BenchTouch:
    """The ball over one panel; :meth:`move` follows it."""

    layout: PanelLayout
    radius_mm: float
    on_event: Callable[[TouchEvent], None]
    knob_deg: Callable[[str], float]
    keys: KeysConfig = field(default_factory=KeysConfig)
    spring: SpringConfig = field(default_factory=SpringConfig)
    mechanisms: MechanismsConfig = field(default_factory=MechanismsConfig)
    tip_mm: tuple[float, float, float] = (0.0, 0.0, 1000.0)
    compression_mm: float = 0.0
    """Overtravel of the drive while the ball is stopped, in mm."""
    force_n: float = 0.0
    """Force of the ball on the touched surface in newtons."""
    sinking_mm: float = 0.0
    """Sinking of the instrument below the ball in mm."""
    _ball: HeldBall = field(default_factory=HeldBall)
    _slide_mm: tuple[float, float] = (0.0, 0.0)
    _commanded: Array | None = None
    _surfaces: list[_Surface] = field(default_factory=list)
    _contact: _Contact | None = None
    _ceiling_mm: float = 0.0

    def __post_init__(self) -> None:
        check_keys(self.keys, self.layout)
        self._surfaces = [_Surface(control, _curve(control, self.keys)) for control in self.layout.controls]
        self._ceiling_mm = max(c.height_mm for c in self.layout.controls) + self.radius_mm

    def rebuild_keys(self, keys: KeysConfig, spring: SpringConfig) -> None:
        """Apply other keys and another spring; the ball and the keys keep their positions."""
        check_keys(keys, self.layout)
        self.keys, self.spring = keys, spring
        for surface in self._surfaces:
            surface.curve = _curve(surface.control, keys)

    def sunk_mm(self) -> tuple[tuple[str, float], ...]:
        """Return the pressed buttons and their depths in mm."""
        return tuple((s.control.name, s.sunk_mm) for s in self._surfaces if s.sunk_mm > 0)

    @property
    def side_force_n(self) -> float:
        """Sideways force on the panel in newtons."""
        return self._ball.side_force_n(self.mechanisms.bending)

    def take_slide(self) -> tuple[float, float]:
        """Return the distance by which the panel was pushed since the last call, in mm along its own axes.

        The panel's frame moves too, so the position of the drive in it changes.
        """
        dx, dy = self._slide_mm
        if (dx or dy) and self._commanded is not None:
            self._slide_mm = (0.0, 0.0)
            self._commanded = self._commanded - np.array([dx, dy, 0.0])
        return dx, dy

    @property
    def contact(self) -> str:
        """Name of the touched surface, "" without contact."""
        return self._contact.name if self._contact else ""

    def is_near(self, margin_mm: float) -> bool:
        """Return whether the ball is lower than ``margin_mm`` above the highest control."""
        return self.tip_mm[2] < self._ceiling_mm + margin_mm

    def place(self, commanded_mm: Array, time_s: float) -> None:
        """Set the ball to a position without a path, as after a gap in the motion samples."""
        self._commanded = np.array(commanded_mm, dtype=np.float64)
        for surface in self._surfaces:
            surface.distance_mm = math.inf
        self._settle(self._commanded, time_s, placed=True)

    def move(self, commanded_mm: Array, time_s: float, since_s: float) -> None:
        """Move the drive straight to ``commanded_mm`` between two times; the ball follows as far as it can."""
        if self._commanded is None:
            self.place(commanded_mm, time_s)
            return
        start, way = self._commanded, np.asarray(commanded_mm, dtype=np.float64) - self._commanded
        low = min(start[2], start[2] + way[2])
        self._commanded = start + way
        if low > self._ceiling_mm and self._contact is None and not any(s.collided for s in self._surfaces):
            self.compression_mm = self.force_n = self.sinking_mm = 0.0
            self.tip_mm = (float(commanded_mm[0]), float(commanded_mm[1]), float(commanded_mm[2]))
            for surface in self._surfaces:
                surface.distance_mm = math.inf
            return
        count = max(1, math.ceil(float(np.abs(way).max()) / STEP_MM))
        for i in range(1, count + 1):
            self._settle(start + way * (i / count), since_s + (time_s - since_s) * i / count)

    def _settle(self, commanded: Array, time_s: float, placed: bool = False) -> None:
        x, y, z = (float(v) for v in commanded)
        x, y = self._held(x, y)
        radius, push, stiffness = self.radius_mm, self.spring.push, math.inf
        if self.mechanisms.mount.enabled:
            stiffness = stiffness_n_mm((x, y), self.layout.size_mm, self.mechanisms.mount)
            push = self.spring.in_series(stiffness)
        self._push_walls(x, y, z, time_s)
        width, height = self.layout.size_mm
        on_panel = -radius <= x <= width + radius and -radius <= y <= height + radius
        # The surface that stops the ball (rigid) and the first one it touches (free), as heights of its centre.
        rigid = radius if on_panel else -math.inf
        felt: tuple[float, _Surface | None] = (radius - z, None) if on_panel else (-math.inf, None)
        for surface in self._surfaces:
            control = surface.control
            distance = surface.distance(x, y)
            entered, surface.distance_mm = surface.distance_mm >= radius, distance
            surface_sunk = 0.0
            if distance < radius:
                # Height of the ball's underside above its lowest point at the control's edge.
                free = control.height_mm + math.sqrt(radius**2 - distance**2) - self._recess_mm(control, x, y)
                if entered and not placed and control.height_mm > 0 and z < control.height_mm:
                    surface.collided = True
                    self._tell("collision", control.name, time_s, (x, y, z))
                if surface.collided and z >= control.height_mm + radius:
                    surface.collided = False
                if not surface.collided:
                    surface_sunk = surface.curve.stroke(surface.sunk_mm, free - z, push)
                    # A key that yields to the drive does not stop the ball before the end of its travel.
                    held = surface_sunk < min(free - z, surface.travel_mm)
                    rigid = max(rigid, free - (surface_sunk if held else surface.travel_mm))
                    # Of two surfaces at one height the control counts, not the face around it.
                    if free - z >= felt[0]:
                        felt = free - z, surface
            elif surface.collided:
                surface.collided = False
                self._tell("clear", control.name, time_s, (x, y, z))
            surface.sunk_mm = surface_sunk
        pushed = max(rigid - z, 0.0)
        self.compression_mm, self.sinking_mm = pushed, 0.0
        if stiffness < math.inf:
            self.compression_mm, self.sinking_mm = share_push(pushed, stiffness, self.spring)
        self.force_n = self.spring.force_n(self.compression_mm)
        if self.sinking_mm > 0 and self.compression_mm == 0:
            self.force_n = stiffness * self.sinking_mm
        tip = (x, y, max(z, rigid) - self.sinking_mm)
        before, self.tip_mm = self.tip_mm, tip
        overtravel = rigid - z - self.sinking_mm
        self._update_contact(felt[1], felt[0] > 0, before, tip, overtravel, time_s)
        self._update_buttons(tip, overtravel, time_s)

    def _held(self, x: float, y: float) -> tuple[float, float]:
        """Return the position in which friction holds the ball; move the panel along if that needs less force."""
        bending, mount = self.mechanisms.bending, self.mechanisms.mount
        if not bending.enabled:
            return x, y
        ball = self._ball
        held = ball.follow((x - self._slide_mm[0], y - self._slide_mm[1]), self.force_n, bending)
        if mount.enabled and self.force_n > 0 and ball.side_force_n(bending) > mount.slide_n:
            dx, dy = ball.lag_mm
            share = 1 - mount.slide_n / ball.side_force_n(bending)
            self._slide_mm = (self._slide_mm[0] + dx * share, self._slide_mm[1] + dy * share)
            ball.lag_mm = (dx * (1 - share), dy * (1 - share))  # in the moved frame of the next call
        return held

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
            run_on = runs_on_deg(contact.speed_deg_s(time_s), self.mechanisms.knob)
            if run_on:
                contact.turned_deg += run_on
                self._tell("turn", contact.name, time_s, tip, 0.0, run_on)
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
            arm_mm = math.dist(surface.control.position_mm, tip[:2])
            turns = knob_turns(self.force_n, arm_mm, self.mechanisms.knob)
            degrees = _turned(surface.control, before, tip) if turns else 0.0
            if degrees:
                contact.turned_deg += degrees
                contact.turn(degrees, time_s)
                self._tell("turn", name, time_s, tip, overtravel, degrees)
        elif surface.control.kind == "touch_area" and math.dist(contact.reported_xy, tip[:2]) >= DRAG_MM:
            contact.reported_xy = tip[:2]
            self._tell("drag", name, time_s, tip, overtravel)

    def _dimple_at(self, knob: Control) -> tuple[float, float]:
        """Return the present position of a knob's dimple."""
        assert knob.dimple is not None
        angle = math.radians(self.knob_deg(knob.name))
        x, y = knob.dimple.place_mm
        return (
            knob.position_mm[0] + x * math.cos(angle) - y * math.sin(angle),
            knob.position_mm[1] + x * math.sin(angle) + y * math.cos(angle),
        )

    def _recess_mm(self, control: Control, x: float, y: float) -> float:
        """Return how much deeper than the control's top the ball can go at (x, y)."""
        if control.dimple is None:
            return 0.0
        to_rim = control.dimple.diameter_mm / 2 - math.dist((x, y), self._dimple_at(control))
        if to_rim <= 0:
            return 0.0
        over_rim = math.sqrt(self.radius_mm**2 - to_rim**2) if to_rim < self.radius_mm else -math.inf
        return self.radius_mm - max(over_rim, self.radius_mm - control.dimple.depth_mm)

    def _push_walls(self, x: float, y: float, z: float, time_s: float) -> None:
        """Turn the knob in whose dimple the ball is pressed until the wall is at the new position of the ball."""
        contact = self._contact
        if contact is None or contact.surface is None or contact.surface.control.dimple is None:
            return
        knob = contact.surface.control
        sunk = knob.height_mm + self.radius_mm - self.tip_mm[2]
        if sunk < GRIP_MM or self.tip_mm[2] - z < GRIP_MM or not self._recess_mm(knob, *self.tip_mm[:2]):
            return
        # Half width of the ball at the rim at this depth.
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
            if not surface.pressed and surface.sunk_mm >= surface.curve.acts_mm > 0:
                surface.pressed = True
                self._tell("press", surface.control.name, time_s, tip, max(overtravel, 0.0))
            elif surface.pressed and surface.sunk_mm < surface.curve.comes_up_mm:
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
            TouchEvent(
                kind=kind,
                control=control,
                time_s=time_s,
                tip_mm=tip,
                overtravel_mm=overtravel,
                degrees=degrees,
                force_n=self.spring.force_n(overtravel),
            )
        )


def check_keys(keys: KeysConfig, layout: PanelLayout) -> None:
    """Raise :class:`ConfigError` if ``keys`` names a control that the panel does not have as a button."""
    buttons = [control.name for control in layout.controls if control.kind == "button"]
    unknown = sorted(set(keys.exceptions()) - set(buttons))
    if unknown:
        raise ConfigError(f"keys.controls names {', '.join(unknown)}; the panel's buttons are {', '.join(buttons)}")


def _curve(control: Control, keys: KeysConfig) -> ForceCurve:
    key = keys.key_of(control.name)
    return ForceCurve(key, min(key.travel_mm, control.height_mm) if control.kind == "button" else 0.0)


def _turned(knob: Control, before: tuple[float, float, float], after: tuple[float, float, float]) -> float:
    """Return by how many degrees the ball that grips a knob's face turns the knob."""
    cx, cy = knob.position_mm
    if min(math.hypot(before[0] - cx, before[1] - cy), math.hypot(after[0] - cx, after[1] - cy)) < GRIP_RADIUS_MM:
        return 0.0
    angle = math.atan2(after[1] - cy, after[0] - cx) - math.atan2(before[1] - cy, before[0] - cx)
    return math.degrees(math.remainder(angle, 2 * math.pi))
