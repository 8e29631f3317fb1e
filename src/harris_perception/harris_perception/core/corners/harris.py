"""Corners of a grey image by the detector of Harris and Stephens and its variants.

Sources: C. Harris, M. Stephens, "A Combined Corner and Edge Detector", Alvey Vision Conference 1988; C. Schmid, R.
Mohr, C. Bauckhage, "Evaluation of Interest Point Detectors", IJCV 37(2), 2000 (Gaussian derivatives and window); J.
Shi, C. Tomasi, "Good Features to Track", CVPR 1994; J. A. Noble, "Finding Corners", IVC 6(2), 1988. The paper of 1988
computes derivatives by -1 0 1 in one row and sums in a Gaussian window. For speed, the default here uses three rows, as
J. Prewitt's kernels do, and a box window.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from harris_perception.core.corners import harris_kernels, peak_kernels, response_kernels
from harris_perception.core.corners.ranking import ranked
from harris_perception.core.corners.spacing import apart, spread
from harris_perception.core.corners.structure_matrix import StructureMatrix
from harris_perception.core.corners.value_range import checked, in_range, in_unit
from harris_perception.core.image import bitmap
from icu_common.core.configuration.config import Config, ConfigError, setting

F32 = npt.NDArray[Any]

Band = tuple[F32, float]
BandMap = Callable[[Callable[[Callable[[], Band]], Band], Iterable[Callable[[], Band]]], Iterable[Band]]

_RESPONSES = ("harris", "shi_tomasi", "noble", "geometric")
_NO_EDGES = (0.0, 0.0, np.empty((2, 0, 0), np.uint8))

# By bytes per pixel: responses to 16 bits are 2^32 times as large as those to 8; those to float32 have any size.
_HALF = {1: np.float32(0.5), 2: np.float32(2.0**-33)}


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
            raise ConfigError(f"window_px = {self.window_px}; expected an odd number")
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

    Attributes
    ----------
    structure
        The structure matrix from which the response is computed.

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
            raise ValueError(f"bands = {bands}; expected at least 1")
        self.config = config if config is not None else HarrisConfig()
        self._bands, self._run = bands, run
        self.structure = StructureMatrix(
            gradient=self.config.gradient,
            sigma_d_px=self.config.sigma_d_px,
            window=self.config.window,
            window_px=self.config.window_px,
            sigma_i_px=self.config.sigma_i_px,
        )
        fusable = self.config.window == "box" and self.config.window_px == 3 and self.config.response == "harris"
        self._degree = 4 if self.config.response == "harris" else 2
        self._fused = fusable and self.config.gradient in ("harris", "sobel")

    @property
    def margin_px(self) -> int:
        """Width of the frame at the image border in which no response is computed."""
        return self.structure.margin_px

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
        return self._selected([peak_kernels.peaks_of(np.ascontiguousarray(response), border, *rows, *thresholds)])

    def strengths_of(self, response: F32) -> F32:
        """Return the strengths of corners with these responses, in the unit of edges, (N,) float32 grey levels per px.

        The strength is (R / k)^(1/4) divided by the gain of kernels and window, as (-R / k)^(1/4) is an edge's
        strength; for other responses it is their root.
        """
        if self.config.response == "harris":
            return np.asarray((response / self.config.k) ** 0.25 / self.structure.gain, np.float32)
        return np.asarray(np.sqrt(response) / self.structure.gain, np.float32)

    def response_of(self, strength: float) -> float:
        """Return the response of a corner of this strength (``harris`` only); negated, it is an edge's response."""
        return float(self.config.k * (self.structure.gain * strength) ** 4)

    def _response(self, picture: npt.NDArray[Any]) -> tuple[F32, F32, F32]:
        """Return the response, and the sums of gx^2 and gy^2 without the frame of ``margin_px``."""
        result = np.zeros(picture.shape, np.float32)
        margin = self.margin_px
        if min(picture.shape) <= 2 * margin:
            return result, result[:0, :0], result[:0, :0]
        a, b, c = self.structure(picture)
        kind = _RESPONSES.index(self.config.response)
        response_kernels.response_of(a, b, c, kind, self.config.k, result[margin:-margin, margin:-margin])
        return result, a, b

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
            across the edge. The first bitmap has those at least as strong as ``low``, the second those at least as
            strong as ``high``.

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
            response_kernels.minima_of(response, a, b, self.margin_px + 1, weak, strong, bits)
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
            centre = self.structure.smooth[1:2].astype(np.int16 if rows.dtype == np.uint8 else np.float32)
            find: Callable[..., Band] = partial(harris_kernels.fused_peaks, rows, centre, border)
            thresholds = (config.k, *thresholds, _HALF.get(picture.dtype.itemsize, 0.5), *edges)
        else:
            find = partial(peak_kernels.peaks_of, self._response(picture)[0] if response is None else response, border)
        # Two rows share half of a sum, so bands begin at even rows: rounding is then the same for any number of bands.
        limits = [*(border + (height - 2 * border) * i // bands // 2 * 2 for i in range(bands)), height - border]
        return [partial(find, first, last, *thresholds) for first, last in pairwise(limits)]

    def _selected(self, bands: Sequence[Band], unit: float = 1.0) -> Corners:
        config = self.config
        peaks = bands[0][0] if len(bands) == 1 else np.concatenate([band[0] for band in bands])
        spaced = config.even_spread or config.suppression_radius_px > 1.0
        limit = config.max_corners or len(peaks)
        xy, response = ranked(peaks, max(band[1] for band in bands), len(peaks) if spaced else limit)
        if spaced and len(xy) > 0:
            even = config.even_spread and len(xy) > limit
            find = spread if even else apart
            kept = find(xy, config.suppression_radius_px, limit)
            xy, response = xy[kept], response[kept]
        return Corners(xy, in_unit(response, unit**self._degree))


def _call(task: Callable[[], Band]) -> Band:
    return task()


def _nothing() -> Band:
    return np.empty((0, 3), np.float32), 0.0
