"""The bench as a whole, fed with motor samples."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.core.bench import Bench
from icu_simulator.core.configuration import BenchConfig, PanelConfig
from icu_simulator.core.renderer import Renderer
from icu_simulator.core.touch import TouchEvent

ROOT = Path(__file__).parents[4]
LAYOUT = load_layout(ROOT / "config/scopes/dso_bench_4.yaml")


class Rig:
    """Drives the motors so that the undisturbed ball goes where asked, in panel millimetres."""

    def __init__(self, config: BenchConfig | None = None) -> None:
        self.bench = Bench(LAYOUT, config or BenchConfig())
        self.time = 100.0
        self.records: list[dict] = []
        self.bench.feed((-359.0, -219.0, -1.0), 0, False, self.time)

    def motor(self, point_mm: tuple[float, float, float]) -> np.ndarray:
        base = self.bench.panel_from.apply(np.array(point_mm) / 1000) * 1000
        errors = self.bench.errors
        xy = np.linalg.solve(errors.base_from_carriage, base[:2] + errors.lean * base[2])
        return np.array([-359 + xy[0], -219 + xy[1], -1 + base[2]])

    def go(self, x: float, y: float, z: float, seconds: float = 1.0) -> None:
        target = self.motor((x, y, z))
        start = getattr(self, "_at", np.array([-359.0, -219.0, -1.0]))
        for share in np.linspace(0, 1, 101)[1:]:
            self.time += seconds / 100
            self.bench.feed(start + (target - start) * share, 0, False, self.time)
        self._at = target
        self.records += self.bench.take_records()

    def press(self, name: str) -> None:
        control = LAYOUT.control(name)
        x, y = control.position_mm
        # Always from the lower left, so that the play is taken up in one direction.
        self.go(x - 2, y - 2, 30)
        self.go(x, y, 30)
        self.go(x, y, control.height_mm + 0.4)
        self.go(x, y, 30)

    def events(self, *kinds: str) -> list[tuple[str, str]]:
        return [(r["event"], r["control"]) for r in self.records if r["event"] in kinds]


def test_pressing_run_stop_stops_the_trace_and_is_logged() -> None:
    rig = Rig()
    rig.press("RUN_STOP")
    assert not rig.bench.state.running
    assert rig.events("contact", "press", "unpress", "release") == [
        (kind, "RUN_STOP") for kind in ("contact", "press", "unpress", "release")
    ]
    change = next(r for r in rig.records if r["event"] == "instrument")
    assert change["changes"] == {"running": False}
    contact = next(r for r in rig.records if r["event"] == "contact")
    assert contact["tip_panel_mm"][:2] == pytest.approx((208.0, 127.0), abs=0.03)
    assert contact["tip_panel_mm"][2] == pytest.approx(5.0, abs=0.11)
    again = rig.bench.panel_from.apply(np.array(contact["tip_panel_mm"]) / 1000)
    assert contact["tip_base_m"] == pytest.approx(again.tolist(), abs=1e-6)
    json.dumps(rig.records)
    rig.press("RUN_STOP")
    assert rig.bench.state.running


def test_turning_a_knob_changes_the_scale() -> None:
    rig = Rig()
    rig.go(211 + 4, 92, 30)
    rig.go(211 + 6, 92, 30)
    rig.go(211 + 6, 92, 16.5)
    for degrees in range(0, -46, -5):
        angle = np.radians(degrees)
        rig.go(211 + 6 * np.cos(angle), 92 + 6 * np.sin(angle), 16.5, 0.1)
    rig.go(220, 80, 30)
    assert rig.bench.state.knob_deg("CH1_SCALE") == pytest.approx(-45, abs=4)
    release = next(r for r in rig.records if r["event"] == "release")
    assert release["control"] == "CH1_SCALE"
    assert release["turned_deg"] == pytest.approx(rig.bench.state.knob_deg("CH1_SCALE"), abs=0.01)
    changes = [r["changes"] for r in rig.records if r["event"] == "instrument"]
    assert [list(c) for c in changes] == [["volts_index"], ["volts_index"]]


def test_touching_the_screen_sets_the_marker_there() -> None:
    rig = Rig()
    rig.go(55, 58, 30)
    rig.go(57.5, 61.5, 30)
    rig.go(57.5, 61.5, 1.5)
    assert rig.bench.state.marker == pytest.approx(((57.5 - 15) / 170, (61.5 - 30) / 105), abs=0.001)
    assert rig.bench.touch.contact == "SCREEN"
    assert rig.bench.truth()["contact"] == "SCREEN"


def test_holding_menu_opens_the_system_menu() -> None:
    rig = Rig()
    x, y = LAYOUT.control("MENU").position_mm
    rig.go(x, y, 30)
    rig.go(x, y, 3.2)
    assert rig.bench.state.menu == "MENU"
    rig.bench.advance(rig.time + 1.5)
    assert rig.bench.state.menu == "SYSTEM"


def test_a_collision_with_a_knobs_side_is_in_the_log() -> None:
    rig = Rig()
    rig.go(225, 104, 30)
    rig.go(225, 104, 8)
    rig.go(225, 92, 8)
    rig.go(212, 92, 8)
    # Passing between the two knobs is free, going on into the left one is not.
    assert rig.events("collision") == [("collision", "CH1_SCALE")]


def test_play_moves_the_ball_with_the_direction_of_approach() -> None:
    rig = Rig()
    rig.go(90, 75, 30)
    rig.go(100, 80, 30)
    from_below = rig.bench.tip_base()
    rig.go(110, 85, 30)
    rig.go(100, 80, 30)
    difference = (rig.bench.tip_base() - from_below) * 1000
    expected = rig.bench.errors.base_from_carriage @ rig.bench.errors.play_mm[:2]
    assert difference[:2] == pytest.approx(expected.tolist(), abs=1e-4)


def test_a_moment_lies_between_the_samples_around_it() -> None:
    rig = Rig()
    rig.go(100, 80, 30)
    start, begin = rig.bench.tip_base(), rig.time
    rig.go(120, 80, 30)
    end = rig.bench.tip_base()
    assert rig.bench.moment(begin).tip == pytest.approx(start.tolist())
    quarter = rig.bench.moment(begin + 0.2525).tip
    assert quarter == pytest.approx((start + (end - start) * 0.2525).tolist(), abs=3e-6)
    assert rig.bench.moment(rig.time + 5).tip == pytest.approx(end.tolist())


def test_a_pushed_panel_stays_under_the_ball_and_is_touched_elsewhere() -> None:
    rig = Rig()
    rig.go(208, 127, 30)
    before = rig.bench.tip_base()
    rig.bench.move_panel(0.003, -0.001, 0.0)
    assert rig.bench.tip_base() == pytest.approx(before.tolist(), abs=1e-9), "the machine has not moved"
    yaw = np.radians(BenchConfig().panel.yaw_deg)
    dx, dy = -3 * np.cos(yaw) + 1 * np.sin(yaw), 3 * np.sin(yaw) + 1 * np.cos(yaw)
    assert rig.bench.touch.tip_mm[:2] == pytest.approx((208 + dx, 127 + dy), abs=0.05)


def test_a_new_configuration_is_taken() -> None:
    rig = Rig()
    config = dataclasses.replace(rig.bench.config, panel=PanelConfig(position_m=(0.05, 0.025, -0.035)))
    errors = rig.bench.errors
    rig.bench.reconfigure(config)
    assert rig.bench.panel_from.translation == pytest.approx([0.05, 0.025, -0.035])
    assert rig.bench.errors is errors


def test_equal_seeds_make_equal_benches() -> None:
    first, again, other = (Rig(BenchConfig(seed=seed)) for seed in (3, 3, 4))
    for rig in (first, again, other):
        rig.press("CH2")
    assert first.records == again.records
    assert first.bench.errors.play_mm[0] != other.bench.errors.play_mm[0]


def test_samples_that_go_back_in_time_are_ignored() -> None:
    rig = Rig()
    rig.go(100, 80, 30)
    tip = rig.bench.tip_base()
    rig.bench.feed((-359.0, -219.0, -1.0), 0, False, rig.time - 0.5)
    assert np.array_equal(rig.bench.tip_base(), tip)


def test_cameras_on_the_carriage_see_the_tip_at_rest_and_the_panel_moving() -> None:
    """Their pictures are those of fixed cameras before a panel that moves the other way."""
    camera = dataclasses.replace(BenchConfig().camera, mounting="carriage", width_px=320, height_px=180, focal_px=425.0)
    camera = dataclasses.replace(camera, centre_px=(160.0, 90.0, 160.0, 90.0), aim_m=(0.0, 0.012, -0.022))
    quiet = dataclasses.replace(BenchConfig().light, noise=0.0)
    config = BenchConfig(camera=camera, light=quiet)
    rig = Rig(config)
    renderer = Renderer(LAYOUT, config, rig.bench.panel_from)
    left = renderer.rig.left
    seen = []
    for x, y in ((60.0, 40.0), (200.0, 100.0)):
        rig.go(x, y, 30)
        rig.go(x, y, 30)
        moment = rig.bench.moment(rig.time)
        assert not moment.crossing
        moved = np.array([*moment.carriage, 0.0])
        tip_px = left.project(np.array(moment.tip) - moved)[0]
        seen.append(tip_px)
        picture = renderer.render(moment)[0].astype(int)
        u, v = np.round(tip_px).astype(int)
        blue, green, red = picture[v, u]
        assert min(blue, red) - green > 60, "the magenta ball is where the moved camera projects it"
        # A white letter's dark surroundings: the panel's corner is where it should be, too.
        corner = left.project(rig.bench.panel_from.apply([0.0, 0.0, 0.0]) - moved)[0]
        if 5 < corner[0] < 315 and 5 < corner[1] < 175:
            c, r = np.round(corner).astype(int)
            inside, outside = picture[r - 4, c + 4].sum(), picture[r - 4, c - 4].sum()
            assert inside > outside + 60
    np.testing.assert_allclose(seen[0], seen[1], atol=0.5, err_msg="the tip rests, but for the panel's tilt")
    halfway = rig.time - 0.5
    assert rig.bench.moment(halfway).crossing is False, "the second way had no length"
    rig.go(60.0, 40.0, 30)
    assert rig.bench.moment(rig.time - 0.5).crossing


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "config" / "scopes").glob("*.yaml")))
def test_every_click_of_a_knob_is_one_step_as_far_apart_as_its_layout_says(name: str) -> None:
    layout = load_layout(ROOT / "config" / "scopes" / f"{name}.yaml")
    for knob in (c for c in layout.controls if c.detent_deg and c.name in ("CH1_SCALE", "TIME_SCALE", "TRIG_LEVEL")):
        bench = Bench(layout, BenchConfig())
        seen = []
        for number in range(4):
            tip_mm = (*knob.position_mm, knob.height_mm)
            event = TouchEvent(
                kind="turn", control=knob.name, time_s=float(number), tip_mm=tip_mm, degrees=knob.detent_deg
            )
            if number:
                bench.touch.on_event(event)
            state = bench.state
            seen.append((state.volts_index[0], state.time_index, round(state.trigger_div * 5)))
        moved = np.abs(np.diff(seen, axis=0)).sum(axis=1)
        assert moved.tolist() == [1, 1, 1], knob.name
