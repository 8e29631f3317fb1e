"""Layout files: what is read, and errors that name file and line."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from icu_common.core.panel.gesture import parse_gesture
from icu_common.core.panel.panel_layout import ArtworkText, LayoutError, load_layout, parse_layout

GOOD = """\
model: test_panel
size_mm: [100, 50]
controls:
  - name: RUN
    kind: button
    position_mm: [20, 10]
    size_mm: [10, 6]
    height_mm: 3
    lit_colour: "#00ff00"
  - name: KNOB
    kind: knob
    shape: circle
    position_mm: [60, 25]
    size_mm: [20, 20]
artwork:
  - {text: "HELLO", at_mm: [50, 45], height_mm: 4}
  - {rectangle_mm: [1, 1, 98, 48], outline: "#ffffff"}
"""


def test_good_layout() -> None:
    layout = parse_layout(GOOD)
    assert layout.size_mm == (100, 50) and [c.name for c in layout.controls] == ["RUN", "KNOB"]
    assert layout.control("RUN").height_mm == 3
    assert layout.artwork[0] == ArtworkText(text="HELLO", at_mm=(50, 45), height_mm=4)
    with pytest.raises(KeyError, match="no control 'STOP'; it has RUN, KNOB"):
        layout.control("STOP")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("kind: button", "kind: lever", r"f\.yaml:4: kind = 'lever' is none of"),
        ("name: KNOB", "name: RUN", r"f\.yaml:10: control 'RUN' occurs twice"),
        ("position_mm: [20, 10]", "position_mm: [4, 10]", r"f\.yaml:4: control 'RUN' at \(4, 10\) reaches outside"),
        ("size_mm: [10, 6]", "size_mm: [10]", r"f\.yaml:4: size_mm = \[10\]; expected 2 numbers"),
        ("size_mm: [10, 6]", "size_mm: [10, .nan]", r"f\.yaml:4: size_mm"),
        pytest.param(
            "size_mm: [10, 6]", f"size_mm: [10, 1{400 * '0'}]", r"f\.yaml:4: .*numbers up to 10000", id="huge"
        ),
        ("height_mm: 3\n", "hieght_mm: 3\n", r"f\.yaml:4: unknown key hieght_mm"),
        ('"#00ff00"', '"green"', r"f\.yaml:4: lit_colour = 'green'"),
        ("height_mm: 3\n", 'colour: ""\n', r"f\.yaml:4: colour = ''"),
        ("size_mm: [100, 50]\n", 'size_mm: [100, 50]\ncolour: ""\n', r"f\.yaml:1: colour = ''"),
        ("HELLO", "HELL\u00d6", r"f\.yaml:16: text 'HELL\u00d6': the stroke font has no '\u00d6'"),
        ("98, 48]", "-98, 48]", r"f\.yaml:17: rectangle_mm = \[1, 1, -98, 48\]; expected width and height above 0"),
        (
            "rectangle_mm: [1, 1, 98, 48]",
            "circle_mm: [1, 1, 0]",
            r"f\.yaml:17: circle_mm = \[1, 1, 0\]; expected a radius above",
        ),
        ("name: RUN\n", "name: ON\n", r"f\.yaml:4: name = True; expected a text"),
        ("size_mm: [100, 50]\n", "size_mm: [100, 50]\nsize_mm: [1, 1]\n", r"f\.yaml:3: key 'size_mm' occurs twice"),
        ("    shape: circle\n", "", r"f\.yaml:10: knob 'KNOB' is a rectangle; a knob is a circle"),
        ("size_mm: [20, 20]", "size_mm: [20, 18]", r"f\.yaml:10: size_mm = \[20, 18\]: a circle is as wide as high"),
        ("height_mm: 3\n", "height_mm: -1\n", r"f\.yaml:4: height_mm = -1 is not within 0 to 200 mm"),
        ("height_mm: 3\n", "detent_deg: 3\n", r"f\.yaml:4: 'RUN' is a button; only a knob has detent_deg"),
        ("shape: circle\n", "shape: circle\n    detent_deg: 200\n", r"f\.yaml:10: detent_deg = 200 is not within"),
        (
            "shape: circle\n",
            "shape: circle\n    marks_deg: [1]\n",
            r"f\.yaml:10: marks_deg = \[1\]; expected a mapping",
        ),
        (
            "shape: circle\n",
            "shape: circle\n    marks_deg:\n      LOW: 0\n      HIGH: 190\n",
            r"f\.yaml:14: mark HIGH = 190 is not within -180 to 180 degrees",
        ),
        (
            "name: RUN\n",
            "name: L\u00d6SCHEN\n",
            r"f\.yaml:4: name 'L\u00d6SCHEN'; expected a letter from A to Z, then letters",
        ),
        (
            "shape: circle\n",
            "shape: circle\n    marks_deg:\n      \u00d6L: 0\n",
            r"f\.yaml:14: mark '\u00d6L'; expected a letter from A to Z",
        ),
        (
            "shape: circle\n",
            "shape: circle\n    marks_deg:\n      INF: 0\n",
            r"f\.yaml:14: mark 'INF'; expected .*, but not nan or inf, which are numbers",
        ),
        (
            "height_mm: 3\n",
            "height_mm: 3\n    dimple: {}\n",
            r"f\.yaml:4: 'RUN' is a button; only a knob has .*dimple",
        ),
        (
            "shape: circle\n",
            "shape: circle\n    dimple: 3\n",
            r"f\.yaml:10: dimple = 3; expected a mapping of place_mm",
        ),
        (
            "shape: circle\n",
            "shape: circle\n    dimple:\n      {place_mm: [0, 8], diameter_mm: 5, depth_mm: 1}\n",
            r"f\.yaml:14: the dimple lies 5\.5 to 10\.5 mm from the knob's middle \(limits 0 to 10 mm\)",
        ),
        (
            "shape: circle\n",
            "shape: circle\n    dimple: {place_mm: [0, 6], diameter_mm: 5, depth_mm: 0}\n",
            r"f\.yaml:13: depth_mm = \[0\]",
        ),
        ("kind: knob", "kind: [knob", r"f\.yaml:\d+: "),
        ("kind: knob", "kind: 2026-13-45", r"f\.yaml:11: month must be in 1\.\.12"),
        ("kind: knob", "kind: !!timestamp knob", r"f\.yaml:11: "),
        ("kind: knob", "{a: b}: knob", r"f\.yaml:10: unhashable type"),
        ("kind: knob", "kind: \0knob", r"f\.yaml:1: unacceptable character #x0000"),
        pytest.param("kind: knob", "kind: " + 900 * "[", r"f\.yaml:11: more than 24 open brackets", id="deep"),
        (
            "position_mm: [20, 10]",
            "position_mm: [5:20, 10]",
            r"f\.yaml:4: position_mm = \['5:20', 10\]; expected 2 numbers",
        ),
        (
            "position_mm: [20, 10]",
            "position_mm: [020, 10]",
            r"f\.yaml:4: position_mm = \['020', 10\]; expected 2 numbers",
        ),
        ("height_mm: 3\n", "height_mm: 1:30.5\n", r"f\.yaml:4: height_mm = \['1:30\.5'\]; expected 1 numbers"),
        (
            "shape: circle\n",
            "shape: circle\n    detent_deg: 0.0\n",
            r"f\.yaml:10: detent_deg = 0: remove this key for a knob without clicks",
        ),
        pytest.param(
            "size_mm: [100, 50]\n",
            f"size_mm: [100, 50]\ntitle: {900_000 * 'x'}\n",
            r"f\.yaml:1: title = 'x{20}'\.\.\., 900000 characters: expected up to 100 printable",
            id="long title",
        ),
        ("size_mm: [100, 50]\n", 'size_mm: [100, 50]\ntitle: "a\\e[2J"\n', r"f\.yaml:1: title = 'a\\x1b\[2J'"),
    ],
)
def test_errors_name_the_line(old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(LayoutError, match=message):
        parse_layout(GOOD.replace(old, new, 1), "f.yaml")


@pytest.mark.parametrize(
    "name", ["LOW", "x_1", "L\u00d6SCHEN", "\u00d6L", "1X", "A B", "_", "", "nan", "INF", "Infinity", "INFUSION"]
)
def test_what_a_layout_names_can_be_named_in_a_gesture(name: str) -> None:
    """Another name would be on the page, and every press on it would be rejected."""
    marked = GOOD.replace("shape: circle\n", f"shape: circle\n    marks_deg: {{{name!r}: 60}}\n")
    for text, command in (
        (GOOD.replace("name: RUN\n", f"name: {name!r}\n"), f"press:{name}"),
        (marked, f"set:KNOB:{name}"),
    ):
        assert text != GOOD
        with contextlib.suppress(LayoutError):
            parse_layout(text)
            gesture = parse_gesture(command)
            assert name in (gesture.target, gesture.mark)


def test_marks_of_a_knob() -> None:
    text = GOOD.replace("shape: circle\n", "shape: circle\n    detent_deg: 30\n    marks_deg: {LOW: 60, HIGH: -60}\n")
    knob = parse_layout(text).control("KNOB")
    assert knob.detent_deg == 30 and knob.marks == (("LOW", 60.0), ("HIGH", -60.0))


def test_a_layout_in_another_character_set_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "ger\u00e4t.yaml"
    path.write_bytes(GOOD.replace("HELLO", "Ger\u00e4t").encode("latin-1"))
    with pytest.raises(LayoutError, match=r"ger\u00e4t\.yaml:16: 'utf-8' codec can't decode byte 0xe4"):
        load_layout(path)
