"""A ray-cast stylus before a panel, seen by a distorted stereo pair: truth for the tests of the stylus tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.camera_model import CameraModel, StereoModel

Array = npt.NDArray[Any]
TILT = np.deg2rad(25.0)
AXIS = np.array([0.0, -np.sin(TILT), -np.cos(TILT)])
"""The stylus's axis from the ball to the carriage, in the left camera's frame: towards the viewer and up."""
UP = np.array([0.0, -np.cos(TILT), np.sin(TILT)])
"""Up the panel's face."""


def rotation(rx: float, ry: float, rz: float) -> Array:
    return np.asarray(cv2.Rodrigues(np.array([rx, ry, rz]))[0])


def stereo_model(width: int = 800, height: int = 480, focal: float = 1700.0) -> StereoModel:
    """A verged, distorted pair of 0.12 m baseline; a narrow view, so that rendering is quick."""
    cx, cy = (width - 1) / 2, (height - 1) / 2
    cameras = []
    for side, vergence, shift in (("left", 0.03, 0.0), ("right", -0.025, -0.12 * focal)):
        cameras.append(
            CameraModel(
                name=side,
                width=width,
                height=height,
                k=np.array([[focal * 1.002, 0, cx + 4], [0, focal * 0.998, cy - 3], [0, 0, 1]]),
                d=np.array([-0.08, 0.02, 0.0003, -0.0004, 0.0]),
                r=rotation(0.004 * np.sign(vergence), vergence, 0.002),
                p=np.array([[focal, 0, cx, shift], [0, focal, cy, 0], [0, 0, 1, 0]]),
            )
        )
    return StereoModel(left=cameras[0], right=cameras[1])


@dataclass(frozen=True, kw_only=True)
class Look:
    """Values that vary between scenes; lengths in metres, colours BGR."""

    ball: tuple[float, float, float] = (190.0, 25.0, 225.0)
    shaft: tuple[float, float, float] = (32.0, 30.0, 30.0)
    panel: tuple[float, float, float] = (150.0, 152.0, 148.0)
    light: tuple[float, float, float] = (0.3, -0.6, -0.75)
    ambient: float = 0.45
    shaft_radius: float = 0.0025
    shaft_from: float = 0.006
    ball_radius: float = 0.002
    blur_px: float = 0.7
    noise: float = 2.0
    lamp: tuple[float, float, float] | None = None
    lamp_up: float = 0.0
    """A lamp that is the panel's lower part, from so far up the panel behind the ball on."""
    hidden_from: float | None = None
    """Hide everything right of this raw column: a cable before one camera."""


