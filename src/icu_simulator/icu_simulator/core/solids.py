"""Ray casting of the panel's protruding parts: controls as upright prisms with side walls, shaded and antialiased.

Everything is in panel millimetres. A viewing ray is given by its point at height 0, ``xy0``, and by its sideways shift
per millimetre of height, ``lean``: at height h it is at ``xy0 + lean * h``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import Control
from icu_simulator.core.panel_texture import bgr

LAMP_DIRECTION = np.array([-0.5, 0.866])
"""Direction towards the light in the plane of the panel: above and slightly left."""
SHADOW_REACH = 0.45
"""Length of a shadow per height."""
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlState:
    """State of a control: depth in mm, rotation in degrees, colour of its lamp or ""."""

    sunk_mm: float = 0.0
    angle_deg: float = 0.0
    lamp: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hit:
    """Intersections of rays with a prism, all of one shape (...,): part, position, outward direction of the wall."""

    top: Mask
    wall: Mask
    x: Array
    y: Array
    height: Array
    normal_x: Array
    normal_y: Array


def cast(control: Control, top_mm: float, bottom_mm: float, xy0: tuple[Array, Array], lean: tuple[Array, Array]) -> Hit:
    """Intersect rays with the prism between two heights; coordinates come back relative to the control's centre."""
    cx, cy = control.position_mm
    top_x, top_y = xy0[0] + lean[0] * top_mm - cx, xy0[1] + lean[1] * top_mm - cy
    # From the top's height downwards: (dx, dy) is the displacement down to the bottom's height.
    dx, dy = lean[0] * (bottom_mm - top_mm), lean[1] * (bottom_mm - top_mm)
    if control.shape == "circle":
        radius = control.size_mm[0] / 2
        top = top_x**2 + top_y**2 <= radius**2
        a = np.maximum(dx**2 + dy**2, 1e-12)
        b = top_x * dx + top_y * dy
        c = top_x**2 + top_y**2 - radius**2
        root = b**2 - a * c
        t = (-b - np.sqrt(np.maximum(root, 0))) / a
        wall = ~top & (root > 0) & (t >= 0) & (t <= 1)
        x, y = top_x + t * dx, top_y + t * dy
        normal_x, normal_y = x / radius, y / radius
    else:
        half_x, half_y = control.size_mm[0] / 2, control.size_mm[1] / 2
        top = (np.abs(top_x) <= half_x) & (np.abs(top_y) <= half_y)
        safe_x, safe_y = np.where(np.abs(dx) < 1e-9, 1e-9, dx), np.where(np.abs(dy) < 1e-9, 1e-9, dy)
        enter_x, enter_y = (-np.sign(safe_x) * half_x - top_x) / safe_x, (-np.sign(safe_y) * half_y - top_y) / safe_y
        leave = np.minimum((np.sign(safe_x) * half_x - top_x) / safe_x, (np.sign(safe_y) * half_y - top_y) / safe_y)
        t = np.maximum(enter_x, enter_y)
        wall = ~top & (t >= 0) & (t <= 1) & (t <= leave)
        x, y = top_x + t * dx, top_y + t * dy
        normal_x = np.where(enter_x >= enter_y, -np.sign(safe_x), 0.0)
        normal_y = np.where(enter_x >= enter_y, 0.0, -np.sign(safe_y))
    height = np.where(top, top_mm, top_mm + t * (bottom_mm - top_mm))
    return Hit(
        top=top,
        wall=wall,
        x=np.where(top, top_x, x),
        y=np.where(top, top_y, y),
        height=height,
        normal_x=normal_x,
        normal_y=normal_y,
    )


def paint(control: Control, state: ControlState, hit: Hit) -> tuple[Array, Array]:
    """Return reflected and emitted light, (..., 3) BGR 0 to 255, at the hits on the control."""
    light = np.clip(hit.normal_x * LAMP_DIRECTION[0] + hit.normal_y * LAMP_DIRECTION[1], -1, 1)
    painter = {"knob": _knob, "connector": _connector}.get(control.kind, _button)
    return painter(control, state, hit, light)


