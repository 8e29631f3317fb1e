"""Measures a pose of the panel's face in an image, and compares the image with the print.

Search and tracking only give the start: the measured pose does not depend on its source. The face is drawn at several
scales, sharp and blurred, and the image is warped onto the most similar one. Corners are tracked by optical flow,
forward and backward, from a distance. Then edges (where the Harris response is negative), which are most of a drawn
panel, are measured across, and give the pose.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import HarrisDetector
from harris_perception.core.pose.planar_pose import (
    FacePoints,
    PoseFit,
    fit_pose,
    homography_of_pose,
    inverse,
    map_points,
)
from harris_perception.core.recognition.edge_alignment import EdgePoints, edge_points, shifts
from harris_perception.core.recognition.face_patches import Patches, PatchGrid, PrintPatches, compared, patch_side
from harris_perception.core.recognition.panel_search import Floats, Gray, robust_homography
from harris_perception.core.recognition.panel_template import PanelTemplate, hidden_by_controls
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import PanelLayout
from icu_common.core.reasons.message import Message

# Blurs (px) of the template that are tried; the best replaces the previous one if it is more similar by ``_BLURRED``.
_BLURS_PX = (0.0, 0.6, 1.0, 1.6, 2.3)
_BLURRED = 0.005
# Minimum agreeing patches of an accepted blur, as a share of the largest number of agreeing patches.
_COMPARED = 0.5
# Factor for the covariance of corners: they are mostly text, whose typeface differs from the maker's, and the corners
# of a word share an error.
_TYPEFACE = 4.0
# Distance from a control (px of the template) within which the image blurs its sides and its shadow into the print.
_BESIDE_PX = 5
# Step of the camera positions for which areas hidden by controls are computed. These areas move by a twentieth of it.
# Computing them takes longer than a measurement, and successive images have the same position.
_VIEWS_MM = 1.0
_KEPT_VIEWS = 8
# With and without a margin, from two positions between which noise may alternate; and their print with each blur.
_KEPT_GRIDS, _KEPT_PRINTS = 4, 12
_Place = tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineConfig(Config):
    """Settings of measuring and judging a found panel."""

    points: int = setting(400, "Number of template corners measured", minimum=20, maximum=5000)
    window_px: int = setting(17, "Side of the optical flow's window", minimum=7, maximum=61, unit="px")
    reach_px: float = setting(16.0, "Maximum accepted shift of a corner", minimum=1.0, maximum=100.0, unit="px")
    round_trip_px: float = setting(
        0.4,
        "Maximum distance between a corner and its position after forward and backward flow",
        minimum=0.01,
        maximum=5.0,
        unit="px",
    )
    tolerance_px: float = setting(0.8, "Maximum misfit of a measured point", minimum=0.1, maximum=10.0, unit="px")
    min_points: int = setting(20, "Minimum number of points that fit", minimum=6, maximum=5000)
    max_deviation_px: float = setting(
        0.45,
        "Maximum standard deviation of the pose, as the image position of any point of the face's outline",
        minimum=0.01,
        maximum=20.0,
    )
    edge_points: int = setting(30, "Minimum number of edge points that fit", minimum=8, maximum=5000)
    max_edge_points: int = setting(1000, "Maximum number of edge points measured", minimum=50, maximum=20000)
    edge_reach_px: float = setting(5.0, "Maximum distance searched for an edge", minimum=1.0, maximum=30.0, unit="px")
    max_rms_px: float = setting(
        0.6,
        "Maximum rms misfit of the edges; a larger one indicates a wrong camera calibration or layout",
        minimum=0.05,
        maximum=10.0,
    )
    edge_correlation: float = setting(
        0.75, "Minimum correlation of the profiles across an edge", minimum=0.1, maximum=1.0
    )
    patch_mm: float = setting(6.0, "Side of a correlated patch", minimum=1.0, maximum=100.0, unit="mm")
    patch_correlation: float = setting(0.6, "Minimum correlation of an agreeing patch", minimum=0.1, maximum=1.0)
    min_purity: float = setting(
        0.94,
        "Minimum fraction of agreeing patches where most of the neighbouring patches agree",
        minimum=0.0,
        maximum=1.0,
    )
    max_contradiction: float = setting(
        0.8,
        "Maximum number of patches with print other than the template's, as a multiple of the agreeing patches",
        minimum=0.0,
        maximum=10.0,
    )
    max_intrusion: float = setting(
        0.13,
        "Maximum fraction with other print among the patches next to at least two agreeing patches",
        minimum=0.0,
        maximum=1.0,
    )
    min_agreement: float = setting(
        0.2,
        "Minimum fraction of the face's textured patches that agree; hidden patches do not agree",
        minimum=0.05,
        maximum=1.0,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One scale of the template: its normalised image, and its corners (on steady print) by falling response."""

    template: PanelTemplate
    even: Gray
    corners_px: Floats
    corners_mm: Array
    edges: EdgePoints


