"""The hidden errors: play, scale, skew, lean, and the other kinds of stylus."""

from __future__ import annotations

import numpy as np
import pytest

from icu_common.core.configuration.config import ConfigError
from icu_simulator.core.configuration import BenchStylusConfig, MechanicsConfig
from icu_simulator.core.mechanics import Errors, Mechanism, draw_errors

PLAY = Errors(play_mm=np.array([0.2, 0.1, 0.0]), base_from_carriage=np.eye(2), lean=np.zeros(2))


def mechanism(errors: Errors = PLAY, kind: str = "z_axis", **stylus: float) -> Mechanism:
    return Mechanism(MechanicsConfig(), BenchStylusConfig(kind=kind, **stylus), errors)


def reading(x: float, y: float = 0.0, z: float = 0.0) -> list[float]:
    """Machine position of a reading in mm; the stylus goes down with z."""
    return [-359 + x, -219 + y, -1 - z]


def test_homed_is_the_origin() -> None:
    assert mechanism().tip(reading(0), 0, False, 0.0) == pytest.approx([0, 0, 0], abs=1e-12)


def test_play_is_taken_up_before_the_carriage_follows() -> None:
    m = mechanism()
    way = [(0.0, 0.0), (10.0, 10.0), (9.9, 10.0), (9.8, 10.0), (9.5, 9.7), (9.6, 9.7), (9.7, 9.7), (9.8, 9.8)]
    for motor, carriage in way:
        tip = m.tip(reading(motor), 0, False, 0.0)
        assert tip[0] * 1000 == pytest.approx(carriage, abs=1e-9), f"motor at {motor}"


def test_axes_have_play_of_their_own() -> None:
    m = mechanism()
    m.tip(reading(50, 50), 0, False, 0.0)
    tip = m.tip(reading(40, 40), 0, False, 0.1)
    assert tip * 1000 == pytest.approx([40.2, 40.1, 0], abs=1e-9)


def test_scale_skew_and_lean() -> None:
    errors = Errors(
        play_mm=np.zeros(3),
        base_from_carriage=np.array([[1.004, -0.003], [0.0, 0.998]]),
        lean=np.array([0.002, -0.001]),
    )
    tip = mechanism(errors).tip(reading(100, 200, 30), 0, False, 0.0)
    assert tip * 1000 == pytest.approx([100.4 - 0.6 + 0.06, 199.6 - 0.03, -30], abs=1e-9)


def test_errors_come_from_the_seed_and_keep_their_bounds() -> None:
    config = MechanicsConfig()
    drawn = [draw_errors(config, np.random.default_rng(seed)) for seed in range(200)]
    again = draw_errors(config, np.random.default_rng(7))
    assert np.array_equal(drawn[7].play_mm, again.play_mm)
    assert np.array_equal(drawn[7].base_from_carriage, again.base_from_carriage)
    play = np.array([e.play_mm for e in drawn])
    assert play[:, :2].min() >= 0.15
    assert play[:, :2].max() <= 0.25
    assert play[:, 2].max() <= 0.02
    matrices = np.array([e.base_from_carriage for e in drawn])
    assert np.abs(np.linalg.norm(matrices, axis=1) - 1).max() <= 0.004 + 1e-9
    assert 0.002 < np.abs(matrices[:, 0, 1]).max() <= 0.00302
    assert np.abs([e.lean for e in drawn]).max() <= 0.002
    assert np.ptp(play[:, 0]) > 0.08


def test_servo_and_solenoid_move_at_their_speed() -> None:
    servo = mechanism(kind="servo_m3", travel_mm=30.0, speed_mm_s=100.0)
    assert servo.tip(reading(0), 200.0, False, 0.0)[2] == 0
    assert servo.tip(reading(0), 800.0, False, 0.1)[2] == pytest.approx(-0.010)
    assert servo.tip(reading(0), 800.0, False, 1.0)[2] == pytest.approx(-0.030)
    assert servo.tip(reading(0), 500.0, False, 2.0)[2] == pytest.approx(-0.015)
    assert servo.tip(reading(0), 0.0, False, 3.0)[2] == pytest.approx(0.0)
    solenoid = mechanism(kind="solenoid_m8", travel_mm=20.0, speed_mm_s=200.0)
    assert solenoid.tip(reading(0), 0.0, False, 0.0)[2] == 0
    assert solenoid.tip(reading(0), 0.0, True, 0.05)[2] == pytest.approx(-0.010)
    assert solenoid.tip(reading(0, 0, 40), 0.0, True, 0.5)[2] == pytest.approx(-0.020), (
        "the motor's z has no part in it"
    )


def test_swapped_bounds_are_refused() -> None:
    with pytest.raises(ConfigError, match="the smaller value comes first"):
        MechanicsConfig(backlash_mm=(0.3, 0.1))
