"""Keys with travel and force: when they act, what the ball feels, and what a wrong entry is answered with."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from icu_common.core.configuration.config import ConfigError, from_mapping, to_mapping
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.core.bench import Bench
from icu_simulator.core.configuration import BenchConfig, MechanicsConfig
from icu_simulator.core.touch import BenchTouch, TouchEvent
from icu_simulator.keys.configuration import KeysConfig
from icu_simulator.keys.curve import ForceCurve
from icu_simulator.mechanisms.spring import SpringConfig

LAYOUT = load_layout(Path(__file__).parents[4] / "config/scopes/dso_bench_4.yaml")
SPRING = SpringConfig(preload_n=0.6, rate_n_mm=1.2)
STRONG = SpringConfig(preload_n=8.0, rate_n_mm=1.2)


class Finger:
    """Presses RUN_STOP, whose top is 3 mm above the face, with a ball of 2 mm radius."""

    def __init__(self, keys: KeysConfig, spring: SpringConfig = SPRING) -> None:
        self.events: list[TouchEvent] = []
        self.touch = BenchTouch(LAYOUT, 2.0, self.events.append, lambda name: 0.0, keys, spring)
        self.touch.place(np.array([208.0, 127.0, 20.0]), 0.0)
        self.time = 0.0

    def push(self, depth_mm: float) -> None:
        """Move the drive to so far below the key's rest."""
        self.touch.move(np.array([208.0, 127.0, 5.0 - depth_mm]), self.time + 1.0, self.time)
        self.time += 1.0

    def sunk(self) -> float:
        return dict(self.touch.sunk_mm()).get("RUN_STOP", 0.0)

    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]


def acts_at(keys: KeysConfig, spring: SpringConfig = STRONG) -> float:
    """Return the drive's depth at which the key acts, in steps of 0.01 mm."""
    finger = Finger(keys, spring)
    for depth in np.arange(0.01, 3.0, 0.01):
        finger.push(float(depth))
        if "press" in finger.kinds():
            return float(depth)
    return np.inf


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        (KeysConfig(), 0.7),
        (from_mapping(KeysConfig, {"plain.travel_mm": 2.5, "plain.actuation_mm": 1.2}), 1.2),
        (KeysConfig(controls="RUN_STOP=plain:2.5/2.2"), 2.2),
        (KeysConfig(controls="MATH=plain:2.5/2.2"), 0.7),
        (KeysConfig(kind="dome"), 0.25),
        (KeysConfig(kind="silicone"), 1.3),
        (KeysConfig(kind="membrane"), 0.3),
        (KeysConfig(kind="rocker"), 2.0),
    ],
)
def test_a_key_acts_at_its_own_stroke(keys: KeysConfig, expected: float) -> None:
    assert acts_at(keys) == pytest.approx(expected, abs=0.011)


def test_a_key_that_acts_at_1_2_mm_is_not_pressed_by_1_mm() -> None:
    finger = Finger(KeysConfig(controls="RUN_STOP=plain:2.5/1.2"))
    finger.push(1.0)
    assert finger.kinds() == ["contact"]
    assert finger.sunk() == pytest.approx(1.0)
    finger.push(1.3)
    assert finger.kinds() == ["contact", "press"]
    finger.push(2.9)
    assert finger.touch.tip_mm[2] == pytest.approx(2.5), "it stops 2.5 mm down"
    assert finger.touch.compression_mm == pytest.approx(0.4)


def test_a_key_stiffer_than_the_preload_stops_the_ball_before_it_acts() -> None:
    finger = Finger(KeysConfig(kind="silicone"))
    # 0.1 N at rest, 1.35 N at 0.7 mm: 1.7857 N/mm. The preload of 0.6 N is reached at 0.28 mm.
    finger.push(0.25)
    assert finger.sunk() == pytest.approx(0.25)
    assert finger.touch.compression_mm == pytest.approx(0.0)
    finger.push(0.6)
    # 0.6 + 1.2 (0.6 - s) = 0.1 + 1.7857 s
    assert finger.sunk() == pytest.approx((0.5 + 0.72) / (1.2 + 1.25 / 0.7), abs=1e-6)
    assert finger.touch.tip_mm[2] == pytest.approx(5.0 - finger.sunk())
    force = SPRING.force_n(finger.touch.compression_mm)
    assert force == pytest.approx(0.1 + finger.sunk() * 1.25 / 0.7), "spring and key are in balance"
    assert finger.kinds() == ["contact"]


def test_a_silicone_key_snaps_through_behind_its_peak_and_needs_more_drive_than_its_stroke() -> None:
    keys = KeysConfig(kind="silicone")
    # At the peak, 1.35 N at 0.7 mm, the spring is compressed by (1.35 - 0.6) / 1.2 = 0.625 mm.
    assert acts_at(keys, SPRING) == pytest.approx(1.325, abs=0.07)
    finger = Finger(keys)
    finger.push(1.30)
    assert finger.sunk() < 0.7
    before = finger.sunk()
    finger.push(1.40)
    assert finger.sunk() - before > 0.3, "it snaps: 0.1 mm of drive make more than 0.3 mm of stroke"


def test_a_key_comes_up_later_than_it_went_down() -> None:
    finger = Finger(KeysConfig(kind="silicone"))
    finger.push(2.4)
    assert "press" in finger.kinds()
    down = finger.sunk()
    finger.push(1.4)
    assert finger.sunk() > 1.0, "on its return curve the key still holds"
    assert down > finger.sunk()
    finger.push(-5.0)
    assert finger.sunk() == 0
    assert finger.kinds() == ["contact", "press", "unpress", "release"]


