"""Layout of a front panel in millimetres: the single source for its image, its controls and its drawing.

Origin at the lower left corner of the panel's face, x right, y up; ``height_mm`` is how far a control protrudes.
Read from ``config/scopes/<model>.yaml``; errors name the file and the line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from icu_common.core.configuration.yaml_entries import LineLoader, YamlEntries
from icu_common.core.configuration.yaml_text import UNREADABLE, mistake
from icu_common.core.geometry.fiducial import DICTIONARIES, Fiducial, count_of
from icu_common.core.panel.gesture import is_mark, is_name
from icu_common.core.panel.stroke_font import text_strokes
from icu_common.core.reasons.message import Message, quoted

CONTROL_KINDS = ("button", "knob", "touch_area", "connector")
SHAPES = ("rectangle", "circle")
TOLERANCE_MM = 0.2
"""Tolerance of a layout that declares none: the accuracy of careful measurement with a caliper."""
MAX_TOLERANCE_MM = 5.0


class LayoutError(ValueError):
    """A layout file is wrong; the message has the form ``file:line: what is wrong``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dimple:
    """A round recess with a flat bottom in a knob's top, for a finger that turns the knob.

    ``place_mm`` is its middle relative to the middle of the knob while the marker points up, x right and y up.
    """

    place_mm: tuple[float, float]
    diameter_mm: float
    depth_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """A part of the panel that can be touched or must be avoided.

    ``position_mm`` is the centre, ``size_mm`` (width, height), for a circle the diameter twice. ``lit_colour`` is the
    colour of its lit lamp, empty without a lamp. The clicks of a knob are ``detent_deg`` apart (0: no clicks), and
    ``marks`` are its marked positions, name and degrees, counter-clockwise from up. It may have a ``dimple``.
    """

    name: str
    kind: str
    position_mm: tuple[float, float]
    size_mm: tuple[float, float]
    shape: str = "rectangle"
    height_mm: float = 0.0
    label: str = ""
    colour: str = "#404448"
    lit_colour: str = ""
    detent_deg: float = 0.0
    marks: tuple[tuple[str, float], ...] = ()
    dimple: Dimple | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ArtworkRectangle:
    """Artwork: lower left corner, width and height in mm; ``fill`` may be empty for an outline of ``line_mm``."""

    rectangle_mm: tuple[float, float, float, float]
    fill: str = ""
    outline: str = ""
    line_mm: float = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class ArtworkCircle:
    """Artwork: centre x, y and radius in mm."""

    circle_mm: tuple[float, float, float]
    fill: str = ""
    outline: str = ""
    line_mm: float = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class ArtworkLine:
    """Artwork: from x, y to x, y in mm."""

    line_from_to_mm: tuple[float, float, float, float]
    colour: str = "#d8dcd8"
    line_mm: float = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class ArtworkText:
    """Artwork: Hershey simplex capitals of ``height_mm``, centred at ``at_mm``."""

    text: str
    at_mm: tuple[float, float]
    height_mm: float = 3.0
    colour: str = "#e8ece8"
    line_mm: float = 0.4


Artwork = ArtworkRectangle | ArtworkCircle | ArtworkLine | ArtworkText


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelLayout:
    """A whole front panel; ``colour`` is that of the face, ``artwork`` is drawn in order, then the controls.

    ``markers`` are the positions of markers on the face; their print is the last part of ``artwork``.
    ``tolerance_mm`` is the maximum deviation of a control from its position and height in this layout.
    """

    model: str
    title: str
    size_mm: tuple[float, float]
    colour: str
    controls: tuple[Control, ...]
    artwork: tuple[Artwork, ...]
    markers: tuple[Fiducial, ...] = ()
    tolerance_mm: float = TOLERANCE_MM

    def control(self, name: str) -> Control:
        """Return the control with that name.

        Raises
        ------
        KeyError
            With the known names.
        """
        for control in self.controls:
            if control.name == name:
                return control
        raise KeyError(
            Message(
                "layout.no_control",
                model=self.model,
                name=quoted(name),
                controls=", ".join(c.name for c in self.controls),
            )
        )


