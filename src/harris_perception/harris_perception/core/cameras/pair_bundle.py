"""A pair's parameters around their optimum: errors of the views, and standard deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import cv2
import numpy as np

from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.board_detection import BoardView
from harris_perception.core.cameras.calibration_config import INTRINSICS
from harris_perception.core.cameras.shared_covariance import shared_covariance
from harris_perception.core.cameras.view_coverage import held_alike
from icu_common.core.geometry.geometry import Array


class PairBundle:
    """All parameters of a pair around their optimum: errors of each pair of views, and the covariance.

    OpenCV reports no uncertainties for a pair. J is computed here by central differences.
    """

    _STEPS = np.array([1e-6] * 3 + [1e-6] * 3 + 2 * ([1e-3] * 4 + [1e-6] * 5))

    def __init__(
        self,
        board: CalibrationBoard,
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
        covariance = shared_covariance(blocks, np.concatenate(self._residuals), self._alike)
        along = self._shared[3:6] / np.linalg.norm(self._shared[3:6])
        names = [f"{side}_{INTRINSICS[i]}" for side in ("left", "right") for i in free]
        deviations = np.sqrt(np.diag(covariance))
        return dict(zip(names, deviations[6:].tolist())) | {
            "baseline_m": float(np.sqrt(along @ covariance[3:6, 3:6] @ along)),
            "rotation_deg": float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        }
