"""Windows of an image, in which the ball is searched and measured."""

from __future__ import annotations

import numpy as np

from harris_perception.core.stylus.ball_view import Picture
from icu_common.core.geometry.geometry import Array

Window = tuple[int, int, int, int]
"""x0, y0, x1, y1 in raw pixels; x1 and y1 are exclusive."""


def around(at: Array, margin: float, window: Window) -> Window:
    """Return the window that extends ``margin`` px beyond a pixel (2,), within another window."""
    x, y = float(at[0]), float(at[1])
    x0, y0, x1, y1 = window
    return (
        max(round(x - margin), x0),
        max(round(y - margin), y0),
        min(round(x + margin), x1),
        min(round(y + margin), y1),
    )


def cut(picture: Picture, window: Window) -> Picture:
    """Return that part of an image (h, w, 3)."""
    x0, y0, x1, y1 = window
    return picture[y0:y1, x0:x1]


def surroundings(picture: Picture, box: Window, window: Window) -> tuple[Picture, Array]:
    """Return the crop (h, w, 3) around a region, whose box is in pixels of the window, and its first raw pixel (2,)."""
    pad = 6
    x0, y0 = max(window[0] + box[0] - pad, window[0]), max(window[1] + box[1] - pad, window[1])
    x1, y1 = min(window[0] + box[2] + pad, window[2]), min(window[1] + box[3] + pad, window[3])
    return cut(picture, (x0, y0, x1, y1)), np.array([x0, y0])
