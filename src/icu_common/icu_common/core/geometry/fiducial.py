"""Markers (ArUco, AprilTag) on the face of a panel: their data and their print."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

DICTIONARIES = ("4X4_50", "5X5_50", "6X6_50", "APRILTAG_16h5", "APRILTAG_36h11")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fiducial:
    """A marker, upright: ``size_mm`` is the side of its black square, ``position_mm`` the middle of it."""

    dictionary: str
    id: int
    position_mm: tuple[float, float]
    size_mm: float

    @property
    def name(self) -> str:
        """Dictionary and number."""
        return f"{self.dictionary} {self.id}"

    @property
    def side_mm(self) -> float:
        """Side including the white rim that a detector needs, one module wide."""
        modules = len(marker_modules(self.dictionary, self.id))
        return self.size_mm * (modules + 2) / modules

    def corners_mm(self) -> npt.NDArray[np.float64]:
        """Return the (4, 2) corners of the black square in OpenCV's order: the marker's upper left, then clockwise."""
        half = self.size_mm / 2
        corners = np.array([(-half, half), (half, half), (half, -half), (-half, -half)])
        return np.asarray(corners + self.position_mm)

    def white_mm(self) -> list[tuple[float, float, float, float]]:
        """Return the white modules, each run of a row merged: lower left corner, width and height in mm."""
        modules = marker_modules(self.dictionary, self.id)
        step = self.size_mm / len(modules)
        x0, y1 = self.position_mm[0] - self.size_mm / 2, self.position_mm[1] + self.size_mm / 2
        found = []
        for number, row in enumerate(modules):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(int), [0]])))
            found += [
                (x0 + start * step, y1 - (number + 1) * step, (end - start) * step, step)
                for start, end in zip(edges[::2], edges[1::2])
            ]
        return found


def dictionary(name: str) -> Any:
    """Return OpenCV's dictionary of that name."""
    # OpenCV 4.6 and 5.0 use different names.
    make = getattr(cv2.aruco, "getPredefinedDictionary", None) or cv2.aruco.Dictionary_get  # type: ignore[attr-defined]
    return make(getattr(cv2.aruco, f"DICT_{name}"))


def count_of(name: str) -> int:
    """Return the number of markers in a dictionary."""
    return int(dictionary(name).bytesList.shape[0])


def marker_modules(name: str, number: int) -> npt.NDArray[np.bool_]:
    """Return the marker's modules with its black rim, from the top, (N, N) bool; True is white."""
    made = dictionary(name)
    side = int(made.markerSize) + 2
    draw = getattr(cv2.aruco, "generateImageMarker", None) or cv2.aruco.drawMarker  # type: ignore[attr-defined]
    return np.asarray(draw(made, number, side)) > 127
