"""Agreement of edges with boundaries drawn by people, and other edge detectors for comparison.

Source: P. Arbelaez, M. Maire, C. Fowlkes, J. Malik, "Contour Detection and Hierarchical Image Segmentation", PAMI
33(5), 2011 (BSDS500): the best F-measure with one threshold for all images (ODS) and with the best threshold for each
(OIS). As in the source, as many found and drawn pixels as possible are paired one to one within 0.0075 of the diagonal;
in the source any pair costs less than none. Precision counts pixels drawn by any person, recall sums over the persons.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.edges.combined_detector import CombinedDetector
from harris_perception.core.edges.edges import EDGE, EdgeConfig, EdgeDetector, TracingConfig
from harris_perception.core.image.compiled import called, compiled

Mask = npt.NDArray[np.bool_]
Finder = Callable[[npt.NDArray[np.uint8]], Iterator[Mask]]
"""From an image (H, W, 3) uint8, BGR, to its edges at each of ``THRESHOLDS``."""

THRESHOLDS = tuple(float(value) for value in np.geomspace(0.7, 30.0, 24))
"""Strengths at which an edge starts, grey levels per px."""

_SIGMAS_PX = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0)
_REACH = 0.0075
_LOW_OF_HIGH = 0.4
_SOBEL = 8.0  # response of the kernels to a slope of one


@called
def _within_reach(found: Any, drawn: Any, offsets: Any) -> tuple[Any, Any]:
    """Return for each pixel of ``found``, in row order, the indices of the pixels of ``drawn`` at these offsets.

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
    """Pair pixel ``first`` with a drawn one along an augmenting path; return whether such a path exists.

    ``owners`` has for each drawn pixel its partner, -1 for none; pixels ``seen`` in this turn are dead ends.
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
    """Return which pixels of ``found`` (H, W) are paired with one of ``drawn``, in a pairing of maximum size.

    Pairs the nearest first, then adds one pair with each augmenting path (C. Berge, "Two Theorems in Graph Theory",
    PNAS 43(9), 1957), along which paired pixels stay paired. ``offsets`` (N, 2) are y, x, the nearest first.
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
    """Return for each threshold the numbers of found pixels, found ones that are drawn, drawn ones, drawn ones found.

    ``drawings`` are (H, W), one per person; the result is (thresholds, 4), the last two numbers summed over persons.
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
    """Return precision, recall and their harmonic mean from counts (..., 4) of ``counts_of``."""
    precision = counts[..., 1] / np.maximum(counts[..., 0], 1)
    recall = counts[..., 3] / np.maximum(counts[..., 2], 1)
    return precision, recall, 2 * precision * recall / np.maximum(precision + recall, 1e-9)


def ods_ois(counts: npt.NDArray[Any]) -> tuple[float, float]:
    """Return the F-measures ODS and OIS from the counts (images, thresholds, 4)."""
    best = counts[np.arange(len(counts)), precision_recall_f(counts)[2].argmax(axis=1)]
    return float(precision_recall_f(counts.sum(axis=0))[2].max()), float(precision_recall_f(best.sum(axis=0))[2])


def our_finders() -> dict[str, Finder]:
    """Return outlines of the colour and of the grey image, and edges of the corners' pass, with default settings."""

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
    """Return OpenCV's Canny on grey and on colour, and scikit-image's if it is installed, for several sigmas, px."""
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
    """With several channels OpenCV uses the strongest gradient."""

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
