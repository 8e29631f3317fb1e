"""How well edges agree with boundaries that people drew, and the edges of others to compare with.

Source: P. Arbelaez, M. Maire, C. Fowlkes, J. Malik, "Contour Detection and Hierarchical Image Segmentation", PAMI
33(5), 2011 (BSDS500): the best F-measure of one threshold for all pictures (ODS) and of the best for each (OIS). As
many found and drawn pixels as can be are paired one to one within 0.0075 of the diagonal, as theirs are, where no pair
costs as much as none; precision counts what any person drew, recall sums over the persons.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.compiled import called, compiled
from harris_perception.core.edges import EDGE, CombinedDetector, EdgeConfig, EdgeDetector, TracingConfig

Mask = npt.NDArray[np.bool_]
Finder = Callable[[npt.NDArray[np.uint8]], Iterator[Mask]]
"""From a picture (H, W, 3) uint8, BGR, to its edges at each of ``THRESHOLDS``."""

THRESHOLDS = tuple(float(value) for value in np.geomspace(0.7, 30.0, 24))
"""Strengths that start an edge, grey levels per px."""

_SIGMAS_PX = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0)
_REACH = 0.0075
_LOW_OF_HIGH = 0.4
_SOBEL = 8.0  # answer of the kernels to a slope of one


@called
def _within_reach(found: Any, drawn: Any, offsets: Any) -> tuple[Any, Any]:
    """Return for each pixel of ``found``, in the order of rows, the places of ``drawn`` at these offsets.

    Those of pixel i are places[starts[i]:starts[i + 1]], row times width plus column, in the order of offsets.
    """
    ys, xs = np.nonzero(found)
    height, width = found.shape
    starts, places = np.zeros(len(ys) + 1, np.int64), np.empty(len(ys) * len(offsets), np.int32)
    count = 0
    for i in range(len(ys)):
        for o in range(len(offsets)):
            y, x = ys[i] + offsets[o, 0], xs[i] + offsets[o, 1]
            if 0 <= y < height and 0 <= x < width and drawn[y, x]:
                places[count] = y * width + x
                count += 1
        starts[i + 1] = count
    return starts, places


@called
def _one_more(first: int, starts: Any, places: Any, owners: Any, seen: Any, turn: int) -> bool:
    """Give pixel ``first`` a drawn one, along a path on which others change theirs; tell whether there is one.

    ``owners`` tells of each place whose it is, -1 for nobody's; places that are ``seen`` in this turn led nowhere.
    """
    path, tried, taken = [first], [starts[first]], [np.int32(0)]
    while len(path) > 0:
        last = path[-1]
        if tried[-1] == starts[last + 1]:
            path.pop()
            tried.pop()
            taken.pop()
            continue
        place = places[tried[-1]]
        tried[-1] += 1
        if seen[place] == turn:
            continue
        seen[place] = turn
        taken[-1] = place
        if owners[place] < 0:
            for i in range(len(path)):
                owners[taken[i]] = path[i]
            return True
        path.append(owners[place])
        tried.append(starts[owners[place]])
        taken.append(place)
    return False


@compiled
def matched(found: Any, drawn: Any, offsets: Any) -> Any:
    """Return which pixels of ``found`` (H, W) got one of ``drawn``, where as many get one as can.

    The nearest pairs first, then one more by each augmenting path (C. Berge, "Two Theorems in Graph Theory", PNAS
    43(9), 1957), on which all that have one keep one. ``offsets`` (N, 2) are y, x, the nearest first.
    """
    starts, places = _within_reach(found, drawn, offsets)
    height, width = found.shape
    ys, xs = np.nonzero(found)
    owners, seen = np.full(found.size, -1, np.int64), np.zeros(found.size, np.int32)
    taken = np.zeros(found.shape, np.bool_)
    for o in range(len(offsets)):
        for i in range(len(ys)):
            y, x = ys[i] + offsets[o, 0], xs[i] + offsets[o, 1]
            inside = 0 <= y < height and 0 <= x < width
            if not taken[ys[i], xs[i]] and inside and drawn[y, x] and owners[y * width + x] < 0:
                taken[ys[i], xs[i]] = True
                owners[y * width + x] = i
    turn, more = 0, True
    while more:
        turn, more = turn + 1, False
        for i in range(len(ys)):
            if not taken[ys[i], xs[i]] and _one_more(i, starts, places, owners, seen, turn):
                taken[ys[i], xs[i]] = more = True
    return taken


def counts_of(finder: Finder, picture: npt.NDArray[np.uint8], drawings: list[Mask]) -> npt.NDArray[np.int64]:
    """Return for each threshold how many pixels were found, of these drawn by anyone, drawn, and of these found.

    ``drawings`` are (H, W), one for each person; the result is (thresholds, 4), both last numbers summed over them.
    """
    radius = _REACH * float(np.hypot(*picture.shape[:2]))
    span = np.arange(-int(radius), int(radius) + 1)
    offsets = np.array([(y, x) for y in span for x in span if y * y + x * x <= radius * radius])
    offsets = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
    rows = []
    for found in finder(picture):
        hits = [matched(found, drawn, offsets) for drawn in drawings]
        right = np.logical_or.reduce(hits)
        rows.append((found.sum(), right.sum(), sum(d.sum() for d in drawings), sum(h.sum() for h in hits)))
    return np.array(rows, np.int64)


def precision_recall_f(counts: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Return precision, recall and their harmonic mean from counts (..., 4) as of ``counts_of``."""
    precision = counts[..., 1] / np.maximum(counts[..., 0], 1)
    recall = counts[..., 3] / np.maximum(counts[..., 2], 1)
    return precision, recall, 2 * precision * recall / np.maximum(precision + recall, 1e-9)


