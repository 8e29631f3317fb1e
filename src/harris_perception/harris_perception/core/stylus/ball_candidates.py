"""Regions of the ball's colour in both images, and the pairs of them that may be the ball."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from harris_perception.core.image.medians import median
from harris_perception.core.stylus.ball_view import Picture, chroma_of
from harris_perception.core.stylus.image_windows import Window, cut
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array

_MAX_BLOBS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Blob:
    """A region: its box in pixels of the window, and its centre (2,) in the rectified image."""

    box: Window
    centre_px: Array


class BallCandidates:
    """Finds the regions and pairs them.

    Parameters
    ----------
    config
        Sizes and limits.
    stereo
        The calibrated pair.
    """

    def __init__(self, config: StylusSearchConfig, stereo: StereoModel) -> None:
        self._config, self._stereo = config, stereo

    def regions(self, picture: Picture, window: Window, model: CameraModel) -> list[Blob]:
        """Return the regions in a window of one camera's image (H, W, 3), the largest first."""
        part = cut(picture, window)
        return list(self._blobs(chroma_of(part), window, model)) if self._has_colour(part) else []

    def pairs(self, left: list[Blob], right: list[Blob], apart_m: float) -> Iterator[tuple[Blob, Blob]]:
        """Yield the pairs at a possible depth and in the same rows.

        The ball moves by at most ``apart_m`` between the images.
        """
        near, far = self._config.min_depth_m, self._config.max_depth_m
        for a in left:
            for b in right:
                depth = float(self._stereo.triangulate(a.centre_px, b.centre_px)[0, 2])
                # Shaft and arm hide different parts in the two images: half a ball is allowed here, and the fit
                # decides.
                if near <= depth <= far and abs(a.centre_px[1] - b.centre_px[1]) <= self._stereo.focal_px * (
                    (0.5 * self._config.ball_diameter_m + apart_m) / depth
                ):
                    yield a, b

    def _has_colour(self, part: Picture) -> bool:
        """Return whether a pixel of every second row and column has the ball's colour; a quarter of a full search.

        A region without such a pixel is less than 2 px wide or high, too small to measure an arc of a ball.
        """
        chroma = chroma_of(part[::2, ::2])
        return bool(chroma.size and chroma.max() > min(self._level(chroma[::4, ::4]), 254.0))

    def _level(self, every_eighth: Picture) -> float:
        """Return the minimum chroma of the ball's colour."""
        return median(every_eighth) + self._config.min_chroma

    def _blobs(self, chroma: Picture, window: Window, model: CameraModel) -> Iterator[Blob]:
        """Yield connected regions with the ball's colour and a possible size, the largest first."""
        level = min(self._level(chroma[::8, ::8]), 254.0)
        mask = np.asarray(cv2.threshold(chroma, level, 255, cv2.THRESH_BINARY)[1])
        left, top, across, down = cv2.boundingRect(mask)  # much faster than labelling, and usually small
        if not across:
            return
        inside = mask[top : top + down, left : left + across]
        _, _, stats, centres = cv2.connectedComponentsWithStats(inside, connectivity=8, ltype=cv2.CV_32S)
        stats[:, :2] += (left, top)
        centres += (left, top)
        diameter = self._config.ball_diameter_m * self._stereo.focal_px
        largest = 1.3 * diameter / self._config.min_depth_m + 4
        smallest = 0.1 * (diameter / self._config.max_depth_m) ** 2
        area = stats[:, cv2.CC_STAT_AREA]
        size = np.max(stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]], axis=1)
        possible = np.flatnonzero((size <= largest) & (area >= max(smallest, 4)))
        possible = possible[possible != 0]
        order: list[int] = possible[np.argsort(-area[possible], kind="stable")][:_MAX_BLOBS].tolist()
        corner = np.array(window[:2])
        for i in order:
            x, y, w, h = (int(stats[i, k]) for k in range(4))
            yield Blob((x, y, x + w, y + h), model.rectify(centres[i] + corner)[0])
