"""Disparity of every pixel of a rectified pair by semi-global matching, and the resulting points in metres.

H. Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual Information", PAMI 30(2), 2008, in OpenCV's form
with three paths. Three things are added. The images are widened to the left, because OpenCV gives no result for columns
nearer to the left edge than the largest disparity searched. Results whose partner lies outside the right image are
removed again. The search may start at any disparity, without cost for columns that are visible in one image only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.image.compiled import called, compiled
from harris_perception.core.stereo.depth_range import DepthRange
from icu_common.core.configuration.config import Config, ConfigError, setting
from icu_common.core.geometry.camera_model import StereoModel

U8 = npt.NDArray[np.uint8]
F32 = npt.NDArray[np.float32]

DELTA_PX = 1 / 16
"""Resolution of OpenCV's matcher: a sixteenth of a pixel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SemiGlobalConfig(Config):
    """Settings of the matcher; the defaults are for 8-bit grey images."""

    block_px: int = setting(3, "Side of the compared blocks (odd)", minimum=1, maximum=11, unit="px")
    p1: int = setting(72, "Penalty for a disparity change of 1 px between neighbours", minimum=1, maximum=5000)
    p2: int = setting(288, "Penalty for a larger disparity change; must be above p1", minimum=2, maximum=10000)
    prefilter_cap: int = setting(31, "Limit at which horizontal gradients are clipped", minimum=1, maximum=63)
    uniqueness_percent: int = setting(
        5, "Minimum margin by which the best disparity must be better than any other", minimum=0, maximum=50, unit="%"
    )
    left_right_px: int = setting(
        1,
        "Maximum difference between the disparities computed from left to right and from right to left",
        minimum=1,
        maximum=64,
        unit="px",
    )
    speckle_px: int = setting(
        100,
        "Minimum size, in pixels, of a connected patch; smaller ones are removed; 0: none is removed",
        minimum=0,
        maximum=10000,
    )
    speckle_range_px: int = setting(
        2, "Maximum difference between neighbours of the same patch", minimum=1, maximum=32, unit="px"
    )
    refine: bool = setting(True, "Refine the subpixel disparity with one Lucas-Kanade step")
    fill_holes: bool = setting(False, "Fill unknown pixels with the farther neighbour in the row")

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.block_px % 2 == 0:
            raise ConfigError(f"block_px = {self.block_px}; expected an odd number")
        if self.p2 <= self.p1:
            raise ConfigError(f"p2 = {self.p2} is not above p1 = {self.p1}")


class SemiGlobalMatcher:
    """Computes the disparity of every pixel.

    Parameters
    ----------
    low_px, high_px
        Disparities to search, left column minus right column; the range is widened to a multiple of 16.
    config
        Settings of the matcher.

    Attributes
    ----------
    least_px, count
        The search covers ``least_px`` to ``least_px + count - 1``. Neither end is returned as a result, because a cost
        that is smallest at the end of the search is no minimum (blank walls give such costs).

    Raises
    ------
    ValueError
        If ``low_px`` is above ``high_px``.
    """

    def __init__(self, low_px: float, high_px: float, config: SemiGlobalConfig) -> None:
        if not low_px <= high_px:
            raise ValueError(f"disparities from {low_px} to {high_px} px: the first must not be above the second")
        self.least_px = math.floor(low_px) - 1
        self.count = 16 * math.ceil((math.ceil(high_px) + 1 - self.least_px + 1) / 16)
        self._refine, self._fill = config.refine, config.fill_holes
        self._matcher = cv2.StereoSGBM_create(  # type: ignore[attr-defined]
            minDisparity=0,
            numDisparities=self.count,
            blockSize=config.block_px,
            P1=config.p1,
            P2=config.p2,
            disp12MaxDiff=config.left_right_px,
            preFilterCap=config.prefilter_cap,
            uniquenessRatio=config.uniqueness_percent,
            speckleWindowSize=config.speckle_px,
            speckleRange=config.speckle_range_px,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )

    def __call__(self, left: U8, right: U8) -> F32:
        """Return (H, W) float32 disparities in pixels, NaN where unknown, of (H, W) uint8 rectified images.

        Raises
        ------
        ValueError
            If the images differ in size, are not 8 bits deep, or are not wider than the least disparity.
        """
        if left.shape != right.shape or left.ndim != 2 or left.dtype != np.uint8 or right.dtype != np.uint8:
            raise ValueError(f"{left.shape} {left.dtype} and {right.shape} {right.dtype}: two equal (H, W) uint8")
        width = left.shape[1]
        if width <= self.least_px:
            raise ValueError(f"pictures {width} px wide cannot show a disparity of {self.least_px} px or more")
        # Columns left of `first` have no partner in the right image. The right image is shifted by the least disparity,
        # so that the search starts at 0, and both images get `count` more columns on the left.
        first = max(self.least_px, 0)
        columns = np.arange(first - self.count, width)
        wide_left = np.take(left, columns.clip(0), axis=1)
        wide_right = np.take(right, (columns - self.least_px).clip(0, width - 1), axis=1)
        found = self._matcher.compute(wide_left, wide_right)[:, self.count :]
        disparity = np.full(left.shape, np.nan, np.float32)
        _accept(np.asarray(found, np.int16), first, self.least_px, self.count, disparity)
        if self._refine:
            disparity = refined(left, right, disparity)
        if self._fill:
            fill_holes(disparity)
        return disparity


