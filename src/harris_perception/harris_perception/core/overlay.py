"""Corners and edges drawn into a picture for people."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Color = tuple[int, int, int]

_GREEN: Color = (80, 255, 80)
_DARK: Color = (0, 60, 0)


def draw_corners(picture: npt.NDArray[np.uint8], xy: npt.NDArray[Any], color: Color = _GREEN) -> None:
    """Draw a cross with a dark outline at each corner, in place.

    Parameters
    ----------
    picture
        (H, W, 3) uint8 BGR.
    xy
        (N, 2) px.
    color
        BGR.
    """
    arms = [(d, 0) for d in range(-3, 4)] + [(0, d) for d in range(-3, 4)]
    outline = {(x + dx, y + dy) for x, y in arms for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
    centres = np.rint(xy).astype(np.intp).reshape(-1, 2)
    for offsets, value in ((sorted(outline), _DARK), (arms, color)):
        points = (centres[:, None, :] + np.array(offsets)[None, :, :]).reshape(-1, 2)
        inside = (points >= 0).all(axis=1) & (points < (picture.shape[1], picture.shape[0])).all(axis=1)
        picture[points[inside, 1], points[inside, 0]] = value
