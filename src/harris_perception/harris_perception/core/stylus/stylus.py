"""Finds the magenta ball at the stylus's end in a stereo pair and measures its centre.

The shaft hides a part of the ball, so a centroid would be biased. Instead the visible outline is measured to a fraction
of a pixel (ball_view.py). A circle with the size of the ball at its distance is fitted to the part of the outline that
agrees (ball_fit.py). In the plane that touches the viewing sphere at the ball's centre the outline of a sphere is an
exact circle. This holds for any lens distortion and any position in the image.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from harris_perception.core.stylus.ball_candidates import BallCandidates, Blob
from harris_perception.core.stylus.ball_measurement import BallMeter
from harris_perception.core.stylus.ball_view import Doubt, Picture
from harris_perception.core.stylus.image_windows import Window, around
from harris_perception.core.stylus.still_ball import StillBall
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from harris_perception.pairing.search import Search
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.geometry import Array

_REST_PAIRS = 30
"""Number of unchanged pairs after which the stylus is at rest: 2 s at 15 Hz, longer than any measurement after a
motion."""
_COMPARED_BEYOND_PX = 3.0
"""Width, in pixels, of the ring beyond the ball's outline that is compared with the last measured pair."""
_LARGEST_SPEED_M_S = 0.2
"""Maximum speed at which the ball is found in two images that are apart."""


class StylusTracker:
    """Searches the ball around its last position first, then in the whole images.

    Parameters
    ----------
    config
        Sizes and limits.
    stereo
        The calibrated pair.
    """

    def __init__(self, config: StylusSearchConfig, stereo: StereoModel) -> None:
        self.config, self.stereo = config, stereo
        self._candidates = BallCandidates(config, stereo)
        self._meter = BallMeter(config, stereo)
        self._last: Array | None = None
        self._still = StillBall(config.unchanged_pairs, _REST_PAIRS)
        self._result = Search(tip=None, reason="not seen")

    def recalibrate(self, stereo: StereoModel) -> None:
        """Use another calibration of the same pair from the next images on."""
        self.stereo = self._meter.stereo = stereo
        self._candidates = BallCandidates(self.config, stereo)
        self._still.forget()  # the same images now mean another position

    def find(self, left: Picture, right: Picture, apart_s: float = 0.0) -> Search:
        """Measure the ball's centre in one pair of raw images, (H, W, 3) uint8 BGR, taken ``apart_s`` apart.

        If the images are apart, the tip is valid only for a ball at rest; its outlines are always valid.

        Raises
        ------
        ValueError
            If an image's shape does not fit the calibration, or it is not 8 bits deep.
        """
        pictures = (left, right)
        for picture, model in zip(pictures, (self.stereo.left, self.stereo.right)):
            if picture.shape != (model.height, model.width, 3) or picture.dtype != np.uint8:
                shape = model.height, model.width, 3
                raise ValueError(f"picture {picture.shape} {picture.dtype}: {shape} uint8 is calibrated")
        if self._still.unchanged(pictures):
            return self._result
        for windows in self._windows():
            self._result = self._search(pictures, windows, apart_s * _LARGEST_SPEED_M_S)
            if self._result.tip is not None:
                break
        self._last = self._result.tip
        if self._last is not None:
            self._still.measured(pictures, self._around_ball(self._last, _COMPARED_BEYOND_PX))
        else:
            self._still.forget()
        return self._result

    def _around_ball(self, tip: Array, margin: float) -> tuple[Window, Window]:
        """Return the windows, one per raw image, that extend ``margin`` px beyond the ball's outline."""
        margin += max(self._meter.radii_px(tip))
        left, right = self.stereo.left, self.stereo.right
        seen = (left.project(tip)[0], self.stereo.project_right(tip)[0])
        near = [around(at, margin, (0, 0, model.width, model.height)) for at, model in zip(seen, (left, right))]
        return near[0], near[1]

    def _windows(self) -> Iterator[tuple[Window, Window]]:
        left, right = self.stereo.left, self.stereo.right
        if self._last is not None:
            yield self._around_ball(self._last, self.config.search_margin_px)
        yield (0, 0, left.width, left.height), (0, 0, right.width, right.height)

    def _search(self, pictures: tuple[Picture, Picture], windows: tuple[Window, Window], apart_m: float) -> Search:
        models = (self.stereo.left, self.stereo.right)
        blobs: list[list[Blob]] = []
        for side, picture, window, model in zip(("left", "right"), pictures, windows, models):
            found = self._candidates.regions(picture, window, model)
            if not found:
                return Search(tip=None, reason=f"not seen in the {side} picture")
            blobs.append(found)
        good: list[Search] = []
        reason = "nothing of the ball's colour is in both pictures at a possible depth"
        for a, b in self._candidates.pairs(blobs[0], blobs[1], apart_m):
            try:
                good.append(self._meter.measure((a, b), pictures, windows, apart_m))
            except Doubt as doubt:
                reason = str(doubt)
        if len(good) > 1:
            return Search(tip=None, reason=f"{len(good)} places look like the ball")
        return good[0] if good else Search(tip=None, reason=reason)
