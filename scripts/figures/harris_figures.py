"""Figures of docs/explanation/harris.md, each computed by the detector of this project. Run it by ``make figures``.

The pictures are drawn here with fixed seeds: a chart for the explanation, and textures for the measured curves.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import matplotlib
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.structure_matrix import StructureMatrix
from harris_perception.core.edges.combined_detector import CombinedDetector
from harris_perception.core.edges.edges import CORNER, EDGE, TracingConfig

matplotlib.use("Agg")
from matplotlib import pyplot as plt

ROOT = Path(__file__).resolve().parents[2]
K = 0.04
EPSILON_PX = 1.5
"""Maximum distance between a corner and its mapped position that counts as repeated."""
COUNT = 200
"""Number of the strongest corners that are compared."""
CONFIG = HarrisConfig(window="gaussian", sigma_i_px=1.0, k=K)
Picture = npt.NDArray[np.uint8]
Rows = list[tuple[float, float]]


def chart() -> Picture:
    """Return the picture of the explanation: a square, a triangle, a disc and a line on a dark ground, with noise."""
    big = np.full((960, 1280), 60.0, np.float32)
    cv2.rectangle(big, (120, 140), (480, 500), 200.0, -1)
    cv2.fillPoly(big, [np.array([(700, 140), (1140, 250), (780, 520)])], 160.0)
    cv2.circle(big, (300, 740), 130, 190.0, -1, cv2.LINE_AA)
    cv2.line(big, (620, 860), (1160, 640), 180.0, 24, cv2.LINE_AA)
    small = cv2.resize(cv2.GaussianBlur(big, (0, 0), 3.0), (320, 240), interpolation=cv2.INTER_AREA)
    return np.clip(small + np.random.default_rng(1).normal(0, 1.5, small.shape), 0, 255).astype(np.uint8)


def scene(seed: int) -> Picture:
    """Return a picture of many overlapping polygons, which has corners of all strengths and angles."""
    rng = np.random.default_rng(seed)
    big = np.full((1920, 1920), 110.0, np.float32)
    for _ in range(260):
        middle, size = rng.uniform(0, 1920, 2), rng.uniform(50, 190)
        angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 6)))
        corners = middle + size * np.column_stack([np.cos(angles), np.sin(angles)])
        cv2.fillPoly(big, [np.rint(corners).astype(np.int32)], float(rng.uniform(20, 235)))
    return cv2.resize(cv2.GaussianBlur(big, (0, 0), 2.0), (480, 480), interpolation=cv2.INTER_AREA).astype(np.uint8)


def noisy(picture: npt.NDArray[Any], seed: int) -> Picture:
    """Return the picture with the noise of a camera, 2 grey levels."""
    noise = np.random.default_rng(seed).normal(0, 2.0, picture.shape)
    return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)


def repeated(first: Picture, second: Picture, second_from_first: npt.NDArray[Any], radius_px: float = 3.0) -> float:
    """Return the share of corners that repeat (Schmid, Mohr and Bauckhage 2000), one to one, in the common part."""
    detector = HarrisDetector(
        HarrisConfig(window="gaussian", sigma_i_px=1.0, k=K, suppression_radius_px=radius_px, max_corners=0)
    )
    found = [detector.detect(picture).xy.astype(np.float64) for picture in (first, second)]
    inverse = np.linalg.inv(second_from_first)
    found[0] = found[0][_inside(_mapped(second_from_first, found[0]), second)][:COUNT]
    found[1] = found[1][_inside(_mapped(inverse, found[1]), first)][:COUNT]
    expected = _mapped(second_from_first, found[0])
    distance = np.hypot(*(expected[:, np.newaxis] - found[1]).transpose(2, 0, 1))
    limit = EPSILON_PX * max(float(np.sqrt(abs(np.linalg.det(second_from_first[:2, :2])))), 1.0)
    pairs = 0
    while distance.size and distance.min() <= limit:
        i, j = np.unravel_index(distance.argmin(), distance.shape)
        distance[i, :], distance[:, j] = np.inf, np.inf
        pairs += 1
    return pairs / max(min(len(found[0]), len(found[1])), 1)


def _mapped(matrix: npt.NDArray[Any], points: npt.NDArray[Any]) -> npt.NDArray[Any]:
    return points @ matrix[:2, :2].T + matrix[:2, 2]


def _inside(points: npt.NDArray[Any], picture: Picture) -> npt.NDArray[np.bool_]:
    height, width = picture.shape
    return ((points > 8) & (points < np.array([width, height]) - 9)).all(axis=1)


def turned(degrees: float, scale: float = 1.0) -> npt.NDArray[Any]:
    """Return the affine map that turns and scales about the middle of a scene."""
    return np.vstack([cv2.getRotationMatrix2D((239.5, 239.5), degrees, scale), [0.0, 0.0, 1.0]])


def curve(values: npt.ArrayLike, change: Callable[[Picture, float], tuple[npt.NDArray[Any], npt.NDArray[Any]]]) -> Rows:
    """Return the mean repeatability of three scenes for each value of a change."""
    rows = []
    for value in np.asarray(values, dtype=float):
        shares = []
        for seed in (1, 2, 3):
            picture = scene(seed)
            other, matrix = change(picture, float(value))
            shares.append(repeated(noisy(picture, 10 + seed), noisy(other, 20 + seed), matrix))
        rows.append((float(value), float(np.mean(shares))))
    return rows


def _warped(picture: Picture, matrix: npt.NDArray[Any]) -> npt.NDArray[Any]:
    soft = picture
    shrunk = float(np.sqrt(abs(np.linalg.det(matrix[:2, :2]))))
    if shrunk < 1:  # a camera averages over its pixels
        soft = cv2.GaussianBlur(picture, (0, 0), 0.5 * np.sqrt(1 / shrunk**2 - 1) + 1e-3).astype(np.uint8)
    return cv2.warpAffine(soft, matrix[:2], picture.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def curves() -> dict[str, Rows]:
    """Return the measured curves: rotation, light, scale and blur."""
    same = np.eye(3)
    return {
        "rotation [deg]": curve([0, 10, 20, 30, 45, 60, 75, 90], lambda p, v: (_warped(p, turned(v)), turned(v))),
        "gain of the light": curve([0.3, 0.5, 0.7, 1.0, 1.3], lambda p, v: (np.clip(p * v, 0, 255), same)),
        "scale": curve(
            [0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0, 2.5], lambda p, v: (_warped(p, turned(0, v)), turned(0, v))
        ),
        "blur, sigma [px]": curve(
            [0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0],
            lambda p, v: (p if v == 0 else cv2.GaussianBlur(p, (0, 0), v), same),
        ),
    }


def eigenvalues(picture: Picture) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the eigenvalues (H, W) of the structure matrix, the larger first, without the frame."""
    a, b, c = structure()(picture)
    half, root = (a + b) / 2, np.sqrt(((a - b) / 2) ** 2 + c * c)
    return half + root, half - root


