"""Calibrates one camera or a pair from views of a board; reports its accuracy, or what is wrong with the views.

The method is Zhang's ("A Flexible New Technique for Camera Calibration", PAMI 22(11), 2000) in OpenCV's implementation.
This module adds checks: outliers, uncertainties of a pair, and rejection of unsuitable input.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import cv2
import numpy as np

from harris_perception.core.cameras.board import Board
from harris_perception.core.cameras.board_detection import BoardView, are_enough
from harris_perception.core.cameras.view_coverage import CalibrationError, held_alike, spread_deg, tilt_spread_deg
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array

INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "k1", "k2", "p1", "p2", "k3")
_MIN_SPREAD_DEG = 6.0
_LEAST_BASELINE_M = 0.001
_ANY_RMS_PX = 1e5
_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-10)


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationConfig(Config):
    """Settings of a calibration."""

    radial_terms: int = setting(
        2,
        "Number of radial distortion terms to estimate; the third is useful only for wide lenses",
        minimum=1,
        maximum=3,
    )
    min_views: int = setting(5, "Minimum number of views that show the board", minimum=3, maximum=100)
    outlier_factor: float = setting(
        2.0,
        "Ratio of a view's rms error to the median of all views, above which the view is an outlier",
        minimum=1.1,
        maximum=20.0,
    )
    drop_outliers: bool = setting(False, "Remove outliers and calibrate again")
    max_rms_px: float = setting(3.0, "Maximum accepted rms error", minimum=0.01, maximum=_ANY_RMS_PX, unit="px")
    alpha: float = setting(
        0.0,
        "Field of the rectified image: 0 shows only valid pixels, 1 keeps every pixel of the raw image",
        minimum=0.0,
        maximum=1.0,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewError:
    """Error of one image or pair, px."""

    name: str
    corners: int
    rms_px: float
    outlier: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CameraCalibration:
    """A calibrated camera.

    Attributes
    ----------
    model
        The camera; its rectified frame is its own frame.
    rms_px
        Root mean square reprojection error of the corners.
    sigma
        Standard deviation of each estimated parameter of INTRINSICS.
    views
        The views used, in the given order.
    left_out
        Outliers that were removed.
    at_px, residual_px
        (M, 2) corners, and measured minus expected position.
    """

    model: CameraModel
    rms_px: float
    sigma: dict[str, float]
    views: tuple[ViewError, ...]
    left_out: tuple[ViewError, ...]
    at_px: Array
    residual_px: Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StereoCalibration:
    """A calibrated pair.

    Attributes
    ----------
    stereo
        The rectified pair.
    left, right
        Each camera's own calibration from the same images; the pair's K and d are estimated jointly.
    rms_px
        Reprojection error of all corners of both cameras, with one board pose per pair.
    rows_rms_px
        Rms difference of a corner's rows in the rectified images, which affects matching along rows.
    sigma
        Standard deviations of ``left_`` and ``right_`` INTRINSICS, ``baseline_m`` and ``rotation_deg``.
    views, left_out
        As for one camera, for each pair.
    """

    stereo: StereoModel
    left: CameraCalibration
    right: CameraCalibration
    rms_px: float
    rows_rms_px: float
    sigma: dict[str, float]
    views: tuple[ViewError, ...]
    left_out: tuple[ViewError, ...]


def _require_tilts(spread: float, count: int) -> None:
    if spread < _MIN_SPREAD_DEG:
        raise CalibrationError(
            f"the board is parallel to itself in all {count} views (tilts differ by {spread:.1f} degrees, at least "
            f"{_MIN_SPREAD_DEG:g} are needed): focal length and distance cannot be told apart; add views with the "
            "board tilted by 20 to 45 degrees to the left, right, up and down"
        )


def require_views(board: Board, views: Sequence[BoardView], config: CalibrationConfig) -> tuple[int, int]:
    """Return the size of all images.

    Raises
    ------
    CalibrationError
        For too few views, images of different sizes, a repeated image, or a board that was always held in the same way.
    """
    if len(views) < config.min_views:
        raise CalibrationError(
            f"the board was found in {len(views)} pictures, at least {config.min_views} are needed (15 are good): "
            "take more, with the whole board sharp and evenly lit"
        )
    for view in views:
        if view.size != views[0].size:
            raise CalibrationError(
                f"{view.name} is {view.size[0]} x {view.size[1]} px but {views[0].name} is {views[0].size[0]} x "
                f"{views[0].size[1]} px: use pictures of one size, the one that the camera will run with"
            )
    seen: dict[bytes, BoardView] = {}
    for view in views:
        if (before := seen.setdefault(view.xy.tobytes(), view)) is not view:
            raise CalibrationError(
                f"{before.name} and {view.name} are one picture: every corner is at the same place, to the last digit; "
                "take one of them out"
            )
    _require_tilts(tilt_spread_deg(board, views), len(views))
    return views[0].size


def _flags(config: CalibrationConfig) -> int:
    fixed = (0, cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3, cv2.CALIB_FIX_K3, 0)
    return int(fixed[config.radial_terms])


def _free(config: CalibrationConfig) -> list[int]:
    """Return the indices of the INTRINSICS to estimate."""
    left_alone = {1: (5, 8), 2: (8,), 3: ()}[config.radial_terms]
    return [i for i in range(len(INTRINSICS)) if i not in left_alone]


def _points(board: Board, views: Sequence[BoardView]) -> tuple[list[Any], list[Any]]:
    objects = [board.points()[view.ids].astype(np.float32).reshape(-1, 1, 3) for view in views]
    return objects, [view.xy.astype(np.float32).reshape(-1, 1, 2) for view in views]


def _judged(names: Sequence[str], counts: Sequence[int], errors: Sequence[float], factor: float) -> list[ViewError]:
    bound = factor * float(np.median(errors))
    return [
        ViewError(name=n, corners=c, rms_px=float(e), outlier=bool(e > bound)) for n, c, e in zip(names, counts, errors)
    ]


_V = TypeVar("_V")
_R = TypeVar("_R", bound=CameraCalibration | StereoCalibration)


def _may_drop(view: ViewError, count: int, config: CalibrationConfig) -> bool:
    return config.drop_outliers and view.outlier and count > config.min_views


def _unfit(rms_px: float, views: Sequence[ViewError], config: CalibrationConfig) -> ViewError | None:
    """Return the worst of the views whose error is too large, unless a view can still be removed."""
    if rms_px <= config.max_rms_px or any(_may_drop(view, len(views), config) for view in views):
        return None
    return max(views, key=lambda view: view.rms_px)


def _without_outliers(
    views: Sequence[_V],
    once: Callable[[Sequence[_V], tuple[ViewError, ...]], _R | tuple[ViewError, ...]],
    config: CalibrationConfig,
) -> _R:
    """Calibrate; then, if configured, remove the worst outlier and calibrate again, until there is none.

    ``once`` may return only the views' errors while a view is to be removed.
    """
    kept = list(views)
    left_out: list[ViewError] = []
    while True:
        result = once(kept, tuple(left_out))
        errors = result if isinstance(result, tuple) else result.views
        worst = max(errors, key=lambda view: view.rms_px)
        if not (isinstance(result, tuple) or _may_drop(worst, len(kept), config)):
            return result
        del kept[errors.index(worst)]
        left_out.append(worst)


def calibrate_camera(
    board: Board, views: Sequence[BoardView], config: CalibrationConfig, name: str = "camera"
) -> CameraCalibration:
    """Calibrate one camera.

    Parameters
    ----------
    board
        The board shown.
    views
        Its corners; see :class:`harris_perception.core.cameras.board_detection.BoardDetector`.
    config
        Parameters to estimate, and handling of outliers.
    name
        The camera's name in the result.

    Raises
    ------
    CalibrationError
        If the views are unsuitable, or the error is too large.
    """

    def once(kept: Sequence[BoardView], left_out: tuple[ViewError, ...]) -> CameraCalibration:
        size = require_views(board, kept, config)
        objects, pictures = _points(board, kept)
        rms, k, d, turns, shifts, _, _, errors = cv2.calibrateCameraExtended(
            objects, pictures, size, None, None, flags=_flags(config), criteria=_CRITERIA
        )  # type: ignore[call-overload]
        # Unknown distortion makes parallel boards look differently tilted, so tilts are checked after the calibration.
        # For parallel boards OpenCV solves the singular problem with a wrong focal length and a small deviation, so the
        # poses must show it.
        _require_tilts(spread_deg(np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])), len(kept))
        if not (np.isfinite(rms) and np.isfinite(k).all() and 0 < k[0, 0] < 100 * max(size)):
            raise CalibrationError(
                f"the focal length comes out as {k[0, 0]:g} px: add views with the board tilted more"
            )
        counts = [len(view.ids) for view in kept]
        judged = tuple(_judged([v.name for v in kept], counts, np.ravel(errors).tolist(), config.outlier_factor))
        if (worst := _unfit(rms, judged, config)) is not None:
            raise CalibrationError(
                f"corners are {rms:.1f} px rms from where they should be, {config.max_rms_px:g} are accepted; in "
                f"{worst.name} {worst.rms_px:.1f}: is the board flat, and were the pictures sharp and of one camera?"
            )
        d = np.asarray(d, dtype=np.float64).ravel()[:5]
        p, _ = cv2.getOptimalNewCameraMatrix(k, d, size, config.alpha)
        at = np.vstack([view.xy for view in kept])
        expected = [cv2.projectPoints(o, r, t, k, d)[:2] for o, r, t in zip(objects, turns, shifts, strict=True)]
        residual = at - np.vstack([places.reshape(-1, 2) for places, _ in expected])
        # Columns of derivatives: the board's rotation and translation, then INTRINSICS.
        slopes = [np.asarray(part, np.float64) for _, part in expected]
        blocks = [(part[:, 6:][:, _free(config)], part[:, :6]) for part in slopes]
        deviations = np.sqrt(np.diag(_shared_covariance(blocks, residual, held_alike(kept))))
        model = CameraModel(
            name=name, width=size[0], height=size[1], k=k, d=d, r=np.eye(3), p=np.column_stack([p, np.zeros(3)])
        )
        return CameraCalibration(
            model=model,
            rms_px=float(rms),
            sigma=dict(zip((INTRINSICS[i] for i in _free(config)), deviations.tolist())),
            views=judged,
            left_out=left_out,
            at_px=at,
            residual_px=residual,
        )

    return _without_outliers(views, once, config)


def common_corners(board: Board, left: BoardView, right: BoardView) -> tuple[BoardView, BoardView]:
    """Return both views reduced to their common corners, counted from the same end of the board.

    A chessboard rotated by 180 degrees looks the same to the finder. Cameras of a pair are never rolled by more than 90
    degrees relative to each other, so the diagonal decides.
    """
    if board.kind == "chessboard":
        diagonals = [view.xy[-1] - view.xy[0] for view in (left, right)]
        if diagonals[0] @ diagonals[1] < 0:
            right = BoardView(name=right.name, size=right.size, ids=right.ids, xy=right.xy[::-1].copy())
    ids, i, j = np.intersect1d(left.ids, right.ids, return_indices=True)
    return (
        BoardView(name=left.name, size=left.size, ids=ids, xy=left.xy[i]),
        BoardView(name=right.name, size=right.size, ids=ids, xy=right.xy[j]),
    )


def calibrate_stereo(
    board: Board,
    pairs: Sequence[tuple[BoardView, BoardView]],
    config: CalibrationConfig,
    names: tuple[str, str] = ("left", "right"),
) -> StereoCalibration:
    """Calibrate a pair of cameras, left and right side by side, from images taken at the same instants.

    Raises
    ------
    CalibrationError
        If the pairs are unsuitable or their error is too large, or the cameras are swapped, or one is above or behind
        the other.
    """
    matched = [common_corners(board, left, right) for left, right in pairs]
    matched = [pair for pair in matched if are_enough(board, pair[0].ids)]
    if len(matched) < config.min_views and len(matched) < len(pairs):
        raise CalibrationError(
            f"both cameras see the same part of the board in {len(matched)} of {len(pairs)} pairs of pictures, at "
            f"least {config.min_views} are needed: hold the board where both see most of it"
        )

    def once(
        kept: Sequence[tuple[BoardView, BoardView]], left_out: tuple[ViewError, ...]
    ) -> StereoCalibration | tuple[ViewError, ...]:
        alone = replace(config, drop_outliers=False, max_rms_px=_ANY_RMS_PX)  # the pair's own errors decide
        left, right = (calibrate_camera(board, [pair[side] for pair in kept], alone, names[side]) for side in (0, 1))
        if left.model.size != right.model.size:
            raise CalibrationError(
                f"left pictures are {left.model.width} x {left.model.height} px, right ones {right.model.width} x "
                f"{right.model.height} px: use one size for both"
            )
        objects, lefts = _points(board, [pair[0] for pair in kept])
        rights = _points(board, [pair[1] for pair in kept])[1]
        rms, k1, d1, k2, d2, turn, shift, *_ = cv2.stereoCalibrate(
            objects,
            lefts,
            rights,
            left.model.k.copy(),
            left.model.d.copy(),
            right.model.k.copy(),
            right.model.d.copy(),
            left.model.size,
            flags=cv2.CALIB_USE_INTRINSIC_GUESS | _flags(config),
            criteria=_CRITERIA,
        )
        shift = np.asarray(shift, dtype=np.float64).ravel()
        cameras = [(np.asarray(k, np.float64), np.asarray(d, np.float64).ravel()[:5]) for k, d in ((k1, d1), (k2, d2))]
        bundle = _PairBundle(board, kept, cameras, turn, shift)
        labels = [f"{a.name} + {b.name}" for a, b in kept]
        counts = [2 * len(a.ids) for a, _ in kept]
        judged = tuple(_judged(labels, counts, bundle.view_rms_px, config.outlier_factor))
        if (worst := _unfit(rms, judged, config)) is not None:
            raise CalibrationError(
                f"corners are {rms:.1f} px rms from where they should be, {config.max_rms_px:g} are accepted; in "
                f"{worst.name} {worst.rms_px:.1f}: alone they are {left.rms_px:.1f} px left and {right.rms_px:.1f} px "
                "right; were both pictures of each pair taken at the same moment, by cameras that do not move against "
                "each other?"
            )
        if any(_may_drop(view, len(judged), config) for view in judged):
            return judged  # with only two pairs the cameras' poses are undetermined
        _require_side_by_side(turn, shift)
        stereo = _rectified(left.model, right.model, cameras, turn, shift, config.alpha)
        rows = [stereo.left.rectify(a.xy)[:, 1] - stereo.right.rectify(b.xy)[:, 1] for a, b in kept]
        return StereoCalibration(
            stereo=stereo,
            left=left,
            right=right,
            rms_px=float(rms),
            rows_rms_px=float(np.sqrt(np.mean(np.concatenate(rows) ** 2))),
            sigma=bundle.sigma(_free(config)),
            views=judged,
            left_out=left_out,
        )

    return _without_outliers(matched, once, config)


def _require_side_by_side(turn: Any, shift: Array) -> None:
    x, y, _ = shift
    apart = float(np.linalg.norm(shift))
    if apart < _LEAST_BASELINE_M:
        raise CalibrationError(
            f"the cameras come out {apart * 1e3:.3f} mm apart, at least {_LEAST_BASELINE_M * 1e3:g} mm are needed: "
            "do both sides have pictures of the same camera?"
        )
    if abs(y) > abs(x):
        raise CalibrationError(
            f"the right camera is {abs(y):.3f} m above or below the left one and {abs(x):.3f} m beside it: "
            "the cameras must be side by side; turn the bar"
        )
    # As in rectification: relative to the mean viewing direction of both cameras.
    beside, _, ahead = np.abs(cv2.Rodrigues(-0.5 * cv2.Rodrigues(turn)[0])[0] @ shift).tolist()
    if ahead > beside:
        raise CalibrationError(
            f"one camera is {ahead:.3f} m ahead of the other and {beside:.3f} m beside it: the cameras must be side by "
            "side"
        )
    if x > 0:
        raise CalibrationError(
            f"the right camera comes out {x:.3f} m to the left of the left one: the two sides are swapped; "
            "exchange them"
        )


def _rectified(
    left: CameraModel, right: CameraModel, cameras: Sequence[tuple[Array, Array]], turn: Any, shift: Array, alpha: float
) -> StereoModel:
    (k1, d1), (k2, d2) = cameras
    found = cv2.stereoRectify(
        k1, d1, k2, d2, left.size, turn, shift.reshape(3, 1), flags=cv2.CALIB_ZERO_DISPARITY, alpha=alpha
    )
    r1, r2, p1, p2 = (np.asarray(part, np.float64) for part in found[:4])
    return StereoModel(
        left=CameraModel(name=left.name, width=left.width, height=left.height, k=k1, d=d1, r=r1, p=p1),
        right=CameraModel(name=right.name, width=right.width, height=right.height, k=k2, d=d2, r=r2, p=p2),
    )


def _shared_covariance(blocks: Sequence[tuple[Array, Array]], residual: Array, alike: Sequence[int]) -> Array:
    """Return the covariance of the parameters shared by all views, from each view's derivatives by these and its pose.

    It is ``s^2 (J^T J)^-1`` with the boards' poses eliminated (Schur complement; Triggs et al., "Bundle Adjustment - A
    Modern Synthesis", 2000). The deviations that OpenCV 4 reports for one camera are about 1.45 times as large, because
    it counts corners, and a corner has two residuals.

    Errors of corners in one view are correlated (a bent board, light, a rolling shutter), so ``s^2`` alone is too
    small. The covariance is therefore scaled by the views' actual pull on the shared parameters, relative to that of
    independent corners. Views between which the board was not moved have the same number in ``alike`` and count as one.
    """
    shared = blocks[0][0].shape[1]
    own = [j - j_pose @ np.linalg.lstsq(j_pose, j, rcond=None)[0] for j, j_pose in blocks]
    # Distances and distortion differ by six orders of magnitude: scale to a unit diagonal before inverting.
    scale = 1 / np.sqrt(sum(np.sum(rest**2, axis=0) for rest in own))
    own = [rest * scale for rest in own]
    inverse = np.linalg.inv(sum(rest.T @ rest for rest in own))
    variance = float(np.sum(residual**2)) / (residual.size - shared - 6 * len(blocks))
    parts = np.split(np.ravel(residual), np.cumsum([len(rest) for rest in own])[:-1])
    which = np.unique(alike, return_inverse=True)[1] == np.arange(len(set(alike)))[:, None]
    pulls = which @ np.array([rest.T @ off for rest, off in zip(own, parts, strict=True)])
    shares = np.tensordot(which, np.array([inverse @ rest.T @ rest for rest in own]), 1)
    independent = shared - float(np.einsum("nij,nji->", shares, shares))
    together = float(np.einsum("ni,ij,nj->", pulls, inverse, pulls)) / independent
    return np.asarray(inverse * np.outer(scale, scale) * max(variance, together))


class _PairBundle:
    """All parameters of a pair around their optimum: errors of each pair of views, and the covariance.

    OpenCV reports no uncertainties for a pair. J is computed here by central differences.
    """

    _STEPS = np.array([1e-6] * 3 + [1e-6] * 3 + 2 * ([1e-3] * 4 + [1e-6] * 5))

    def __init__(
        self,
        board: Board,
        pairs: Sequence[tuple[BoardView, BoardView]],
        cameras: Sequence[tuple[Array, Array]],
        turn: Any,
        shift: Array,
    ) -> None:
        self._turn = np.asarray(turn, dtype=np.float64)
        self._alike = held_alike([a for a, _ in pairs])
        intrinsics = [(k[0, 0], k[1, 1], k[0, 2], k[1, 2], *d) for k, d in cameras]
        self._shared = np.concatenate([np.zeros(3), shift, *intrinsics])
        self._blocks: list[tuple[Array, Array]] = []
        self._residuals: list[Array] = []
        self.view_rms_px: list[float] = []
        for a, b in pairs:
            points = board.points()[a.ids]
            measured = np.vstack([a.xy, b.xy])
            _, r, t = cv2.solvePnP(points, a.xy, *cameras[0])
            pose = np.concatenate([np.ravel(r), np.ravel(t)])
            for _ in range(10):
                residual = (measured - self._expected(points, self._shared, pose)).ravel()
                j_pose = self._slopes(partial(self._expected, points, self._shared), pose, np.full(6, 1e-6))
                step = np.linalg.lstsq(j_pose, residual, rcond=None)[0]
                pose = pose + step
                if np.abs(step).max() < 1e-9:
                    break
            residual = (measured - self._expected(points, self._shared, pose)).ravel()
            j_shared = self._slopes(partial(self._expected, points, pose=pose), self._shared, self._STEPS)
            self._blocks.append((j_shared, j_pose))
            self._residuals.append(residual)
            self.view_rms_px.append(float(np.sqrt(2 * np.mean(residual**2))))

    def _expected(self, points: Array, shared: Array, pose: Array) -> Array:
        turn = cv2.Rodrigues(pose[:3])[0]
        right_turn = cv2.Rodrigues(shared[:3])[0] @ self._turn
        poses = ((pose[:3], pose[3:]), (cv2.Rodrigues(right_turn @ turn)[0], right_turn @ pose[3:] + shared[3:6]))
        pictures = []
        for (r, t), (fx, fy, cx, cy, *d) in zip(poses, (shared[6:15], shared[15:24])):
            k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
            pictures.append(cv2.projectPoints(points, r, t, k, np.array(d))[0].reshape(-1, 2))
        return np.vstack(pictures)

    @staticmethod
    def _slopes(function: Callable[[Array], Array], at: Array, steps: Array) -> Array:
        columns = []
        for i, step in enumerate(steps):
            move = np.zeros(len(at))
            move[i] = step
            columns.append((function(at + move) - function(at - move)).ravel() / (2 * step))
        return np.column_stack(columns)

    def sigma(self, free: Sequence[int]) -> dict[str, float]:
        """Return the standard deviations; ``free`` lists the estimated intrinsics."""
        used = [*range(6), *(6 + i for i in free), *(15 + i for i in free)]
        blocks = [(j_shared[:, used], j_pose) for j_shared, j_pose in self._blocks]
        covariance = _shared_covariance(blocks, np.concatenate(self._residuals), self._alike)
        along = self._shared[3:6] / np.linalg.norm(self._shared[3:6])
        names = [f"{side}_{INTRINSICS[i]}" for side in ("left", "right") for i in free]
        deviations = np.sqrt(np.diag(covariance))
        return dict(zip(names, deviations[6:].tolist())) | {
            "baseline_m": float(np.sqrt(along @ covariance[3:6, 3:6] @ along)),
            "rotation_deg": float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        }


def residual_picture(calibration: CameraCalibration) -> Any:
    """Return (H, W, 3) uint8: each corner with its residual, magnified so that 3 rms are a thirtieth of the width."""
    model = calibration.model
    zoom = max(1.0, 1280 / model.width)
    picture = np.full((round(model.height * zoom) + 40, round(model.width * zoom), 3), 255, np.uint8)
    rms = max(calibration.rms_px, 1e-9)
    magnify = max(1.0, float(f"{model.width / 90 / rms:.1g}"))
    bound = 3 * rms
    for at, residual in zip(calibration.at_px, calibration.residual_px):
        start, end = (tuple(round(v * 8) for v in p * zoom) for p in (at, at + magnify * residual))
        colour = (40, 40, 220) if np.hypot(*residual) > bound else (190, 110, 20)
        cv2.line(picture, start, end, colour, 1, cv2.LINE_AA, 3)
        cv2.circle(picture, start, 10, colour, -1, cv2.LINE_AA, 3)
    text = f"{model.name}: rms {calibration.rms_px:.3f} px, residuals x{magnify:g}, red: above three times the rms"
    cv2.putText(picture, text, (10, picture.shape[0] - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 1, cv2.LINE_AA)
    return picture
