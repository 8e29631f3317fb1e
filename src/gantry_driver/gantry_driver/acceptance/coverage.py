"""Part of the panel that a camera sees."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array

_PER_EDGE = 50


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PanelCoverage:
    """The panel in an image: outline (N, 2) in pixels, the share of it inside, and the smallest margin in pixels."""

    outline_px: Array
    share: float
    margin_px: float


def along_outline(corners: Array) -> Array:
    """Return points (N, 2) along the closed outline of corners (M, 2)."""
    closed = np.vstack([corners, corners[:1]])
    steps = np.linspace(0.0, 1.0, _PER_EDGE, endpoint=False)[:, np.newaxis]
    return np.vstack([a + steps * (b - a) for a, b in itertools.pairwise(closed)])


def view_of(outline_px: Array, width: int, height: int) -> PanelCoverage:
    """Return the view of an outline (N, 2) in pixels; a point that the camera cannot see is NaN."""
    ends = np.array([width - 1, height - 1])
    margins = np.minimum(outline_px, ends - outline_px).min(axis=1)
    seen = np.nan_to_num(margins, nan=-np.inf)
    return PanelCoverage(outline_px=outline_px, share=float((seen >= 0).mean()), margin_px=float(seen.min()))


def mask_of(view: PanelCoverage, width: int, height: int) -> npt.NDArray[np.bool_]:
    """Return the pixels (height, width) inside the outline."""
    mask = np.zeros((height, width), np.uint8)
    points = view.outline_px[np.isfinite(view.outline_px).all(axis=1)]
    if len(points):
        cv2.fillPoly(mask, [np.rint(np.clip(points, -1e4, 1e4)).astype(np.int32)], (1,))
    return mask.astype(bool)