class FaceMeter:
    """Measures one face.

    Parameters
    ----------
    layout
        Layout of its panel.
    config
        See :class:`RefineConfig`.
    templates
        The face at decreasing scales.
    detector
        Detects their corners.
        Finds their corners.

    Raises
    ------
    ValueError
        If the face has too little print to be measured.
    """

    def __init__(
        self, layout: PanelLayout, config: RefineConfig, templates: Sequence[PanelTemplate], detector: HarrisDetector
    ) -> None:
        self.layout, self.config = layout, config
        self.levels = [_level(template, detector) for template in templates]
        best = self.levels[0] if self.levels else None
        if best is None or len(best.corners_px) < config.min_points or len(best.edges) < config.edge_points:
            raise ValueError(Message("face.face_too_little_print_recognised", model=layout.model))
        self._soft: dict[tuple[int, float], Level] = {}
        self._number = {level.template.px_per_mm: number for number, level in enumerate(self.levels)}
        self._hidden = lru_cache(_KEPT_VIEWS)(self._hidden_from)
        self._grid = lru_cache(_KEPT_GRIDS)(self._grid_from)
        self._print = lru_cache(_KEPT_PRINTS)(self._print_from)

    def by_corners(self, rectified: Gray, start: Transform, camera: CameraModel, blur_px: float) -> PoseFit | None:
        """Return the pose after tracking the template's corners: robust, coarse."""
        pose, fit = start, None
        for _ in range(2):
            homography = homography_of_pose(pose, camera)
            level = self._level_for(homography, blur_px)
            if level is None:
                return None
            warped = self._warp(rectified, homography, level)
            flow = _flow(level, self._visible(level, pose), warped, self.config)
            if flow is None:
                return None
            pixels = map_points(homography @ inverse(level.template.px_from_mm), flow[1])
            fitted = robust_homography(flow[0], pixels, self.config.tolerance_px, self.config.min_points)
            if fitted is None:
                return None
            used = fitted[1]
            fit = fit_pose(pose, FacePoints.of_corners(flow[0][used] * 1e-3, pixels[used]), camera)
            pose = fit.camera_from_panel
        return fit

    def by_edges(
        self, rectified: Gray, start: PoseFit | Transform, camera: CameraModel, blur_px: float
    ) -> tuple[PoseFit, FacePoints, npt.NDArray[np.intp], float] | None:
        """Return the pose, the edge points that fit, the line of each, and their rms misfit in px; None for too few.

        If a pose comes from a few crowded points, distant edges are measured only after the nearer ones have improved
        their predicted positions.
        """
        config = self.config
        fit = start if isinstance(start, PoseFit) else None
        prior = None if fit is None else dataclasses.replace(fit, covariance=fit.covariance * _TYPEFACE)
        pose = start.camera_from_panel if isinstance(start, PoseFit) else start
        turns = 0
        while True:
            homography = homography_of_pose(pose, camera)
            level = self._level_for(homography, blur_px)
            if level is None:
                return None
            nearest = level.edges.px.astype(int)
            seen = self._visible(level, pose, _BESIDE_PX)[nearest[:, 1], nearest[:, 0]]
            usable = np.flatnonzero(seen)
            count = min(len(usable), config.max_edge_points)
            edges = level.edges.chosen(usable[np.linspace(0, len(usable) - 1, count).astype(int)])
            reach = (config.edge_reach_px, 0.5 * config.edge_reach_px, 2.0)[min(turns, 2)]
            known = np.ones(count, bool)
            if fit is not None and count:
                places_m = np.column_stack([map_points(inverse(level.template.px_from_mm), edges.px), np.zeros(count)])
                known = 3 * fit.deviation_px(places_m * 1e-3, camera) < reach
                if not known.all():
                    reach = config.edge_reach_px
                    known = 3 * fit.deviation_px(places_m * 1e-3, camera) < reach
            complete = bool(known.all())
            edges = edges.chosen(known)
            if len(edges) < config.edge_points:
                return None
            moved, good = shifts(edges, self._warp(rectified, homography, level), reach, config.edge_correlation)
            if int(good.sum()) < config.edge_points:
                return None
            edges, moved = edges.chosen(good), moved[good]
            rectified_from_level = homography @ inverse(level.template.px_from_mm)
            found = edges.px + moved[:, None] * edges.across
            pixels = map_points(rectified_from_level, found)
            along = edges.across[:, ::-1] * (-1.0, 1.0)
            tangent = map_points(rectified_from_level, found + along) - pixels
            across = tangent[:, ::-1] * (1.0, -1.0)
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            points_m = map_points(inverse(level.template.px_from_mm), edges.px) * 1e-3
            measured = FacePoints(in_face=points_m, pixels=pixels, across=across)
            fit = fit_pose(pose, measured, camera, prior=prior)
            pose = fit.camera_from_panel
            turns += 1
            if (complete and turns >= 3) or turns >= 8:
                break
        error = fit.error_px
        near = np.abs(error) < max(3 * 1.4826 * float(np.median(np.abs(error))), 0.3)
        rms = float(np.sqrt(np.mean(error[near] ** 2)))
        if int(near.sum()) < max(config.edge_points, 0.5 * len(error)) or rms > config.max_rms_px:
            return None
        return fit, measured.chosen(near), edges.line[near], rms

    def blur(self, rectified: Gray, pose: Transform, camera: CameraModel, before_px: float) -> float:
        """Return the blur (px) of the template that is most similar to the image; it was ``before_px``.

        A blur that leaves little print to compare is ignored, however similar it is.
        """
        homography = homography_of_pose(pose, camera)
        found: dict[float, Patches] = {}
        for blur_px in _BLURS_PX:
            level = self._level_for(homography, blur_px)
            if level is None:
                return 0.0
            printed = self._print(level, _place_of(pose), 0)
            if not found:
                seen = printed.grid.cut(self._warp(rectified, homography, level))  # the same for all blurs
            found[blur_px] = compared(printed, seen, self.config.patch_correlation)
        most = max(patches.count for patches in found.values())
        likeness = {blur: patches.likeness for blur, patches in found.items() if patches.count >= _COMPARED * most}
        best = max(likeness, key=lambda blur: likeness[blur])
        return best if likeness[best] > likeness.get(before_px, 0.0) + _BLURRED else before_px

    def compared(self, rectified: Gray, pose: Transform, camera: CameraModel, blur_px: float) -> Patches | None:
        """Compare the image with the print, except near raised controls; None if no camera can have this pose."""
        homography = homography_of_pose(pose, camera)
        level = self._level_for(homography, blur_px)
        if level is None:
            return None
        printed = self._print(level, _place_of(pose), _BESIDE_PX)
        seen = printed.grid.cut(self._warp(rectified, homography, level))
        return compared(printed, seen, self.config.patch_correlation)

    def _print_from(self, level: Level, place: _Place, margin_px: int) -> PrintPatches:
        return PrintPatches(level.template, self._grid(self._number[level.template.px_per_mm], place, margin_px))

    def _grid_from(self, number: int, place: _Place, margin_px: int) -> PatchGrid:
        level = self.levels[number]
        return PatchGrid(self._visible_from(level, place, margin_px), patch_side(level.template, self.config.patch_mm))

    def _level_for(self, homography: Array, blur_px: float) -> Level | None:
        """Return the level whose scale is nearest to the image's; None for a homography that no camera can have."""
        width, height = self.layout.size_mm
        corners = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
        depth = np.column_stack([corners, np.ones(4)]) @ homography[2]
        if not (np.isfinite(homography).all() and (depth * depth[0] > 0).all()):
            return None
        outline = map_points(homography, corners)
        side = np.roll(outline, -1, axis=0) - outline
        following = np.roll(side, -1, axis=0)
        turn = side[:, 0] * following[:, 1] - side[:, 1] * following[:, 0]
        # y is up on the panel and down in the image: seen from the front the outline turns negative at each corner.
        if not (turn < 0).all():
            return None
        area = 0.5 * abs(float(np.sum(outline[:, 0] * side[:, 1] - outline[:, 1] * side[:, 0])))
        scale = np.sqrt(area / (width * height))
        if not 0.5 * self.levels[-1].template.px_per_mm < scale < 2.5 * self.levels[0].template.px_per_mm:
            return None
        number = int(np.argmin([abs(np.log(level.template.px_per_mm / scale)) for level in self.levels]))
        return self.levels[number] if blur_px == 0.0 else self._softened(number, blur_px)

    def _softened(self, number: int, blur_px: float) -> Level:
        """Return a level as it appears in a blurred image."""
        if (number, blur_px) not in self._soft:
            sharp = self.levels[number]
            gray = np.asarray(cv2.GaussianBlur(sharp.template.gray, (0, 0), blur_px), np.uint8)
            self._soft[number, blur_px] = dataclasses.replace(
                sharp,
                template=dataclasses.replace(sharp.template, gray=gray),
                even=even_out(gray),
                edges=edge_points(gray, sharp.template.exact, 4.0 + blur_px),
            )
        return self._soft[number, blur_px]

    def _visible(self, level: Level, pose: Transform, margin_px: int = 0) -> npt.NDArray[np.bool_]:
        """Return where steady print is not hidden by raised controls, at least ``margin_px`` away from them."""
        return self._visible_from(level, _place_of(pose), margin_px)

    def _visible_from(self, level: Level, place: _Place, margin_px: int) -> npt.NDArray[np.bool_]:
        hidden = self._hidden(place, level.template.gray.shape, level.template.px_per_mm, margin_px)
        return np.asarray(level.template.steady & ~hidden)

    def _hidden_from(
        self, view: _Place, shape: tuple[int, int], px_per_mm: float, margin_px: int
    ) -> npt.NDArray[np.bool_]:
        """Return the areas hidden by raised controls, plus ``margin_px``, from a position in steps of ``_VIEWS_MM``."""
        hidden = hidden_by_controls(self.layout, np.array(view) * _VIEWS_MM, shape, px_per_mm)
        if margin_px:
            size = 2 * margin_px + 1
            hidden = cv2.dilate(hidden.astype(np.uint8), np.ones((size, size), np.uint8)).astype(bool)
        return np.asarray(hidden)

    def _warp(self, rectified: Gray, homography: Array, level: Level) -> Gray:
        height, width = level.template.gray.shape
        rectified_from_level = homography @ inverse(level.template.px_from_mm)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(rectified, rectified_from_level, (width, height), flags=flags), np.uint8)


