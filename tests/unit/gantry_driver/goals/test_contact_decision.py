"""A contact whose images scatter: more of them are taken until they decide, up to a bound in time."""

from __future__ import annotations

import pytest
from unit.gantry_driver.controller_bench import Bench, config

from gantry_driver.core.contact.config import ContactConfig
from gantry_driver.core.job.goal_job import Phase
from gantry_driver.core.motion.targets import TouchConfig
from icu_common.core.goals.results import Felt, GoalResult, Outcome

SEED = 5
POINT = "press:0.28,0.02@panel_link"
TRAVEL_M = 0.0005
"""Travel of the press, beyond which the driver allows none."""


def pressed(noise_m: float, **changes: float) -> tuple[GoalResult, float]:
    """Press the bare face, with noise of the seen height; return the answer and the contact's duration in s."""
    touch = TouchConfig(overtravel_m=TRAVEL_M)
    contact = ContactConfig(key_travel_m=TRAVEL_M, max_travel_m=TRAVEL_M)
    bench = Bench(config(touch=touch, contact=contact, **changes), seed=SEED).start()
    bench.noise_m[2] = noise_m
    times: dict[Phase, int] = {}
    bench.on_phase[Phase.CONTACT] = lambda b: times.update({Phase.CONTACT: b.now_ns})
    bench.on_phase[Phase.LIFT] = lambda b: times.update({Phase.LIFT: b.now_ns})
    return bench.do(POINT), (times[Phase.LIFT] - times[Phase.CONTACT]) / 1e9


def test_a_contact_that_is_clear_is_not_longer() -> None:
    result, contact_s = pressed(0.00002)
    assert result.outcome is Outcome.REACHED and contact_s == pytest.approx(0.3, abs=0.1)


def test_more_images_decide_a_contact_that_scatters() -> None:
    """Before, such touches of the face were answered with contact_unknown: 3 of 72 in room workshop."""
    unknown, _ = pressed(0.00024, decide_max_s=0.0)
    assert unknown.outcome is Outcome.ABORTED and unknown.code == "contact_unknown"
    result, contact_s = pressed(0.00024)
    assert result.outcome is Outcome.REACHED and result.touch is Felt.TOUCHED, result
    assert 0.35 < contact_s <= 1.1


def test_what_stays_undecided_ends_in_time_and_is_not_claimed() -> None:
    result, contact_s = pressed(0.0012)
    assert result.outcome is Outcome.ABORTED and result.touch in (Felt.UNKNOWN, Felt.NOT_TOUCHED), result
    assert contact_s <= 1.1
