"""Renders the stereo pair: the static views, the live screen, a hand, the stylus, and the sensor's noise.

Per frame only the screen and the stylus are drawn; the rest comes from :class:`icu_simulator.core.view.BenchView`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control, PanelLayout
from icu_simulator.core import screen
from icu_simulator.core.configuration import BenchConfig, BenchStylusConfig, LightConfig, PanelConfig
from icu_simulator.core.instrument import InstrumentState
from icu_simulator.core.optics import Rays, StereoRig, turn
from icu_simulator.core.panel_texture import Picture
from icu_simulator.core.solids import ControlState
from icu_simulator.core.stylus_picture import StylusPainter
from icu_simulator.core.surfaces import Surfaces
from icu_simulator.core.view import SAMPLES, BenchView, Window
from icu_simulator.imaging.configuration import ImagingConfig
from icu_simulator.imaging.motion import ShutterTimes, TipTrack, row_tips
from icu_simulator.imaging.rig import NO_SHIFTS, CameraShift, Drift, Shifts, true_rig
from icu_simulator.imaging.sensor import Sensor
from icu_simulator.manufacture.layout import manufactured

GLARE_SHIFT_MM = 52.0
"""Shift of the lamp's reflection between the cameras: the mirror image is as far behind the panel as the lamp is in
front of it."""
_STILL_M = 1e-6
_MOVED_SAMPLES = 2
"""Samples per pixel and direction of a view that is redrawn for each position of the carriage."""
_TILE = 256
_GLOVE = np.array([190.0, 120.0, 62.0])


def base_from_panel(config: PanelConfig, moved: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Transform:
    """Return the pose of the panel; ``moved`` is its displacement since: dx, dy in metres, rotation in degrees."""
    tilt_x, tilt_y = config.tilt_deg
    rotation = turn(2, config.yaw_deg + moved[2]) @ turn(1, tilt_y) @ turn(0, tilt_x)
    return Transform(rotation, np.asarray(config.position_m) + np.array([moved[0], moved[1], 0.0]))


@functools.lru_cache(maxsize=1)
def _cameras(config: BenchConfig, shifts: Shifts) -> tuple[StereoRig, tuple[Rays, Rays]]:
    """Return the true pair and its viewing rays; the last result is cached, as the rays take most of a second."""
    rig = true_rig(config, shifts)
    return rig, (Rays(rig.left), Rays(rig.right))


def _optics(config: BenchConfig) -> BenchConfig:
    """Return the settings on which the geometry of the cameras depends."""
    imaging = ImagingConfig(calibration=config.imaging.calibration, lens=config.imaging.lens)
    return BenchConfig(camera=config.camera, seed=config.seed, imaging=imaging)


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """Scene at one moment.

    Ball centre in base_link (metres), instrument state, sunken buttons (mm), displacement of the carriage in base_link
    (metres), which cameras mounted on it follow, and whether the carriage is moving. ``track`` is the ball's path
    around the exposure; without it the stylus is at rest.
    """

    tip: tuple[float, float, float]
    state: InstrumentState
    now_s: float
    sunk_mm: tuple[tuple[str, float], ...] = ()
    carriage: tuple[float, float] = (0.0, 0.0)
    crossing: bool = False
    track: TipTrack | None = None


class Renderer:
    """Draws both images of a pair.

    Parameters
    ----------
    layout
        The nominal panel; ``config`` has the deviations of the manufactured one.
    config
        The bench.
    panel_from
        ``base_from_panel``.
    """

    def __init__(self, layout: PanelLayout, config: BenchConfig, panel_from: Transform) -> None:
        self.layout = layout = manufactured(layout, config.manufacture, config.seed)
        self._shifts, self._drift = NO_SHIFTS, Drift(config.seed, config.camera.focal_px, config.camera.width_px)
        self.rig, self._rays = _cameras(_optics(config), NO_SHIFTS)
        self._config = config
        self._sensors = [Sensor(config, index) for index in (0, 1)]
        self._light = config.light
        self._surfaces = Surfaces.of(layout, config.manufacture, config.seed)
        self._panel_from = panel_from
        self._camera_xy, self._samples = (0.0, 0.0), SAMPLES
        self._sides = self._make_sides()
        self._still_of: InstrumentState | None = None
        self._still: Picture = np.zeros((1, 1, 3), np.uint8)
        self._noise: tuple[Picture, Picture] | None = None
        self._screens = [c for c in layout.controls if c.kind == "touch_area"]
        self._lamps = [c for c in layout.controls if c.height_mm > 0]
        self._make_noise()

    @property
    def views(self) -> tuple[BenchView, BenchView]:
        """The left and the right view."""
        return self._sides[0].view, self._sides[1].view

    def _make_sides(self) -> list[_Side]:
        seen = Transform(self._panel_from.rotation, self._panel_from.translation - np.array([*self._camera_xy, 0.0]))
        place = (self._camera_xy, self._samples)
        return [
            _Side(
                BenchView(
                    rays, seen, self.layout, self._surfaces, self._light, shift, *place, self._config.imaging.defocus
                ),
                self._config.stylus,
            )
            for rays, shift in zip(self._rays, (0.0, GLARE_SHIFT_MM))
        ]

    def _draw_anew(self) -> None:
        hidden = self._sides[0].hidden
        self._sides = self._make_sides()
        self.hide(hidden)

    def move_panel(self, panel_from: Transform) -> None:
        """Move the panel to another pose, ``base_from_panel``."""
        self._panel_from = panel_from
        self._draw_anew()

    def follow_panel(self, panel_from: Transform) -> None:
        """Draw the panel in its present pose, ``base_from_panel``, if it has been moved since."""
        if panel_from is not self._panel_from:
            self.move_panel(panel_from)

    def _follow(self, carriage: tuple[float, float], samples: int) -> None:
        """Move cameras on the carriage along with it: coarse views while it moves, fine ones at rest."""
        here = np.abs(np.subtract(carriage, self._camera_xy)).max() <= _STILL_M
        if here and self._samples >= samples:
            return
        self._camera_xy, self._samples = carriage, samples
        self._draw_anew()

    def relight(self, light: LightConfig) -> None:
        """Change light, blur, glare and noise."""
        self._config = dataclasses.replace(self._config, light=light)
        changed = light.noise != self._light.noise
        self._light = light
        for sensor in self._sensors:
            sensor.configure(self._config)
        for side in self._sides:
            side.relight(light)
        if changed:
            self._make_noise()

    def hide(self, rectangle_mm: tuple[float, float, float, float] | None) -> None:
        """Place a gloved hand over a rectangle (x, y, width, height) of the panel, or remove it."""
        for side in self._sides:
            side.hide(rectangle_mm)

    def reimage(self, config: BenchConfig) -> None:
        """Apply other camera effects; the states of drift and exposure stay."""
        old, self._config = self._config, config
        for sensor in self._sensors:
            sensor.configure(config)
        if (config.imaging.calibration, config.imaging.lens) != (old.imaging.calibration, old.imaging.lens):
            self._set_cameras(self._shifts)
        elif config.imaging.defocus != old.imaging.defocus:
            self._draw_anew()

    def knock(self, camera: str, shift: CameraShift) -> None:
        """Rotate a camera, or shift its lens, from the next image on."""
        self._drift.knock(camera, shift)

    def settle(self, now_s: float) -> None:
        """Move the cameras to their state at a time, by drift and knocks."""
        shifts = self._drift.at(self._config.imaging, now_s)
        if shifts != self._shifts:
            self._set_cameras(shifts)

    def _set_cameras(self, shifts: Shifts) -> None:
        self._shifts = shifts
        self.rig, self._rays = _cameras(_optics(self._config), shifts)
        self._draw_anew()

    def render(self, moment: Moment) -> list[Picture]:
        """Return the left and right image of one moment, each (H, W, 3) BGR."""
        return list(self.render_each({0: moment, 1: moment}).values())

    def render_each(self, moments: Mapping[int, Moment]) -> dict[int, Picture]:
        """Return the image, (H, W, 3) BGR, of each camera at its own moment; 0 is the left camera."""
        result: dict[int, Picture] = {}
        drawn_of: Moment | None = None
        for index, given in moments.items():
            moment = given
            if drawn_of is None or moment.now_s != drawn_of.now_s:
                self.settle(moment.now_s)
                # Separate noise for each moment: an image does not depend on the images rendered before it.
                rng = np.random.default_rng((self._config.seed, round(moment.now_s * 1e6)))
                light, states, drawn_of = self._emission(moment, rng), self._control_states(moment), moment
            if self._config.camera.mounting == "carriage":
                self._follow(moment.carriage, _MOVED_SAMPLES if not moment.crossing else 1)
                moment = self._seen_from_carriage(moment)
            picture = self._sides[index].draw(states, light, moment, self._config.imaging)
            sensor = self._sensors[index]
            if not sensor.adds_noise:
                picture = self._with_noise(picture, rng)
            result[index] = sensor.develop(picture, moment.now_s)
        return result

    def _seen_from_carriage(self, moment: Moment) -> Moment:
        """Return the moment with the stylus at the position that cameras on the carriage see."""
        away = np.array([*self._camera_xy, 0.0])
        track = moment.track
        if track is not None:
            track = dataclasses.replace(track, tips=track.tips - away)
        return dataclasses.replace(moment, tip=tuple((np.asarray(moment.tip) - away).tolist()), track=track)

    def _control_states(self, moment: Moment) -> dict[str, ControlState]:
        sunk = dict(moment.sunk_mm)
        return {
            control.name: ControlState(
                # Quarters of a millimetre, so that a moving button is not redrawn for every micrometre.
                sunk_mm=round(sunk.get(control.name, 0.0) * 4) / 4,
                angle_deg=round(moment.state.knob_deg(control.name), 1),
                lamp=moment.state.lamp(control.name, control.lit_colour),
            )
            for control in self._lamps
        }

    def _emission(self, moment: Moment, rng: np.random.Generator) -> Picture | None:
        if not self._screens:
            return None
        size = screen.SIZE_PX
        if self._still_of != moment.state:
            self._still_of, self._still = moment.state, screen.still_part(moment.state, size)
        noise = rng.standard_normal((2, 364))
        drawn = screen.with_traces(self._still, moment.state, moment.now_s, noise)
        # One pixel of the image covers almost two of the screen; the lens adds its blur.
        sigma = float(np.hypot(0.62, 1.8 * self._light.blur_px))
        return np.asarray(cv2.GaussianBlur(drawn, (0, 0), sigma))

    def _make_noise(self) -> None:
        self._noise = None
        if self._light.noise > 0:
            height, width = self.rig.left.height, self.rig.left.width
            rng = np.random.default_rng(self._config.seed)
            values = rng.standard_normal((height + _TILE, width + _TILE, 3), dtype=np.float32) * self._light.noise
            whole = np.rint(values)
            # Saturating addition and subtraction of bytes is many times faster than signed arithmetic.
            self._noise = np.clip(whole, 0, 255).astype(np.uint8), np.clip(-whole, 0, 255).astype(np.uint8)

    def _with_noise(self, picture: Picture, rng: np.random.Generator) -> Picture:
        if self._noise is None:
            return picture
        r, c = (int(v) for v in rng.integers(0, _TILE, 2))
        rows, columns = slice(r, r + picture.shape[0]), slice(c, c + picture.shape[1])
        cv2.add(picture, self._noise[0][rows, columns], picture)
        cv2.subtract(picture, self._noise[1][rows, columns], picture)
        return picture


class _Side:
    """One camera's part of the renderer."""

    def __init__(self, view: BenchView, stylus: BenchStylusConfig) -> None:
        self.view = view
        self._stylus = StylusPainter(view, stylus)
        self._screen: Window | None = None
        for control in view.layout.controls:
            if control.kind == "touch_area" and self._screen is None:
                self._prepare_screen(control)
        self._hand: tuple[Window, npt.NDArray[np.float32], npt.NDArray[np.float32]] | None = None
        self.hidden: tuple[float, float, float, float] | None = None
        self._light_screen()

    def _prepare_screen(self, control: Control) -> None:
        (x, y), (w, h) = control.position_mm, control.size_mm
        corners = [(x + sx * w / 2, y + sy * h / 2, 0.0) for sx in (-1, 1) for sy in (-1, 1)]
        self._screen = self.view.window_of_panel(corners)
        px, py = self.view.xy0[(slice(None), *self._screen)]
        columns, rows = screen.SIZE_PX
        map_x = (px - x + w / 2) * columns / w - 0.5
        map_y = (y + h / 2 - py) * rows / h - 0.5
        self._maps = cv2.convertMaps(map_x.astype(np.float32), map_y.astype(np.float32), cv2.CV_16SC2)

    def relight(self, light: LightConfig) -> None:
        self.view.relight(light)
        self._light_screen()
        self.hide(self.hidden)

    def _light_screen(self) -> None:
        if self._screen is not None:
            gain = np.clip(self.view.vignette[self._screen] * 235, 0, 255).astype(np.uint8)
            self._screen_gain = np.repeat(gain[..., None], 3, axis=2)

    def hide(self, rectangle_mm: tuple[float, float, float, float] | None) -> None:
        self.hidden = rectangle_mm
        self._hand = None
        if rectangle_mm is None:
            return
        x, y, width, height = rectangle_mm
        window = self.view.window_of_panel(
            [(x, y, 25), (x + width, y, 25), (x, y + height, 25), (x + width, y + height, 25)]
        )
        shape = (window[0].stop - window[0].start, window[1].stop - window[1].start)
        px, py = (self.view.xy0 + self.view.lean * 25.0)[(slice(None), *window)]
        round_mm = min(12.0, width / 2, height / 2)
        dx = np.abs(px - x - width / 2) - width / 2 + round_mm
        dy = np.abs(py - y - height / 2) - height / 2 + round_mm
        distance = np.hypot(np.maximum(dx, 0), np.maximum(dy, 0)) + np.minimum(np.maximum(dx, dy), 0) - round_mm
        share = np.clip(0.5 - distance * 2.4, 0, 1).astype(np.float32)
        folds = 1 + 0.06 * np.sin(px / 5.0 + np.sin(py / 9.0) * 2)
        shade = (0.55 + 0.45 * np.clip(-distance / 10, 0, 1)) * folds * self.view.light.level
        light = (shade * self.view.vignette[window])[..., None] * _GLOVE
        self._hand = window, share.reshape(*shape, 1), np.clip(light, 0, 255).astype(np.float32)

    def draw(
        self, states: dict[str, ControlState], emission: Picture | None, moment: Moment, imaging: ImagingConfig
    ) -> Picture:
        self.view.show(states)
        picture = self.view.picture.copy()
        tip = np.asarray(moment.tip)
        self._stylus.cast_shadow(picture, tip)
        if emission is not None and self._screen is not None:
            seen = cv2.remap(emission, self._maps[0], self._maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
            seen = cv2.multiply(seen, self._screen_gain, scale=1 / 255)
            picture[self._screen] = cv2.add(picture[self._screen], seen)
        if imaging.mirror.enabled and self._screen is not None:
            self._stylus.reflect(picture, self._screen, tip, imaging.mirror.reflectance)
        if self._hand is not None:
            window, share, light = self._hand
            mixed = picture[window] * (1 - share) + light * share
            picture[window] = np.rint(mixed).astype(np.uint8)
        if moment.track is not None and moment.track.moves:
            rows = row_tips(moment.track, ShutterTimes.of(imaging), picture.shape[0])
            self._stylus.draw_moving(picture, rows)
        else:
            self._stylus.draw(picture, tip)
        return picture


def control_pixels(view: BenchView, layout: PanelLayout) -> dict[str, dict[str, list[list[float]] | list[float]]]:
    """Return the image position of each control in raw pixels: ``centre`` and outline of its face at its full height.

    ``base_centre`` is the same point on the panel's face.
    """
    found: dict[str, dict[str, list[list[float]] | list[float]]] = {}
    for control in layout.controls:
        (x, y), (w, h) = control.position_mm, control.size_mm
        if control.shape == "circle":
            turn_rad = np.linspace(0, 2 * np.pi, 24, endpoint=False)
            outline: Array = np.column_stack([x + w / 2 * np.cos(turn_rad), y + h / 2 * np.sin(turn_rad)])
        else:
            outline = np.array(
                [(x - w / 2, y - h / 2), (x + w / 2, y - h / 2), (x + w / 2, y + h / 2), (x - w / 2, y + h / 2)]
            )
        face = np.column_stack([outline, np.full(len(outline), control.height_mm)])
        found[control.name] = {
            "centre": view.pixel_of_panel((x, y, control.height_mm))[0].tolist(),
            "base_centre": view.pixel_of_panel((x, y, 0.0))[0].tolist(),
            "outline": view.pixel_of_panel(face).tolist(),
        }
    return found
