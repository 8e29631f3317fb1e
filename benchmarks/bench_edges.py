"""Edges against human drawings (BSDS500 form): best F-measure of one threshold for all (ODS) and of the best for each
picture (OIS), beside OpenCV's and scikit-image's Canny at their best sigma; and the cost of edges beside corners.

Needs a folder of <name>.jpg and <name>.mat, by default edges/ in the data folder. Found and drawn pixels are matched
one to one, nearest first, within 0.0075 of the diagonal; precision counts what any person drew, recall sums over the
persons. Ours has its default settings, for grey and for color alike. They were chosen for the highest ODS and OIS on
every second picture by name (the first, the third, ...) of twenty of the train part; the report is about the others,
and the peers get the sigma that is best on those. Twenty pictures are few: the halves differ by more than we do.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numba
import numpy as np
from bench_harris import SIZES, picture
from rows import Row, bound, data_folder, interleaved_ms, row, tune_malloc, write

from harris_perception.core.edges import EDGE, CombinedDetector, EdgeConfig, EdgeDetector
from harris_perception.core.harris import HarrisDetector

Maps = Callable[[np.ndarray], Iterator[np.ndarray]]
LEVELS = np.geomspace(0.7, 30.0, 24)


@numba.njit(cache=True)
def matched(found: np.ndarray, drawn: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Return which found pixels got a drawn one, nearest pairs first."""
    free, taken = drawn.copy(), np.zeros(found.shape, np.bool_)
    ys, xs = np.nonzero(found)
    for o in range(len(offsets)):
        for i in range(len(ys)):
            y, x = ys[i] + offsets[o, 0], xs[i] + offsets[o, 1]
            if not taken[ys[i], xs[i]] and 0 <= y < found.shape[0] and 0 <= x < found.shape[1] and free[y, x]:
                taken[ys[i], xs[i]] = True
                free[y, x] = False
    return taken


def gray_of(picture: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)


def harris(picture: np.ndarray) -> Iterator[np.ndarray]:
    thinned = EdgeDetector().thinned(picture)
    for level in LEVELS:
        yield EdgeDetector(EdgeConfig(high=float(level))).edges_of(thinned).labels == EDGE


def harris_on_gray(picture: np.ndarray) -> Iterator[np.ndarray]:
    return harris(gray_of(picture))


def opencv_canny(sigma: float) -> Maps:
    def maps(picture: np.ndarray) -> Iterator[np.ndarray]:
        return opencv_canny_on_color(sigma)(gray_of(picture))

    return maps


def opencv_canny_on_color(sigma: float) -> Maps:
    """Of several channels OpenCV takes the strongest gradient."""

    def maps(picture: np.ndarray) -> Iterator[np.ndarray]:
        soft = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), sigma)
        dx, dy = (cv2.Sobel(soft, cv2.CV_32F, *d).clip(-32768, 32767).astype(np.int16) for d in ((1, 0), (0, 1)))
        for level in LEVELS:
            yield cv2.Canny(dx, dy, 0.4 * 8 * level, 8 * level, L2gradient=True) > 0

    return maps


def skimage_canny(sigma: float) -> Maps | None:
    try:
        from skimage.feature import canny
    except ImportError:
        return None

    def maps(picture: np.ndarray) -> Iterator[np.ndarray]:
        gray = gray_of(picture)
        for level in LEVELS:
            yield canny(gray.astype(np.float32), sigma, 0.4 * 8 * level / 2, 8 * level / 2)

    return maps


def score(maps: Maps, pictures: list[tuple[np.ndarray, list[np.ndarray]]]) -> tuple[float, float]:
    """Return ODS and OIS."""
    counts = np.zeros((len(pictures), len(LEVELS), 4))  # found, right, drawn, met
    for p, (photograph, drawings) in enumerate(pictures):
        radius = 0.0075 * np.hypot(*photograph.shape[:2])
        span = np.arange(-int(radius), int(radius) + 1)
        offsets = np.array([(y, x) for y in span for x in span if y * y + x * x <= radius * radius])
        offsets = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
        for level, found in enumerate(maps(photograph)):
            right = np.zeros(found.shape, bool)
            met = 0
            for drawn in drawings:
                hit = matched(found, drawn, offsets)
                right |= hit
                met += int(hit.sum())
            counts[p, level] = found.sum(), right.sum(), sum(int(d.sum()) for d in drawings), met

    def f(c: np.ndarray) -> np.ndarray:
        precision, recall = c[..., 1] / np.maximum(c[..., 0], 1), c[..., 3] / np.maximum(c[..., 2], 1)
        return 2 * precision * recall / np.maximum(precision + recall, 1e-9)

    best = counts[np.arange(len(pictures)), f(counts).argmax(axis=1)]
    return float(f(counts.sum(axis=0)).max()), float(f(best.sum(axis=0)))


