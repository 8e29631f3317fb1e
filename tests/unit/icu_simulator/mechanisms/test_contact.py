"""Stick-slip, knobs that resist, an instrument that yields, tilts and slides, and a capacitive screen."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from icu_common.core.configuration.config import from_mapping, to_mapping
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.core.bench import Bench
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.touch import BenchTouch, TouchEvent
from icu_simulator.keys.configuration import KeysConfig
from icu_simulator.mechanisms.configuration import GlassConfig, MechanismsConfig, MountConfig
from icu_simulator.mechanisms.contact import GlassSensor, contact_diameter_mm, share_push, stiffness_n_mm
from icu_simulator.mechanisms.spring import SpringConfig

LAYOUT = load_layout(Path(__file__).parents[4] / "config/scopes/dso_bench_4.yaml")
SPRING = SpringConfig(preload_n=0.6, rate_n_mm=1.2)


class Finger:
    def __init__(self, keys: KeysConfig | None = None, **values: object) -> None:
        named = {key.replace("__", "."): value for key, value in values.items()}
        self.events: list[TouchEvent] = []
        self.knob_deg = 0.0
        mechanisms = from_mapping(MechanismsConfig, named)
        self.touch = BenchTouch(
            LAYOUT, 2.0, self._on, lambda name: self.knob_deg, keys or KeysConfig(), SPRING, mechanisms
        )
        self.time = 0.0
        self.touch.place(np.array([5.0, 5.0, 40.0]), 0.0)

    def _on(self, event: TouchEvent) -> None:
        self.events.append(event)
        self.knob_deg += event.degrees if event.kind == "turn" else 0.0

    def go(self, x: float, y: float, z: float, seconds: float = 0.1) -> tuple[float, float, float]:
        self.touch.move(np.array([x, y, z]), self.time + seconds, self.time)
        self.time += seconds
        return self.touch.tip_mm

    def down(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        self.go(x, y, 40.0)
        return self.go(x, y, z)


# Bending and stick-slip


def test_the_ball_sticks_until_the_stylus_bends_enough_and_then_slips_a_part() -> None:
    finger = Finger(bending__enabled=True, bending__stiffness_n_mm=7.2)
    finger.down(100, 80, 1.0)  # on the screen, 1 mm of compression: 1.8 N
    assert finger.touch.force_n == pytest.approx(1.8)
    sticks = 0.35 * 1.8 / 7.2
    assert finger.go(100 + 0.9 * sticks, 80, 1.0)[0] == pytest.approx(100.0, abs=1e-9)
    assert finger.touch.side_force_n == pytest.approx(0.9 * 0.35 * 1.8)
    moved = finger.go(100 + 1.1 * sticks, 80, 1.0)[0]
    assert moved == pytest.approx(100 + 1.1 * sticks - 0.22 * 1.8 / 7.2, abs=0.02)
    lags = []
    for step in range(1, 200):
        x = 100.2 + 0.01 * step
        lags.append(x - finger.go(x, 80, 1.0, 0.01)[0])
    assert max(lags) == pytest.approx(sticks, abs=0.012), "it follows in jumps"
    assert min(lags) == pytest.approx(0.22 * 1.8 / 7.2, abs=0.012)
    assert finger.go(102.3, 80, 40.0)[0] == pytest.approx(102.3), "lifted, the stylus is straight again"


def test_without_force_nothing_sticks() -> None:
    finger = Finger(bending__enabled=True)
    finger.down(100, 80, 2.05)
    assert finger.go(103, 80, 2.05) == pytest.approx((103, 80, 2.05))


# Knobs


def turned_by(finger: Finger, radius_mm: float, z: float) -> float:
    x, y = LAYOUT.control("CH1_SCALE").position_mm
    finger.down(x + radius_mm, y, z)
    for degrees in np.arange(1, 31):
        angle = np.radians(degrees)
        finger.go(x + radius_mm * np.cos(angle), y + radius_mm * np.sin(angle), z, 0.01)
    return finger.knob_deg


@pytest.mark.parametrize(("radius_mm", "depth_mm", "turns"), [(6.0, 1.0, True), (6.0, 0.2, False), (2.0, 1.0, False)])
def test_a_knob_turns_where_friction_overcomes_its_torque(radius_mm: float, depth_mm: float, turns: bool) -> None:
    # 0.6 x F x r against 4 mN m: 1.8 N at 6 mm give 6.5, 0.84 N give 3.0, 1.8 N at 2 mm give 2.2.
    finger = Finger(knob__enabled=True, knob__torque_mn_m=4.0)
    turned = turned_by(finger, radius_mm, 17.0 - depth_mm)
    assert turned == pytest.approx(30.0 if turns else 0.0, abs=0.5)
    assert turned_by(Finger(), radius_mm, 17.0 - depth_mm) == pytest.approx(30.0, abs=0.5)


def test_a_knob_with_inertia_runs_on_when_it_is_left_in_motion() -> None:
    results = []
    for inertia in (0.0, 2e5):
        finger = Finger(knob__enabled=True, knob__torque_mn_m=4.0, knob__inertia_g_mm2=inertia)
        x, y = LAYOUT.control("CH1_SCALE").position_mm
        finger.down(x + 6, y, 16.0)
        for degrees in np.arange(1, 31):
            angle = np.radians(degrees)
            finger.go(x + 6 * np.cos(angle), y + 6 * np.sin(angle), 16.0, 0.01)
        finger.go(x + 6 * np.cos(angle), y + 6 * np.sin(angle), 17.5, 0.01)
        results.append(finger.knob_deg)
        release = next(e for e in finger.events if e.kind == "release")
        assert release.degrees == pytest.approx(finger.knob_deg, abs=1e-6)
    # 100 degrees/s: J w^2 / 2 T = 0.5 x 2e-4 x 1.745^2 / 4e-3 = 0.076 rad.
    assert results[0] == pytest.approx(30.0, abs=0.5)
    assert results[1] - results[0] == pytest.approx(np.degrees(0.5 * 2e-4 * np.radians(100) ** 2 / 4e-3), rel=0.15)


# The instrument's feet


def test_the_instrument_sinks_least_in_its_middle_and_tilts_towards_a_corner() -> None:
    config = MountConfig(enabled=True, foot_n_mm=10.0, inset_mm=20.0)
    size = LAYOUT.size_mm
    assert stiffness_n_mm((160.0, 75.0), size, config) == pytest.approx(40.0)
    # Above a foot it is that foot alone.
    assert stiffness_n_mm((20.0, 20.0), size, config) == pytest.approx(40.0 / 3)
    corner = stiffness_n_mm((0.0, 0.0), size, config)
    assert corner < stiffness_n_mm((20.0, 20.0), size, config)


@pytest.mark.parametrize("pushed", [0.005, 0.03, 0.3, 1.5])
def test_spring_and_feet_carry_the_same_force(pushed: float) -> None:
    compression, sinking = share_push(pushed, 20.0, SPRING)
    assert compression + sinking == pytest.approx(pushed)
    if compression > 0:
        assert SPRING.force_n(compression) == pytest.approx(20.0 * sinking)
    else:
        assert 20.0 * sinking <= SPRING.preload_n + 1e-9


def test_a_yielding_instrument_takes_travel_from_the_press() -> None:
    hard, soft = Finger(), Finger(mount__enabled=True, mount__foot_n_mm=2.0)
    for finger in (hard, soft):
        finger.down(160, 60, 1.0)  # the bare screen
    assert hard.touch.tip_mm[2] == pytest.approx(2.0)
    assert hard.touch.compression_mm == pytest.approx(1.0)
    assert soft.touch.sinking_mm == pytest.approx(1.0 - soft.touch.compression_mm)
    assert soft.touch.tip_mm[2] == pytest.approx(2.0 - soft.touch.sinking_mm)
    assert soft.touch.sinking_mm == pytest.approx(
        soft.touch.force_n / stiffness_n_mm((160, 60), LAYOUT.size_mm, MountConfig(enabled=True, foot_n_mm=2.0)),
        abs=1e-9,
    )
    assert 0.15 < soft.touch.sinking_mm < 0.3


def test_a_dome_on_soft_feet_needs_more_drive_than_on_hard_ones() -> None:
    needed = []
    for values in ({}, {"mount__enabled": True, "mount__foot_n_mm": 1.0}):
        finger = Finger(KeysConfig(kind="dome"), **values)
        finger.go(208, 127, 40.0)
        depth = 0.0
        while "press" not in [e.kind for e in finger.events]:
            depth += 0.01
            assert depth < 3
            finger.go(208, 127, 5.0 - depth)
        needed.append(depth)
    assert 0.8 < needed[0] < 1.0
    assert needed[1] > needed[0] + 0.2


def drag_on_screen(slide_n: float) -> tuple[Bench, np.ndarray]:
    values = {
        "mechanics.backlash_mm": [0.0, 0.0],
        "mechanics.backlash_z_mm": 0.0,
        "mechanics.scale": 0.0,
        "mechanics.skew_rad": 0.0,
        "mechanics.tilt_rad": 0.0,
        "panel.tilt_deg": [0.0, 0.0],
        "panel.yaw_deg": 0.0,
        "mechanisms.bending.enabled": True,
        "mechanisms.mount.enabled": True,
        "mechanisms.mount.foot_n_mm": 10_000.0,
        "mechanisms.mount.slide_n": slide_n,
    }
    bench = Bench(LAYOUT, from_mapping(BenchConfig, values))
    before = bench.panel_from.translation.copy()
    time_s = 1.0

    def go(start: np.ndarray, end: np.ndarray) -> None:
        nonlocal time_s
        for share in np.linspace(0, 1, 251)[1:]:
            time_s += 0.004
            x, y, z = start + (end - start) * share
            bench.feed((-359 + x, -219 + y, -1 + z), 0, False, time_s)

    above, low = np.array([100.0, 90.0, 0.0]), np.array([100.0, 90.0, -34.0])
    aside = np.array([104.0, 90.0, -34.0])
    bench.feed((-359, -219, -1), 0, False, time_s)
    go(np.zeros(3), above)
    go(above, low)  # the face is at -35 mm: 1 mm of compression, 1.8 N
    go(low, aside)
    return bench, (bench.panel_from.translation - before) * 1000


def test_a_light_instrument_slides_with_the_ball_and_a_heavy_one_stays() -> None:
    bench, moved = drag_on_screen(slide_n=0.1)
    lag = 0.1 / 7.2
    assert moved == pytest.approx([4.0 - lag, 0.0, 0.0], abs=0.03)
    assert bench.touch.tip_mm[0] == pytest.approx(80.0, abs=0.03), "it is touched where it was"
    assert bench.tip_base()[0] * 1000 == pytest.approx(104.0 - lag, abs=0.03)
    _, heavy = drag_on_screen(slide_n=12.0)
    assert heavy == pytest.approx([0.0, 0.0, 0.0])


# The capacitive screen


def test_contact_grows_with_the_force_as_hertz_has_it() -> None:
    glass = GlassConfig(tip_mpa=2.0)
    assert contact_diameter_mm(1.0, 2.0, glass) == pytest.approx(2 * 0.75 ** (1 / 3))
    assert contact_diameter_mm(8.0, 2.0, glass) == pytest.approx(2 * contact_diameter_mm(1.0, 2.0, glass))
    assert contact_diameter_mm(0.0, 2.0, glass) == 0


def test_a_touch_needs_width_and_time() -> None:
    glass, sensor = GlassConfig(contact_mm=1.2, dwell_s=0.035), GlassSensor()
    seen = [sensor.feel(width, 0.004 * i, glass) for i, width in enumerate([1.5] * 8 + [1.0] + [1.5] * 12)]
    assert [i for i, begun in enumerate(seen) if begun] == [18], "a dip starts the time again; 9 samples are 36 ms"


@pytest.mark.parametrize(("depth_mm", "hold_s", "marked"), [(0.5, 0.2, True), (0.5, 0.0, False), (0.0, 0.2, False)])
def test_a_screen_reacts_to_force_that_lasts(depth_mm: float, hold_s: float, marked: bool) -> None:
    config = from_mapping(
        BenchConfig,
        {
            "mechanisms.glass.enabled": True,
            "mechanisms.glass.contact_mm": 1.2,
            "panel.tilt_deg": [0.0, 0.0],
            "stylus.spring.preload_n": 0.1,  # 0.1 N flatten the tip to 0.84 mm only
        },
    )
    bench = Bench(LAYOUT, config)
    time_s = 1.0
    bench.touch.place(np.array([100.0, 80.0, 10.0]), time_s)
    heights = [10.0, 2.5, 2.0 - depth_mm - 0.001, *[2.0 - depth_mm - 0.001] * round(hold_s / 0.004), 2.5, 10.0]
    for z in heights:
        base = bench.panel_from.apply(np.array([100.0, 80.0, z]) / 1000) * 1000
        xy = np.linalg.solve(bench.errors.base_from_carriage, base[:2] + bench.errors.lean * base[2])
        time_s += 0.004
        bench.feed((-359 + xy[0], -219 + xy[1], -1 + base[2]), 0, False, time_s)
    assert (bench.state.marker is not None) == marked
    events = [r["event"] for r in bench.take_records() if r["event"] in ("contact", "screen", "release")]
    assert events == (["contact", "screen", "release"] if marked else ["contact", "release"])


def test_mechanisms_are_set_live() -> None:
    bench = Bench(LAYOUT, BenchConfig())
    bench.feed((-300.0, -150.0, -1.0), 0, False, 1.0)
    before = bench.tip_base()
    values = {**to_mapping(bench.config), "mechanisms.pulley.enabled": True, "mechanisms.pulley.runout_mm": 0.3}
    bench.reconfigure(from_mapping(BenchConfig, values))
    bench.feed((-300.0, -150.0, -1.0), 0, False, 1.004)
    moved = (bench.tip_base() - before) * 1000
    assert 0.005 < np.abs(moved[:2]).max() < 1.0 and moved[2] == pytest.approx(0.0, abs=1e-9)
    bench.reconfigure(dataclasses.replace(bench.config, mechanisms=MechanismsConfig()))
    bench.feed((-300.0, -150.0, -1.0), 0, False, 1.008)
    assert np.abs(bench.tip_base() - before).max() * 1000 < 0.3, "back within the play"
