"""Data from the controller to the driver: the panel's plane, and the purpose of each trajectory."""

from __future__ import annotations

import math

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import BASE_FROM_PANEL, CAMERA_FROM_BASE, Bench

from gantry_driver.core.envelope.estimate import HELD_SIGMA_M, PlaneEstimate
from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.goal_job import GoalPhase
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.intent import Intent
from icu_common.core.goals.results import Outcome

BALL_M, SIGMA_M = 0.002, 0.0001


def planes(bench: Bench) -> list[tuple[int, PanelPlane]]:
    return [(a.stamp_ns, a.plane) for a in bench.actions if isinstance(a, msg.ReportPlane)]


def intents(bench: Bench) -> list[str]:
    return [a.intent.value for a in bench.actions if isinstance(a, msg.SendTrajectory)]


def calibrated() -> Bench:
    bench = Bench().start()
    bench.tell(msg.CalibrationSigma(value_m=SIGMA_M))
    return bench


def test_the_plane_is_told_once_a_second_while_the_machine_rests() -> None:
    bench = calibrated()
    bench.run(3.5)
    told = planes(bench)
    assert 3 <= len(told) <= 4
    assert all(0 <= bench.now_ns - stamp < 3.6e9 for stamp, _ in told)
    for x, y in ((0.0, 0.0), (0.3, 0.2)):
        surface = BASE_FROM_PANEL.apply([*BASE_FROM_PANEL.inverse().apply([x, y, 0.0])[:2], 0.0])
        assert told[-1][1].contact_m(x, y) == pytest.approx(-surface[2] - BALL_M, abs=2e-4)
    assert told[-1][1].sigma_m(*told[-1][1].at_m[:2]) == pytest.approx(math.hypot(SIGMA_M, HELD_SIGMA_M), abs=1e-6)


def test_no_plane_without_the_calibrations_error_nor_after_a_second_source_nor_with_an_alarm() -> None:
    bench = Bench().start()
    bench.run(3.0)
    assert planes(bench) == []
    bench.tell(msg.CalibrationSigma(value_m=SIGMA_M))
    bench.tell(msg.PanelAlarm(text="the markers contradict the print"))
    bench.run(3.0)
    assert planes(bench) == []
    bench.tell(msg.PanelAlarm(text=""))
    bench.tell(msg.Rivals(topic="panel/pose", text="two programs publish panel/pose: /a and /b"))
    bench.run(3.0)
    assert planes(bench) == []
    for value in (math.nan, -1.0, math.inf):
        with pytest.raises(ValueError, match="standard deviation"):
            msg.CalibrationSigma(value_m=value)


def test_no_plane_is_told_while_the_stylus_is_extended_or_the_machine_moves() -> None:
    bench = calibrated()
    bench.run(1.5)
    before = len(planes(bench))
    assert before >= 1
    extended: list[int] = []
    tell = bench.tell

    def watched(event: msg.Event) -> None:
        count = len(planes(bench))
        tell(event)
        if len(planes(bench)) > count:
            extended.append(round(1e6 * bench.readings[2]))

    bench.tell = watched  # type: ignore[method-assign]
    assert bench.do("hold:RUN_STOP:3").outcome is Outcome.REACHED
    bench.run(2.0)
    assert len(planes(bench)) > before and set(extended) == {0}


def test_a_goal_right_after_the_calibration_waits_until_the_driver_has_the_plane() -> None:
    """Without the plane the driver would reject its way down."""
    bench = calibrated()
    assert planes(bench) == [] and bench.controller.state == "waiting: the measurement of the panel's plane is running"
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
    first = next(i for i, action in enumerate(bench.actions) if isinstance(action, msg.ReportPlane))
    assert not any(isinstance(action, msg.SendTrajectory) for action in bench.actions[:first])


def test_a_driver_that_was_gone_gets_the_plane_again_before_a_goal_begins() -> None:
    bench = calibrated()
    bench.run(2.0)
    assert planes(bench) and bench.controller.state == "ready"
    bench.tell(msg.DriverState(text="disconnected: the guard has ended"))
    bench.tell(msg.DriverState(text="idle"))
    assert bench.controller.state == "waiting: the measurement of the panel's plane is running"
    count = len(planes(bench))
    bench.run(1.0)
    assert len(planes(bench)) > count and bench.controller.state == "ready"


