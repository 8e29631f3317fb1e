"""A plain stroke font, so that the print of a panel does not depend on the version of a drawing library."""

from __future__ import annotations

import numpy as np

from icu_common.core.geometry.geometry import Array

# A character, ";", and polylines of points "xy" on a grid four wide and six high, separated by "|".
_TABLE = """
A;00 04 26 44 40|03 43   B;00 06 36 45 44 33 03|33 42 41 30 00   C;45 36 16 05 01 10 30 41
D;00 06 26 44 42 20 00   E;46 06 00 40|03 33   F;46 06 00|03 33   G;45 36 16 05 01 10 30 41 43 23
H;00 06|40 46|03 43   I;20 26|10 30|16 36   J;36 31 20 10 01   K;00 06|46 03 40   L;06 00 40
M;00 06 23 46 40   N;00 06 40 46   O;10 30 41 45 36 16 05 01 10   P;00 06 36 45 44 33 03
Q;10 30 41 45 36 16 05 01 10|22 40   R;00 06 36 45 44 33 03|23 40   S;45 36 16 05 04 13 33 42 41 30 10 01
T;06 46|26 20   U;06 01 10 30 41 46   V;06 20 46   W;06 10 24 30 46   X;00 46|06 40   Y;06 23 46|23 20
Z;06 46 00 40   0;10 30 41 45 36 16 05 01 10|11 35   1;14 26 20|10 30   2;05 16 36 45 44 00 40
3;05 16 36 45 44 33 23|33 42 41 30 10 01   4;30 36 02 42   5;46 06 03 33 42 41 30 10 01
6;45 36 16 05 01 10 30 41 42 33 03   7;06 46 10   8;13 04 05 16 36 45 44 33 13 02 01 10 30 41 42 33
9;01 10 30 41 45 36 16 05 04 13 43   /;00 46   -;13 33   +;03 43|21 25   .;20 20   ,;21 10   :;21 21|24 24
=;02 42|04 44   %;00 46|05 05|41 41   (;36 25 21 30   );16 25 21 10   <;35 13 31   >;15 33 11   _;00 40
#;10 16|30 36|02 42|04 44   &;40 05 16 25 02 01 10 20 42   ';26 24   !;26 22|20 20
?;05 16 36 45 44 23 22|20 20   °;15 26 35 24 15   k;00 06|34 02 30   m;00 04|03 14 23 20|23 34 43 40
n;00 04|03 14 34 43 40   s;44 14 03 12 32 41 30 00   u;04 01 10 30 41|44 40   z;04 44 00 40
"""
_GLYPHS = {" ": ""} | {entry[0]: entry[2:] for line in _TABLE.split("\n") for entry in line.split("   ") if entry}
_WIDTH, _ADVANCE = 0.58, 0.88  # of the capitals' height


def text_strokes(text: str, at: tuple[float, float], height: float) -> list[Array]:
    """Return the polylines, each (N, 2) with N >= 2, of ``text`` centred at ``at``.

    Parameters
    ----------
    text
        Capitals, digits and some signs; lower-case letters without their own shape become capitals.
    at
        Centre x, y (y up), any unit.
    height
        Height of a capital in the same unit.

    Raises
    ------
    ValueError
        For a character that the font does not have.
    """
    left = at[0] - (_ADVANCE * (len(text) - 1) + _WIDTH) * height / 2
    strokes = []
    for index, character in enumerate(text):
        shape = _GLYPHS.get(character, _GLYPHS.get(character.upper()))
        if shape is None:
            raise ValueError(f"text {text!r}: the stroke font has no {character!r}")
        origin = np.array([left + index * _ADVANCE * height, at[1] - height / 2])
        for polyline in filter(None, shape.split("|")):
            grid = np.array([[int(point[0]), int(point[1])] for point in polyline.split()], dtype=np.float64)
            strokes.append(origin + grid * (_WIDTH / 4, 1 / 6) * height)
    return strokes
