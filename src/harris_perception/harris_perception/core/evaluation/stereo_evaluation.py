"""Evaluation of sparse and dense stereo against known disparity, and other methods for comparison.

Dense: the share of pixels whose disparity is off by more than N px (bad-N) after D. Scharstein and R. Szeliski
(IJCV 47, 2002), over the pixels visible in both images, before and after filling holes in the same way for all methods.
Sparse: the share of matches within 1 px (precision), and their number divided by the number of the first image's points
that are visible in both images (recall). A point visible only in the first image may be matched correctly by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.stereo.dense_stereo import F32, U8, SemiGlobalConfig, SemiGlobalMatcher, fill_holes
from harris_perception.core.stereo.stereo_matching import StereoMatchConfig, match_corners

MAX_POINTS = 1500
ALL_CORNERS = "ours, min_probability 0.45"
_HALF, _STRIP = 5, 100
_BEYOND_PX = 8
"""Minimum excess of an image's width over the disparity range, as OpenCV's semi-global matcher requires."""
ROWS_PX = 1.5
"""Maximum row difference of the peers' matches, as for ours: the pair is rectified."""
Clock = Callable[[], float]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StereoScene:
    """A rectified pair with known disparity.

    ``left`` and ``right`` are (H, W) uint8, ``truth`` is (H, W) float32, NaN where unknown.
    """

    name: str
    left: U8
    right: U8
    truth: F32

    def __post_init__(self) -> None:
        if not self.left.shape == self.right.shape == self.truth.shape or self.left.ndim != 2:
            shapes = f"{self.left.shape}, {self.right.shape} and {self.truth.shape}"
            raise ValueError(f"{self.name}: left, right and truth have the sizes {shapes}; they must be equal")
        if not np.isfinite(self.truth).any():
            raise ValueError(f"{self.name}: the truth knows no disparity at all")
        width, most = self.truth.shape[1], float(np.nanmax(self.truth))
        limit = (width - _BEYOND_PX) // 16 * 16
        if not most // 16 * 16 < limit:  # otherwise the search's memory would be unbounded
            raise ValueError(
                f"{self.name}: the truth reaches {most:g} px, with pictures {width} px wide below {limit} px are "
                "possible: is its unit a pixel?"
            )

    def disparities(self) -> int:
        """Return the number of disparities from 0 that the search needs, a multiple of 16."""
        return 16 * int(np.nanmax(self.truth) // 16 + 1)

    def visible(self) -> Mask:
        """Return (H, W): truth is known, and the right image also shows the point, not hidden by a nearer one."""
        height, width = self.truth.shape
        y, x = np.nonzero(np.isfinite(self.truth))
        disparity = self.truth[y, x]
        there = np.round(x - disparity).astype(int)
        inside = (there >= 0) & (there < width)
        y, x, disparity, there = y[inside], x[inside], disparity[inside], there[inside]
        front = np.full((height, width + 1), -np.inf, np.float32)
        for step in (0, 1):
            np.maximum.at(front, (y, there + step), disparity)
        seen = np.zeros((height, width), bool)
        seen[y, x] = disparity >= front[y, there] - 1.5
        return seen


@dataclass(frozen=True, slots=True, kw_only=True)
class DenseScore:
    """Shares in percent of the pixels visible in both images; ``rms_px`` of the known ones within 2 px of the truth.

    ``strip_apart`` is bad-2 after filling, without the columns left of the search range, which OpenCV's matchers leave
    empty.
    """

    bad_half: float
    bad_1: float
    bad_2: float
    bad_2_of_known: float
    bad_2_strip_apart: float
    invalid: float
    rms_px: float
    took_ms: float


def score_dense(scene: StereoScene, disparity: F32, took_ms: float) -> DenseScore:
    """Compare (H, W) disparities, NaN where unknown, with the truth."""
    seen = scene.visible()
    known = seen & np.isfinite(disparity)
    off = np.abs(disparity - scene.truth)
    filled = disparity.copy()
    fill_holes(filled)
    off_filled = np.where(np.isfinite(filled), np.abs(filled - scene.truth), np.inf)
    strip_apart = seen & (np.arange(seen.shape[1]) >= scene.disparities())

    def share(values: Mask, among: Mask) -> float:
        return 100.0 * float(values[among].mean()) if among.any() else float("nan")

    near = off[known & (off <= 2.0)]
    return DenseScore(
        bad_half=share(off_filled > 0.5, seen),
        bad_1=share(off_filled > 1.0, seen),
        bad_2=share(off_filled > 2.0, seen),
        bad_2_of_known=share(off > 2.0, known),
        bad_2_strip_apart=share(off_filled > 2.0, strip_apart),
        invalid=share(~known, seen),
        rms_px=float(np.sqrt(np.mean(near**2))) if near.size else float("nan"),
        took_ms=took_ms,
    )


def dense_methods(disparities: int) -> dict[str, Callable[[U8, U8], F32]]:
    """Return our matcher and its peers, all searching 0 to ``disparities - 1``.

    The peers have the defaults of image_pipeline's stereo_image_proc::DisparityNode (documented in its components.rst),
    except for the range, which the scene determines.
    """
    block = cv2.StereoBM_create(disparities, 15)  # type: ignore[attr-defined]
    block.setPreFilterSize(9)
    block.setPreFilterCap(31)
    block.setTextureThreshold(10)
    block.setUniquenessRatio(15)
    block.setSpeckleWindowSize(100)
    block.setSpeckleRange(4)
    block.setDisp12MaxDiff(0)
    semi_global = cv2.StereoSGBM_create(  # type: ignore[attr-defined]
        minDisparity=0,
        numDisparities=disparities,
        blockSize=15,
        P1=200,
        P2=400,
        disp12MaxDiff=0,
        preFilterCap=31,
        uniquenessRatio=15,
        speckleWindowSize=100,
        speckleRange=4,
        mode=cv2.STEREO_SGBM_MODE_SGBM,
    )
    return {
        "ours": SemiGlobalMatcher(0, disparities - 1, SemiGlobalConfig()),
        "SGBM as image_pipeline": lambda left, right: _pixels(semi_global.compute(left, right)),
        "BM as image_pipeline": lambda left, right: _pixels(block.compute(left, right)),
    }


def _pixels(sixteenths: npt.NDArray[Any]) -> F32:
    return np.where(sixteenths >= 0, sixteenths / np.float32(16), np.nan).astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class SparseScore:
    """Precision and recall in percent at 1 px; ``rms_px`` of the matches within it."""

    points: int
    matches: int
    precision: float
    recall: float
    rms_px: float
    took_ms: float


@dataclass(frozen=True, slots=True, eq=False)
class SparseResult:
    """The first image's points, (M, 2) px, and its matches: (N, 2) px with (N,) disparities."""

    points_px: npt.NDArray[Any]
    matched_px: npt.NDArray[Any]
    disparity_px: npt.NDArray[Any]


def score_sparse(scene: StereoScene, result: SparseResult, took_ms: float) -> SparseScore:
    """Compare matches with the truth; matches at unknown truth do not count."""
    height, width = scene.truth.shape

    def at(picture: npt.NDArray[Any], px: npt.NDArray[Any]) -> npt.NDArray[Any]:
        x, y = np.round(px.reshape(-1, 2)).astype(int).T
        return np.asarray(picture[y.clip(0, height - 1), x.clip(0, width - 1)])

    off = np.abs(result.disparity_px - at(scene.truth, result.matched_px))
    off = off[np.isfinite(off)]
    good = off[off <= 1.0]
    could = int(at(scene.visible(), result.points_px).sum())
    return SparseScore(
        points=len(result.points_px),
        matches=len(result.matched_px),
        precision=100.0 * len(good) / len(off) if len(off) else float("nan"),
        recall=100.0 * len(good) / could if could else float("nan"),
        rms_px=float(np.sqrt(np.mean(good**2))) if len(good) else float("nan"),
        took_ms=took_ms,
    )


def sparse_methods(disparities: int) -> dict[str, Callable[[U8, U8], SparseResult]]:
    """Return our matcher and its peers; each uses at most MAX_POINTS points per image."""
    detector = HarrisDetector(HarrisConfig(max_corners=MAX_POINTS))

    def corners(left: U8, right: U8, config: StereoMatchConfig) -> SparseResult:
        a, b = (detector.detect(picture).xy for picture in (left, right))
        found = match_corners(left, right, a, b, (1.0, float(disparities)), config)
        return SparseResult(a, found.left_px, found.disparity_px)

    def orb(left: U8, right: U8) -> SparseResult:
        finder = cv2.ORB_create(MAX_POINTS)  # type: ignore[attr-defined]
        matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        return _described(finder, left, right, lambda a, b: list(matcher.match(a, b)))

    def sift(left: U8, right: U8) -> SparseResult:
        finder = cv2.SIFT_create(MAX_POINTS)  # type: ignore[attr-defined]
        matcher = cv2.BFMatcher(cv2.NORM_L2)

        def distinct(a: Any, b: Any) -> list[Any]:
            pairs = [pair for pair in matcher.knnMatch(a, b, 2) if len(pair) == 2]
            return [best for best, second in pairs if best.distance < 0.75 * second.distance]

        return _described(finder, left, right, distinct)

    def mutual(left: U8, right: U8) -> SparseResult:
        a, b = (detector.detect(picture).xy for picture in (left, right))
        return _mutual_corners(left, right, a, b, disparities)

    def whole_row(left: U8, right: U8) -> SparseResult:
        return _whole_rows(left, right, detector.detect(left).xy, disparities)

    return {
        "ours": lambda left, right: corners(left, right, StereoMatchConfig()),
        ALL_CORNERS: lambda left, right: corners(left, right, StereoMatchConfig(min_probability=0.45)),
        "ORB, cross check": orb,
        "SIFT, ratio 0.75": sift,
        "Harris, ZNCC, mutual best": mutual,
        "Harris, ZNCC along the row": whole_row,
    }


def _mutual_corners(left: U8, right: U8, a: npt.ArrayLike, b: npt.ArrayLike, disparities: int) -> SparseResult:
    """Match corners with corners: mutual best correlation of 11x11 windows, and nothing else."""
    sides = []
    for picture, at in ((left, a), (right, b)):
        px = np.asarray(at, np.float64).reshape(-1, 2)
        whole = np.rint(px).astype(int)
        height, width = picture.shape
        inside = ((whole >= _HALF) & (whole < (width - _HALF, height - _HALF))).all(axis=1)
        px, whole = px[inside], whole[inside]
        windows = np.lib.stride_tricks.sliding_window_view(picture, (2 * _HALF + 1, 2 * _HALF + 1))
        flat = windows[whole[:, 1] - _HALF, whole[:, 0] - _HALF].reshape(-1, (2 * _HALF + 1) ** 2).astype(np.float32)
        flat -= flat.mean(axis=1, keepdims=True)
        sides.append((px, flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-6)))
    (first, windows_a), (second, windows_b) = sides
    if not len(first) or not len(second):
        return SparseResult(np.asarray(a, np.float64), np.empty((0, 2)), np.empty(0))
    shift = first[:, None, 0] - second[None, :, 0]
    possible = (np.abs(first[:, None, 1] - second[None, :, 1]) <= ROWS_PX) & (shift >= 1) & (shift <= disparities)
    score = np.where(possible, windows_a @ windows_b.T, -1.0)
    to, back = score.argmax(axis=1), score.argmax(axis=0)
    mine = np.flatnonzero((back[to] == np.arange(len(first))) & (score.max(axis=1) > 0.5))
    return SparseResult(np.asarray(a, np.float64), first[mine], first[mine, 0] - second[to[mine], 0])


