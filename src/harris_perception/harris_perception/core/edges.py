"""Edges by the combined detector: where the response is negative, thinned, linked, and ending at corners.

Sources: C. Harris, M. Stephens, "A Combined Corner and Edge Detector", Alvey Vision Conference 1988; hysteresis as
J. Canny, PAMI 8(6), 1986; the gradient of several channels as S. Di Zenzo, CVGIP 33(1), 1986; the inhibition by the
surroundings after C. Grigorescu, N. Petkov, M. Westenberg, IEEE TIP 12(7), 2003. Flat, edge or corner is told for every
pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core import edge_kernels as kernels
from harris_perception.core.harris import gaussian_taps
from icu_common.core.config import Config, setting

FLAT, EDGE, CORNER = 0, 128, 255
"""Values of the label picture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeConfig(Config):
    """What is an edge; strengths are (-R / k)^(1/4), which on a straight edge is the gradient in grey levels per px.

    The window over the products is 1 2 1 both ways. Strengths at a fine and a coarse scale are combined by their
    geometric mean, and what surrounds a pixel on average is subtracted, so that texture counts less than outlines.
    """

    sigma_d_px: float = setting(1.5, "Scale of the derivatives", minimum=0.5, maximum=10.0, unit="px")
    coarse_sigma_px: float = setting(
        4.0, "Scale at which an edge must be seen as well, 0 = none", minimum=0.0, maximum=40.0, unit="px"
    )
    k: float = setting(
        0.15, "Weight of trace^2 in the response; more keeps bent edges whole", minimum=0.001, maximum=0.24
    )
    surround: float = setting(
        1.0, "The strength averaged over the surroundings is subtracted so many times", minimum=0.0, maximum=4.0
    )
    surround_px: float = setting(40.0, "Size (sigma) of the surroundings", minimum=8.0, maximum=500.0, unit="px")
    color: float = setting(4.0, "Weight of the Lab colors a and b in color pictures", minimum=0.0, maximum=20.0)
    high: float = setting(3.0, "Strength that starts an edge", minimum=0.0, maximum=1e5, unit="grey levels per px")
    low_of_high: float = setting(0.3, "Strength that continues an edge, as a fraction", minimum=0.0, maximum=1.0)
    min_length_px: int = setting(20, "Smaller connected pieces are removed", minimum=1, maximum=10_000, unit="px")
    min_weight_px: float = setting(
        30.0,
        "Pieces are removed whose strengths add up to less than so many pixels of the strength 'high'",
        minimum=0.0,
        maximum=1e5,
        unit="px",
    )
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
        self._fine = _half_taps(self.config.sigma_d_px)
        # The coarse scale is computed on a picture of half the size.
        self._coarse = _half_taps(max(0.5 * self.config.coarse_sigma_px, 0.3))

    def warm(self) -> None:
        """Compile, or load from the cache, all that is needed, so that no picture waits for it."""
        checks = np.indices((64, 64)).sum(axis=0) // 16 % 2 * 100
        for dtype in (np.uint8, np.float32):
            self.detect(checks.astype(dtype), [(20.0, 20.0)])

    def thinned(self, picture: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Return the strength of every pixel that is a maximum across an edge, (H, W) float32, zero elsewhere.

        The picture is as for ``detect``.
        """
        channels = self._channels(picture)
        shape = picture.shape[:2]
        if 0 in shape:
            return np.zeros(shape, np.float32)
        config = self.config
        a, b, c = _structure(channels, self._fine)
        strength = kernels.strength_of(a, b, c, config.k)
        size = (shape[1], shape[0])
        if config.coarse_sigma_px > 0.0:
            half = tuple(max((side + 1) // 2, 1) for side in size)
            small = [(cv2.resize(channel, half, interpolation=cv2.INTER_AREA), w) for channel, w in channels]
            a2, b2, c2 = _structure(small, self._coarse)
            coarse = kernels.strength_of(a2, b2, c2, config.k)
            kernels.combine(strength, cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR))
        if config.surround > 0.0:
            eighth = tuple(max(side // 8, 1) for side in size)
            small_strength = cv2.resize(strength, eighth, interpolation=cv2.INTER_AREA)
            around = cv2.GaussianBlur(small_strength, (0, 0), config.surround_px / 8, borderType=cv2.BORDER_REFLECT)
            around = cv2.resize(around, size, interpolation=cv2.INTER_LINEAR)
            strength = cv2.scaleAdd(around, -config.surround, strength)
        framed = cv2.copyMakeBorder(strength, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        return np.asarray(kernels.thin(framed, a, b, c), np.float32)

    def _channels(self, picture: npt.NDArray[Any]) -> list[tuple[npt.NDArray[Any], float]]:
        """Return grey, or the three of Lab, each with the weight of its squared gradient."""
        if picture.ndim == 3 and picture.shape[2] == 3 and picture.dtype == np.uint8:
            if picture.size == 0:
                return []
            light, a, b = cv2.split(cv2.cvtColor(picture, cv2.COLOR_BGR2LAB))
            return [(light, 1.0), (a, self.config.color**2), (b, self.config.color**2)]
        if picture.ndim != 2:
            raise ValueError(f"a grey picture (H, W) or BGR (H, W, 3) uint8 is needed, not shape {picture.shape}")
        dtype = np.uint8 if picture.dtype == np.uint8 else np.float32
        return [(np.ascontiguousarray(picture, dtype), 1.0)]

    def detect(self, picture: npt.NDArray[Any], corners_xy: npt.ArrayLike = ()) -> Edges:
        """Return the edges of a picture.

        Parameters
        ----------
        picture
            Grey (H, W) uint8, uint16 or float32, or color (H, W, 3) uint8, BGR.
        corners_xy
            (N, 2) px of corners that edges shall end at, for example of ``HarrisDetector.detect``.

        Raises
        ------
        ValueError
            For another shape, or a corner outside the picture.
        """
        return self.edges_of(self.thinned(picture), corners_xy)

    def edges_of(self, thinned: npt.NDArray[Any], corners_xy: npt.ArrayLike = ()) -> Edges:
        """Do the second half of ``detect``, from what ``thinned`` has returned."""
        config = self.config
        corners = np.rint(np.asarray(corners_xy, np.float64).reshape(-1, 2)).astype(np.int32)
        if ((corners < 0) | (corners >= thinned.shape[::-1])).any():
            raise ValueError(f"a corner lies outside the picture of {thinned.shape[1]} x {thinned.shape[0]} px")
        low = config.low_of_high * config.high
        mask = kernels.hysteresis(thinned, config.high, low, config.min_length_px, config.min_weight_px)
        kernels.skeletonise(mask, thinned)
        points, starts = kernels.link(mask)
        while config.max_spur_px > 0 and kernels.remove_spurs(mask, points, starts, config.max_spur_px):
            kernels.skeletonise(mask, thinned)  # what a branch leaves behind may be a thick bend
            points, starts = kernels.link(mask)
        if len(corners) and config.max_gap_px > 0.0:
            kernels.lead_to_corners(mask, corners, config.max_gap_px)
            points, starts = kernels.link(mask)
        labels = np.multiply(mask.view(np.uint8), np.uint8(EDGE), dtype=np.uint8)
        labels[corners[:, 1], corners[:, 0]] = CORNER
        chains = [points[i:j] for i, j in zip(starts[:-1].tolist(), starts[1:].tolist())]
        return Edges(labels, chains)


def _half_taps(sigma: float) -> npt.NDArray[np.float32]:
    """Return the centre and one side of a sampled Gaussian."""
    taps = gaussian_taps(sigma)
    return np.array(taps[len(taps) // 2 :], np.float32)


def _structure(
    channels: list[tuple[npt.NDArray[Any], float]], taps: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return the weighted sum of the channels' structure tensors as gx^2, gy^2, gx gy."""
    a, b, c = (np.zeros(channels[0][0].shape, np.float32) for _ in range(3))
    for channel, weight in channels:
        kernels.add_structure(channel, taps, weight, a, b, c)
    return a, b, c
