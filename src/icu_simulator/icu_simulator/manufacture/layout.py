"""Draws the layout of the manufactured panel, which the bench touches and renders: the reference of the truth."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from icu_common.core.panel.panel_layout import (
    Artwork,
    ArtworkCircle,
    ArtworkLine,
    ArtworkRectangle,
    ArtworkText,
    Control,
    PanelLayout,
    rgb,
)
from icu_common.core.panel.stroke_font import text_strokes
from icu_simulator.manufacture.configuration import ManufactureConfig, PrintConfig

SCREW_MM, SCREW_INSET_MM = 2.1, 4.6
"""Radius of a screw's head (M2.5 pan head), and its distance from the edges of the face."""
_LOWEST_MM = 0.3
"""Minimum height in mm of a protruding control."""


def manufactured(layout: PanelLayout, config: ManufactureConfig, seed: int) -> PanelLayout:
    """Return the layout of the panel as manufactured, or ``layout`` itself if manufacture is exact.

    Parameters
    ----------
    layout
        The nominal panel.
    config
        Maximum deviations.
    seed
        Seed of the deviations; equal seeds give equal panels.
    """
    if not config.enabled:
        return layout
    rng = np.random.default_rng((seed, 1))
    controls = tuple(_made_control(control, layout, config, rng) for control in layout.controls)
    offset = rng.uniform(-1, 1, 2) * config.print.offset_mm
    at = (float(offset[0]), float(offset[1]))
    artwork = [shape for item in layout.artwork for shape in _printed(item, at, config.print)]
    if config.age.screws:
        artwork += _screws(layout, controls, rng)
    colour = _painted(layout.colour, config.colour_levels, rng)
    markers = tuple(
        dataclasses.replace(marker, position_mm=(marker.position_mm[0] + at[0], marker.position_mm[1] + at[1]))
        for marker in layout.markers
    )
    return dataclasses.replace(layout, colour=colour, controls=controls, artwork=tuple(artwork), markers=markers)


def deviations(nominal: PanelLayout, made: PanelLayout) -> dict[str, dict[str, list[float]]]:
    """Return true centre and height (3,) of each control in mm, and their differences from the nominal values."""
    found = {}
    for control in made.controls:
        other = nominal.control(control.name)
        true = np.array([*control.position_mm, control.height_mm])
        off = true - np.array([*other.position_mm, other.height_mm])
        found[control.name] = {"true_mm": np.round(true, 4).tolist(), "off_mm": np.round(off, 4).tolist()}
    return found


def print_offset_mm(nominal: PanelLayout, made: PanelLayout) -> tuple[float, float]:
    """Return the offset of the print of a manufactured panel: points of the face that are known by the print have it.

    Raises
    ------
    ValueError
        If the panel has no printed rectangle or circle.
    """
    for kind in (ArtworkRectangle, ArtworkCircle):
        pairs = zip(*([item for item in panel.artwork if isinstance(item, kind)] for panel in (nominal, made)))
        for before, after in pairs:
            (x0, y0), (x1, y1) = (_corner(before), _corner(after))
            return x1 - x0, y1 - y0
    raise ValueError(f"panel {nominal.model}: no rectangle or circle is printed on it")


def _corner(item: Artwork) -> tuple[float, float]:
    if isinstance(item, ArtworkRectangle):
        return item.rectangle_mm[0], item.rectangle_mm[1]
    assert isinstance(item, ArtworkCircle)
    return item.circle_mm[0], item.circle_mm[1]


def _made_control(
    control: Control, layout: PanelLayout, config: ManufactureConfig, rng: np.random.Generator
) -> Control:
    dx, dy, dz = rng.uniform(-1, 1, 3)
    # Controls stay inside the face: otherwise the case could not be closed.
    half = np.array(control.size_mm) / 2
    moved = np.array(control.position_mm) + np.array([dx, dy]) * config.position_mm
    x, y = np.clip(moved, half, np.array(layout.size_mm) - half)
    height = control.height_mm
    if height > 0:
        height = max(height + dz * config.height_mm, min(height, _LOWEST_MM))
    colour = _painted(control.colour, config.colour_levels, rng)
    return dataclasses.replace(control, position_mm=(float(x), float(y)), height_mm=float(height), colour=colour)


def _painted(colour: str, levels: float, rng: np.random.Generator) -> str:
    shade = np.clip(np.rint(np.array(rgb(colour)) + rng.uniform(-levels, levels)), 0, 255).astype(int)
    return "#" + "".join(f"{int(value):02x}" for value in shade)


def _printed(item: Artwork, offset: tuple[float, float], config: PrintConfig) -> list[Artwork]:
    dx, dy = offset
    if isinstance(item, ArtworkRectangle):
        x, y, width, height = item.rectangle_mm
        return [dataclasses.replace(item, rectangle_mm=(x + dx, y + dy, width, height))]
    if isinstance(item, ArtworkCircle):
        x, y, radius = item.circle_mm
        return [dataclasses.replace(item, circle_mm=(x + dx, y + dy, radius))]
    if isinstance(item, ArtworkLine):
        x0, y0, x1, y1 = item.line_from_to_mm
        return [dataclasses.replace(item, line_from_to_mm=(x0 + dx, y0 + dy, x1 + dx, y1 + dy))]
    return _lettered(item, offset, config)


def _lettered(item: ArtworkText, offset: tuple[float, float], config: PrintConfig) -> list[Artwork]:
    """Return the letters as lines, which are enough for another width and slant."""
    centre, at = np.array(item.at_mm), np.array(item.at_mm) + offset
    shape = np.array([[config.font_width, config.font_slant], [0.0, config.font_height]])
    lines: list[Artwork] = []
    for stroke in text_strokes(item.text, item.at_mm, item.height_mm):
        points = at + (stroke - centre) @ shape.T
        lines += [
            ArtworkLine(
                line_from_to_mm=(float(a[0]), float(a[1]), float(b[0]), float(b[1])),
                colour=item.colour,
                line_mm=item.line_mm * config.font_weight,
            )
            for a, b in itertools.pairwise(points)
        ]
    return lines


def _screws(layout: PanelLayout, controls: tuple[Control, ...], rng: np.random.Generator) -> list[Artwork]:
    width, height = layout.size_mm
    shapes: list[Artwork] = []
    for x, y in itertools.product((SCREW_INSET_MM, width - SCREW_INSET_MM), (SCREW_INSET_MM, height - SCREW_INSET_MM)):
        angle = rng.uniform(0, np.pi)
        if any(
            abs(x - c.position_mm[0]) < c.size_mm[0] / 2 + SCREW_MM
            and abs(y - c.position_mm[1]) < c.size_mm[1] / 2 + SCREW_MM
            for c in controls
        ):
            continue
        dx, dy = 0.8 * SCREW_MM * np.array([np.cos(angle), np.sin(angle)])
        shapes += [
            ArtworkCircle(circle_mm=(x, y, SCREW_MM), fill="#9a9d9a", outline="#5a5d5a", line_mm=0.3),
            ArtworkLine(line_from_to_mm=(x - dx, y - dy, x + dx, y + dy), colour="#3a3c3a", line_mm=0.5),
        ]
    return shapes
