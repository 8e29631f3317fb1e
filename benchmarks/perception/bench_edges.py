"""Measure edges against human drawings (BSDS500 format), and their cost in addition to corners.

Scores are the best F-measure of one threshold for all images (ODS) and of the best threshold for each image (OIS). They
are next to those of OpenCV's and scikit-image's Canny at their best sigma.

The benchmark needs a folder of <name>.jpg and <name>.mat, by default edges/ in the data folder. Ours runs with its
default settings, for grey and for colour images. They were chosen for the highest ODS and OIS on every second image by
name (the first, the third, ...) of twenty images of the train part. The report covers the other images, and the peers
get the best sigma for those, separately for ODS and OIS. Twenty images are few: the halves differ from each other by
more than ours differs from the peers.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np

from harris_perception.adapters.boundary_files import drawn_pictures, read_drawn
from harris_perception.core.corners.harris import HarrisDetector
from harris_perception.core.edges.combined_detector import CombinedDetector
from harris_perception.core.edges.edges import EDGE, EdgeConfig, EdgeDetector
from harris_perception.core.evaluation.boundary_evaluation import Finder, counts_of, ods_ois, our_finders, peer_finders
from icu_common.adapters.memory import keep_large_blocks

sys.path.append(str(Path(__file__).resolve().parents[1]))
from perception.bench_harris import SIZES, picture
from rows import Row, bound, data_folder, interleaved_ms, row, write

Pictures = list[tuple[np.ndarray, list[np.ndarray]]]


def score(finder: Finder, pictures: Pictures) -> tuple[float, float]:
    """Return ODS and OIS."""
    return ods_ois(np.stack([counts_of(finder, picture, drawings) for picture, drawings in pictures]))


def quality(folder: Path, limit: int) -> list[Row]:
    pictures = [read_drawn(*paths) for paths in drawn_pictures(folder)[:limit]]
    rows = []
    for half, part in (("held out", pictures[1::2]), ("used for the choice", pictures[::2])):
        rows += _rows(f"{len(part)} pictures {half}", part) if part else []
    return rows


def _rows(what: str, pictures: Pictures) -> list[Row]:
    tried = {
        library: {sigma: score(finder, pictures) for sigma, finder in finders.items()}
        for library, finders in peer_finders().items()
    }
    rows = []
    for ours in ("outlines, grey", "outlines, color"):
        found = score(our_finders()[ours], pictures)
        for library, scores in tried.items():
            if "color" in library and "grey" in ours:
                continue
            for i, measure in enumerate(("ODS", "OIS")):
                sigma = max(scores, key=lambda s: scores[s][i])
                name, theirs = f"{library}, sigma {sigma}", scores[sigma][i]
                rows.append(row(f"{what}, {ours}: {measure}", found[i], theirs, name, higher_is_better=True))
                ahead = 100 * (found[i] - theirs)
                rows.append(bound(f"{what}, {ours}: {measure} ahead of {name} [points]", ahead, 3.0, at_least=True))
    return rows


def speed() -> list[Row]:
    """Measure the time of the combined pass, of the corners alone, which it includes, and of outlines."""
    cv2.setNumThreads(1)
    rows = []
    corners, combined, outlines = HarrisDetector(), CombinedDetector(), EdgeDetector()
    without_regions = EdgeDetector(EdgeConfig(region_px=0.0))
    for width, height in SIZES:
        gray = picture(width, height)
        xy = corners.detect(gray).xy
        ms = interleaved_ms(
            {
                "corners": lambda gray=gray: corners.detect(gray),
                "combined": lambda gray=gray: combined.detect(gray),
                "outlines": lambda gray=gray, xy=xy: outlines.detect(gray, xy),
                "without regions": lambda gray=gray, xy=xy: without_regions.detect(gray, xy),
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
            row(f"{width}x{height}: the same [ms]", ms["outlines"], ms["without regions"], "without regions"),
        ]
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--limit", type=int, default=1000, help="only so many pictures")
    arguments = parser.parse_args()
    keep_large_blocks()
    data = data_folder()
    folder = arguments.folder or (data / "edges" if data else None)
    if folder is None:
        print("no pictures with drawings: give a folder, or set ICU_TEST_DATA; only the cost is measured")
    write("edges", [*(quality(folder, arguments.limit) if folder else []), *speed()], title="edges")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
