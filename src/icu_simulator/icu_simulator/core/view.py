"""View of one camera on the bench at rest: the static scene, drawn once per state of the panel and kept.

The printed face is sampled sixteen times per pixel through the exact ray of each sample, so edges in the image are
exactly at their projected positions. Controls are cast as solids into separate images and composed over the face from
far to near; when one of them moves, only its surroundings are composed again.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control, PanelLayout
from icu_simulator.core.configuration import LightConfig
from icu_simulator.core.optics import Camera, Rays
from icu_simulator.core.panel_texture import Picture
from icu_simulator.core.solids import LAMP_DIRECTION, ControlState, cast, paint
from icu_simulator.core.surfaces import FACE_PER_MM, TABLE_LEFT_MM, TABLE_PER_MM, TABLE_TOP_MM, Surfaces, shade
from icu_simulator.imaging.configuration import DefocusConfig
from icu_simulator.imaging.focus import Focus, blurred

SAMPLES = 4
"""Samples per pixel and direction."""
CASE_MM = 30.0
"""Depth of the instrument's case below its face in mm."""
_STRIP = 90
SHARP = DefocusConfig()
Window = tuple[slice, slice]
_grounds: OrderedDict[Any, npt.NDArray[np.float32]] = OrderedDict()
"""Grounds of the last two views."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sprite:
    """Image of a control: window, coverage of each pixel, and its weighted reflected and emitted light."""

    window: Window
    share: npt.NDArray[np.float32]
    reflected: npt.NDArray[np.float32]
    emitted: npt.NDArray[np.float32]


class BenchView:
    """The static scene of one camera.

    Parameters
    ----------
    rays
        The camera's rays.
    base_from_panel
        Pose of the panel.
    layout
        The panel.
    surfaces
        Its surfaces.
    light
        Light, lens and sensor.
    glare_shift_mm
        Shift along x of the lamp's reflection in this camera from its position in ``light``.
    camera_xy
        (2,) metres: displacement of the camera from the origin of ``rays``. Everything is drawn relative to the camera,
        so ``base_from_panel`` is the panel's pose minus this; only the table needs the value.
    samples
        Samples per pixel and direction.
    defocus
        Blur of the lens by distance.
    """

    def __init__(
        self,
        rays: Rays,
        base_from_panel: Transform,
        layout: PanelLayout,
        surfaces: Surfaces,
        light: LightConfig,
        glare_shift_mm: float,
        camera_xy: tuple[float, float] = (0.0, 0.0),
        samples: int = SAMPLES,
        defocus: DefocusConfig = SHARP,
    ) -> None:
        self.rays = rays
        self._defocus = defocus
        self._camera_xy, self._samples = np.asarray(camera_xy), samples
        self.camera = camera = rays.camera
        self.layout = layout
        self.light = light
        self.glare_shift_mm = glare_shift_mm
        panel_from_base = base_from_panel.inverse()
        down = np.concatenate([rays.lean, np.full((1, camera.height, camera.width), -1.0)])
        direction = np.tensordot(panel_from_base.rotation, down, axes=1)
        self.eye_mm = panel_from_base.apply(rays.eye) * 1000
        self.lean: Array = direction[:2] / direction[2]
        self.xy0: Array = self.eye_mm[:2, None, None] - self.lean * self.eye_mm[2]
        self.base_from_panel = base_from_panel
        self._ground = self._kept_ground(surfaces)
        self._sprites: dict[str, Sprite] = {}
        self._states: dict[str, ControlState] = {}
        # Far from the camera first.
        proud = [c for c in layout.controls if c.height_mm > 0]
        self._proud = sorted(proud, key=lambda c: -float(np.hypot(*(np.array(c.position_mm) - self.eye_mm[:2]))))
        self.picture: Picture = np.empty((camera.height, camera.width, 3), np.uint8)
        for control in self._proud:
            self._set(control, ControlState())
        self.relight(light)

    def show(self, states: dict[str, ControlState]) -> None:
        """Set the controls to these states; controls that are not named keep theirs."""
        for control in self._proud:
            state = states.get(control.name, self._states[control.name])
            if state != self._states[control.name]:
                old = self._sprites[control.name].window
                self._set(control, state)
                for window in (old, self._sprites[control.name].window):
                    self._compose(window)

    def relight(self, light: LightConfig) -> None:
        """Change light, blur or glare; noise is added by the caller."""
        self.light = light
        self.focus = Focus.of(light.blur_px, self.camera.focal_px, self._defocus)
        self._sigma = self.focus.over_image(self.xy0, lambda xyz: self.depth_m(self.base_from_panel.apply(xyz / 1000)))
        self.vignette = self._draw_vignette()
        x, y = self.xy0
        centre_x, centre_y = (side / 2 for side in self.layout.size_mm)
        along = ((x - centre_x) * LAMP_DIRECTION[0] + (y - centre_y) * LAMP_DIRECTION[1]) / 160.0
        uneven = 1 - light.unevenness * (0.5 - 0.5 * np.clip(along, -1.4, 1.2))
        self._gain = (light.level * uneven * self.vignette).astype(np.float32)[..., None]
        glare_x, glare_y = light.glare_at_mm[0] + self.glare_shift_mm, light.glare_at_mm[1]
        distance2 = ((x - glare_x) ** 2 + ((y - glare_y) * 1.3) ** 2) / light.glare_radius_mm**2
        self._glare = (255 * light.glare * light.level * np.exp(-0.5 * distance2)).astype(np.float32)[..., None]
        self._compose((slice(0, self.camera.height), slice(0, self.camera.width)))

    def pixel_of_panel(self, points_mm: npt.ArrayLike) -> Array:
        """Project (N, 3) panel points in millimetres to (N, 2) raw pixels."""
        points = np.atleast_2d(np.asarray(points_mm, dtype=np.float64)) / 1000
        return self.camera.project(self.base_from_panel.apply(points))

    def window_of_panel(self, points_mm: npt.ArrayLike, margin: int = 2) -> Window:
        """Return the pixels that enclose the panel points, clipped to the image."""
        pixels = self.pixel_of_panel(points_mm)
        return window_around(pixels, margin, self.camera)

    def samples(self, grid: Array, window: Window, count: int = SAMPLES) -> Array:
        """Interpolate (..., H, W) values, smooth over the image, at ``count`` squared points of each pixel."""
        rows, columns = window
        r0, r1 = max(rows.start - 1, 0), min(rows.stop + 1, grid.shape[-2])
        c0, c1 = max(columns.start - 1, 0), min(columns.stop + 1, grid.shape[-1])
        part = grid[..., r0:r1, c0:c1].reshape(-1, r1 - r0, c1 - c0)
        size = ((c1 - c0) * count, (r1 - r0) * count)
        # cv2.resize positions the samples correctly: sample i of n is (i + 0.5) / n - 0.5 from a pixel's centre.
        large: Array = np.stack([cv2.resize(layer, size, interpolation=cv2.INTER_LINEAR) for layer in part])
        top, left = (rows.start - r0) * count, (columns.start - c0) * count
        height, width = (rows.stop - rows.start) * count, (columns.stop - columns.start) * count
        return large[:, top : top + height, left : left + width]

    def _draw_vignette(self) -> npt.NDArray[np.float32]:
        """Return the share of light that the lens transmits, (H, W)."""
        v, u = np.mgrid[0 : self.camera.height, 0 : self.camera.width].astype(np.float64)
        radius2 = ((u - self.camera.width / 2) ** 2 + (v - self.camera.height / 2) ** 2) / (self.camera.width / 2) ** 2
        return np.asarray(1 - self.light.vignetting * np.clip(radius2 / 1.3, 0, 1.2), dtype=np.float32)

    def depth_m(self, points_base: Array) -> Array:
        """Return the depth of (..., 3) points in base_link along the camera's axis."""
        return np.asarray((points_base - self.rays.eye) @ self.camera.camera_from_base.rotation[2])

    def _kept_ground(self, surfaces: Surfaces) -> npt.NDArray[np.float32]:
        """Return the ground, redrawn only if it is not one of the last two: those of a pair serve the next pair."""
        arrays = (self.base_from_panel.rotation, self.base_from_panel.translation, self._camera_xy)
        key = (self.rays, surfaces, self._samples, *(array.tobytes() for array in arrays))
        ground = _grounds.get(key)
        if ground is None:
            ground = self._draw_ground(surfaces)
            ground.flags.writeable = False
            while len(_grounds) > 1:
                _grounds.popitem(last=False)
            _grounds[key] = ground
        return ground  # no second lookup: a bench in another thread may have replaced it meanwhile

    def _draw_ground(self, surfaces: Surfaces) -> npt.NDArray[np.float32]:
        """Draw the face, the case's sides and the table: (H, W, 3) reflected light under even lighting."""
        height, width = self.camera.height, self.camera.width
        result = np.empty((height, width, 3), np.float32)
        table_z = float(self.base_from_panel.translation[2]) - CASE_MM / 1000
        table_xy = (self.rays.eye[:2, None, None] + self.rays.lean * (self.rays.eye[2] - table_z)) * 1000
        table_xy = table_xy + 1000 * self._camera_xy[:, None, None]
        under = self.xy0 - self.lean * CASE_MM
        case_rows, case_columns = self.window_of_panel(_case_points(self.layout.size_mm))
        for top in range(0, height, _STRIP):
            rows = slice(top, min(top + _STRIP, height))
            table_x, table_y = table_xy[:, rows].astype(np.float32)
            ground = cv2.remap(
                surfaces.table,
                (table_x - TABLE_LEFT_MM) * TABLE_PER_MM - 0.5,
                (TABLE_TOP_MM - table_y) * TABLE_PER_MM - 0.5,
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            ).astype(np.float32)
            result[rows] = ground * shade(surfaces.table_shadow, self.layout, *under[:, rows].astype(np.float32))
            rows = slice(max(top, case_rows.start), min(rows.stop, case_rows.stop))
            if rows.start < rows.stop:
                self._lay_case(result, surfaces, (rows, case_columns))
        return result

    def _lay_case(self, ground: npt.NDArray[np.float32], surfaces: Surfaces, window: Window) -> None:
        """Draw the visible parts of the face and of the case's sides in a window over the ground."""
        size = (window[1].stop - window[1].start, window[0].stop - window[0].start)
        face_width, face_height = self.layout.size_mm
        x, y = self.samples(self.xy0, window, self._samples).astype(np.float32)
        s = np.float32(FACE_PER_MM)
        map_x, map_y = x * s - 0.5, (np.float32(face_height) - y) * s - 0.5
        seen = cv2.remap(surfaces.face, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        printed = cv2.resize(seen, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        printed *= shade(surfaces.face_shadow, self.layout, *self.xy0[(slice(None), *window)].astype(np.float32))
        inside = (x >= 0) & (x <= face_width) & (y >= 0) & (y <= face_height)
        on_top = cv2.resize(inside.astype(np.float32), size, interpolation=cv2.INTER_AREA)[..., None]
        edge = min(self._samples, 2)
        lean, start = self.samples(self.lean, window, edge), self.samples(self.xy0, window, edge)
        case = Control(
            name="case", kind="button", position_mm=(face_width / 2, face_height / 2), size_mm=self.layout.size_mm
        )
        hit = cast(case, 0.0, -CASE_MM, (start[0], start[1]), (lean[0], lean[1]))
        solid = cv2.resize((hit.top | hit.wall).astype(np.float32), size, interpolation=cv2.INTER_AREA)[..., None]
        wall = np.array([60.0, 58.0, 55.0], np.float32)
        solid = np.maximum(solid, on_top)
        ground[window] = printed * on_top + wall * (solid - on_top) + ground[window] * (1 - solid)

    def _set(self, control: Control, state: ControlState) -> None:
        self._states[control.name] = state
        self._sprites[control.name] = self._sprite(control, state)

    def _sprite(self, control: Control, state: ControlState) -> Sprite:
        top_mm = control.height_mm - state.sunk_mm
        (x, y), (w, h) = control.position_mm, control.size_mm
        corners = [
            (x + sx * w / 2, y + sy * h / 2, z) for sx in (-1, 1) for sy in (-1, 1) for z in (0.0, control.height_mm)
        ]
        window = self.window_of_panel(corners)
        x0, y0 = self.samples(self.xy0, window, self._samples)
        lean_x, lean_y = self.samples(self.lean, window, self._samples)
        hit = cast(control, top_mm, 0.0, (x0, y0), (lean_x, lean_y))
        reflected, emitted = paint(control, state, hit)
        share = (hit.top | hit.wall).astype(np.float32)
        size = (window[1].stop - window[1].start, window[0].stop - window[0].start)

        def gathered(layer: Array) -> npt.NDArray[np.float32]:
            weighted = np.asarray(layer * share[..., None], dtype=np.float32)
            return np.asarray(cv2.resize(weighted, size, interpolation=cv2.INTER_AREA))

        small = np.asarray(cv2.resize(share, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
        return Sprite(window=window, share=small[..., None], reflected=gathered(reflected), emitted=gathered(emitted))

    def _compose(self, window: Window) -> None:
        """Compose the controls over the ground, light and blur the result, and store it in ``picture``."""
        widest = self.light.blur_px if self._sigma is None else float(self._sigma.max())
        pad = int(np.ceil(3 * widest)) + 1
        outer = _grown(window, pad, self.camera)
        reflected = self._ground[outer].copy()
        emitted = np.zeros_like(reflected)
        for control in self._proud:
            sprite = self._sprites[control.name]
            common = _common(outer, sprite.window)
            if common is None:
                continue
            here, there = _relative(common, outer), _relative(common, sprite.window)
            reflected[here] = reflected[here] * (1 - sprite.share[there]) + sprite.reflected[there]
            emitted[here] = emitted[here] * (1 - sprite.share[there]) + sprite.emitted[there]
        lit = reflected * self._gain[outer] + emitted * self.vignette[outer][..., None] + self._glare[outer]
        lit = np.clip(lit, 0, 255).astype(np.float32)
        if self._sigma is not None:
            lit = blurred(lit, self._sigma[outer], self._sigma)
        elif self.light.blur_px > 0:
            lit = cv2.GaussianBlur(lit, (0, 0), self.light.blur_px)
        inner = _relative(window, outer)
        self.picture[window] = np.rint(lit[inner]).astype(np.uint8)


def _case_points(size_mm: tuple[float, float]) -> Array:
    """Return (N, 3) points in mm all over the case's upper and lower side: a lens may bend edges beyond the corners."""
    x, y = (grid.ravel() for grid in np.meshgrid(*(np.linspace(0.0, side, 17) for side in size_mm)))
    return np.concatenate([np.column_stack([x, y, np.full_like(x, z)]) for z in (0.0, -CASE_MM)])


def window_around(pixels: Array, margin: int, camera: Camera) -> Window:
    """Return the slices (rows, columns) around (N, 2) pixels, clipped to the image; at least one pixel."""
    low, high = np.floor(pixels.min(axis=0)) - margin, np.ceil(pixels.max(axis=0)) + margin + 1
    c0, c1 = (int(np.clip(v, 0, camera.width)) for v in (low[0], high[0]))
    r0, r1 = (int(np.clip(v, 0, camera.height)) for v in (low[1], high[1]))
    c0, r0 = min(c0, camera.width - 1), min(r0, camera.height - 1)
    return slice(r0, max(r1, r0 + 1)), slice(c0, max(c1, c0 + 1))


def _grown(window: Window, pad: int, camera: Camera) -> Window:
    rows, columns = window
    return (
        slice(max(rows.start - pad, 0), min(rows.stop + pad, camera.height)),
        slice(max(columns.start - pad, 0), min(columns.stop + pad, camera.width)),
    )


def _common(a: Window, b: Window) -> Window | None:
    rows = slice(max(a[0].start, b[0].start), min(a[0].stop, b[0].stop))
    columns = slice(max(a[1].start, b[1].start), min(a[1].stop, b[1].stop))
    return (rows, columns) if rows.start < rows.stop and columns.start < columns.stop else None


def _relative(inner: Window, outer: Window) -> Window:
    return (
        slice(inner[0].start - outer[0].start, inner[0].stop - outer[0].start),
        slice(inner[1].start - outer[1].start, inner[1].stop - outer[1].start),
    )
