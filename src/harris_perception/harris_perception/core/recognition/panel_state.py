"""Reads a recognised panel: lit lamps, directions of knobs, changes of screens, and hidden controls.

All samples are taken through the panel's pose at the height of the control's top. The areas hidden by the robot's own
stylus and arm follow from the tip's position. Any other object shows in the print around a control, which then no
longer correlates with the template.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.image.sampling import sampled
from harris_perception.core.recognition.face_patches import Patches
from harris_perception.core.recognition.screen_watch import ScreenWatch
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control, PanelLayout, rgb
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen

Picture = npt.NDArray[np.uint8]
ANGLES = np.radians(np.arange(0.0, 360.0, 2.0))
RADII = np.linspace(0.36, 0.74, 6)
"""Directions and radii, relative to the knob's radius, at which a knob's marker is searched."""
_NEAREST_M, _FIELD = 0.05, 1.5
"""Minimum depth of the drawn part of a body that extends behind the camera, and its maximum distance from the image
centre, in half image sizes."""
_DARKEST_SHADE = 0.6
"""Minimum share of a control's light that the arm's shadow leaves; it does not change the hue."""
_PAINTED = 0.5
"""Minimum chroma of a dark lamp's paint, as a share of a lit lamp's, at which the paint may be mistaken for light."""
_LIGHT = 0.3, 3.0
"""Range of the room's brightness relative to usual; beyond it, an object covers all controls that measure it."""
HUES = ((20, "red"), (45, "amber"), (75, "yellow"), (165, "green"), (200, "cyan"), (265, "blue"), (345, "violet"))
"""Upper limits of the hues in degrees (HSV) and their names; above the last one is red again."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StateConfig(Config):
    """Settings of reading lamps, knobs and screens."""

    lit_chroma: float = setting(
        80.0, "Minimum chroma of a coloured lamp that is lit", minimum=5.0, maximum=255.0, unit="grey levels"
    )
    lit_gain: float = setting(
        1.3,
        "Minimum ratio of a lit white lamp's brightness to its surroundings, and of a lit lamp's on bright or "
        "coloured paint to the paint",
        minimum=1.0,
        maximum=20.0,
    )
    marker_contrast: float = setting(
        12.0,
        "Minimum difference between a knob's marker and the knob's top",
        minimum=1.0,
        maximum=255.0,
        unit="grey levels",
    )
    marker_unity: float = setting(
        0.95,
        "Minimum length of the mean direction of the marker's pixels; 1 is a single line",
        minimum=0.1,
        maximum=1.0,
    )
    cell_mm: float = setting(3.4, "Side of a screen cell", minimum=0.5, maximum=50.0, unit="mm")
    cell_change: float = setting(
        14.0,
        "Minimum difference of a cell at rest that counts as a change",
        minimum=1.0,
        maximum=255.0,
        unit="grey levels",
    )
    changed_cells: int = setting(
        5, "Minimum number of changed cells that count as a change of the screen", minimum=1, maximum=10000
    )
    cell_rest_s: float = setting(
        6.0,
        "Minimum time at rest before a screen cell counts; must exceed the period of periodic screen content",
        minimum=0.2,
        maximum=60.0,
        unit="s",
    )
    stylus_radius_m: float = setting(
        0.006, "Half width of the area that the shaft hides", minimum=1e-4, maximum=0.1, unit="m"
    )
    arm_half_width_m: float = setting(
        0.013, "Half width of the area that the arm hides", minimum=1e-4, maximum=0.2, unit="m"
    )
    arm_height_m: float = setting(
        0.070, "Height of the arm's underside above the panel's face", minimum=0.0, maximum=1.0, unit="m"
    )
    arm_top_m: float = setting(
        0.150, "Height of the top of shaft and arm above the panel's face", minimum=0.0, maximum=1.0, unit="m"
    )
    print_margin_mm: float = setting(
        9.0,
        "Width of the print around a control that shows whether the control is hidden",
        minimum=0.0,
        maximum=100.0,
        unit="mm",
    )
    odd_colour: float = setting(
        45.0,
        "Minimum difference from a control's usual colour for the control to count as hidden",
        minimum=1.0,
        maximum=255.0,
        unit="levels",
    )
    print_share: float = setting(
        0.5, "Minimum fraction of the print around a control that must match the template", minimum=0.0, maximum=1.0
    )


class PanelReader:
    """Reads successive images of one panel; remembers the usual appearance of its controls and screens.

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
        # All sampled points, so that an image needs one projection.
        self._parts: dict[tuple[str, str], slice] = {}
        points: list[Array] = []
        for control in layout.controls:
            for part, places in self._places(control).items():
                start = sum(map(len, points))
                self._parts[control.name, part] = slice(start, start + len(places))
                points.append(places)
        self._points = np.vstack(points)

    def _places(self, control: Control) -> dict[str, Array]:
        """Return the points (N, 3) in metres of panel_link that are sampled, by purpose."""
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
        """Read one image.

        Parameters
        ----------
        bgr
            (H, W, 3) uint8, raw.
        camera_from_panel
            The panel's pose, metres.
        camera
            The camera that took the image.
        stamp_ns
            Stamp of the image.
        patches
            Agreement of the print with the template; without it only the stylus counts as hiding controls.
        tip
            (3,) metres, the stylus's tip in the camera's rectified frame, if it is seen.
        wander_m
            Maximum distance of the tip from there if it was not seen in this image: controls within it may be hidden,
            and are not read.
        coloured
            Whether the camera has colour; without it coloured lamps are not read.
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
        # Paint may also look like a lit lamp: coloured, or much lighter than the surrounding face, which gives the
        # brightness.
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
        """Return the marker's direction: the mean direction of the pixels that differ from the rest of the top."""
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
        """Draw the area hidden by stylus and arm, (H, W) uint8; empty if the tip is not seen."""
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
        """Return the share of the print around each control that agrees; omits controls with too little print."""
        if patches is None:
            return {}
        # Patches that the stylus hides partly are not used either.
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
        """Return the controls that look covered: by the print around them, or by their own colour.

        A control's usual colour is learned; the room's light may change it, but changes all controls alike.
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
            # If the surrounding print agrees, an object that lies only on the control becomes usual after a while.
            if name not in self._usual or name not in odd:
                self._usual[name] = colour if name not in self._usual else 0.9 * self._usual[name] + 0.1 * colour
            elif prints.get(name, 0.0) > 0.9:
                self._usual[name] = 0.98 * self._usual[name] + 0.02 * colour
        return odd


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Look:
    """Samples of one image at all points: colours (N, 3), whether outside the image, whether behind the stylus.

    ``coloured`` is true if the image has colours.
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
    """Return the area that may be hidden after the tip (3,) m has moved by ``wander_m``, from its shadow (H, W)."""
    if tip is None or wander_m == 0:
        return shadow
    reach = min(math.ceil(wander_m * camera.k[0, 0] / max(float(tip[2]), _NEAREST_M)), max(camera.size))
    wide = cv2.dilate(shadow, np.ones((1, 2 * reach + 1), np.uint8))
    return np.asarray(cv2.dilate(wide, np.ones((2 * reach + 1, 1), np.uint8)), np.uint8)