def load(folder: Path, limit: int) -> list[tuple[np.ndarray, list[np.ndarray]]]:
    from scipy.io import loadmat

    result = []
    for path in sorted(folder.glob("*.mat"))[:limit]:
        truth = loadmat(str(path))["groundTruth"].ravel()
        drawings = [np.ascontiguousarray(t["Boundaries"][0, 0].astype(bool)) for t in truth]
        result.append((cv2.imread(str(path.with_suffix(".jpg"))), drawings))
    return result


def quality(folder: Path, limit: int) -> list[Row]:
    pictures = load(folder, limit)
    rows = []
    for half, part in (("held out", pictures[1::2]), ("used for the choice", pictures[::2])):
        rows += _rows(f"{len(part)} pictures {half}", part)
    return rows


def _rows(what: str, pictures: list[tuple[np.ndarray, list[np.ndarray]]]) -> list[Row]:
    peers: dict[str, tuple[float, float]] = {}
    makers = {"cv2.Canny": opencv_canny, "skimage canny": skimage_canny, "cv2.Canny on color": opencv_canny_on_color}
    for library, make in makers.items():
        tried = {s: score(m, pictures) for s in (1.5, 2.0, 2.5, 3.0, 4.0) if (m := make(s)) is not None}
        if tried:
            best = max(tried, key=lambda s: tried[s][0])
            peers[f"{library}, best sigma {best}"] = tried[best]
    rows = []
    for ours, maps in (("grey", harris_on_gray), ("color", harris)):
        ods, ois = score(maps, pictures)
        for name, (a, b) in peers.items():
            if "color" in name and ours == "grey":
                continue
            rows.append(row(f"{what}, {ours}: ODS", ods, a, name, higher_is_better=True))
            rows.append(row(f"{what}, {ours}: OIS", ois, b, name, higher_is_better=True))
            rows.append(bound(f"{what}, {ours}: ODS ahead of {name} [points]", 100 * (ods - a), 3.0, at_least=True))
            rows.append(bound(f"{what}, {ours}: OIS ahead of {name} [points]", 100 * (ois - b), 3.0, at_least=True))
    return rows


def speed() -> list[Row]:
    """Time of the combined pass beside the corners alone, which it contains, and of outlines."""
    cv2.setNumThreads(1)
    rows = []
    corners, combined, outlines = HarrisDetector(), CombinedDetector(), EdgeDetector()
    for width, height in SIZES:
        gray = picture(width, height)
        xy = corners.detect(gray).xy
        ms = interleaved_ms(
            {
                "corners": lambda gray=gray: corners.detect(gray),
                "combined": lambda gray=gray: combined.detect(gray),
                "outlines": lambda gray=gray, xy=xy: outlines.detect(gray, xy),
                "canny": lambda gray=gray: cv2.Canny(gray, 80, 160, L2gradient=True),
                "soft canny": lambda gray=gray: cv2.Canny(cv2.GaussianBlur(gray, (0, 0), 2.0), 10, 30, L2gradient=True),
            },
            repeats=20,
        )
        what = f"{width}x{height}, {(combined.detect(gray)[1].labels == EDGE).sum()} px of edges"
        rows += [
            bound(f"{what}: combined pass / corners alone", ms["combined"] / ms["corners"], 2.0),
            row(
                f"{what}: combined - corners [ms]",
                ms["combined"] - ms["corners"],
                ms["canny"],
                "cv2.Canny, pixels only",
            ),
            row(f"{width}x{height}: outlines as chains [ms]", ms["outlines"], ms["soft canny"], "cv2 blur + Canny"),
        ]
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--limit", type=int, default=1000, help="only so many pictures")
    arguments = parser.parse_args()
    tune_malloc()
    data = data_folder()
    folder = arguments.folder or (data / "edges" if data else None)
    if folder is None:
        print("no pictures with drawings: give a folder, or set ICU_TEST_DATA; only the cost is measured")
    write("edges", [*(quality(folder, arguments.limit) if folder else []), *speed()], title="edges")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
