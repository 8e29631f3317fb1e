"""Detects that a stereo pair shows the ball where the last measured pair did, so that it need not be measured again.

The shift between two images of the ball is the least-squares solution of change = -gradient . shift (Lucas and Kanade
1981). Noise of 2 grey levels changes it by 0.02 px for a ball of 4 px radius. Pixels in which the background changes,
such as the trace on a screen, are excluded as long as the others determine the shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from harris_perception.core.stylus.ball_view import Picture, chroma_of
from harris_perception.core.stylus.image_windows import Window
from icu_common.core.geometry.geometry import Array

_LARGEST_SHIFT_PX = 0.08
_LARGEST_CHANGE = 10.0
"""Maximum change of a pixel's chroma, in grey levels, by noise and the largest shift."""
_LEAST_SHARE = 0.7
"""Minimum share of the squared gradient, down and right, in the pixels that are not excluded."""


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """The ball in one image of the measured pair: its window, its chroma (N,), and the chroma's gradient, (2, N)."""

    window: Window
    chroma: Array
    gradient: Array

    def shows(self, picture: Picture) -> bool:
        change = _chroma(picture, self.window).ravel() - self.chroma
        used = np.abs(change) <= _LARGEST_CHANGE
        gradient = self.gradient[:, used]
        squares = gradient @ gradient.T
        if not (np.diag(squares) >= _LEAST_SHARE * np.square(self.gradient).sum(axis=1)).all():
            return False
        shift = np.linalg.solve(squares, -gradient @ change[used])
        return bool(np.abs(shift).max() <= _LARGEST_SHIFT_PX)


class StillBall:
    """Compares stereo pairs with a measured one.

    A measurement of a ball that has just stopped averages several images, whose noise must be independent. A pair
    therefore counts as unchanged only after ``after`` measured pairs that did not differ.

    Parameters
    ----------
    longest
        Maximum number of successive pairs that count as unchanged; 0: none does.
    after
        Number of successive measured pairs without a change before the first that counts as unchanged.
    """

    def __init__(self, longest: int, after: int) -> None:
        self._longest, self._after = longest, after
        self._references: list[_Reference] = []
        self._unchanged = self._measured = 0

    def forget(self) -> None:
        """Count the next pair as changed."""
        self._references = []

    def measured(self, pictures: Sequence[Picture], windows: Sequence[Window]) -> None:
        """Store a pair of raw images, each (H, W, 3) uint8, in which the ball was measured in these windows."""
        self._unchanged = 0
        if self._shown(pictures):
            self._measured += 1
            return
        self._measured = 1
        self._references = [_reference(picture, window) for picture, window in zip(pictures, windows, strict=True)]

    def unchanged(self, pictures: Sequence[Picture]) -> bool:
        """Return whether both raw images show the ball where it was measured; count the pairs that do."""
        if self._measured < self._after or self._unchanged >= self._longest or not self._shown(pictures):
            return False
        self._unchanged += 1
        return True

    def _shown(self, pictures: Sequence[Picture]) -> bool:
        return bool(self._references) and all(
            reference.shows(picture) for reference, picture in zip(self._references, pictures, strict=True)
        )


def _reference(picture: Picture, window: Window) -> _Reference:
    chroma = _chroma(picture, window)
    down, right = np.gradient(chroma)
    gradient = np.stack([right.ravel(), down.ravel()])
    return _Reference(window, chroma.ravel(), gradient)


def _chroma(picture: Picture, window: Window) -> Array:
    """Return the chroma in a window, (h, w) float."""
    x0, y0, x1, y1 = window
    return np.asarray(chroma_of(picture[y0:y1, x0:x1]), np.float64)
