"""Descriptors at Harris corners, and matches of two images that pass mutual, ratio and geometric checks.

Sources: E. Rublee et al., "ORB", ICCV 2011 (orientation by the intensity centroid); D. Lowe, IJCV 60(2), 2004 (SIFT,
ratio test); R. Arandjelovic, A. Zisserman, CVPR 2012 (RootSIFT).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris_laplace import ScaledCorners
from harris_perception.core.image.sampling import sampled
from icu_common.core.configuration.config import Config, ConfigError, setting

F32 = npt.NDArray[np.float32]

_EMPTY_PAIRS = np.empty((0, 2), np.int64)
_ROWS = 256
_DISC_PX = 15
"""Radius of the disc that determines a corner's direction, as in ORB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchConfig(Config):
    """Settings of descriptors and of the acceptance of matches."""

    descriptor: str = setting(
        "sift",
        "Descriptor: patch is a square of normalised grey values, orb is ORB, sift is RootSIFT",
        choices=("patch", "orb", "sift"),
    )
    patch_px: int = setting(15, "Side of the patch (odd)", minimum=5, maximum=63, unit="px")
    size_px: float = setting(
        6.0, "Size of SIFT's keypoints; a descriptor covers six times as much", minimum=2.0, maximum=100.0, unit="px"
    )
    oriented: bool = setting(True, "Rotate ORB and SIFT descriptors to the direction of the intensity centroid")
    mutual: bool = setting(True, "Require that each corner is the other's best match")
    ratio: float = setting(
        0.85,
        "Maximum distance to the best match, as a fraction of the distance to the best match at another position",
        minimum=0.1,
        maximum=1.0,
    )
    elsewhere_px: float = setting(
        8.0,
        "Distance below which two matches count as the same position for the ratio",
        minimum=0.0,
        maximum=1000.0,
        unit="px",
    )
    geometry: str = setting(
        "homography", "Model that all matches must agree with", choices=("none", "epipolar", "homography")
    )
    tolerance_px: float = setting(
        3.0,
        "Maximum deviation of a match from the model; Sampson distance for epipolar geometry",
        minimum=0.1,
        maximum=50.0,
        unit="px",
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.patch_px % 2 == 0:
            raise ConfigError(f"patch_px = {self.patch_px}; expected an odd number")


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """Corners with descriptors.

    Attributes
    ----------
    xy
        (N, 2) px; corners too near to the image border for a descriptor are omitted.
    index
        (N,) their indices among the given corners.
    vectors
        (N, D) float32 of unit length (patch, sift) or uint8 bits (orb).
    """

    xy: F32
    index: npt.NDArray[np.int64]
    vectors: npt.NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """Matches of two sets of corners.

    Attributes
    ----------
    pairs
        (M, 2) indices into the given corners of the first and the second image.
    model
        (3, 3) homography second_from_first or fundamental matrix; None without geometry, or if none was found.
    tentative
        Number of matches before the geometric check.
    """

    pairs: npt.NDArray[np.int64]
    model: npt.NDArray[np.float64] | None
    tentative: int


def orientations_deg(gray: npt.NDArray[np.uint8], xy: npt.ArrayLike) -> F32:
    """Return the direction from each corner to the intensity centroid of a disc, (N,) degrees in 0 to 360, y down."""
    points = np.asarray(xy, np.float32).reshape(1, -1, 2)
    if points.size == 0:
        return np.empty(0, np.float32)
    y, x = np.mgrid[-_DISC_PX : _DISC_PX + 1, -_DISC_PX : _DISC_PX + 1]
    disc = (x * x + y * y <= _DISC_PX * _DISC_PX).astype(np.float32)
    moments = [
        cv2.filter2D(gray.astype(np.float32), cv2.CV_32F, disc * weight, borderType=cv2.BORDER_REPLICATE)
        for weight in (x.astype(np.float32), y.astype(np.float32))
    ]
    at = points[..., 0], points[..., 1]
    mx, my = (sampled(m, *at)[0] for m in moments)
    return np.asarray(np.rad2deg(np.arctan2(my, mx)) % 360.0, np.float32)


def describe(gray: npt.NDArray[np.uint8], xy: npt.ArrayLike, config: MatchConfig) -> Described:
    """Describe the corners ``xy`` (N, 2) px of a grey image (H, W) uint8.

    Raises
    ------
    ValueError
        For another shape or dtype.
    """
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise ValueError(f"expected a grey picture (H, W) uint8, got {gray.shape} {gray.dtype}")
    points = np.asarray(xy, np.float32).reshape(-1, 2)
    if config.descriptor == "patch":
        return _patches(gray, points, config.patch_px)
    angles = orientations_deg(gray, points) if config.oriented else np.zeros(len(points), np.float32)
    # OpenCV drops and reorders keypoints; class_id carries the index.
    keypoints = [
        cv2.KeyPoint(float(x), float(y), config.size_px, float(angle), 1.0, 0, i)
        for i, ((x, y), angle) in enumerate(zip(points, angles))
    ]
    extractor: Any = cv2.ORB_create() if config.descriptor == "orb" else cv2.SIFT_create()  # type: ignore[attr-defined]
    kept, vectors = extractor.compute(gray, keypoints) if keypoints else ((), None)
    index = np.array([k.class_id for k in kept], np.int64)
    if vectors is None or len(index) == 0:
        return Described(points[:0], index[:0], np.empty((0, 1), np.float32))
    if config.descriptor == "sift":
        vectors = np.sqrt(vectors / np.maximum(vectors.sum(axis=1, keepdims=True), 1e-9))
    return Described(points[index], index, vectors)


def describe_over_scales(gray: npt.NDArray[np.uint8], corners: ScaledCorners, config: MatchConfig) -> Described:
    """Describe each corner on the image reduced by its scale, so that descriptors cover the same part of the scene."""
    parts, places = [], []
    for scale in np.unique(corners.scale):
        index = np.nonzero(corners.scale == scale)[0]
        size = tuple(max(round(side / float(scale)), 1) for side in gray.shape[::-1])
        level = cv2.resize(gray, size, interpolation=cv2.INTER_AREA) if scale != 1.0 else gray
        ratio = np.array(size, np.float32) / np.array(gray.shape[::-1], np.float32)
        part = describe(np.asarray(level, np.uint8), (corners.xy[index] + 0.5) * ratio - 0.5, config)
        if len(part.xy) > 0:
            parts.append(part.vectors)
            places.append(index[part.index])
    if not parts:
        return Described(np.empty((0, 2), np.float32), np.empty(0, np.int64), np.empty((0, 1), np.float32))
    place = np.concatenate(places)
    return Described(corners.xy[place], place, np.concatenate(parts))


def _patches(gray: npt.NDArray[np.uint8], points: F32, side: int) -> Described:
    half = side // 2
    limit = np.array(gray.shape[::-1], np.float32) - 1 - half
    index = np.nonzero(((points >= half) & (points <= limit)).all(axis=1))[0]
    if len(index) == 0:
        return Described(points[:0], index, np.empty((0, side * side), np.float32))
    dy, dx = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, 1, -1).astype(np.float32)
    at = points[index]
    values = sampled(gray.astype(np.float32), at[:, :1] + dx, at[:, 1:] + dy)
    values = values - values.mean(axis=1, keepdims=True)
    length = np.linalg.norm(values, axis=1)
    good = length > 1e-3
    return Described(at[good], index[good], values[good] / length[good, None])


