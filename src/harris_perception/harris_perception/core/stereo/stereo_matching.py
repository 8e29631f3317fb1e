"""Matches Harris corners of a rectified pair and measures their disparity to a fraction of a pixel.

A left corner is compared with the right corners near its row by zero-mean normalised cross-correlation. A mutual best
match is kept if it is clearly better than the best match at another position and agrees with its neighbours. The
disparity is then refined (``match_windows``). The window's slant is a free parameter, since an instrument's panel is
seldom parallel to the cameras.

Unmatched corners are searched again with small windows. Then all matches are rated (``match_rating``).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.stereo import stereo_kernels as kernels
from harris_perception.core.stereo.depth_range import DepthRange
from harris_perception.core.stereo.match_rating import agreeing, probability
from harris_perception.core.stereo.match_windows import F32, normalised, refined, windows_at
from harris_perception.core.stereo.matches import StereoMatches
from icu_common.core.configuration.config import ConfigError, setting
from icu_common.core.geometry.camera_model import StereoModel

Gray = npt.NDArray[np.uint8]

_NOISE = 0.02
"""Loss of correlation by noise, added to both terms of the ratio; without it noise decides between equal matches."""
_FLOOR_PX = 0.06
"""Error by rectification and interpolation besides noise (rendered panels: 0.07 px measured, 0.025 by noise)."""
_SEARCH = 8
"""Columns around the expected position in which a corner without partner is searched."""
_SMALL_PASSES = ((3.0, 0.4), (np.inf, 0.5))
"""Range beyond the neighbours' disparities that is searched, and minimum correlation: first near the neighbours, then
along the whole row. The probability decides later, for all matches alike."""
_SMALL_HALF = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class StereoMatchConfig(DepthRange):
    """Settings of the matcher."""

    row_tolerance_px: float = setting(
        1.5, "Maximum difference between the rectified rows of a match", minimum=0.1, maximum=10.0, unit="px"
    )
    window_px: int = setting(11, "Side of the compared windows (odd)", minimum=5, maximum=31, unit="px")
    min_correlation: float = setting(0.7, "Minimum correlation of a match", minimum=0.0, maximum=1.0)
    max_ratio: float = setting(
        0.8,
        "Maximum ratio (1 - best) / (1 - next) of the correlations, where next is at another position; 1: all "
        "are accepted",
        minimum=0.05,
        maximum=1.0,
    )
    min_agreeing: int = setting(
        3, "Minimum number of the eight nearest matches that must have a consistent disparity", minimum=0, maximum=8
    )
    max_slope: float = setting(
        0.2,
        "Maximum disparity difference between consistent neighbours per pixel of distance, in addition to 1 px",
        minimum=0.0,
        maximum=5.0,
    )
    guided: bool = setting(
        True,
        "Also search the right image for partners of unmatched corners: near the neighbours' disparity, then "
        "along the row",
    )
    min_probability: float = setting(
        0.6,
        "Minimum probability that a match is correct; a larger value gives fewer matches and fewer wrong ones",
        minimum=0.0,
        maximum=1.0,
    )

    def __post_init__(self) -> None:
        DepthRange.__post_init__(self)
        if self.window_px % 2 == 0:
            raise ConfigError(f"window_px = {self.window_px}; expected an odd number")


def disparity_range(stereo: StereoModel, config: StereoMatchConfig) -> tuple[float, float]:
    """Return the minimum and maximum column difference, in rectified pixels, for the depth limits."""
    shift = float(stereo.left.p[0, 2] - stereo.right.p[0, 2])
    product = stereo.focal_px * stereo.baseline
    return product / config.max_depth_m + shift, product / config.min_depth_m + shift


def match_corners(
    left: Gray,
    right: Gray,
    left_px: npt.ArrayLike,
    right_px: npt.ArrayLike,
    disparity_limits_px: tuple[float, float],
    config: StereoMatchConfig,
) -> StereoMatches:
    """Match corners of a rectified pair.

    Parameters
    ----------
    left, right
        (H, W) uint8 rectified grey images.
    left_px, right_px
        (N, 2) and (M, 2) corners in rectified pixels.
    disparity_limits_px
        Minimum and maximum disparity.
    config
        Limits of a match.

    Raises
    ------
    ValueError
        If the images differ in size.
    """
    if left.shape != right.shape:
        raise ValueError(f"rectified pictures of {left.shape} and {right.shape} px; expected two of one size")
    half = config.window_px // 2
    left_fine, right_fine = left.astype(np.float32), right.astype(np.float32)
    left_place, left_at = _inside(left_px, left, half + 2)
    right_place, right_at = _inside(right_px, right, half + 2)
    order = np.argsort(right_at[:, 1], kind="stable")
    right_place, right_at = right_place[order], right_at[order]
    low, high = disparity_limits_px
    best, score, after = kernels.best_partners(
        normalised(windows_at(left_fine, left_at, half)),
        normalised(windows_at(right_fine, right_at, half)),
        left_at,
        right_at,
        config.row_tolerance_px,
        low,
        high,
    )
    distinct = (1 - score + _NOISE) <= config.max_ratio * (1 - after + _NOISE)
    chosen = np.flatnonzero((best >= 0) & (score >= config.min_correlation) & distinct)
    rough = left_at[chosen, 0] - right_at[best[chosen], 0]
    if config.min_agreeing:
        at = left_at[chosen]
        agree = agreeing(at, rough, at, rough, config.max_slope) >= config.min_agreeing
        chosen, rough = chosen[agree], rough[agree]
    if config.guided:
        # A corner with several equal partners stays undecided: its neighbours may have been misled by the same pattern.
        rest = np.setdiff1d(np.flatnonzero(distinct | (score < config.min_correlation)), chosen)
        which, more, correlation = _guided(left_fine, right_fine, left_at[rest], left_at[chosen], rough, half, config)
        best[rest[which]], score[rest[which]] = -1, correlation
        chosen, rough = np.r_[chosen, rest[which]], np.r_[rough, more]
    disparity, sigma = refined(left_fine, right_fine, left_at[chosen], rough.astype(np.float64), half)
    # A window that moves by more than its corner's own uncertainty follows something else; NaN also fails here.
    steady = (np.abs(disparity - rough) < 1.5) & (disparity >= low) & (disparity <= high)
    chosen = chosen[steady]
    partner = np.where(best[chosen] < 0, -1, right_place[best[chosen]]) if len(right_place) else best[chosen]
    matches = StereoMatches(
        left_px=left_at[chosen].astype(np.float64),
        disparity_px=disparity[steady],
        sigma_px=np.hypot(sigma[steady], _FLOOR_PX),
        correlation=score[chosen].astype(np.float64),
        index=np.column_stack([left_place[chosen], partner]),
    )
    corners = np.asarray(left_px, np.float32).reshape(-1, 2)
    undecided = left_place[~distinct & (score >= config.min_correlation)]
    for reach_px, least in _SMALL_PASSES if config.guided else ():
        matches = _with_small_windows(matches, left_fine, right_fine, corners, undecided, (low, high), reach_px, least)
    return matches.only(probability(left_fine, right_fine, matches) >= config.min_probability)


def warm() -> None:
    """Compile the code that a pair needs, or load it from the cache, so that the first pair is not late."""
    rng = np.random.default_rng(0)
    picture = np.asarray(cv2.GaussianBlur(rng.integers(0, 256, (96, 200), np.uint8), (0, 0), 1.0), np.uint8)
    left, right = picture[:, :160], picture[:, 20:180].copy()
    right[:, 100:] = right[::-1, 100:]  # unmatched corners exercise all searches
    at = rng.uniform((45, 15), (145, 80), (120, 2)).astype(np.float32)
    match_corners(left, right, at, at[::2] - (20, 0), (1.0, 32.0), StereoMatchConfig())


def _inside(points: npt.ArrayLike, picture: Gray, margin: int) -> tuple[npt.NDArray[np.intp], F32]:
    """Return the indices and positions (N, 2) of the points that keep a margin to the image border."""
    at = np.asarray(points, np.float32).reshape(-1, 2)
    x, y = at.T
    height, width = picture.shape
    place = np.flatnonzero((x >= margin) & (y >= margin) & (x < width - margin) & (y < height - margin))
    return place, at[place]


def _guided(
    left: F32, right: F32, at: F32, matched: F32, disparity: F32, half: int, config: StereoMatchConfig
) -> tuple[npt.NDArray[np.intp], F32, F32]:
    """Search the right image for corners that were found only in the left one, near their neighbours' disparity.

    Returns
    -------
    which, disparity_px, correlation
        Row numbers of ``at`` for which a partner was found, and its values.
    """
    nothing = np.empty(0, np.intp), np.empty(0, np.float32), np.empty(0, np.float32)
    if len(matched) < 8 or not len(at):
        return nothing
    expected = np.median(disparity[kernels.nearest(at, matched)[:, :5]], axis=1)
    which = np.flatnonzero(at[:, 0] - expected > half + _SEARCH + 2)
    at, column = at[which], np.round(at[which, 0] - expected[which]).astype(np.float32)
    there = np.column_stack([column, at[:, 1]])
    score = kernels.slid(normalised(windows_at(left, at, half)), windows_at(right, there, half, _SEARCH), half)
    best = np.argmax(score, axis=1)
    rows = np.arange(len(at))
    top = score[rows, best]
    places = np.arange(2 * _SEARCH + 1)
    other = np.where(np.abs(places - best[:, None]) > 2, score, -1.0).max(axis=1)
    found = column + best - _SEARCH
    # The search back must lead to the same corner again.
    seen = normalised(windows_at(right, np.column_stack([found, at[:, 1]]), half))
    back = kernels.slid(seen, windows_at(left, at, half, _SEARCH), half)
    good = (np.abs(np.argmax(back, axis=1) - _SEARCH) <= 1) & (top >= config.min_correlation)
    good &= ((1 - top + _NOISE) <= config.max_ratio * (1 - other + _NOISE)) & (best > 0) & (best < 2 * _SEARCH)
    offset = at[:, 0] - found
    if config.min_agreeing:
        good &= agreeing(at, offset, matched, disparity, config.max_slope) >= config.min_agreeing
    return which[good], offset[good], top[good].astype(np.float32)


def _with_small_windows(
    matches: StereoMatches,
    left: F32,
    right: F32,
    corners: F32,
    undecided: npt.NDArray[np.intp],
    limits_px: tuple[float, float],
    reach_px: float,
    least: float,
) -> StereoMatches:
    """Search corners without a match by small windows along the row, in both directions.

    Small windows contain a depth edge less often, and reach nearer to the image border.
    """
    rest = np.setdiff1d(np.arange(len(corners)), np.r_[matches.index[:, 0], undecided])
    matched, disparity = matches.left_px.astype(np.float32), matches.disparity_px.astype(np.float32)
    if len(matched) < 8 or not len(rest):
        return matches
    at = corners[rest]
    near = disparity[kernels.nearest(at, matched)]
    low = np.floor(np.maximum(near.min(axis=1) - reach_px, limits_px[0])).astype(np.int64)
    high = np.ceil(np.minimum(near.max(axis=1) + reach_px, limits_px[1])).astype(np.int64)
    rough, score = kernels.along_rows(left, right, at, low, high, _SMALL_HALF, least)
    found = np.flatnonzero(np.isfinite(rough))
    rest, at, rough, score = rest[found], at[found], rough[found], score[found]
    better, sigma = refined(left, right, at, rough.astype(np.float64), _SMALL_HALF)
    steady = (np.abs(better - rough) < 1.0) & (better >= limits_px[0]) & (better <= limits_px[1])
    index = np.column_stack([rest, np.full(len(rest), -1)])[steady]
    return StereoMatches(
        left_px=np.r_[matches.left_px, at[steady].astype(np.float64)],
        disparity_px=np.r_[matches.disparity_px, better[steady]],
        sigma_px=np.r_[matches.sigma_px, np.hypot(sigma[steady], _FLOOR_PX)],
        correlation=np.r_[matches.correlation, score[steady].astype(np.float64)],
        index=np.r_[matches.index, index],
    )