def load_layout(path: Path) -> PanelLayout:
    """Read and check a layout file.

    Raises
    ------
    LayoutError
        ``file:line: what is wrong``.
    OSError
        If the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise LayoutError(f"{path}:{line}: {error}") from error
    return parse_layout(text, str(path))


def parse_layout(text: str, file_name: str = "layout") -> PanelLayout:
    """Check the text of a layout file; see :func:`load_layout`."""
    try:
        document = yaml.load(text, Loader=LineLoader)  # a SafeLoader with line numbers
    except UNREADABLE as error:
        raise LayoutError(f"{file_name}:{mistake(error)}") from error
    if not isinstance(document, dict):
        raise LayoutError(Message("layout.n_1_mapping_model_size_controls", file_name=file_name))
    return _LayoutReader(file_name, LayoutError).layout(document)


class _LayoutReader(YamlEntries):
    """Converts the YAML document to dataclasses, or raises one error with file and line."""

    def layout(self, document: dict[str, Any]) -> PanelLayout:
        self.known(document, {"model", "title", "size_mm", "colour", "controls", "artwork", "markers", "tolerance_mm"})
        width, height = self.numbers(document, "size_mm", 2, positive=True)
        controls: list[Control] = []
        for entry in self.entries(document, "controls"):
            control = self.one_control(entry)
            if control.name in {c.name for c in controls}:
                raise self.error(entry, Message("layout.control_stands_twice", control=quoted(control.name)))
            x, y = control.position_mm
            half_width, half_height = control.size_mm[0] / 2, control.size_mm[1] / 2
            if not (half_width <= x <= width - half_width and half_height <= y <= height - half_height):
                raise self.error(
                    entry,
                    Message(
                        "layout.control_reaches_outside_panel",
                        control=quoted(control.name),
                        x=x,
                        y=y,
                        width=width,
                        height_mm=height,
                    ),
                )
            controls.append(control)
        if not controls:
            raise self.error(document, Message("layout.no_controls"))
        markers: list[Fiducial] = []
        for entry in self.entries(document, "markers"):
            marker = self.one_marker(entry)
            if marker.name in {m.name for m in markers}:
                raise self.error(entry, Message("layout.marker_stands_twice", marker=marker.name))
            self.check_place(entry, marker, (width, height), controls)
            markers.append(marker)
        return PanelLayout(
            model=self.text(document, "model"),
            title=self.text(document, "title", self.text(document, "model")),
            size_mm=(width, height),
            colour=self.colour(document, "colour", "#303438"),
            controls=tuple(controls),
            artwork=(
                *(self.one_artwork(entry) for entry in self.entries(document, "artwork")),
                *(shape for marker in markers for shape in marker_artwork(marker)),
            ),
            markers=tuple(markers),
            tolerance_mm=self.tolerance(document),
        )

    def tolerance(self, document: dict[str, Any]) -> float:
        value = self.one_number(document, "tolerance_mm", TOLERANCE_MM)
        if not 0 <= value <= MAX_TOLERANCE_MM:
            raise self.error(
                document, Message("layout.tolerance_not_within_0", value=value, max_tolerance_mm=MAX_TOLERANCE_MM)
            )
        return value

    def one_marker(self, entry: dict[str, Any]) -> Fiducial:
        self.known(entry, {"dictionary", "id", "position_mm", "size_mm"})
        dictionary = self.choice(entry, "dictionary", DICTIONARIES)
        number, count = self.one_number(entry, "id", -1.0), count_of(dictionary)
        if number != int(number) or not 0 <= number < count:
            raise self.error(
                entry,
                Message("layout.id_markers_0", entry=quoted(entry.get("id")), dictionary=dictionary, count=count - 1),
            )
        x, y = self.numbers(entry, "position_mm", 2)
        size = self.one_number(entry, "size_mm", positive=True)
        return Fiducial(dictionary=dictionary, id=int(number), position_mm=(x, y), size_mm=size)

    def check_place(
        self, entry: dict[str, Any], marker: Fiducial, size_mm: tuple[float, float], controls: list[Control]
    ) -> None:
        (x, y), half = marker.position_mm, marker.side_mm / 2
        if not all(half <= place <= side - half for place, side in zip((x, y), size_mm)):
            text = Message("layout.marker_white_rim_wide", marker=marker.name, x=x, y=y, side_mm=marker.side_mm)
            raise self.error(
                entry, Message("layout.reaches_outside_panel", text=text, size_mm=size_mm[0], size_2_mm=size_mm[1])
            )
        for control in controls:
            beside = (abs(p - q) - s / 2 - half for p, q, s in zip((x, y), control.position_mm, control.size_mm))
            if max(beside) < 0:
                raise self.error(
                    entry,
                    Message("layout.marker_white_rim_under_control", marker=marker.name, control=quoted(control.name)),
                )

    def one_control(self, entry: dict[str, Any]) -> Control:
        fields = {"name", "kind", "position_mm", "size_mm", "shape", "height_mm", "label", "colour", "lit_colour"}
        self.known(entry, fields | {"detent_deg", "marks_deg", "dimple"})
        name = self.text(entry, "name")
        if not is_name(name):
            raise self.error(entry, Message("layout.name_letter_z_then_letters", name=quoted(name)))
        x, y = self.numbers(entry, "position_mm", 2)
        width, height = self.numbers(entry, "size_mm", 2, positive=True)
        kind, shape = self.choice(entry, "kind", CONTROL_KINDS), self.choice(entry, "shape", SHAPES, "rectangle")
        proud = self.one_number(entry, "height_mm", 0.0)
        detent = self.one_number(entry, "detent_deg", 0.0)
        if not 0 <= proud <= 200:
            raise self.error(entry, Message("layout.height_not_within_0_200", proud=proud))
        if not 0 <= detent <= 180:
            raise self.error(entry, Message("layout.detent_deg_not_within_0", detent=detent))
        if "detent_deg" in entry and not detent:
            raise self.error(entry, Message("layout.detent_deg_remove_key_knob", detent=detent))
        if kind == "knob" and shape != "circle":
            raise self.error(entry, Message("layout.knob_knob_circle", name=quoted(name), shape=shape))
        if shape == "circle" and width != height:
            raise self.error(entry, Message("layout.size_circle_wide_high", width=width, height=height))
        if kind != "knob" and (detent or "marks_deg" in entry or "dimple" in entry):
            raise self.error(entry, Message("layout.only_knob_detent_deg_marks", name=quoted(name), kind=kind))
        return Control(
            name=name,
            kind=kind,
            position_mm=(x, y),
            size_mm=(width, height),
            shape=shape,
            height_mm=proud,
            detent_deg=detent,
            marks=self.marks(entry),
            dimple=self.dimple(entry, width, proud) if "dimple" in entry else None,
            label=self.text(entry, "label", ""),
            colour=self.colour(entry, "colour", "#404448"),
            lit_colour=self.colour(entry, "lit_colour", ""),
        )

    def one_artwork(self, entry: dict[str, Any]) -> Artwork:
        line_mm = self.one_number(entry, "line_mm", 0.4, positive=True)
        if "rectangle_mm" in entry:
            self.known(entry, {"rectangle_mm", "fill", "outline", "line_mm"})
            x, y, width, height = self.numbers(entry, "rectangle_mm", 4)
            if min(width, height) <= 0:
                raise self.error(
                    entry, Message("layout.rectangle_width_height_above_0", rectangle_mm=entry["rectangle_mm"])
                )
            fill, outline = self.colour(entry, "fill", ""), self.colour(entry, "outline", "")
            return ArtworkRectangle(rectangle_mm=(x, y, width, height), fill=fill, outline=outline, line_mm=line_mm)
        if "circle_mm" in entry:
            self.known(entry, {"circle_mm", "fill", "outline", "line_mm"})
            x, y, radius = self.numbers(entry, "circle_mm", 3)
            if radius <= 0:
                raise self.error(entry, Message("layout.circle_radius_above_0_needed", circle_mm=entry["circle_mm"]))
            fill, outline = self.colour(entry, "fill", ""), self.colour(entry, "outline", "")
            return ArtworkCircle(circle_mm=(x, y, radius), fill=fill, outline=outline, line_mm=line_mm)
        if "line_from_to_mm" in entry:
            self.known(entry, {"line_from_to_mm", "colour", "line_mm"})
            x0, y0, x1, y1 = self.numbers(entry, "line_from_to_mm", 4)
            return ArtworkLine(
                line_from_to_mm=(x0, y0, x1, y1), colour=self.colour(entry, "colour", "#d8dcd8"), line_mm=line_mm
            )
        if "text" in entry:
            self.known(entry, {"text", "at_mm", "height_mm", "colour", "line_mm"})
            x, y = self.numbers(entry, "at_mm", 2)
            height = self.one_number(entry, "height_mm", 3.0, positive=True)
            colour = self.colour(entry, "colour", "#e8ece8")
            text = self.text(entry, "text")
            try:
                text_strokes(text, (x, y), height)
            except ValueError as error:
                raise self.error(entry, str(error)) from error
            return ArtworkText(text=text, at_mm=(x, y), height_mm=height, colour=colour, line_mm=line_mm)
        raise self.error(entry, Message("layout.artwork_needs_one_rectangle_circle"))

    def marks(self, entry: dict[str, Any]) -> tuple[tuple[str, float], ...]:
        given = entry.get("marks_deg", {})
        if not isinstance(given, dict):
            raise self.error(entry, Message("layout.marks_deg_mapping_names_degrees", given=quoted(given)))
        found = []
        for name in (key for key in given if key != "__line__"):
            if not isinstance(name, str) or not is_mark(name):
                raise self.error(
                    given,
                    Message("layout.mark_letter_z_then_letters", name=quoted(name)),
                )
            degrees = self.one_number(given, name, 0.0)
            if not -180 <= degrees <= 180:
                raise self.error(given, Message("layout.mark_not_within_180_180", name=name, degrees=degrees))
            found.append((name, degrees))
        return tuple(found)

    def dimple(self, entry: dict[str, Any], knob_mm: float, proud_mm: float) -> Dimple:
        given = entry["dimple"]
        if not isinstance(given, dict):
            raise self.error(entry, Message("layout.dimple_mapping_place_diameter_depth", given=quoted(given)))
        self.known(given, {"place_mm", "diameter_mm", "depth_mm"})
        x, y = self.numbers(given, "place_mm", 2)
        diameter, depth = (self.one_number(given, key, positive=True) for key in ("diameter_mm", "depth_mm"))
        reach = math.hypot(x, y) + diameter / 2
        if reach > knob_mm / 2 or math.hypot(x, y) < diameter / 2:
            raise self.error(
                given,
                Message(
                    "layout.dimple_lies_knob_middle_0",
                    hypot=math.hypot(x, y) - diameter / 2,
                    reach_mm=reach,
                    knob_mm=knob_mm / 2,
                ),
            )
        if depth >= proud_mm:
            raise self.error(given, Message("layout.depth_not_below_knob_height", depth=depth, proud_mm=proud_mm))
        return Dimple(place_mm=(x, y), diameter_mm=diameter, depth_mm=depth)


def marker_artwork(marker: Fiducial) -> tuple[ArtworkRectangle, ...]:
    """Return the print of a marker: the white rim, the black square, the white modules."""

    def square(side: float, fill: str) -> ArtworkRectangle:
        x, y = (place - side / 2 for place in marker.position_mm)
        return ArtworkRectangle(rectangle_mm=(x, y, side, side), fill=fill)

    white = tuple(ArtworkRectangle(rectangle_mm=module, fill="#ffffff") for module in marker.white_mm())
    return (square(marker.side_mm, "#ffffff"), square(marker.size_mm, "#000000"), *white)


def rgb(colour: str) -> tuple[int, int, int]:
    """Return (red, green, blue), 0 to 255, of a colour such as ``#ff8800``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
