"""The stops, and the axes that are fitted to the tips seen there."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from gantry_driver.acceptance.axes_fit import AxesFit, fit_axes
from gantry_driver.acceptance.stops import BEYOND_M, beyond, plan_stops

LOW, HIGH = np.array([0.0, 0.0]), np.array([0.359, 0.219])


def seen_axes(axes: np.ndarray, lag: np.ndarray, noise_m: float = 0.0) -> AxesFit:
    stops = plan_stops(LOW, HIGH)
    readings = np.array([stop.reading for stop in stops])
    above = np.array([stop.from_above for stop in stops])
    tips = np.array([0.01, -0.02, 0.03]) + readings @ axes.T + above @ lag.T
    tips += np.random.default_rng(4).normal(0.0, noise_m, tips.shape) if noise_m else 0.0
    return fit_axes(stops, readings, tips)


def true_axes(scale: float = 1.0, skew_rad: float = 0.0, turn_rad: float = 0.0, tilt_rad: float = 0.0) -> np.ndarray:
    x = scale * np.array([math.cos(turn_rad), math.sin(turn_rad), 0.0])
    y = np.array([-math.sin(turn_rad + skew_rad), math.cos(turn_rad + skew_rad), math.sin(tilt_rad)])
    return np.column_stack([x, y])


def test_stops_are_the_corners_the_centre_and_pairs_at_both_lower_limits() -> None:
    stops = plan_stops(LOW, HIGH)
    corners = {tuple(stop.reading) for stop in stops if stop.corner}
    assert corners == {(0.0, 0.0), (0.359, 0.0), (0.0, 0.219), (0.359, 0.219)}
    assert len(stops) == 13
    for before, stop in itertools.pairwise(stops):  # an axis at its lower limit arrived from above, or has not moved
        for axis in (0, 1):
            assert stop.from_above[axis] == (stop.reading[axis] == 0.0)
            assert before.reading[axis] >= stop.reading[axis] or stop.reading[axis] > 0.0
    assert stops[0].reading == pytest.approx((0.1795, 0.1095)), "away from both limits"


def test_goals_beyond_leave_one_limit_each() -> None:
    outside = np.array(beyond(LOW, HIGH))
    past = np.maximum(LOW - outside, outside - HIGH)
    assert np.isclose(np.maximum(past, 0).sum(axis=1), BEYOND_M).all()
    assert ((past > 0).sum(axis=1) == 1).all()


def test_scale_squareness_direction_tilt_and_backlash_are_found_exactly_without_noise() -> None:
    lag = np.column_stack([[0.00015, 0.0, 0.0], [0.0, 0.00025, 0.0]])
    fit = seen_axes(true_axes(scale=1.004, skew_rad=0.003, turn_rad=math.radians(-1.2), tilt_rad=0.01), lag)
    assert fit.scale_error[0] == pytest.approx(0.004, abs=1e-9)
    assert fit.squareness_deg == pytest.approx(math.degrees(0.003), abs=1e-3)
    assert fit.direction_deg == pytest.approx([-1.2, -1.2 + math.degrees(0.003)], abs=1e-3)
    assert fit.tilt_deg == pytest.approx(math.degrees(0.01), abs=0.01)
    assert fit.backlash_m == pytest.approx([0.00015, 0.00025], abs=2e-6)
    assert fit.straightness_m < 1e-9


def test_a_reversed_axis_and_crossed_axes_show_in_the_direction() -> None:
    reversed_y = true_axes() @ np.diag([1.0, -1.0])
    assert abs(seen_axes(reversed_y, np.zeros((3, 2))).direction_deg[1]) == pytest.approx(180.0)
    crossed = true_axes()[:, ::-1]
    assert np.abs(seen_axes(crossed, np.zeros((3, 2))).direction_deg) == pytest.approx([90.0, 90.0])


def test_stated_deviations_are_those_of_the_noise() -> None:
    fit = seen_axes(true_axes(), np.zeros((3, 2)), noise_m=3e-5)
    assert fit.sigma_m == pytest.approx(3e-5, rel=0.5)
    assert (np.abs(fit.scale_error) < 4 * fit.axis_sigma).all()
    assert (np.abs(fit.backlash_m) < 4 * fit.lag_sigma_m).all()
    assert fit.panel_at(np.array([[0.1, 0.1]]))[0] == pytest.approx((0.11, 0.08), abs=1e-4)


def test_too_few_tips_are_reported_with_their_number() -> None:
    stops = plan_stops(LOW, HIGH)[:4]
    readings = np.array([stop.reading for stop in stops])
    with pytest.raises(ValueError, match="seen at 4 stops, more than 5"):
        fit_axes(stops, readings, np.zeros((4, 3)))
    with pytest.raises(ValueError, match="seen at 0 stops"):
        fit_axes([], np.zeros((0, 2)), np.zeros((0, 3)))