def _whole_rows(left: U8, right: U8, a: npt.ArrayLike, disparities: int) -> SparseResult:
    """Search each corner's 11x11 window along the other image's row, in both directions, with a parabola's vertex."""
    px = np.asarray(a, np.float64).reshape(-1, 2)
    kept, found = [], []
    for x, y in px:
        there = _along(left, right, round(x), round(y), -disparities, -1)
        if there is None:
            continue
        back = _along(right, left, round(round(x) + there), round(y), 1, disparities)
        if back is not None and abs(there + back) <= 1.0:
            kept.append((x, y))
            found.append(-there)
    return SparseResult(px, np.array(kept).reshape(-1, 2), np.array(found))


def _along(picture: U8, other: U8, x: int, y: int, low: int, high: int) -> float | None:
    """Return the shift of the window at (x, y) in the other image's row; None if it is not found."""
    height, width = picture.shape
    low, high = max(low, _HALF - x), min(high, width - 1 - _HALF - x)
    if not (_HALF <= x < width - _HALF and _HALF <= y < height - _HALF) or high - low < 2:
        return None
    window = picture[y - _HALF : y + _HALF + 1, x - _HALF : x + _HALF + 1]
    strip = other[y - _HALF : y + _HALF + 1, x + low - _HALF : x + high + _HALF + 1]
    score = cv2.matchTemplate(strip, window, cv2.TM_CCOEFF_NORMED)[0]
    best = int(score.argmax())
    if score[best] < 0.5 or best in (0, len(score) - 1):
        return None
    before, at, after = (float(v) for v in score[best - 1 : best + 2])
    bend = before - 2 * at + after
    return low + best + (0.5 * (before - after) / bend if bend < 0 else 0.0)


