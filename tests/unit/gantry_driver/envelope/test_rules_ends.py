"""The limits of the space at the panel to the last digit, and each breach as text and as values."""

from __future__ import annotations

import dataclasses
import math

import pytest

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.envelope import rules
from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.core.envelope.rules import (
    ROUNDING_M,
    STRAIGHT_M,
    Breach,
    EnvelopeFault,
    Reading,
    breach_of,
    depth_limit_m,
)
from icu_common.core.goals.intent import Intent

CONFIG = DriverConfig()
LIMITS = CONFIG.envelope
SURE = (0.0,) * 9


def flat(extension_m: float) -> PanelPlane:
    return PanelPlane(at_m=(0.0, 0.0, extension_m), slope=(0.0, 0.0), covariance=SURE)


def code(*path: Reading, plane: PanelPlane | None, intent: Intent = Intent.PRESS) -> str:
    found = breach_of(path, plane, intent, CONFIG)
    return "" if found is None else found.code.value


def above(value: float) -> float:
    """Return the next larger number."""
    return math.nextafter(value, math.inf)


def test_the_margins_are_these() -> None:
    assert (rules.SIGMAS, rules.STRAIGHT_M, rules.ROUNDING_M) == (3.0, 0.0002, 5e-5)
    assert rules.SIDEWAYS == (Intent.TURN, Intent.DRAG)


def test_the_panel_is_crossed_up_to_the_crossing_height_and_a_motor_step() -> None:
    height = LIMITS.crossing_m + ROUNDING_M
    start = (0.0, 0.0, 0.0)
    assert code(start, (0.3, 0.0, height), plane=None) == ""
    assert code(start, (0.3, 0.0, above(height)), plane=None) == "sideways"
    assert code((0.0, 0.0, height), (0.3, 0.0, 0.0), plane=None) == ""
    assert code((0.0, 0.0, above(height)), (0.3, 0.0, 0.0), plane=None) == "sideways"


def test_a_stylus_that_is_too_deep_may_stay_or_rise_where_it_is_but_not_move_on() -> None:
    deep, plane = 0.05, flat(0.035)
    for depth in (deep, deep - 0.01):
        assert code((0.0, 0.0, deep), (STRAIGHT_M, 0.0, depth), plane=plane) == ""
        assert code((0.0, 0.0, deep), (above(STRAIGHT_M), 0.0, depth), plane=plane) == "too_deep"
    assert code((0.0, 0.0, deep), (0.0, 0.0, above(deep)), plane=plane) == "too_deep"


def test_the_free_space_ends_a_motor_step_below_its_limit() -> None:
    depth = LIMITS.free_space_m + ROUNDING_M
    assert code((0.0, 0.0, 0.0), (0.0, 0.0, depth), plane=None) == ""
    assert code((0.0, 0.0, 0.0), (0.0, 0.0, above(depth)), plane=None) == "no_panel"
    for begin, end, deeper in (((0.0, 0.0, 0.04), (0.0, 0.1, 0.02), 0), ((0.0, 0.1, 0.02), (0.0, 0.0, 0.04), 1)):
        found = breach_of([begin, end], None, Intent.PRESS, CONFIG)
        assert found is not None and found.place == (begin, end)[deeper] and found.measured == 0.04


def test_a_correction_ends_at_its_limit() -> None:
    height = LIMITS.crossing_m + 0.001
    for limit, expected in ((LIMITS.correction_m, ""), (above(LIMITS.correction_m), "sideways")):
        assert code((0.0, 0.0, height), (limit, 0.0, height), plane=None) == expected
        assert code((0.0, 0.0, height), (limit, 0.0, height), plane=flat(0.035)) == expected
    far = (0.05, 0.0, height)
    assert code((0.0, 0.0, height), far, plane=flat(0.035), intent=Intent.DRAG) == ""
    assert code((0.0, 0.0, height), far, plane=None, intent=Intent.DRAG) == "sideways"


def test_steps_count_from_where_the_stylus_was_extended_and_again_after_a_rise() -> None:
    height, half = LIMITS.crossing_m + 0.001, 0.6 * LIMITS.correction_m
    up, down = 0.0, height
    steps = [(0.0, 0.0, down), (half, 0.0, down), (2 * half, 0.0, down)]
    assert code(*steps, plane=flat(0.035)) == "sideways"
    lifted = [(0.0, 0.0, down), (half, 0.0, down), (half, 0.0, up), (0.2, 0.0, up), (0.2, 0.0, down)]
    assert code(*lifted, (0.2 + half, 0.0, down), plane=flat(0.035)) == ""


