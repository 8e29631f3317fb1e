"""Finds a panel without prior knowledge: descriptors at corners, their matches at different positions, a homography."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.geometry import Array

Gray = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchConfig(Config):
    """Settings of the search without prior knowledge."""

    px_per_mm: float = setting(4.0, "Scale of the template's largest level", minimum=0.2, maximum=20.0, unit="px/mm")
    levels: int = setting(7, "Number of levels of the template pyramid", minimum=1, maximum=12)
    factor: float = setting(1.26, "Ratio between the scales of neighbouring levels", minimum=1.05, maximum=2.0)
    descriptor: str = setting("sift", "Descriptor of the corners", choices=("sift", "orb"))
    upright: bool = setting(
        False, "Do not rotate descriptors to the image gradient; faster and more reliable if the camera is not rolled"
    )
    patch_px: float = setting(5.0, "Keypoint size that the descriptor uses", minimum=2.0, maximum=40.0, unit="px")
    corners_per_level: int = setting(
        700, "Maximum number of template corners on each level, strongest first", minimum=50, maximum=5000
    )
    max_corners: int = setting(1500, "Maximum number of image corners, strongest first", minimum=50, maximum=10000)
    ratio: float = setting(
        0.85,
        "Maximum distance to the best match, as a fraction of the distance to the best match at another position",
        minimum=0.3,
        maximum=1.0,
    )
    same_place_mm: float = setting(
        2.0,
        "Distance on the face below which two matches count as the same position",
        minimum=0.1,
        maximum=50.0,
        unit="mm",
    )
    tolerance_px: float = setting(3.0, "Maximum misfit of a match", minimum=0.5, maximum=20.0, unit="px")
    min_matches: int = setting(10, "Minimum number of matches that agree with the homography", minimum=6, maximum=1000)
    hypotheses: int = setting(
        3,
        "Maximum number of homographies tried, each from the matches that the previous ones left over",
        minimum=1,
        maximum=20,
    )


class Describer:
    """Computes descriptors at given corners; they are vectors whose dot product is their similarity."""

    def __init__(self, config: SearchConfig) -> None:
        self._config = config
        if config.descriptor == "sift":
            self._extractor: Any = cv2.SIFT.create()
        else:
            self._extractor = cv2.ORB.create(edgeThreshold=2)

    def __call__(self, gray: Gray, corners_px: Floats) -> tuple[Floats, npt.NDArray[np.intp]]:
        """Return unit descriptors (M, D) and the indices (M,) of the corners that have one; D is the same for M = 0."""
        angles = np.zeros(len(corners_px)) if self._config.upright else _directions(gray, corners_px)
        size = self._config.patch_px
        keypoints = [
            cv2.KeyPoint(float(x), float(y), size, float(angle), 1.0, 0, number)
            for number, ((x, y), angle) in enumerate(zip(corners_px, angles))
        ]
        kept, descriptors = self._extractor.compute(gray, keypoints)
        if descriptors is None:
            # SIFT's size is a count of numbers, ORB's a count of bytes of eight bits.
            count = self._extractor.descriptorSize() * (8 if self._config.descriptor == "orb" else 1)
            return np.empty((0, count), np.float32), np.empty(0, np.intp)
        indices = np.array([k.class_id for k in kept], dtype=np.intp)
        if self._config.descriptor == "orb":
            bits = np.unpackbits(descriptors, axis=1).astype(np.float32) * 2 - 1
            return bits / np.float32(np.sqrt(bits.shape[1])), indices
        # RootSIFT (R. Arandjelovic, A. Zisserman, CVPR 2012): Hellinger distance as a dot product.
        values = descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)
        return np.sqrt(values).astype(np.float32), indices


def _directions(gray: Gray, corners_px: Floats) -> Array:
    """Return the direction in degrees of the smoothed gradient at each corner (M. Brown et al., MOPS, CVPR 2005)."""
    smooth = cv2.GaussianBlur(gray, (0, 0), 3.5).astype(np.float32)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    at = np.clip(np.rint(corners_px).astype(int), 0, (gray.shape[1] - 1, gray.shape[0] - 1))
    return np.asarray(np.degrees(np.arctan2(gy[at[:, 1], at[:, 0]], gx[at[:, 1], at[:, 0]])) % 360.0)


def matches(
    query: Floats, template: Floats, places_mm: Array, config: SearchConfig
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return the pairs (query, template) that pass the ratio test against the best match at another position."""
    likeness = query @ template.T
    count = min(24, likeness.shape[1])
    top = np.argpartition(-likeness, count - 1, axis=1)[:, :count]
    values = np.take_along_axis(likeness, top, axis=1)
    order = np.argsort(-values, axis=1)
    top, values = np.take_along_axis(top, order, axis=1), np.take_along_axis(values, order, axis=1)
    apart = np.linalg.norm(places_mm[top] - places_mm[top[:, :1]], axis=2) > config.same_place_mm
    elsewhere = np.where(apart, values, -1.0).max(axis=1)
    best, other = (np.sqrt(np.maximum(2.0 - 2.0 * v, 0.0)) for v in (values[:, 0], elsewhere))
    good = np.flatnonzero(best < config.ratio * other)
    return good, top[good, 0]