def ods_ois(counts: npt.NDArray[Any]) -> tuple[float, float]:
    """Return both best F-measures from the counts (pictures, thresholds, 4)."""
    best = counts[np.arange(len(counts)), precision_recall_f(counts)[2].argmax(axis=1)]
    return float(precision_recall_f(counts.sum(axis=0))[2].max()), float(precision_recall_f(best.sum(axis=0))[2])


def our_finders() -> dict[str, Finder]:
    """Return outlines of the color picture and of the grey one, and edges of the corners' pass, by default settings."""

    def outlines(picture: npt.NDArray[np.uint8]) -> Iterator[Mask]:
        thinned = EdgeDetector().thinned(picture)
        for threshold in THRESHOLDS:
            yield EdgeDetector(EdgeConfig(high=threshold)).edges_of(thinned).labels == EDGE

    def combined(picture: npt.NDArray[np.uint8]) -> Iterator[Mask]:
        for threshold in THRESHOLDS:
            yield CombinedDetector(edges=TracingConfig(high=threshold)).detect(_gray(picture))[1].labels == EDGE

    def of_gray(picture: npt.NDArray[np.uint8]) -> Iterator[Mask]:
        return outlines(_gray(picture))

    return {"outlines, color": outlines, "outlines, grey": of_gray, "combined, grey": combined}


def peer_finders() -> dict[str, dict[float, Finder]]:
    """Return OpenCV's Canny on grey and on color, and scikit-image's where it is installed, for some sigmas, px."""
    peers = {
        "cv2.Canny": {sigma: _opencv_canny(sigma, color=False) for sigma in _SIGMAS_PX},
        "cv2.Canny on color": {sigma: _opencv_canny(sigma, color=True) for sigma in _SIGMAS_PX},
    }
    try:
        from skimage.feature import canny
    except ImportError:
        return peers

    def of_skimage(sigma: float) -> Finder:
        def edges(picture: npt.NDArray[np.uint8]) -> Iterator[Mask]:
            gray = _gray(picture).astype(np.float32)
            for threshold in THRESHOLDS:
                yield canny(gray, sigma, _LOW_OF_HIGH * _SOBEL * threshold, _SOBEL * threshold)

        return edges

    return peers | {"skimage canny": {sigma: of_skimage(sigma) for sigma in _SIGMAS_PX}}


def _opencv_canny(sigma: float, *, color: bool) -> Finder:
    """Of several channels OpenCV takes the strongest gradient."""

    def edges(picture: npt.NDArray[np.uint8]) -> Iterator[Mask]:
        values = (picture if color else _gray(picture)).astype(np.float32)
        soft = cv2.GaussianBlur(values, (0, 0), sigma)
        dx, dy = (
            cv2.Sobel(soft, cv2.CV_32F, *order).clip(-32768, 32767).astype(np.int16) for order in ((1, 0), (0, 1))
        )
        for threshold in THRESHOLDS:
            yield cv2.Canny(dx, dy, _LOW_OF_HIGH * _SOBEL * threshold, _SOBEL * threshold, L2gradient=True) > 0

    return edges


def _gray(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