@compiled
def _accept(found: npt.NDArray[np.int16], first: int, least_px: int, searched: int, disparity: F32) -> None:
    """Write the disparities, given in sixteenths above the least, whose partner lies inside the right image."""
    height, count = found.shape
    width = disparity.shape[1]
    for y in range(height):
        for i in range(count):
            value = np.float32(least_px) + np.float32(0.0625) * np.float32(found[y, i])
            partner = np.float32(first + i) - value
            inside = partner >= np.float32(-0.5) and partner <= np.float32(width) - np.float32(0.5)
            if inside and found[y, i] > 0 and found[y, i] < 16 * (searched - 1):
                disparity[y, first + i] = value


_REACH = 2
"""Half size of the refinement's windows, which have 5 x 5 px."""
_MAX_STEP_PX = 0.5
_LEAST_VARIANCE = 30.0
"""Variance of the gradient, in squared grey values per squared px, below which a step is damped."""


def refined(left: U8, right: U8, disparity: F32) -> F32:
    """Return the disparities moved by at most half a pixel to where the images fit better.

    Semi-global matching biases the fraction towards whole and half pixels (by up to 0.17 px on synthetic planes). One
    Gauss-Newton step along the row removes most of this bias (B. Lucas, T. Kanade, IJCAI 1981). Each window's own mean
    is subtracted, since the two cameras seldom have the same brightness.
    """
    better = np.empty_like(disparity)
    _refine(left, right, disparity, better)
    return better


@compiled
def _refine(left: U8, right: U8, disparity: F32, better: F32) -> None:
    """Refine in one pass: each row is compared once, and the values of the last rows are kept for the windows' sums."""
    height, width = disparity.shape
    side = 2 * _REACH + 1
    kept = np.zeros((side, 5, width), np.float32)  # known, difference, slope, difference times slope, slope squared
    sums = np.empty((5, width + 2 * _REACH), np.float32)
    for row in range(height + _REACH):
        if row < height:
            _compare(left[row], right[row], disparity[row], kept[row % side])
        else:
            kept[row % side] = np.float32(0)
        y = row - _REACH
        if y < 0:
            continue
        sums[:] = np.float32(0)
        for r in range(side):
            for k in range(5):
                for x in range(width):
                    sums[k, x + _REACH] += kept[r, k, x]
        for k in range(5):
            for x in range(width):
                total = np.float32(0)
                for i in range(side):
                    total += sums[k, x + i]
                sums[k, x] = total
        for x in range(width):
            share = max(sums[0, x], np.float32(1))
            slope = sums[2, x] / share
            covariance = sums[3, x] / share - slope * sums[1, x] / share
            variance = max(sums[4, x] / share - slope * slope, np.float32(0))
            step = -covariance / (variance + np.float32(_LEAST_VARIANCE))
            small = abs(step) < np.float32(_MAX_STEP_PX)
            better[y, x] = disparity[y, x] + (step if small else np.float32(0))


