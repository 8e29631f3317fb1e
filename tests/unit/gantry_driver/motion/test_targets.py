"""From names, pixels and points to the place where the ball touches."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import (
    BASE_FROM_PANEL,
    CAMERA,
    CAMERA_FROM_BASE,
    CAMERA_FROM_PANEL,
    PANEL,
    control,
    turned,
)

from gantry_driver.core.motion.scene import PanelMap, Scene, TargetRefused
from gantry_driver.core.motion.targets import TouchConfig, highest_near, resolve, turn_points
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.gesture import parse_gesture
from icu_common.core.panel.panel_layout import Control, Dimple

CONFIG = TouchConfig()
SCENE = Scene(
    camera_from_base=CAMERA_FROM_BASE,
    camera_from_panel=CAMERA_FROM_PANEL,
    base_from_reading=np.eye(2),
    panel=PANEL,
    camera=CAMERA,
)
FLAT = replace(SCENE, camera_from_panel=CAMERA_FROM_BASE @ Transform(np.eye(3), np.array([0.02, 0.025, -0.035])))


def pixel_of(in_panel: Array) -> Array:
    return CAMERA.project(CAMERA_FROM_PANEL.apply(in_panel)[np.newaxis])[0]


def test_named_button_is_touched_at_the_centre_of_its_top() -> None:
    touch = resolve(parse_gesture("press:RUN_STOP"), FLAT, CONFIG, wander_m=0.002)
    assert touch.control == "RUN_STOP"
    np.testing.assert_allclose(touch.in_panel, [0.208, 0.127, 0.003], atol=1e-12)
    np.testing.assert_allclose(touch.in_base, [0.228, 0.152, -0.032], atol=1e-12)
    # Ball radius 2 mm less 1 mm overtravel; and 8 mm of air below the ball's bottom.
    assert touch.touch_z == pytest.approx(-0.032 + 0.002 - 0.001, abs=1e-12)
    assert touch.hover_z == pytest.approx(-0.032 + 0.002 + 0.008, abs=1e-12)
    assert touch.arc.shape == (0, 3)


def test_turned_and_tilted_panel() -> None:
    touch = resolve(parse_gesture("press:RUN_STOP"), SCENE, CONFIG, wander_m=0.002)
    np.testing.assert_allclose(touch.in_base, BASE_FROM_PANEL.apply([0.208, 0.127, 0.003]), atol=1e-9)


def test_hover_clears_tall_neighbours_only_within_the_wander() -> None:
    # CH1's centre is 12 mm below the knob's edge: 21 mm to its centre less 9 mm radius.
    near = resolve(parse_gesture("press:CH1"), FLAT, CONFIG, wander_m=0.010)
    far = resolve(parse_gesture("press:CH1"), FLAT, CONFIG, wander_m=0.009)
    assert far.hover_z == pytest.approx(-0.032 + 0.008 + 0.002, abs=1e-12)
    assert near.hover_z == pytest.approx(-0.020 + 0.003 + 0.002, abs=1e-12)


@pytest.mark.parametrize(
    "in_panel", [(0.205, 0.129, 0.003), (0.211, 0.092, 0.015), (0.05, 0.05, 0.0), (0.3, 0.14, 0.0)]
)
def test_pixel_finds_the_surface_point_it_shows(in_panel: tuple[float, float, float]) -> None:
    u, v = pixel_of(np.array(in_panel))
    gesture = parse_gesture(f"press:{float(u)!r},{float(v)!r}@camera_left_optical_frame")
    touch = resolve(gesture, SCENE, CONFIG, wander_m=0.002)
    np.testing.assert_allclose(touch.in_panel, in_panel, atol=2e-8)
    np.testing.assert_allclose(touch.in_base, BASE_FROM_PANEL.apply(in_panel), atol=2e-8)


def test_pixel_on_a_knobs_side_means_the_knob() -> None:
    # The camera looks from -y, so it sees the knob's side at y = centre - radius, here halfway up.
    side = np.array([0.211, 0.092 - 0.009, 0.0075])
    u, v = pixel_of(side)
    touch = resolve(
        parse_gesture(f"press:{float(u)!r},{float(v)!r}@camera_left_optical_frame"), SCENE, CONFIG, wander_m=0.002
    )
    assert touch.control == "CH1_SCALE"
    np.testing.assert_allclose(touch.in_panel, [0.211, 0.092, 0.015], atol=1e-9)


def test_point_in_base_is_seen_along_base_z() -> None:
    above = BASE_FROM_PANEL.apply([0.232, 0.127, 0.003])
    gesture = parse_gesture(f"press:{float(above[0])!r},{float(above[1])!r}@base_link")
    touch = resolve(gesture, SCENE, CONFIG, wander_m=0.002)
    assert touch.control == "SINGLE"
    np.testing.assert_allclose(touch.in_base, above, atol=1e-9)


def test_smallest_of_nested_flat_areas_is_meant() -> None:
    nested = PanelMap(
        controls=(*PANEL.controls, control("SOFT_KEY", "touch_area", 60, 60, 20, 10, 0)), extent=PANEL.extent
    )
    touch = resolve(parse_gesture("press:0.061,0.059@panel_link"), replace(SCENE, panel=nested), CONFIG, wander_m=0.002)
    assert touch.control == "SOFT_KEY"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("press:RUN_STOPP", ["RUN_STOPP", "RUN_STOP"]),
        ("press:CH1_IN", ["CH1_IN", "connector", "never"]),
        ("hold:CH1_IN:1", ["CH1_IN", "connector"]),
        ("turn:CH1_IN:10", ["CH1_IN", "connector"]),
        ("press:0.211,0.013@panel_link", ["CH1_IN", "connector"]),
        ("turn:RUN_STOP:10", ["RUN_STOP", "button", "knob"]),
        ("turn:SCREEN:10", ["SCREEN", "touch_area", "knob"]),
        ("turn:0.3,0.14@panel_link:10", ["no control"]),
        ("press:CRAMPED", ["2.0 mm", "CRAMPING", "15 mm high", "3.5 mm"]),
        ("press:0.199,0.127@panel_link", ["1.0 mm", "RUN_STOP", "3.5 mm"]),
        ("press:0.33,0.05@panel_link", ["0.3300", "0.320"]),
        ("press:-0.001,0.05@panel_link", ["-0.0010", "0.000"]),
        ("press:1280.0,5@camera_left_optical_frame", ["1280", "1280 x 720"]),
        ("press:5,-0.6@camera_left_optical_frame", ["-0.6", "1280 x 720"]),
        ("press:0.1,0.1@map", ["'map'", "base_link", "panel_link"]),
    ],
)
def test_refusals_say_why(command: str, words: list[str]) -> None:
    with pytest.raises(TargetRefused) as refusal:
        resolve(parse_gesture(command), SCENE, CONFIG, wander_m=0.002)
    for word in words:
        assert word in str(refusal.value)


def test_leaning_panel_is_refused() -> None:
    leaning = CAMERA_FROM_BASE @ Transform(turned(0, 12.0), np.array([0.02, 0.025, -0.035]))
    with pytest.raises(TargetRefused, match=r"12\.0 degrees \(limit 10"):
        resolve(parse_gesture("press:RUN_STOP"), replace(SCENE, camera_from_panel=leaning), CONFIG, wander_m=0.002)


@pytest.mark.parametrize("angle", [30.0, -45.0, 360.0, 1.0, 7.3])
def test_arc_has_the_radius_the_angle_and_short_chords(angle: float) -> None:
    knob = PANEL.controls[6]
    points = turn_points(knob, angle, CONFIG)
    offset = points[:, :2] - knob.centre
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), 0.6 * 0.009, atol=1e-12)
    np.testing.assert_allclose(points[:, 2], 0.015)
    steps = np.diff(np.unwrap(np.arctan2(offset[:, 1], offset[:, 0])))
    assert math.degrees(steps.sum()) == pytest.approx(angle, abs=1e-9)
    assert np.abs(np.degrees(steps)).max() <= 2.0 + 1e-9
    middle = offset.mean(axis=0) if abs(angle) < 360 else np.array([0.0, -1.0])
    assert middle[1] < 0 and abs(middle[0]) < 1e-9


def test_turn_touches_at_the_arcs_start_and_keeps_its_depth() -> None:
    touch = resolve(parse_gesture("turn:CH1_SCALE:30"), FLAT, CONFIG, wander_m=0.002)
    points = turn_points(PANEL.controls[6], 30.0, CONFIG)
    shift = np.array([0.02, 0.025, -0.035])
    np.testing.assert_allclose(touch.in_base, points[0] + shift, atol=1e-12)
    np.testing.assert_allclose(touch.arc, points[1:] + shift + [0, 0, 0.001], atol=1e-12)
    assert touch.touch_z == pytest.approx(-0.035 + 0.015 + 0.001, abs=1e-12)


def with_dimple(diameter_mm: float, depth_mm: float) -> Scene:
    dimple = Dimple(place_mm=(0.0, -5.0), diameter_mm=diameter_mm, depth_mm=depth_mm)
    knobs = [replace(c, dimple=dimple) if c.name == "CH1_SCALE" else c for c in PANEL.controls]
    return replace(FLAT, panel=replace(PANEL, controls=tuple(knobs)))


@pytest.mark.parametrize("way", [40.0, -40.0])
def test_a_dimple_is_entered_where_the_marker_says(way: float) -> None:
    """The dimple is opposite to the marker: at 30 degrees of the knob it is 30 degrees beyond straight down."""
    gesture = parse_gesture(f"turn:CH1_SCALE:{way}")
    touch = resolve(gesture, with_dimple(4.0, 1.0), CONFIG, wander_m=0.002, knob_deg=30.0)
    centre = np.array([0.231, 0.117, -0.035 + 0.015 - 0.001])
    start = centre + 0.005 * np.array([0.5, -math.sqrt(3) / 2, 0])
    np.testing.assert_allclose(touch.in_base, start, atol=1e-12)
    angles = np.unwrap([math.atan2(p[1] - centre[1], p[0] - centre[0]) for p in (touch.in_base, *touch.arc)])
    assert math.degrees(angles[-1] - angles[0]) == pytest.approx(way, abs=1e-9)
    assert np.abs(np.degrees(np.diff(angles))).max() <= 2.0 + 1e-9
    assert np.ptp(touch.arc[:, 2]) < 1e-12


def test_a_dimple_needs_a_known_marker_and_room_for_the_ball() -> None:
    gesture = parse_gesture("turn:CH1_SCALE:40")
    with pytest.raises(TargetRefused, match="finds the dimple by its marker: turn it by its name"):
        resolve(gesture, with_dimple(4.0, 1.0), CONFIG, wander_m=0.002)
    with pytest.raises(TargetRefused, match=r"is 3 mm wide, the stylus needs more than 3\.5 mm to reach its bottom"):
        resolve(gesture, with_dimple(3.0, 1.0), CONFIG, wander_m=0.002, knob_deg=0.0)
    # A ball of 2 mm radius is sqrt(3) mm to either side at a depth of 1 mm.
    with pytest.raises(TargetRefused, match=r"has 14\.6 degrees of play in the dimple of CH1_SCALE \(limit 10"):
        resolve(gesture, with_dimple(6.0, 1.0), CONFIG, wander_m=0.002, knob_deg=0.0)


def test_highest_near() -> None:
    knob = BASE_FROM_PANEL.apply([0.211, 0.092, 0.015])
    assert highest_near(knob[:2], SCENE, 0.003) == pytest.approx(knob[2], abs=1e-9)
    beside = BASE_FROM_PANEL.apply([0.211 + 0.009 + 0.002, 0.092, 0.0])
    assert highest_near(beside[:2], SCENE, 0.003) == pytest.approx(knob[2], abs=1e-4)
    assert highest_near(beside[:2], SCENE, 0.0015) == pytest.approx(beside[2], abs=1e-9)


def test_layout_in_millimetres_becomes_metres() -> None:
    layout = [
        Control(name="K", kind="knob", position_mm=(10.0, 20.0), size_mm=(8.0, 8.0), shape="circle", height_mm=15.0)
    ]
    panel = PanelMap.of(layout, np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.05], [0.0, 0.05], [0.0, 0.0]]))
    knob = panel.controls[0]
    np.testing.assert_allclose(knob.centre, [0.010, 0.020])
    np.testing.assert_allclose(knob.size, [0.008, 0.008])
    assert (knob.height, knob.round, knob.name, knob.kind) == (0.015, True, "K", "knob")
    np.testing.assert_allclose(panel.extent, [[0, 0], [0.1, 0.05]])


def test_gap_of_round_and_square_controls() -> None:
    square, circle = control("A", "button", 0, 0, 10, 6, 3), control("B", "knob", 0, 0, 10, 10, 15, True)
    assert square.gap(np.array([0.004, 0.002])) == 0.0
    assert square.gap(np.array([0.008, 0.007])) == pytest.approx(0.005)
    assert circle.gap(np.array([0.003, 0.004])) == pytest.approx(0.0)
    assert circle.gap(np.array([0.006, 0.008])) == pytest.approx(0.005)
    assert circle.gap(np.array([0.0, 0.0])) == 0.0


@pytest.mark.parametrize("cosine", [-1.0 - 1e-9, -1.0])
def test_a_panel_seen_from_behind_is_refused_whatever_the_rounding(cosine: float) -> None:
    turned = Transform(np.diag([1.0, -1.0, cosine]), np.zeros(3))
    behind = replace(SCENE, camera_from_base=Transform.identity(), camera_from_panel=turned)
    with pytest.raises(TargetRefused, match=r"leans by 180\.0 degrees"):
        resolve(parse_gesture("press:RUN_STOP"), behind, TouchConfig(), wander_m=0.005)
