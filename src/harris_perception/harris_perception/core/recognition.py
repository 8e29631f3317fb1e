"""Finds the designated panel in a picture and gives its pose.

A new panel is searched by descriptors at Harris corners, matched with those of a template pyramid, under a robust
homography (RANSAC). Every pose that its matches suggest is measured, and the one that most print agrees with is judged:
a strip of matches, all that a hand may leave, goes with two poses about equally well. A pose is refined by warping the
picture onto the template and measuring with optical flow, forward and backward, what is still amiss; the same step
follows it from frame to frame. The template's edges (where the Harris response is negative) are then measured across,
which is most of what a drawn panel shows, and give the pose.

A patchwise correlation with the template decides whether to believe it, and several frames must agree before it counts.
Few patches may agree, for most of the panel may be hidden; but where some do their neighbours must, and few may show
other print instead, as another panel does.

Only what is printed on the face is used: controls stand proud (parallax), screens and lamps change. Text is good for
finding the panel; where it was drawn from the layout its typeface is not the maker's, and it measures nothing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.edge_alignment import EdgePoints, edge_points, shifts
from harris_perception.core.face_patches import Patches, compared
from harris_perception.core.harris import HarrisConfig, HarrisDetector
from harris_perception.core.panel_search import Describer, Floats, Gray, SearchConfig, matches, robust_homography
from harris_perception.core.panel_template import PanelTemplate, hidden_by_controls, panel_template
from harris_perception.core.planar_pose import (
    FacePoints,
    PoseFit,
    fit_pose,
    homography_of_pose,
    inverse,
    map_points,
    planar_poses,
)
from harris_perception.core.pose_agreement import AgreementConfig
from icu_common.core.camera_model import CameraModel
from icu_common.core.config import Config, ConfigError, nested, setting
from icu_common.core.geometry import Array, Transform
from icu_common.core.panel_layout import PanelLayout

# A sighting that more of the face agrees with is not compared with others.
_SURE = 0.6
# The template is tried as a picture so blurred (px) shows it; it must look that much more like the picture than the one
# before. A tracked panel's blur is tried anew in every so many pictures.
_BLURS_PX = (0.0, 1.0, 1.6, 2.3)
_BLURRED = 0.01
_BLUR_EVERY = 10
# The corners are mostly text, whose typeface is not the maker's, and a word's corners err together: their covariance
# counts so many times.
_TYPEFACE = 4.0
# So near to a control the picture blurs its sides and its shadow into the print (px of the template).
_BESIDE_PX = 5
# How much larger a picture is searched that shows no panel as it is, and every how many such pictures.
_ENLARGED = 1.5
_ENLARGE_EVERY = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class RefineConfig(Config):
    """How a found panel is measured and judged."""

    points: int = setting(400, "Template corners that are measured", minimum=20, maximum=5000)
    window_px: int = setting(17, "Side of the window of the optical flow", minimum=7, maximum=61, unit="px")
    reach_px: float = setting(16.0, "Greatest shift that is believed", minimum=1.0, maximum=100.0, unit="px")
    round_trip_px: float = setting(0.4, "Forward and backward flow may differ", minimum=0.01, maximum=5.0, unit="px")
    tolerance_px: float = setting(0.8, "Misfit of a measured point", minimum=0.1, maximum=10.0, unit="px")
    min_points: int = setting(20, "Points that fit", minimum=6, maximum=5000)
    max_deviation_px: float = setting(
        0.45, "Standard deviation to which the pose must tell every place of the face", minimum=0.01, maximum=20.0
    )
    edge_points: int = setting(30, "Edge points that fit", minimum=8, maximum=5000)
    max_edge_points: int = setting(1000, "Edge points that are measured", minimum=50, maximum=20000)
    edge_reach_px: float = setting(5.0, "Greatest distance of an edge", minimum=1.0, maximum=30.0, unit="px")
    max_rms_px: float = setting(
        0.6, "Greatest misfit of the edges; more means a wrong camera calibration or layout", minimum=0.05, maximum=10.0
    )
    edge_correlation: float = setting(0.75, "Likeness of the profiles across an edge", minimum=0.1, maximum=1.0)
    patch_mm: float = setting(6.0, "Side of a patch of the correlation", minimum=1.0, maximum=100.0, unit="mm")
    patch_correlation: float = setting(0.6, "A patch agrees from here on", minimum=0.1, maximum=1.0)
    min_purity: float = setting(0.94, "Part of the patches that agree where most around do", minimum=0.0, maximum=1.0)
    max_contradiction: float = setting(
        0.8, "Patches that show other print than the template's, over those that agree", minimum=0.0, maximum=10.0
    )
    min_agreement: float = setting(
        0.2,
        "Agreeing part of the face's textured patches, hidden ones not agreeing",
        minimum=0.05,
        maximum=1.0,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognitionConfig(Config):
    """Search, refinement and agreement."""

    search: SearchConfig = nested(SearchConfig)
    refine: RefineConfig = nested(RefineConfig)
    agreement: AgreementConfig = nested(AgreementConfig)

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.agreement.window < self.agreement.frames:
            raise ConfigError(
                f"agreement.window = {self.agreement.window} is below agreement.frames = {self.agreement.frames}"
            )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Sighting:
    """The panel in one picture.

    Attributes
    ----------
    rectified_from_mm
        (3, 3) homography from the face's mm to rectified pixels.
    camera_from_panel
        Pose in the camera's rectified frame, metres.
    points
        The measured points that fit.
    rms_px
        Their misfit under the pose.
    deviation_px
        Standard deviation to which the pose tells where the face's corners are seen.
    tracked
        Followed from the frame before rather than searched.
    patches
        Where on the face the print agrees.
    fit
        The pose with its covariance.
    """

    rectified_from_mm: Array
    camera_from_panel: Transform
    points: FacePoints
    rms_px: float
    deviation_px: float
    tracked: bool
    patches: Patches
    fit: PoseFit

    @property
    def agreement(self) -> float:
        """Agreeing part of the face's textured patches, 0 to 1."""
        return self.patches.agreement


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """One scale of the template: its picture evened out, and its corners (on steady print) by falling response."""

    template: PanelTemplate
    even: Gray
    corners_px: Floats
    corners_mm: Array
    edges: EdgePoints


