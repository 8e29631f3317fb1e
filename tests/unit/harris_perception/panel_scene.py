"""Pictures of a panel with known truth, made independently of the template: rays from every pixel, proud controls,
a changing screen, an arm in front, uneven light, blur and noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from harris_perception.core.recognition.panel_template import draw_panel
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control, PanelLayout, load_layout, rgb

LAYOUT = Path(__file__).parents[3] / "config" / "scopes" / "dso_bench_4.yaml"
_TEXTURE_PX_PER_MM = 8.0


@cache
def bench_layout() -> PanelLayout:
    return load_layout(LAYOUT)


def camera(width: int = 1280, height: int = 720, focal: float = 1700.0, k1: float = -0.08) -> CameraModel:
    distortion = np.array([k1, 0.05, 0.001, -0.001, 0.0])
    k = np.array([[focal, 0.0, width / 2 + 4.0], [0.0, focal, height / 2 - 3.0], [0.0, 0.0, 1.0]])
    turn = np.asarray(cv2.Rodrigues(np.array([0.002, -0.004, 0.003]))[0])
    p = np.column_stack([k, np.zeros(3)])
    return CameraModel(name="left", width=width, height=height, k=k, d=distortion, r=turn, p=p)


def pose(
    layout: PanelLayout,
    distance_m: float = 0.65,
    below_deg: float = 25.0,
    side_deg: float = 0.0,
    roll_deg: float = 0.0,
    shift_m: tuple[float, float] = (0.0, 0.0),
) -> Transform:
    """camera_from_panel of a camera that looks at the panel's centre from below, from the side and rolled."""
    a, b, c = np.radians([-below_deg, side_deg, roll_deg])
    flip = np.diag([1.0, -1.0, -1.0])  # panel axes (y up, z to the viewer) to camera axes (y down, z away)
    tilt = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    pan = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    roll = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    rotation = roll @ pan @ tilt @ flip
    centre = np.array([layout.size_mm[0] / 2, layout.size_mm[1] / 2, 0.0]) * 1e-3
    return Transform(rotation, np.array([*shift_m, distance_m]) - rotation @ centre)


@dataclass(frozen=True)
class Look:
    """Effects between the truth and the image."""

    noise: float = 2.0
    blur_px: float = 0.6
    gain: float = 1.0
    gradient: float = 0.25
    glare: float = 0.0
    screen_seed: int = 1
    arm_x_mm: float | None = 180.0
    arm_width_mm: float = 12.0
    hidden: float = 0.0
    lit: bool = True
    spot_px: int = 0


@cache
def _rays(model: CameraModel) -> Array:
    """(H, W, 3) directions of all pixels in the rectified frame."""
    columns, rows = np.meshgrid(np.arange(model.width), np.arange(model.height))
    return model.rays(np.column_stack([columns.ravel(), rows.ravel()])).reshape(model.height, model.width, 3)


class _View:
    """Where the rays of a part of the picture meet planes parallel to the face."""

    def __init__(self, model: CameraModel, camera_from_panel: Transform) -> None:
        back = camera_from_panel.inverse()
        self.directions = (_rays(model) @ back.rotation.T).astype(np.float32)
        self.origin = back.translation
        self.model, self.pose = model, camera_from_panel

    def meet(self, height_mm: float, window: Any = np.s_[:, :]) -> tuple[Any, Any]:
        rays = self.directions[window].astype(np.float64)
        along = (height_mm * 1e-3 - self.origin[2]) / rays[..., 2]
        return ((self.origin[i] + along * rays[..., i]) * 1e3 for i in (0, 1))  # type: ignore[return-value]

    def window(self, control: Control) -> Any:
        """The part of the picture that a control can cover."""
        (x, y), (w, h) = control.position_mm, control.size_mm
        box = [(x + i * w / 2, y + j * h / 2, z) for i in (-1, 1) for j in (-1, 1) for z in (0, control.height_mm)]
        pixels = self.model.project(self.pose.apply(np.array(box) * 1e-3))
        low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 3, 0, None)
        high = np.ceil(pixels.max(axis=0)).astype(int) + 3
        return np.s_[low[1] : high[1], low[0] : high[0]]


