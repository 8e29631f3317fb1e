"""Ray casting of the stylus into the image: ball, stem, shaft and arm, for each frame and only in their windows.

The ball is a sphere intersected with the exact ray of every sample, so perspective and distortion are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array
from icu_simulator.core.configuration import BenchStylusConfig, LightConfig
from icu_simulator.core.panel_texture import Picture
from icu_simulator.core.solids import LAMP_DIRECTION, SHADOW_REACH
from icu_simulator.core.view import BenchView, Window, window_around

BALL = np.array([176.0, 22.0, 226.0])
"""Colour of the ball: magenta, BGR; nothing else on the bench has this hue."""
SHAFT = np.array([46.0, 44.0, 42.0])
ARM = np.array([52.0, 50.0, 48.0])
LIGHT = np.array([-0.35, 0.45, 0.82])
_SHADOW_DEPTH, _SHADOW_BLUR_PX = 90, 5
_COUNT, _BALL_COUNT = 3, 6
"""Samples per pixel and direction, of the rest and of the ball; only the ball is measured."""
_MOVING_COUNT, _MOVING_BALL_COUNT = 1, 2
"""The same while the stylus moves."""
_MOVING_M = 0.001
"""Distance in metres between two images above which the stylus moves; no program then measures it to subpixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Part:
    """A part's window, its transmittance (share of light from below), (H, W, 1), and its own light, (H, W, 3)."""

    window: Window
    left: npt.NDArray[np.float32]
    light: npt.NDArray[np.float32]


