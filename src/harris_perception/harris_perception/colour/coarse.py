"""Detects from the edges of the colour whether a camera sends colour at a lower resolution than the image.

YUYV and NV12 repeat one colour for two or four pixels. MJPEG with 4:2:2 or 4:2:0 interpolates it, which removes the
finest detail: the colour's third difference becomes small relative to its slope.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.uint8]
Values = npt.NDArray[np.float32]

_PAIRED = 0.08
"""Change of colour within pairs, as a share of the change between pairs, below which two pixels share one colour."""
_SOFT = 0.8
"""Ratio of third difference to slope at colour edges: 1.0 or more in sharp images, 0.3 to 0.75 in MJPEG with 4:2:0."""
_SOFTER_THAN_LUMA = 0.68
"""The same ratio relative to the luma's: defocus softens both alike, 4:2:0 gives 0.2 to 0.7."""
_SHARED_ROWS = 0.45
"""The same ratio down the columns, below which rows share their colour: 0.2 to 0.5 in 4:2:0, 0.4 to 1.6 in 4:2:2."""
_EDGE = 0.3
"""Minimum share of the steepest slope for a pixel to belong to an edge."""
_NEIGHBOURS = np.array([0.25, 0.5, 0.25])


def coarse_colour(colours: Picture, chroma: Values) -> Picture | None:
    """Return (h, w, 3) with smoothed colour if pixels repeat it; None if colour is as fine as the image.

    Parameters
    ----------
    colours
        (h, w, 3) BGR around a coloured object.
    chroma
        (h, w) one chroma of it.
    """
    repeated = [_repeated(values) for values in (chroma, chroma.T)]
    if not any(repeated) and not _soft(chroma, colours):
        return None
    if not any(repeated):
        return colours
    along, down = (_NEIGHBOURS if is_so else np.ones(1) for is_so in repeated)
    parts = cv2.cvtColor(colours, cv2.COLOR_BGR2YCrCb)
    smooth = np.asarray(cv2.sepFilter2D(parts, -1, along, down))
    smooth[..., 0] = parts[..., 0]
    return np.asarray(cv2.cvtColor(smooth, cv2.COLOR_YCrCb2BGR), np.uint8)


def rows_share_colour(chroma: Values) -> bool:
    """Return whether two rows of a coarse chroma (h, w) share their colour, as in 4:2:0 but not in 4:2:2."""
    down = np.ascontiguousarray(chroma.T)
    return _repeated(down) or _fineness(down) < _SHARED_ROWS


def _repeated(chroma: npt.NDArray[Any]) -> bool:
    """Return whether pairs of neighbours along the rows of (h, w) share one colour."""
    steps = np.abs(np.diff(chroma, axis=1))
    within, between = sorted(float(steps[:, start::2].mean()) for start in (0, 1))
    return within <= _PAIRED * between


def _soft(chroma: Values, colours: Picture) -> bool:
    """Return whether the colour's edges along the rows of (h, w), w at least 5, are interpolated."""
    fineness = _fineness(chroma)
    if fineness >= _SOFT:
        return False
    luma = np.asarray(cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY), np.float32)
    return fineness < _SOFTER_THAN_LUMA * _fineness(luma)


def _fineness(values: Values) -> float:
    """Return the ratio of third difference to slope at the edges along the rows of (h, w)."""
    slope = np.abs(np.diff(values, axis=1))[:, 1:-1]
    third = np.abs(np.diff(values, n=3, axis=1))
    edge = slope > _EDGE * slope.max()
    return float(third[edge].mean() / slope[edge].mean()) if edge.any() else 0.0
