"""The printed face: coverage of texels, exact to a hundredth of a texel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from icu_common.core.geometry.fiducial import marker_modules
from icu_common.core.panel.panel_layout import load_layout, parse_layout
from icu_common.core.panel.stroke_font import text_strokes
from icu_simulator.core.panel_texture import Canvas, bgr, draw_face

ROOT = Path(__file__).parents[4]


def darkness(canvas: Canvas) -> np.ndarray:
    """Share of black in each texel of a white canvas."""
    return 1 - canvas.picture[..., 0].astype(float) / 255


def test_rectangle_covers_shares_of_texels() -> None:
    canvas = Canvas((10.0, 8.0), 10.0, "#ffffff")
    canvas.rectangle(1.03, 2.06, 3.0, 1.5, "#000000")
    dark = darkness(canvas)
    # The row whose centre is at y = 2.55 mm is the 80 - 25.5 th from the top; its left end lies at 10.3 texels.
    row = dark[54]
    assert row[10] == pytest.approx(0.7, abs=0.003)
    assert row[11:40] == pytest.approx(1.0)
    assert row[40] == pytest.approx(0.3, abs=0.003)
    column = dark[:, 20]
    assert column[80 - 36] == pytest.approx(0.6, abs=0.003)
    assert column[80 - 21] == pytest.approx(0.4, abs=0.003)
    assert dark.sum() == pytest.approx(3.0 * 1.5 * 100, rel=2e-3)


def test_disc_and_line_have_their_area_and_place() -> None:
    canvas = Canvas((20.0, 20.0), 12.0, "#ffffff")
    canvas.ring(7.31, 12.77, -1.0, 3.2, "#000000")
    dark = darkness(canvas)
    assert dark.sum() / 144 == pytest.approx(np.pi * 3.2**2, rel=2e-3)
    rows, columns = np.mgrid[0:240, 0:240]
    x, y = (columns + 0.5) / 12, 20 - (rows + 0.5) / 12
    assert (dark * x).sum() / dark.sum() == pytest.approx(7.31, abs=0.002)
    assert (dark * y).sum() / dark.sum() == pytest.approx(12.77, abs=0.002)
    line = Canvas((20.0, 20.0), 12.0, "#ffffff")
    line.polyline(np.array([[3.0, 3.0], [15.0, 9.0]]), 0.8, "#000000")
    length = np.hypot(12, 6)
    assert darkness(line).sum() / 144 == pytest.approx(length * 0.8 + np.pi * 0.4**2, rel=0.01)


def test_frame_has_its_middle_on_the_edge() -> None:
    canvas = Canvas((10.0, 10.0), 10.0, "#ffffff")
    canvas.frame(2.0, 2.0, 6.0, 5.0, 0.4, "#000000")
    assert darkness(canvas)[50, 15:25] == pytest.approx([0, 0, 0, 1, 1, 1, 1, 0, 0, 0])


def test_text_is_centred_and_as_high_as_asked() -> None:
    points = np.vstack(text_strokes("HEH", (10.0, 5.0), 3.0))
    assert (points.min(axis=0) + points.max(axis=0)) / 2 == pytest.approx([10.0, 5.0])
    assert np.ptp(points[:, 1]) == pytest.approx(3.0)
    with pytest.raises(ValueError, match="no '@'"):
        text_strokes("A@B", (0.0, 0.0), 1.0)


def test_face_of_the_bench_shows_its_layout() -> None:
    layout = load_layout(ROOT / "config/scopes/dso_bench_4.yaml")
    face = draw_face(layout, 4.0)
    assert face.shape == (600, 1280, 3)

    def at(x: float, y: float) -> list[int]:
        return face[600 - round(y * 4), round(x * 4)].tolist()

    assert at(10.0, 30.0) == bgr("#1b1f23").tolist(), "bezel"
    assert at(100.0, 80.0) == bgr("#0a1016").tolist(), "screen"
    assert at(200.0, 112.0) == bgr("#3a4149").tolist(), "title strip"
    assert at(211.0, 92.0) == bgr("#bfc4c1").tolist(), "under a knob the bare face"


def test_layout_has_what_the_bench_needs() -> None:
    layout = load_layout(ROOT / "config/scopes/dso_bench_4.yaml")
    kinds = {c.name: c.kind for c in layout.controls}
    assert sum(kind == "button" for kind in kinds.values()) >= 9
    assert sum(kind == "knob" for kind in kinds.values()) >= 4
    assert kinds["SCREEN"] == "touch_area"
    for first in layout.controls:
        for second in layout.controls:
            if first.name < second.name:
                gap = np.abs(np.subtract(first.position_mm, second.position_mm))
                room = np.add(first.size_mm, second.size_mm) / 2
                assert (gap > room + 3.0).any(), f"{first.name} and {second.name} are too near for the stylus"


def test_no_magenta_on_the_panel() -> None:
    layout = load_layout(ROOT / "config/scopes/dso_bench_4.yaml")
    blue, green, red = draw_face(layout, 4.0).astype(int).reshape(-1, 3).T
    assert (np.minimum(red, blue) - green).max() < 30


def test_small_layout_draws_every_kind_of_artwork() -> None:
    layout = parse_layout(
        """
model: m
size_mm: [40, 30]
colour: "#ffffff"
controls:
- {name: S, kind: touch_area, shape: circle, position_mm: [30, 8], size_mm: [8, 8], colour: "#0000ff"}
artwork:
- {circle_mm: [10, 10, 4], fill: "#ff0000", outline: "#000000", line_mm: 1}
- {line_from_to_mm: [2, 25, 38, 25], colour: "#00ff00", line_mm: 1}
- {text: I, at_mm: [30, 18], height_mm: 6, colour: "#000000"}
"""
    )
    face = draw_face(layout, 5.0)
    assert face[100, 50].tolist() == [0, 0, 255]
    assert face[100, 70].tolist() == [0, 0, 0]
    assert face[25, 100].tolist() == [0, 255, 0]
    assert face[110, 150].tolist() == [255, 0, 0]
    assert face[60, 150].max() < 40


def test_markers_of_the_layout_are_printed_module_by_module() -> None:
    text = (ROOT / "config" / "scopes" / "dso_bench_4.yaml").read_text() + (
        "markers:\n  - {dictionary: APRILTAG_36h11, id: 3, position_mm: [68.0, 13.0], size_mm: 12.0}\n"
    )
    layout = parse_layout(text)
    face = draw_face(layout, 8.0)
    modules = marker_modules("APRILTAG_36h11", 3)
    step = 12.0 / len(modules)
    for (row, column), white in np.ndenumerate(modules):
        x, y = 62.0 + (column + 0.5) * step, 19.0 - (row + 0.5) * step
        assert (face[int((150.0 - y) * 8), int(x * 8)] == (255 if white else 0)).all(), (row, column)
    assert (face[int((150.0 - 19.7) * 8), int(68.0 * 8)] == 255).all()
