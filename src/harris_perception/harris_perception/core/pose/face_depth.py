"""Checks that stereo measures the same distance of the panel as its print and the layout's size do in one camera.

The pose is derived from one image and the layout's millimetres, the stylus's tip from both images. A wrongly measured
layout, or a camera that was rotated slightly after the pair was calibrated, makes their depths differ. The stylus would
then be driven into the panel or never touch it, although its measured position would be correct.
"""

from __future__ import annotations

import numpy as np

from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.reasons.message import Message

LEAST_POINTS = 30
LOOKS = 5
"""Number of successive measurements that must agree."""


def height_above_face_m(points: Array, camera_from_panel: Transform, size_mm: tuple[float, float]) -> float | None:
    """Return the median height of points (N, 3), in the camera's frame, whose lines of sight meet the face.

    Most matched points are print on the face, so knobs and objects next to the panel do not change the median. None for
    fewer than ``LEAST_POINTS`` points.
    """
    panel_from_camera = camera_from_panel.inverse()
    eye, places = panel_from_camera.translation, panel_from_camera.apply(points)
    towards = places - eye
    with np.errstate(divide="ignore", invalid="ignore"):
        met = eye[:2] - towards[:, :2] * (eye[2] / towards[:, 2:])
    on_face = ((met >= 0) & (met <= np.array(size_mm) / 1e3)).all(axis=1)
    return float(np.median(places[on_face, 2])) if on_face.sum() >= LEAST_POINTS else None


class FaceDepth:
    """Collects measurements; ``text`` is None until enough agree, then the fault, or empty for none."""

    def __init__(self, bound_mm: float) -> None:
        self._bound_mm = bound_mm
        self._row: tuple[bool, int] = (False, 0)
        self.text: str | None = None

    def start_anew(self) -> None:
        """Require new measurements because a camera has changed; a fault stays until they agree that it is gone."""
        self._row = False, 0
        self.text = self.text or None

    def add(self, height_m: float | None) -> None:
        """Add one measurement; None is ignored."""
        if height_m is None:
            return
        off = not abs(1e3 * height_m) <= self._bound_mm
        self._row = off, self._row[1] + 1 if self._row[0] is off else 1
        if self._row[1] >= LOOKS and (self.text is None or bool(self.text) is not off):
            self.text = self._wrong_text(1e3 * height_m) if off else ""

    def _wrong_text(self, height_mm: float) -> str:
        side = "nearer" if height_mm > 0 else Message("face.further_away")
        return Message(
            "face.both_cameras_together_see_panel", height_mm=abs(height_mm), side=side, bound_mm=self._bound_mm
        )