def picture(layout: PanelLayout, model: CameraModel, camera_from_panel: Transform, look: Look, seed: int) -> Any:
    """Return the raw grey image, (H, W) uint8."""
    rng = np.random.default_rng(seed)
    size, scale = (model.width, model.height), _TEXTURE_PX_PER_MM
    view = _View(model, camera_from_panel)
    x, y = view.meet(0.0)
    footprint = 0.5 * scale / (model.k[0, 0] * 1e-3 / camera_from_panel.translation[2])
    texture = cv2.GaussianBlur(_texture(layout, look), (0, 0), max(0.5, footprint))
    u, v = (x * scale - 0.5).astype(np.float32), ((layout.size_mm[1] - y) * scale - 0.5).astype(np.float32)
    face = cv2.remap(texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    table = cv2.resize(rng.integers(30, 120, (24, 40)).astype(np.float32), size)
    result = np.where((x >= 0) & (x <= layout.size_mm[0]) & (y >= 0) & (y <= layout.size_mm[1]), face, table)
    for control in sorted(layout.controls, key=lambda c: -c.position_mm[1]):
        window = view.window(control)
        for height in range(1, round(control.height_mm) + 1):
            a, b = view.meet(float(height), window)
            dx, dy = (
                (a - control.position_mm[0]) / control.size_mm[0],
                (b - control.position_mm[1]) / control.size_mm[1],
            )
            on = dx**2 + dy**2 <= 0.25 if control.shape == "circle" else (abs(dx) <= 0.5) & (abs(dy) <= 0.5)
            top = height == round(control.height_mm)
            tone = np.full(on.shape, _tone(control.colour) * (1.0 if top else 0.6))
            if top and control.kind == "knob":
                tone[abs(dx + dy) < 0.06] = 230.0
            result[window] = np.where(on, tone, result[window])
    if look.arm_x_mm is not None:
        a, b = view.meet(35.0)
        result[(abs(a - look.arm_x_mm) < look.arm_width_mm / 2) & (b > 60.0)] = 28.0
    if look.hidden > 0:
        hand = cv2.resize(rng.integers(60, 200, (12, 20)).astype(np.float32), size)
        edge = look.hidden * layout.size_mm[0]
        part = x < edge if rng.random() < 0.5 else x > layout.size_mm[0] - edge
        result = np.where(part, hand, result)
    columns = np.arange(model.width, dtype=np.float32)
    rows = np.arange(model.height, dtype=np.float32)[:, None]
    result = result.astype(np.float32) * (look.gain * (1.0 + look.gradient * (columns / model.width - 0.5)))
    if look.glare:
        away = (columns - 0.6 * model.width) ** 2 + (rows - 0.4 * model.height) ** 2
        result = result + 255 * look.glare * np.exp(-away / (2 * 90.0**2))
    result = cv2.GaussianBlur(result.astype(np.float32), (0, 0), look.blur_px)
    noise = rng.standard_normal(result.shape, dtype=np.float32) * look.noise
    seen = np.clip(np.rint(result + noise), 0, 255).astype(np.uint8)
    if look.spot_px:  # a hot pixel, or a lamp
        left, top = int(rng.integers(model.width - look.spot_px)), int(rng.integers(model.height - look.spot_px))
        seen[top : top + look.spot_px, left : left + look.spot_px] = 255
    return seen


@cache
def _face(layout: PanelLayout) -> Any:
    return cv2.cvtColor(draw_panel(layout, _TEXTURE_PX_PER_MM), cv2.COLOR_BGR2GRAY).astype(np.float32)


def _texture(layout: PanelLayout, look: Look) -> Any:
    texture = _face(layout).copy()
    rng = np.random.default_rng(look.screen_seed)
    for control in layout.controls:
        x, y = control.position_mm
        width, height = control.size_mm
        top, bottom = ((layout.size_mm[1] - y + s * height / 2) * _TEXTURE_PX_PER_MM for s in (-1, 1))
        left, right = ((x + s * width / 2) * _TEXTURE_PX_PER_MM for s in (-1, 1))
        area = texture[int(top) : int(bottom), int(left) : int(right)]
        if control.kind == "touch_area":
            wave = np.cumsum(rng.normal(0, 6, area.shape[1])) + area.shape[0] / 2
            points = np.column_stack([np.arange(area.shape[1]), np.clip(wave, 5, area.shape[0] - 5)]).astype(np.int32)
            cv2.polylines(area, [points], False, 220.0, 4)
            area[:: area.shape[0] // 8] = 70
            area[:, :: area.shape[1] // 10] = 70
        elif look.lit and control.lit_colour:
            area[:] = _tone(control.lit_colour)
    return texture


def _tone(colour: str) -> float:
    red, green, blue = rgb(colour)
    return 0.299 * red + 0.587 * green + 0.114 * blue


def control_points_m(layout: PanelLayout) -> Array:
    """The centres of all controls' top faces in panel_link, (N, 3) metres."""
    return np.array([(*c.position_mm, c.height_mm) for c in layout.controls]) * 1e-3