def structure() -> StructureMatrix:
    """Return the structure matrix with the settings of this page."""
    return HarrisDetector(CONFIG).structure


def show(axis: Any, picture: npt.NDArray[Any], title: str, **options: Any) -> None:
    axis.imshow(picture, **({"cmap": "gray"} | options))
    axis.set_title(title, fontsize=10)
    axis.set_xticks([])
    axis.set_yticks([])


def draw_structure(out: Path) -> None:
    """Draw the picture and the three sums of the structure matrix."""
    picture = chart()
    figure, axes = plt.subplots(1, 4, figsize=(13, 3))
    show(axes[0], picture, "picture I", vmin=0, vmax=255)
    for axis, term, name in zip(axes[1:], structure()(picture), ("A: sum of Ix²", "B: sum of Iy²", "C: sum of Ix Iy")):
        size = float(np.percentile(np.abs(term), 99.5))
        show(axis, term, name, cmap="RdBu_r", vmin=-size, vmax=size)
    save(figure, out)


def draw_response(out: Path) -> None:
    """Draw the response, its maxima before and after suppression, and the accepted corners."""
    picture = chart()
    response = HarrisDetector(CONFIG).response(picture)
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.6))
    signed = np.sign(response) * np.abs(response) ** 0.25
    size = float(np.abs(signed).max())
    show(axes[0], signed, "R, fourth root: blue edge, red corner", cmap="RdBu_r", vmin=-size, vmax=size)
    ring = response[30:50, 110:130]
    show(axes[1], ring, "R around one corner, and its maximum")
    row, column = np.unravel_index(ring.argmax(), ring.shape)
    axes[1].plot(column, row, "r+", markersize=14)
    show(axes[2], picture, "corners after suppression and threshold", vmin=0, vmax=255)
    corners = HarrisDetector(CONFIG).detect(picture)
    axes[2].plot(*corners.xy.T, "r+", markersize=9)
    save(figure, out)


