"""Rates matches: how many neighbours agree, and the probability that a match is correct.

The probability is derived from the middle of both windows, their census (the pixels that are brighter than the middle
one; R. Zabih, J. Woodfill, ECCV 1994), the match's uncertainty and its neighbours.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from harris_perception.core.stereo import stereo_kernels as kernels
from harris_perception.core.stereo.match_windows import F32, normalised, windows_at
from harris_perception.core.stereo.matches import StereoMatches
from icu_common.core.geometry.geometry import Array

_JUDGED_HALF, _CENSUS_HALF, _CENSUS_NOISE = 2, 3, 4.0
_NEAR_SLOPE = 0.02
_WEIGHTS = np.array([3.62, 12.17, -0.74, 4.44, -16.42])
"""Weights of correlation, census, log of the uncertainty in px, share of agreeing neighbours, and 1. They come from a
logistic regression over the matches of eight pairs made from photographs other than the evaluated ones."""


def agreeing(query: F32, disparity: F32, at: F32, theirs: F32, max_slope: float) -> npt.NDArray[np.intp]:
    """Count for each query how many of the eight nearest matches have a consistent disparity."""
    if not len(at):
        return np.zeros(len(query), np.intp)
    near = kernels.nearest(query, at)
    distance = np.hypot(*np.moveaxis(query[:, None] - at[near], 2, 0))
    fits = np.abs(disparity[:, None] - theirs[near]) <= 1.0 + max_slope * distance
    return np.asarray((fits & (near >= 0)).sum(axis=1), np.intp)


def probability(left: F32, right: F32, matches: StereoMatches) -> Array:
    """Return the probability (N,) that a match is correct within one pixel."""
    at, disparity = matches.left_px.astype(np.float32), matches.disparity_px.astype(np.float32)
    there = at - np.column_stack([disparity, np.zeros_like(disparity)])
    alike = np.einsum(
        "nk,nk->n", *(normalised(windows_at(p, q, _JUDGED_HALF)) for p, q in ((left, at), (right, there)))
    )
    here, other = (windows_at(p, q, _CENSUS_HALF) for p, q in ((left, at), (right, there)))
    middle = here.shape[1] // 2
    brighter = here - here[:, middle : middle + 1]
    clear = np.abs(brighter) > _CENSUS_NOISE
    same = (brighter > 0) == (other > other[:, middle : middle + 1])
    census = (same & clear).sum(axis=1) / np.maximum(clear.sum(axis=1), 1)
    near = agreeing(at, disparity, at, disparity, _NEAR_SLOPE) / 8
    told = np.column_stack([alike, census, np.log(matches.sigma_px), near, np.ones(len(at))])
    return np.asarray(1.0 / (1.0 + np.exp(-told @ _WEIGHTS)))
