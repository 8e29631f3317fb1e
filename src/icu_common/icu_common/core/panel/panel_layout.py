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
class Rectangle:
    """Artwork: lower left corner, width and height in mm; ``fill`` may be empty for an outline of ``line_mm``."""

    rectangle_mm: tuple[float, float, float, float]
    fill: str = ""
    outline: str = ""
    line_mm: float = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class Circle:
    """Artwork: centre x, y and radius in mm."""

    circle_mm: tuple[float, float, float]
    fill: str = ""
    outline: str = ""
    line_mm: float = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """Artwork: from x, y to x, y in mm."""

    line_from_to_mm: tuple[float, float, float, float]
    colour: str = "#d8dcd8"
    line_mm: float = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class Text:
    """Artwork: Hershey simplex capitals of ``height_mm``, centred at ``at_mm``."""

    text: str
    at_mm: tuple[float, float]
    height_mm: float = 3.0
    colour: str = "#e8ece8"
    line_mm: float = 0.4


Artwork = Rectangle | Circle | Line | Text


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
        raise KeyError(f"{self.model} has no control {name!r}; it has {', '.join(c.name for c in self.controls)}")


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
        raise LayoutError(f"{file_name}:1: a mapping with model, size_mm and controls is needed")
    return _Reader(file_name, LayoutError).layout(document)