class StylusPainter:
    """Draws the stylus over an image of one view; intermediate results are kept while the stylus is at rest."""

    def __init__(self, view: BenchView, config: BenchStylusConfig) -> None:
        self._view = view
        self._config = config
        # Rays in base_link with z = -1: the cameras are aimed down at the bench.
        self._lean, self._eye = view.rays.lean, view.rays.eye
        self._tip: Array | None = None
        self._rows: Array | None = None
        """(H, 3) positions of a moving tip during the exposure of each row."""
        self._counts = _COUNT, _BALL_COUNT
        self._drawn: tuple[bytes, LightConfig, tuple[int, int]] | None = None
        self._below_arm: list[_Part] = []
        self._above_arm: list[_Part] = []
        self._mirrored: tuple[tuple[bytes, LightConfig], list[_Part]] | None = None
        self._shaded: bytes | None = None
        self._shade: tuple[Window, Picture] = (slice(0), slice(0)), np.empty((0, 0, 3), np.uint8)

    def draw_moving(self, picture: Picture, tips: Sequence[Array]) -> None:
        """Draw the mean of a stylus that moves while the image is exposed.

        Parameters
        ----------
        picture
            (H, W, 3) BGR, drawn into.
        tips
            Ball centre (H, 3) in metres during the exposure of each row, for each averaged moment.
        """
        ends = [rows[index] for rows in tips for index in (0, -1)]
        window = self._window_of_all(np.array(ends))
        under = picture[window].copy()
        total = np.zeros(under.shape, np.uint16)
        self._counts, self._drawn = (_MOVING_COUNT, _MOVING_BALL_COUNT), None
        for rows in tips:
            picture[window] = under
            self._rows, middle = rows, rows[len(rows) // 2]
            self._tip = middle
            self._cast(middle)
            self._over(picture, self._below_arm)
            self._arm(picture, middle)
            self._over(picture, self._above_arm)
            total += picture[window]
        self._rows = None
        picture[window] = ((total + len(tips) // 2) // len(tips)).astype(np.uint8)

    def _window_of_all(self, tips: Array) -> Window:
        """Return the pixels that a stylus at any of (N, 3) tips may cover."""
        config = self._config
        wide = 2 * max(config.ball_diameter_mm, config.shaft_diameter_mm, config.arm_width_mm) / 1000
        low, high = tips.min(axis=0) - wide, tips.max(axis=0) + wide
        top = max(high[2] + config.shaft_mm / 1000, config.arm_height_m + 0.02)
        corners = [
            (x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1], high[1] + 0.4) for z in (low[2], top)
        ]
        return window_around(self._view.camera.project(np.array(corners)), self._margin(), self._view.camera)

    def draw(self, picture: Picture, tip: Array) -> None:
        """Draw the stylus with its ball's centre at ``tip``, (3,) metres in base_link, into ``picture``."""
        travels = self._tip is not None and np.abs(tip - self._tip).max() > _MOVING_M
        self._tip, self._counts = tip, (_MOVING_COUNT, _MOVING_BALL_COUNT) if travels else (_COUNT, _BALL_COUNT)
        as_drawn = tip.tobytes(), self._view.light, self._counts
        if self._drawn != as_drawn:
            self._cast(tip)
            self._drawn = as_drawn
        # From far to near: seen from above, higher parts hide lower parts.
        self._over(picture, self._below_arm)
        self._arm(picture, tip)
        self._over(picture, self._above_arm)

    def _cast(self, tip: Array) -> None:
        config = self._config
        stem, shaft = config.stem_mm / 1000, config.shaft_mm / 1000
        top = max(tip[2] + shaft, config.arm_height_m + 0.02)
        rod = config.shaft_diameter_mm / 2000
        ball_radius = config.ball_diameter_mm / 2000
        ball = self._ball(tip, ball_radius)
        thin = self._rod(tip, tip[2], tip[2] + stem, config.stem_diameter_mm / 2000, tip, ball_radius)
        below = ball, thin, self._rod(tip, tip[2] + stem, config.arm_height_m, rod)
        above = self._rod(tip, config.arm_height_m + 0.008, top, rod)
        self._below_arm = [part for part in below if part is not None]
        self._above_arm = [] if above is None else [above]

    def reflect(self, picture: Picture, window: Window, tip: Array, reflectance: float) -> None:
        """Add the stylus's mirror image in the panel's face, seen in a window of glass.

        Parameters
        ----------
        picture
            (H, W, 3) BGR, drawn into.
        window
            The glass.
        tip
            (3,) the ball's centre, metres in base_link.
        reflectance
            Share of the light that the glass reflects.
        """
        config, stands = self._config, self._view.base_from_panel
        foot = stands.inverse().apply(tip)
        mirrored = stands.apply(foot * (1.0, 1.0, -1.0))
        key = mirrored.tobytes(), self._view.light
        if self._mirrored is None or self._mirrored[0] != key:
            counts, self._counts = self._counts, (_MOVING_COUNT, _MOVING_BALL_COUNT)
            stem, shaft = (length / 1000 for length in (config.stem_mm, config.shaft_mm))
            parts = [
                self._rod(mirrored, mirrored[2] - shaft, mirrored[2] - stem, config.shaft_diameter_mm / 2000),
                self._rod(mirrored, mirrored[2] - stem, mirrored[2], config.stem_diameter_mm / 2000),
                self._ball(mirrored, config.ball_diameter_mm / 2000),
            ]
            self._counts = counts
            self._mirrored = key, [part for part in parts if part is not None]
        for part in self._mirrored[1]:
            rows, columns = (slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(part.window, window))
            if rows.start < rows.stop and columns.start < columns.stop:
                top, left = rows.start - part.window[0].start, columns.start - part.window[1].start
                light = part.light[top : top + rows.stop - rows.start, left : left + columns.stop - columns.start]
                added = np.rint(np.clip(light * reflectance, 0, 255)).astype(np.uint8)
                picture[rows, columns] = cv2.add(picture[rows, columns], added)

    def cast_shadow(self, picture: Picture, tip: Array) -> None:
        """Darken the panel in the shadow of ball, shaft and arm; call this before adding the light of the screen."""
        if self._shaded != tip.tobytes():
            self._shade, self._shaded = self._shadow(tip), tip.tobytes()
        window, left = self._shade
        picture[window] = cv2.multiply(picture[window], left, scale=1 / 255)

    def _shadow(self, tip: Array) -> tuple[Window, Picture]:
        """Return the window of the shadow, and the share of light that remains, of 255."""
        config = self._config
        arm, half = config.arm_height_m, config.arm_width_mm / 2000
        rod = config.shaft_diameter_mm / 2000
        # Outlines in base_link; high parts cast their shadow far to the right and down.
        start = tip[2] + config.stem_mm / 1000
        shaft = [(tip[0] + dx, tip[1], z) for dx, z in ((-rod, start), (-rod, arm), (rod, arm), (rod, start))]
        beam = [
            (tip[0] + dx, tip[1] + dy, arm) for dx, dy in ((-half, -0.006), (-half, 0.4), (half, 0.4), (half, -0.006))
        ]
        ball = config.ball_diameter_mm / 2000
        turn = np.linspace(0, 2 * np.pi, 8, endpoint=False)
        disc = [(tip[0] + ball * np.cos(t), tip[1] + ball * np.sin(t), tip[2]) for t in turn]
        outlines = [self._view.camera.project(self._shadow_of(np.array(part))) for part in (shaft, beam, disc)]
        window = window_around(np.vstack(outlines), 4 * _SHADOW_BLUR_PX, self._view.camera)
        rows, columns = window
        height, width = rows.stop - rows.start, columns.stop - columns.start
        # Half the resolution is enough for the detail of such a soft shadow.
        mask = np.zeros(((height + 1) // 2, (width + 1) // 2), np.uint8)
        for outline in outlines:
            inside = (np.clip(outline, -2000, 4000) - (columns.start, rows.start) + 0.5) / 2 - 0.5
            cv2.fillConvexPoly(mask, np.round(inside * 16).astype(np.int32), (_SHADOW_DEPTH,), cv2.LINE_AA, 4)
        left = 255 - cv2.GaussianBlur(mask, (0, 0), _SHADOW_BLUR_PX / 2)
        left = cv2.resize(left, (2 * mask.shape[1], 2 * mask.shape[0]), interpolation=cv2.INTER_LINEAR)
        return window, np.asarray(cv2.cvtColor(left[:height, :width], cv2.COLOR_GRAY2BGR), np.uint8)

    def _shadow_of(self, points: Array) -> Array:
        """Slide points along the light onto the panel's face; (N, 3) metres in base_link."""
        stands = self._view.base_from_panel
        in_panel = stands.inverse().apply(points)
        height = np.maximum(in_panel[:, 2:], 0)
        slid = in_panel[:, :2] - SHADOW_REACH * height * LAMP_DIRECTION
        return stands.apply(np.column_stack([slid, np.minimum(in_panel[:, 2], 0)]))

    def _over(self, picture: Picture, parts: list[_Part]) -> None:
        for part in parts:
            mixed = picture[part.window] * part.left + part.light
            picture[part.window] = np.clip(mixed + 0.5, 0, 255).astype(np.uint8)

    def _rays(self, window: Window, count: int) -> tuple[Array, Array]:
        lean = self._view.samples(self._lean, window, count)
        return lean[0], lean[1]

    def _window(self, corners: Array, tip: Array) -> Window:
        """Return the pixels around (N, 3) corners relative to the tip, for all tip positions of the exposure."""
        places = corners + tip
        if self._rows is not None:
            middle = self._rows[len(self._rows) // 2]
            low, high = self._rows.min(axis=0) - middle, self._rows.max(axis=0) - middle
            ends = ((low[0], low[1], low[2]), (low[0], high[1], high[2]), (high[0], low[1], low[2]), tuple(high))
            places = np.concatenate([places + end for end in ends])
        return window_around(self._view.camera.project(places), self._margin(), self._view.camera)

    def _from_tip(self, tip: Array, window: Window, count: int) -> tuple[Any, Any, Any]:
        """Return the eye relative to the ball's centre: numbers, or (rows * count, 1) of a moving stylus."""
        if self._rows is None:
            ex, ey, ez = self._eye - tip
            return ex, ey, ez
        rows = window[0]
        at = rows.start + (np.arange((rows.stop - rows.start) * count) + 0.5) / count - 0.5
        known = np.arange(len(self._rows))
        ex, ey, ez = ((e - np.interp(at, known, column))[:, None] for e, column in zip(self._eye, self._rows.T))
        return ex, ey, ez

    def _from_axis(self, axis: Array, window: Window, count: int) -> tuple[Any, Any, float]:
        """Return the eye relative to the foot of the stylus's axis at z = 0."""
        if self._rows is None:
            ex, ey, ez = (self._eye - (*axis[:2], 0.0)).tolist()
            return ex, ey, ez
        ex, ey, _ = self._from_tip(axis, window, count)
        return ex.astype(np.float32), ey.astype(np.float32), float(self._eye[2])

    def _gather(self, window: Window, hit: npt.NDArray[np.bool_], colour: npt.NDArray[Any], middle: Array) -> _Part:
        size = (window[1].stop - window[1].start, window[0].stop - window[0].start)
        samples = hit.astype(np.float32)
        share = cv2.resize(samples, size, interpolation=cv2.INTER_AREA)
        light = cv2.resize((colour * samples[..., None]).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        blur = float(self._view.focus.sigma_px(self._view.depth_m(middle)))
        if blur > 0:
            share, light = (cv2.GaussianBlur(layer, (0, 0), blur) for layer in (share, light))
        return _Part(
            window=window,
            left=np.asarray(1 - share[..., None], np.float32),
            light=np.asarray(light * (self._view.light.level * self._view.vignette[window])[..., None], np.float32),
        )

    def _margin(self) -> int:
        tip = self._tip if self._tip is not None else np.zeros(3)
        return int(np.ceil(3 * float(self._view.focus.sigma_px(self._view.depth_m(tip))))) + 2

    def _ball(self, tip: Array, radius: float) -> _Part | None:
        corners = radius * 1.1 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        window = self._window(corners, tip)
        dx, dy = self._rays(window, self._counts[1])
        # |eye + t d - tip| = radius with d = (dx, dy, -1).
        ex, ey, ez = self._from_tip(tip, window, self._counts[1])
        a = dx**2 + dy**2 + 1
        b = ex * dx + ey * dy - ez
        c = ex**2 + ey**2 + ez**2 - radius**2
        root = b**2 - a * c
        hit = root >= 0
        t = (-b - np.sqrt(np.maximum(root, 0))) / a
        nx, ny, nz = (ex + t * dx) / radius, (ey + t * dy) / radius, (ez - t) / radius
        facing = nx * LIGHT[0] + ny * LIGHT[1] + nz * LIGHT[2]
        shade = 0.52 + 0.48 * np.clip(facing, -0.2, 1)
        eighth = _to_the_eighth(np.clip(facing, 0, 1))
        spark = np.square(np.square(eighth)) * eighth * 70
        return self._gather(window, hit, shade[..., None] * BALL + spark[..., None], tip)

    def _rod(
        self,
        axis: Array,
        low: float,
        high: float,
        radius: float,
        ball: Array | None = None,
        ball_radius: float = 0.0,
    ) -> _Part | None:
        """Cast an upright cylinder between two heights, with its upper face; ``ball`` hides the part inside it."""
        if high <= low:
            return None
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 1)], dtype=np.float64)
        corners = corners * (radius, radius, high - low) + (0.0, 0.0, low)
        window = self._window(corners, np.array([axis[0], axis[1], 0.0]))
        dx, dy = (ray.astype(np.float32) for ray in self._rays(window, self._counts[0]))
        ex, ey, ez = self._from_axis(axis, window, self._counts[0])
        # Upper face, then the side: |(ex, ey) + t (dx, dy)| = radius. The term under its root is written with
        # Lagrange's identity: float32 has too few digits for the difference of two large squares.
        t_top = ez - high
        cap = (ex + t_top * dx) ** 2 + (ey + t_top * dy) ** 2 <= radius**2
        a = dx**2 + dy**2
        root = a * radius**2 - (ex * dy - ey * dx) ** 2
        t = (-(ex * dx + ey * dy) - np.sqrt(np.maximum(root, 0))) / np.maximum(a, 1e-12)
        z = ez - t
        x, y = ex + t * dx, ey + t * dy
        side = ~cap & (root >= 0) & (z <= high) & (z >= low)
        if ball is not None:
            bx, by, bz = (ball - (*axis[:2], 0.0)).tolist()
            side &= (x - bx) ** 2 + (y - by) ** 2 + (z - bz) ** 2 >= ball_radius**2
        nx, ny = x / radius, y / radius
        facing = nx * float(LIGHT[0]) + ny * float(LIGHT[1])
        shade = np.where(
            cap, 1.7, 0.75 + 0.9 * np.clip(facing, -0.3, 1) + 0.9 * _to_the_eighth(np.clip(nx + 0.2, 0, 1))
        )
        middle = np.array([axis[0], axis[1], (low + high) / 2])
        return self._gather(window, cap | side, shade[..., None] * SHAFT.astype(np.float32), middle)

    def _arm(self, picture: Picture, tip: Array) -> None:
        """Draw the arm: its front end, then its upper face to beyond the edge of the image."""
        config = self._config
        half, low, high = config.arm_width_mm / 2000, config.arm_height_m, config.arm_height_m + 0.008
        near, far = tip[1] - 0.006, tip[1] + 0.4
        y = np.linspace(near, far, 12)
        left = np.column_stack([np.full(12, tip[0] - half), y, np.full(12, high)])
        right = np.column_stack([np.full(12, tip[0] + half), y, np.full(12, high)])
        front = np.array([(x, near, z) for x, z in ((-1, low), (1, low), (1, high), (-1, high))]) + (tip[0], 0, 0)
        front[:, 0] = tip[0] + (front[:, 0] - tip[0]) * half
        eye_left = self._eye[0] < tip[0]
        side = left if eye_left else right
        below = side - (0, 0, high - low)
        gain = self._view.light.level
        for outline, shade in (
            (np.vstack([side, below[::-1]]), 0.75 if eye_left else 0.6),
            (front, 0.55),
            (np.vstack([left, right[::-1]]), 1.25),
        ):
            pixels = self._view.camera.project(outline)
            if self._rows is not None:
                at = np.clip(np.rint(pixels[:, 1]), 0, len(self._rows) - 1).astype(int)
                pixels = self._view.camera.project(outline + (self._rows[at] - tip) * (1.0, 1.0, 0.0))
            points = np.round(np.clip(pixels, -2000, 4000) * 16).astype(np.int32)
            colour = tuple(float(c) for c in np.minimum(ARM * shade * gain, 255))
            cv2.fillPoly(picture, [points], colour, cv2.LINE_AA, 4)


def _to_the_eighth(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the eighth power; numpy's own takes as long as the rest of the ball."""
    return np.asarray(np.square(np.square(np.square(values))))
