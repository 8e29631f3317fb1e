"""Repeatability of interest points between images related by a known homography, and warps for measuring it.

Source: C. Schmid, R. Mohr, C. Bauckhage, "Evaluation of Interest Point Detectors", IJCV 37(2), 2000. Points are paired
one to one, nearest first; the rate is divided by the smaller count in the common part. The rate of the same points
after a shift is the rate by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.harris_laplace import HarrisLaplaceConfig, HarrisLaplaceDetector
from harris_perception.core.corners.repeatable import RepeatableConfig, RepeatableDetector

Gray = npt.NDArray[np.uint8]
Points = npt.NDArray[Any]
Detect = Callable[[Gray, int], Points]
"""From a grey image and a count to (N, 2) px, the strongest first, at most that many."""

EPSILONS_PX = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0)
_EDGE_PX = 5.0  # nearer to an image border, some detectors' kernels cut points off and others' do not
_SHIFT_PX = np.array([23.0, 17.0])

WARPS: dict[str, tuple[float, ...]] = {
    "rotation": (15.0, 30.0, 45.0, 60.0, 90.0, 135.0, 180.0),
    "scale": (1.2, 1.5, 2.0, 2.5, 3.0),
    "light": (0.3, 0.5, 0.7, 1.4, 0.0),
    "viewpoint": (15.0, 30.0, 45.0, 55.0),
    "noise": (2.0, 5.0, 10.0, 20.0),
}
"""Kinds and amounts of change of ``warps``: degrees, reduction factor, gain (0: a ramp), degrees, grey levels."""


# OpenCV 5 moved these detectors to its contributed modules. The thresholds are low enough for the wanted count.
_FURTHER_PEERS: dict[str, dict[str, Any]] = {
    "AKAZE": {"threshold": 1e-6},
    "KAZE": {"threshold": 1e-6},
    "BRISK": {"thresh": 10},
    "HarrisLaplaceFeatureDetector": {"corn_thresh": 1e-4, "maxCorners": 20000},
}


@dataclass(frozen=True, slots=True)
class Rate:
    """Repeatability for each epsilon, the rate by chance, and the smaller count in the common part."""

    rates: tuple[float, ...]
    chance: tuple[float, ...]
    count: int


@dataclass(frozen=True, slots=True)
class HomographyPair:
    """Two images, second_from_first (3, 3), and kind and amount of the change between them."""

    change: str
    amount: float
    first: Gray
    second: Gray
    homography: npt.NDArray[np.float64]


def mapped(points: Points, homography: npt.NDArray[Any]) -> Points:
    """Map (N, 2) px by a homography (3, 3) of any scale; points at infinity are not finite."""
    # OpenCV treats values below 1e-7 as zero, even if the whole homography is that small.
    places = np.asarray(points, np.float64).reshape(-1, 2)
    ends = np.column_stack((places, np.ones(len(places)))) @ np.asarray(homography, np.float64).T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(ends[:, :2] / ends[:, 2:])


def repeatability(
    pair: HomographyPair, first: Points, second: Points, epsilons_px: Sequence[float] = EPSILONS_PX
) -> Rate:
    """Return the repeatability of the points (N, 2), (M, 2) of a pair's images."""
    ahead = mapped(first, pair.homography)
    back = mapped(second, np.linalg.inv(pair.homography))
    a = ahead[_inside(ahead, pair.second) & _inside(first, pair.first)]
    b = np.asarray(second, np.float64)[_inside(back, pair.first) & _inside(second, pair.second)]
    count = min(len(a), len(b))
    if count == 0:
        return Rate((0.0,) * len(epsilons_px), (0.0,) * len(epsilons_px), 0)
    shifted = _shifted(first, pair.first)
    moved = mapped(shifted, pair.homography)
    moved = moved[_inside(moved, pair.second)]
    found, by_chance = (_paired_distances(p, b, max(epsilons_px)) for p in (a, moved))
    return Rate(
        tuple(float((found <= e).sum() / count) for e in epsilons_px),
        tuple(float((by_chance <= e).sum() / count) for e in epsilons_px),
        count,
    )


def _inside(points: Points, picture: Gray) -> npt.NDArray[np.bool_]:
    limit = np.array(picture.shape[::-1]) - 1 - _EDGE_PX
    return np.asarray(((points >= _EDGE_PX) & (points <= limit)).all(axis=1))