def _pictured(
    model: CameraModel, origin: Array, tip: Array, look: Look, texture: Array, roi: tuple[int, int, int, int]
) -> Array:
    """Cast rays, 5 x 5 per pixel, through a window (x0, y0, x1, y1) of the raw picture; tip in the model's frame."""
    x0, y0, x1, y1 = roi
    sub = (np.arange(5) - 2) / 5
    us = (np.arange(x0, x1)[:, None] + sub).ravel()
    vs = (np.arange(y0, y1)[:, None] + sub).ravel()
    grid = np.stack(np.meshgrid(us, vs), axis=-1).reshape(-1, 2)
    rays = model.rays(grid)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    light = np.array(look.light) / np.linalg.norm(look.light)
    # panel: a plane a little below the ball, with a texture of its own
    foot = tip - 0.02 * AXIS
    depth = (foot @ AXIS) / (rays @ AXIS)
    spot = rays * depth[:, None] - foot
    right = np.array([1.0, 0.0, 0.0])
    tu = (spot @ right * 4000).astype(int) % texture.shape[1]
    tv = (spot @ UP * 4000).astype(int) % texture.shape[0]
    colour = np.array(look.panel) * texture[tv, tu][:, None]
    if look.lamp is not None:
        # Seen from the camera, what is behind the ball lies higher up the panel than its foot.
        behind = (tip / tip[2] * (foot @ AXIS) / (tip / tip[2] @ AXIS) - foot) @ UP
        colour[spot @ UP < behind + look.lamp_up] = look.lamp
    # ball
    b = rays @ tip
    root = b * b - (tip @ tip - look.ball_radius**2)
    hit = root > 0
    t = b - np.sqrt(np.maximum(root, 0))
    normal = (rays * t[:, None] - tip) / look.ball_radius
    shade = look.ambient + (1 - look.ambient) * np.maximum(normal @ light, 0)
    colour[hit] = (np.array(look.ball) * shade[:, None])[hit]
    depth = np.where(hit, t, depth)
    # shaft: a capped cylinder from tip + shaft_from along the axis, and the arm that holds it
    base = tip + look.shaft_from * AXIS
    for start, direction, radius, length in (
        (base, AXIS, look.shaft_radius, 0.06),
        (tip + 0.04 * AXIS, UP, 0.005, 0.2),
    ):
        across = rays - np.outer(rays @ direction, direction)
        offset = start - (start @ direction) * direction
        qa = np.einsum("ij,ij->i", across, across)
        qb = across @ offset
        qc = offset @ offset - radius**2
        disc = qb * qb - qa * qc
        t = (qb - np.sqrt(np.maximum(disc, 0))) / qa
        along = rays @ direction * t - start @ direction
        side = (disc > 0) & (along > 0) & (along < length) & (t < depth)
        t_cap = (start @ direction) / (rays @ direction)
        cap_off = rays * t_cap[:, None] - start
        cap = (np.einsum("ij,ij->i", cap_off, cap_off) < radius**2) & (t_cap < depth)
        hidden = side | cap
        shade = np.where(cap, 0.7, 0.8 + 0.2 * np.clip(along / length, 0, 1))
        colour[hidden] = (np.array(look.shaft) * shade[:, None])[hidden]
        depth = np.where(side, t, np.where(cap, t_cap, depth))
    height, width = y1 - y0, x1 - x0
    return colour.reshape(height, 5, width, 5, 3).mean(axis=(1, 3))


def render(
    stereo: StereoModel, tip: Array, rng: np.random.Generator, look: Look | None = None, margin_px: int = 30
) -> list[Array]:
    """Return left and right raw pictures, (H, W, 3) uint8, with the ball's centre at ``tip`` (left rectified frame)."""
    look = look if look is not None else Look()
    texture = cv2.GaussianBlur(rng.uniform(0.7, 1.3, (400, 400)), (0, 0), 2.0)
    pictures = []
    for model, shift in ((stereo.left, 0.0), (stereo.right, stereo.baseline)):
        seen = np.asarray(tip, dtype=np.float64) - [shift, 0.0, 0.0]
        width, height = model.size
        shades = cv2.resize(rng.uniform(0.6, 1.3, (36, 64)), model.size, interpolation=cv2.INTER_CUBIC)
        picture = shades[:, :, None] * np.array(look.panel)
        u, v = (round(float(x)) for x in model.project(seen)[0])
        x0, y0 = max(u - margin_px, 0), max(v - margin_px, 0)
        x1, y1 = min(u + margin_px, width), min(v + margin_px, height)
        picture[y0:y1, x0:x1] = _pictured(model, np.zeros(3), seen, look, texture, (x0, y0, x1, y1))
        if look.hidden_from is not None:
            picture[:, max(0, int(u + look.hidden_from)) :] = 40.0
        picture = cv2.GaussianBlur(picture, (0, 0), look.blur_px) + rng.normal(0, look.noise, picture.shape)
        pictures.append(np.clip(np.round(picture), 0, 255).astype(np.uint8))
    return pictures


STEREO = stereo_model()
TIP = np.array([0.03, -0.02, 0.66])
MAGENTA = (190, 25, 225)


def draw(pictures: list[np.ndarray[Any, Any]], tip: Any, paint: Any) -> None:
    """Paint something at the projection of ``tip`` in both pictures."""
    for picture, at in zip(pictures, (STEREO.left.project(tip)[0], STEREO.project_right(tip)[0])):
        paint(picture, tuple(round(float(v) * 16) for v in at))