def _described(finder: Any, left: U8, right: U8, match: Callable[[Any, Any], list[Any]]) -> SparseResult:
    (first, a), (second, b) = (finder.detectAndCompute(picture, None) for picture in (left, right))
    first_px = np.array([p.pt for p in first], np.float64).reshape(-1, 2)
    second_px = np.array([p.pt for p in second], np.float64).reshape(-1, 2)
    pairs = match(a, b) if a is not None and b is not None else []
    from_, to = (np.array([getattr(m, end) for m in pairs], np.intp) for end in ("queryIdx", "trainIdx"))
    same_row = np.abs(first_px[from_, 1] - second_px[to, 1]) <= ROWS_PX
    from_, to = from_[same_row], to[same_row]
    return SparseResult(first_px, first_px[from_], first_px[from_, 0] - second_px[to, 0])


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Scores by method, and the methods' results, of one scene."""

    scene: StereoScene
    dense: Mapping[str, DenseScore]
    sparse: Mapping[str, SparseScore]
    disparities: Mapping[str, F32]
    matches: Mapping[str, SparseResult]

    def rows(self) -> list[dict[str, Any]]:
        """Return one flat row for each kind and method."""
        kinds: tuple[tuple[str, Mapping[str, Any]], ...] = (("dense", self.dense), ("sparse", self.sparse))
        return [
            {"scene": self.scene.name, "kind": kind, "method": name, **asdict(score)}
            for kind, scores in kinds
            for name, score in scores.items()
        ]


