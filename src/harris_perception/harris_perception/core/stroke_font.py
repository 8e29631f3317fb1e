"""Capitals as strokes, so that a panel's template looks the same under every OpenCV.

The shapes are those of A. V. Hershey, "Calligraphy for Computers", NWL report TR-2101, 1967 (simplex Roman): cap height
21 units, baseline at 0. OpenCV 4's Hershey fonts are the same; OpenCV 5 draws another typeface under their names.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

CAP_HEIGHT = 21

_BOWL = "4 21 4 0|4 21 13 21 16 20 17 19 18 17 18 {} 17 {} 16 {} 13 {} 4 {}"
_OVAL = "9 21 7 20 5 18 4 16 3 13 3 8 4 5 5 3 7 1 9 0 13 0 15 1 17 3 18 5 19 8 19 13 18 16 17 18 15 20 13 21 9 21"
_C = "18 16 17 18 15 20 13 21 9 21 7 20 5 18 4 16 3 13 3 8 4 5 5 3 7 1 9 0 13 0 15 1 17 3 18 5"

# character: advance width, strokes as x y x y ... separated by |
_GLYPHS: dict[str, tuple[int, str]] = {
    " ": (16, ""),
    "A": (18, "9 21 1 0|9 21 17 0|4 7 14 7"),
    "B": (21, _BOWL.format(15, 13, 12, 11, 11) + "|13 11 16 10 17 9 18 7 18 4 17 2 16 1 13 0 4 0"),
    "C": (21, _C),
    "D": (21, "4 21 4 0|4 21 11 21 14 20 16 18 17 16 18 13 18 8 17 5 16 3 14 1 11 0 4 0"),
    "E": (19, "4 21 4 0|4 21 17 21|4 11 12 11|4 0 17 0"),
    "F": (18, "4 21 4 0|4 21 17 21|4 11 12 11"),
    "G": (21, _C + " 18 8|13 8 18 8"),
    "H": (22, "4 21 4 0|18 21 18 0|4 11 18 11"),
    "I": (8, "4 21 4 0"),
    "J": (16, "12 21 12 5 11 2 10 1 8 0 6 0 4 1 3 2 2 5 2 7"),
    "K": (21, "4 21 4 0|18 21 4 7|9 12 18 0"),
    "L": (17, "4 21 4 0|4 0 16 0"),
    "M": (24, "4 21 4 0|4 21 12 0|20 21 12 0|20 21 20 0"),
    "N": (22, "4 21 4 0|4 21 18 0|18 21 18 0"),
    "O": (22, _OVAL),
    "P": (21, _BOWL.format(14, 12, 11, 10, 10)),
    "Q": (22, _OVAL + "|12 4 18 -2"),
    "R": (21, _BOWL.format(15, 13, 12, 11, 11) + "|11 11 18 0"),
    "S": (
        20,
        "17 18 15 20 12 21 8 21 5 20 3 18 3 16 4 14 5 13 7 12 13 10 15 9 16 8 17 6 17 3 15 1 12 0 8 0 5 1 3 3",
    ),
    "T": (16, "8 21 8 0|1 21 15 21"),
    "U": (22, "4 21 4 6 5 3 7 1 10 0 12 0 15 1 17 3 18 6 18 21"),
    "V": (18, "1 21 9 0|17 21 9 0"),
    "W": (24, "2 21 7 0|12 21 7 0|12 21 17 0|22 21 17 0"),
    "X": (20, "3 21 17 0|17 21 3 0"),
    "Y": (18, "1 21 9 11 9 0|17 21 9 11"),
    "Z": (20, "17 21 3 0|3 21 17 21|3 0 17 0"),
    "0": (20, "9 21 6 20 4 17 3 12 3 9 4 4 6 1 9 0 11 0 14 1 16 4 17 9 17 12 16 17 14 20 11 21 9 21"),
    "1": (20, "6 17 8 18 11 21 11 0"),
    "2": (20, "4 16 4 17 5 19 6 20 8 21 12 21 14 20 15 19 16 17 16 15 15 13 13 10 3 0 17 0"),
    "3": (20, "5 21 16 21 10 13 13 13 15 12 16 11 17 8 17 6 16 3 14 1 11 0 8 0 5 1 4 2 3 4"),
    "4": (20, "13 21 3 7 18 7|13 21 13 0"),
    "5": (20, "15 21 5 21 4 12 5 13 8 14 11 14 14 13 16 11 17 8 17 6 16 3 14 1 11 0 8 0 5 1 4 2 3 4"),
    "6": (
        20,
        "16 18 15 20 12 21 10 21 7 20 5 17 4 12 4 7 5 3 7 1 10 0 11 0 14 1 16 3 17 6 17 7 16 10 14 12 11 13 10 13 7 12 "
        "5 10 4 7",
    ),
    "7": (20, "17 21 7 0|3 21 17 21"),
    "8": (
        20,
        "8 21 5 20 4 18 4 16 5 14 7 13 11 12 14 11 16 9 17 7 17 4 16 2 15 1 12 0 8 0 5 1 4 2 3 4 3 7 4 9 6 11 9 12 13 "
        "13 15 14 16 16 16 18 15 20 12 21 8 21",
    ),
    "9": (
        20,
        "16 14 15 11 13 9 10 8 9 8 6 9 4 11 3 14 3 15 4 18 6 20 9 21 10 21 13 20 15 18 16 14 16 9 15 4 13 1 10 0 8 0 5 "
        "1 4 3",
    ),
    "/": (22, "20 25 2 -7"),
    "-": (26, "4 9 22 9"),
    "+": (26, "13 18 13 0|4 9 22 9"),
    ".": (10, "5 2 4 1 5 0 6 1 5 2"),
    ":": (10, "5 14 4 13 5 12 6 13 5 14|5 2 4 1 5 0 6 1 5 2"),
    "_": (16, "0 -2 16 -2"),
}


def strokes(text: str, height: float) -> list[npt.NDArray[np.float64]]:
    """Return the polylines of ``text``, each (N, 2), x right and y up, centred at the origin.

    Parameters
    ----------
    text
        Drawn in capitals; a character that the font lacks leaves a gap.
    height
        Cap height; the result has the same unit.
    """
    lines: list[npt.NDArray[np.float64]] = []
    left = 0
    for character in text.upper():
        advance, glyph = _GLYPHS.get(character, _GLYPHS[" "])
        for stroke in filter(None, glyph.split("|")):
            line = np.array(stroke.split(), dtype=np.float64).reshape(-1, 2)
            lines.append(line + (left, 0.0))
        left += advance
    scale = height / CAP_HEIGHT
    return [(line - (left / 2, CAP_HEIGHT / 2)) * scale for line in lines]
