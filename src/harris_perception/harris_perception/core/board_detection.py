"""Finds a calibration board's inner corners in a picture, to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.board import Board, aruco_dictionary
from icu_common.core.geometry import Array

_WINDOW_SHARE = 0.35
_MIN_CORNERS = 8
_OUT_OF_LINE = 0.3
"""So far are corners out of line at most, as a part of their spacing: 0.1 on photographs, 0.25 on a board tilted by 70
degrees. What is covered, by a finger or a lamp's reflection, the finders put anywhere near by."""
_LEAST_PX = 16
"""Smaller pictures show no board; OpenCV's finders fail on them."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardView:
    """The board as one picture shows it.

    Attributes
    ----------
    name
        The picture's name.
    size
        (width, height) of the picture in pixels.
    ids
        (N,) numbers of the corners, as in :meth:`Board.points`.
    xy
        (N, 2) raw pixels; the centre of the first pixel is (0, 0).

    Raises
    ------
    ValueError
        If a corner's place is not finite.
    """

    name: str
    size: tuple[int, int]
    ids: npt.NDArray[np.int64]
    xy: Array

    def __post_init__(self) -> None:
        for i in np.flatnonzero(~np.isfinite(self.xy).all(axis=1))[:1]:
            raise ValueError(
                f"{self.name}: corner {self.ids[i]} is at {self.xy[i].tolist()} px: finite numbers are needed"
            )


def are_enough(board: Board, ids: npt.NDArray[np.int64]) -> bool:
    """Return whether corners of these numbers (N,) tell where the board is: 8 or more, not all on one line of it."""
    rows, columns = np.divmod(ids, board.columns)
    return len(ids) >= _MIN_CORNERS and bool(np.ptp(rows) > 0 and np.ptp(columns) > 0)


def out_of_line(board: Board, ids: npt.NDArray[np.int64], xy: Array) -> float:
    """Return by how much, in spacings, a corner is out of line with its neighbours.

    That is the largest third difference of four in a row or column, in which perspective and lens leave little.
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
        What to look for.
    quick
        Give up early where no board seems to be: for live pictures, of which the next one may do.
    """

    def __init__(self, board: Board, *, quick: bool = False) -> None:
        self._board = board
        self._flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        if quick:
            self._flags |= cv2.CALIB_CB_FAST_CHECK
        self._charuco = _CharucoFinder(board) if board.kind == "charuco" else None

    def detect(self, gray: npt.NDArray[np.uint8], name: str) -> BoardView | None:
        """Return the view, or None where the board is not found (chessboard: not found whole), or a corner out of line.

        Parameters
        ----------
        gray
            (H, W) uint8.
        name
            What to call the view.
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
        # From the other end the board looks the same to the finder; a pair's order is settled in camera_calibration.
        return np.arange(board.columns * board.rows), np.asarray(corners, dtype=np.float64).reshape(-1, 2)

    def _refined(self, gray: npt.NDArray[np.uint8], rough: Array) -> Array:
        """Return the corners to a fraction of a pixel, (N, 2)."""
        board = self._board
        distance = np.linalg.norm(rough[:, None] - rough[None], axis=2)
        spacing = float(distance[distance > 0].min())
        # cornerSubPix counts from the centre: a whole window of two thirds of the smallest spacing has no edges in it
        # but the corner's own four. A fixed window of 11 px takes in the neighbours of a small board: 0.9 px rms.
        # Between markers there is less room. OpenCV 4.6 leaves charuco corners half a pixel off; this mends that too.
        gap = (1 - board.marker_m / board.square_m) / 2
        half = max(2, int((_WINDOW_SHARE if board.kind == "chessboard" else min(_WINDOW_SHARE, gap)) * spacing))
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
        start = np.ascontiguousarray(rough, dtype=np.float32).reshape(-1, 1, 2)
        return np.asarray(cv2.cornerSubPix(gray, start, (half, half), (-1, -1), criteria), np.float64).reshape(-1, 2)


class _CharucoFinder:
    """OpenCV's finder of ChArUco corners: a class since 4.7, functions before."""

    def __init__(self, board: Board) -> None:
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


def size_shown(gray: npt.NDArray[np.uint8], board: Board) -> tuple[int, int] | None:
    """Return the size near a chessboard's own (columns, rows), one more or fewer, that the picture does show.

    For the message to somebody who counted squares instead of inner corners.
    """
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    for i, j in ((-1, -1), (1, 1), (-1, 0), (0, -1), (1, 0), (0, 1)):
        size = (board.columns + i, board.rows + j)
        if min(size) >= 3 and cv2.findChessboardCorners(gray, size, flags=flags)[0]:
            return size
    return None
