"""Calibrates one camera from views of a board; reports its accuracy, or what is wrong with the views.

The method is Zhang's ("A Flexible New Technique for Camera Calibration", PAMI 22(11), 2000) in OpenCV's implementation.
The room's other modules add checks: outliers, uncertainties, and rejection of unsuitable input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.board_detection import BoardView
from harris_perception.core.cameras.calibration_config import (
    CRITERIA,
    INTRINSICS,
    CalibrationConfig,
    estimated,
    solver_flags,
)
from harris_perception.core.cameras.shared_covariance import shared_covariance
from harris_perception.core.cameras.view_coverage import CalibrationError, held_alike, spread_deg
from harris_perception.core.cameras.view_errors import ViewError, errors_of, without_outliers, worst_unfit
from harris_perception.core.cameras.view_requirements import require_tilts, require_views
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array


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


def calibrate_camera(
    board: CalibrationBoard, views: Sequence[BoardView], config: CalibrationConfig, name: str = "camera"
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
        objects, pictures = matched_points(board, kept)
        rms, k, d, turns, shifts, _, _, errors = cv2.calibrateCameraExtended(
            objects, pictures, size, None, None, flags=solver_flags(config), criteria=CRITERIA
        )  # type: ignore[call-overload]
        # Unknown distortion makes parallel boards look differently tilted, so tilts are checked after the calibration.
        # For parallel boards OpenCV solves the singular problem with a wrong focal length and a small deviation, so the
        # poses must show it.
        require_tilts(spread_deg(np.array([cv2.Rodrigues(turn)[0][:, 2] for turn in turns])), len(kept))
        if not (np.isfinite(rms) and np.isfinite(k).all() and 0 < k[0, 0] < 100 * max(size)):
            raise CalibrationError(
                f"the focal length comes out as {k[0, 0]:g} px: add views with the board tilted more"
            )
        counts = [len(view.ids) for view in kept]
        judged = tuple(errors_of([v.name for v in kept], counts, np.ravel(errors).tolist(), config.outlier_factor))
        if (worst := worst_unfit(rms, judged, config)) is not None:
            raise CalibrationError(
                f"corners are {rms:.1f} px rms from where they should be (limit {config.max_rms_px:g}); in "
                f"{worst.name} {worst.rms_px:.1f}: is the board flat, and were the pictures sharp and of one camera?"
            )
        d = np.asarray(d, dtype=np.float64).ravel()[:5]
        p, _ = cv2.getOptimalNewCameraMatrix(k, d, size, config.alpha)
        at = np.vstack([view.xy for view in kept])
        expected = [cv2.projectPoints(o, r, t, k, d)[:2] for o, r, t in zip(objects, turns, shifts, strict=True)]
        residual = at - np.vstack([places.reshape(-1, 2) for places, _ in expected])
        # Columns of derivatives: the board's rotation and translation, then INTRINSICS.
        slopes = [np.asarray(part, np.float64) for _, part in expected]
        blocks = [(part[:, 6:][:, estimated(config)], part[:, :6]) for part in slopes]
        deviations = np.sqrt(np.diag(shared_covariance(blocks, residual, held_alike(kept))))
        model = CameraModel(
            name=name, width=size[0], height=size[1], k=k, d=d, r=np.eye(3), p=np.column_stack([p, np.zeros(3)])
        )
        return CameraCalibration(
            model=model,
            rms_px=float(rms),
            sigma=dict(zip((INTRINSICS[i] for i in estimated(config)), deviations.tolist())),
            views=judged,
            left_out=left_out,
            at_px=at,
            residual_px=residual,
        )

    return without_outliers(views, once, config)


def matched_points(board: CalibrationBoard, views: Sequence[BoardView]) -> tuple[list[Any], list[Any]]:
    """Return the board's points and the corners of each view, (M, 1, 3) m and (M, 1, 2) px, as OpenCV takes them."""
    objects = [board.points()[view.ids].astype(np.float32).reshape(-1, 1, 3) for view in views]
    return objects, [view.xy.astype(np.float32).reshape(-1, 1, 2) for view in views]
