"""Draws the instrument's screen: graticule, live traces, scales, menus, the marker of a touch."""

from __future__ import annotations

import cv2
import numpy as np

from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import rgb
from icu_common.core.panel.stroke_font import text_strokes
from icu_simulator.core.instrument import (
    MENU_LEFT_SHARE,
    MENUS,
    RED,
    SECONDS_PER_DIVISION,
    VOLTS_PER_DIVISION,
    InstrumentState,
    engineering,
)
from icu_simulator.core.panel_texture import Picture

SIZE_PX = (816, 504)
"""Width and height of the drawn screen; a screen of another size shows the same picture, scaled."""
DIVISIONS = (14, 8)
DIVISION_PX = 52
LEFT_PX, TOP_PX = 22, 44
YELLOW, CYAN, ORANGE, GREEN, WHITE, GREY = "#ffd52e", "#35cdf2", "#ff8a3c", "#2fd15a", "#f2f5f2", "#8b98a4"
_SHIFT = 4


def _colour(value: str) -> tuple[int, int, int]:
    red, green, blue = rgb(value)
    return blue, green, red


def _strokes(picture: Picture, lines: list[Array], colour: str, thickness: int = 1) -> None:
    # A dot is a line of length 0, which cv2 does not draw.
    lines = [line + [[0, 0], [0.7, 0]] if len(line) == 2 and (line[0] == line[1]).all() else line for line in lines]
    points = [np.round(line * (1 << _SHIFT)).astype(np.int32) for line in lines]
    cv2.polylines(picture, points, False, _colour(colour), thickness, cv2.LINE_AA, _SHIFT)


def _text(picture: Picture, text: str, left: float, middle: float, height: float, colour: str) -> float:
    """Write from ``left`` at row ``middle``; return the right end."""
    width = height * (0.88 * (len(text) - 1) + 0.58)
    lines = [line * (1, -1) + (0, 2 * middle) for line in text_strokes(text, (left + width / 2, middle), height)]
    _strokes(picture, lines, colour, 2)
    return left + width


def _box(picture: Picture, text: str, left: float, middle: float, fill: str, ink: str, height: float = 15) -> float:
    width = height * (0.88 * (len(text) - 1) + 0.58)
    corner = (round(left), round(middle - height * 0.95))
    cv2.rectangle(picture, corner, (round(left + width + 16), round(middle + height * 0.95)), _colour(fill), -1)
    return _text(picture, text, left + 8, middle, height, ink) + 8


def still_part(state: InstrumentState, size: tuple[int, int]) -> Picture:
    """Draw the parts that change only with the state; ``size`` is (width, height) in pixels."""
    width, height = size
    picture = np.zeros((height, width, 3), np.uint8)
    picture[:] = (16, 10, 6)
    right, bottom = LEFT_PX + DIVISIONS[0] * DIVISION_PX, TOP_PX + DIVISIONS[1] * DIVISION_PX
    cv2.rectangle(picture, (0, 0), (width, TOP_PX - 8), (44, 34, 26), -1)
    cv2.rectangle(picture, (0, bottom + 8), (width, height), (44, 34, 26), -1)
    for i in range(DIVISIONS[0] + 1):
        x = LEFT_PX + i * DIVISION_PX
        cv2.line(picture, (x, TOP_PX), (x, bottom), (70, 60, 48) if i != 7 else (130, 118, 100), 1)
    for i in range(DIVISIONS[1] + 1):
        y = TOP_PX + i * DIVISION_PX
        cv2.line(picture, (LEFT_PX, y), (right, y), (70, 60, 48) if i != 4 else (130, 118, 100), 1)
    middle = (TOP_PX - 8) / 2
    waiting = state.single_until_s > 0
    mode, fill = ("WAIT", ORANGE) if waiting else ("RUN", GREEN) if state.running else ("STOP", RED)
    end = _box(picture, mode, 10, middle, fill, "#0a0f12" if state.running else WHITE, 17)
    end = _text(picture, "T " + engineering(SECONDS_PER_DIVISION[state.time_index], "s"), end + 26, middle, 15, WHITE)
    end = _text(picture, f"D {state.time_position_div:+.1f}", end + 34, middle, 15, GREY)
    _text(picture, f"TRIG {state.trigger_div:+.1f} DIV", end + 34, middle, 15, YELLOW)
    if state.note:
        _text(picture, state.note, 520, middle, 15, WHITE)
    row = (bottom + 8 + height) / 2
    edge = 12.0
    for channel, (name, colour) in enumerate((("1", YELLOW), ("2", CYAN))):
        scale = engineering(VOLTS_PER_DIVISION[state.volts_index[channel]], "V")
        if state.channels[channel]:
            edge = _box(picture, name, edge, row, colour, "#0a0f12")
            edge = _text(picture, scale, edge + 12, row, 15, colour) + 34
        else:
            edge = _text(picture, name + " OFF", edge + 8, row, 15, GREY) + 34
    if state.math:
        edge = _text(picture, "M 1+2", edge, row, 15, ORANGE) + 30
    _text(picture, "1 kHz", width - 90, row, 15, WHITE)
    level = TOP_PX + (4 - state.trigger_div) * DIVISION_PX
    _strokes(picture, [np.array([[right + 18, level - 7], [right + 4, level], [right + 18, level + 7]])], YELLOW, 2)
    for channel, colour in enumerate((YELLOW, CYAN)):
        if state.channels[channel]:
            row = TOP_PX + (4 - state.position_div[channel]) * DIVISION_PX
            _strokes(picture, [np.array([[4, row - 7], [16, row], [4, row + 7]])], colour, 2)
    return picture


