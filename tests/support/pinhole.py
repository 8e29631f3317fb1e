"""A camera as most tests need one: known, and turned as its pair is."""

from __future__ import annotations

import numpy as np

from icu_common.core.geometry.camera_model import CameraModel


def pinhole(
    name: str = "left",
    *,
    size: tuple[int, int] = (1280, 720),
    focal_px: float = 1700.0,
    centre_px: tuple[float, float] | None = None,
    baseline_m: float = 0.0,
    k1: float = 0.0,
) -> CameraModel:
    """Return a camera ``baseline_m`` to the right of the left one; ``centre_px`` is the image's unless given."""
    cx, cy = centre_px or ((size[0] - 1) / 2, (size[1] - 1) / 2)
    k = np.array([[focal_px, 0.0, cx], [0.0, focal_px, cy], [0.0, 0.0, 1.0]])
    p = np.column_stack([k, [-focal_px * baseline_m, 0.0, 0.0]])
    d = np.array([k1, 0.0, 0.0, 0.0, 0.0])
    return CameraModel(name=name, width=size[0], height=size[1], k=k, d=d, r=np.eye(3), p=p)