def test_goal_after_goal_the_plane_stays_young() -> None:
    """Each goal ends as soon as its effect is seen, and the next one begins at once."""
    bench = calibrated()
    bench.run(1.5)
    oldest_s = 0.0
    for _ in range(8):
        assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED
        oldest_s = max(oldest_s, (bench.now_ns - planes(bench)[-1][0]) / 1e9)
    assert oldest_s < 15.0


@pytest.mark.parametrize(
    ("command", "contact"),
    [("press:RUN_STOP", ["press"]), ("double:RUN_STOP", ["press"]), ("turn:CH1_SCALE:30", ["press", "turn"])],
)
def test_each_trajectory_says_what_it_is_for(command: str, contact: list[str]) -> None:
    bench = calibrated()
    bench.do(command)
    told = intents(bench)
    first = told.index("press")
    assert told[first : first + len(contact)] == contact
    assert set(told[:first] + told[first + len(contact) :]) == {"move"} and first >= 1


def test_a_drag_says_that_it_is_one() -> None:
    bench = calibrated()
    bench.do("drag:0.05,0.06@panel_link:0.12,0.06@panel_link")
    assert [text for text in intents(bench) if text != "move"] == ["press", "drag"]


def test_a_lift_after_a_fault_is_a_move() -> None:
    bench = calibrated()
    bench.on_phase[GoalPhase.CONTACT] = lambda b: b.talking.discard("heartbeat")
    bench.do("hold:RUN_STOP:5")
    assert intents(bench)[-1] == Intent.MOVE


def leaning(pitch: float, roll: float, z: float) -> Transform:
    turn_x = np.array([[1, 0, 0], [0, math.cos(pitch), -math.sin(pitch)], [0, math.sin(pitch), math.cos(pitch)]])
    turn_y = np.array([[math.cos(roll), 0, math.sin(roll)], [0, 1, 0], [-math.sin(roll), 0, math.cos(roll)]])
    return Transform(turn_x @ turn_y, np.array([0.02, 0.03, z]))


def test_a_leaning_panel_is_told_in_readings_of_skewed_axes() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        pose = leaning(*rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.05, -0.03))
        axes = np.eye(2) + rng.uniform(-0.01, 0.01, (2, 2))
        estimate = PlaneEstimate()
        for stamp in range(1, 4):
            estimate.take(pose, stamp)
        plane = estimate.plane(axes, np.array([0.16, 0.07]), BALL_M, SIGMA_M)
        assert plane is not None
        for place in rng.uniform(0.0, 0.3, (5, 2)):
            on_face = pose.apply([*place, 0.0])
            reading = np.linalg.solve(axes, on_face[:2])
            assert plane.contact_m(*reading) == pytest.approx(-on_face[2] - BALL_M, abs=1e-9)


def test_the_scatter_of_poses_is_the_planes_covariance() -> None:
    rng, estimate = np.random.default_rng(6), PlaneEstimate()
    sigma_m, sigma_rad = 0.0003, 0.001
    found = []
    for run in range(200):
        estimate.forget()
        for number in range(10):
            pose = leaning(*(sigma_rad * rng.standard_normal(2)), -0.035 + sigma_m * rng.standard_normal())
            estimate.take(pose, 10**9 * (1 + run) + number)
        plane = estimate.plane(np.eye(2), np.zeros(2), BALL_M, 0.0)
        assert plane is not None
        found.append([plane.sigma_m(*plane.at_m[:2]), plane.sigma_m(plane.at_m[0] + 1.0, plane.at_m[1])])
    near, far = np.mean(np.square(found), axis=0)
    assert near == pytest.approx(sigma_m**2 + HELD_SIGMA_M**2, rel=0.1)
    assert far == pytest.approx(near + sigma_rad**2, rel=0.15)


def test_one_pose_and_poses_of_long_ago_are_no_plane() -> None:
    estimate = PlaneEstimate()
    assert estimate.plane(np.eye(2), np.zeros(2), BALL_M, 0.0) is None and estimate.stamp_ns == 0
    pose = CAMERA_FROM_BASE.inverse() @ CAMERA_FROM_BASE
    estimate.take(pose, 10**9)
    estimate.take(pose, 10**9)
    assert estimate.plane(np.eye(2), np.zeros(2), BALL_M, 0.0) is None
    estimate.take(pose, 10 * 10**9)
    assert estimate.plane(np.eye(2), np.zeros(2), BALL_M, 0.0) is None, "the first is too old"
    estimate.take(pose, 11 * 10**9)
    assert estimate.plane(np.eye(2), np.zeros(2), BALL_M, 0.0) is not None
