"""Printed markers: their size on paper, and that OpenCV's detector finds each one where it should be."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest

from harris_perception.cli.calibrate import main
from harris_perception.core.cameras.marker_sheet import marker_sheet
from harris_perception.core.cameras.print_page import pdf, svg
from icu_common.core.geometry.fiducial import dictionary

PX_PER_MM = 10


def painted(text: str) -> np.ndarray:
    """Return the SVG's rectangles as an image of 10 pixels per millimetre."""
    root = ET.fromstring(text)
    width, height = (float(root.attrib[name].removesuffix("mm")) for name in ("width", "height"))
    image = np.full((round(height * PX_PER_MM), round(width * PX_PER_MM)), 128, np.uint8)
    for item in root.iter("{http://www.w3.org/2000/svg}rect"):
        x, y, w, h = (round(float(item.get(key, 0)) * PX_PER_MM) for key in ("x", "y", "width", "height"))
        image[y : y + h, x : x + w] = 0 if item.get("fill") == "#000" else 255
    return image


@pytest.mark.parametrize("name", ["APRILTAG_36h11", "4X4_50"])
def test_each_marker_is_found_in_true_size(name: str) -> None:
    numbers = [3, 7, 12, 40, 1]
    image = painted(svg(marker_sheet(name, numbers, 30.0)))
    assert image.shape == (2100, 2970), "a4"
    corners, found, _ = cv2.aruco.ArucoDetector(dictionary(name)).detectMarkers(image)
    assert sorted(found.ravel().tolist()) == sorted(numbers)
    for quad in corners:
        sides = np.linalg.norm(quad[0] - np.roll(quad[0], 1, axis=0), axis=1) / PX_PER_MM
        assert sides == pytest.approx([30.0] * 4, abs=0.3)
    places = dict(zip(found.ravel().tolist(), (quad[0].mean(axis=0) for quad in corners)))
    assert places[3][0] < places[7][0] and places[3][1] == pytest.approx(places[7][1], abs=2), "in reading order"


def test_pdf_has_the_size_of_the_paper_and_a_label_for_each_marker() -> None:
    document = pdf(marker_sheet("APRILTAG_36h11", [3, 4], 12.0, "letter")).decode("ascii")
    box = re.search(r"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", document)
    assert box and (float(box[1]), float(box[2])) == pytest.approx((792.0, 612.0))
    assert "(APRILTAG_36h11 3) Tj" in document and "(APRILTAG_36h11 4) Tj" in document
    assert "keep a white rim of 1.5 mm" in document


@pytest.mark.parametrize(
    ("numbers", "size_mm", "text"),
    [
        ([60], 12.0, "marker 60: the dictionary 4X4_50 has the numbers 0 to 49"),
        ([1, 1], 12.0, "markers 1, 1: expected one or more numbers, each once"),
        ([1], 0.0, "size 0 mm: expected a size above 0"),
        ([1, 2, 3], 120.0, "3 markers of 120 mm: the paper a4 has room for 1"),
    ],
)
def test_wrong_orders_are_rejected_with_the_reason(numbers: list[int], size_mm: float, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        marker_sheet("4X4_50", numbers, size_mm)


def test_command_writes_both_forms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(tmp_path / "m.svg"), str(tmp_path / "m.pdf")]
    assert main(["markers", *files, "--ids", "3", "4"]) == 0
    assert Path(files[0]).read_text().count("APRILTAG_36h11 ") >= 2
    assert Path(files[1]).read_bytes().startswith(b"%PDF-1.6")
    assert main(["markers", str(tmp_path / "m.txt"), "--ids", "3"]) == 2
    assert "must end in .svg or .pdf" in capsys.readouterr().err
