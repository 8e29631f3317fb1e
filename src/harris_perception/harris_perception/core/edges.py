"""Edges by the combined detector: where the response is negative, thinned, linked, and ending at corners.

Sources: C. Harris, M. Stephens, "A Combined Corner and Edge Detector", Alvey Vision Conference 1988; hysteresis as
J. Canny, PAMI 8(6), 1986. Flat, edge or corner is told for every pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core import edge_kernels as kernels
from harris_perception.core.harris import HarrisConfig, HarrisDetector
from icu_common.core.config import Config, setting

FLAT, EDGE, CORNER = 0, 128, 255
"""Values of the label picture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeConfig(Config):
    """What is an edge; strengths are (-R / k)^(1/4), which on a straight edge is the gradient in grey levels per px."""

    sigma_d_px: float = setting(2.0, "Scale of the derivatives", minimum=0.5, maximum=10.0, unit="px")
    sigma_i_px: float = setting(1.0, "Scale of the window over their products", minimum=0.5, maximum=10.0, unit="px")
    k: float = setting(
        0.08, "Weight of trace^2 in the response; more keeps bent edges whole", minimum=0.001, maximum=0.24
    )
    high: float = setting(6.0, "Strength that starts an edge", minimum=0.0, maximum=1e5, unit="grey levels per px")
    low_of_high: float = setting(0.4, "Strength that continues an edge, as a fraction", minimum=0.0, maximum=1.0)
    min_length_px: int = setting(20, "Smaller connected pieces are removed", minimum=1, maximum=10_000, unit="px")
    max_spur_px: int = setting(5, "Branches up to this length are removed", minimum=0, maximum=100, unit="px")
    max_gap_px: float = setting(
        6.0, "Free ends this near to a corner are led to it", minimum=0.0, maximum=50.0, unit="px"
    )


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges of one picture.

    Attributes
    ----------
    labels
        (H, W) uint8: FLAT, EDGE or CORNER.
    chains
        Each (N, 2) int32 px x, y of neighbouring pixels; a closed one ends where it starts.
    """

    labels: npt.NDArray[np.uint8]
    chains: list[npt.NDArray[np.int32]]


class EdgeDetector:
    """Detector of edges with one configuration; it keeps no state between pictures.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.zeros((60, 60), np.uint8)
    >>> picture[:, 30:] = 200
    >>> edges = EdgeDetector(EdgeConfig()).detect(picture)
    >>> [(len(chain), set(chain[:, 0].tolist()) <= {29, 30}) for chain in edges.chains]
    [(60, True)]
    """

    def __init__(self, config: EdgeConfig | None = None) -> None:
        self.config = config if config is not None else EdgeConfig()
        self._detector = HarrisDetector(
            HarrisConfig(
                gradient="gaussian",
                sigma_d_px=self.config.sigma_d_px,
                window="gaussian",
                sigma_i_px=self.config.sigma_i_px,
                k=self.config.k,
            )
        )

    def thinned(self, gray: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Return the strength of every pixel that is a maximum across an edge, (H, W) float32, zero elsewhere."""
        if gray.ndim != 2:
            raise ValueError(f"a grey picture (H, W) is needed, not shape {gray.shape}")
        if gray.size == 0:
            return np.zeros(gray.shape, np.float32)
        margin = self._detector.margin_px
        padded = cv2.copyMakeBorder(gray.astype(np.float32), margin, margin, margin, margin, cv2.BORDER_REPLICATE)
        a, b, c = self._detector.structure(padded)
        return np.asarray(kernels.thin(a, b, c, self.config.k), np.float32)

    def detect(self, gray: npt.NDArray[Any], corners_xy: npt.ArrayLike = ()) -> Edges:
        """Return the edges of a picture.

        Parameters
        ----------
        gray
            (H, W) uint8, uint16 or float32.
        corners_xy
            (N, 2) px of corners that edges shall end at, for example of ``HarrisDetector.detect``.

        Raises
        ------
        ValueError
            For another shape, or a corner outside the picture.
        """
        return self.edges_of(self.thinned(gray), corners_xy)

    def edges_of(self, thinned: npt.NDArray[Any], corners_xy: npt.ArrayLike = ()) -> Edges:
        """Do the second half of ``detect``, from what ``thinned`` has returned."""
        config = self.config
        corners = np.rint(np.asarray(corners_xy, np.float64).reshape(-1, 2)).astype(np.int32)
        if ((corners < 0) | (corners >= thinned.shape[::-1])).any():
            raise ValueError(f"a corner lies outside the picture of {thinned.shape[1]} x {thinned.shape[0]} px")
        mask = kernels.hysteresis(thinned, config.high, config.low_of_high * config.high, config.min_length_px)
        kernels.skeletonise(mask, thinned)
        points, starts = kernels.link(mask)
        while config.max_spur_px > 0 and kernels.remove_spurs(mask, points, starts, config.max_spur_px):
            kernels.skeletonise(mask, thinned)  # what a branch leaves behind may be a thick bend
            points, starts = kernels.link(mask)
        if len(corners) and config.max_gap_px > 0.0:
            kernels.lead_to_corners(mask, corners, config.max_gap_px)
            points, starts = kernels.link(mask)
        labels = np.where(mask, np.uint8(EDGE), np.uint8(FLAT))
        labels[corners[:, 1], corners[:, 0]] = CORNER
        chains = [points[i:j] for i, j in zip(starts[:-1].tolist(), starts[1:].tolist())]
        return Edges(labels, chains)
