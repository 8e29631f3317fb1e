"""Corners of a grey image by the detector of Harris and Stephens and its variants.

Sources: C. Harris, M. Stephens, "A Combined Corner and Edge Detector", Alvey Vision Conference 1988; C. Schmid, R.
Mohr, C. Bauckhage, "Evaluation of Interest Point Detectors", IJCV 37(2), 2000 (Gaussian derivatives and window); J.
Shi, C. Tomasi, "Good Features to Track", CVPR 1994; J. A. Noble, "Finding Corners", IVC 6(2), 1988; for the recursive
filters see deriche.py. The paper of 1988 computes derivatives by -1 0 1 in one row and sums in a Gaussian window. For
speed, the default here uses three rows, as J. Prewitt's kernels do, and a box window.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, overload

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners import harris_kernels as kernels
from harris_perception.core.corners.structure import structure_of
from harris_perception.core.image import bitmap, deriche
from icu_common.core.configuration.config import Config, ConfigError, setting

F32 = npt.NDArray[Any]

Band = tuple[F32, float]
BandMap = Callable[[Callable[[Callable[[], Band]], Band], Iterable[Callable[[], Band]]], Iterable[Band]]

_RESPONSES = ("harris", "shi_tomasi", "noble", "geometric")
_NO_EDGES = (0.0, 0.0, np.empty((2, 0, 0), np.uint8))


# By bytes per pixel: responses to 16 bits are 2^32 times as large as those to 8; those to float32 have any size.
_HALF = {1: np.float32(0.5), 2: np.float32(2.0**-33)}

_FAINT, _BRIGHT = 2.0**-16, 2.0**20
"""Range of image values whose responses, of the fourth power, fit into float32 with any window."""

_SPAN = 2.0**-24
"""Size of a value, relative to one of 16 bits, whose response does not fit into float32 together with the latter's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HarrisConfig(Config):
    """Settings of the detector.

    The response is in grey levels to the fourth power (``harris``) or squared (all others), summed over the kernels as
    written. ``absolute_threshold`` therefore depends on gradient and window; the relative threshold does not.
    """

    gradient: str = setting(
        "harris",
        "Derivative kernels: harris is -1 0 1 of 1988 over three rows (Prewitt's 3x3), sobel, gaussian, or "
        "deriche (recursive Gaussian)",
        choices=("harris", "sobel", "gaussian", "deriche"),
    )
    sigma_d_px: float = setting(
        1.0, "Standard deviation of the Gaussian derivative", minimum=0.5, maximum=10.0, unit="px"
    )
    window: str = setting(
        "box",
        "Window that sums the products; deriche is a recursive Gaussian, exact to a few thousandths; with "
        "relative_threshold = 0 its errors are detected as corners",
        choices=("box", "gaussian", "deriche"),
    )
    window_px: int = setting(3, "Side of the box window (odd)", minimum=3, maximum=255, unit="px")
    sigma_i_px: float = setting(2.0, "Standard deviation of the Gaussian window", minimum=0.5, maximum=20.0, unit="px")
    response: str = setting(
        "harris",
        "Response: harris is det - k trace^2, shi_tomasi the smaller eigenvalue, noble det / trace, geometric "
        "sqrt(det) times det / (det + k trace^2)",
        choices=_RESPONSES,
    )
    k: float = setting(0.04, "Weight of trace^2 in the harris and geometric responses", minimum=0.001, maximum=0.24)
    absolute_threshold: float = setting(0.0, "Response that a corner must exceed", minimum=0.0, maximum=1e300)
    relative_threshold: float = setting(
        0.01,
        "Fraction of the strongest corner's response that a corner must exceed; use 0 in the dark, where a "
        "lamp or a hot pixel suppresses all other corners",
        minimum=0.0,
        maximum=1.0,
    )
    suppression_radius_px: float = setting(
        1.0,
        "Minimum distance between two corners, of which the stronger is kept; 1 keeps the maxima of 3x3 neighbourhoods",
        minimum=1.0,
        maximum=500.0,
        unit="px",
    )
    max_corners: int = setting(
        2000, "Maximum number of corners, strongest first; 0: no limit", minimum=0, maximum=1_000_000
    )
    even_spread: bool = setting(
        False, "Increase the suppression radius until max_corners remain, so that the corners cover the image"
    )
    subpixel: bool = setting(True, "Refine each corner with a quadratic through its 3x3 responses")
    border_px: int = setting(
        0, "Minimum distance of a corner from the image border", minimum=0, maximum=10_000, unit="px"
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.window_px % 2 == 0:
            raise ConfigError(f"window_px = {self.window_px}: an odd number is needed")
        if self.even_spread and self.max_corners == 0:
            raise ConfigError("even_spread = True needs max_corners > 0, it is 0")


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Corners of one image by falling response.

    Attributes
    ----------
    xy
        (N, 2) float32 px, x right, y down, the centre of the first pixel is (0, 0).
    response
        (N,) float32, greater than zero; float64 if float32 cannot hold the responses to an image of floats.
    """

    xy: F32
    response: F32

    def __len__(self) -> int:
        return len(self.response)


class HarrisDetector:
    """Detector with one configuration; it keeps no state between images.

    Parameters
    ----------
    config
        Defaults to ``HarrisConfig()``.
    bands
        Number of bands of rows into which an image, or all images of a sequence, are cut. One is fastest unless ``run``
        works in parallel.
    run
        Function like ``map``; for several threads the ``map`` of a ``concurrent.futures.ThreadPoolExecutor``. The
        compiled passes hold no lock, so the bands of one image, or the images of a pair, then run in parallel.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.zeros((40, 40), np.uint8)
    >>> picture[10:30, 10:30] = 200
    >>> corners = HarrisDetector(HarrisConfig()).detect(picture)
    >>> sorted(corners.xy.round().astype(int).tolist())
    [[10, 10], [10, 29], [29, 10], [29, 29]]
    """

    def __init__(self, config: HarrisConfig | None = None, *, bands: int = 1, run: BandMap = map) -> None:
        if bands < 1:
            raise ValueError(f"bands = {bands}: at least 1 is needed")
        self.config = config if config is not None else HarrisConfig()
        self._bands, self._run = bands, run
        self._derivative, self._smooth = _gradient_taps(self.config)
        self._window = _window_taps(self.config)
        x = np.arange(len(self._derivative)) - len(self._derivative) // 2
        self._gain = float((self._derivative * x).sum() * self._smooth.sum() * self._window.sum())
        fusable = self.config.window == "box" and self.config.window_px == 3 and self.config.response == "harris"
        self._degree = 4 if self.config.response == "harris" else 2
        self._fused = fusable and self.config.gradient in ("harris", "sobel")

    @property
    def margin_px(self) -> int:
        """Width of the frame at the image border in which no response is computed."""
        return len(self._derivative) // 2 + len(self._window) // 2

    def warm(self) -> None:
        """Compile, or load from the cache, all code of this configuration, so that no image waits for it."""
        edge = 4 * self.margin_px + 8
        checks = (np.indices((edge, edge)) // 4).sum(axis=0) % 2
        for dtype in (np.uint8, np.uint16, np.float32):
            self.detect((checks * 100).astype(dtype))

    def response(self, gray: npt.NDArray[Any]) -> F32:
        """Return the response of every pixel, (H, W) float32; zero within ``margin_px`` of the border.

        Float32 may not hold it if the largest value is below 1e-5 or above 1e6; ``detect`` also handles such images.

        Parameters
        ----------
        gray
            (H, W) uint8, uint16 or float32.

        Raises
        ------
        ValueError
            For another shape or dtype.
        """
        return self._response(checked(gray))[0]

    def corners_of(self, response: F32) -> Corners:
        """Return the corners of a response returned by ``response``, for callers that need more than its corners."""
        border, config = max(self.margin_px + 1, self.config.border_px), self.config
        if min(response.shape) <= 2 * border:
            return self._selected([_nothing()])
        rows = (border, response.shape[0] - border)
        thresholds: tuple[Any, ...] = (config.absolute_threshold, config.relative_threshold, config.subpixel)
        return self._selected([kernels.peaks_of(np.ascontiguousarray(response), border, *rows, *thresholds)])

    def strengths_of(self, response: F32) -> F32:
        """Return the strengths of corners with these responses, in the unit of edges, (N,) float32 grey levels per px.

        The strength is (R / k)^(1/4) divided by the gain of kernels and window, as (-R / k)^(1/4) is an edge's
        strength; for other responses it is their root.
        """
        if self.config.response == "harris":
            return np.asarray((response / self.config.k) ** 0.25 / self._gain, np.float32)
        return np.asarray(np.sqrt(response) / self._gain, np.float32)

    def response_of(self, strength: float) -> float:
        """Return the response of a corner of this strength (``harris`` only); negated, it is an edge's response."""
        return float(self.config.k * (self._gain * strength) ** 4)

    def _response(self, picture: npt.NDArray[Any]) -> tuple[F32, F32, F32]:
        """Return the response, and the sums of gx^2 and gy^2 without the frame of ``margin_px``."""
        result = np.zeros(picture.shape, np.float32)
        margin = self.margin_px
        if min(picture.shape) <= 2 * margin:
            return result, result[:0, :0], result[:0, :0]
        a, b, c = self.structure(picture)
        kind = _RESPONSES.index(self.config.response)
        kernels.response_of(a, b, c, kind, self.config.k, result[margin:-margin, margin:-margin])
        return result, a, b

    def structure(self, gray: npt.NDArray[Any]) -> tuple[F32, F32, F32]:
        """Return the sums of gx^2, gy^2 and gx gy over the window, where kernels and window lie inside the image.

        Parameters
        ----------
        gray
            (H, W), both larger than twice ``margin_px``.

        Returns
        -------
        tuple
            Three of (H - 2 margin_px, W - 2 margin_px) float32, without the frame of ``margin_px``.
        """
        config, margin = self.config, self.margin_px
        if "deriche" not in (config.gradient, config.window):
            shape = (gray.shape[0] - 2 * margin, gray.shape[1] - 2 * margin)
            a, b, c = (np.empty(shape, np.float32) for _ in range(3))
            derivative, smooth, window = (
                t[len(t) // 2 :].copy() for t in (self._derivative, self._smooth, self._window)
            )
            rows = np.ascontiguousarray(gray, np.uint8 if gray.dtype == np.uint8 else np.float32)
            structure_of(rows, derivative[1:], smooth, window, a, b, c)
            return a, b, c
        source = from_lowest(gray)
        unknown = ~np.isfinite(source)
        source[unknown] = 0.0  # recursion would spread them over the whole image
        if config.gradient == "deriche":
            soft, slope = (deriche.recursive_filter(config.sigma_d_px, order) for order in (False, True))
            gx, gy = deriche.filtered(source, slope, soft), deriche.filtered(source, soft, slope)
        else:
            gx = cv2.sepFilter2D(source, cv2.CV_32F, self._derivative, self._smooth)
            gy = cv2.sepFilter2D(source, cv2.CV_32F, self._smooth, self._derivative)
        inside = np.s_[margin:-margin, margin:-margin]
        products = (gx * gx, gy * gy, gx * gy)
        if config.window == "deriche":
            soft = deriche.recursive_filter(config.sigma_i_px, False)
            a, b, c = (deriche.filtered(p, soft, soft)[inside] for p in products)
            for squares in (a, b):  # far from a step the recursion is below zero
                np.maximum(squares, 0.0, out=squares)
        else:
            a, b, c = (cv2.sepFilter2D(p, cv2.CV_32F, self._window, self._window)[inside] for p in products)
        if unknown.any():
            near = cv2.dilate(unknown.astype(np.uint8), np.ones(2 * (2 * margin + 1,), np.uint8))[inside] > 0
            a[near] = b[near] = c[near] = np.nan
        return a, b, c

    @overload
    def detect(self, gray: npt.NDArray[Any]) -> Corners: ...

    @overload
    def detect(self, gray: Sequence[npt.NDArray[Any]]) -> list[Corners]: ...

    def detect(self, gray: npt.NDArray[Any] | Sequence[npt.NDArray[Any]]) -> Corners | list[Corners]:
        """Return the corners of an image, or of each image of a sequence (a stereo pair).

        Empty and constant images, images smaller than the kernels, and the surroundings of pixels that are not finite
        have no corners.

        Parameters
        ----------
        gray
            (H, W) uint8, uint16 or float32, or a sequence of such.

        Raises
        ------
        ValueError
            For another shape or dtype.
        """
        if isinstance(gray, np.ndarray):
            return self._detect([gray])[0]
        return self._detect(gray)

    def detect_with_edges(
        self, gray: npt.NDArray[Any], low: float, high: float
    ) -> tuple[Corners, npt.NDArray[np.uint8]]:
        """Return the corners, and the pixels of edges: both halves of the detector of 1988.

        Parameters
        ----------
        gray
            (H, W) uint8, uint16 or float32.
        low, high
            Minimum strengths (-R / k)^(1/4) of a pixel and of a strong pixel; on a straight edge the strength is the
            gradient in grey levels per px.

        Returns
        -------
        tuple
            The corners, and bitmaps (2, H + 3, B) uint8 (see bitmap.py) of the pixels with R < 0 that are minima of R
            across the edge: those at least as strong as ``low``, and those at least as strong as ``high``.

        Raises
        ------
        ValueError
            For another shape or dtype, or a response other than ``harris``, which alone is negative on edges.
        """
        if self.config.response != "harris":
            raise ValueError(f"response = {self.config.response!r}: edges need 'harris'")
        if self.config.border_px > self.margin_px + 1:  # border_px applies to corners only
            whole = HarrisDetector(replace(self.config, border_px=0), bands=self._bands, run=self._run)
            return self.detect(gray), whole.detect_with_edges(gray, low, high)[1]
        picture, unit = in_range(checked(gray))
        # On a straight edge R = -k trace^2, and the trace is the squared gradient times the gain of kernels and window.
        weak, strong = (-self.response_of(max(least / unit, 1e-6)) for least in (low, max(low, high)))
        bits = bitmap.blank(2, *picture.shape)
        if self._fused:
            found = list(self._run(_call, self._tasks(picture, self._bands, unit, (weak, strong, bits))))
        else:
            response, a, b = self._response(picture)
            found = list(self._run(_call, self._tasks(picture, self._bands, unit, response=response)))
            kernels.minima_of(response, a, b, self.margin_px + 1, weak, strong, bits)
        return self._selected(found, unit), bits

    def _detect(self, pictures: Sequence[npt.NDArray[Any]]) -> list[Corners]:
        each = -(-self._bands // max(len(pictures), 1))  # as many at a time as for one image, not more
        scaled = [in_range(checked(picture)) for picture in pictures]
        tasks = [task for picture, unit in scaled for task in self._tasks(picture, each, unit)]
        found = list(self._run(_call, tasks))
        return [self._selected(found[i * each : (i + 1) * each], unit) for i, (_, unit) in enumerate(scaled)]

    def _tasks(
        self,
        picture: npt.NDArray[Any],
        bands: int,
        unit: float,
        edges: tuple[float, float, npt.NDArray[np.uint8]] = _NO_EDGES,
        response: F32 | None = None,
    ) -> list[Callable[[], Band]]:
        """Return one task for each band of rows of an image in this unit."""
        config = self.config
        border = max(self.margin_px + 1, config.border_px)
        height, width = picture.shape
        if width <= 2 * border or height <= 2 * border:
            return [_nothing] * bands
        absolute = config.absolute_threshold / unit**self._degree
        thresholds: tuple[Any, ...] = (absolute, config.relative_threshold, config.subpixel)
        if self._fused:
            rows = np.ascontiguousarray(picture, np.uint8 if picture.dtype == np.uint8 else np.float32)
            centre = self._smooth[1:2].astype(np.int16 if rows.dtype == np.uint8 else np.float32)
            find: Callable[..., Band] = partial(kernels.fused_peaks, rows, centre, border)
            thresholds = (config.k, *thresholds, _HALF.get(picture.dtype.itemsize, 0.5), *edges)
        else:
            find = partial(kernels.peaks_of, self._response(picture)[0] if response is None else response, border)
        # Two rows share half of a sum, so bands begin at even rows: rounding is then the same for any number of bands.
        limits = [*(border + (height - 2 * border) * i // bands // 2 * 2 for i in range(bands)), height - border]
        return [partial(find, first, last, *thresholds) for first, last in pairwise(limits)]

    def _selected(self, bands: Sequence[Band], unit: float = 1.0) -> Corners:
        config = self.config
        peaks = bands[0][0] if len(bands) == 1 else np.concatenate([band[0] for band in bands])
        spaced = config.even_spread or config.suppression_radius_px > 1.0
        limit = config.max_corners or len(peaks)
        xy, response = kernels.ranked(peaks, max(band[1] for band in bands), len(peaks) if spaced else limit)
        if spaced and len(xy) > 0:
            even = config.even_spread and len(xy) > limit
            find = spread if even else kernels.apart
            kept = find(xy, config.suppression_radius_px, limit)
            xy, response = xy[kept], response[kept]
        return Corners(xy, in_unit(response, unit**self._degree))


def _call(task: Callable[[], Band]) -> Band:
    return task()


def _nothing() -> Band:
    return np.empty((0, 3), np.float32), 0.0


def checked(gray: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return the image (H, W) if the detectors accept it, else raise ``ValueError``.

    A read-only image is copied: numba would compile the kernels again for read-only arrays.
    """
    if gray.ndim != 2:
        raise ValueError(f"a grey picture (H, W) is needed, not shape {gray.shape}")
    if gray.dtype.newbyteorder("=") not in (np.uint8, np.uint16, np.float32):
        raise ValueError(f"uint8, uint16 or float32 is needed, not {gray.dtype}")
    return gray if gray.flags.writeable else gray.copy()


def in_range(gray: npt.NDArray[Any], least: float = _FAINT) -> tuple[npt.NDArray[Any], float]:
    """Return a checked image (H, W) in a unit in which float32 holds its responses, and that unit.

    The unit is a power of two, so nothing is rounded. It is 1 except for floats whose largest value is below ``least``
    or huge. It is also 1 if only a few values are huge relative to the others, such as placeholders for unknown values.
    """
    if gray.dtype.kind != "f" or gray.size == 0:
        return gray, 1.0
    top = max(-float(np.fmin.reduce(gray, axis=None)), float(np.fmax.reduce(gray, axis=None)))
    if not math.isfinite(top):
        top = float(np.where(np.isfinite(gray), np.abs(gray), np.float32(0.0)).max())
    if top == 0.0 or least <= top <= _BRIGHT:
        return gray, 1.0
    exponent = math.frexp(top)[1] - 16
    if top > _BRIGHT:
        sizes = np.abs(gray[np.isfinite(gray) & (gray != 0.0)])
        if math.ldexp(float(np.median(sizes)), -exponent) < _SPAN:
            return gray, 1.0
    return np.ldexp(gray, -exponent), math.ldexp(1.0, exponent)


def in_unit(response: F32, unit: float) -> F32:
    """Return positive responses times a unit, float32 if it holds all of them, else float64."""
    if unit == 1.0:
        return response
    values = response.astype(np.float64) * unit
    held = np.finfo(np.float32)
    return values if ((values < held.tiny) | (values > held.max)).any() else values.astype(np.float32)


def from_lowest(gray: npt.NDArray[Any]) -> F32:
    """Return an image (H, W) minus its lowest finite value, float32.

    Gradients do not change, but rounding in earlier steps grows with the values: on a constant image rounding errors
    would be detected as corners.
    """
    values = gray.astype(np.float32)
    lowest = np.min(values, where=np.isfinite(values), initial=np.float32(np.inf))
    return np.asarray(values - lowest, np.float32) if np.isfinite(lowest) else values


def gaussian_taps(sigma: float) -> F32:
    """Return the weights (2 ceil(3 sigma) + 1,) of a sampled Gaussian of ``sigma`` px, cut at three sigma, sum one."""
    x = np.arange(-math.ceil(3.0 * sigma), math.ceil(3.0 * sigma) + 1)
    weights = np.exp(-0.5 * (x / sigma) ** 2)
    return np.array(weights / weights.sum(), np.float32)


def gaussian_derivative_taps(sigma: float) -> F32:
    """Return the weights (for correlation) of a Gaussian's derivative; a ramp of slope one gives one."""
    x = np.arange(-math.ceil(3.0 * sigma), math.ceil(3.0 * sigma) + 1)
    weights = x * np.exp(-0.5 * (x / sigma) ** 2)
    return np.array(weights / (weights * x).sum(), np.float32)


def _gradient_taps(config: HarrisConfig) -> tuple[F32, F32]:
    if config.gradient in ("gaussian", "deriche"):  # with recursion the taps only give the margin
        return gaussian_derivative_taps(config.sigma_d_px), gaussian_taps(config.sigma_d_px)
    smooth = (1, 1, 1) if config.gradient == "harris" else (1, 2, 1)
    return np.array((-1, 0, 1), np.float32), np.array(smooth, np.float32)


def _window_taps(config: HarrisConfig) -> F32:
    if config.window in ("gaussian", "deriche"):
        return gaussian_taps(config.sigma_i_px)
    return np.ones(config.window_px, np.float32)


def spread(xy: F32, least: float, limit: int) -> npt.NDArray[np.int64]:
    """Return ``limit`` indices of corners (N, 2) px, strongest first, at the largest distance, at least ``least`` px.

    The distance that leaves this number is found by bisection (Bailo, PRL 106, 2018).
    """
    low, high = least, float(np.hypot(*np.ptp(xy, axis=0))) + least
    best = kernels.apart(xy, low, limit)
    while high - low > 0.25 and len(best) == limit:
        middle = 0.5 * (low + high)
        tried = kernels.apart(xy, middle, limit)
        if len(tried) == limit:
            low, best = middle, tried
        else:
            high = middle
    return best
