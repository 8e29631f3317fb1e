"""Difference between the two sides of an edge: between the adjacent areas, and between the regions it separates.

Values are coded by their shares in overlapping bins (the channel representation of G. Granlund), the texture by the
second difference of the brightness. The areas adjacent to an edge are averaged by a Gaussian, like local histograms.
Regions are averaged by a random walk that hardly crosses strong edges: the diffusion of P. Perona, J. Malik (PAMI
12(7), 1990). Its conductivity depends on edges found before. It runs in implicit steps along rows and columns
alternately (N. Yanenko, "The Method of Fractional Steps", 1971).
"""

from __future__ import annotations

from functools import cached_property, reduce
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.taps import gaussian_taps
from harris_perception.core.edges import edge_kernels as kernels

Picture = npt.NDArray[np.float32]

SHRUNK = 4
"""Factor by which the image is reduced to compare sides: width and height of a cell in pixels."""

_REACH = 2
_WAYS = [(distance * x, distance * y) for distance in (1, _REACH) for x, y in ((1, 0), (0, 1), (1, 1), (1, -1))]
"""Offsets (x, y) in px of the second differences that measure texture: twice a pixel minus two opposite ones."""

_BENT = 12
"""Grey levels at which a second difference is clipped, so that texture counts, not contrast."""

_STEPS = 3
"""Number of implicit steps of a walk; more give the same edges."""

_CLOSED = 0.2
"""Scale of the conductivity exp(-p / 0.2) of an edge with probability p, 0 to 1."""

_STRONG = 0.8
"""Quantile of the image's edge strengths at which an edge has the probability one half."""

_STEP_CELLS = 0.5
"""Standard deviation, in cells, of the smoothing of a step between two regions before its gradient is computed."""

_OF_REGIONS = 10.0
"""Factor for differences of regions, which are smaller than those of adjacent areas; it keeps the scale of
strengths."""


def _bins(low: float, high: float, count: int) -> Picture:
    """Return the membership of each of 256 values in each of ``count`` overlapping bins, (count, 256)."""
    values, centres = np.clip(np.arange(256.0), low, high), np.linspace(low, high, count)
    share = np.abs(values - centres[:, None]) / (centres[1] - centres[0])
    return np.asarray(np.maximum(1.0 - share, 0.0), np.float32)


_LIGHT_BINS = _bins(0.0, 255.0, 8)
_COLOR_BINS = _bins(88.0, 168.0, 8)  # colours of photographs are near grey, which is 128


def structure(channels: list[tuple[npt.NDArray[Any], float]], sigma_px: float) -> tuple[Picture, Picture, Picture]:
    """Return the weighted sum of the structure tensors of channels (H, W) as gx^2, gy^2, gx gy."""
    taps = np.asarray(gaussian_taps(sigma_px), np.float32)
    a, b, c = (np.zeros(channels[0][0].shape, np.float32) for _ in range(3))
    for channel, weight in channels:
        kernels.add_structure(channel, taps[len(taps) // 2 :], weight, a, b, c)
    return a, b, c


class Sides:
    """Code of one image, at a quarter of its size and computed on demand, from which differences are computed.

    Parameters
    ----------
    channels
        Brightness and, if available, colours, (H, W) uint8 each.
    texture
        Weight of texture relative to values.
    k
        Weight of trace^2 in the response that measures a difference.
    """

    def __init__(self, channels: list[npt.NDArray[np.uint8]], texture: float, k: float) -> None:
        height, width = channels[0].shape
        self._size, self._k = (width, height), k
        self._channels, self._texture = channels, texture

    @cached_property
    def _code(self) -> list[Picture]:
        cells = (-(-self._size[0] // SHRUNK), -(-self._size[1] // SHRUNK))
        code: list[Picture] = []
        for number, channel in enumerate(self._channels):
            small = cv2.resize(channel, cells, interpolation=cv2.INTER_AREA)
            bins = _COLOR_BINS if number else _LIGHT_BINS
            code += [np.asarray(cv2.LUT(small, table), np.float32) for table in bins]
        if self._texture > 0.0:
            share = np.float32(self._texture / (_BENT * (255 // _BENT)))
            small_bends = (cv2.resize(bent, cells, interpolation=cv2.INTER_AREA) for bent in _bends(self._channels[0]))
            code += [np.asarray(bent * share, np.float32) for bent in small_bends]
        return code

    def beside(self, sigma_px: float) -> Picture:
        """Return the difference between the sides of each pixel at a scale, (H, W), about 1 for nothing in common."""
        sigma = sigma_px / SHRUNK
        # A smoothed step between two bins has a gradient of sqrt(2) / (sigma sqrt(2 pi)).
        return self._difference(self._code, max(sigma, 0.3), float(np.sqrt(np.pi)) * sigma)

    def of_regions(self, thinned: Picture, reach_px: float) -> Picture:
        """Return the difference between the regions on both sides of each pixel, (H, W).

        Parameters
        ----------
        thinned
            (H, W) strengths of known edges, which a walk hardly crosses; zero elsewhere.
        reach_px
            Range of a walk (sigma along each axis) without edges.
        """
        found = thinned[thinned > 0.0]
        strong = max(float(np.quantile(found, _STRONG)), 1e-3) if found.size else 1.0
        squares = _most_of_cells(thinned) ** 2
        walked = _walked(self._code, squares / (squares + np.float32(strong**2)), (reach_px / SHRUNK) ** 2 / 2.0)
        return self._difference(walked, _STEP_CELLS, _OF_REGIONS)

    def _difference(self, code: list[Picture], sigma: float, scale: float) -> Picture:
        """Return ``scale`` times the gradient of a code smoothed by ``sigma`` cells, in the size of the image."""
        tensor = structure([(each, 1.0) for each in code], sigma)
        strength = kernels.strength_of(*tensor, self._k) * np.float32(scale)
        return np.asarray(cv2.resize(strength, self._size, interpolation=cv2.INTER_LINEAR))


def _bends(light: npt.NDArray[np.uint8]) -> list[npt.NDArray[np.uint8]]:
    """Return the second differences of an image in each direction; a step affects few pixels, so texture dominates."""
    framed = cv2.copyMakeBorder(light, _REACH, _REACH, _REACH, _REACH, cv2.BORDER_REFLECT)
    return [kernels.bends(framed, _REACH, *way, _BENT) for way in _WAYS]


def _most_of_cells(values: Picture) -> Picture:
    """Return the maximum of each cell's pixels, so that no thin line is lost."""
    whole = np.pad(values, [(0, -length % SHRUNK) for length in values.shape])
    return reduce(np.maximum, (whole[y::SHRUNK, x::SHRUNK] for y in range(SHRUNK) for x in range(SHRUNK)))


def _walked(code: list[Picture], sure: Picture, time: float) -> list[Picture]:
    """Return each of ``code`` (h, w) averaged by a walk of duration ``time`` (cells^2) between edges 0 to 1 (h, w)."""
    cells = np.stack(code, axis=2)  # one cell's values are contiguous and are processed together
    right, down = np.zeros_like(sure), np.zeros_like(sure)
    right[:, :-1] = np.exp(np.maximum(sure[:, 1:], sure[:, :-1]) / -_CLOSED)
    down[:-1] = np.exp(np.maximum(sure[1:], sure[:-1]) / -_CLOSED)
    kernels.walk(cells, right * np.float32(time / _STEPS), down * np.float32(time / _STEPS), _STEPS)
    return [np.ascontiguousarray(each) for each in np.moveaxis(cells, 2, 0)]