@called
def _compare(ours: Any, theirs: Any, disparity: Any, values: Any) -> None:
    """Write a row's known pixels (1 or 0), differences, slopes, and products; the right row is extended at its ends."""
    width = len(disparity)
    last = width - 1
    for x in range(width):
        values[:, x] = np.float32(0)
        if np.isnan(disparity[x]):
            continue
        place = min(max(np.float32(x) - disparity[x], np.float32(-1)), np.float32(width))
        whole = int(np.floor(place))
        t = place - np.float32(whole)
        p0 = np.float32(theirs[min(max(whole - 1, 0), last)])
        p1 = np.float32(theirs[min(max(whole, 0), last)])
        p2 = np.float32(theirs[min(max(whole + 1, 0), last)])
        p3 = np.float32(theirs[min(max(whole + 2, 0), last)])
        # Catmull-Rom's cubic; the slope is the mean of both images' central differences.
        a = np.float32(0.5) * (p3 - p0) + np.float32(1.5) * (p1 - p2)
        b = p0 - np.float32(2.5) * p1 + np.float32(2) * p2 - np.float32(0.5) * p3
        c = np.float32(0.5) * (p2 - p0)
        seen = ((a * t + b) * t + c) * t + p1
        across = c + t * (np.float32(0.5) * (p3 - p1) - c)
        own = np.float32(ours[min(x + 1, last)]) - np.float32(ours[max(x - 1, 0)])
        slope = np.float32(0.5) * (across + np.float32(0.5) * own)
        difference = np.float32(ours[x]) - seen
        values[0, x] = np.float32(1)
        values[1, x] = difference
        values[2, x] = slope
        values[3, x] = difference * slope
        values[4, x] = slope * slope


@compiled
def fill_holes(disparity: F32) -> None:
    """Fill unknown pixels (NaN), in place, with the smaller disparity of the nearest known ones in the row.

    A point that only one camera sees is hidden by a nearer object, hence belongs to the farther side. Rows without any
    known pixel stay unknown.
    """
    height, width = disparity.shape
    for y in range(height):
        x = 0
        while x < width:
            if not np.isnan(disparity[y, x]):
                x += 1
                continue
            end = x
            while end < width and np.isnan(disparity[y, end]):
                end += 1
            before = disparity[y, x - 1] if x > 0 else np.float32(np.inf)
            after = disparity[y, end] if end < width else np.float32(np.inf)
            farther = min(before, after)
            if farther < np.float32(np.inf):
                disparity[y, x:end] = farther
            x = end


@dataclass(frozen=True, slots=True, kw_only=True)
class DenseConfig(DepthRange):
    """Limits and resolution of a calibrated pair's dense disparity."""

    binning: int = setting(1, "Factor by which images are reduced before matching", minimum=1, maximum=8)


