"""Calibrates a pair of cameras from views of a board that both took at the same instants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.board_detection import BoardView, are_enough
from harris_perception.core.cameras.calibration_config import (
    ANY_RMS_PX,
    CRITERIA,
    CalibrationConfig,
    estimated,
    solver_flags,
)
from harris_perception.core.cameras.camera_calibration import CameraCalibration, calibrate_camera, matched_points
from harris_perception.core.cameras.pair_bundle import PairBundle
from harris_perception.core.cameras.view_coverage import CalibrationError
from harris_perception.core.cameras.view_errors import ViewError, errors_of, may_drop, without_outliers, worst_unfit
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array

_LEAST_BASELINE_M = 0.001


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PairCalibration:
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


def common_corners(board: CalibrationBoard, left: BoardView, right: BoardView) -> tuple[BoardView, BoardView]:
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
    board: CalibrationBoard,
    pairs: Sequence[tuple[BoardView, BoardView]],
    config: CalibrationConfig,
    names: tuple[str, str] = ("left", "right"),
) -> PairCalibration:
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
    ) -> PairCalibration | tuple[ViewError, ...]:
        alone = replace(config, drop_outliers=False, max_rms_px=ANY_RMS_PX)  # the pair's own errors decide
        left, right = (calibrate_camera(board, [pair[side] for pair in kept], alone, names[side]) for side in (0, 1))
        if left.model.size != right.model.size:
            raise CalibrationError(
                f"left pictures are {left.model.width} x {left.model.height} px, right ones {right.model.width} x "
                f"{right.model.height} px: use one size for both"
            )
        objects, lefts = matched_points(board, [pair[0] for pair in kept])
        rights = matched_points(board, [pair[1] for pair in kept])[1]
        rms, k1, d1, k2, d2, turn, shift, *_ = cv2.stereoCalibrate(
            objects,
            lefts,
            rights,
            left.model.k.copy(),
            left.model.d.copy(),
            right.model.k.copy(),
            right.model.d.copy(),
            left.model.size,
            flags=cv2.CALIB_USE_INTRINSIC_GUESS | solver_flags(config),
            criteria=CRITERIA,
        )
        shift = np.asarray(shift, dtype=np.float64).ravel()
        cameras = [(np.asarray(k, np.float64), np.asarray(d, np.float64).ravel()[:5]) for k, d in ((k1, d1), (k2, d2))]
        bundle = PairBundle(board, kept, cameras, turn, shift)
        labels = [f"{a.name} + {b.name}" for a, b in kept]
        counts = [2 * len(a.ids) for a, _ in kept]
        judged = tuple(errors_of(labels, counts, bundle.view_rms_px, config.outlier_factor))
        if (worst := worst_unfit(rms, judged, config)) is not None:
            raise CalibrationError(
                f"corners are {rms:.1f} px rms from where they should be (limit {config.max_rms_px:g}); in "
                f"{worst.name} {worst.rms_px:.1f}: alone they are {left.rms_px:.1f} px left and {right.rms_px:.1f} px "
                "right; were both pictures of each pair taken at the same moment, by cameras that do not move against "
                "each other?"
            )
        if any(may_drop(view, len(judged), config) for view in judged):
            return judged  # with only two pairs the cameras' poses are undetermined
        _require_side_by_side(turn, shift)
        stereo = _rectified(left.model, right.model, cameras, turn, shift, config.alpha)
        rows = [stereo.left.rectify(a.xy)[:, 1] - stereo.right.rectify(b.xy)[:, 1] for a, b in kept]
        return PairCalibration(
            stereo=stereo,
            left=left,
            right=right,
            rms_px=float(rms),
            rows_rms_px=float(np.sqrt(np.mean(np.concatenate(rows) ** 2))),
            sigma=bundle.sigma(estimated(config)),
            views=judged,
            left_out=left_out,
        )

    return without_outliers(matched, once, config)


def _require_side_by_side(turn: Any, shift: Array) -> None:
    x, y, _ = shift
    apart = float(np.linalg.norm(shift))
    if apart < _LEAST_BASELINE_M:
        raise CalibrationError(
            f"the cameras come out {apart * 1e3:.3f} mm apart; expected at least {_LEAST_BASELINE_M * 1e3:g} mm: "
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
