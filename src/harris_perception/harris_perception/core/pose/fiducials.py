"""Finds the markers of a panel's face: a second source of its pose, and a check of the first.

ArUco: S. Garrido-Jurado et al., Pattern Recognition 47(6), 2014; AprilTag: E. Olson, ICRA 2011.
The detector is OpenCV's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.pose.planar_pose import (
    FacePoints,
    fit_pose,
    homography_of_pose,
    inverse,
    map_points,
    planar_poses,
)
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.fiducial import Fiducial, dictionary
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import PanelLayout
from icu_common.core.reasons.message import Message

_LEAST_SIDE_PX = 12.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SeenMarker:
    """A marker in an image: its dictionary and number, and its corners (4, 2), rectified px, in OpenCV's order."""

    dictionary: str
    id: int
    corners_px: Array


def _refine(gray: npt.NDArray[np.uint8], corners: npt.NDArray[np.float32], module_px: float) -> Array:
    """Refine corners (4, 2) to sub-pixels in a window that ends before the next module's corner.

    OpenCV's own window has one size for all markers before 4.8, and is too small since: errors up to 0.6 px, here 0.35.
    """
    half = min(5, max(2, round(0.7 * module_px)))
    stop = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 30, 0.01)
    return np.asarray(cv2.cornerSubPix(gray, corners.copy(), (half, half), (-1, -1), stop), np.float64)


class MarkerFinder:
    """Finds markers of the dictionaries that a layout uses, with either of OpenCV's interfaces (4.6, 4.7 and later)."""

    def __init__(self, layout: PanelLayout) -> None:
        self._layout = layout
        self._known = {(m.dictionary, m.id): m for m in layout.markers}
        aruco: Any = cv2.aruco
        self._newer = hasattr(aruco, "ArucoDetector")
        parameters = aruco.DetectorParameters() if self._newer else aruco.DetectorParameters_create()
        parameters.cornerRefinementMethod = aruco.CORNER_REFINE_NONE
        self._detectors: dict[str, Any] = {}
        for name in {m.dictionary for m in layout.markers}:
            made = dictionary(name)
            self._detectors[name] = aruco.ArucoDetector(made, parameters) if self._newer else (made, parameters)

    def find(self, gray: npt.NDArray[np.uint8], camera: CameraModel) -> list[SeenMarker]:
        """Return the markers in a raw image (H, W) uint8, including those that the layout does not have."""
        found = []
        for name, detector in self._detectors.items():
            if self._newer:
                corners, numbers, _ = detector.detectMarkers(gray)
            else:
                made, parameters = detector
                corners, numbers, _ = cv2.aruco.detectMarkers(gray, made, parameters=parameters)  # type: ignore[attr-defined]
            for number, places in zip([] if numbers is None else np.ravel(numbers), corners):
                raw = np.asarray(places, np.float32).reshape(4, 2)
                sides = np.linalg.norm(raw - np.roll(raw, 1, axis=0), axis=1)
                if sides.min() >= _LEAST_SIDE_PX:
                    refined = _refine(gray, raw, float(sides.mean()) / (dictionary(name).markerSize + 2))
                    corners_px = camera.rectify(refined)
                    if np.isfinite(corners_px).all():  # without corners for which the lens model has no rays
                        found.append(SeenMarker(dictionary=name, id=int(number), corners_px=corners_px))
        return found

    def poses(self, seen: list[SeenMarker], camera: CameraModel) -> list[Transform]:
        """Return the poses (none, one or two, the better first) that fit the layout's markers among ``seen``."""
        pairs = [(self._known[m.dictionary, m.id], m) for m in seen if (m.dictionary, m.id) in self._known]
        if not pairs:
            return []
        places_m = np.vstack([known.corners_mm() for known, _ in pairs]) * 1e-3
        pixels = np.vstack([m.corners_px for _, m in pairs])
        measured = FacePoints.of_corners(places_m, pixels)
        found = planar_poses(places_m, pixels, camera)
        return [fit_pose(pose, measured, camera, floor_px=0.3).camera_from_panel for pose in found]

    def disagreement(
        self, seen: list[SeenMarker], camera_from_panel: Transform, camera: CameraModel, bound_mm: float
    ) -> str | None:
        """Return how the markers contradict a pose; empty if they confirm it, None if none is seen.

        A marker's error is the distance of its corners, projected onto the face by that pose, from their layout
        positions.
        """
        mm_from_rectified = inverse(homography_of_pose(camera_from_panel, camera))
        confirmed = False
        for marker in seen:
            places_mm = map_points(mm_from_rectified, marker.corners_px)
            known = self._known.get((marker.dictionary, marker.id))
            if known is not None:
                apart_mm = float(np.linalg.norm(places_mm - known.corners_mm(), axis=1).max())
                if not apart_mm <= bound_mm:
                    return Message(
                        "markers.marker_panel_where_print_allowed",
                        known=known.name,
                        apart_mm=apart_mm,
                        bound_mm=bound_mm,
                    )
                confirmed = True
            elif (other := self._in_place_of(places_mm.mean(axis=0))) is not None:
                return Message(
                    "markers.marker_where_layout", dictionary=marker.dictionary, id=marker.id, other=other.name
                )
        return "" if confirmed else None

    def _in_place_of(self, centre_mm: Array) -> Fiducial | None:
        for known in self._layout.markers:
            if np.abs(centre_mm - known.position_mm).max() < known.size_mm / 2:
                return known
        return None