def _place_of(camera_from_panel: Transform) -> _Place:
    """Return the camera's position, in steps of ``_VIEWS_MM``."""
    x, y, z = np.rint(camera_from_panel.inverse().translation * 1e3 / _VIEWS_MM).tolist()
    return x, y, z


def _level(template: PanelTemplate, detector: HarrisDetector) -> Level:
    corners = detector.detect(template.gray).xy
    # A corner that touches a control, screen or lamp would be affected by parallax or by changes.
    margin = np.ones((5, 5), np.uint8)
    steady = cv2.erode(template.steady.astype(np.uint8), margin).astype(bool)
    nearest = np.rint(corners).astype(int)
    corners = corners[steady[nearest[:, 1], nearest[:, 0]]]
    corners_mm = map_points(inverse(template.px_from_mm), corners.astype(np.float64))
    edges = edge_points(template.gray, template.exact)
    return Level(template, even_out(template.gray), corners.astype(np.float32), corners_mm, edges)


def even_out(gray: Gray) -> Gray:
    """Return the image with its local mean at 128 and constant local contrast, against uneven light."""
    picture = gray.astype(np.float32)
    size = (31, 31)
    mean = cv2.boxFilter(picture, -1, size)
    deviation = np.sqrt(np.maximum(cv2.boxFilter(picture * picture, -1, size) - mean * mean, 0.0))
    return np.asarray(np.clip(128.0 + 45.0 * (picture - mean) / (deviation + 6.0), 0, 255), dtype=np.uint8)