def draw_plane(out: Path) -> None:
    """Draw the pixels of the chart in the plane of eigenvalues, with the lines R = 0 and R = threshold."""
    large, small = eigenvalues(chart())
    response = large * small - K * (large + small) ** 2
    threshold = 0.01 * float(response.max())
    figure, axis = plt.subplots(figsize=(6.4, 5.6))
    kinds = (
        ("corner: R > threshold", response > threshold, "#b3261e"),
        ("edge: R < -threshold", response < -threshold, "#0969da"),
        ("flat: |R| small", np.abs(response) <= threshold, "#8c959f"),
    )
    roots = np.sqrt(np.maximum(large, 0.0)), np.sqrt(np.maximum(small, 0.0))
    size = float(roots[0].max()) * 1.05
    for name, chosen, colour in kinds:
        axis.plot(roots[0][chosen], roots[1][chosen], ".", markersize=3, color=colour, label=name)
        axis.plot(roots[1][chosen], roots[0][chosen], ".", markersize=3, color=colour)
    line = np.linspace(0, size, 400)
    # R = 0 is a pair of lines through the origin: k (r + 1)² = r for the ratio r of the eigenvalues.
    slope = np.sqrt((1 - 2 * K - np.sqrt(1 - 4 * K)) / (2 * K))
    axis.plot(line, slope * line, "k-", linewidth=1)
    axis.plot(slope * line, line, "k-", linewidth=1, label="R = 0")
    first, second = (grid**2 for grid in np.meshgrid(line, line))
    level = first * second - K * (first + second) ** 2
    axis.contour(line, line, level, levels=[threshold], colors="#b3261e", linestyles="--", linewidths=1)
    axis.set(xlabel="root of eigenvalue 1", ylabel="root of eigenvalue 2", xlim=(0, size), ylim=(0, size))
    axis.set_aspect("equal")
    axis.legend(loc="upper right", fontsize=9)
    save(figure, out)


def draw_edges(out: Path) -> None:
    """Draw edges by one threshold, by hysteresis, and the label of each pixel."""
    fading = np.linspace(1.0, 0.1, chart().shape[1])
    picture = np.rint(60.0 + (chart() - 60.0) * fading).clip(0, 255).astype(np.uint8)
    figure, axes = plt.subplots(1, 4, figsize=(13, 3))
    show(axes[0], picture, "contrast falls to the right", vmin=0, vmax=255)
    for axis, low, name in ((axes[1], 1.0, "high only"), (axes[2], 0.4, "high and low: hysteresis")):
        edges = CombinedDetector(CONFIG, TracingConfig(high=13.0, low_of_high=low)).detect(picture)[1]
        show(axis, edges.labels == EDGE, name)
    colours = np.full((*edges.labels.shape, 3), 235, np.uint8)
    colours[edges.labels == EDGE] = (9, 105, 218)
    for y, x in np.argwhere(edges.labels == CORNER):
        cv2.circle(colours, (int(x), int(y)), 3, (179, 38, 30), -1)
    show(axes[3], colours, "label: flat, edge (blue), corner (red)")
    save(figure, out)


def draw_curves(measured: dict[str, Rows], out: Path) -> None:
    """Draw the measured repeatability."""
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.2), sharey=True)
    for axis, (name, rows) in zip(axes, measured.items()):
        axis.plot(*zip(*rows), "o-", color="#0969da")
        axis.set(xlabel=name, ylim=(0, 1.02))
        axis.grid(color="#d0d7de")
    axes[0].set_ylabel("share of corners that repeat")
    save(figure, out)


def save(figure: Any, out: Path) -> None:
    figure.tight_layout()
    figure.savefig(out, dpi=110, metadata={"Software": None})
    plt.close(figure)


def main() -> None:
    """Draw all figures, and print the measured values."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "docs" / "explanation" / "harris")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    draw_structure(folder / "structure.png")
    draw_response(folder / "response.png")
    draw_plane(folder / "plane.png")
    draw_edges(folder / "edges.png")
    measured = curves()
    draw_curves(measured, folder / "curves.png")
    for name, rows in measured.items():
        print(f"{name}: " + ", ".join(f"{value:g}: {100 * share:.0f} %" for value, share in rows))


if __name__ == "__main__":
    main()