def _shifted(points: Points, picture: Gray) -> Points:
    """Return the points inside after a shift that wraps around the image, so that none is lost."""
    inner = np.array(picture.shape[::-1]) - 1 - 2 * _EDGE_PX
    kept = np.asarray(points, np.float64)[_inside(points, picture)]
    return np.asarray(_EDGE_PX + (kept - _EDGE_PX + _SHIFT_PX) % inner)


def _paired_distances(a: Points, b: Points, farthest: float) -> npt.NDArray[np.float64]:
    """Pair nearest first, one to one. The order does not depend on epsilon, so the pairs of a smaller one are a
    prefix."""
    by_x = np.argsort(b[:, 0], kind="stable")
    low = np.searchsorted(b[by_x, 0], a[:, 0] - farthest, "left")
    counts = np.searchsorted(b[by_x, 0], a[:, 0] + farthest, "right") - low
    rows = np.repeat(np.arange(len(a)), counts)  # all that are near enough in x
    columns = by_x[np.arange(len(rows)) + np.repeat(low - (np.cumsum(counts) - counts), counts)]
    values = np.linalg.norm(a[rows] - b[columns], axis=1)
    near = values <= farthest
    rows, columns, values = rows[near], columns[near], values[near]
    free_a, free_b = np.ones(len(a), bool), np.ones(len(b), bool)
    taken = []
    for k in np.lexsort((columns, rows, values)):
        i, j = rows[k], columns[k]
        if free_a[i] and free_b[j]:
            free_a[i] = free_b[j] = False
            taken.append(values[k])
    return np.array(taken)


def means(rows: Sequence[Mapping[str, Any]], key: str) -> dict[tuple[str, str], float]:
    """Return the mean of a column of result rows for each change and detector."""
    values: dict[tuple[str, str], list[float]] = {}
    for row in rows:
        values.setdefault((row["change"], row["detector"]), []).append(row[key])
    return {place: float(np.mean(each)) for place, each in values.items()}


def best_on_average(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """Return the detector with the highest mean rate, with equal weight for every kind of change."""
    rates = means(rows, "repeatability")
    changes = {change for change, _ in rates}
    return max(names, key=lambda name: sum(rates[change, name] for change in changes))


def warps(photograph: Gray, rng: np.random.Generator, *, noise: float = 2.0) -> Iterator[HomographyPair]:
    """Yield pairs of a photograph (H, W) with itself rotated, scaled, relit, tilted and with noise.

    Each image gets its own noise (grey levels), so that no points repeat only because bytes are equal.
    """
    height, width = photograph.shape
    centre = ((width - 1) / 2, (height - 1) / 2)

    def pair(
        change: str, amount: float, h: npt.NDArray[Any], relight: Callable[[Any], Any], sigma: float
    ) -> HomographyPair:
        seen = cv2.warpPerspective(
            photograph, h, (width, height), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REPLICATE
        )
        noisy = [
            np.clip(p + rng.normal(0, s, p.shape), 0, 255).astype(np.uint8)
            for p, s in ((photograph.astype(np.float64), noise), (relight(seen.astype(np.float64)), sigma))
        ]
        return HomographyPair(change, amount, noisy[0], noisy[1], h)

    def same(p: Any) -> Any:
        return p

    for angle in WARPS["rotation"]:
        yield pair("rotation", angle, _similar(centre, angle, 1.0), same, noise)
    for scale in WARPS["scale"]:
        # Blur before reducing, or the small image aliases.
        soft = cv2.GaussianBlur(photograph, (0, 0), 0.5 * np.sqrt(scale * scale - 1.0))
        h = _similar(centre, 0.0, 1.0 / scale)
        small = cv2.warpPerspective(soft, h, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        noisy = [np.clip(p + rng.normal(0, noise, p.shape), 0, 255).astype(np.uint8) for p in (photograph, small)]
        yield HomographyPair("scale", scale, noisy[0], noisy[1], h)
    ramp = np.linspace(0.4, 1.3, width)[None]
    for gain in WARPS["light"]:
        yield pair("light", gain, np.eye(3), partial(np.multiply, gain or ramp), noise)
    for tilt in WARPS["viewpoint"]:
        yield pair("viewpoint", tilt, _tilted(width, height, tilt), same, noise)
    for sigma in WARPS["noise"]:
        yield pair("noise", sigma, np.eye(3), same, sigma)


def _similar(centre: tuple[float, float], angle_deg: float, scale: float) -> npt.NDArray[np.float64]:
    return np.vstack((cv2.getRotationMatrix2D(centre, angle_deg, scale), (0.0, 0.0, 1.0)))


def _tilted(width: int, height: int, angle_deg: float) -> npt.NDArray[np.float64]:
    """Return the view of a plane rotated about its vertical axis, from a distance of 1.5 widths."""
    f, t = 1.5 * width, np.deg2rad(angle_deg)
    k = np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])
    plane = np.array([[np.cos(t), 0.0, 0.0], [0.0, 1.0, 0.0], [np.sin(t), 0.0, 1.0]])
    return np.asarray(k @ plane @ np.linalg.inv(k))


