"""Boards: what is refused, and drawings of true size whose painted pixels OpenCV recognises."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from typing import Any

import cv2
import numpy as np
import pytest

from harris_perception.core.cameras.board import CalibrationBoard, board_pdf, board_svg, rectangles
from harris_perception.core.cameras.board_detection import BoardDetector
from icu_common.core.configuration.config import ConfigError

CHESS = CalibrationBoard(columns=9, rows=6, square_m=0.024)
CHARUCO = CalibrationBoard(kind="charuco", columns=9, rows=6, square_m=0.024, marker_m=0.018)
PER_MM = 4


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"columns": 6, "rows": 6}, "more columns than rows"),
        ({"kind": "charuco", "columns": 9, "rows": 5}, "even number"),
        ({"kind": "charuco", "marker_m": 0.024}, "at most 0.9 of the square"),
        ({"kind": "charuco", "columns": 20, "rows": 10, "dictionary": "4X4_50"}, "115 markers.*only 50"),
        ({"columns": 2}, "below its minimum 3"),
        ({"square_m": 25.0}, "above its maximum 1 m"),
        ({"kind": "circles"}, "none of chessboard, charuco"),
    ],
)
def test_impossible_boards_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        CalibrationBoard(**values)


def painted_svg(text: str) -> tuple[Any, tuple[float, float]]:
    """Paint an SVG of rectangles; return the pixels and the size in mm that its header claims."""
    root = ET.fromstring(text)
    size = tuple(float(str(root.get(key)).removesuffix("mm")) for key in ("width", "height"))
    assert str(root.get("width")).endswith("mm") and root.get("viewBox") == "0 0 {:.4f} {:.4f}".format(*size)
    pixels = np.zeros((round(size[1] * PER_MM), round(size[0] * PER_MM)), np.uint8)
    for item in root.iter("{http://www.w3.org/2000/svg}rect"):
        x, y, w, h = (float(item.get(key, "0")) * PER_MM for key in ("x", "y", "width", "height"))
        pixels[round(y) : round(y + h), round(x) : round(x + w)] = 0 if item.get("fill") == "#000" else 255
    return pixels, (size[0], size[1])


def painted_pdf(document: bytes) -> tuple[Any, tuple[float, float]]:
    """Paint the rectangles of a PDF's page; return the pixels and the size of the page in mm."""
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", document)
    stream = re.search(rb"<< /Length (\d+) >>\nstream\n(.*)\nendstream", document, re.DOTALL)
    assert box is not None and stream is not None
    assert int(stream[1]) == len(stream[2])
    size = (float(box[1]) / 72 * 25.4, float(box[2]) / 72 * 25.4)
    first, *lines = stream[2].decode().split("\n")
    scale = float(first.split()[0]) / 72 * 25.4
    assert first.endswith("cm") and scale == pytest.approx(1, abs=1e-6)
    pixels = np.full((round(size[1] * PER_MM), round(size[0] * PER_MM)), 255, np.uint8)
    for line in lines:
        if line.endswith("re f"):
            gray, _, x, y, w, h = line.split()[:6]
            left, low, right, high = (float(v) * PER_MM for v in (x, y, float(x) + float(w), float(y) + float(h)))
            rows = slice(round(size[1] * PER_MM - high), round(size[1] * PER_MM - low))
            pixels[rows, round(left) : round(right)] = 255 * int(gray)
    return pixels, size


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chessboard", "charuco"])
@pytest.mark.parametrize("form", ["svg", "pdf"])
def test_drawing_has_true_size_and_is_recognised(board: CalibrationBoard, form: str) -> None:
    pixels, size = painted_svg(board_svg(board, "a4")) if form == "svg" else painted_pdf(board_pdf(board, "a4"))
    assert size == pytest.approx((297, 210), abs=1e-3)
    view = BoardDetector(board).detect(pixels, form)
    assert view is not None and np.array_equal(np.sort(view.ids), np.arange(54))
    # OpenCV counts a plain board from either end.
    xy = view.xy[np.argsort(view.ids)]
    mm = (xy if xy[0, 0] < xy[-1, 0] else xy[::-1]) / PER_MM + 0.5 / PER_MM
    expected = board.points()[:, :2] * 1e3
    assert np.abs((mm - mm.mean(axis=0)) - (expected - expected.mean(axis=0))).max() < 0.05
    assert np.abs(mm.mean(axis=0) - (148.5, 105)).max() < 0.05


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chessboard", "charuco"])
@pytest.mark.parametrize("shape", [(0, 0), (1, 1), (12, 12), (5, 300), (16, 16), (17, 40)])
def test_too_small_a_picture_shows_no_board(board: CalibrationBoard, shape: tuple[int, int]) -> None:
    for quick in (False, True):
        for picture in (np.zeros(shape, np.uint8), np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)):
            assert BoardDetector(board, quick=quick).detect(picture, "small") is None


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chessboard", "charuco"])
def test_first_square_is_black_and_as_large_as_said(board: CalibrationBoard) -> None:
    first = next(rectangles(board))
    assert first == (0, 0, 0.024, 0.024, True)
    assert board.size_m == pytest.approx((0.24, 0.168))


DRAWS_BOARDS = hasattr(getattr(cv2, "aruco", None), "CharucoDetector")


@pytest.mark.skipif(not DRAWS_BOARDS, reason="this OpenCV draws boards otherwise")
def test_charuco_equals_the_library_s_own_drawing() -> None:
    made = cv2.aruco.CharucoBoard((10, 7), 0.024, 0.018, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250))
    theirs = made.generateImage((10 * 24 * PER_MM, 7 * 24 * PER_MM))
    pixels, _ = painted_svg(board_svg(CHARUCO, "a4"))
    top, left = round((210 - 168) / 2 * PER_MM), round((297 - 240) / 2 * PER_MM)
    ours = pixels[top : top + theirs.shape[0], left : left + theirs.shape[1]]
    assert np.mean(np.abs(ours.astype(int) - theirs) > 128) < 0.02


def test_every_pdf_object_is_where_the_table_says() -> None:
    document = board_pdf(CHARUCO)
    start = int(re.findall(rb"startxref\n(\d+)\n", document)[0])
    assert document[start : start + 4] == b"xref" and document.endswith(b"%%EOF\n")
    places = [int(p) for p in re.findall(rb"(\d{10}) 00000 n ", document)]
    assert len(places) == 5
    for number, place in enumerate(places, start=1):
        assert document[place:].startswith(b"%d 0 obj" % number)


def test_ruler_is_100_mm_and_paper_must_be_large_enough() -> None:
    ruler = [line for line in board_svg(CHESS).split("\n") if 'height="0.3"' in line]
    assert len(ruler) == 1 and 'width="100"' in ruler[0]
    with pytest.raises(ValueError, match=r"450 x 315 mm, the paper a4 297 x 210 mm"):
        board_svg(CalibrationBoard(columns=9, rows=6, square_m=0.045), "a4")
    with pytest.raises(ValueError, match="paper 'b5' is none of fit, a4"):
        board_pdf(CHESS, "b5")
    assert 'width="420.0000mm"' in board_svg(CalibrationBoard(columns=9, rows=6, square_m=0.036), "a3")
