"""Measure the time from a grey image to the list of corners, against OpenCV and scikit-image, on one and two threads.

All do the same work: 3x3 Sobel, window 3, k 0.04, threshold 1 % of the strongest, 3x3 suppression, all corners, sorted
by response; ours also computes sub-pixel positions. The peers are measured twice: with a malloc that keeps large blocks
(their best case, to which the goals refer) and with glibc's default. Agreement is the share of corners on the same
pixel, among those of either list at least 3 px from the edge, without sub-pixel positions.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.taps import gaussian_derivative_taps, gaussian_taps
from harris_perception.core.image.deriche import filtered, recursive_filter
from icu_common.adapters.memory import keep_large_blocks

sys.path.append(str(Path(__file__).resolve().parents[1]))
from rows import Row, bound, data_folder, interleaved_ms, row, write

SIZES = ((640, 480), (1280, 720), (1920, 1080))
GOALS = {(640, 480): 3.0, (1280, 720): 3.0, (1920, 1080): 4.0}
CONFIG = HarrisConfig(gradient="sobel", max_corners=0)


def picture(width: int, height: int) -> np.ndarray:
    """Return a photograph cropped or scaled to the size; without the data folder, a drawing with noise."""
    folder = data_folder()
    if folder is not None:
        photograph = cv2.imread(str(next((folder / "stereo/aloe").glob("*l*.*g"))), cv2.IMREAD_GRAYSCALE)
        scale = max(width / photograph.shape[1], height / photograph.shape[0])
        scaled = cv2.resize(photograph, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(scaled[:height, :width])
    rng = np.random.default_rng(1)
    canvas = np.full((height, width), 120, np.uint8)
    for _ in range(width * height // 2000):
        centre, size = rng.uniform((0, 0), (width, height)), rng.uniform(5, 40, 2)
        box = cv2.boxPoints((tuple(map(float, centre)), tuple(map(float, size)), float(rng.uniform(0, 180))))
        cv2.fillConvexPoly(canvas, box.astype(np.int32), int(rng.integers(0, 256)), lineType=cv2.LINE_AA)
    noisy = cv2.GaussianBlur(canvas, (0, 0), 0.8) + rng.normal(0, 2, canvas.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def good_features(gray: np.ndarray) -> np.ndarray:
    found = cv2.goodFeaturesToTrack(gray, 0, 0.01, 0, blockSize=3, useHarrisDetector=True, k=0.04)
    return np.asarray(found).reshape(-1, 2)


def harris_and_dilate(gray: np.ndarray) -> np.ndarray:
    response = cv2.cornerHarris(gray, 3, 3, 0.04)
    _, high, _, _ = cv2.minMaxLoc(response)
    _, response = cv2.threshold(response, 0.01 * high, 0, cv2.THRESH_TOZERO)
    peaks = (response == cv2.dilate(response, None)) & (response > 0)
    return np.asarray(cv2.findNonZero(peaks.view(np.uint8))).reshape(-1, 2)


def scikit_image() -> Callable[[np.ndarray], Any] | None:
    try:
        from skimage.feature import corner_harris, corner_peaks
    except ImportError:
        return None
    return lambda gray: corner_peaks(corner_harris(gray, k=0.04, sigma=1), min_distance=1, threshold_rel=0.01)


def agreement(gray: np.ndarray) -> float:
    height, width = gray.shape

    def inside(xy: np.ndarray) -> set[tuple[int, int]]:
        return {(int(x), int(y)) for x, y in xy if 3 <= x < width - 3 and 3 <= y < height - 3}

    config = HarrisConfig(gradient="sobel", max_corners=0, subpixel=False)
    ours, theirs = inside(HarrisDetector(config).detect(gray).xy), inside(good_features(gray))
    return len(ours & theirs) / max(len(ours | theirs), 1)


def measure(threads: int, label: str, goals: bool) -> list[Row]:
    rows: list[Row] = []
    cv2.setNumThreads(threads)
    peer = scikit_image()
    with ThreadPoolExecutor(threads) as pool:
        run = map if threads == 1 else pool.map
        detector = HarrisDetector(CONFIG, bands=threads, run=run)
        detector.warm()
        for width, height in SIZES:
            gray = picture(width, height)
            mirrored = np.ascontiguousarray(gray[:, ::-1])
            functions: dict[str, Callable[[], Any]] = {
                "ours": lambda gray=gray: detector.detect(gray),
                "pair": lambda gray=gray, mirrored=mirrored: detector.detect([gray, mirrored]),
                "cv2.goodFeaturesToTrack": lambda gray=gray: good_features(gray),
                "cv2.cornerHarris + dilate": lambda gray=gray: harris_and_dilate(gray),
            }
            if peer is not None and threads == 1:
                functions["skimage corner_harris + corner_peaks"] = lambda gray=gray: peer(gray)
            ms = interleaved_ms(functions, slow=["skimage corner_harris + corner_peaks"])
            what = f"{width}x{height}, {threads} thread{'s' * (threads > 1)}, {label} [ms]"
            for name in list(functions)[2:]:
                goal = GOALS[width, height] if goals and name == "cv2.goodFeaturesToTrack" and threads == 1 else None
                rows.append(row(what, ms["ours"], ms[name], name, goal))
            rows.append(bound(what.replace(" [ms]", ": time of a pair / of one"), ms["pair"] / ms["ours"], 2.0))
            if goals and threads == 1:
                corners = len(detector.detect(gray))
                rows.append(
                    bound(f"{width}x{height}: agreement, {corners} corners", agreement(gray), 0.99, at_least=True)
                )
    return rows


def recursion() -> list[Row]:
    """Measure Gaussian derivatives and window by recursion, whose time does not grow with sigma."""
    cv2.setNumThreads(1)
    gray, rows, ms = picture(1280, 720), [], {}
    for sigma in (1.0, 4.0, 8.0):  # the window's sigma is twice as large, up to 16 px
        detectors = {
            kind: HarrisDetector(HarrisConfig(gradient=kind, window=kind, sigma_d_px=sigma, sigma_i_px=2.0 * sigma))
            for kind in ("deriche", "gaussian")
        }
        calls = {kind: (lambda detector=detector: detector.structure(gray)) for kind, detector in detectors.items()}
        ms[sigma] = interleaved_ms(calls, repeats=10)
        what = f"1280x720: structure tensor by recursion, sigma {sigma:g} / {2 * sigma:g} [ms]"
        rows.append(row(what, ms[sigma]["deriche"], ms[sigma]["gaussian"], "direct, one pass over rows"))
    rows.append(bound("recursion: time at the widest / narrowest sigma", ms[8.0]["deriche"] / ms[1.0]["deriche"], 1.25))
    filters = {s: (recursive_filter(s, True), recursive_filter(s, False)) for s in (1.0, 4.0, 16.0)}
    source = gray.astype(np.float32)
    one = interleaved_ms({str(s): (lambda f=f: filtered(source, *f)) for s, f in filters.items()}, repeats=10)
    rows += [row(f"1280x720: one derivative by recursion, sigma {s} [ms]", value, None, "") for s, value in one.items()]
    return rows


def five_filters(gray: np.ndarray) -> list[np.ndarray]:
    """Return gx^2, gy^2, gx gy under a Gaussian window, as usually written with OpenCV's filters."""
    source = gray.astype(np.float32)
    smooth, derivative, window = gaussian_taps(1.0), gaussian_derivative_taps(1.0), gaussian_taps(2.0)
    gx = cv2.sepFilter2D(source, cv2.CV_32F, derivative, smooth)
    gy = cv2.sepFilter2D(source, cv2.CV_32F, smooth, derivative)
    return [cv2.sepFilter2D(product, cv2.CV_32F, window, window) for product in (gx * gx, gy * gy, gx * gy)]