def _before(camera: CameraModel, corners: Array) -> Array:
    """Return corners (M, 3) m with the same outline in the image as a convex body with corners (N, 3) m.

    A body that extends behind the camera, where points have no pixel, is cut to the part that may be in the image.
    """
    turned = corners @ camera.r
    depth = turned[:, 2] - _NEAREST_M
    ahead, behind = depth > 0, depth <= 0
    if ahead.all():
        return corners
    # Between each corner in front and each behind: the intersection of their line with the nearest depth.
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
        # A hand over stylus and control counts as a hand: it shows in the surrounding print, unless the stylus hides
        # that.
        if odd:
            return "something"
        if float((look.covered[where] > 0).mean()) > 0.1:
            return "stylus"
    return "something" if odd else ""


class _Screen:
    """Usual appearance of each cell of a screen, and the time of the last change of enough resting cells."""

    def __init__(self, control: Control, config: StateConfig) -> None:
        columns, rows = (max(4, round(side / config.cell_mm)) for side in control.size_mm)
        fine = 2  # samples per cell, in each direction
        x = (np.arange(columns * fine) + 0.5) / (columns * fine) * 2 - 1
        y = (np.arange(rows * fine) + 0.5) / (rows * fine) * 2 - 1
        grid = np.stack(np.meshgrid(0.98 * x, 0.98 * y), axis=-1).reshape(-1, 2)
        self.points_m = _on_top(control, grid)
        self.shape = (rows, fine, columns, fine)
        self._watch = ScreenWatch((rows, columns), config.cell_change, config.changed_cells, config.cell_rest_s)

    @property
    def changed_ns(self) -> int:
        """Stamp of the newest change."""
        return self._watch.changed_ns

    def cells(self, samples: Array) -> Array:
        """Return the means of the cells, (rows, columns, channels)."""
        means: Array = samples.reshape(*self.shape, -1).mean(axis=(1, 3))
        return means

    def add(self, samples: Array, hidden: npt.NDArray[np.bool_], stamp_ns: int, light: float) -> None:
        """Add one image's samples (N, 3), which of them are hidden (N,), and its brightness (1 is usual)."""
        seen = self.cells(hidden.astype(np.float64))[..., 0] == 0
        self._watch.add(self.cells(samples), seen, stamp_ns, light)


def _on_top(control: Control, grid: Array, height_mm: float | None = None) -> Array:
    """Return (N, 3) metres in panel_link of points (N, 2) on a control's top, in halves of its size."""
    half = np.array(control.size_mm) / 2
    xy = np.array(control.position_mm) + grid * half
    height = control.height_mm if height_mm is None else height_mm
    return np.asarray(np.column_stack([xy, np.full(len(xy), height)]) * 1e-3)


def _grid(count: int, reach: float) -> Array:
    """Return (count * count, 2) points from -reach to reach in each direction."""
    share = np.linspace(-reach, reach, count)
    return np.stack(np.meshgrid(share, share), axis=-1).reshape(-1, 2)


def _at(picture: Picture, pixels: Array) -> Array:
    """Return (N,) or (N, C) values of the image at pixels (N, 2), interpolated."""
    x, y = pixels.T
    return np.asarray(sampled(picture, x[None], y[None])[0], np.float64)


def _inside(pixels: Array, camera: CameraModel) -> npt.NDArray[np.bool_]:
    return np.asarray(((pixels >= 0) & (pixels <= np.array(camera.size) - 1.0)).all(axis=1))


def _hue(bgr: Array) -> str:
    pixel = np.clip(bgr, 0, 255).astype(np.uint8).reshape(1, 1, 3)
    hue = 2.0 * float(np.asarray(cv2.cvtColor(pixel, cv2.COLOR_BGR2HSV)).flat[0])
    return next((name for end, name in HUES if hue < end), "red")
