"""Surfaces of the bench that are drawn once for a layout: the printed face, the table, and the shadows on both."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import PanelLayout
from icu_simulator.core.panel_texture import Canvas, Picture, draw_face
from icu_simulator.core.solids import LAMP_DIRECTION, SHADOW_REACH
from icu_simulator.manufacture.age import aged
from icu_simulator.manufacture.configuration import ManufactureConfig

FACE_PER_MM = 12.0
TABLE_LEFT_MM, TABLE_TOP_MM = -260.0, 460.0
"""Upper left corner of the table's mat in base_link."""
TABLE_PER_MM = 2.0
_TABLE_MM = 880.0
_SHADOW_BORDER = 100
EXACT = ManufactureConfig()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surfaces:
    """Parts drawn once for a layout: the printed face, the controls' shadows on it, the table, the case's shadow."""

    face: Picture
    face_shadow: npt.NDArray[np.float32]
    table: Picture
    table_shadow: npt.NDArray[np.float32]

    @classmethod
    @functools.lru_cache(maxsize=2)
    def of(cls, layout: PanelLayout, manufacture: ManufactureConfig = EXACT, seed: int = 0) -> Surfaces:
        """Draw the surfaces; drawing takes about a second, so the last ones are kept.

        Parameters
        ----------
        layout
            The panel as manufactured.
        manufacture, seed
            Ageing of the panel.
        """
        age = manufacture.age
        return cls(
            face=aged(layout, age, seed, FACE_PER_MM, draw_face)
            if manufacture.enabled
            else draw_face(layout, FACE_PER_MM),
            face_shadow=_face_shadow(layout),
            table=_table(),
            table_shadow=_table_shadow(layout),
        )


def _table() -> Picture:
    """Draw the mat under the instrument; TABLE_LEFT_MM and TABLE_TOP_MM say where."""
    canvas = Canvas((_TABLE_MM, _TABLE_MM), TABLE_PER_MM, "#39443f")
    for i in range(45):
        colour, line = ("#566660", 0.9) if i % 5 == 0 else ("#45524c", 0.5)
        canvas.rectangle(i * 20.0, 0.0, line, _TABLE_MM, colour)
        canvas.rectangle(0.0, i * 20.0, _TABLE_MM, line, colour)
    return canvas.picture


def shade(shadow: npt.NDArray[np.float32], layout: PanelLayout, x: Array, y: Array) -> npt.NDArray[np.float32]:
    """Look up a shadow map, one texel per mm with a border around the panel, at panel points in mm: (..., 1)."""
    rows = np.asarray(layout.size_mm[1] + _SHADOW_BORDER - 0.5 - y, np.float32)
    columns = np.asarray(x + (_SHADOW_BORDER - 0.5), np.float32)
    found = cv2.remap(shadow, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.float32)[..., None]


def _empty_shadow(layout: PanelLayout) -> npt.NDArray[np.float32]:
    width, height = (round(side) + 2 * _SHADOW_BORDER for side in layout.size_mm)
    return np.zeros((height, width), np.float32)


def _table_shadow(layout: PanelLayout) -> npt.NDArray[np.float32]:
    """Return the case's soft shadow on the table as factors; it falls to the right and down."""
    shadow = _empty_shadow(layout)
    top, left = _SHADOW_BORDER + 16, _SHADOW_BORDER + 10
    shadow[top : top + round(layout.size_mm[1]), left : left + round(layout.size_mm[0])] = 1.0
    return np.asarray(1 - 0.55 * cv2.GaussianBlur(shadow, (0, 0), 8), dtype=np.float32)


def _face_shadow(layout: PanelLayout) -> npt.NDArray[np.float32]:
    """Return the controls' soft shadows on the face as factors."""
    shadow = _empty_shadow(layout)
    for control in layout.controls:
        for step in np.linspace(0, 1, 6) if control.height_mm > 0 else ():
            reach = SHADOW_REACH * control.height_mm * step
            x = control.position_mm[0] - LAMP_DIRECTION[0] * reach + _SHADOW_BORDER
            y = layout.size_mm[1] - control.position_mm[1] + LAMP_DIRECTION[1] * reach + _SHADOW_BORDER
            half_x, half_y = (side / 2 for side in control.size_mm)
            # Sixteenths of a millimetre, with half a texel between a texel's corner and its centre.
            centre = (round((x - 0.5) * 16), round((y - 0.5) * 16))
            if control.shape == "circle":
                cv2.circle(shadow, centre, round(half_x * 16), (1.0,), -1, shift=4)
            else:
                reach_px = round(half_x * 16), round(half_y * 16)
                low, high = (tuple(c + sign * r for c, r in zip(centre, reach_px)) for sign in (-1, 1))
                cv2.rectangle(shadow, low, high, (1.0,), -1, shift=4)
    return np.asarray(1 - 0.38 * cv2.GaussianBlur(shadow, (0, 0), 1.6), dtype=np.float32)
