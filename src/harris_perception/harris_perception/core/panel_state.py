"""Reads a recognised panel: which lamps shine, where knobs point, whether a screen has changed, and what is hidden.

Everything is sampled through the panel's pose at the height of the control's top. What the robot's own stylus and arm
hide follows from the tip's place; what anything else hides shows in the print around a control, which then no longer
correlates with the template.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.face_patches import Patches
from harris_perception.core.sampling import sampled
from icu_common.core.camera_model import CameraModel
from icu_common.core.config import Config, setting
from icu_common.core.geometry import Array, Transform
from icu_common.core.panel_layout import Control, PanelLayout, rgb
from icu_common.core.panel_state import ControlSeen, PanelSeen

Picture = npt.NDArray[np.uint8]
ANGLES = np.radians(np.arange(0.0, 360.0, 2.0))
RADII = np.linspace(0.36, 0.74, 6)
"""Where a knob's marker is looked for: directions, and parts of its radius."""
QUIET_PICTURES = 4
"""A cell is at rest after so many pictures without a jump."""
_NEAREST_M, _FIELD = 0.05, 1.5
"""Of what reaches behind the camera, what is nearer or farther from the picture's middle than so many of its halves is
not drawn."""
_DARKEST_SHADE = 0.6
"""The arm's shadow leaves so much of a control's light, and its hue."""
_PAINTED = 0.5
"""From this part of a shining lamp's colour on its dark paint might be taken for one."""
_LIGHT = 0.3, 3.0
"""How bright it may be, as a part of what is usual; beyond, something lies over all that would tell."""
HUES = ((20, "red"), (45, "amber"), (75, "yellow"), (165, "green"), (200, "cyan"), (265, "blue"), (345, "violet"))
"""Upper ends of the hues in degrees (HSV) and their names; above the last one is red again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StateConfig(Config):
    """How lamps, knobs and screens are read."""

    lit_chroma: float = setting(
        80.0, "A lamp shines when its colour is at least this strong", minimum=5.0, maximum=255.0, unit="grey levels"
    )
    lit_gain: float = setting(
        1.3,
        "A white lamp shines when it is so many times brighter than what surrounds it, one in coloured paint than that",
        minimum=1.0,
        maximum=20.0,
    )
    marker_contrast: float = setting(
        12.0, "A knob's marker differs from its top by at least this", minimum=1.0, maximum=255.0, unit="grey levels"
    )
    marker_unity: float = setting(
        0.95, "Length of the mean direction of the marker's pixels; 1 is a single line", minimum=0.1, maximum=1.0
    )
    cell_mm: float = setting(3.4, "Side of a screen's cells", minimum=0.5, maximum=50.0, unit="mm")
    cell_change: float = setting(
        14.0, "A cell at rest has changed when it differs by this", minimum=1.0, maximum=255.0, unit="grey levels"
    )
    changed_cells: int = setting(5, "Cells that make a change of a screen", minimum=1, maximum=10000)
    stylus_radius_m: float = setting(0.006, "Half width of what the shaft hides", minimum=1e-4, maximum=0.1, unit="m")
    arm_half_width_m: float = setting(0.013, "Half width of what the arm hides", minimum=1e-4, maximum=0.2, unit="m")
    arm_height_m: float = setting(
        0.070, "Height of the arm's lower side above the panel's face", minimum=0.0, maximum=1.0, unit="m"
    )
    arm_top_m: float = setting(0.150, "Height up to which shaft and arm reach", minimum=0.0, maximum=1.0, unit="m")
    print_margin_mm: float = setting(
        9.0, "Print around a control that tells whether it is hidden", minimum=0.0, maximum=100.0, unit="mm"
    )
    odd_colour: float = setting(
        45.0, "A control is hidden when its colour is this far from its own", minimum=1.0, maximum=255.0, unit="levels"
    )
    print_share: float = setting(0.5, "Part of that print that must look like the template", minimum=0.0, maximum=1.0)


class PanelReader:
    """Reads picture after picture of one panel; remembers what its controls and screens usually look like.

    Parameters
    ----------
    layout
        The panel.
    config
        See :class:`StateConfig`.
    """

    def __init__(self, layout: PanelLayout, config: StateConfig | None = None) -> None:
        self.layout = layout
        self.config = config if config is not None else StateConfig()
        self._screens = {c.name: _Screen(c, self.config) for c in layout.controls if c.kind == "touch_area"}
        self._usual: dict[str, Array] = {}
        self._light = 1.0
        # All places that are sampled, so that a picture needs one projection.
        self._parts: dict[tuple[str, str], slice] = {}
        points: list[Array] = []
        for control in layout.controls:
            for part, places in self._places(control).items():
                start = sum(map(len, points))
                self._parts[control.name, part] = slice(start, start + len(places))
                points.append(places)
        self._points = np.vstack(points)

    def _places(self, control: Control) -> dict[str, Array]:
        """Return the places (N, 3) in metres of panel_link that are looked at, by what for."""
        if control.kind == "touch_area":
            return {"screen": self._screens[control.name].points_m}
        places = {"extent": _on_top(control, _grid(5, 0.8)), "top": _on_top(control, _grid(5, 0.6))}
        if control.kind == "knob":
            rays = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=-1)
            places["marker"] = _on_top(control, (RADII[:, None, None] * rays).reshape(-1, 2))
        elif control.lit_colour:
            edge = _grid(7, 1.0)
            edge = edge[np.abs(edge).max(axis=1) == 1] * (1 + 4.0 / np.array(control.size_mm))
            places["lamp"] = _on_top(control, _grid(7, 0.5))
            places["around"] = _on_top(control, edge, height_mm=0.0)
        return places

    def read(
        self,
        bgr: Picture,
        camera_from_panel: Transform,
        camera: CameraModel,
        stamp_ns: int,
        *,
        patches: Patches | None = None,
        tip: Array | None = None,
        wander_m: float = 0.0,
        coloured: bool = True,
    ) -> PanelSeen:
        """Read one picture.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8, raw.
        camera_from_panel
            The panel's pose, metres.
        camera
            The camera that took the picture.
        stamp_ns
            When it was taken.
        patches
            Where the print agrees with the template; without it nothing but the stylus counts as hiding.
        tip
            (3,) metres, the stylus's tip in the camera's rectified frame, when it is seen.
        wander_m
            How far the tip may be from there, where it was not seen in this very picture: what is so near may be
            hidden, and is not read.
        coloured
            Whether the camera sees colours: without them a coloured lamp is not read.
        """
        shadow = self._own_shadow(camera_from_panel, camera, tip)
        pixels = camera.project(camera_from_panel.apply(self._points))
        look = _Look(
            parts=self._parts,
            colours=_at(bgr, pixels),
            outside=~_inside(pixels, camera),
            covered=_at(_around(shadow, camera, tip, wander_m), pixels),
            coloured=coloured,
        )
        prints = self._prints(camera_from_panel, camera, shadow, patches)
        odd = self._odd(look, prints)
        return PanelSeen(
            stamp_ns=stamp_ns,
            controls=tuple(
                self._read_one(c, look, _hidden_by(c, look, c.name in odd), stamp_ns) for c in self.layout.controls
            ),
        )

    def _read_one(self, control: Control, look: _Look, hidden: str, stamp_ns: int) -> ControlSeen:
        lamp, angle, changed = "", math.nan, 0
        if control.kind == "touch_area":
            screen = self._screens[control.name]
            if hidden != "something":
                screen.add(look(control, "screen"), look.hidden(control, "screen"), stamp_ns, self._light)
            changed = screen.changed_ns
        elif not hidden and control.kind == "knob":
            angle = self._marker(look(control, "marker"))
        elif not hidden and control.lit_colour:
            lamp = self._lamp(control, look)
        return ControlSeen(
            name=control.name,
            kind=control.kind,
            hidden_by=hidden,
            lamp=lamp,
            angle_deg=angle,
            changed_ns=changed,
            detent_deg=control.detent_deg,
            marks=control.marks,
        )

    def _lamp(self, control: Control, look: _Look) -> str:
        colour, around = look(control, "lamp").mean(axis=0), look(control, "around")
        white = np.ptp(rgb(control.lit_colour)) < 60
        # Paint may look like a lamp, too: coloured, or much lighter than the face around, which tells the light.
        light = np.median(around) / max(float(np.median(rgb(self.layout.colour))), 1.0)
        paint = light * np.array(rgb(control.colour))
        gain, chroma = self.config.lit_gain, self.config.lit_chroma
        if white:
            of_paint, shines = (value.mean() > gain * np.median(around) for value in (paint, colour))
        elif look.coloured:
            of_paint, shines = np.ptp(paint) >= _PAINTED * chroma, np.ptp(colour) >= chroma
        else:
            return ""
        if not shines or (of_paint and colour.mean() <= gain * paint.mean()):
            return "off"
        return "white" if white else _hue(colour)

    def _marker(self, samples: Array) -> float:
        """Return where the marker points: the mean direction of the pixels that differ from the rest of the top."""
        gray = samples.mean(axis=1).reshape(len(RADII), -1)
        off = np.abs(gray - np.median(gray, axis=1, keepdims=True)).mean(axis=0)
        peak = float(np.sort(off)[-4:].mean())
        if peak < self.config.marker_contrast:
            return math.nan
        weight = np.clip(off - 0.5 * peak, 0, None)
        x, y = float(weight @ np.cos(ANGLES)), float(weight @ np.sin(ANGLES))
        if math.hypot(x, y) < self.config.marker_unity * float(weight.sum()):
            return math.nan
        return math.degrees(math.remainder(math.atan2(y, x) - math.pi / 2, 2 * math.pi))

    def _own_shadow(self, pose: Transform, camera: CameraModel, tip: Array | None) -> Picture:
        """Draw what stylus and arm hide, (H, W) uint8; nothing when the tip is not seen."""
        mask = np.zeros((camera.height, camera.width), np.uint8)
        if tip is None:
            return mask
        c = self.config
        x, y, z = pose.inverse().apply(tip)
        r, w = c.stylus_radius_m, c.arm_half_width_m
        shaft = [(x + i * r, y + j * r, h) for i in (-1, 1) for j in (-1, 1) for h in (z - r, c.arm_top_m)]
        arm = [
            (x + i * w, y + j, h) for i in (-1, 1) for j in (-w, 0.5) for h in (c.arm_height_m, c.arm_height_m + 0.02)
        ]
        for box in (shaft, arm):
            pixels = camera.project(_before(camera, pose.apply(np.array(box))))
            if len(pixels):
                hull = cv2.convexHull(np.clip(pixels, -4000, 8000).astype(np.float32))
                cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
        return mask

    def _prints(
        self, pose: Transform, camera: CameraModel, shadow: Picture, patches: Patches | None
    ) -> dict[str, float]:
        """Return which part of the print around each control looks as it should; without those that have too little."""
        if patches is None:
            return {}
        # What the stylus hides a part of tells nothing either.
        spots = patches.centres_mm[:, None] + 0.5 * patches.side_mm * _grid(3, 1.0)
        face = np.dstack([spots, np.zeros(spots.shape[:2])]).reshape(-1, 3) * 1e-3
        covered = _at(shadow, camera.project(pose.apply(face)))
        usable = ~(covered.reshape(spots.shape[:2]) > 0).any(axis=1)
        found = {}
        for control in self.layout.controls:
            reach = np.array(control.size_mm) / 2 + self.config.print_margin_mm
            near = usable & (np.abs(patches.centres_mm - control.position_mm) <= reach).all(axis=1)
            if int(near.sum()) >= 3:
                found[control.name] = float(patches.agreeing[near].mean())
        return found

    def _odd(self, look: _Look, prints: dict[str, float]) -> set[str]:
        """Return the controls that look as if something lay over them: by the print around, or by their own colour.

        A control's usual colour is learnt; the light of the room may change it, but all controls alike.
        """
        odd = {name for name, share in prints.items() if share < self.config.print_share}
        plain = [c for c in self.layout.controls if c.kind != "touch_area" and not c.lit_colour]
        plain = [c for c in plain if not look.hidden(c, "top").any()]
        now = {c.name: np.median(look(c, "top"), axis=0) for c in plain}
        known = [name for name in now if name in self._usual]
        ratios = [now[n].mean() / max(self._usual[n].mean(), 1.0) for n in known]
        if known:
            self._light = float(np.clip(np.median(ratios), *_LIGHT))
        for name in known:
            usual = self._light * self._usual[name]
            shade = np.clip(now[name].mean() / max(usual.mean(), 1.0), _DARKEST_SHADE, 1.0)
            if np.abs(now[name] - shade * usual).max() > self.config.odd_colour:
                odd.add(name)
        for name, colour in now.items():
            # Where the print around is as it should be, what lies on the control alone becomes usual after a while.
            if name not in self._usual or name not in odd:
                self._usual[name] = colour if name not in self._usual else 0.9 * self._usual[name] + 0.1 * colour
            elif prints.get(name, 0.0) > 0.9:
                self._usual[name] = 0.98 * self._usual[name] + 0.02 * colour
        return odd


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Look:
    """The samples of one picture at all places: colours (N, 3), whether outside of it, whether behind the stylus.

    ``coloured`` tells whether the picture has any.
    """

    parts: dict[tuple[str, str], slice]
    colours: Array
    outside: npt.NDArray[np.bool_]
    covered: Array
    coloured: bool

    def __call__(self, control: Control, part: str) -> Array:
        return self.colours[self.parts[control.name, part]]

    def hidden(self, control: Control, part: str) -> npt.NDArray[np.bool_]:
        where = self.parts[control.name, part]
        return np.asarray((self.covered[where] > 0) | self.outside[where])


def _around(shadow: Picture, camera: CameraModel, tip: Array | None, wander_m: float) -> Picture:
    """Return all that a shadow (H, W) may hide once the tip (3,) m has gone so far."""
    if tip is None or wander_m == 0:
        return shadow
    reach = min(math.ceil(wander_m * camera.k[0, 0] / max(float(tip[2]), _NEAREST_M)), max(camera.size))
    wide = cv2.dilate(shadow, np.ones((1, 2 * reach + 1), np.uint8))
    return np.asarray(cv2.dilate(wide, np.ones((2 * reach + 1, 1), np.uint8)), np.uint8)


def _before(camera: CameraModel, corners: Array) -> Array:
    """Return corners (M, 3) m that look as a convex body does, from all its corners (N, 3) m.

    Of a body that reaches behind the camera, where nothing has a pixel, only what can be in the picture is left.
    """
    turned = corners @ camera.r
    depth = turned[:, 2] - _NEAREST_M
    ahead, behind = depth > 0, depth <= 0
    if ahead.all():
        return corners
    # Between each corner ahead and each behind, where the line of both passes the nearest place.
    share = depth[ahead][:, None] / (depth[ahead][:, None] - depth[behind])
    near, far = turned[behind][None], turned[ahead][:, None]
    left = np.vstack([turned[ahead], (far + share[..., None] * (near - far)).reshape(-1, 3)])
    if not len(left):
        return left
    flat = cv2.convexHull((left[:, :2] / left[:, 2:]).astype(np.float32))
    focal, middle = camera.k[[0, 1], [0, 1]], camera.k[:2, 2]
    low, high = (_FIELD * (edge - middle) / focal for edge in (np.zeros(2), np.array(camera.size)))
    field = np.array([low, (high[0], low[1]), high, (low[0], high[1])], np.float32)
    _, cut = cv2.intersectConvexConvex(flat, field)
    if cut is None:
        return np.empty((0, 3))
    return np.column_stack([np.asarray(cut, np.float64).reshape(-1, 2), np.ones(len(cut))]) @ camera.r.T


def _hidden_by(control: Control, look: _Look, odd: bool) -> str:
    if control.kind != "touch_area":
        where = look.parts[control.name, "extent"]
        if look.outside[where].any():
            return "edge"
        # A hand over stylus and control is a hand: the print around tells, where the stylus leaves it in view.
        if odd:
            return "something"
        if float((look.covered[where] > 0).mean()) > 0.1:
            return "stylus"
    return "something" if odd else ""


class _Screen:
    """What each cell of one screen usually shows, and when enough of those at rest last took on another look."""

    def __init__(self, control: Control, config: StateConfig) -> None:
        self._config = config
        columns, rows = (max(4, round(side / config.cell_mm)) for side in control.size_mm)
        fine = 2  # samples of a cell, each way
        x = (np.arange(columns * fine) + 0.5) / (columns * fine) * 2 - 1
        y = (np.arange(rows * fine) + 0.5) / (rows * fine) * 2 - 1
        grid = np.stack(np.meshgrid(0.98 * x, 0.98 * y), axis=-1).reshape(-1, 2)
        self.points_m = _on_top(control, grid)
        self.shape = (rows, fine, columns, fine)
        self.changed_ns = 0
        self._usual = self._last = np.zeros((rows, columns, 3))
        self._quiet = np.full((rows, columns), -1)
        self._pending = np.zeros((rows, columns), bool)
        self._last_ns = 0
        self._light = 1.0

    def cells(self, samples: Array) -> Array:
        """Return the means of the cells, (rows, columns, channels)."""
        means: Array = samples.reshape(*self.shape, -1).mean(axis=(1, 3))
        return means

    def add(self, samples: Array, hidden: npt.NDArray[np.bool_], stamp_ns: int, light: float) -> None:
        """Take one picture's samples (N, 3), which of them are hidden (N,), and how bright it is; 1 is as usual."""
        value, seen = self.cells(samples), self.cells(hidden.astype(np.float64))[..., 0] == 0
        reach = self._config.cell_change
        jump = _unlit(value, self._last, light / self._light)
        off = _unlit(value, self._usual, light) > reach
        # Only cells that were at rest count, and only when they rest again: a trace never rests.
        settled = seen & self._pending & off & (jump < reach / 2)
        if int(settled.sum()) >= self._config.changed_cells:
            self.changed_ns = self._last_ns
        first = seen & (self._quiet < 0)
        pending = seen & off & (self._quiet >= QUIET_PICTURES)
        anew = (first | settled)[..., None]
        slow = np.where((seen & ~pending)[..., None], self._usual + 0.3 * (value - self._usual), self._usual)
        self._usual = np.where(anew, value, slow)
        self._quiet = np.where(seen, np.where(jump < reach / 2, self._quiet + 1, 0), self._quiet)
        self._quiet[settled] = QUIET_PICTURES
        self._quiet[first] = 0
        self._pending = pending
        self._last = np.where(seen[..., None], value, self._last)
        self._last_ns, self._light = stamp_ns, light


