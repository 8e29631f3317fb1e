"""Touch of the ball: control, height, sinking, collisions, turning."""

from __future__ import annotations

import math

import numpy as np
import pytest

from icu_common.core.panel.panel_layout import parse_layout
from icu_simulator.core.touch import FACE, BenchTouch, TouchEvent

LAYOUT = parse_layout(
    """
model: m
size_mm: [200, 100]
controls:
- {name: B, kind: button, position_mm: [30, 50], size_mm: [16, 8], height_mm: 3}
- {name: K, kind: knob, shape: circle, position_mm: [80, 50], size_mm: [18, 18], height_mm: 15}
- {name: D, kind: knob, shape: circle, position_mm: [100, 20], size_mm: [20, 20], height_mm: 15,
   dimple: {place_mm: [0, -6], diameter_mm: 5, depth_mm: 1.2}}
- {name: C, kind: connector, shape: circle, position_mm: [120, 50], size_mm: [14, 14], height_mm: 12}
- {name: S, kind: touch_area, position_mm: [165, 50], size_mm: [60, 80]}
"""
)


class Rig:
    def __init__(self) -> None:
        self.events: list[TouchEvent] = []
        self.knob_deg = 0.0
        self.touch = BenchTouch(LAYOUT, 2.0, self._on_event, lambda name: self.knob_deg)
        self.time = 0.0
        self.touch.place(np.array([5.0, 5.0, 40.0]), 0.0)

    def _on_event(self, event: TouchEvent) -> None:
        self.events.append(event)
        self.knob_deg += event.degrees if event.kind == "turn" else 0.0

    def go(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        self.touch.move(np.array([x, y, z]), self.time + 0.1, self.time)
        self.time += 0.1
        return self.touch.tip_mm

    def down(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        self.go(x, y, 40.0)
        return self.go(x, y, z)

    def kinds(self) -> list[tuple[str, str]]:
        return [(event.kind, event.control) for event in self.events]


@pytest.mark.parametrize(
    ("x", "y", "name", "height"),
    [(80, 50, "K", 15), (86, 54, "K", 15), (120, 50, "C", 12), (165, 50, "S", 0), (60, 90, FACE, 0), (30, 60, FACE, 0)],
)
def test_contact_is_at_the_surface(x: float, y: float, name: str, height: float) -> None:
    rig = Rig()
    tip = rig.down(x, y, height + 2 - 0.6)
    assert tip == pytest.approx((x, y, height + 2)), "the ball stops where its underside meets the surface"
    assert rig.kinds() == [("contact", name)]
    contact = rig.events[0]
    assert contact.tip_mm[:2] == (x, y)
    assert 0 <= contact.overtravel_mm < 0.11
    # The drive came down 40 mm in 0.1 s.
    assert contact.time_s == pytest.approx(rig.time - 0.1 + 0.1 * (40 - height - 2) / (40 - height - 1.4), abs=0.0006)
    rig.go(x, y, height + 6.0)
    assert rig.kinds()[1:] == [("release", name)]
    assert rig.events[-1].overtravel_mm == pytest.approx(0.6, abs=1e-6)


def test_nothing_is_touched_above_the_surface_or_beside_the_panel() -> None:
    rig = Rig()
    rig.down(80, 50, 17.05)
    rig.down(30, 50, 5.05)
    rig.down(-5, 50, -20.0)
    assert rig.events == []
    assert rig.touch.contact == ""


def test_button_sinks_acts_and_comes_back() -> None:
    rig = Rig()
    assert rig.down(30, 50, 4.6)[2] == pytest.approx(4.6), "a button gives way"
    assert rig.touch.sunk_mm() == (("B", pytest.approx(0.4)),)
    assert rig.kinds() == [("contact", "B")]
    assert rig.go(30, 50, 4.2)[2] == pytest.approx(4.2)
    assert rig.kinds() == [("contact", "B"), ("press", "B")]
    assert rig.go(30, 50, 3.0)[2] == pytest.approx(3.5), "its stop is 1.5 mm down"
    rig.go(30, 50, 4.5)
    rig.go(30, 50, 10.0)
    assert rig.kinds()[2:] == [("unpress", "B"), ("release", "B")]
    assert rig.events[-1].overtravel_mm == pytest.approx(0.5, abs=1e-6)
    assert rig.touch.sunk_mm() == ()


def test_a_button_is_pressed_once_however_deep() -> None:
    rig = Rig()
    rig.down(30, 50, 3.0)
    rig.go(30, 50, 4.0)
    rig.go(30, 50, 3.0)
    assert [e.kind for e in rig.events].count("press") == 1


def test_the_edge_of_a_knob_is_met_with_the_side_of_the_ball() -> None:
    rig = Rig()
    # 1.2 mm outside the rim the ball's underside is sqrt(4 - 1.44) = 1.6 mm below its centre.
    assert rig.down(80 + 9 + 1.2, 50, 15.0)[2] == pytest.approx(16.6)
    assert rig.kinds() == [("contact", "K")]


def test_running_into_a_side_is_a_collision() -> None:
    rig = Rig()
    rig.down(60, 50, 8.0)
    rig.go(75, 50, 8.0)
    assert rig.kinds() == [("collision", "K")]
    assert rig.events[0].tip_mm[0] == pytest.approx(80 - 9 - 2, abs=0.11), "where the ball's side meets the wall"
    assert rig.events[0].tip_mm[2] == 8.0
    rig.go(60, 50, 8.0)
    assert rig.kinds() == [("collision", "K"), ("clear", "K")]
    rig.go(60, 50, 40.0)
    rig.go(80, 50, 40.0)
    assert len(rig.events) == 2


def test_a_knob_goes_along_with_the_ball() -> None:
    rig = Rig()
    rig.down(86, 50, 16.5)
    for degrees in range(3, 93, 3):
        rig.go(80 + 6 * math.cos(math.radians(degrees)), 50 + 6 * math.sin(math.radians(degrees)), 16.5)
    turned = [e.degrees for e in rig.events if e.kind == "turn"]
    assert sum(turned) == pytest.approx(90.0, abs=0.01)
    rig.go(80, 56, 30.0)
    assert rig.events[-1].kind == "release"
    assert rig.events[-1].degrees == pytest.approx(90.0, abs=0.01)


def test_clockwise_is_negative_and_without_pressure_nothing_turns() -> None:
    rig = Rig()
    rig.down(86, 50, 16.5)
    rig.go(80 + 6 * math.cos(-0.5), 50 + 6 * math.sin(-0.5), 16.5)
    assert sum(e.degrees for e in rig.events) == pytest.approx(-math.degrees(0.5), abs=0.01)
    light = Rig()
    light.down(86, 50, 16.98)
    light.go(80, 56, 16.98)
    assert light.kinds() == [("contact", "K")]


PLAY_MM = 2.5 - math.sqrt(2.0**2 - 0.8**2)
"""The ball, 2 mm in radius, in the dimple of knob D: 1.2 mm deep, so 0.8 mm of it are above the rim."""


def around(turned_deg: float, radius_mm: float = 6.0) -> tuple[float, float]:
    """The place over knob D that its dimple has when it is turned so far."""
    angle = math.radians(turned_deg - 90)
    return 100 + radius_mm * math.cos(angle), 20 + radius_mm * math.sin(angle)


@pytest.mark.parametrize("way", [50, -50])
def test_in_a_dimple_the_ball_takes_the_knob_along_once_it_has_met_the_wall(way: int) -> None:
    rig = Rig()
    rig.knob_deg = 30.0
    assert rig.down(*around(30), 15 - 1.2 + 2 - 0.5)[2] == pytest.approx(15 - 1.2 + 2), "it stands on the bottom"
    step = 1 if way > 0 else -1
    for turned in range(30 + step, 30 + way + step, step):
        tip = rig.go(*around(turned), 15 - 1.2 + 2 - 0.5)
        assert tip[2] == pytest.approx(15 - 1.2 + 2, abs=0.02)
    play_deg = math.degrees(2 * math.asin(PLAY_MM / 12))
    assert rig.knob_deg == pytest.approx(30 + way - step * play_deg, abs=0.05)
    rig.go(*around(30 + way), 40)
    assert rig.events[-1].degrees == pytest.approx(way - step * play_deg, abs=0.05)
    assert {event.control for event in rig.events} == {"D"}


def test_outwards_the_ball_climbs_over_the_rim_of_a_dimple() -> None:
    rig = Rig()
    rig.down(*around(0), 15 - 1.2 + 2 - 0.5)
    heights = [rig.go(*around(0, 6 + 0.1 * k), 15 - 1.2 + 2 - 0.5)[2] for k in range(1, 27)]
    assert (np.diff(heights) >= -1e-9).all()
    assert heights[-1] == pytest.approx(17.0), "on the knob's top"
    assert rig.knob_deg == 0.0


def test_beside_its_dimple_a_knob_goes_along_by_friction() -> None:
    rig = Rig()
    rig.down(*around(180), 16.5)
    for turned in range(181, 201):
        rig.go(*around(turned), 16.5)
    assert rig.knob_deg == pytest.approx(20, abs=0.1)


def test_through_the_middle_a_knob_does_not_turn() -> None:
    rig = Rig()
    rig.down(86, 50, 16.5)
    rig.go(74, 50, 16.5)
    assert [e for e in rig.events if e.kind == "turn"] == []


def test_a_touch_that_moves_on_is_a_drag() -> None:
    rig = Rig()
    rig.down(150, 50, 1.5)
    rig.go(155, 50, 1.5)
    drags = [e for e in rig.events if e.kind == "drag"]
    assert 8 <= len(drags) <= 10
    assert drags[-1].tip_mm[0] == pytest.approx(155, abs=0.6)
    rig.go(155, 93, 1.5)
    assert rig.kinds()[-2:] == [("release", "S"), ("contact", FACE)]


def test_after_a_gap_the_way_does_not_count() -> None:
    rig = Rig()
    rig.down(60, 50, 8.0)
    rig.touch.place(np.array([100.0, 50.0, 8.0]), 9.0)
    assert rig.events == []