def match(first: Described, second: Described, config: MatchConfig) -> Matches:
    """Return the matches that pass the checks; the geometric check uses the same random samples each time."""
    if len(first.xy) == 0 or len(second.xy) == 0:
        return Matches(_EMPTY_PAIRS, None, 0)
    count = len(first.xy)
    best, nearest, other = np.empty(count, np.int64), np.empty(count, np.float32), np.empty(count, np.float32)
    back, least = np.zeros(len(second.xy), np.int64), np.full(len(second.xy), np.inf, np.float32)
    for start in range(0, count, _ROWS):  # all distances at once would need 12 bytes per pair: gigabytes
        part = slice(start, start + _ROWS)
        distance = _distances(first.vectors[part], second.vectors)
        best[part], nearest[part] = distance.argmin(axis=1), distance.min(axis=1)
        closer = distance.min(axis=0) < least
        back[closer] = start + distance.argmin(axis=0)[closer]
        least = np.minimum(least, distance.min(axis=0))
        x, y = (second.xy[best[part], i, None] - second.xy[None, :, i] for i in range(2))
        elsewhere = x * x + y * y > config.elsewhere_px**2
        other[part] = distance.min(axis=1, where=elsewhere, initial=np.inf)
    rows = np.arange(count)
    good = np.ones(count, bool)
    if config.mutual:
        good &= back[best] == rows
    if config.ratio < 1.0:
        good &= nearest < config.ratio * other
    pairs = np.column_stack((rows, best))[good]
    inliers, model = _agreeing(first.xy[pairs[:, 0]], second.xy[pairs[:, 1]], config)
    kept = pairs[inliers]
    return Matches(np.column_stack((first.index[kept[:, 0]], second.index[kept[:, 1]])), model, len(pairs))


def _distances(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> F32:
    if a.dtype == np.uint8:  # Hamming distance: bits set in one and not in the other, both ways
        bits_a, bits_b = (np.unpackbits(v, axis=1).astype(np.float32) for v in (a, b))
        return np.asarray(bits_a @ (1.0 - bits_b).T + (1.0 - bits_a) @ bits_b.T, np.float32)
    return np.asarray(np.sqrt(np.maximum(2.0 - 2.0 * (a @ b.T), 0.0)), np.float32)


def _agreeing(a: F32, b: F32, config: MatchConfig) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.float64] | None]:
    least = {"none": 0, "homography": 4, "epipolar": 8}[config.geometry]
    if config.geometry == "none":
        return np.ones(len(a), bool), None
    if len(a) < least:
        return np.zeros(len(a), bool), None
    if config.geometry == "homography":
        model, mask = cv2.findHomography(a, b, cv2.USAC_MAGSAC, config.tolerance_px, maxIters=5000, confidence=0.999)
    else:
        try:
            model, mask = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, config.tolerance_px, 0.999, 5000)
        except cv2.error:  # for some degenerate points it raises instead of returning none
            model, mask = None, None
    if model is None or mask is None or model.shape != (3, 3):
        return np.zeros(len(a), bool), None
    return mask.ravel().astype(bool), np.asarray(model, np.float64)
