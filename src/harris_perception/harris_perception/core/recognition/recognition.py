"""Finds the designated panel in an image and measures its pose.

A new panel is searched by descriptors at Harris corners, which are matched with those of a template pyramid under a
robust homography (RANSAC). Every pose that the matches suggest is measured (``face_measurement``), and the one with
most agreeing print is judged. A strip of matches, which may be all that a hand leaves visible, fits two poses about
equally well. The same measurement tracks the panel from frame to frame.

A patchwise correlation with the template decides whether to accept a pose, and several frames must agree before it
counts. Few patches may agree, because most of the panel may be hidden. But the neighbours of agreeing patches must
agree, and few patches may show other print instead, as another panel does. Rows of similar controls also agree with
themselves mirrored and shifted. If much disagrees, the mirrored image is searched too, and must not show more of the
panel.

Only print on the face itself is used: controls are raised (parallax), screens and lamps change. Text helps to find the
panel. If it was drawn from the layout its typeface is not the maker's, and it is not used for measuring.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.pose.planar_pose import (
    FacePoints,
    PoseFit,
    fit_pose,
    planar_poses,
    sharing,
)
from harris_perception.core.pose.pose_agreement import AgreementConfig
from harris_perception.core.recognition.face_measurement import FaceMeter, RefineConfig
from harris_perception.core.recognition.panel_search import Floats, Gray, SearchConfig, TemplateSearch
from harris_perception.core.recognition.panel_template import panel_template
from harris_perception.core.recognition.sighting import Sighting
from icu_common.core.configuration.config import Config, ConfigError, nested
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import PanelLayout
from icu_common.core.reasons.message import Message

# Minimum agreement of a sighting that is accepted without comparing it with others.
_SURE = 0.6
# Number of images between two measurements of a tracked panel's blur.
_BLUR_EVERY = 10
# Factor by which an image without a recognised panel is enlarged for another search.
_ENLARGED = 1.5
# Period, in successive images without the panel, of the further searches: the first is enlarged, the second mirrored.
_FURTHER_EVERY = 5
# Minimum matches of the mirrored image, as a share of the original's, for its poses to be measured. For a normal panel
# they were a third at most, for a mirrored one at least 2.8 times as many (docs/decisions/recognition.md).
_MIRRORED_MATCHES = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognitionConfig(Config):
    """Settings of search, refinement and agreement."""

    search: SearchConfig = nested(SearchConfig)
    refine: RefineConfig = nested(RefineConfig)
    agreement: AgreementConfig = nested(AgreementConfig)

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.agreement.window < self.agreement.frames:
            raise ConfigError(
                f"agreement.window = {self.agreement.window} is below agreement.frames = {self.agreement.frames}"
            )


def face_meter(
    layout: PanelLayout,
    config: RecognitionConfig,
    harris: HarrisConfig | None,
    picture: npt.NDArray[Any] | None,
    picture_px_per_mm: float,
) -> FaceMeter:
    """Return a meter of a face at all scales of the search; see :class:`PanelRecogniser` for the parameters."""
    search = config.search
    scales = [search.px_per_mm / search.factor**k for k in range(search.levels)]
    templates = [
        panel_template(layout, scale, picture, picture_px_per_mm)
        for scale in scales
        if min(layout.size_mm) * scale >= 48
    ]
    return FaceMeter(layout, config.refine, templates, HarrisDetector(harris))


class PanelRecogniser:
    """Searches one designated panel and tracks it from its last pose.

    Attributes
    ----------
    mirrored
        True if the last image does not show the panel, but its mirror image does, as far as it was searched: the camera
        flips its images.

    Parameters
    ----------
    layout
        The designated panel.
    config
        See :class:`RecognitionConfig`.
    harris
        Detector settings for the template's corners; the same as for the images.
    picture, picture_px_per_mm
        An image of the face instead of the layout's drawing; see :func:`panel_template`.

    Raises
    ------
    ValueError
        If the face has too little print to be recognised, or the image does not fit the layout.
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
        fine = HarrisConfig() if harris is None else harris
        self._fine_detector = HarrisDetector(dataclasses.replace(fine, relative_threshold=0.0))
        self._meter = face_meter(layout, self.config, harris, picture, picture_px_per_mm)
        count = search.corners_per_level
        self._templates = TemplateSearch(
            search,
            [(level.template.gray, level.corners_px[:count], level.corners_mm[:count]) for level in self._meter.levels],
        )
        self._maps: tuple[CameraModel, tuple[Any, Any]] | None = None
        self._last: Sighting | None = None
        self._failures = self._tracked = 0
        self._blur_px = 0.0
        self.mirrored = False

    @property
    def meter(self) -> FaceMeter:
        """Measures the face."""
        return self._meter

    def forget(self) -> None:
        """Search the next image without prior knowledge."""
        self._last = None
        self._failures = 0
        self.mirrored = False

    def locate(
        self,
        gray: Gray,
        corners_px: npt.ArrayLike | Callable[[], npt.ArrayLike],
        camera: CameraModel,
        suggested: Sequence[Transform] = (),
    ) -> Sighting | None:
        """Find the panel in a raw image, or return None.

        Parameters
        ----------
        gray
            (H, W) uint8, raw.
        corners_px
            (N, 2) Harris corners in raw pixels by falling response, or a function that detects them: a tracked panel
            needs none.
        camera
            The camera that took it.
        suggested
            Poses (camera_from_panel) from other sources, which are tried first and judged like any other.

        Raises
        ------
        ValueError
            If the image's size is not the camera's, or it is not 8 bits deep.
        """
        if gray.shape[::-1] != camera.size:
            raise ValueError(
                Message("recognition.picture_camera_calibration", shape_px=gray.shape[::-1], size=camera.size)
            )
        if gray.dtype != np.uint8:
            raise ValueError(Message("recognition.picture_values_uint_8_needed", dtype=gray.dtype))
        rectified = self._rectify(gray, camera)
        sighting = self._track(rectified, camera) if self._last is not None else None
        if sighting is None:
            found = corners_px() if callable(corners_px) else corners_px
            sighting = self._search(rectified, found, camera, suggested)
        self._failures = 0 if sighting is not None else self._failures + 1
        self.mirrored = self.mirrored and sighting is None
        self._last = sighting
        return sighting

    def _search(
        self, rectified: Gray, corners_px: npt.ArrayLike, camera: CameraModel, suggested: Sequence[Transform]
    ) -> Sighting | None:
        """Return the accepted sighting in an image that is searched without prior knowledge."""
        best = self._best(rectified, suggested, camera)
        if best is not None and self._believed(best):
            return best
        raw = np.asarray(corners_px, dtype=np.float64).reshape(-1, 2)[: self.config.search.max_corners]
        corners = camera.rectify(raw).astype(np.float32)
        best, matched = self._find(rectified, corners, camera, self.config.search.min_matches)
        if best is None and self._failures % _FURTHER_EVERY == 0:
            best = self._find_enlarged(rectified, camera)
        believed = best if best is not None and self._believed(best) else None
        if believed is not None and believed.agreement > _SURE:
            return believed
        if believed is not None or self.mirrored or self._failures % _FURTHER_EVERY == 1:
            self.mirrored = self._is_mirrored(rectified, corners, camera, believed, matched)
        return None if self.mirrored else believed

    def _find(
        self, rectified: Gray, corners_px: Floats, camera: CameraModel, least: int
    ) -> tuple[Sighting | None, int]:
        """Return the best sighting, not yet judged, and the most matches of a suggestion, ``least`` or more."""
        most = 0

        def matched() -> Iterator[tuple[Array, Array]]:
            nonlocal most
            for _, places, pixels in self._templates.matched(rectified, corners_px, least):
                most = max(most, len(places))
                yield places, pixels

        return self._best(rectified, self._suggested(matched(), camera), camera), most

    def _find_enlarged(self, rectified: Gray, camera: CameraModel) -> Sighting | None:
        """Search the enlarged image: its descriptors cover smaller surroundings, which are more often visible.

        Its strongest corners are used without a threshold: in the dark no print has a hundredth of the response of a
        lamp or a hot pixel.
        """
        size = tuple(round(_ENLARGED * side) for side in rectified.shape[::-1])
        larger = np.asarray(cv2.resize(rectified, size, interpolation=cv2.INTER_CUBIC), np.uint8)
        corners = self._fine_detector.detect(larger).xy[: self.config.search.max_corners].astype(np.float32)
        least = self.config.search.min_matches
        matched = self._templates.matched(larger, corners, least)
        smaller = ((places, (pixels + 0.5) / _ENLARGED - 0.5) for _, places, pixels in matched)
        return self._best(rectified, self._suggested(smaller, camera), camera)

    def _is_mirrored(
        self, rectified: Gray, corners_px: Floats, camera: CameraModel, seen: Sighting | None, matched: int
    ) -> bool:
        """Return whether the mirrored image shows the panel, and more of it than ``seen`` in the image.

        The image had ``matched`` matches. If the mirrored image has far fewer, its poses are not measured, which would
        take long.
        """
        last = camera.width - 1
        p = camera.p.copy()
        p[0, 2] = last - p[0, 2]
        corners = np.column_stack([last - corners_px[:, 0], corners_px[:, 1]])
        blur_px = self._blur_px
        least = max(self.config.search.min_matches, int(_MIRRORED_MATCHES * matched) + 1)
        mirror = np.ascontiguousarray(rectified[:, ::-1])
        other, _ = self._find(mirror, corners, dataclasses.replace(camera, p=p), least)
        self._blur_px = blur_px
        return (
            other is not None and self._believed(other) and (seen is None or other.patches.count > seen.patches.count)
        )

    def _best(self, rectified: Gray, poses: Iterable[Transform], camera: CameraModel) -> Sighting | None:
        """Measure at all suggested poses, and return the one with most agreeing print, not yet judged.

        If that is not accepted, a less likely one must not replace it: it would be wrong.
        """
        best: Sighting | None = None
        self._blur_px = 0.0
        for pose in poses:
            start = self._meter.by_corners(rectified, pose, camera, 0.0)
            if start is None:
                continue
            blur_px = self._meter.blur(rectified, start.camera_from_panel, camera, 0.0)
            sighting = self._measure(rectified, start, camera, blur_px, tracked=False)
            if sighting is not None and (best is None or sighting.patches.count > best.patches.count):
                best, self._blur_px = sighting, blur_px
                if best.agreement > _SURE and self._believed(best):
                    break
        return best

    def _track(self, rectified: Gray, camera: CameraModel) -> Sighting | None:
        """Search near the last sighting: by edges alone, or by corners first if the edges find less than before."""
        assert self._last is not None
        last = self._last.camera_from_panel
        self._tracked += 1
        if self._tracked % _BLUR_EVERY == 0:
            self._blur_px = self._meter.blur(rectified, last, camera, self._blur_px)
        sighting = self._measure(rectified, last, camera, self._blur_px, tracked=True)
        if sighting is not None and not self._believed(sighting):
            sighting = None
        if sighting is not None and sighting.agreement > 0.9 * self._last.agreement:
            return sighting
        start = self._meter.by_corners(rectified, last, camera, self._blur_px)
        if start is None:
            return sighting
        self._blur_px = self._meter.blur(rectified, start.camera_from_panel, camera, self._blur_px)
        again = self._measure(rectified, start, camera, self._blur_px, tracked=True)
        return again if again is not None and self._believed(again) else sighting

    def _believed(self, sighting: Sighting) -> bool:
        """Return whether enough print agrees, nearly all of it where any does, and determines the whole face's pose."""
        config, patches = self.config.refine, sighting.patches
        return (
            patches.agreement >= config.min_agreement
            and patches.purity >= config.min_purity
            and patches.contradiction <= config.max_contradiction * patches.agreement
            and patches.intrusion <= config.max_intrusion
            and sighting.deviation_px <= config.max_deviation_px
        )

    def _rectify(self, gray: Gray, camera: CameraModel) -> Gray:
        if self._maps is None or self._maps[0] is not camera:
            self._maps = (camera, camera.rectification_maps())
            self._last = None
        first, second = self._maps[1]
        return np.asarray(cv2.remap(gray, first, second, cv2.INTER_LINEAR), dtype=np.uint8)

    def search(self, rectified: Gray, corners_px: Floats) -> Array | None:
        """Find the face by descriptors alone: return rectified_from_mm (3, 3), unrefined and not judged, or None.

        Parameters
        ----------
        rectified
            (H, W) uint8, without distortion.
        corners_px
            (N, 2) float32 corners by falling response.
        """
        least = self.config.search.min_matches
        return next((homography for homography, _, _ in self._templates.matched(rectified, corners_px, least)), None)

    def _suggested(self, matched: Iterable[tuple[Array, Array]], camera: CameraModel) -> Iterator[Transform]:
        """Yield the poses that fit the positions (N, 2) mm and pixels (N, 2)."""
        for places_mm, pixels in matched:
            for pose in planar_poses(places_mm * 1e-3, pixels, camera):
                yield fit_pose(
                    pose, FacePoints.of_corners(places_mm * 1e-3, pixels), camera, floor_px=1.0
                ).camera_from_panel

    def _measure(
        self, rectified: Gray, start: PoseFit | Transform, camera: CameraModel, blur_px: float, *, tracked: bool
    ) -> Sighting | None:
        """Measure the panel near ``start`` and compare it with the print; None if it is not there."""
        measured = self._meter.by_edges(rectified, start, camera, blur_px)
        if measured is None:
            return None
        fit, points, line, rms = measured
        pose = fit.camera_from_panel
        patches = self._meter.compared(rectified, pose, camera, blur_px)
        if patches is None:
            return None
        return Sighting(
            camera_from_panel=pose,
            points=points,
            rms_px=rms,
            deviation_px=float(fit.deviation_px(self._outline_m(), camera).max()),
            tracked=tracked,
            patches=patches,
            fit=sharing(fit, points, line, camera),
        )

    def _outline_m(self) -> Array:
        width, height = (1e-3 * side for side in self.layout.size_mm)
        return np.array([(0.0, 0.0, 0.0), (width, 0.0, 0.0), (width, height, 0.0), (0.0, height, 0.0)])