@pytest.mark.parametrize("kind", ["dome", "silicone", "membrane", "rocker"])
def test_the_force_is_that_of_the_key_at_every_stroke_on_the_way_in(kind: str) -> None:
    keys = KeysConfig(kind=kind)
    curve = ForceCurve(keys.of_kind(kind), keys.of_kind(kind).travel_mm)
    stroke = 0.0
    for pushed in np.arange(0.0, 8.0, 0.05):
        new = curve.stroke(stroke, float(pushed), SPRING.push)
        assert stroke <= new <= curve.travel_mm
        compression = pushed - new
        if 0 < new < curve.travel_mm and compression > 1e-9 and new > stroke:
            assert SPRING.force_n(compression) == pytest.approx(curve.force_n(new), abs=1e-9)
        stroke = new
    assert stroke == curve.travel_mm


def test_a_low_key_cannot_sink_below_the_face() -> None:
    control = LAYOUT.control("RUN_STOP")
    low = dataclasses.replace(control, height_mm=0.4)
    layout = dataclasses.replace(LAYOUT, controls=(low,))
    events: list[TouchEvent] = []
    touch = BenchTouch(layout, 2.0, events.append, lambda name: 0.0)
    touch.place(np.array([208.0, 127.0, 20.0]), 0.0)
    touch.move(np.array([208.0, 127.0, 2.05]), 1.0, 0.0)
    assert [e.kind for e in events] == ["contact"]
    touch.move(np.array([208.0, 127.0, 1.9]), 2.0, 1.0)
    assert [e.kind for e in events] == ["contact", "press"], "it acts at its stop"
    touch.move(np.array([208.0, 127.0, 2.1]), 3.0, 2.0)
    assert [e.kind for e in events] == ["contact", "press"], "and holds until half of its stroke is back"


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"controls": "RUN_STOP"}, "expected NAME=kind"),
        ({"controls": "RUN_STOP=glass"}, "'glass': expected one of plain, dome"),
        ({"controls": "RUN_STOP=dome:1.2/2.5"}, "expected ascending values"),
        ({"controls": "RUN_STOP=dome:1..2/2.5"}, "must be numbers of mm"),
        ({"plain.travel_mm": 0.5}, "expected ascending values"),
        ({"dome.release_mm": 0.3}, "expected less than actuation_mm 0.25"),
        ({"kind": "glass"}, "is none of plain, dome"),
    ],
)
def test_a_wrong_key_is_answered_with_what_is_expected(values: dict[str, object], expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        from_mapping(KeysConfig, values)


def fed(values: dict[str, object]) -> Bench:
    bench = Bench(LAYOUT, from_mapping(BenchConfig, values))
    for share in np.linspace(0, 1, 11):
        bench.feed((-359 + 90 * share, -219 + 60 * share, -1.0), 0, False, 10 + share)
    return bench


def test_a_key_of_a_control_that_the_panel_does_not_have_changes_nothing() -> None:
    bench = fed({})
    before = bench.config
    with pytest.raises(ConfigError, match="names KNOB_9; the panel's buttons are RUN_STOP"):
        bench.reconfigure(from_mapping(BenchConfig, {"keys.controls": "KNOB_9=dome"}))
    assert bench.config is before


@pytest.mark.parametrize("offset_mm", [0.8, 2.2, -0.5])
def test_the_ball_is_higher_by_the_offset_at_once_and_keeps_its_play(offset_mm: float) -> None:
    bench = fed({})
    bench.feed((-359 + 80, -219 + 50, -1.0), 0, False, 11.5)
    before, errors = bench.tip_base(), bench.errors
    config = from_mapping(BenchConfig, {**to_mapping(bench.config), "mechanics.z_offset_mm": offset_mm})
    bench.reconfigure(config)
    bench.feed((-359 + 80, -219 + 50, -1.0), 0, False, 11.6)
    assert (bench.tip_base() - before) * 1000 == pytest.approx([0, 0, offset_mm], abs=1e-9)
    assert errors.play_mm.tolist() == bench.errors.play_mm.tolist()
    assert bench.truth()["tip_base_m"][2] * 1000 == pytest.approx(offset_mm + before[2] * 1000)


def test_missed_steps_move_the_carriage_through_its_play() -> None:
    bench = fed({})
    before = bench.tip_base()
    bench.reconfigure(dataclasses.replace(bench.config, mechanics=MechanicsConfig(missed_mm=(0.5, -0.1))))
    bench.feed((-269.0, -159.0, -1.0), 0, False, 11.5)
    moved = np.linalg.solve(bench.errors.base_from_carriage, ((bench.tip_base() - before) * 1000)[:2])
    assert moved == pytest.approx([0.5, 0.0], abs=1e-9), "0.1 mm back are lost in the play of y"


def test_the_log_has_the_force_of_a_touch() -> None:
    bench = Bench(LAYOUT, BenchConfig())
    event = TouchEvent(kind="release", control="MATH", time_s=1.0, tip_mm=(0, 0, 0), overtravel_mm=0.5, force_n=1.2)
    bench.touch.on_event(event)
    assert bench.take_records()[0]["force_n"] == 1.2
    finger = Finger(KeysConfig())
    finger.push(2.5)
    finger.push(-5.0)
    release = finger.events[-1]
    assert release.overtravel_mm == pytest.approx(1.0)
    assert release.force_n == pytest.approx(0.6 + 1.2 * 1.0)
