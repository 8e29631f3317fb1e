"""Finds a calibration board's inner corners in an image, to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.cameras.board import CalibrationBoard, aruco_dictionary
from icu_common.core.geometry.geometry import Array

_WINDOW_SHARE = 0.35
_MIN_CORNERS = 8
_OUT_OF_LINE = 0.3
"""Maximum deviation of corners from a line, as a share of their spacing: 0.1 on photographs, 0.25 on a board tilted by
70 degrees. OpenCV's finders put a corner that is covered, by a finger or a reflection, anywhere nearby."""
_LEAST_PX = 16
"""Minimum image size; OpenCV's finders fail on smaller images."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardView:
    """The board in one image.

    Attributes
    ----------
    name
        Name of the image.
    size
        (width, height) of the image in pixels.
    ids
        (N,) numbers of the corners, as in :meth:`CalibrationBoard.points`.
    xy
        (N, 2) raw pixels; the centre of the first pixel is (0, 0).

    Raises
    ------
    ValueError
        If a corner's position is not finite.
    """

    name: str
    size: tuple[int, int]
    ids: npt.NDArray[np.int64]
    xy: Array

    def __post_init__(self) -> None:
        for i in np.flatnonzero(~np.isfinite(self.xy).all(axis=1))[:1]:
            raise ValueError(
                f"{self.name}: corner {self.ids[i]} is at {self.xy[i].tolist()} px; expected finite numbers"
            )


def are_enough(board: CalibrationBoard, ids: npt.NDArray[np.int64]) -> bool:
    """Return whether these corners (N,) determine the board's pose: 8 or more, not all on one line."""
    rows, columns = np.divmod(ids, board.columns)
    return len(ids) >= _MIN_CORNERS and bool(np.ptp(rows) > 0 and np.ptp(columns) > 0)


def out_of_line(board: CalibrationBoard, ids: npt.NDArray[np.int64], xy: Array) -> float:
    """Return the maximum deviation of a corner from the line of its neighbours, in spacings.

    It is the largest third difference of four corners in a row or column, which perspective and lens hardly affect.
    """
    grid = np.full((board.rows, board.columns, 2), np.nan)
    grid[np.divmod(ids, board.columns)] = xy
    bent = 0.0
    for rows in (grid, grid.swapaxes(0, 1)):
        step = np.linalg.norm(rows[3:] - rows[:-3], axis=2) / 3
        bent = float(np.fmax.reduce((np.linalg.norm(np.diff(rows, 3, axis=0), axis=2) / step).ravel(), initial=bent))
    return bent


class BoardDetector:
    """Finds one board.

    Parameters
    ----------
    board
        Board to find.
    quick
        Stop early if there seems to be no board: for live images, where the next one may succeed.
    """

    def __init__(self, board: CalibrationBoard, *, quick: bool = False) -> None:
        self._board = board
        self._flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        if quick:
            self._flags |= cv2.CALIB_CB_FAST_CHECK
        self._charuco = _CharucoFinder(board) if board.kind == "charuco" else None

    def detect(self, gray: npt.NDArray[np.uint8], name: str) -> BoardView | None:
        """Return the view; None if the board is not found (a chessboard: not completely), or a corner is out of line.

        Parameters
        ----------
        gray
            (H, W) uint8.
        name
            Name of the view.
        """
        if min(gray.shape) < _LEAST_PX:
            return None
        found = self._charuco.find(gray) if self._charuco is not None else self._chessboard(gray)
        if found is None:
            return None
        ids, rough = found
        if not are_enough(self._board, ids):
            return None
        xy = self._refined(gray, rough)
        if out_of_line(self._board, ids, xy) > _OUT_OF_LINE:
            return None
        return BoardView(name=name, size=(gray.shape[1], gray.shape[0]), ids=ids, xy=xy)

    def _chessboard(self, gray: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.int64], Array] | None:
        board = self._board
        found, corners = cv2.findChessboardCorners(gray, (board.columns, board.rows), flags=self._flags)
        if not found:
            return None
        # A chessboard looks the same to the finder from its other end; camera_calibration resolves the order for a
        # pair.
        return np.arange(board.columns * board.rows), np.asarray(corners, dtype=np.float64).reshape(-1, 2)

    def _refined(self, gray: npt.NDArray[np.uint8], rough: Array) -> Array:
        """Return the corners (N, 2) to a fraction of a pixel."""
        board = self._board
        distance = np.linalg.norm(rough[:, None] - rough[None], axis=2)
        spacing = float(distance[distance > 0].min())
        # cornerSubPix counts from the centre. A window of two thirds of the smallest spacing contains only the corner's
        # own four edges; a fixed window of 11 px includes the neighbours on a small board: 0.9 px rms. Between markers
        # there is less room. OpenCV 4.6 leaves charuco corners half a pixel off; this refinement also corrects that.
        gap = (1 - board.marker_m / board.square_m) / 2
        half = max(2, int((_WINDOW_SHARE if board.kind == "chessboard" else min(_WINDOW_SHARE, gap)) * spacing))
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
        start = np.ascontiguousarray(rough, dtype=np.float32).reshape(-1, 1, 2)
        return np.asarray(cv2.cornerSubPix(gray, start, (half, half), (-1, -1), criteria), np.float64).reshape(-1, 2)


class _CharucoFinder:
    """OpenCV's ChArUco detector: a class since 4.7, functions before."""

    def __init__(self, board: CalibrationBoard) -> None:
        self._dictionary = aruco_dictionary(board.dictionary)
        squares = (board.columns + 1, board.rows + 1)
        aruco: Any = cv2.aruco
        self._detector: Any = None
        if hasattr(aruco, "CharucoDetector"):
            made = aruco.CharucoBoard(squares, board.square_m, board.marker_m, self._dictionary)
            self._detector = aruco.CharucoDetector(made)
        else:
            self._made = aruco.CharucoBoard_create(*squares, board.square_m, board.marker_m, self._dictionary)

    def find(self, gray: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.int64], Array] | None:
        aruco: Any = cv2.aruco
        if self._detector is not None:
            corners, ids = self._detector.detectBoard(gray)[:2]
        else:
            markers, numbers, _ = aruco.detectMarkers(gray, self._dictionary)
            if numbers is None:
                return None
            _, corners, ids = aruco.interpolateCornersCharuco(markers, numbers, gray, self._made)
        if ids is None or corners is None:
            return None
        return np.asarray(ids, dtype=np.int64).ravel(), np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def size_shown(gray: npt.NDArray[np.uint8], board: CalibrationBoard) -> tuple[int, int] | None:
    """Return the (columns, rows) that the image does show, if they differ by at most one from the board's.

    For the error message, because people may count squares instead of inner corners.
    """
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    for i, j in ((-1, -1), (1, 1), (-1, 0), (0, -1), (1, 0), (0, 1)):
        size = (board.columns + i, board.rows + j)
        if min(size) >= 3 and cv2.findChessboardCorners(gray, size, flags=flags)[0]:
            return size
    return None
