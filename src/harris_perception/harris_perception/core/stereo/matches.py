"""Matched corners of a rectified pair, and their points in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StereoMatches:
    """Matched corners.

    Attributes
    ----------
    left_px
        (N, 2) rectified pixels in the left image.
    disparity_px
        (N,) left column minus right column.
    sigma_px
        (N,) standard deviation of the disparity, from the windows' difference and texture; docs/decisions/stereo.md has
        its accuracy.
    correlation
        (N,) correlation of the windows.
    index
        (N, 2) row numbers of the left and right corners; -1 if the right image has no corner there.
    """

    left_px: Array
    disparity_px: Array
    sigma_px: Array
    correlation: Array
    index: npt.NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.disparity_px)

    def only(self, which: npt.NDArray[np.bool_]) -> StereoMatches:
        """Return the matches set in ``which`` (N,)."""
        return StereoMatches(
            left_px=self.left_px[which],
            disparity_px=self.disparity_px[which],
            sigma_px=self.sigma_px[which],
            correlation=self.correlation[which],
            index=self.index[which],
        )


def triangulated(stereo: StereoModel, matches: StereoMatches) -> Array:
    """Return (N, 4): x, y, z and the depth's standard deviation in metres, in the left rectified frame."""
    right = matches.left_px - np.column_stack([matches.disparity_px, np.zeros(len(matches))])
    xyz = stereo.triangulate(matches.left_px, right)
    sigma = xyz[:, 2] ** 2 / (stereo.focal_px * stereo.baseline) * matches.sigma_px
    return np.column_stack([xyz, sigma])
