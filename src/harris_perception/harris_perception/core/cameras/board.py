"""Calibration boards: their content, and drawings in true size as SVG and PDF."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.cameras.print_page import BORDER_MM, PAPERS_MM, RULER_MM, PrintRectangle, Sheet, pdf, svg
from icu_common.core.configuration.config import Config, ConfigError, setting
from icu_common.core.geometry import fiducial
from icu_common.core.geometry.geometry import Array

KINDS = ("chessboard", "charuco")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationBoard(Config):
    """A flat board of squares.

    Corners are counted row by row from the upper left; x points right, y down the board, z into it.

    Raises
    ------
    ConfigError
        If a quarter turn makes the board look the same, or the dictionary has too few markers.
    """

    kind: str = setting(
        "chessboard", "Type of board: plain chessboard, or charuco with a marker in each white square", choices=KINDS
    )
    columns: int = setting(9, "Inner corners in a row (number of squares minus one)", minimum=3, maximum=60)
    rows: int = setting(6, "Inner corners in a column (number of squares minus one)", minimum=3, maximum=60)
    square_m: float = setting(0.025, "Side of a square", minimum=0.0005, maximum=1.0, unit="m")
    marker_m: float = setting(0.018, "Side of a marker (charuco)", minimum=0.0003, maximum=1.0, unit="m")
    dictionary: str = setting(
        "4X4_250",
        "Dictionary of the markers (charuco)",
        choices=("4X4_50", "4X4_100", "4X4_250", "5X5_100", "5X5_250", "6X6_250"),
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        if self.kind == "chessboard":
            if self.columns == self.rows:
                raise ConfigError(
                    f"{self.columns} x {self.rows} inner corners: a plain board needs more columns than rows, "
                    "or the reverse, or nobody can tell how it is turned"
                )
            return
        if self.rows % 2:
            raise ConfigError(
                f"{self.rows} rows of inner corners: a charuco board needs an even number, "
                "because versions of OpenCV disagree about the others' pattern"
            )
        if not self.marker_m <= 0.9 * self.square_m:
            raise ConfigError(
                f"marker_m = {self.marker_m:g} m: at most 0.9 of the square is allowed, {0.9 * self.square_m:g} m"
            )
        markers, known = (self.columns + 1) * (self.rows + 1) // 2, int(self.dictionary.split("_")[1])
        if markers > known:
            raise ConfigError(f"the board has {markers} markers, the dictionary {self.dictionary} only {known}")

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of all squares together, in metres."""
        return (self.columns + 1) * self.square_m, (self.rows + 1) * self.square_m

    @property
    def title(self) -> str:
        """Short description of the board."""
        text = f"{self.kind} {self.columns}x{self.rows} inner corners, squares {self.square_m * 1e3:g} mm"
        return text if self.kind == "chessboard" else f"{text}, markers {self.marker_m * 1e3:g} mm {self.dictionary}"

    def points(self) -> Array:
        """Return (rows * columns, 3) inner corners in metres; the first is (0, 0, 0)."""
        y, x = np.mgrid[0 : self.rows, 0 : self.columns]
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * self.square_m


def aruco_dictionary(name: str) -> Any:
    """Return OpenCV's marker dictionary of that name."""
    return fiducial.dictionary(name)


def _marker_bits(dictionary: Any, number: int) -> npt.NDArray[np.bool_]:
    """Return the marker's cells with its frame, True = white."""
    cells = int(dictionary.markerSize) + 2
    draw = getattr(cv2.aruco, "generateImageMarker", None) or cv2.aruco.drawMarker  # type: ignore[attr-defined]
    return np.asarray(draw(dictionary, number, cells)) > 127


def rectangles(board: CalibrationBoard) -> Iterator[PrintRectangle]:
    """Yield the black and white areas to fill, in order of painting, on white."""
    side = board.square_m
    dictionary = aruco_dictionary(board.dictionary) if board.kind == "charuco" else None
    number = 0
    for row in range(board.rows + 1):
        for column in range(board.columns + 1):
            x, y = column * side, row * side
            if (row + column) % 2 == 0:
                yield PrintRectangle(x, y, side, side, True)
            elif dictionary is not None:
                gap = (side - board.marker_m) / 2
                yield PrintRectangle(x + gap, y + gap, board.marker_m, board.marker_m, True)
                bits = _marker_bits(dictionary, number)
                cell = board.marker_m / len(bits)
                for i, j in np.argwhere(bits):
                    yield PrintRectangle(x + gap + j * cell, y + gap + i * cell, cell, cell, False)
                number += 1


def _sheet(board: CalibrationBoard, paper: str) -> Sheet:
    width, height = (v * 1e3 for v in board.size_m)
    if paper == "fit":
        border = max(board.square_m * 1e3, BORDER_MM)
        page = (max(width, RULER_MM) + 2 * border, height + 2 * border)
    elif paper in PAPERS_MM:
        page = PAPERS_MM[paper] if width >= height else PAPERS_MM[paper][::-1]
    else:
        raise ValueError(f"paper {paper!r} is none of fit, {', '.join(PAPERS_MM)}")
    room = min(page[0] - width, page[1] - height) / 2
    if room < BORDER_MM or page[0] < RULER_MM + 2 * BORDER_MM:
        raise ValueError(
            f"the board is {width:g} x {height:g} mm, the paper {paper} {page[0]:g} x {page[1]:g} mm: a white border "
            f"of {BORDER_MM:g} mm on each side is needed; choose smaller squares or a larger paper"
        )
    notes = (
        board.title,
        f"print at 100 %, no scaling; this line must be {RULER_MM:g} mm long; glue the sheet to a flat plate",
    )
    left, top = (page[0] - width) / 2, (page[1] - height) / 2
    return Sheet(width=page[0], height=page[1], left=left, top=top, notes=notes, rectangles=tuple(rectangles(board)))


def board_svg(board: CalibrationBoard, paper: str = "fit") -> str:
    """Return an SVG document of the board in true size.

    Raises
    ------
    ValueError
        If the paper is unknown or too small.
    """
    return svg(_sheet(board, paper))


def board_pdf(board: CalibrationBoard, paper: str = "fit") -> bytes:
    """Return a PDF document of the board in true size.

    Raises
    ------
    ValueError
        If the paper is unknown or too small.
    """
    return pdf(_sheet(board, paper))
