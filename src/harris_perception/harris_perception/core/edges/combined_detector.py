"""Corners and edges in one pass.

Source: C. Harris, M. Stephens, "A Combined Corner and Edge Detector", Alvey Vision Conference 1988.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import Corners, HarrisConfig, HarrisDetector
from harris_perception.core.edges.edges import ABOVE_NOISE, Edges, TracingConfig, traced
from harris_perception.core.image.noise import noise_above


class CombinedDetector:
    """Corners and edges in one pass, as in the paper of 1988: as fast as possible, at the scale of the corners.

    For outlines of objects rather than of texture see ``edges``.

    Examples
    --------
    >>> import numpy as np
    >>> from harris_perception.core.edges.edges import CORNER, EDGE, FLAT
    >>> picture = np.zeros((60, 60), np.uint8)
    >>> picture[20:, 30:] = 200
    >>> corners, edges = CombinedDetector().detect(picture)
    >>> corners.xy.round().astype(int).tolist(), [len(chain) for chain in edges.chains]
    ([[30, 20]], [27, 37])
    >>> sorted({int(value) for value in np.unique(edges.labels)}) == [FLAT, EDGE, CORNER]
    True
    """

    def __init__(self, config: HarrisConfig | None = None, edges: TracingConfig | None = None) -> None:
        self.edges = edges if edges is not None else TracingConfig()
        self._detector = HarrisDetector(config)

    def warm(self) -> None:
        """Compile, or load from the cache, all code needed, so that no image waits for it."""
        checks = (np.indices((64, 64)) // 16).sum(axis=0) % 2 * 100
        for dtype in (np.uint8, np.uint16, np.float32):
            self.detect(checks.astype(dtype))

    def detect(
        self,
        gray: npt.NDArray[Any],
        corners_xy: npt.ArrayLike | None = None,
        strengths: npt.ArrayLike | None = None,
        grey_level: float = 1.0,
    ) -> tuple[Corners, Edges]:
        """Return corners and edges of an image; the corners are those of ``HarrisDetector``.

        Edges end only at corners that are at least as strong as the weakest edge and three times the noise. In an image
        without such corners all corners are noise, and edges that ended at them would be cut to pieces.

        Parameters
        ----------
        gray
            (H, W) uint8, uint16 or float32.
        corners_xy
            (N, 2) px of other corners at which edges end instead.
        strengths
            (N,) of these, from their detector's ``strengths_of``. Without strengths edges end at all of them.
        grey_level
            Size of one grey level of the edges' settings, in values of the image.

        Raises
        ------
        ValueError
            For another shape or dtype, a response other than ``harris``, or a corner outside the image.
        """
        config, high = self.edges, self.edges.high * grey_level
        low = config.low_of_high * high
        corners, bits = self._detector.detect_with_edges(gray, low, high)
        least = max(low, ABOVE_NOISE * noise_above(gray, low / ABOVE_NOISE))
        ends: npt.NDArray[np.bool_] | None
        if corners_xy is None:
            corners_xy, ends = corners.xy, corners.response >= np.float64(self._detector.response_of(least))
        else:
            ends = None if strengths is None else np.asarray(strengths) >= least
        return corners, traced(bits, gray.shape, config, corners_xy, ends)
