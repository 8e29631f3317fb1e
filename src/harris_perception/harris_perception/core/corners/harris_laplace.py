"""Harris corners over a pyramid, at the scale with the largest Laplacian response: the detector for scale changes.

Source: K. Mikolajczyk, C. Schmid, "Scale & Affine Invariant Interest Point Detectors", IJCV 60(1), 2004. The scales are
levels of a pyramid instead of wider kernels: derivatives per px of a level are the normalised derivatives of its scale.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.spacing import spread
from harris_perception.core.corners.value_range import checked, from_lowest
from harris_perception.core.image.sampling import sampled
from icu_common.core.configuration.config import Config, nested, setting

F32 = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class PyramidConfig(Config):
    """Scales, and selection of a scale."""

    levels: int = setting(8, "Number of pyramid levels", minimum=1, maximum=30)
    factor: float = setting(1.26, "Ratio between neighbouring scales", minimum=1.05, maximum=2.0)
    select: bool = setting(
        True, "Keep a corner only at the scale with the largest Laplacian response; if false, at every scale"
    )
    laplacian_px: float = setting(1.5, "Scale of the Laplacian on each level", minimum=0.5, maximum=10.0, unit="px")


@dataclass(frozen=True, slots=True, kw_only=True)
class HarrisLaplaceConfig(PyramidConfig):
    """The pyramid, and the detector on each of its levels (its ``max_corners`` is for all levels together)."""

    detector: HarrisConfig = nested(HarrisConfig)


@dataclass(frozen=True, slots=True, eq=False)
class ScaledCorners:
    """Corners with their scales, by falling response.

    Attributes
    ----------
    xy
        (N, 2) float32 px of the image.
    scale
        (N,) float32, 1 for the image's own resolution, larger for coarser levels.
    response
        (N,) float32 of the level; float64 as in ``Corners``.
    """

    xy: F32
    scale: F32
    response: npt.NDArray[Any]

    def __len__(self) -> int:
        return len(self.response)


class HarrisLaplaceDetector:
    """Detector of corners with their scale.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.indices((120, 120))
    >>> picture = np.where((abs(x - 60) < 12) & (abs(y - 60) < 12), 200, 20).astype(np.uint8)
    >>> corners = HarrisLaplaceDetector().detect(picture)
    >>> len(corners) > 0, bool((np.abs(np.abs(corners.xy - 60).max(axis=1) - 12) < 6).all())
    (True, True)
    """

    def __init__(self, config: HarrisLaplaceConfig | None = None) -> None:
        self.config = config if config is not None else HarrisLaplaceConfig()
        detector = self.config.detector
        # The best scales, and large distances, are selected among all corners of each level.
        every = replace(detector, even_spread=False, max_corners=0)
        self._detector = HarrisDetector(every if detector.even_spread or self.config.select else detector)

    def warm(self) -> None:
        """Compile, or load from the cache, all code needed, so that no image waits for it."""
        self._detector.warm()

    def strengths_of(self, response: npt.NDArray[Any]) -> F32:
        """Return the strengths of corners with these responses, like ``HarrisDetector.strengths_of``."""
        return self._detector.strengths_of(response)

    def detect(self, gray: npt.NDArray[Any]) -> ScaledCorners:
        """Return the corners of (H, W) uint8, uint16 or float32; with ``select``, where the Laplacian is largest.

        Raises
        ------
        ValueError
            For another shape or dtype.
        """
        gray = checked(gray) if gray.dtype == np.uint8 else from_lowest(checked(gray))
        pictures, detector = self._pyramid(gray), self.config.detector
        found = [self._detector.detect(picture) for picture in pictures]
        laplacians = [self._laplacian(picture) for picture in pictures] if self.config.select else []
        xys = [np.asarray((c.xy + 0.5) * _ratio(gray, p) - 0.5, np.float32) for c, p in zip(found, pictures)]
        selected = []
        for level, xy in enumerate(xys):
            kept = np.ones(len(xy), bool)
            for beside in (level - 1, level + 1):
                if 0 <= beside < len(laplacians):
                    kept &= _values(laplacians[level], xy, gray) > _values(laplacians[beside], xy, gray)
            selected.append(np.flatnonzero(kept))
        quotas = self._quotas([len(places) for places in selected])
        responses, scales, beyond = [], [], []
        for level, (corners, places, quota) in enumerate(zip(found, selected, quotas)):
            if detector.even_spread:
                if len(places) > quota:
                    places = places[spread(corners.xy[places], detector.suppression_radius_px, quota)]
                late = np.zeros(len(places), bool)
            else:
                # A quota covers only strong corners of its level; weak ones do not precede strong ones of other levels.
                late = (np.arange(len(places)) >= quota) | (places >= (detector.max_corners or len(xys[level])))
            xys[level] = xys[level][places]
            scales.append(np.full(len(places), self.config.factor**level))
            responses.append(corners.response[places])
            beyond.append(late)
        response = np.concatenate(responses)
        # Quotas are rounded up, so their sum may be too large; corners that a level does not use go to the others.
        order = np.lexsort((-response, np.concatenate(beyond)))[: detector.max_corners or None]
        order = order[np.argsort(-response[order], kind="stable")]
        xy, scale = (np.asarray(np.concatenate(parts)[order], np.float32) for parts in (xys, scales))
        return ScaledCorners(xy, scale, response[order])

    def _pyramid(self, gray: npt.NDArray[Any]) -> list[npt.NDArray[Any]]:
        pictures = [gray]
        for level in range(1, self.config.levels):
            scale = self.config.factor**level
            width, height = round(gray.shape[1] / scale), round(gray.shape[0] / scale)
            if min(width, height) <= 2 * self._detector.margin_px + 2:
                break
            pictures.append(cv2.resize(gray, (width, height), interpolation=cv2.INTER_AREA))
        return pictures

    def _laplacian(self, picture: npt.NDArray[Any]) -> F32:
        if picture.size == 0:
            return np.zeros(picture.shape, np.float32)
        soft = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), self.config.laplacian_px)
        return np.abs(cv2.Laplacian(soft, cv2.CV_32F, ksize=1))

    def _quotas(self, there: Sequence[int]) -> list[int]:
        """Return the maximum number of corners of each level; it is proportional to the level's number of pixels.

        With an even spread it is at most ``there``, the number of corners found; the other levels share the rest.
        """
        count, even = self.config.detector.max_corners, self.config.detector.even_spread
        if count == 0:
            return [sys.maxsize] * len(there)
        if not even:
            shares = self.config.factor ** (-2.0 * np.arange(self.config.levels))
            return [int(np.ceil(count * share / shares.sum())) for share in shares[: len(there)]]
        room, given = np.array(there), np.zeros(len(there), np.int64)
        while (left := min(count, int(room.sum())) - int(given.sum())) > 0:
            shares = np.where(given < room, self.config.factor ** (-2.0 * np.arange(len(there))), 0.0)
            ends = np.rint(np.cumsum(shares) * (left / shares.sum())).astype(np.int64)  # exact in sum
            given += np.minimum(np.diff(ends, prepend=0), room - given)
        return [int(number) for number in given]


def _ratio(gray: npt.NDArray[Any], picture: npt.NDArray[Any]) -> F32:
    return np.array([gray.shape[1] / max(picture.shape[1], 1), gray.shape[0] / max(picture.shape[0], 1)], np.float32)


def _values(picture: F32, xy: F32, gray: npt.NDArray[Any]) -> F32:
    """Return the level's values at the positions ``xy`` of the full image, interpolated."""
    if len(xy) == 0:
        return np.empty(0, np.float32)
    at = np.asarray((xy + 0.5) / _ratio(gray, picture) - 0.5, np.float32)
    return sampled(picture, at[None, :, 0], at[None, :, 1]).reshape(-1)