def gaussian() -> list[Row]:
    """Measure Gaussian derivatives and window, and larger boxes, by plain kernels."""
    cv2.setNumThreads(1)
    gray, rows = picture(1280, 720), []
    direct, wide = (
        HarrisDetector(HarrisConfig(gradient="gaussian", window="gaussian")),
        HarrisDetector(HarrisConfig(window_px=5)),
    )
    ms = interleaved_ms(
        {
            "direct": lambda: direct.structure(gray),
            "filters": lambda: five_filters(gray),
            "corners": lambda: direct.detect(gray),
            "wide": lambda: wide.detect(gray),
            "peer": lambda: cv2.goodFeaturesToTrack(gray, 2000, 0.01, 0, blockSize=5, useHarrisDetector=True, k=0.04),
        },
        repeats=20,
    )
    rows.append(row("1280x720: structure tensor, Gaussians 1 / 2 [ms]", ms["direct"], ms["filters"], "cv2.sepFilter2D"))
    rows.append(row("1280x720: corners, Gaussians 1 / 2 [ms]", ms["corners"], None, ""))
    rows.append(row("1280x720: corners, window 5 [ms]", ms["wide"], ms["peer"], "cv2.goodFeaturesToTrack"))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--default-malloc", action="store_true", help="only with glibc's default malloc")
    if parser.parse_args().default_malloc:
        write("harris_default_malloc", measure(1, "default malloc", goals=False), title="grey picture to corners")
        return 0
    subprocess.run([sys.executable, __file__, "--default-malloc"], check=True)
    keep_large_blocks()
    rows = measure(1, "tuned malloc", goals=True) + measure(2, "tuned malloc", goals=False) + gaussian() + recursion()
    write("harris", rows, title="grey picture to corners")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
