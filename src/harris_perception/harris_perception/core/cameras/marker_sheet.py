"""Sheets of markers (ArUco, AprilTag) in true size, to glue on the face of a panel."""

from __future__ import annotations

from collections.abc import Sequence

from harris_perception.core.cameras.print_page import BORDER_MM, PAPERS_MM, RULER_MM, Label, PrintRectangle, Sheet
from icu_common.core.geometry.fiducial import Fiducial, count_of

_BETWEEN_MM = 8.0
"""Room between two markers, for a cut and the label below."""


def marker_sheet(dictionary: str, numbers: Sequence[int], size_mm: float, paper: str = "a4") -> Sheet:
    """Return a sheet with one marker for each number, row by row, with its name and size below it.

    Parameters
    ----------
    dictionary
        One of :data:`icu_common.core.geometry.fiducial.DICTIONARIES`.
    numbers
        Numbers of the markers, each once.
    size_mm
        Side of the black square.
    paper
        A key of :data:`harris_perception.core.cameras.print_page.PAPERS_MM`.

    Raises
    ------
    ValueError
        If the dictionary has no such marker, a number is given twice, or the sheet is too small.
    """
    count = count_of(dictionary)
    for number in numbers:
        if not 0 <= number < count:
            raise ValueError(f"marker {number}: the dictionary {dictionary} has the numbers 0 to {count - 1}")
    if not numbers or len(set(numbers)) < len(numbers):
        raise ValueError(f"markers {', '.join(map(str, numbers))}: expected one or more numbers, each once")
    if not size_mm > 0:
        raise ValueError(f"size {size_mm:g} mm: expected a size above 0")
    width, height = PAPERS_MM[paper]
    side = Fiducial(dictionary=dictionary, id=0, position_mm=(0.0, 0.0), size_mm=size_mm).side_mm
    pitch = side + _BETWEEN_MM
    columns, rows = (int((room - 2 * BORDER_MM + _BETWEEN_MM) / pitch) for room in (width, height - BORDER_MM))
    if columns * rows < len(numbers):
        raise ValueError(
            f"{len(numbers)} markers of {size_mm:g} mm: the paper {paper} has room for {columns * rows}; "
            "choose smaller or fewer markers, or a larger paper"
        )
    rectangles: list[PrintRectangle] = []
    labels: list[Label] = []
    for place, number in enumerate(numbers):
        left, top = (place % columns) * pitch, (place // columns) * pitch
        middle = (left + side / 2, top + side / 2)
        marker = Fiducial(dictionary=dictionary, id=number, position_mm=(middle[0], -middle[1]), size_mm=size_mm)
        x, y = middle[0] - size_mm / 2, middle[1] - size_mm / 2
        rectangles.append(_in_metres(x, y, size_mm, size_mm, black=True))
        rectangles += [_in_metres(x, -y - h, w, h, black=False) for x, y, w, h in marker.white_mm()]
        labels.append(Label(left * 1e-3, (top + side + 2.5) * 1e-3, f"{marker.name}"))
    notes = (
        f"{dictionary} markers, black square {size_mm:g} mm; keep a white rim of {(side - size_mm) / 2:.3g} mm",
        f"print at 100 %, no scaling; this line must be {RULER_MM:g} mm long",
    )
    return Sheet(
        width=width, height=height, left=BORDER_MM, top=BORDER_MM, notes=notes, rectangles=rectangles, labels=labels
    )


def _in_metres(x: float, y: float, width: float, height: float, *, black: bool) -> PrintRectangle:
    return PrintRectangle(x * 1e-3, y * 1e-3, width * 1e-3, height * 1e-3, black)