def our_detectors() -> dict[str, Detect]:
    """Return variants of this detector by name."""
    variants: dict[str, dict[str, Any]] = {
        "harris 1988 (default)": {},
        "impharris 1 / 2": {"gradient": "gaussian", "window": "gaussian", "k": 0.06},
        "impharris 0.7 / 1.5": {
            "gradient": "gaussian",
            "window": "gaussian",
            "sigma_d_px": 0.7,
            "sigma_i_px": 1.5,
            "k": 0.06,
        },
        "shi-tomasi 1 / 2": {"gradient": "gaussian", "window": "gaussian", "response": "shi_tomasi"},
    }

    def make(settings: dict[str, Any]) -> Detect:
        def detect(gray: Gray, count: int) -> Points:
            config = HarrisConfig(max_corners=count, relative_threshold=0.0, **settings)
            return HarrisDetector(config).detect(gray).xy

        return detect

    def over_scales(gray: Gray, count: int) -> Points:
        detector = HarrisConfig(max_corners=count, relative_threshold=0.0, **variants["impharris 1 / 2"])
        return HarrisLaplaceDetector(HarrisLaplaceConfig(detector=detector)).detect(gray).xy[:count]

    def above_noise(gray: Gray, count: int) -> Points:
        return RepeatableDetector(RepeatableConfig(max_corners=count)).detect(gray).xy

    several = {"harris-laplace 1 / 2": over_scales, "repeatable": above_noise}
    return {name: make(settings) for name, settings in variants.items()} | several


def peer_detectors() -> dict[str, Detect]:
    """Return the detectors of the installed OpenCV, and scikit-image's if it is installed."""

    def good_features(harris: bool) -> Detect:
        def detect(gray: Gray, count: int) -> Points:
            found = cv2.goodFeaturesToTrack(gray, count, 1e-9, 0, blockSize=3, useHarrisDetector=harris, k=0.04)
            return np.empty((0, 2)) if found is None else found.reshape(-1, 2)

        return detect

    def keypoints(make: Callable[[int], Any]) -> Detect:
        def detect(gray: Gray, count: int) -> Points:
            found = sorted(make(count).detect(gray), key=lambda k: -k.response)
            places = dict.fromkeys((round(k.pt[0], 2), round(k.pt[1], 2)) for k in found)  # several scales
            return np.array(list(places)[:count], np.float64).reshape(-1, 2)

        return detect

    def further(create: Callable[..., Any], settings: dict[str, Any]) -> Detect:
        return keypoints(lambda count: create(**settings))

    api: Any = cv2
    peers: dict[str, Detect] = {
        "cv2 Harris": good_features(True),
        "cv2 Shi-Tomasi": good_features(False),
        "cv2 FAST": keypoints(lambda count: api.FastFeatureDetector_create(5)),
        "cv2 ORB": keypoints(lambda count: api.ORB_create(count)),
        "cv2 SIFT": keypoints(lambda count: api.SIFT_create(count)),
    }
    contrib = getattr(api, "xfeatures2d", None)
    for name, settings in _FURTHER_PEERS.items():
        create = getattr(api, f"{name}_create", getattr(contrib, f"{name}_create", None))
        if create is not None:
            peers[f"cv2 {name.removesuffix('FeatureDetector')}"] = further(create, settings)
    if find_spec("skimage") is None:
        return peers

    def skimage(gray: Gray, count: int) -> Points:
        from skimage.feature import corner_harris, corner_peaks  # import takes a second, and not all callers use it

        peaks = corner_peaks(corner_harris(gray, sigma=1), min_distance=1, threshold_rel=0.0, num_peaks=count)
        return np.asarray(peaks[:, ::-1], np.float64)

    return peers | {"skimage Harris": skimage}