class DenseStereo:
    """Dense disparity and points of a calibrated pair; everything is in the left camera's rectified frame.

    Attributes
    ----------
    focal_px
        Focal length of the disparity image; its depth is ``focal_px * baseline / disparity``.
    least_px, largest_px
        Limits of the disparities that can be found, after subtracting the difference of the principal points.
    first_column
        Columns left of this one are always unknown.
    """

    def __init__(self, stereo: StereoModel, config: DenseConfig, matching: SemiGlobalConfig) -> None:
        self._models, self._binning = (stereo.left, stereo.right), config.binning
        self._maps = [model.rectification_maps(stereo.left.size) for model in self._models]
        self.focal_px, self.baseline_m = stereo.focal_px / config.binning, stereo.baseline
        # A pixel of the reduced image covers several of the full one, and pixel centres are whole numbers in both.
        centre = (stereo.left.p[:2, 2] + 0.5) / config.binning - 0.5
        self._offset_px = float(stereo.left.p[0, 2] - stereo.right.p[0, 2]) / config.binning
        width, height = (size // config.binning for size in stereo.left.size)
        product = self.focal_px * self.baseline_m
        low, high = (product / depth + self._offset_px for depth in (config.max_depth_m, config.min_depth_m))
        # No image shows a disparity beyond its width, and the computing time of a pair grows with the square of the
        # range.
        self._matcher = SemiGlobalMatcher(low, max(low, min(high, width)), matching)
        self.first_column = max(self._matcher.least_px, 0)
        self.least_px = self._matcher.least_px - self._offset_px
        self.largest_px = self.least_px + self._matcher.count - 1
        if width <= self.first_column:
            raise ValueError(f"max_depth_m = {config.max_depth_m}: pictures {width} px wide show nothing so near")
        across = (np.arange(width, dtype=np.float64) - centre[0]) / self.focal_px
        down = (np.arange(height, dtype=np.float64) - centre[1]) * (stereo.focal_px / stereo.left.p[1, 1])
        self._across = across.astype(np.float32)
        self._down = (down / self.focal_px).astype(np.float32)
        # Rectification leaves black borders, in which the matcher would find false disparities.
        near = np.ones((5, 5), np.uint8)
        wholes = (np.full(model.size[::-1], 255, np.uint8) for model in self._models)
        self._covered = [cv2.erode(self.rectified(side, whole), near) == 255 for side, whole in enumerate(wholes)]

    def rectified(self, side: int, raw: npt.NDArray[Any]) -> U8:
        """Rectify a raw image, (H, W) or (H, W, 3) uint8, of the left (0) or right (1) camera, and reduce it.

        Raises
        ------
        ValueError
            If its size is not the calibrated one, or it is not 8 bits deep.
        """
        return self._rectified(side, raw, cv2.BORDER_CONSTANT)

    def _rectified(self, side: int, raw: npt.NDArray[Any], border: int) -> U8:
        model = self._models[side]
        if raw.shape[:2] != (model.height, model.width) or raw.dtype != np.uint8:
            raise ValueError(f"picture {raw.shape} {raw.dtype}: {(model.height, model.width)} uint8 is calibrated")
        whole = cv2.remap(raw, *self._maps[side], cv2.INTER_LINEAR, borderMode=border)
        if self._binning == 1:
            return np.asarray(whole, np.uint8)
        height, width = len(self._down), len(self._across)
        cut = whole[: height * self._binning, : width * self._binning]
        return np.asarray(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA), np.uint8)

    def disparity(self, left_raw: U8, right_raw: U8) -> F32:
        """Return (H, W) float32 disparities of raw grey images, H and W after binning.

        NaN where unknown, and where the rectified images are empty.
        """
        # Edge pixels are replicated: black borders would create edges that the matcher propagates far into untextured
        # areas.
        pair = (self._rectified(side, raw, cv2.BORDER_REPLICATE) for side, raw in enumerate((left_raw, right_raw)))
        found = self._matcher(*pair)
        _keep_covered(found, self._covered[0], self._covered[1])
        return found - np.float32(self._offset_px)

    def points(self, disparity: F32) -> F32:
        """Return (H, W, 3) float32 points in metres, NaN where the disparity is unknown or not positive."""
        xyz = np.empty((*disparity.shape, 3), np.float32)
        _spread_out(disparity, np.float32(self.focal_px * self.baseline_m), self._across, self._down, xyz)
        return xyz


@compiled
def _keep_covered(disparity: F32, left: npt.NDArray[np.bool_], right: npt.NDArray[np.bool_]) -> None:
    """Set to NaN, in place, the pixels that one of the rectified images does not cover."""
    height, width = disparity.shape
    for y in range(height):
        for x in range(width):
            if not np.isnan(disparity[y, x]):
                partner = min(max(int(np.round(x - disparity[y, x])), 0), width - 1)
                if not (left[y, x] and right[y, partner]):
                    disparity[y, x] = np.nan


@compiled
def _spread_out(disparity: F32, product: np.float32, across: F32, down: F32, xyz: F32) -> None:
    """Write the points (H, W, 3) of disparities; ``across`` (W,) and ``down`` (H,) are the pixels' rays at depth 1."""
    height, width = disparity.shape
    for y in range(height):
        for x in range(width):
            z = product / disparity[y, x] if disparity[y, x] > 0 else np.float32(np.nan)
            xyz[y, x, 0] = z * across[x]
            xyz[y, x, 1] = z * down[y]
            xyz[y, x, 2] = z


def warm() -> None:
    """Compile the code that a pair needs, or load it from the cache, so that the first pair is not late."""
    noise = np.random.default_rng(0).integers(0, 256, (48, 96), np.uint8)
    disparity = SemiGlobalMatcher(1.0, 32.0, SemiGlobalConfig())(noise, noise)
    everywhere = np.ones(disparity.shape, np.bool_)
    _keep_covered(disparity, everywhere, everywhere)
    down, across = (np.zeros(length, np.float32) for length in disparity.shape)
    _spread_out(disparity, np.float32(1.0), across, down, np.empty((*disparity.shape, 3), np.float32))
