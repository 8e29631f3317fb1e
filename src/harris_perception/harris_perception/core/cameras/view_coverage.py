"""Coverage by the views of a board, and what to show next; known before calibrating, while the board is shown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.board_detection import BoardView
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message, joined

_STILL_PX = 2.0


class CalibrationError(ValueError):
    """The views are unsuitable for a calibration; the message says what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """Range of the views in one of x, y, size and skew.

    Attributes
    ----------
    name
        x, y: minimum and maximum of the corners' positions, as a share of the image's width or height. size: square
        root of the board's share of the image. skew: 0 = a rectangle, 1 = an angle that is 30 degrees or more off.
    low, high
        Limits of the range.
    missing
        Advice for the next view; empty if the range is covered.
    """

    name: str
    low: float
    high: float
    missing: str


def is_still(before: BoardView, now: BoardView) -> bool:
    """Return whether the board's pose is the same in both views, except for trembling hands and image noise."""
    _, i, j = np.intersect1d(before.ids, now.ids, return_indices=True)
    return len(i) > 0 and bool(np.abs(before.xy[i] - now.xy[j]).max() <= _STILL_PX)


def held_alike(views: Sequence[BoardView]) -> list[int]:
    """Return (N,) for each view the number of the first view with the same board pose."""
    first: list[int] = []
    for i, view in enumerate(views):
        first.append(next((j for j in sorted(set(first)) if is_still(views[j], view)), i))
    return first


def _homography(board: CalibrationBoard, view: BoardView) -> Array:
    """Return (3, 3) image_from_board."""
    found, _ = cv2.findHomography(board.points()[view.ids, :2], view.xy)
    if found is None:
        raise CalibrationError(f"{view.name}: the corners do not fit a flat board; take this picture out")
    return np.asarray(found, dtype=np.float64)


def view_place(board: CalibrationBoard, view: BoardView) -> Array:
    """Return (4,) x, y, size, skew of one view, each about 0 to 1, to compare it with others.

    Raises
    ------
    CalibrationError
        If the corners do not fit a flat board; also raised by :func:`coverage` and :func:`tilt_spread_deg`.
    """
    width, height = view.size
    w, h = (board.columns - 1) * board.square_m, (board.rows - 1) * board.square_m
    outer = cv2.perspectiveTransform(np.array([[[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]]]), _homography(board, view))[0]
    before, after = np.roll(outer, 1, axis=0) - outer, np.roll(outer, -1, axis=0) - outer
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    angles = np.arccos(np.clip((before * after).sum(axis=1) / lengths, -1, 1))
    skew = min(1.0, float(np.abs(angles - np.pi / 2).max() / (np.pi / 6)))
    hull = cv2.contourArea(cv2.convexHull(view.xy.astype(np.float32)))
    x, y = view.xy.mean(axis=0) / (width, height)
    return np.array([x, y, np.sqrt(hull / (width * height)), skew])


def coverage(board: CalibrationBoard, views: Sequence[BoardView]) -> tuple[Reach, ...]:
    """Return the coverage in x, y, size and skew (the four of ROS's camera_calibration)."""
    if not views:
        return tuple(
            Reach(name=n, low=0.0, high=0.0, missing=Message("views.show_board")) for n in ("x", "y", "size", "skew")
        )
    seen = np.vstack([view.xy / view.size for view in views])
    places = np.array([view_place(board, view) for view in views])
    reaches = []
    for axis, (name, sides) in enumerate((("x", ("left", "right")), ("y", ("upper", "lower")))):
        low, high = float(seen[:, axis].min()), float(seen[:, axis].max())
        needed = [side for side, open_ in zip(sides, (low > 0.12, high < 0.88)) if open_]
        missing = Message("views.show_board_nearer_picture_edge", needed=joined(needed, "text.both")) if needed else ""
        reaches.append(Reach(name=name, low=low, high=high, missing=missing))
    low, high = float(places[:, 2].min()), float(places[:, 2].max())
    missing = Message("views.show_board_farther_away") if high - low < 0.12 and low > 0.3 else ""
    missing = Message("views.show_board_nearer_filling_half") if high < 0.4 else missing
    reaches.append(Reach(name="size", low=low, high=high, missing=missing))
    low, high = float(places[:, 3].min()), float(places[:, 3].max())
    tilted = int((places[:, 3] > 0.25).sum())
    missing = "" if tilted >= 4 else Message("views.tilt_board_20_45_degrees", tilted=tilted)
    reaches.append(Reach(name="skew", low=low, high=high, missing=missing))
    return tuple(reaches)


def tilt_spread_deg(board: CalibrationBoard, views: Sequence[BoardView]) -> float:
    """Return the approximate largest angle between the board's normals in two views, without a calibration.

    The focal length is guessed, so the angles are approximate. Parallel boards are detected with any focal length: the
    columns of ``K^-1 H`` are then equal up to their length.
    """
    normals = []
    for view in views:
        width, height = view.size
        guess = np.array([[max(view.size), 0, width / 2], [0, max(view.size), height / 2], [0, 0, 1.0]])
        columns = np.linalg.solve(guess, _homography(board, view))
        normal = np.cross(columns[:, 0], columns[:, 1])
        normals.append(normal / np.linalg.norm(normal) * np.sign(normal[2] or 1.0))
    return spread_deg(np.array(normals))


def spread_deg(normals: Array) -> float:
    """Return the largest angle between two of (N, 3) unit vectors."""
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1).min())))
