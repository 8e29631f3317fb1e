"""Evidence of a contact: the lag of the ball, the end of a press, and what is made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gantry_driver.core.contact.config import ContactConfig
from gantry_driver.core.contact.heights import HeightFindingCode
from gantry_driver.core.contact.lag import Lag, height_of, lag_between
from gantry_driver.core.contact.memory import HeightMemory
from gantry_driver.core.contact.press import Evidence, next_extension_m, verdict
from icu_common.core.goals.results import Felt

CONFIG = ContactConfig()
MOTIONS = 4000
SEED = 46


def lags(rng: np.random.Generator, lag_m: float, noise_m: float, offset_m: float) -> list[Lag]:
    """Return measured lags: 4 images in the air, 3 in contact, heights off by an offset."""
    found = []
    for _ in range(MOTIONS):
        air = np.zeros((4, 3))
        air[:, 2] = -0.0206 + offset_m + rng.normal(0.0, noise_m, 4)
        now = np.zeros((3, 3))
        now[:, 2] = -0.0309 + lag_m + offset_m + rng.normal(0.0, noise_m, 3)
        found.append(lag_between(height_of(air, 0.0206), height_of(now, 0.0309), CONFIG))
    return found


@pytest.mark.parametrize("noise_m", [0.00003, 0.00008, 0.00012])
@pytest.mark.parametrize("offset_m", [0.0, 0.0022])
def test_a_ball_in_the_air_never_counts_as_stopped(noise_m: float, offset_m: float) -> None:
    print(f"seed {SEED}")
    found = lags(np.random.default_rng(SEED), 0.0, noise_m, offset_m)
    assert sum(lag.stopped(CONFIG) for lag in found) <= MOTIONS // 1000
    spread = float(np.std([lag.lag_m for lag in found]))
    stated = float(np.median([lag.sigma_m for lag in found]))
    assert 0.95 * spread < stated < spread + 0.00007, "the stated sigma covers the true one"


def test_a_stopped_ball_is_found_by_its_lag() -> None:
    print(f"seed {SEED}")
    found = lags(np.random.default_rng(SEED), 0.0008, 0.00006, 0.0008)
    assert sum(lag.stopped(CONFIG) for lag in found) >= 0.999 * MOTIONS


def test_an_image_of_the_moving_stylus_does_not_count() -> None:
    tips = np.zeros((3, 3))
    tips[:, 2] = (-0.0285, -0.0288, -0.0288)
    assert height_of(tips, 0.03).seen_m == -0.0288


def test_one_wrong_image_does_not_make_a_contact_unknown() -> None:
    """Before, such a touch of the bare face was answered with contact_unknown: sigma was 0.25 mm."""
    air, now = np.zeros((10, 3)), np.zeros((4, 3))
    air[:, 2] = [-0.02, -0.0201, -0.0199, -0.02, -0.0199, -0.0201, -0.02, -0.02, -0.0199, -0.0186]
    now[:, 2] = [-0.03, -0.0299, -0.0301, -0.03]
    lag = lag_between(height_of(air, 0.02), height_of(now, 0.031), CONFIG)
    assert lag.stopped(CONFIG) and lag.lag_m == pytest.approx(0.001) and lag.sigma_m < 0.00012


def test_a_press_goes_on_until_the_ball_stops_or_the_bound_is_reached() -> None:
    free, held = Lag(lag_m=0.0, sigma_m=0.00008), Lag(lag_m=0.0008, sigma_m=0.00008)
    assert next_extension_m(0.030, 0.035, free, CONFIG) == pytest.approx(0.031)
    assert next_extension_m(0.030, 0.0305, free, CONFIG) == pytest.approx(0.0305)
    assert next_extension_m(0.030, 0.0301, free, CONFIG) is None
    assert next_extension_m(0.030, 0.035, held, CONFIG) is None
    touching = Lag(lag_m=0.0003, sigma_m=0.0001)
    assert next_extension_m(0.030, 0.035, touching, CONFIG) == pytest.approx(0.0307), "only what is missing"


@pytest.mark.parametrize(
    "lag_m, effect, switch, felt",
    [
        (0.0008, True, None, Felt.PRESSED),
        (0.0008, False, None, Felt.TOUCHED),
        (0.0, False, None, Felt.NOT_TOUCHED),
        (0.0, True, None, Felt.UNKNOWN),
        (0.00028, False, None, Felt.UNKNOWN),
        (None, False, None, Felt.UNKNOWN),
        (None, True, None, Felt.UNKNOWN),
        (None, True, True, Felt.PRESSED),
        (0.0, False, True, Felt.TOUCHED),
    ],
)
def test_what_is_known_of_a_touch(lag_m: float | None, effect: bool, switch: bool | None, felt: Felt) -> None:
    lag = None if lag_m is None else Lag(lag_m=lag_m, sigma_m=0.00005)
    found, evidence = verdict(lag, effect=effect, own_lamp=False, switch=switch, config=CONFIG)
    assert found is felt
    assert (Evidence.EFFECT in evidence) == effect and (Evidence.SWITCH in evidence) == bool(switch)


def test_a_stylus_that_was_bumped_is_reported_once_and_corrected() -> None:
    memory = HeightMemory(CONFIG)
    finding = memory.looked(0.0008, 0.00005)
    assert finding is not None and finding.code is HeightFindingCode.STYLUS_OFFSET
    assert finding.text() == "the stylus is 0.8 mm higher than its readings say"
    assert memory.stylus.value_m == pytest.approx(0.0008, abs=2e-5)
    assert memory.looked(0.00083, 0.00005) is None


def test_the_error_of_a_look_at_another_control_is_no_finding() -> None:
    """In room ``workshop`` looks above keys scatter by 0.154 mm: "the stylus is 0.4 mm higher" was reported at CH2."""
    rng = np.random.default_rng(SEED)
    config = replace(CONFIG, height=replace(CONFIG.height, look_sigma_m=0.00016))
    looks, findings = 50, 0
    for _ in range(40):
        memory = HeightMemory(config)
        offset_m = rng.normal(0.0, CONFIG.height.start_sigma_m)
        findings += sum(memory.looked(offset_m + rng.normal(0.0, 0.000154), 0.00005) is not None for _ in range(looks))
    print(f"seed {SEED}: {findings} findings in {40 * looks} looks")
    assert findings <= 0.005 * 40 * looks


def test_the_end_of_a_key_is_learnt_and_its_shift_is_a_finding() -> None:
    memory = HeightMemory(CONFIG)
    assert memory.travel_m("SAVE", True, CONFIG.key_travel_m) == CONFIG.key_travel_m
    assert memory.touched("SAVE", True, 0.0025, 0.00008) is None, "nothing was known of its stroke"
    assert memory.travel_m("SAVE", True, CONFIG.key_travel_m) == pytest.approx(0.0033, abs=1e-4)
    finding = memory.touched("SAVE", True, 0.0033, 0.00008)
    assert finding is not None and finding.text() == "the panel is 0.8 mm lower than measured"
    assert memory.travel_m("SAVE", True, CONFIG.key_travel_m) <= CONFIG.max_travel_m
