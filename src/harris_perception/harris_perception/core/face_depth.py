"""Is the panel as far away for both cameras as its print, by the layout's size, says for one of them?

The pose comes from one picture and the layout's millimetres, the stylus's tip from both pictures. A layout that was
measured wrongly, or a camera that was turned a little after the pair was calibrated, sets the two apart in depth: the
stylus would be driven into the panel, or never touch it, and be seen where it should be all the same.
"""

from __future__ import annotations

import numpy as np

from icu_common.core.geometry import Array, Transform

LEAST_POINTS = 30
LOOKS = 5
"""So many looks in a row must say the same."""


def height_above_face_m(points: Array, camera_from_panel: Transform, size_mm: tuple[float, float]) -> float | None:
    """Return the median height of points (N, 3), in the camera's frame, whose lines of sight meet the face.

    Most of what is matched is print on the face, which neither knobs nor what is beside the panel outvote; None for
    less than ``LEAST_POINTS``.
    """
    panel_from_camera = camera_from_panel.inverse()
    eye, places = panel_from_camera.translation, panel_from_camera.apply(points)
    towards = places - eye
    with np.errstate(divide="ignore", invalid="ignore"):
        met = eye[:2] - towards[:, :2] * (eye[2] / towards[:, 2:])
    on_face = ((met >= 0) & (met <= np.array(size_mm) / 1e3)).all(axis=1)
    return float(np.median(places[on_face, 2])) if on_face.sum() >= LEAST_POINTS else None


class FaceDepth:
    """Collects looks; ``text`` is None until enough agree, then what is wrong, or empty for nothing."""

    def __init__(self, bound_mm: float) -> None:
        self._bound_mm = bound_mm
        self._row: tuple[bool, int] = (False, 0)
        self.text: str | None = None

    def start_anew(self) -> None:
        """Ask for new looks, as a camera has changed; what was wrong stays so until they agree that it is not."""
        self._row = False, 0
        self.text = self.text or None

    def add(self, height_m: float | None) -> None:
        """Take one look; None says nothing."""
        if height_m is None:
            return
        off = not abs(1e3 * height_m) <= self._bound_mm
        self._row = off, self._row[1] + 1 if self._row[0] is off else 1
        if self._row[1] >= LOOKS and (self.text is None or bool(self.text) is not off):
            self.text = self._wrong_text(1e3 * height_m) if off else ""

    def _wrong_text(self, height_mm: float) -> str:
        side = "nearer" if height_mm > 0 else "further away"
        return (
            f"both cameras together see the panel {abs(height_mm):.1f} mm {side} than its print says, "
            f"{self._bound_mm:g} mm are allowed: measure the panel against its layout's size_mm, and calibrate the "
            "cameras as a pair anew if one may have been turned"
        )
