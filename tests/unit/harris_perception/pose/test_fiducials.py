"""Markers on the face: found where they are, and contradicting the print when they were moved or exchanged."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from unit.harris_perception import panel_scene as scene

from harris_perception.core.pose.fiducials import MarkerFinder
from harris_perception.core.pose.planar_pose import homography_of_pose, map_points
from icu_common.core.geometry.fiducial import dictionary, marker_modules
from icu_common.core.geometry.geometry import Transform
from icu_common.core.panel.panel_layout import PanelLayout, parse_layout

CAMERA = scene.camera()
MARKERS = """
markers:
  - {dictionary: APRILTAG_36h11, id: 3, position_mm: [68.0, 13.0], size_mm: 12.0}
  - {dictionary: 4X4_50, id: 7, position_mm: [156.5, 12.0], size_mm: 12.0}
"""


@cache
def layout(changed: tuple[str, str] = ("", "")) -> PanelLayout:
    return parse_layout(scene.LAYOUT.read_text() + MARKERS.replace(*changed))


def picture(shown: PanelLayout, truth: Transform, **look: Any) -> Any:
    return scene.picture(shown, CAMERA, truth, scene.Look(**look), seed=2)


@pytest.mark.parametrize("view", [{}, {"roll_deg": 130.0, "side_deg": 20.0}])
def test_markers_are_seen_in_place_and_give_the_pose(view: dict[str, Any]) -> None:
    truth = scene.pose(layout(), **view)
    finder = MarkerFinder(layout())
    seen = finder.find(picture(layout(), truth), CAMERA)
    assert {(m.dictionary, m.id) for m in seen} == {("APRILTAG_36h11", 3), ("4X4_50", 7)}
    for marker in seen:
        known = next(m for m in layout().markers if m.id == marker.id)
        expected = map_points(homography_of_pose(truth, CAMERA), known.corners_mm())
        assert np.linalg.norm(marker.corners_px - expected, axis=1).max() < 0.6
    assert finder.disagreement(seen, truth, CAMERA, 2.0) == ""
    corners = np.array([m.corners_mm() for m in layout().markers]).reshape(-1, 2) * 1e-3
    places = np.column_stack([corners, np.zeros(len(corners))])
    best = finder.poses(seen, CAMERA)[0]
    # Two small markers in a row determine the tilt badly, but their position well.
    pixels = CAMERA.project(best.apply(places)) - CAMERA.project(truth.apply(places))
    assert np.linalg.norm(pixels, axis=1).max() < 0.7


def test_a_marker_where_the_lens_has_no_rays_neither_gives_a_pose_nor_contradicts() -> None:
    """In the corners of a wide picture the distortion bends back; the print elsewhere is as good as without it."""
    truth, finder = scene.pose(layout()), MarkerFinder(layout())
    bending = dataclasses.replace(CAMERA, d=np.array([-40.0, 0.0, 0.0, 0.0, 0.0]))
    seen = finder.find(picture(layout(), truth), bending)
    assert finder.poses(seen, bending) == []
    assert finder.disagreement(seen, truth, bending, 2.0) is None


MOVED = "by marker APRILTAG_36h11 3 the panel is 6.0 mm from where its print is (limit 2 mm)"
EXCHANGED = "marker APRILTAG_36h11 4 is where the layout has APRILTAG_36h11 3"


@pytest.mark.parametrize(
    ("changed", "expected"),
    [(("[68.0, 13.0]", "[74.0, 13.0]"), MOVED), (("id: 3", "id: 4"), EXCHANGED)],
    ids=["moved", "exchanged"],
)
def test_moved_and_exchanged_markers_contradict_the_print(changed: tuple[str, str], expected: str) -> None:
    truth = scene.pose(layout())
    finder = MarkerFinder(layout())
    text = finder.disagreement(finder.find(picture(layout(changed), truth), CAMERA), truth, CAMERA, 2.0)
    print(text)
    assert text is not None
    number = float(expected.split("panel is ")[1].split()[0]) if "panel is" in expected else None
    if number is None:
        assert text == expected
    else:
        found = float(text.split("panel is ")[1].split()[0])
        assert abs(found - number) < 0.3
        assert text.replace(f"{found:.1f}", f"{number:.1f}") == expected


def test_without_the_panels_markers_nothing_is_said() -> None:
    truth = scene.pose(layout())
    finder = MarkerFinder(layout())
    assert finder.disagreement([], truth, CAMERA, 2.0) is None
    elsewhere = [dataclasses.replace(m, id=9) for m in finder.find(picture(layout(), truth), CAMERA) if m.id == 7]
    moved = [dataclasses.replace(m, corners_px=m.corners_px + 300.0) for m in elsewhere]
    assert moved and finder.disagreement(moved, truth, CAMERA, 2.0) is None
    assert MarkerFinder(scene.bench_layout()).find(picture(layout(), truth), CAMERA) == []


def test_printed_modules_are_those_of_the_dictionary() -> None:
    modules = marker_modules("4X4_50", 7)
    assert modules.shape == (6, 6)
    assert not modules[0].any() and not modules[:, 0].any()
    bits = modules[1:-1, 1:-1].astype(np.uint8)
    found, number, _ = dictionary("4X4_50").identify(bits, 0.0)
    assert found and number == 7


def test_marker_that_cannot_be_is_refused_with_its_line() -> None:
    lines = scene.LAYOUT.read_text().count("\n") + 3
    for changed, expected in (
        (("id: 3", "id: 600"), "id = 600: APRILTAG_36h11 has the markers 0 to 586"),
        (("id: 3", "id: 3.5"), "id = 3.5: APRILTAG_36h11 has the markers 0 to 586"),
        (("36h11, id: 3", "99h9, id: 3"), "dictionary = 'APRILTAG_99h9' is none of 4X4_50"),
        (("[68.0, 13.0]", "[68.0, 6.0]"), r"at \(68, 6\) with its white rim, 15.0 mm wide, reaches outside the panel"),
        (("[68.0, 13.0]", "[68.0, 35.0]"), "with its white rim is under control 'SCREEN'"),
        (("size_mm: 12.0}\n  - {dictionary: 4X4", "size_mm: 0}\n  - {dictionary: 4X4"), "positive numbers"),
        (("4X4_50, id: 7", "APRILTAG_36h11, id: 3"), "marker APRILTAG_36h11 3 occurs twice"),
    ):
        with pytest.raises(ValueError, match=rf"layout:({lines}|{lines + 1}): .*{expected}"):
            layout(changed)
