"""Boards before a known camera: exact corners, and pictures rendered from the board's own rectangles."""

from __future__ import annotations

import functools
from typing import Any

import cv2
import numpy as np

from harris_perception.core.cameras.board import CalibrationBoard, rectangles
from harris_perception.core.cameras.board_detection import BoardView
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array

SIZE = (960, 720)


def camera(name: str = "left", baseline: float = 0.0) -> CameraModel:
    """Return a camera whose rectified frame is its own, so that project() takes points in its own frame."""
    shift = 4.0 if baseline else 0.0
    k = np.array([[900.0 + shift, 0.0, 471.3], [0.0, 903.0 + shift, 365.8 - shift], [0.0, 0.0, 1.0]])
    p = np.column_stack([k, [-900.0 * baseline, 0.0, 0.0]])
    d = np.array([-0.21, 0.09, 0.0006, -0.0004, 0.0])
    return CameraModel(name=name, width=SIZE[0], height=SIZE[1], k=k, d=d, r=np.eye(3), p=p)


def poses(
    rng: np.random.Generator, board: CalibrationBoard, count: int, tilt_deg: float = 32.0
) -> list[tuple[Array, Array]]:
    """Return camera_from_board rotations and translations that keep the board in the picture of camera()."""
    centre = np.append(np.array([board.columns - 1, board.rows - 1]) / 2 * board.square_m, 0.0)
    found = []
    while len(found) < count:
        axis = rng.normal(size=3) * (1.0, 1.0, 0.4)
        turn = cv2.Rodrigues(axis / np.linalg.norm(axis) * np.radians(rng.uniform(0.4, 1.0) * tilt_deg))[0]
        at = rng.uniform((-0.16, -0.11, 0.4), (0.16, 0.11, 0.65))
        xyz = (board.points() - centre) @ turn.T + at
        xy = camera().project(xyz)
        if (xy > 25).all() and (xy < np.array(SIZE) - 25).all():
            found.append((turn, at - turn @ centre))
    return found


def exact(
    board: CalibrationBoard,
    model: CameraModel,
    where: list[tuple[Array, Array]],
    rng: np.random.Generator,
    sigma_px: float,
) -> list[BoardView]:
    """Return views of projected corners with noise."""
    views = []
    for number, (turn, at) in enumerate(where):
        xy = model.project(board.points() @ turn.T + at)
        xy = xy + rng.normal(0, sigma_px, xy.shape)
        views.append(BoardView(name=f"{model.name}{number:02d}", size=model.size, ids=np.arange(len(xy)), xy=xy))
    return views


def pair_poses(where: list[tuple[Array, Array]], turn: Array, shift: Array) -> list[tuple[Array, Array]]:
    """Return the same boards as the right camera sees them; right_from_left is (turn, shift)."""
    return [(turn @ r, turn @ t + shift) for r, t in where]


@functools.cache
def _rays() -> Any:
    u, v = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays = camera().rays(np.column_stack([u.ravel(), v.ravel()]))[:, :2].reshape(SIZE[1], SIZE[0], 2)
    return rays, np.gradient(rays, axis=1), np.gradient(rays, axis=0)


def picture(board: CalibrationBoard, pose: tuple[Array, Array], rng: np.random.Generator) -> Any:
    """Render (H, W) uint8 of camera(): the plane is looked up for 2 x 2 rays in each pixel, then noise is added."""
    per_m, margin = 8000.0, board.square_m
    w, h = (round((v + 2 * margin) * per_m) for v in board.size_m)
    flat = np.full((h, w), 235, np.uint8)
    for part in rectangles(board):
        x, y = (part.x + margin) * per_m, (part.y + margin) * per_m
        rows = slice(round(y), round(y + part.height * per_m))
        flat[rows, round(x) : round(x + part.width * per_m)] = 25 if part.black else 235
    flat = cv2.GaussianBlur(flat, (0, 0), 1.0)
    turn, at = pose
    rays, along_x, along_y = _rays()
    # Board plane to rays as a homography: its inverse maps a ray to metres on the board.
    board_from_ray = np.linalg.inv(np.column_stack([turn[:, :2], at]))
    parts = []
    for dx, dy in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        xy = cv2.perspectiveTransform(rays + dx * along_x + dy * along_y, board_from_ray)
        # The origin is the first inner corner: one square into the squares.
        maps = ((xy + board.square_m + margin) * per_m - 0.5).astype(np.float32)
        parts.append(cv2.remap(flat, maps, None, cv2.INTER_LINEAR, borderValue=(120,)).astype(np.float32))
    mean = cv2.GaussianBlur(np.mean(parts, axis=0), (0, 0), 0.6)
    return np.clip(mean + rng.normal(0, 2, mean.shape) + 0.5, 0, 255).astype(np.uint8)
