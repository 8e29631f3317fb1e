"""Screws, pulleys, growth and ringing: each has the asked size, in mm, at the carriage."""

from __future__ import annotations

import numpy as np
import pytest

from icu_common.core.configuration.config import ConfigError, from_mapping
from icu_simulator.core.configuration import BenchConfig, BenchStylusConfig, MechanicsConfig
from icu_simulator.core.mechanics import Errors, Mechanism
from icu_simulator.imaging.effect import effects_of
from icu_simulator.mechanisms.configuration import MechanismsConfig
from icu_simulator.mechanisms.drives import Drives

EXACT = Errors(play_mm=np.zeros(3), base_from_carriage=np.eye(2), lean=np.zeros(2))


def mechanism(seed: int = 1, **values: object) -> Mechanism:
    named = {key.replace("__", "."): value for key, value in values.items()}
    return Mechanism(MechanicsConfig(), BenchStylusConfig(), EXACT, Drives(from_mapping(MechanismsConfig, named), seed))


def tips(m: Mechanism, motors: np.ndarray, step_s: float = 0.004) -> np.ndarray:
    """Return (N, 3) mm of the ball for (N, 3) readings in mm."""
    reading = np.array([-359.0, -219.0, -1.0]) + motors * np.array([1, 1, -1])
    return 1000 * np.array([m.tip(mpos, 0, False, i * step_s) for i, mpos in enumerate(reading)])


def along(axis: int, places: np.ndarray) -> np.ndarray:
    motors = np.zeros((len(places), 3))
    motors[:, axis] = places
    return motors


def test_switched_off_nothing_changes_to_the_last_bit() -> None:
    plain = Mechanism(MechanicsConfig(), BenchStylusConfig(), EXACT)
    motors = np.random.default_rng(1).uniform(0, 30, (200, 3))
    assert np.array_equal(tips(plain, motors), tips(mechanism(), motors))


@pytest.mark.parametrize("axis", [0, 1])
def test_a_pulley_out_of_centre_repeats_with_each_turn(axis: int) -> None:
    m = mechanism(pulley__enabled=True, pulley__runout_mm=0.05, pulley__tooth_mm=0.0)
    places = np.linspace(0, 160, 1601)
    error = tips(m, along(axis, places))[:, axis] - places
    assert error[0] == 0, "homing takes the origin as it is"
    assert np.ptp(error) == pytest.approx(0.10, abs=0.001)
    assert error[400:] == pytest.approx(error[:-400].tolist(), abs=1e-9), "40 mm a turn"


def test_the_teeth_of_the_belt_repeat_with_its_pitch() -> None:
    m = mechanism(pulley__enabled=True, pulley__runout_mm=0.0, pulley__tooth_mm=0.02)
    places = np.linspace(0, 20, 2001)
    error = tips(m, along(0, places))[:, 0] - places
    assert np.ptp(error) == pytest.approx(0.04, abs=0.0005)
    assert error[200:] == pytest.approx(error[:-200].tolist(), abs=1e-9)


def test_a_screw_has_a_periodic_error_and_one_of_its_lead() -> None:
    m = mechanism(screw__enabled=True, screw__periodic_mm=0.03, screw__lead_mm=4.0, screw__lead_error=0.002)
    places = np.linspace(0, 40, 4001)
    error = -tips(m, along(2, places))[:, 2] - places
    turns = error[::400]
    slope = np.polyfit(places[::400], turns, 1)[0]
    assert 0 < abs(slope) <= 0.002
    assert turns == pytest.approx((slope * places[::400]).tolist(), abs=1e-9)
    assert np.ptp(error - slope * places) == pytest.approx(0.06, abs=0.001)


def test_the_seed_draws_the_phases() -> None:
    places = np.linspace(0, 40, 41)
    made = [tips(mechanism(seed, pulley__enabled=True), along(0, places)) for seed in (1, 1, 2)]
    assert np.array_equal(made[0], made[1])
    assert np.abs(made[0] - made[2]).max() > 0.01


def test_the_machine_grows_with_time() -> None:
    m = mechanism(thermal__enabled=True, thermal__rise_k=10.0, thermal__time_constant_s=100.0, thermal__column_mm=200.0)
    first = 1000 * m.tip([-359.0 + 300, -219.0, -1.0], 0, False, 50.0)
    assert first == pytest.approx([300, 0, 0], abs=1e-9), "the first sample is at the calibration's temperature"
    later = 1000 * m.tip([-359.0 + 300, -219.0, -1.0], 0, False, 150.0)
    rise = 10 * (1 - np.exp(-1))
    assert later == pytest.approx([300 * (1 + 23e-6 * rise), 0, 200 * 23e-6 * rise], abs=1e-9)
    end = 1000 * m.tip([-359.0 + 300, -219.0, -1.0], 0, False, 5000.0)
    assert end == pytest.approx([300.069, 0, 0.046], abs=1e-4)