class PanelRecogniser:
    """Searches one designated panel and follows it; remembers where it was seen last.

    Parameters
    ----------
    layout
        The designated panel.
    config
        See :class:`RecognitionConfig`.
    harris
        Detector settings for the template's corners; the same as for the pictures.
    picture, picture_px_per_mm
        A picture of the face instead of the layout's drawing; see :func:`panel_template`.

    Raises
    ------
    ValueError
        If the face has too little print to be recognised, or the picture does not fit the layout.
    """

    def __init__(
        self,
        layout: PanelLayout,
        config: RecognitionConfig | None = None,
        harris: HarrisConfig | None = None,
        picture: npt.NDArray[Any] | None = None,
        picture_px_per_mm: float = 0.0,
    ) -> None:
        self.layout = layout
        self.config = config if config is not None else RecognitionConfig()
        search = self.config.search
        detector = HarrisDetector(harris)
        fine = HarrisConfig() if harris is None else harris
        self._fine_detector = HarrisDetector(
            dataclasses.replace(fine, relative_threshold=0.3 * fine.relative_threshold)
        )
        scales = [search.px_per_mm / search.factor**k for k in range(search.levels)]
        self._levels = [
            _level(panel_template(layout, scale, picture, picture_px_per_mm), detector)
            for scale in scales
            if min(layout.size_mm) * scale >= 48
        ]
        refine = self.config.refine
        best = self._levels[0] if self._levels else None
        if best is None or len(best.corners_px) < refine.min_points or len(best.edges) < refine.edge_points:
            raise ValueError(f"the face of {layout.model} has too little print to be recognised")
        self._describe = Describer(search)
        described = [
            self._describe(level.template.gray, level.corners_px[: search.corners_per_level]) for level in self._levels
        ]
        self._descriptors = np.vstack([descriptors for descriptors, _ in described])
        self._places_mm = np.vstack(
            [level.corners_mm[: search.corners_per_level][kept] for level, (_, kept) in zip(self._levels, described)]
        )
        self._maps: tuple[CameraModel, tuple[Any, Any]] | None = None
        self._last: Sighting | None = None
        self._failures = self._tracked = 0
        self._blur_px = 0.0
        self._soft: dict[tuple[int, float], _Level] = {}

    def forget(self) -> None:
        """Search the next picture from nothing."""
        self._last = None
        self._failures = 0

    def locate(
        self, gray: Gray, corners_px: npt.ArrayLike, camera: CameraModel, suggested: Sequence[Transform] = ()
    ) -> Sighting | None:
        """Find the panel in a raw picture, or return None.

        Parameters
        ----------
        gray
            (H, W) uint8, raw.
        corners_px
            (N, 2) its Harris corners in raw pixels by falling response.
        camera
            The camera that took it.
        suggested
            Poses (camera_from_panel) from elsewhere, where a search looks first; judged as any other.

        Raises
        ------
        ValueError
            If the picture's size is not the camera's.
        """
        if gray.shape[::-1] != camera.size:
            raise ValueError(f"the picture has {gray.shape[::-1]} px, the camera's calibration {camera.size}")
        rectified = self._rectify(gray, camera)
        sighting = self._track(rectified, camera) if self._last is not None else None
        if sighting is None:
            raw = np.asarray(corners_px, dtype=np.float64).reshape(-1, 2)[: self.config.search.max_corners]
            best = self._best(rectified, suggested, camera)
            if best is None or not self._believed(best):
                best = self._find(rectified, camera.rectify(raw).astype(np.float32), camera)
            if best is None and self._failures % _ENLARGE_EVERY == 0:
                best = self._find_enlarged(rectified, camera)
            sighting = best if best is not None and self._believed(best) else None
        self._failures = 0 if sighting is not None else self._failures + 1
        self._last = sighting
        return sighting

    def _find(self, rectified: Gray, corners_px: Floats, camera: CameraModel) -> Sighting | None:
        matched = ((places, pixels) for _, places, pixels in self._matched(rectified, corners_px))
        return self._best(rectified, self._suggested(matched, camera), camera)

    def _find_enlarged(self, rectified: Gray, camera: CameraModel) -> Sighting | None:
        """Search the picture enlarged: its descriptors see less around a corner, and that is more often unhidden."""
        size = tuple(round(_ENLARGED * side) for side in rectified.shape[::-1])
        larger = np.asarray(cv2.resize(rectified, size, interpolation=cv2.INTER_CUBIC), np.uint8)
        corners = self._fine_detector.detect(larger).xy[: self.config.search.max_corners].astype(np.float32)
        matched = ((places, (pixels + 0.5) / _ENLARGED - 0.5) for _, places, pixels in self._matched(larger, corners))
        return self._best(rectified, self._suggested(matched, camera), camera)

    def _best(self, rectified: Gray, poses: Iterable[Transform], camera: CameraModel) -> Sighting | None:
        """Measure at all suggested poses, and return what most print agrees with, not yet judged.

        Where that cannot be believed, what is less likely must not take its place: it would be wrong.
        """
        best: Sighting | None = None
        blur_px = 0.0
        for pose in poses:
            self._blur_px = 0.0
            start = self._by_corners(rectified, pose, camera)
            if start is None:
                continue
            self._blur_px = self._blur(rectified, start.camera_from_panel, camera)
            sighting = self._measure(rectified, start, camera, tracked=False)
            if sighting is not None and (best is None or sighting.patches.count > best.patches.count):
                best, blur_px = sighting, self._blur_px
                if best.agreement > _SURE and self._believed(best):
                    break
        self._blur_px = blur_px
        return best

    def _track(self, rectified: Gray, camera: CameraModel) -> Sighting | None:
        """Look near the last sighting: by the edges alone; by the corners first where those find less than before."""
        assert self._last is not None
        last = self._last.camera_from_panel
        self._tracked += 1
        if self._tracked % _BLUR_EVERY == 0:
            self._blur_px = self._blur(rectified, last, camera)
        sighting = self._measure(rectified, last, camera, tracked=True)
        if sighting is not None and not self._believed(sighting):
            sighting = None
        if sighting is not None and sighting.agreement > 0.9 * self._last.agreement:
            return sighting
        start = self._by_corners(rectified, last, camera)
        if start is None:
            return sighting
        self._blur_px = self._blur(rectified, start.camera_from_panel, camera)
        again = self._measure(rectified, start, camera, tracked=True)
        return again if again is not None and self._believed(again) else sighting

    def _believed(self, sighting: Sighting) -> bool:
        """Tell whether enough print agrees, nearly all of it where any does, and whether that fixes the whole face."""
        config, patches = self.config.refine, sighting.patches
        return (
            patches.agreement >= config.min_agreement
            and patches.purity >= config.min_purity
            and patches.contradiction <= config.max_contradiction * patches.agreement
            and sighting.deviation_px <= config.max_deviation_px
        )

    def _rectify(self, gray: Gray, camera: CameraModel) -> Gray:
        if self._maps is None or self._maps[0] is not camera:
            self._maps = (camera, camera.rectification_maps())
            self._last = None
        first, second = self._maps[1]
        return np.asarray(cv2.remap(gray, first, second, cv2.INTER_LINEAR), dtype=np.uint8)

    def search(self, rectified: Gray, corners_px: Floats) -> Array | None:
        """Find the face by descriptors alone: return rectified_from_mm (3, 3), unrefined and unjudged, or None.

        Parameters
        ----------
        rectified
            (H, W) uint8, without distortion.
        corners_px
            (N, 2) float32 its corners by falling response.
        """
        return next((homography for homography, _, _ in self._matched(rectified, corners_px)), None)

    def _matched(self, rectified: Gray, corners_px: Floats) -> Iterator[tuple[Array, Array, Array]]:
        """Yield homographies, the likeliest first, with the places (N, 2) mm and pixels (N, 2) that agree on each."""
        search = self.config.search
        descriptors, kept = self._describe(rectified, corners_px)
        if len(kept) < search.min_matches:
            return
        query, place = matches(descriptors, self._descriptors, self._places_mm, search)
        places, pixels = self._places_mm[place], corners_px[kept][query].astype(np.float64)
        for _ in range(search.hypotheses):
            if len(places) < search.min_matches:
                return
            fitted = robust_homography(places, pixels, search.tolerance_px, search.min_matches)
            if fitted is None:
                return
            homography, used = fitted
            yield homography, places[used], pixels[used]
            places, pixels = places[~used], pixels[~used]

    def _suggested(self, matched: Iterable[tuple[Array, Array]], camera: CameraModel) -> Iterator[Transform]:
        """Yield the poses that places (N, 2) mm and pixels (N, 2) go with."""
        for places_mm, pixels in matched:
            for pose in planar_poses(places_mm * 1e-3, pixels, camera):
                yield fit_pose(
                    pose, FacePoints.of_corners(places_mm * 1e-3, pixels), camera, floor_px=1.0
                ).camera_from_panel

    def _measure(
        self, rectified: Gray, start: PoseFit | Transform, camera: CameraModel, *, tracked: bool
    ) -> Sighting | None:
        """Measure the panel near ``start`` and judge it; None when it is not there."""
        measured = self._by_edges(rectified, start, camera)
        if measured is None:
            return None
        fit, points, rms = measured
        pose = fit.camera_from_panel
        homography = homography_of_pose(pose, camera)
        level = self._level_for(homography)
        if level is None:
            return None
        return Sighting(
            rectified_from_mm=homography,
            camera_from_panel=pose,
            points=points,
            rms_px=rms,
            deviation_px=float(fit.deviation_px(self._outline_m(), camera).max()),
            tracked=tracked,
            patches=self._compared(
                level, self._visible(level, pose, _BESIDE_PX), self._warp(rectified, homography, level)
            ),
            fit=fit,
        )

    def _outline_m(self) -> Array:
        width, height = (1e-3 * side for side in self.layout.size_mm)
        return np.array([(0.0, 0.0, 0.0), (width, 0.0, 0.0), (width, height, 0.0), (0.0, height, 0.0)])

    def _by_corners(self, rectified: Gray, start: Transform, camera: CameraModel) -> PoseFit | None:
        """Return the pose after following the template's corners: robust, coarse."""
        pose, fit = start, None
        for _ in range(2):
            homography = homography_of_pose(pose, camera)
            level = self._level_for(homography)
            if level is None:
                return None
            warped = self._warp(rectified, homography, level)
            flow = _flow(level, self._visible(level, pose), warped, self.config.refine)
            if flow is None:
                return None
            pixels = map_points(homography @ inverse(level.template.px_from_mm), flow[1])
            fitted = robust_homography(flow[0], pixels, self.config.refine.tolerance_px, self.config.refine.min_points)
            if fitted is None:
                return None
            used = fitted[1]
            fit = fit_pose(pose, FacePoints.of_corners(flow[0][used] * 1e-3, pixels[used]), camera)
            pose = fit.camera_from_panel
        return fit

    def _by_edges(
        self, rectified: Gray, start: PoseFit | Transform, camera: CameraModel
    ) -> tuple[PoseFit, FacePoints, float] | None:
        """Return the pose, the edge points that fit, and their rms misfit in px.

        Where a pose comes from a few crowded points, far edges are measured only once the nearer ones have told where
        to look for them.
        """
        config = self.config.refine
        fit = start if isinstance(start, PoseFit) else None
        prior = None if fit is None else dataclasses.replace(fit, covariance=fit.covariance * _TYPEFACE)
        pose = start.camera_from_panel if isinstance(start, PoseFit) else start
        turns = 0
        while True:
            homography = homography_of_pose(pose, camera)
            level = self._level_for(homography)
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
        return fit, measured.chosen(near), rms

    def _blur(self, rectified: Gray, pose: Transform, camera: CameraModel) -> float:
        """Return by how much (px) the template must be blurred to look most like the picture."""
        homography = homography_of_pose(pose, camera)
        before = self._blur_px
        likeness: dict[float, float] = {}
        for self._blur_px in _BLURS_PX:
            level = self._level_for(homography)
            if level is None:
                return 0.0
            if not likeness:
                visible, warped = self._visible(level, pose), self._warp(rectified, homography, level)
            likeness[self._blur_px] = self._compared(level, visible, warped).likeness
        best = max(likeness, key=lambda blur: likeness[blur])
        return best if likeness[best] > likeness[before] + _BLURRED else before

    def _level_for(self, homography: Array) -> _Level | None:
        """Return the level whose scale is nearest to the picture's; None for a homography that no camera makes."""
        width, height = self.layout.size_mm
        corners = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
        depth = np.column_stack([corners, np.ones(4)]) @ homography[2]
        if not (np.isfinite(homography).all() and (depth * depth[0] > 0).all()):
            return None
        outline = map_points(homography, corners)
        side = np.roll(outline, -1, axis=0) - outline
        following = np.roll(side, -1, axis=0)
        turn = side[:, 0] * following[:, 1] - side[:, 1] * following[:, 0]
        # y is up on the panel and down in the picture: seen from the front the outline turns negative at each corner.
        if not (turn < 0).all():
            return None
        area = 0.5 * abs(float(np.sum(outline[:, 0] * side[:, 1] - outline[:, 1] * side[:, 0])))
        scale = np.sqrt(area / (width * height))
        if not 0.5 * self._levels[-1].template.px_per_mm < scale < 2.5 * self._levels[0].template.px_per_mm:
            return None
        number = int(np.argmin([abs(np.log(level.template.px_per_mm / scale)) for level in self._levels]))
        return self._levels[number] if self._blur_px == 0.0 else self._softened(number, self._blur_px)

    def _softened(self, number: int, blur_px: float) -> _Level:
        """Return a level as a blurred picture shows it."""
        if (number, blur_px) not in self._soft:
            sharp = self._levels[number]
            gray = np.asarray(cv2.GaussianBlur(sharp.template.gray, (0, 0), blur_px), np.uint8)
            self._soft[number, blur_px] = dataclasses.replace(
                sharp,
                template=dataclasses.replace(sharp.template, gray=gray),
                even=even_out(gray),
                edges=edge_points(gray, sharp.template.exact, 4.0 + blur_px),
            )
        return self._soft[number, blur_px]

    def _visible(self, level: _Level, pose: Transform, margin_px: int = 0) -> npt.NDArray[np.bool_]:
        """Return where steady print is not hidden by proud controls, at least ``margin_px`` away from them."""
        viewpoint_mm = pose.inverse().translation * 1e3
        shape = level.template.gray.shape
        hidden = hidden_by_controls(self.layout, viewpoint_mm, (shape[0], shape[1]), level.template.px_per_mm)
        if margin_px:
            size = 2 * margin_px + 1
            hidden = cv2.dilate(hidden.astype(np.uint8), np.ones((size, size), np.uint8)).astype(bool)
        return np.asarray(level.template.steady & ~hidden)

    def _warp(self, rectified: Gray, homography: Array, level: _Level) -> Gray:
        height, width = level.template.gray.shape
        rectified_from_level = homography @ inverse(level.template.px_from_mm)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(rectified, rectified_from_level, (width, height), flags=flags), np.uint8)

    def _compared(self, level: _Level, visible: npt.NDArray[np.bool_], warped: Gray) -> Patches:
        config = self.config.refine
        return compared(level.template, visible, warped, config.patch_mm, config.patch_correlation)


