"""Casts the stylus into the picture: ball, stem, shaft and arm, per frame and only where they are.

The ball is a sphere hit by the exact ray of every sample, so its outline is exact under perspective and distortion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry import Array
from scope_bench.core.configuration import LightConfig, StylusConfig
from scope_bench.core.panel_texture import Picture
from scope_bench.core.solids import LAMP_DIRECTION, SHADOW_REACH
from scope_bench.core.view import View, Window, window_around

BALL = np.array([176.0, 22.0, 226.0])
"""Magenta, BGR; nothing else on the bench has this hue."""
SHAFT = np.array([46.0, 44.0, 42.0])
ARM = np.array([52.0, 50.0, 48.0])
LIGHT = np.array([-0.35, 0.45, 0.82])
_SHADOW_DEPTH, _SHADOW_BLUR_PX = 90, 5
_COUNT, _BALL_COUNT = 3, 6
"""Samples per pixel and direction; the ball is measured, the rest only seen."""
_MOVING_COUNT, _MOVING_BALL_COUNT = 1, 2
"""The same while the stylus travels."""
_MOVING_M = 0.001
"""Distance between two images above which the stylus travels; nothing measures it to a fraction of a pixel then."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Part:
    """Where a part is, the share that it leaves of what is under it, (H, W, 1), and its own light, (H, W, 3)."""

    window: Window
    left: npt.NDArray[np.float32]
    light: npt.NDArray[np.float32]


class StylusPainter:
    """Draws the stylus over a picture of one view; what it needs for that is kept as long as the stylus stands."""

    def __init__(self, view: View, config: StylusConfig) -> None:
        self._view = view
        self._config = config
        # Rays in base_link with z = -1: the cameras look down at the bench.
        self._lean, self._eye = view.rays.lean, view.rays.eye
        self._tip: Array | None = None
        self._counts = _COUNT, _BALL_COUNT
        self._drawn: tuple[bytes, LightConfig, tuple[int, int]] | None = None
        self._below_arm: list[_Part] = []
        self._above_arm: list[_Part] = []
        self._shaded: bytes | None = None
        self._shade: tuple[Window, Picture] = (slice(0), slice(0)), np.empty((0, 0, 3), np.uint8)

    def draw(self, picture: Picture, tip: Array) -> None:
        """Draw the stylus with its ball's centre at ``tip``, (3,) metres in base_link, into ``picture``."""
        travels = self._tip is not None and np.abs(tip - self._tip).max() > _MOVING_M
        self._tip, self._counts = tip, (_MOVING_COUNT, _MOVING_BALL_COUNT) if travels else (_COUNT, _BALL_COUNT)
        as_drawn = tip.tobytes(), self._view.light, self._counts
        if self._drawn != as_drawn:
            self._cast(tip)
            self._drawn = as_drawn
        # From far to near: the camera looks down, so what is higher hides what is lower.
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

    def cast_shadow(self, picture: Picture, tip: Array) -> None:
        """Darken the panel where ball, shaft and arm keep the lamp's light away; done before the screen shines."""
        if self._shaded != tip.tobytes():
            self._shade, self._shaded = self._shadow(tip), tip.tobytes()
        window, left = self._shade
        picture[window] = cv2.multiply(picture[window], left, scale=1 / 255)

    def _shadow(self, tip: Array) -> tuple[Window, Picture]:
        """Return where the shadow is, and the share of light that it leaves, of 255."""
        config = self._config
        arm, half = config.arm_height_m, config.arm_width_mm / 2000
        rod = config.shaft_diameter_mm / 2000
        # Outlines in base_link; what is high throws its shadow far to the right and down.
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
        # So soft a shadow has no more detail than half the pixels hold.
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

    def _gather(self, window: Window, hit: npt.NDArray[np.bool_], colour: npt.NDArray[Any]) -> _Part:
        size = (window[1].stop - window[1].start, window[0].stop - window[0].start)
        samples = hit.astype(np.float32)
        share = cv2.resize(samples, size, interpolation=cv2.INTER_AREA)
        light = cv2.resize((colour * samples[..., None]).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        blur = self._view.light.blur_px
        if blur > 0:
            share, light = (cv2.GaussianBlur(layer, (0, 0), blur) for layer in (share, light))
        return _Part(
            window=window,
            left=np.asarray(1 - share[..., None], np.float32),
            light=np.asarray(light * (self._view.light.level * self._view.vignette[window])[..., None], np.float32),
        )

    def _margin(self) -> int:
        return int(np.ceil(3 * self._view.light.blur_px)) + 2

    def _ball(self, tip: Array, radius: float) -> _Part | None:
        corners = tip + radius * 1.1 * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        window = window_around(self._view.camera.project(corners), self._margin(), self._view.camera)
        dx, dy = self._rays(window, self._counts[1])
        # |eye + t d - tip| = radius with d = (dx, dy, -1).
        ex, ey, ez = self._eye - tip
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
        return self._gather(window, hit, shade[..., None] * BALL + spark[..., None])

    def _rod(
        self,
        axis: Array,
        low: float,
        high: float,
        radius: float,
        ball: Array | None = None,
        ball_radius: float = 0.0,
    ) -> _Part | None:
        """Cast an upright cylinder between two heights, with its upper face; ``ball`` hides what lies inside it."""
        if high <= low:
            return None
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 1)], dtype=np.float64)
        corners = corners * (radius, radius, high - low) + (axis[0], axis[1], low)
        window = window_around(self._view.camera.project(corners), self._margin(), self._view.camera)
        dx, dy = (ray.astype(np.float32) for ray in self._rays(window, self._counts[0]))
        ex, ey, ez = (self._eye - (*axis[:2], 0.0)).tolist()
        # Upper face, then the side: |(ex, ey) + t (dx, dy)| = radius. What is under its root is written as by
        # Lagrange's identity: float32 has too few digits for the difference of two large squares.
        t_top = float(ez - high)
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
        return self._gather(window, cap | side, shade[..., None] * SHAFT.astype(np.float32))

    def _arm(self, picture: Picture, tip: Array) -> None:
        """Draw the arm: its front end, then its upper face up to beyond the picture."""
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
            points = np.round(np.clip(pixels, -2000, 4000) * 16).astype(np.int32)
            colour = tuple(float(c) for c in np.minimum(ARM * shade * gain, 255))
            cv2.fillPoly(picture, [points], colour, cv2.LINE_AA, 4)


def _to_the_eighth(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the eighth power; numpy's own takes as long as all else of a ball together."""
    return np.asarray(np.square(np.square(np.square(values))))
