"""What the ball touches: control, height, sinking, collisions, turning."""

from __future__ import annotations

import math

import numpy as np
import pytest

from icu_common.core.panel_layout import parse_layout
from scope_bench.core.touch import FACE, Touch, TouchEvent

LAYOUT = parse_layout(
    """
model: m
size_mm: [200, 100]
controls:
- {name: B, kind: button, position_mm: [30, 50], size_mm: [16, 8], height_mm: 3}
- {name: K, kind: knob, shape: circle, position_mm: [80, 50], size_mm: [18, 18], height_mm: 15}
- {name: C, kind: connector, shape: circle, position_mm: [120, 50], size_mm: [14, 14], height_mm: 12}
- {name: S, kind: touch_area, position_mm: [165, 50], size_mm: [60, 80]}
"""
)


class Rig:
    def __init__(self) -> None:
        self.events: list[TouchEvent] = []
        self.touch = Touch(LAYOUT, 2.0, self.events.append)
        self.time = 0.0
        self.touch.place(np.array([5.0, 5.0, 40.0]), 0.0)

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