def evaluate(scene: StereoScene, clock: Clock) -> Evaluation:
    """Run every method on a scene; ``clock`` returns seconds. A strip of it is run first, untimed, as warm-up."""

    def run(method: Callable[[U8, U8], Any]) -> tuple[Any, float]:
        method(scene.left[:_STRIP], scene.right[:_STRIP])
        start = clock()
        return method(scene.left, scene.right), 1e3 * (clock() - start)

    dense = {name: run(method) for name, method in dense_methods(scene.disparities()).items()}
    sparse = {name: run(method) for name, method in sparse_methods(scene.disparities()).items()}
    return Evaluation(
        scene,
        {name: score_dense(scene, *result) for name, result in dense.items()},
        {name: score_sparse(scene, *result) for name, result in sparse.items()},
        {name: result for name, (result, _) in dense.items()},
        {name: result for name, (result, _) in sparse.items()},
    )


def error_picture(evaluation: Evaluation) -> U8:
    """Draw (H, W, 3) BGR: the left image, the truth, disparity and error of each dense method, then the sparse matches.

    Errors range from dark blue (0 px) to red (4 px and more); unknown is black, occluded grey.
    """
    scene, top = evaluation.scene, float(np.nanmax(evaluation.scene.truth))
    seen = scene.visible()
    grey = cv2.cvtColor(scene.left, cv2.COLOR_GRAY2BGR)
    columns = [_stack("left picture", grey, "truth", _coloured(scene.truth, top))]
    for name, disparity in evaluation.disparities.items():
        error = _coloured(np.abs(disparity - scene.truth), 4.0)
        error[~seen] = 110
        text = f"bad-2 {evaluation.dense[name].bad_2:.2f} %, unknown {evaluation.dense[name].invalid:.1f} %"
        columns.append(_stack(name, _coloured(disparity, top), text, error))
    both = []
    for name in list(evaluation.matches)[:2]:
        drawn = (grey * 0.6).astype(np.uint8)
        result = evaluation.matches[name]
        for (x, y), found in zip(result.matched_px, result.disparity_px):
            expected = scene.truth[int(round(y)), int(round(x))]  # noqa: RUF046 - numpy's round gives floats
            good = abs(found - expected) <= 1.0
            colour = (60, 220, 60) if good else (60, 60, 255) if np.isfinite(expected) else (200, 200, 60)
            cv2.circle(drawn, (int(x), int(y)), 3, colour, -1, cv2.LINE_AA)
        score = evaluation.sparse[name]
        both += [f"{name}: right {score.precision:.1f} % of {score.matches}, recall {score.recall:.1f} %", drawn]
    columns.append(_stack(*both))
    return np.hstack(columns)


def _coloured(values: F32, top: float) -> U8:
    scaled = np.nan_to_num(values / top * 255.0, nan=0.0, posinf=255.0).clip(0, 255).astype(np.uint8)
    drawn = np.asarray(cv2.applyColorMap(scaled, cv2.COLORMAP_TURBO), np.uint8)
    drawn[~np.isfinite(values)] = 0
    return drawn


def _stack(*titles_and_pictures: Any) -> U8:
    parts = []
    for title, picture in zip(titles_and_pictures[::2], titles_and_pictures[1::2]):
        bar = np.full((28, picture.shape[1], 3), 245, np.uint8)
        cv2.putText(bar, title, (6, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1, cv2.LINE_AA)
        parts += [bar, picture]
    return np.vstack(parts)