def _unlit(value: Array, before: Array, light: float) -> Array:
    """Return by how much cells (rows, columns, channels) have changed more than the light tells, (rows, columns).

    An exposure changes all that a screen shows, a lamp in the room only what it reflects.
    """
    low, high = before * min(light, 1.0), before * max(light, 1.0)
    return np.asarray(np.abs(value - np.clip(value, low, high)).max(axis=-1))


def _on_top(control: Control, grid: Array, height_mm: float | None = None) -> Array:
    """Return (N, 3) metres in panel_link of places (N, 2) on a control's top, in halves of its size."""
    half = np.array(control.size_mm) / 2
    xy = np.array(control.position_mm) + grid * half
    height = control.height_mm if height_mm is None else height_mm
    return np.asarray(np.column_stack([xy, np.full(len(xy), height)]) * 1e-3)


def _grid(count: int, reach: float) -> Array:
    """Return (count * count, 2) places from -reach to reach each way."""
    share = np.linspace(-reach, reach, count)
    return np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)


def _at(picture: Picture, pixels: Array) -> Array:
    """Return (N,) or (N, C) values of the picture at pixels (N, 2), interpolated."""
    x, y = pixels.T
    return np.asarray(sampled(picture, x[None], y[None])[0], np.float64)


def _inside(pixels: Array, camera: CameraModel) -> npt.NDArray[np.bool_]:
    return np.asarray(((pixels >= 0) & (pixels <= np.array(camera.size) - 1.0)).all(axis=1))


def _hue(bgr: Array) -> str:
    pixel = np.clip(bgr, 0, 255).astype(np.uint8).reshape(1, 1, 3)
    hue = 2.0 * float(np.asarray(cv2.cvtColor(pixel, cv2.COLOR_BGR2HSV)).flat[0])
    return next((name for end, name in HUES if hue < end), "red")