def robust_homography(
    points_mm: Array, pixels: Array, tolerance_px: float, least: int
) -> tuple[Array, npt.NDArray[np.bool_]] | None:
    """Return the homography that most points agree on, fitted to these points, and which they are.

    Parameters
    ----------
    points_mm, pixels
        (N, 2) of the face and of the image, in pairs.
    tolerance_px
        Maximum deviation of a point.
    least
        Minimum number of agreeing points; with fewer, None is returned.

    Returns
    -------
    tuple or None
        (3, 3) pixels_from_mm, and (N,) bool.
    """
    options: Any = {"ransacReprojThreshold": tolerance_px, "maxIters": 5000, "confidence": 0.999}
    # MAGSAC, which OpenCV 5.0 ends after a few samples, found none of 60 views alone and added none to RANSAC.
    found, mask = cv2.findHomography(points_mm, pixels, method=cv2.RANSAC, **options)
    if found is None:
        return None
    used = mask.ravel().astype(bool)
    if int(used.sum()) < least:
        return None
    refined, _ = cv2.findHomography(points_mm[used], pixels[used], method=0)
    return None if refined is None else (np.asarray(refined, dtype=np.float64), used)


class TemplateSearch:
    """Searches images for a face by the descriptors of its templates.

    Parameters
    ----------
    config
        Limits of the search.
    templates
        For each scale the drawn face (H, W) uint8, its corners (N, 2) px, and their positions (N, 2) mm on the face.
    """

    def __init__(self, config: SearchConfig, templates: Sequence[tuple[Gray, Floats, Array]]) -> None:
        self._config = config
        self._describe = Describer(config)
        described = [self._describe(gray, corners_px) for gray, corners_px, _ in templates]
        self._descriptors = np.vstack([descriptors for descriptors, _ in described])
        self._places_mm = np.vstack([places[kept] for (_, _, places), (_, kept) in zip(templates, described)])

    def matched(self, rectified: Gray, corners_px: Floats, least: int) -> Iterator[tuple[Array, Array, Array]]:
        """Yield homographies, the likeliest first, with the positions (N, 2) mm and pixels (N, 2) that agree on each.

        At least ``least`` agree on each.
        """
        config = self._config
        descriptors, kept = self._describe(rectified, corners_px)
        if len(kept) < least:
            return
        query, place = matches(descriptors, self._descriptors, self._places_mm, config)
        places, pixels = self._places_mm[place], corners_px[kept][query].astype(np.float64)
        for _ in range(config.hypotheses):
            if len(places) < least:
                return
            fitted = robust_homography(places, pixels, config.tolerance_px, least)
            if fitted is None:
                return
            homography, used = fitted
            yield homography, places[used], pixels[used]
            places, pixels = places[~used], pixels[~used]
