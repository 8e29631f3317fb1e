"""Reads a recognised panel: lit lamps, directions of knobs, changes of screens, and hidden controls.

All samples are taken through the panel's pose at the height of the control's top. The areas hidden by the robot's own
stylus and arm follow from the tip's position. Any other object shows in the print around a control, which then no
longer correlates with the template.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.recognition.control_samples import ControlSamples, is_inside, on_top, square_grid, values_at
from harris_perception.core.recognition.face_patches import Patches
from harris_perception.core.recognition.own_shadow import own_shadow, widened
from harris_perception.core.recognition.screen_watch import ScreenCells
from harris_perception.core.recognition.state_config import StateConfig
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control, PanelLayout, rgb
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen

Picture = npt.NDArray[np.uint8]
ANGLES = np.radians(np.arange(0.0, 360.0, 2.0))
RADII = np.linspace(0.36, 0.74, 6)
"""Directions and radii, relative to the knob's radius, at which a knob's marker is searched."""
_DARKEST_SHADE = 0.6
"""Minimum share of a control's light that the arm's shadow leaves; it does not change the hue."""
_PAINTED = 0.5
"""Minimum chroma of a dark lamp's paint, as a share of a lit lamp's, at which the paint may be mistaken for light."""
_LIGHT = 0.3, 3.0
"""Range of the room's brightness relative to usual; beyond it, an object covers all controls that measure it."""
HUES = ((20, "red"), (45, "amber"), (75, "yellow"), (165, "green"), (200, "cyan"), (265, "blue"), (345, "violet"))
"""Upper limits of the hues in degrees (HSV) and their names; above the last one is red again."""


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
        self._screens = {c.name: ScreenCells(c, self.config) for c in layout.controls if c.kind == "touch_area"}
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
        places = {"extent": on_top(control, square_grid(5, 0.8)), "top": on_top(control, square_grid(5, 0.6))}
        if control.kind == "knob":
            rays = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=-1)
            places["marker"] = on_top(control, (RADII[:, None, None] * rays).reshape(-1, 2))
        elif control.lit_colour:
            edge = square_grid(7, 1.0)
            edge = edge[np.abs(edge).max(axis=1) == 1] * (1 + 4.0 / np.array(control.size_mm))
            places["lamp"] = on_top(control, square_grid(7, 0.5))
            places["around"] = on_top(control, edge, height_mm=0.0)
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
        shadow = own_shadow(camera_from_panel, camera, tip, self.config)
        pixels = camera.project(camera_from_panel.apply(self._points))
        look = ControlSamples(
            parts=self._parts,
            colours=values_at(bgr, pixels),
            outside=~is_inside(pixels, camera),
            covered=values_at(widened(shadow, camera, tip, wander_m), pixels),
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

    def _read_one(self, control: Control, look: ControlSamples, hidden: str, stamp_ns: int) -> ControlSeen:
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

    def _lamp(self, control: Control, look: ControlSamples) -> str:
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

    def _prints(
        self, pose: Transform, camera: CameraModel, shadow: Picture, patches: Patches | None
    ) -> dict[str, float]:
        """Return the share of the print around each control that agrees; omits controls with too little print."""
        if patches is None:
            return {}
        # Patches that the stylus hides partly are not used either.
        spots = patches.centres_mm[:, None] + 0.5 * patches.side_mm * square_grid(3, 1.0)
        face = np.dstack([spots, np.zeros(spots.shape[:2])]).reshape(-1, 3) * 1e-3
        covered = values_at(shadow, camera.project(pose.apply(face)))
        usable = ~(covered.reshape(spots.shape[:2]) > 0).any(axis=1)
        found = {}
        for control in self.layout.controls:
            reach = np.array(control.size_mm) / 2 + self.config.print_margin_mm
            near = usable & (np.abs(patches.centres_mm - control.position_mm) <= reach).all(axis=1)
            if int(near.sum()) >= 3:
                found[control.name] = float(patches.agreeing[near].mean())
        return found

    def _odd(self, look: ControlSamples, prints: dict[str, float]) -> set[str]:
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
            # If the surrounding print agrees, the reader slowly accepts an object on the control as its usual look.
            if name not in self._usual or name not in odd:
                self._usual[name] = colour if name not in self._usual else 0.9 * self._usual[name] + 0.1 * colour
            elif prints.get(name, 0.0) > 0.9:
                self._usual[name] = 0.98 * self._usual[name] + 0.02 * colour
        return odd


def _hidden_by(control: Control, look: ControlSamples, odd: bool) -> str:
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


def _hue(bgr: Array) -> str:
    pixel = np.clip(bgr, 0, 255).astype(np.uint8).reshape(1, 1, 3)
    hue = 2.0 * float(np.asarray(cv2.cvtColor(pixel, cv2.COLOR_BGR2HSV)).flat[0])
    return next((name for end, name in HUES if hue < end), "red")
