"""Paths: order of the steps, approach side, speeds, limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gantry_driver.core.motion.motion_plan import (
    MotionConfig,
    OutOfReach,
    aside,
    check_reach,
    follow,
    lift,
    plunge,
    shift,
    travel,
)

CONFIG = MotionConfig(travel_speed_m_s=0.1, stylus_speed_m_s=0.02, touch_speed_m_s=0.01, turn_speed_m_s=0.005)


def test_travel_retracts_crosses_and_lowers() -> None:
    path = travel(np.array([0.1, 0.1, 0.02]), np.array([0.2, 0.15]), 0.03, CONFIG)
    np.testing.assert_allclose(
        path.points, [[0.1, 0.1, 0.0], [0.199, 0.149, 0.0], [0.2, 0.15, 0.0], [0.2, 0.15, 0.03]], atol=1e-12
    )
    across, last = np.hypot(0.099, 0.049) / 0.1, np.hypot(0.001, 0.001) / 0.1
    np.testing.assert_allclose(path.times_s, np.cumsum([1.0, across, last, 1.5]), atol=1e-9)
    assert path.duration_s == pytest.approx(2.5 + across + last)


def test_steps_that_do_not_move_are_left_out() -> None:
    path = travel(np.array([0.2, 0.15, 0.0]), np.array([0.2, 0.15]), 0.0, CONFIG)
    np.testing.assert_allclose(path.points, [[0.199, 0.149, 0.0], [0.2, 0.15, 0.0]], atol=1e-12)
    home = travel(np.zeros(3), np.zeros(2), 0.0, CONFIG)
    assert home.points.shape == (0, 3) and home.duration_s == 0.0


def test_shift_keeps_the_height() -> None:
    path = shift(np.array([0.1, 0.1, 0.02]), np.array([0.1004, 0.0999]), CONFIG)
    np.testing.assert_allclose(path.points, [[0.0994, 0.0989, 0.02], [0.1004, 0.0999, 0.02]], atol=1e-12)


@pytest.mark.parametrize(
    ("middle", "place"),
    [
        ((0.2, 0.1), (0.2, 0.14)),  # beyond, where the arm comes from
        ((0.2, 0.2), (0.24, 0.2)),  # no room there: to the outer side, away from the cameras over the middle
        ((0.1, 0.2), (0.06, 0.2)),
        ((0.34, 0.2), (0.3, 0.2)),  # no room there either
    ],
)
def test_aside_goes_where_the_stylus_hides_least(middle: tuple[float, float], place: tuple[float, float]) -> None:
    path = aside(np.array([*middle, 0.02]), np.array(middle), 0.04, CONFIG)
    np.testing.assert_allclose(path.points, [[*middle, 0.0], [*place, 0.0]], atol=1e-12)


def test_plunge_follow_and_lift() -> None:
    start = np.array([0.1, 0.1, 0.02])
    down = plunge(start, 0.03, CONFIG)
    np.testing.assert_allclose(down.points, [[0.1, 0.1, 0.027], [0.1, 0.1, 0.03]])
    np.testing.assert_allclose(down.times_s, [0.007 / CONFIG.stylus_speed_m_s, 0.007 / CONFIG.stylus_speed_m_s + 0.3])
    near = plunge(np.array([0.1, 0.1, 0.028]), 0.03, CONFIG)
    np.testing.assert_allclose(near.points, [[0.1, 0.1, 0.03]])
    np.testing.assert_allclose(lift(start, CONFIG).points, [[0.1, 0.1, 0.0]])
    arc = np.array([[0.1, 0.101, 0.02], [0.101, 0.101, 0.02]])
    path = follow(start, arc, 0.005, CONFIG)
    np.testing.assert_allclose(path.points, arc)
    np.testing.assert_allclose(path.times_s, [0.2, 0.4])


@pytest.mark.parametrize(
    ("point", "words"),
    [
        ((-0.001, 0.1, 0.0), "gantry_x_joint = -0.0010 m lies outside 0.0000 to 0.3590 m"),
        ((0.36, 0.1, 0.0), "gantry_x_joint = 0.3600 m lies outside 0.0000 to 0.3590 m"),
        ((0.1, -0.001, 0.0), "gantry_y_joint = -0.0010 m"),
        ((0.1, 0.2201, 0.0), "gantry_y_joint = 0.2201 m lies outside 0.0000 to 0.2190 m"),
        ((0.1, 0.1, -0.001), "stylus_joint = -0.0010 m"),
        ((0.1, 0.1, 0.06), "stylus_joint = 0.0600 m lies outside 0.0000 to 0.0590 m"),
        ((float("nan"), 0.1, 0.0), "gantry_x_joint = nan"),
    ],
)
def test_limits_name_value_and_bound(point: tuple[float, float, float], words: str) -> None:
    with pytest.raises(OutOfReach, match=words):
        check_reach(np.array([[0.1, 0.1, 0.01], point]), CONFIG)
    with pytest.raises(OutOfReach, match=words):
        travel(np.array([0.1, 0.1, 0.0]), np.array(point[:2]), point[2], CONFIG)


def test_a_reading_rounded_past_the_limit_is_no_obstacle_and_is_not_commanded() -> None:
    path = travel(np.array([-1.2e-5, 0.1, 0.01]), np.array([0.1, 0.1]), 0.0, CONFIG)
    np.testing.assert_allclose(path.points[0], [0.0, 0.1, 0.0], atol=0)


_X, _Y, _S = st.floats(0.0, 0.359), st.floats(0.0, 0.219), st.floats(0.0, 0.059)


@given(start=st.tuples(_X, _Y, _S), aim=st.tuples(_X, _Y), depth=_S, approach=st.floats(0.0, 0.005))
def test_every_travel_is_safe(
    start: tuple[float, float, float], aim: tuple[float, float], depth: float, approach: float
) -> None:
    config = replace(CONFIG, approach_m=approach)
    path = travel(np.array(start), np.array(aim), depth, config)
    points = np.vstack([start, path.points])
    # The end is reached, nothing leaves the limits, and x and y move only while the stylus is up.
    np.testing.assert_allclose(points[-1], [*aim, depth], atol=1e-6)
    check_reach(path.points, config)
    crossing = np.abs(np.diff(points[:, :2], axis=0)).max(axis=1, initial=0.0) > 1e-6
    assert points[:-1][crossing, 2].max(initial=0.0) <= 1e-6 and points[1:][crossing, 2].max(initial=0.0) <= 1e-6
    assert (np.diff(path.times_s, prepend=0.0) > 0).all()
    # The last way across is towards +x, +y, in each axis that has room for the approach.
    room = np.array(aim) >= approach
    if crossing.any() and approach > 2e-6:
        last = np.diff(points[:, :2], axis=0)[crossing][-1]
        assert (last[room] >= -1e-6).all()
