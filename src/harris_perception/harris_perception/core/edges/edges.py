"""Edges as outlines of objects: pixels with negative response, thinned, linked, and ending at corners.

Sources: C. Harris, M. Stephens, "A Combined Corner and Edge Detector", Alvey Vision Conference 1988; hysteresis as in
J. Canny, PAMI 8(6), 1986; the gradient of several channels as in S. Di Zenzo, CVGIP 33(1), 1986; the inhibition by the
surroundings after C. Grigorescu, N. Petkov, M. Westenberg, IEEE TIP 12(7), 2003. Every pixel is labelled flat, edge or
corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.value_range import checked, from_lowest, in_range
from harris_perception.core.edges import edge_kernels as kernels
from harris_perception.core.edges import edge_tracing as tracing
from harris_perception.core.edges.edge_sides import SHRUNK, Sides, structure
from harris_perception.core.image import bitmap
from harris_perception.core.image.noise import noise_above
from harris_perception.core.image.sampling import mean_around
from icu_common.core.configuration.config import Config, setting

FLAT, EDGE, CORNER = 0, tracing.EDGE, tracing.CORNER
"""Values of the label image."""

_NO_STRENGTH = np.empty((0, 0), np.float32)

_LOOKS = 2
"""Number of passes: regions are separated by edges, which change the edges, which separate regions again."""

_ABOVE_START = 1.5
"""Minimum strength of corners that end an outline, as a multiple of ``high``; noise of 1 grey level hardly reaches
it."""

ABOVE_NOISE = 3.0
"""Minimum strength of corners that end an edge, as a multiple of the noise; corners of noise seldom reach it."""


_DIM = 16.0
"""Maximum value of floats that are scaled to another unit: separating regions ignores strengths of a thousandth."""

_STARTS = "Strength that starts an edge, always in grey levels of 8 bits, even if a message or file has more"


@dataclass(frozen=True, slots=True, kw_only=True)
class TracingConfig(Config):
    """Settings that turn thinned pixels into chains.

    Strengths are (-R / k)^(1/4), which on a straight edge is the gradient in grey levels per px.
    """

    high: float = setting(20.0, _STARTS, minimum=0.0, maximum=1e5, unit="grey levels per px")
    low_of_high: float = setting(0.5, "Fraction of 'high' at which an edge continues", minimum=0.0, maximum=1.0)
    min_length_px: int = setting(
        10,
        "Minimum number of pixels of a connected piece, counted before thinning",
        minimum=1,
        maximum=10_000,
        unit="px",
    )
    max_spur_px: int = setting(3, "Maximum length of branches that are removed", minimum=0, maximum=100, unit="px")
    max_gap_px: float = setting(
        5.0,
        "Maximum distance from a free end to a corner for the end to be extended to the corner",
        minimum=0.0,
        maximum=50.0,
        unit="px",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeConfig(TracingConfig):
    """Settings of outlines.

    The window over the products is 1 2 1 in both directions. Strengths are multiplied by the difference between both
    sides of an edge, in values (coded in soft bins) and texture. It is taken at a coarse scale, and between the regions
    that edges separate. The mean surrounding strength is subtracted, so that texture counts less than outlines.
    """

    sigma_d_px: float = setting(
        1.5, "Standard deviation of the Gaussian derivatives", minimum=0.5, maximum=10.0, unit="px"
    )
    coarse_sigma_px: float = setting(
        6.0,
        "Scale at which both sides of an edge must also differ; 0: not compared",
        minimum=0.0,
        maximum=40.0,
        unit="px",
    )
    texture: float = setting(
        1.4, "Weight of texture relative to values when both sides of an edge are compared", minimum=0.0, maximum=20.0
    )
    k: float = setting(
        0.24,
        "Weight of trace^2 in the response; a larger value keeps curved edges connected",
        minimum=0.001,
        maximum=0.24,
    )
    region_px: float = setting(
        40.0,
        "Range of the diffusion that averages the regions on both sides of an edge, which must also differ; "
        "0: not compared, which takes a third of the time",
        minimum=0.0,
        maximum=400.0,
        unit="px",
    )
    surround: float = setting(
        0.75, "Factor of the mean surrounding strength that is subtracted from the strength", minimum=0.0, maximum=4.0
    )
    surround_px: float = setting(
        40.0,
        "Standard deviation of the Gaussian that averages the surrounding strength",
        minimum=8.0,
        maximum=500.0,
        unit="px",
    )
    along_px: int = setting(
        6,
        "Distance along an edge, in both directions, over which strengths are averaged",
        minimum=0,
        maximum=50,
        unit="px",
    )
    color: float = setting(5.0, "Weight of the Lab channels a and b in colour images", minimum=0.0, maximum=20.0)
    high: float = setting(3.0, _STARTS, minimum=0.0, maximum=1e5, unit="grey levels per px")
    low_of_high: float = setting(0.3, "Fraction of 'high' at which an edge continues", minimum=0.0, maximum=1.0)
    min_length_px: int = setting(
        14,
        "Minimum number of pixels of a connected piece, counted before thinning",
        minimum=1,
        maximum=10_000,
        unit="px",
    )
    min_weight_px: float = setting(
        30.0,
        "Minimum sum of a piece's strengths, as a number of pixels of strength 'high'",
        minimum=0.0,
        maximum=1e5,
        unit="px",
    )
    max_spur_px: int = setting(5, "Maximum length of branches that are removed", minimum=0, maximum=100, unit="px")
    max_gap_px: float = setting(
        6.0,
        "Maximum distance from a free end to a corner for the end to be extended to the corner",
        minimum=0.0,
        maximum=50.0,
        unit="px",
    )


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """Edges of one image.

    Attributes
    ----------
    labels
        (H, W) uint8: FLAT, EDGE or CORNER.
    points
        (K, 2) int32 px x, y of all chains, one after another.
    starts
        (C + 1,) int64: chain i is points[starts[i]:starts[i + 1]].
    """

    labels: npt.NDArray[np.uint8]
    points: npt.NDArray[np.int32]
    starts: npt.NDArray[np.int64]

    @property
    def chains(self) -> list[npt.NDArray[np.int32]]:
        """Each (N, 2) int32 px x, y, from an end, branch or corner to the next; a closed chain ends where it starts."""
        return np.split(self.points, self.starts[1:-1].tolist()) if len(self.starts) > 1 else []


class EdgeDetector:
    """Detector of edges with one configuration; it keeps no state between images.

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

    def warm(self) -> None:
        """Compile, or load from the cache, all code needed, so that no image waits for it."""
        checks = (np.indices((64, 64)) // 16).sum(axis=0) % 2 * 100
        for dtype in (np.uint8, np.uint16, np.float32):
            self.detect(checks.astype(dtype), [(20.0, 20.0)], [100.0])

    def thinned(self, picture: npt.NDArray[Any], grey_level: float = 1.0) -> npt.NDArray[np.float32]:
        """Return the strength of every pixel that is a maximum across an edge, (H, W) float32, zero elsewhere.

        ``picture`` and ``grey_level`` are as for ``detect``; strengths are in grey levels per px.
        """
        channels, unit = self._channels(picture)
        if 0 in picture.shape[:2]:
            return np.zeros(picture.shape[:2], np.float32)
        config = self.config
        tensor = structure(channels, config.sigma_d_px)
        strength = kernels.strength_of(*tensor, config.k)
        graded = [_of_256(channel) for channel, weight in channels if weight > 0.0]
        sides = Sides(graded, config.texture, config.k)
        if config.coarse_sigma_px > 0.0:
            kernels.weigh(strength, sides.beside(config.coarse_sigma_px))
        if config.surround > 0.0:
            strength = cv2.scaleAdd(mean_around(strength, config.surround_px), -config.surround, strength)
        maxima = self._maxima(strength, tensor)
        for _ in range(_LOOKS if config.region_px > 0.0 else 0):
            weighed = strength.copy()
            kernels.weigh(weighed, sides.of_regions(maxima, config.region_px))
            maxima = self._maxima(weighed, tensor)
        return maxima if grey_level == unit else maxima * np.float32(unit / grey_level)

    def _maxima(
        self, strength: npt.NDArray[np.float32], tensor: tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]
    ) -> npt.NDArray[np.float32]:
        """Return the maxima of a strength across edges, averaged along them."""
        framed = cv2.copyMakeBorder(strength, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
        maxima = kernels.thin(framed, *tensor)
        if self.config.along_px > 0:
            kernels.mean_along(maxima, strength, *tensor, self.config.along_px)
        return np.asarray(maxima, np.float32)

    def _channels(self, picture: npt.NDArray[Any]) -> tuple[list[tuple[npt.NDArray[Any], float]], float]:
        """Return grey, or the three channels of Lab, each with the weight of its squared gradient, and their unit."""
        if picture.ndim == 3 and picture.shape[2] == 3 and picture.dtype == np.uint8:
            if picture.size == 0:
                return [], 1.0
            light, a, b = cv2.split(cv2.cvtColor(picture, cv2.COLOR_BGR2LAB))
            return [(light, 1.0), (a, self.config.color**2), (b, self.config.color**2)], 1.0
        if picture.ndim != 2:
            raise ValueError(f"expected a grey picture (H, W) or BGR (H, W, 3) uint8, got shape {picture.shape}")
        gray, unit = in_range(checked(picture), _DIM)
        return [(np.ascontiguousarray(gray, np.uint8 if gray.dtype == np.uint8 else np.float32), 1.0)], unit

    def detect(
        self,
        picture: npt.NDArray[Any],
        corners_xy: npt.ArrayLike = (),
        strengths: npt.ArrayLike | None = None,
        grey_level: float = 1.0,
    ) -> Edges:
        """Return the edges of an image.

        Parameters
        ----------
        picture
            Grey (H, W) uint8, uint16 or float32, or colour (H, W, 3) uint8, BGR.
        corners_xy
            (N, 2) px of corners at which edges end, for example from ``HarrisDetector.detect``.
        strengths
            (N,) of the corners, from ``HarrisDetector.strengths_of``. Corners below 1.5 times ``high``, or three times
            the image's noise, may be noise and end no edge. Without strengths all corners do.
        grey_level
            Size of one grey level of the settings, in values of the image.

        Raises
        ------
        ValueError
            For another shape or dtype, or a corner outside the image.
        """
        thinned, noise = self.thinned(picture, grey_level), 0.0
        if strengths is not None:
            gray = picture if picture.ndim == 2 or picture.size == 0 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            noise = noise_above(gray, _ABOVE_START * self.config.high * grey_level / ABOVE_NOISE) / grey_level
            strengths = np.asarray(strengths) / grey_level
        return self.edges_of(thinned, corners_xy, strengths, noise)

    def edges_of(
        self,
        thinned: npt.NDArray[Any],
        corners_xy: npt.ArrayLike = (),
        strengths: npt.ArrayLike | None = None,
        noise: float = 0.0,
    ) -> Edges:
        """Return the edges from the result of ``thinned`` and the image's noise: the second half of ``detect``."""
        config, values = self.config, np.ascontiguousarray(thinned, np.float32)
        bits = bitmap.blank(2, *values.shape)
        tracing.candidates(values, config.low_of_high * config.high, config.high, bits)
        ends = (
            None if strengths is None else np.asarray(strengths) >= max(_ABOVE_START * config.high, ABOVE_NOISE * noise)
        )
        return traced(bits, values.shape, config, corners_xy, ends, values, config.min_weight_px * config.high)


def traced(
    bits: npt.NDArray[np.uint8],
    shape: tuple[int, ...],
    config: TracingConfig,
    corners_xy: npt.ArrayLike,
    ends: npt.NDArray[np.bool_] | None = None,
    strength: npt.NDArray[np.float32] = _NO_STRENGTH,
    weight: float = 0.0,
) -> Edges:
    """Return the edges of an image of a shape (H, W) from its thinned pixels, like ``tracing.trace``.

    All corners (N, 2) are labelled; edges end at those set in ``ends`` (N,), or at all corners if it is None.
    """
    labels = np.zeros(shape, np.uint8)
    if 0 in shape:
        return Edges(labels, np.empty((0, 2), np.int32), np.zeros(1, np.int64))
    xy = np.asarray(corners_xy, np.float32).reshape(-1, 2)
    inside, points, starts = tracing.trace(
        bits.view(np.uint64),
        bits[0].reshape(-1),
        bitmap.wide(bits[0]),
        bitmap.wide(bits[1]),
        strength,
        config.min_length_px,
        weight,
        config.max_spur_px,
        xy,
        np.ones(len(xy), np.bool_) if ends is None else ends,
        config.max_gap_px,
        labels,
    )
    if not inside:
        raise ValueError(f"a corner lies outside the picture of {shape[1]} x {shape[0]} px")
    return Edges(labels, points, starts)


def _of_256(channel: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return a channel in 256 steps; dtypes other than uint8 have no fixed range: that of the reduced image is used."""
    if channel.dtype == np.uint8:
        return channel
    above = from_lowest(channel)
    finite = np.where(np.isfinite(above), above, np.float32(0.0))
    size = (-(-channel.shape[1] // SHRUNK), -(-channel.shape[0] // SHRUNK))
    small = cv2.resize(finite, size, interpolation=cv2.INTER_AREA)
    low, high = float(small.min()), float(small.max())
    return np.asarray(np.clip((finite - low) * (255.0 / max(high - low, 1e-9)), 0.0, 255.0), np.uint8)
