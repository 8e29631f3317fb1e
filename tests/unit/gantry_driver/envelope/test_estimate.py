"""The estimate of the panel's plane: which poses count, to the nanosecond, and what each adds to the covariance."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gantry_driver.core.contact.heights import HeightEstimate, HeightFindingCode
from gantry_driver.core.envelope.estimate import HELD_SIGMA_M, MOST_POSES, WINDOW_S, PlaneEstimate, plane_below
from gantry_driver.core.envelope.plane import PanelPlane
from icu_common.core.geometry.geometry import Transform

BALL_M, SIGMA_M = 0.002, 0.0001
SECOND = 10**9


def pose(depth_m: float = 0.035, lean: float = 0.0) -> Transform:
    """Return a panel's face at a depth below home, leaning about the machine's y."""
    turn = np.array([[math.cos(lean), 0.0, math.sin(lean)], [0.0, 1.0, 0.0], [-math.sin(lean), 0.0, math.cos(lean)]])
    return Transform(turn, np.array([0.02, 0.03, -depth_m]))


def taken(*poses: tuple[int, Transform]) -> PlaneEstimate:
    estimate = PlaneEstimate()
    for stamp_ns, one in poses:
        estimate.take(one, stamp_ns)
    return estimate


def plane(estimate: PlaneEstimate, middle: tuple[float, float] = (0.16, 0.07)) -> PanelPlane | None:
    return estimate.plane(np.eye(2), np.array(middle), BALL_M, SIGMA_M)


def extension_m(estimate: PlaneEstimate) -> float:
    found = plane(estimate)
    assert found is not None
    return found.at_m[2] + BALL_M


def test_two_poses_are_needed_and_ten_are_kept() -> None:
    assert (MOST_POSES, WINDOW_S, HELD_SIGMA_M) == (10, 8.0, 0.00015)
    assert plane(taken((1, pose()))) is None and plane(taken((1, pose()), (2, pose()))) is not None
    rest = [(stamp, pose(0.035)) for stamp in range(2, 12)]
    assert extension_m(taken((1, pose(0.045)), *rest[:9])) == pytest.approx(0.036), "one of ten"
    assert extension_m(taken((1, pose(0.045)), *rest)) == pytest.approx(0.035), "the eleventh pushes it out"


def test_a_pose_counts_until_it_is_older_than_the_window() -> None:
    first, second = (SECOND, pose(0.045)), (2 * SECOND, pose(0.035))
    assert extension_m(taken(first, second, (9 * SECOND, pose(0.035)))) == pytest.approx(0.035 + 0.01 / 3)
    assert extension_m(taken(first, second, (9 * SECOND + 1, pose(0.035)))) == pytest.approx(0.035)


def test_a_pose_that_is_not_newer_than_the_last_is_ignored() -> None:
    for stamp_ns in (1, 2, 3):
        assert extension_m(taken((1, pose()), (3, pose()), (stamp_ns, pose(0.065)))) == pytest.approx(0.035)
    assert extension_m(taken((1, pose()), (3, pose()), (4, pose(0.065)))) == pytest.approx(0.045)


def test_the_stamp_is_that_of_the_newest_pose_and_nothing_is_left_of_poses_in_doubt() -> None:
    estimate = taken((5, pose(0.045)), (7, pose(0.045)))
    assert estimate.stamp_ns == 7
    estimate.take(pose(0.045), 9)
    assert estimate.stamp_ns == 9
    estimate.forget()
    assert estimate.stamp_ns == 0 and plane(estimate) is None
    estimate.take(pose(), 6)
    estimate.take(pose(), 8)
    assert extension_m(estimate) == pytest.approx(0.035)


def test_a_plane_is_told_at_the_middle_of_the_face() -> None:
    leaning = pose(lean=0.1)
    found = plane(taken((1, leaning), (2, leaning)))
    assert found is not None
    x, y, z = leaning.apply(np.array([0.16, 0.07, 0.0]))
    assert found.at_m == pytest.approx((x, y, -z - BALL_M), abs=1e-12)
    assert found.slope == pytest.approx((math.tan(0.1), 0.0), abs=1e-12)


def test_a_plane_that_leans_along_both_axes_passes_through_the_middle_of_the_face() -> None:
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(0.2), -math.sin(0.2)], [0.0, math.sin(0.2), math.cos(0.2)]])
    leaning = Transform(pose(lean=0.1).rotation @ tilt, pose().translation)
    found = plane(taken((1, leaning), (2, leaning)))
    assert found is not None
    x, y, z = leaning.apply(np.array([0.16, 0.07, 0.0]))
    assert found.at_m == pytest.approx((x, y, -z - BALL_M), abs=1e-12)
    nx, ny, nz = leaning.rotation[:, 2]
    assert found.slope == pytest.approx((nx / nz, ny / nz), abs=1e-12)


def test_poses_that_do_not_scatter_are_as_sure_as_recognition_and_calibration() -> None:
    found = plane(taken((1, pose()), (2, pose())))
    assert found is not None
    assert found.covariance == pytest.approx((0.00015**2 + 0.0001**2, *(0.0,) * 8), rel=1e-12, abs=1e-18)


PLANE = PanelPlane(at_m=(0.1, 0.2, 0.03), slope=(0.1, 0.2), covariance=(4e-8, 1e-9, 0, 1e-9, 1e-6, 0, 0, 0, 1e-6))


def stylus(*, measured: bool) -> HeightEstimate:
    code = HeightFindingCode.STYLUS_OFFSET
    return HeightEstimate(code=code, value_m=0.0005, sigma_m=0.0003, drift_m=0.0, measured=measured)


def test_the_plane_of_a_stylus_that_touches_later_lies_deeper_and_is_less_sure() -> None:
    found = plane_below(PLANE, stylus(measured=True))
    assert found.at_m == pytest.approx((0.1, 0.2, 0.0305)) and found.slope == PLANE.slope
    assert found.covariance == pytest.approx((4e-8 + 9e-8, *PLANE.covariance[1:]))


def test_the_plane_of_a_stylus_that_no_look_has_measured_stays() -> None:
    assert plane_below(PLANE, stylus(measured=False)) is PLANE