def _level(template: PanelTemplate, detector: HarrisDetector) -> _Level:
    corners = detector.detect(template.gray).xy
    # A corner that touches a control, screen or lamp would be measured with parallax or with what changes.
    margin = np.ones((5, 5), np.uint8)
    steady = cv2.erode(template.steady.astype(np.uint8), margin).astype(bool)
    nearest = np.rint(corners).astype(int)
    corners = corners[steady[nearest[:, 1], nearest[:, 0]]]
    corners_mm = map_points(inverse(template.px_from_mm), corners.astype(np.float64))
    edges = edge_points(template.gray, template.exact)
    return _Level(template, even_out(template.gray), corners.astype(np.float32), corners_mm, edges)


def even_out(gray: Gray) -> Gray:
    """Return the picture with its local mean at 128 and its local contrast at one level, against uneven light."""
    picture = gray.astype(np.float32)
    size = (31, 31)
    mean = cv2.boxFilter(picture, -1, size)
    deviation = np.sqrt(np.maximum(cv2.boxFilter(picture * picture, -1, size) - mean * mean, 0.0))
    return np.asarray(np.clip(128.0 + 45.0 * (picture - mean) / (deviation + 6.0), 0, 255), dtype=np.uint8)


def _flow(
    level: _Level, visible: npt.NDArray[np.bool_], warped: Gray, config: RefineConfig
) -> tuple[Array, Array] | None:
    """Return template points (N, 2) mm and where they are in the warped picture (N, 2) px; None for too few."""
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
