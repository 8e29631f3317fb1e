"""Detects that an image shows the panel as the last measured image did, so that it need not be measured again.

Both are compared at an eighth of their size, where a cell's mean has an eighth of a pixel's noise. A shift of the panel
by a seventh of a pixel, a shadow, or a hand at its edge is then visible. Screens are excluded, because their content
changes without the panel.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.image.medians import median
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import PanelLayout

_CELL_PX = 8
_FROM_NOISE, _LEAST = 6.0, 0.5
"""Minimum change of a changed cell: a multiple of the noise of all cells, and grey levels."""
_MOST_NOISE = 1.5
"""Maximum noise of a sensor, in grey levels."""
_CORNERS = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
_FEWEST_CELLS = 100

Gray = npt.NDArray[np.uint8]


class StillPanel:
    """Compares images with the last one in which the panel was measured.

    Parameters
    ----------
    layout
        The designated panel.
    longest
        Maximum number of successive images that count as unchanged; then the panel is measured in any case.
    """

    def __init__(self, layout: PanelLayout, longest: int) -> None:
        self._layout, self._longest = layout, longest
        self._means: Array | None = None
        self._where: npt.NDArray[np.bool_] = np.zeros((0, 0), bool)
        self._count = 0

    def forget(self) -> None:
        """Count the next image as changed."""
        self._means = None

    def measured(self, gray: Gray, camera_from_panel: Transform, camera: CameraModel) -> None:
        """Store a raw image (H, W) uint8 in which the panel was measured, and its pose."""
        self._where = self._cells(camera_from_panel, camera)
        self._means, self._count = _cell_means(gray), 0
        if self._where.shape != self._means.shape or int(self._where.sum()) < _FEWEST_CELLS:
            self._means = None

    def unchanged(self, gray: Gray) -> bool:
        """Return whether a raw image (H, W) uint8 differs from the measured one only by noise; count those that do."""
        if self._means is None or self._count >= self._longest:
            return False
        means = _cell_means(gray)
        if means.shape != self._means.shape:
            return False
        change = (means - self._means)[self._where]
        noise = 1.4826 * median(np.abs(change - median(change)))
        if noise > _MOST_NOISE or float(np.abs(change).max()) > max(_FROM_NOISE * noise, _LEAST):
            return False
        self._count += 1
        return True

    def _cells(self, pose: Transform, camera: CameraModel) -> npt.NDArray[np.bool_]:
        """Return the cells on the panel's face and on no screen, (rows, columns)."""
        shape, around = (camera.height // _CELL_PX, camera.width // _CELL_PX), np.ones((5, 5), np.uint8)
        width, height = self._layout.size_mm
        face, screens = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
        _fill(face, np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)]), pose, camera)
        for control in self._layout.controls:
            if control.kind == "touch_area":
                _fill(screens, np.array(control.position_mm) + _CORNERS * control.size_mm, pose, camera)
        # Cells at the edge of either show parts of both, and a lens bends the lines between corners.
        inside = cv2.erode(face, around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        return np.asarray((inside > 0) & (cv2.dilate(screens, around) == 0))


def _fill(cells: Gray, corners_mm: Array, pose: Transform, camera: CameraModel) -> None:
    """Mark the cells, (rows, columns), that show a part of the face with these corners (N, 2) mm."""
    face = pose.apply(np.column_stack([corners_mm, np.zeros(len(corners_mm))]) * 1e-3)
    places = (camera.project(face) + 0.5) / _CELL_PX - 0.5
    cv2.fillConvexPoly(cells, np.rint(np.clip(places, -4000, 8000)).astype(np.int32), (1,))


def _cell_means(gray: Gray) -> Array:
    """Return the mean of each cell, (rows, columns); incomplete cells at the right and bottom are dropped."""
    rows, columns = (side // _CELL_PX for side in gray.shape)
    whole = gray[: rows * _CELL_PX, : columns * _CELL_PX]
    by_row = whole.reshape(rows, _CELL_PX, columns * _CELL_PX).sum(axis=1, dtype=np.uint16)
    sums = by_row.reshape(rows, columns, _CELL_PX).sum(axis=2, dtype=np.uint32)
    return np.asarray(sums / _CELL_PX**2)