def _button(control: Control, state: ControlState, hit: Hit, light: Array) -> tuple[Array, Array]:
    cap = bgr(control.colour)
    half = np.array(control.size_mm) / 2
    edge_x, edge_y = half[0] - np.abs(hit.x), half[1] - np.abs(hit.y)
    bevel = 0.7
    slope = np.where(edge_x < edge_y, np.sign(hit.x) * LAMP_DIRECTION[0], np.sign(hit.y) * LAMP_DIRECTION[1])
    near_edge = np.minimum(edge_x, edge_y) < bevel
    top_gain = np.where(near_edge, 0.88 + 0.16 * slope, 0.94 + 0.04 * hit.y / half[1])
    gain = np.where(hit.top, top_gain, 0.5 + 0.22 * light)
    emitted = np.zeros((*hit.x.shape, 3))
    reflected = gain[..., None] * cap
    if state.lamp:
        lamp = bgr(state.lamp)
        glow = np.where(hit.top & ~near_edge, 1.0, 0.55)[..., None]
        reflected = reflected * (1 - 0.88 * glow)
        centre = np.exp(-((hit.x / half[0]) ** 2 + (hit.y / half[1]) ** 2))[..., None]
        emitted = glow * (0.8 * lamp + 60 * centre * (lamp / 255 + 0.25))
    elif control.lit_colour:
        # The dark lens of an unlit lamp keeps a hint of its colour.
        inside = (hit.top & ~near_edge)[..., None]
        reflected = np.where(inside, reflected * 0.62 + 0.12 * bgr(control.lit_colour), reflected)
    return reflected, emitted


def _knob(control: Control, state: ControlState, hit: Hit, light: Array) -> tuple[Array, Array]:
    radius = control.size_mm[0] / 2
    r = np.hypot(hit.x, hit.y) / radius
    turned = np.arctan2(hit.y, hit.x) - np.radians(state.angle_deg)
    knurl = 1 + 0.3 * np.sin(28 * turned)
    rim = r > 0.86
    facing = (hit.x * LAMP_DIRECTION[0] + hit.y * LAMP_DIRECTION[1]) / radius
    top_gain = np.where(rim, (1.45 + 0.5 * facing) * (1 + 0.12 * np.sin(28 * turned)), 1.15 + 0.2 * facing)
    top_gain = np.where(np.abs(r - 0.84) < 0.03, 0.6, top_gain)
    wall_gain = (0.62 + 0.45 * light) * knurl * (0.75 + 0.25 * hit.height / control.height_mm)
    angle = np.radians(state.angle_deg)
    along = -hit.x * np.sin(angle) + hit.y * np.cos(angle)
    across = hit.x * np.cos(angle) + hit.y * np.sin(angle)
    if control.dimple is not None:
        # The bottom is in the dimple's own shadow, which a light from one side does not reach.
        inside = np.hypot(across - control.dimple.place_mm[0], along - control.dimple.place_mm[1])
        top_gain = np.where(inside < control.dimple.diameter_mm / 2, 0.9 * top_gain, top_gain)
    gain = np.where(hit.top, top_gain, wall_gain)
    reflected = gain[..., None] * bgr(control.colour)
    # The pointer: a white line from the middle towards the rim, up if the knob is at 0.
    pointer = hit.top & (np.abs(across) < 0.085 * radius + 0.25) & (along > 0.3 * radius) & (along < 0.8 * radius)
    reflected = np.where(pointer[..., None], np.array([236.0, 238.0, 236.0]), reflected)
    return reflected, np.zeros_like(reflected)


def _connector(control: Control, state: ControlState, hit: Hit, light: Array) -> tuple[Array, Array]:
    radius = control.size_mm[0] / 2
    r = np.hypot(hit.x, hit.y) / radius
    turned = np.arctan2(hit.y, hit.x)
    metal = bgr(control.colour)
    sheen = 0.95 + 0.28 * np.cos(2 * (turned - 2.1))
    band = np.where(np.abs(hit.height - 0.62 * control.height_mm) < 0.09 * control.height_mm, 0.55, 1.0)
    gain = np.where(hit.top, sheen, (0.62 + 0.5 * light + 0.12 * np.cos(3 * turned)) * band)
    reflected = gain[..., None] * metal
    hole = hit.top & (r < 0.68)
    reflected = np.where(hole[..., None], np.array([34.0, 34.0, 36.0]), reflected)
    sleeve = hit.top & (r < 0.46)
    reflected = np.where(sleeve[..., None], (0.9 + 0.1 * np.cos(turned))[..., None] * [205.0, 212.0, 214.0], reflected)
    pin = hit.top & (r < 0.15)
    reflected = np.where(pin[..., None], np.array([40.0, 120.0, 160.0]), reflected)
    return reflected, np.zeros_like(reflected)