@pytest.mark.parametrize("intent", Intent)
def test_the_depth_ends_at_its_limit(intent: Intent) -> None:
    plane = flat(0.0)
    limit = depth_limit_m(plane, 0.0, 0.0, intent, CONFIG)
    assert limit == pytest.approx((0.0 if intent is Intent.MOVE else CONFIG.overtravel_m) + 5e-5, rel=1e-12)
    assert code((0.0, 0.0, 0.0), (0.0, 0.0, limit), plane=plane, intent=intent) == ""
    found = breach_of([(0.0, 0.0, 0.0), (0.0, 0.0, above(limit))], plane, intent, CONFIG)
    assert found is not None and found.code is EnvelopeFault.TOO_DEEP
    assert (found.measured, found.limit, found.place) == (above(limit), limit, (0.0, 0.0, above(limit)))


def test_a_leaning_plane_may_be_deeper_by_its_rise_over_a_correction() -> None:
    leaning = dataclasses.replace(flat(0.035), slope=(0.03, 0.04))
    assert depth_limit_m(leaning, 0.0, 0.0, Intent.MOVE, CONFIG) == pytest.approx(0.05 * 0.007 + 5e-5, rel=1e-12)


def test_sideways_motion_ends_at_its_height_above_the_panel() -> None:
    side = (0.3, 0.0, 0.0)
    assert code((0.0, 0.0, 0.0), side, plane=flat(LIMITS.side_height_m)) == ""
    found = breach_of([(0.0, 0.0, 0.0), side], flat(LIMITS.side_height_m - 1e-6), Intent.MOVE, CONFIG)
    assert found is not None and found.code is EnvelopeFault.TOO_LOW and found.place == (0.0, 0.0, 0.0)
    assert (found.measured, found.limit) == (pytest.approx(LIMITS.side_height_m - 1e-6), LIMITS.side_height_m)


def test_straight_down_near_the_panel_is_not_sideways() -> None:
    begin, plane = (0.0, 0.0, 0.031), flat(0.035)
    assert code(begin, (STRAIGHT_M, 0.0, 0.034), plane=plane) == ""
    assert code(begin, (above(STRAIGHT_M), 0.0, 0.034), plane=plane) == "too_low"
    assert code(begin, (0.003, 0.0, 0.034), plane=plane, intent=Intent.TURN) == ""


def test_the_lower_end_of_a_motion_near_the_panel_is_named() -> None:
    found = breach_of([(0.0, 0.0, 0.02), (0.003, 0.0, 0.033)], flat(0.035), Intent.PRESS, CONFIG)
    assert found is not None and found.place == (0.003, 0.0, 0.033)
    assert found.measured == pytest.approx(0.002)


def test_a_path_is_refused_for_its_first_breach_and_depth_before_the_rest() -> None:
    plane = flat(0.035)
    first = breach_of([(0.0, 0.0, 0.0), (0.0, 0.0, 0.04), (0.0, 0.0, 0.05)], plane, Intent.PRESS, CONFIG)
    assert first is not None and first.place == (0.0, 0.0, 0.04)
    begin = breach_of([(0.0, 0.0, 0.05), (0.05, 0.0, 0.04)], plane, Intent.PRESS, CONFIG)
    assert begin is not None and begin.code is EnvelopeFault.TOO_DEEP and begin.place == (0.0, 0.0, 0.05)


@pytest.mark.parametrize(
    ("fault", "text", "unit"),
    [
        ("no_panel", "the panel's plane is unknown: the stylus would extend 12.5 mm (limit 3.1 mm)", "m"),
        ("too_deep", "the path goes 12.5 mm beyond the panel (limit 3.1 mm)", "m"),
        ("too_low", "the path moves sideways 12.5 mm above the panel (limit 3.1 mm)", "m"),
        ("sideways", "the path moves 12.5 mm sideways with the stylus extended (limit 3.1 mm)", "m"),
        ("old_panel", "the panel's plane is 61.2 s old (limit 60.0 s)", "s"),
    ],
)
def test_a_breach_is_told_with_value_limit_and_place(fault: str, text: str, unit: str) -> None:
    measured, limit = (61.2, 60.0) if unit == "s" else (0.0125, 0.0031)
    breach = Breach(code=EnvelopeFault(fault), measured=measured, limit=limit, place=(0.1, 0.2, 0.03))
    assert breach.text() == text and f"{breach.code}" == fault
    values = ((f"measured_{unit}", f"{measured:.5f}"), (f"limit_{unit}", f"{limit:.5f}"))
    assert breach.details() == (*values, ("reading_m", "0.10000 0.20000 0.03000"))
    assert dataclasses.replace(breach, place=None).details() == values


def test_a_breach_of_a_metre_is_a_thousand_millimetres() -> None:
    breach = Breach(code=EnvelopeFault.SIDEWAYS, measured=1.0, limit=0.5)
    assert breach.text() == "the path moves 1000.0 mm sideways with the stylus extended (limit 500.0 mm)"


def test_a_breach_has_no_place_unless_it_is_given_and_cannot_change() -> None:
    breach = Breach(code=EnvelopeFault.TOO_LOW, measured=0.0, limit=0.0)
    assert breach.place is None
    with pytest.raises(dataclasses.FrozenInstanceError):
        breach.limit = 1.0  # type: ignore[misc]