class _Reader(YamlEntries):
    """Converts the YAML document to dataclasses, or raises one error with file and line."""

    def layout(self, document: dict[str, Any]) -> PanelLayout:
        self.known(document, {"model", "title", "size_mm", "colour", "controls", "artwork", "markers", "tolerance_mm"})
        width, height = self.numbers(document, "size_mm", 2, positive=True)
        controls: list[Control] = []
        for entry in self.entries(document, "controls"):
            control = self.one_control(entry)
            if control.name in {c.name for c in controls}:
                raise self.error(entry, f"control {control.name!r} stands twice")
            x, y = control.position_mm
            half_width, half_height = control.size_mm[0] / 2, control.size_mm[1] / 2
            if not (half_width <= x <= width - half_width and half_height <= y <= height - half_height):
                raise self.error(
                    entry,
                    f"control {control.name!r} at ({x:g}, {y:g}) reaches outside the panel {width:g} x {height:g} mm",
                )
            controls.append(control)
        if not controls:
            raise self.error(document, "no controls")
        markers: list[Fiducial] = []
        for entry in self.entries(document, "markers"):
            marker = self.one_marker(entry)
            if marker.name in {m.name for m in markers}:
                raise self.error(entry, f"marker {marker.name} stands twice")
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
            raise self.error(document, f"tolerance_mm = {value:g} is not within 0 to {MAX_TOLERANCE_MM:g} mm")
        return value

    def one_marker(self, entry: dict[str, Any]) -> Fiducial:
        self.known(entry, {"dictionary", "id", "position_mm", "size_mm"})
        dictionary = self.choice(entry, "dictionary", DICTIONARIES)
        number, count = self.one_number(entry, "id", -1.0), count_of(dictionary)
        if number != int(number) or not 0 <= number < count:
            raise self.error(entry, f"id = {entry.get('id')!r}: {dictionary} has the markers 0 to {count - 1}")
        x, y = self.numbers(entry, "position_mm", 2)
        size = self.one_number(entry, "size_mm", positive=True)
        return Fiducial(dictionary=dictionary, id=int(number), position_mm=(x, y), size_mm=size)

    def check_place(
        self, entry: dict[str, Any], marker: Fiducial, size_mm: tuple[float, float], controls: list[Control]
    ) -> None:
        (x, y), half = marker.position_mm, marker.side_mm / 2
        if not all(half <= place <= side - half for place, side in zip((x, y), size_mm)):
            text = f"marker {marker.name} at ({x:g}, {y:g}) with its white rim, {marker.side_mm:.1f} mm wide,"
            raise self.error(entry, f"{text} reaches outside the panel {size_mm[0]:g} x {size_mm[1]:g} mm")
        for control in controls:
            beside = (abs(p - q) - s / 2 - half for p, q, s in zip((x, y), control.position_mm, control.size_mm))
            if max(beside) < 0:
                raise self.error(entry, f"marker {marker.name} with its white rim is under control {control.name!r}")

    def one_control(self, entry: dict[str, Any]) -> Control:
        fields = {"name", "kind", "position_mm", "size_mm", "shape", "height_mm", "label", "colour", "lit_colour"}
        self.known(entry, fields | {"detent_deg", "marks_deg", "dimple"})
        name = self.text(entry, "name")
        if not is_name(name):
            raise self.error(entry, f"name {name!r}: a letter from A to Z, then letters, digits and '_' are needed")
        x, y = self.numbers(entry, "position_mm", 2)
        width, height = self.numbers(entry, "size_mm", 2, positive=True)
        kind, shape = self.choice(entry, "kind", CONTROL_KINDS), self.choice(entry, "shape", SHAPES, "rectangle")
        proud = self.one_number(entry, "height_mm", 0.0)
        detent = self.one_number(entry, "detent_deg", 0.0)
        if not 0 <= proud <= 200:
            raise self.error(entry, f"height_mm = {proud:g} is not within 0 to 200 mm")
        if not 0 <= detent <= 180:
            raise self.error(entry, f"detent_deg = {detent:g} is not within 0 to 180 degrees")
        if "detent_deg" in entry and not detent:
            raise self.error(entry, f"detent_deg = {detent:g}: remove this key for a knob without clicks")
        if kind == "knob" and shape != "circle":
            raise self.error(entry, f"knob {name!r} is a {shape}; a knob is a circle")
        if shape == "circle" and width != height:
            raise self.error(entry, f"size_mm = [{width:g}, {height:g}]: a circle is as wide as high")
        if kind != "knob" and (detent or "marks_deg" in entry or "dimple" in entry):
            raise self.error(entry, f"{name!r} is a {kind}; only a knob has detent_deg, marks_deg or a dimple")
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
                raise self.error(entry, f"rectangle_mm = {entry['rectangle_mm']}: width and height above 0 are needed")
            fill, outline = self.colour(entry, "fill", ""), self.colour(entry, "outline", "")
            return Rectangle(rectangle_mm=(x, y, width, height), fill=fill, outline=outline, line_mm=line_mm)
        if "circle_mm" in entry:
            self.known(entry, {"circle_mm", "fill", "outline", "line_mm"})
            x, y, radius = self.numbers(entry, "circle_mm", 3)
            if radius <= 0:
                raise self.error(entry, f"circle_mm = {entry['circle_mm']}: a radius above 0 is needed")
            fill, outline = self.colour(entry, "fill", ""), self.colour(entry, "outline", "")
            return Circle(circle_mm=(x, y, radius), fill=fill, outline=outline, line_mm=line_mm)
        if "line_from_to_mm" in entry:
            self.known(entry, {"line_from_to_mm", "colour", "line_mm"})
            x0, y0, x1, y1 = self.numbers(entry, "line_from_to_mm", 4)
            return Line(
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
            return Text(text=text, at_mm=(x, y), height_mm=height, colour=colour, line_mm=line_mm)
        raise self.error(entry, "artwork needs one of rectangle_mm, circle_mm, line_from_to_mm, text")

    def marks(self, entry: dict[str, Any]) -> tuple[tuple[str, float], ...]:
        given = entry.get("marks_deg", {})
        if not isinstance(given, dict):
            raise self.error(entry, f"marks_deg = {given!r}: a mapping of names to degrees is needed")
        found = []
        for name in (key for key in given if key != "__line__"):
            if not isinstance(name, str) or not is_mark(name):
                raise self.error(
                    given,
                    f"mark {name!r}: a letter from A to Z, then letters, digits and '_' are needed, "
                    "and neither nan nor inf, which are numbers",
                )
            degrees = self.one_number(given, name, 0.0)
            if not -180 <= degrees <= 180:
                raise self.error(given, f"mark {name} = {degrees:g} is not within -180 to 180 degrees")
            found.append((name, degrees))
        return tuple(found)

    def dimple(self, entry: dict[str, Any], knob_mm: float, proud_mm: float) -> Dimple:
        given = entry["dimple"]
        if not isinstance(given, dict):
            raise self.error(entry, f"dimple = {given!r}: a mapping of place_mm, diameter_mm and depth_mm is needed")
        self.known(given, {"place_mm", "diameter_mm", "depth_mm"})
        x, y = self.numbers(given, "place_mm", 2)
        diameter, depth = (self.one_number(given, key, positive=True) for key in ("diameter_mm", "depth_mm"))
        reach = math.hypot(x, y) + diameter / 2
        if reach > knob_mm / 2 or math.hypot(x, y) < diameter / 2:
            raise self.error(
                given,
                f"the dimple lies {math.hypot(x, y) - diameter / 2:g} to {reach:g} mm from the knob's middle, "
                f"0 to {knob_mm / 2:g} mm are possible",
            )
        if depth >= proud_mm:
            raise self.error(given, f"depth_mm = {depth:g} is not below the knob's height_mm = {proud_mm:g}")
        return Dimple(place_mm=(x, y), diameter_mm=diameter, depth_mm=depth)


def marker_artwork(marker: Fiducial) -> tuple[Rectangle, ...]:
    """Return the print of a marker: the white rim, the black square, the white modules."""

    def square(side: float, fill: str) -> Rectangle:
        x, y = (place - side / 2 for place in marker.position_mm)
        return Rectangle(rectangle_mm=(x, y, side, side), fill=fill)

    white = tuple(Rectangle(rectangle_mm=module, fill="#ffffff") for module in marker.white_mm())
    return (square(marker.side_mm, "#ffffff"), square(marker.size_mm, "#000000"), *white)


def rgb(colour: str) -> tuple[int, int, int]:
    """Return (red, green, blue), 0 to 255, of a colour such as ``#ff8800``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
