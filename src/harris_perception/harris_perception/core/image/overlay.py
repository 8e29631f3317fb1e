"""Drawings of corners and edges on an image, for people."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Color = tuple[int, int, int]

_GREEN: Color = (80, 255, 80)
_DARK: Color = (0, 60, 0)


def draw_corners(picture: npt.NDArray[np.uint8], xy: npt.NDArray[Any]) -> None:
    """Draw a green cross with a dark outline at each corner, in place.

    Parameters
    ----------
    picture
        (H, W, 3) uint8 BGR.
    xy
        (N, 2) px.
    """
    arms = [(d, 0) for d in range(-3, 4)] + [(0, d) for d in range(-3, 4)]
    outline = {(x + dx, y + dy) for x, y in arms for dx in (-1, 0, 1) for dy in (-1, 0, 1)}
    centres = np.rint(xy).astype(np.intp).reshape(-1, 2)
    for offsets, value in ((sorted(outline), _DARK), (arms, _GREEN)):
        points = (centres[:, None, :] + np.array(offsets)[None, :, :]).reshape(-1, 2)
        inside = (points >= 0).all(axis=1) & (points < (picture.shape[1], picture.shape[0])).all(axis=1)
        picture[points[inside, 1], points[inside, 0]] = value


def matches_picture(
    first: npt.NDArray[np.uint8], second: npt.NDArray[np.uint8], a: npt.NDArray[Any], b: npt.NDArray[Any]
) -> npt.NDArray[np.uint8]:
    """Return two grey images side by side with lines from each point of ``a`` (N, 2) px to its match in ``b``."""
    height = max(first.shape[0], second.shape[0])
    picture = np.zeros((height, first.shape[1] + second.shape[1], 3), np.uint8)
    picture[: first.shape[0], : first.shape[1]] = first[:, :, None]
    picture[: second.shape[0], first.shape[1] :] = second[:, :, None]
    hues = np.linspace(0, 179, max(len(a), 1)).astype(np.uint8)
    colors = cv2.cvtColor(
        np.stack([hues, np.full_like(hues, 200), np.full_like(hues, 255)], -1)[None], cv2.COLOR_HSV2BGR
    )
    for (x1, y1), (x2, y2), color in zip(a, b, colors[0].tolist()):
        start, end = (round(float(x1)), round(float(y1))), (round(float(x2)) + first.shape[1], round(float(y2)))
        cv2.line(picture, start, end, color, 1, cv2.LINE_AA)
    return picture
