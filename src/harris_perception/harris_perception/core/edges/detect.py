"""Corners and edges of one image with one call each: the package's public functions.

Programs that see many images keep a :class:`~harris_perception.core.corners.harris.HarrisDetector` and an
:class:`~harris_perception.core.edges.edges.EdgeDetector` instead.
"""

from __future__ import annotations

from typing import Any

import numpy.typing as npt

from harris_perception.core.corners.harris import Corners, HarrisConfig, HarrisDetector
from harris_perception.core.edges.edges import EdgeConfig, EdgeDetector, Edges
from harris_perception.core.image.gray import gray_of


def detect_corners(picture: npt.NDArray[Any], **settings: Any) -> Corners:
    """Return the Harris corners of an image, strongest first.

    Parameters
    ----------
    picture
        Grey (H, W) uint8, uint16 or float32, or colour (H, W, 3) uint8, BGR.
    settings
        Fields of ``HarrisConfig``, for example ``max_corners=500``.

    Raises
    ------
    ConfigError, TypeError
        For a value outside its range, or an unknown setting.
    ValueError
        For another shape or dtype.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.zeros((40, 40), np.uint8)
    >>> picture[10:30, 10:30] = 200
    >>> sorted(detect_corners(picture).xy.round().astype(int).tolist())
    [[10, 10], [10, 29], [29, 10], [29, 29]]
    """
    return HarrisDetector(HarrisConfig(**settings)).detect(_gray(picture))


def detect_edges(picture: npt.NDArray[Any], **settings: Any) -> Edges:
    """Return the outlines of an image as chains of pixels that end at its Harris corners.

    Parameters
    ----------
    picture
        As for :func:`detect_corners`; with colour, outlines between colours of equal brightness count as well.
    settings
        Fields of ``EdgeConfig``, for example ``min_length_px=20``.

    Raises
    ------
    ConfigError, TypeError
        For a value outside its range, or an unknown setting.
    ValueError
        For another shape or dtype.

    Examples
    --------
    >>> import numpy as np
    >>> picture = np.zeros((60, 60), np.uint8)
    >>> picture[15:45, 15:45] = 200
    >>> len(detect_edges(picture).chains)
    4
    """
    detector = HarrisDetector()
    corners = detector.detect(_gray(picture))
    return EdgeDetector(EdgeConfig(**settings)).detect(picture, corners.xy, detector.strengths_of(corners.response))


def _gray(picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return gray_of(picture, "bgr8") if picture.ndim == 3 else picture