def stop_at(speed: float, acceleration: float, step_s: float) -> np.ndarray:
    """Return positions of a move that brakes evenly to rest at 0.5 s, and rests until 1.5 s."""
    times = np.arange(0, 1.5, step_s) - 0.5
    brake = speed / acceleration
    way = np.where(times < -brake, speed * (times + brake) - speed * brake / 2, -0.5 * acceleration * times**2)
    return np.where(times < 0, way, 0.0)


@pytest.mark.parametrize(("speed", "acceleration"), [(100.0, 2000.0), (50.0, 500.0)])
def test_the_carriage_rings_after_a_stop_at_its_frequency_and_dies_out(speed: float, acceleration: float) -> None:
    m = mechanism(ringing__enabled=True, ringing__frequency_hz=[25.0, 40.0], ringing__damping=0.05)
    step_s = 0.001
    places = stop_at(speed, acceleration, step_s)
    tip = tips(m, along(0, places), step_s)
    error = tip[:, 0] - places
    natural = 2 * np.pi * 25.0
    after = error[500:]
    # A step of the acceleration: at most twice its static deflection, a / w^2, from the begin and from the end.
    static = acceleration / natural**2
    assert 0.3 * static < np.abs(after).max() < 2.5 * static
    crossings = np.nonzero(np.diff(np.sign(after[: int(0.4 / step_s)])))[0] * step_s
    assert np.diff(crossings).mean() == pytest.approx(1 / 50.0, rel=0.03)
    peaks = np.abs(after[:40]).max(), np.abs(after[400:440]).max()
    assert peaks[1] / peaks[0] == pytest.approx(np.exp(-0.05 * natural * 0.4), rel=0.3)
    assert np.abs(tip[:, 1]).max() == 0, "the other axis rests"


def test_ringing_is_the_same_for_fine_and_coarse_samples() -> None:
    ends = []
    for step_s in (0.0005, 0.004):
        m = mechanism(ringing__enabled=True, ringing__frequency_hz=[25.0, 40.0])
        places = stop_at(100.0, 2000.0, step_s)
        ends.append((tips(m, along(0, places), step_s)[:, 0] - places)[round(0.52 / step_s)])
    assert ends[1] == pytest.approx(ends[0], abs=0.012)


def test_nothing_rings_after_a_gap_in_the_samples() -> None:
    m = mechanism(ringing__enabled=True)
    m.tip([-359.0, -219.0, -1.0], 0, False, 0.0)
    assert m.tip([-259.0, -219.0, -1.0], 0, False, 5.0)[0] == pytest.approx(0.1, abs=1e-12)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"mechanisms.ringing.frequency_hz": [30.0]}, "expected two values"),
        ({"mechanisms.bending.sliding_friction": 0.6}, "expected at most static_friction 0.35"),
        ({"mechanisms.screw.lead_mm": 0.0}, "below its minimum 0.5 mm"),
    ],
)
def test_sizes_that_cannot_be_are_rejected(values: dict[str, object], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        from_mapping(BenchConfig, values)


def test_every_mechanism_is_an_effect_with_a_source_and_off_by_default() -> None:
    found = {name: effect for name, effect in effects_of(BenchConfig()) if not name.startswith("imaging.")}
    assert set(found) == {
        "manufacture",
        *(f"mechanisms.{name}" for name in ("screw", "pulley", "thermal", "ringing")),
        *(f"mechanisms.{name}" for name in ("bending", "knob", "mount", "glass")),
    }
    for name, effect in found.items():
        assert not effect.enabled and len(effect.SOURCE) > 20, name
        assert effect.scaled(2.0).enabled, name
    assert found["mechanisms.pulley"].scaled(2.0).runout_mm == pytest.approx(0.06)
    assert found["mechanisms.ringing"].scaled(4.0).frequency_hz == pytest.approx((21.0, 16.5))
    assert found["mechanisms.mount"].scaled(2.0).foot_n_mm == pytest.approx(12.5)
    assert found["manufacture"].scaled(2.0).position_mm == pytest.approx(0.4)