def with_traces(still: Picture, state: InstrumentState, now_s: float, noise: Array) -> Picture:
    """Return a copy of :func:`still_part` with the traces at ``now_s``, and the parts above them.

    Parameters
    ----------
    noise
        (2, N) standard normal values; the trace of each channel gets N points.
    """
    picture = still.copy()
    moment = now_s if state.running else state.phase_s
    share = np.linspace(0, 1, noise.shape[1])
    # The picture's own time: divisions from the middle of the screen. The screen shows a 1 kHz calibration square and a
    # sine, drawn at the chosen scale; above 40 periods per screen, too fast for the eye, it is drawn with 40.
    per_division = SECONDS_PER_DIVISION[state.time_index]
    time = ((share - 0.5) * DIVISIONS[0] - state.time_position_div) * per_division
    rolling = 0.9 * moment
    breath = 1 + 0.04 * np.sin(2.1 * moment)
    hz = min(1000.0, 40 / (DIVISIONS[0] * per_division))
    volts = np.stack(
        [
            0.5 * np.tanh(6 * np.sin(2 * np.pi * hz * time)) * breath,
            1.2 * np.sin(2 * np.pi * (1.7 * hz * time + rolling)) * (1 + 0.1 * np.sin(1.3 * moment)),
        ]
    )
    quiet = noise if state.running else np.zeros_like(noise)
    x = LEFT_PX + share * DIVISIONS[0] * DIVISION_PX
    curves = []
    for channel in (0, 1):
        per_volt = 1 / VOLTS_PER_DIVISION[state.volts_index[channel]]
        curves.append(volts[channel] * per_volt + 0.02 * quiet[channel] + state.position_div[channel])
    drawn = [(curves[c], colour) for c, colour in ((1, CYAN), (0, YELLOW)) if state.channels[c]]
    if state.math:
        drawn.append((sum(curves) - sum(state.position_div), ORANGE))
    for curve, colour in drawn:
        y = TOP_PX + (4 - np.clip(curve, -4, 4)) * DIVISION_PX
        _strokes(picture, [np.column_stack([x, y])], colour, 2)
    _overlays(picture, state)
    return picture


def _overlays(picture: Picture, state: InstrumentState) -> None:
    height, width = picture.shape[:2]
    bottom = TOP_PX + DIVISIONS[1] * DIVISION_PX
    if state.cursors:
        for x in (LEFT_PX + 4 * DIVISION_PX, LEFT_PX + 9 * DIVISION_PX):
            for y in range(TOP_PX, bottom, 14):
                cv2.line(picture, (x, y), (x, y + 7), _colour(GREEN), 2)
        text = "dT " + engineering(5 * SECONDS_PER_DIVISION[state.time_index], "s")
        _box(picture, text.upper(), LEFT_PX + 8, TOP_PX + 18, "#143020", GREEN, 14)
    if state.menu:
        left = round(MENU_LEFT_SHARE * width)
        cv2.rectangle(picture, (left, 0), (width, height), (58, 44, 34), -1)
        cv2.line(picture, (left, 0), (left, height), (180, 160, 120), 2)
        items = (state.menu.replace("_", " "), *MENUS[state.menu])
        cell = height / len(items)
        for index, item in enumerate(items):
            chosen = index - 1 == state.menu_item and index > 0
            top, low = round(index * cell) + 5, round((index + 1) * cell) - 5
            fill = "#2f6fd0" if chosen else "#22303c" if index else "#4a5a68"
            cv2.rectangle(picture, (left + 8, top), (width - 8, low), _colour(fill), -1)
            _text(picture, item, left + 20, (top + low) / 2, 14, WHITE)
    if state.marker is not None:
        x, y = state.marker[0] * width, (1 - state.marker[1]) * height
        for radius in (7, 14):
            cv2.circle(picture, (round(x * 16), round(y * 16)), radius * 16, _colour(WHITE), 2, cv2.LINE_AA, 4)
        _strokes(picture, [np.array([[x - 24, y], [x + 24, y]]), np.array([[x, y - 24], [x, y + 24]])], WHITE, 1)