def _flow(
    level: Level, visible: npt.NDArray[np.bool_], warped: Gray, config: RefineConfig
) -> tuple[Array, Array] | None:
    """Return template points (N, 2) mm and their positions in the warped image (N, 2) px; None for too few."""
    nearest = np.rint(level.corners_px).astype(int)
    usable = np.flatnonzero(visible[nearest[:, 1], nearest[:, 0]])[: config.points]
    if len(usable) < config.min_points:
        return None
    start = level.corners_px[usable].reshape(-1, 1, 2)
    evened = even_out(warped)
    options: Any = {
        "winSize": (config.window_px, config.window_px),
        "maxLevel": 2,
        "criteria": (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.005),
    }
    forward, there, _ = cv2.calcOpticalFlowPyrLK(level.even, evened, start, start.copy(), **options)
    back, here, _ = cv2.calcOpticalFlowPyrLK(evened, level.even, forward, forward.copy(), **options)
    round_trip = np.linalg.norm((back - start)[:, 0], axis=1)
    shift = np.linalg.norm((forward - start)[:, 0], axis=1)
    good = (there[:, 0] == 1) & (here[:, 0] == 1) & (round_trip < config.round_trip_px) & (shift < config.reach_px)
    if int(good.sum()) < config.min_points:
        return None
    return level.corners_mm[usable[good]], forward[good, 0].astype(np.float64)
