"""The calibration procedure, driven by a machine in a few lines that has backlash, scale, skew and a tilted stylus."""

from __future__ import annotations

import itertools
import re
from typing import Any

import cv2
import numpy as np
import pytest
from unit.harris_perception.rectified_pair import AXES, POSE
from unit.harris_perception.rectified_pair import PAIR as CAMERAS

from harris_perception.core.alignment.pair_rotation import turned_right
from harris_perception.core.hand_eye.carriage_camera import PanelSample
from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Sample
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig, check_plan, corners, plan
from harris_perception.core.hand_eye_procedure.calibration_run import (
    Action,
    CalibrationRun,
    Progress,
    SendCalibrationGoal,
)
from harris_perception.core.hand_eye_procedure.calibration_solution import CalibrationFailed, CalibrationFinished
from harris_perception.core.hand_eye_procedure.calibration_tour import Purpose
from harris_perception.core.hand_eye_procedure.still_watch import StillConfig, StillWatch
from harris_perception.core.pose.planar_pose import FacePoints
from icu_common.core.configuration.config import ConfigError
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import GoalResult, Outcome


def run_config(**changes: Any) -> RunConfig:
    """Return a configuration with six positions, which are enough for these tests."""
    return RunConfig(**{"places": 6, **changes})


MS = 1_000_000


class Machine:
    """Answers goals and shows the tip; ``fault(machine, stop number)`` may spoil things."""

    def __init__(self, run: CalibrationRun, seed: int, fault: Any = None) -> None:
        self.run, self.rng, self.fault = run, np.random.default_rng(seed), fault
        self.now = 10_000 * MS
        self.reading, self.true = np.zeros(3), np.zeros(3)
        self.lag, self.slip = np.zeros(2), np.zeros(3)
        self.stylus_scale = 1.0
        self.goals: list[tuple[float, float, float]] = []
        self.progress: list[Progress] = []
        self.end: CalibrationFinished | CalibrationFailed | None = None
        self.silent = self.blind = self.dark = self.lost = False
        self.outcome, self.code = Outcome.REACHED, ""
        self.images: list[tuple[int, Any]] = []
        self.seen_as: Any = lambda tip: tip

    def act(self, actions: list[Action]) -> None:
        for action in actions:
            if isinstance(action, SendCalibrationGoal):
                self.goals.append(action.xyz)
                self.go(action)
            elif isinstance(action, Progress):
                self.progress.append(action)
            else:
                self.end = action

    def go(self, goal: SendCalibrationGoal) -> None:
        if self.fault is not None:
            self.fault(self, len(self.goals))
        if self.silent:
            return
        target = np.array([goal.xyz[0], goal.xyz[1], -goal.xyz[2]])
        # The controller comes from the lower left by way of a point 1 mm before, where there is room for one.
        before = np.maximum(target[:2] - 0.001, 0.0)
        moved = np.where(before < target[:2], 1.0, np.sign(target[:2] - self.reading[:2]))
        self.reading = np.round(target * 80e3) / 80e3
        # Backlash of 0.2 mm: the carriage lags behind the motor by which way it came.
        self.lag = np.where(moved != 0, 0.0001 * moved, self.lag)
        self.true = np.array([*(self.reading[:2] - self.lag), self.stylus_scale * self.reading[2]]) - self.slip

        def answer(outcome: Outcome, reason: str = "") -> None:
            code = self.code if outcome is self.outcome else ""
            result = GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=outcome, reason=reason, code=code)
            self.act(self.run.result(result, self.now))

        if self.outcome is Outcome.REJECTED:
            answer(self.outcome, "stale: the stamp is 0.527 s old (limit 0.5 s)")
            return
        answer(Outcome.ACCEPTED)
        self.now += 800 * MS
        self.run.reading(self.now, self.reading)
        if self.outcome is not Outcome.ACCEPTED:
            answer(self.outcome, "" if self.outcome is Outcome.REACHED else "hit the wall")

    def spin(self, seconds: float) -> None:
        """15 images and 10 readings a second until the run is over; the tracker needs 33 ms for an image."""
        for step in range(int(seconds * 30)):
            self.now += 33 * MS
            if self.end is not None:
                return
            if step % 3 == 0:
                self.run.reading(self.now, self.reading)
            shown, self.images = self.images, []
            for stamp, tip in [] if self.lost else shown:
                self.act(self.run.tip(stamp, tip, self.now))
            if step % 2 == 0 and not self.dark and self.end is None:
                base = np.array([*(AXES @ self.true[:2]), 0.0]) + self.true[2] * np.array([0.001, -0.0015, -1.0])
                noise = self.rng.normal(0, (0.00004, 0.00004, 0.0002))
                self.images.append((self.now, None if self.blind else self.seen_as(POSE.apply(base) + noise)))
                self.act(self.run.image(self.now, self.now))
            self.act(self.run.tick(self.now))


def machine(
    seed: int = 1, fault: Any = None, face: Transform | None = None, seen_as: Any = None, **config: Any
) -> Machine:
    # The tip is seen worse than a real one: the first solution is to be good enough where nothing else is asked for.
    settings = run_config(**{"enough_m": 0.001, **config})
    run = CalibrationRun(settings, StillConfig(), HandEyeConfig(), CAMERAS, 10_000 * MS)
    run.keep_clear_of(face, 0.017)
    rig = Machine(run, seed, fault)
    rig.seen_as = seen_as or rig.seen_as
    rig.act(run.start(rig.now))
    rig.spin(1500.0)
    return rig


def test_run_finds_the_hidden_axes_and_checks_itself() -> None:
    rig = machine()
    assert isinstance(rig.end, CalibrationFinished), rig.end
    result = rig.end.calibration
    np.testing.assert_allclose(result.base_from_reading, AXES, atol=0.0004)
    np.testing.assert_allclose(result.stylus_direction, (0.001, -0.0015, -1.0), atol=0.012)
    query = np.array([(0.05, 0.05, 0.03), (0.3, 0.15, 0.03), (0.18, 0.1, 0.0)])
    seen = POSE.apply(np.column_stack([(query[:, :2] - 0.0001) @ AXES.T, -query[:, 2]]))
    error = np.linalg.norm(result.tip_in_camera(query) - seen, axis=1)
    print("aim error mm", error * 1e3, "held out mm", rig.end.held_out_m * 1e3)
    assert error.max() < 0.0003
    for backlash in rig.end.backlash:
        assert backlash is not None
        print("backlash", backlash.text())
        assert backlash.places == 2
        assert abs(backlash.play_m - 0.0002) < 4 * backlash.sigma_m
        assert 0.00001 < backlash.sigma_m < 0.0001
    assert len(rig.end.held_out_m) == 4
    assert rig.end.held_out_m.max() < 0.0004
    totals = [p.total for p in rig.progress]
    assert totals[0] == 24 and totals == sorted(totals)
    assert rig.progress[-1].done == rig.progress[-1].total


TURN_RAD = np.array([0.0002, 0.0005, -0.0003])


def uncorrected(tip: np.ndarray) -> np.ndarray:
    """Return a tip (3,) m by the calibration files alone, of a right camera that has turned by ``TURN_RAD``."""
    true = turned_right(CAMERAS, TURN_RAD)
    left, right = CAMERAS.left.project(tip), true.project_right(tip)
    return CAMERAS.triangulate(CAMERAS.left.rectify(left), CAMERAS.right.rectify(right))[0]


def test_a_correction_of_the_right_camera_that_begins_during_the_run_spoils_no_sample() -> None:
    """Before, samples before and after it were mixed, which were 1 to 2 mm apart."""

    def run(corrected_from: int) -> Machine:
        def begins(rig: Machine, number: int) -> None:
            if number == corrected_from:
                rig.seen_as = lambda tip: tip
                rig.run.pair(rig.now, TURN_RAD)

        return machine(fault=begins, seen_as=uncorrected)

    off_m = np.linalg.norm(uncorrected(POSE.translation) - POSE.translation)
    print(f"{1e3 * off_m:.2f} mm off without the correction")
    assert off_m > 0.001
    late, early = run(17), run(1)
    for rig in (late, early):
        assert isinstance(rig.end, CalibrationFinished), rig.end
        print("held out mm", rig.end.held_out_m * 1e3)
        assert rig.end.held_out_m.max() < 0.0004
    assert isinstance(late.end, CalibrationFinished) and isinstance(early.end, CalibrationFinished)
    query = np.array([(0.05, 0.05, 0.03), (0.3, 0.15, 0.03)])
    np.testing.assert_allclose(
        late.end.calibration.tip_in_camera(query), early.end.calibration.tip_in_camera(query), atol=2e-5
    )


def test_held_out_positions_may_be_as_uncertain_as_all_others() -> None:
    """An ordinary webcam measures single positions 0.4 mm off; 0.92 mm were measured at the limit of 1 mm."""

    def place_error(tip: np.ndarray) -> np.ndarray:
        # The background of the ball: the same at one position, another one 20 mm away.
        rng = np.random.default_rng(int(abs(np.round(tip / 0.004)) @ (1, 100, 10_000)))
        return tip * (1.0 + rng.normal(0.0, 0.00055))

    rigs = [machine(seed, seen_as=place_error, places=8, max_held_out_m=0.0006) for seed in range(1, 5)]
    for rig in rigs:
        assert isinstance(rig.end, CalibrationFinished), rig.end
        print("held out mm", 1e3 * rig.end.held_out_m, "rms mm", 1e3 * rig.end.calibration.fit.rms_m)
    assert max(float(rig.end.held_out_m.max()) for rig in rigs if isinstance(rig.end, CalibrationFinished)) > 0.0006


def test_progress_forecasts_the_seconds_that_are_left() -> None:
    rig = machine()
    assert isinstance(rig.end, CalibrationFinished), rig.end
    first, last = rig.progress[0], rig.progress[-1]
    assert (first.done, last.remaining_s) == (0, 0.0) and 15.0 < first.remaining_s < 30.0
    # This machine is slower than the forecast's: its pace counts after three stops.
    took_s = (rig.now - 10_000 * MS) * 1e-9
    half = next(p for p in rig.progress if p.done >= 12)
    print("took", took_s, "s; forecast", first.remaining_s, "s, in the middle", half.remaining_s, "s")
    assert abs(half.remaining_s - took_s / 2) < 0.2 * took_s


def test_positions_are_chosen_for_what_they_tell_and_lie_inside_the_limits() -> None:
    stops = plan(run_config())
    fit = np.array([(s.x, s.y, s.z) for s in stops if s.purpose is Purpose.FIT])
    assert len(fit) == 12, "six positions, two heights"
    np.testing.assert_allclose(fit.min(axis=0), (0.03, 0.03, -0.016))
    np.testing.assert_allclose(fit.max(axis=0), (0.33, 0.18, 0.0))
    corners = {(0.03, 0.03), (0.33, 0.03), (0.03, 0.18), (0.33, 0.18)}
    assert corners <= {(round(x, 9), round(y, 9)) for x, y, _ in fit}, "far apart, slopes show best"
    checks = [(s.x, s.y) for s in stops if s.purpose is Purpose.CHECK]
    assert len(set(checks)) == 4
    assert not set(checks) & {(x, y) for x, y, _ in fit}
    assert stops[-1].purpose is Purpose.CHECK and stops[-1].z == 0.0, "a drive that slips late is noticed, too"
    # Each position is looked at from above before the stylus is lowered there.
    for before, stop in itertools.pairwise(stops):
        if stop.purpose is Purpose.FIT and stop.z < 0.0:
            assert before[:3] == (stop.x, stop.y, 0.0)


def test_the_order_of_the_positions_is_short() -> None:
    stops = plan(run_config())
    way = sum(np.hypot(b.x - a.x, b.y - a.y) for a, b in itertools.pairwise(stops))
    print(f"{way * 1e3:.0f} mm")
    assert way < 1.3, "once round an area of 300 by 150 mm are 0.9 m"


def test_positions_follow_one_by_one_while_the_predicted_error_is_too_large() -> None:
    every = machine(enough_m=0.0)
    assert isinstance(every.end, CalibrationFinished), every.end
    fit = {goal[:2] for goal in every.goals if min(goal[:2]) > 0.02}
    grid = {(x, y) for x in np.linspace(0.03, 0.33, 4).tolist() for y in np.linspace(0.03, 0.18, 3).tolist()}
    assert grid <= fit, "all of the grid, and no more after that"
    assert (every.progress[-1].done, every.progress[-1].total) == (36, 36)
    least_m = every.end.calibration.own_sigma_m(corners(run_config()))
    some = machine(enough_m=1.15 * least_m)
    assert isinstance(some.end, CalibrationFinished)
    print(f"{1e3 * least_m:.4f} mm after 36, 1.15 times it after {some.progress[-1].done}")
    assert 24 < some.progress[-1].done < 36
    assert some.end.calibration.own_sigma_m(corners(run_config())) < 1.2 * least_m
    assert machine(enough_m=2 * least_m).progress[-1].done == 24


def test_positions_that_gain_little_are_not_visited() -> None:
    """Ordinary webcams measure the tip three to five times worse: four further positions cost 9.5 s for 16 %."""
    every = machine(enough_m=0.0)
    assert isinstance(every.end, CalibrationFinished)
    least_m = every.end.calibration.own_sigma_m(corners(run_config()))
    unreachable_m = 0.3 * least_m
    assert machine(enough_m=unreachable_m, places=8).progress[-1].done == 28
    assert machine(enough_m=unreachable_m, places=8, least_gain=0.01).progress[-1].done == 36
    few = machine(enough_m=unreachable_m, places=3)
    print("from three positions:", few.progress[-1].done)
    assert few.progress[-1].done > 18, "few samples gain much by more"


def test_the_machine_moves_on_while_the_last_images_are_evaluated() -> None:
    rig = machine()
    assert isinstance(rig.end, CalibrationFinished)
    waiting = machine(fault=lambda rig, number: setattr(rig.run, "image", lambda stamp_ns, now_ns: []))
    assert isinstance(waiting.end, CalibrationFinished)
    saved_s = (waiting.now - rig.now) * 1e-9
    print("saved", saved_s, "s")
    assert saved_s > 24 * 0.03
    assert len(waiting.goals) == len(rig.goals)
    np.testing.assert_allclose(
        rig.end.calibration.base_from_reading, waiting.end.calibration.base_from_reading, atol=6e-4
    )


def test_cameras_on_the_carriage_see_the_tip_at_each_height_in_turn() -> None:
    riding = plan(run_config(mounting="carriage", places=12))
    heights = {(round(s.x, 3), round(s.y, 3)): s.z for s in riding if s.purpose is Purpose.FIT}
    assert len(heights) == sum(s.purpose is Purpose.FIT for s in riding) == 12
    assert [heights[x, 0.03] for x in (0.03, 0.13, 0.23, 0.33)] == [0.0, -0.016, 0.0, -0.016]
    assert [heights[x, 0.105] for x in (0.03, 0.13, 0.23, 0.33)] == [-0.016, 0.0, -0.016, 0.0]


def test_cameras_on_the_carriage_that_do_not_see_the_tip_have_no_use_for_a_way_down() -> None:
    above = plan(run_config(mounting="carriage"), see_tip=False)
    assert {s.z for s in above} == {0.0}
    assert sum(s.purpose is Purpose.FIT for s in above) == 6


def test_backlash_is_told_by_neighbours_entered_from_both_sides() -> None:
    stops = plan(run_config())
    for axis, below, above in (("x", Purpose.X_BELOW, Purpose.X_ABOVE), ("y", Purpose.Y_BELOW, Purpose.Y_ABOVE)):
        pairs = [(a, b) for a, b in itertools.pairwise(stops) if (a.purpose, b.purpose) == (below, above)]
        assert len(pairs) == 2
        for a, b in pairs:
            assert (getattr(a, axis), getattr(b, axis)) == (0.006, 0.0)


def silent(rig: Machine, number: int) -> None:
    rig.silent = number >= 5


def never_there(rig: Machine, number: int) -> None:
    rig.outcome = Outcome.ACCEPTED if number == 4 else Outcome.REACHED


def aborts(rig: Machine, number: int) -> None:
    rig.outcome = Outcome.ABORTED if number == 3 else Outcome.REACHED


def blind_for_good(rig: Machine, number: int) -> None:
    rig.blind = number > 2


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (silent, r"the goal was not answered within 48 s"),
        (never_there, r"the goal was not reached within 60 s"),
        (aborts, r"the goal x = 6, y = 80, z = 0 mm was aborted: hit the wall"),
        (blind_for_good, r"7 of 24 positions gave no sample; last: the cameras saw the tip 0 of 3 times while"),
    ],
)
def test_every_wait_ends_with_its_reason(fault: Any, reason: str) -> None:
    rig = machine(fault=fault)
    assert isinstance(rig.end, CalibrationFailed)
    assert re.match(reason, rig.end.reason), rig.end.reason
    goals = len(rig.goals)
    rig.end = None
    rig.spin(60.0)
    assert (len(rig.goals), rig.end) == (goals, None)


def face_below(distance_m: float) -> Transform:
    """Return where the cameras see a panel that lies so far below the homed tip."""
    return POSE @ Transform(np.eye(3), np.array([0.02, 0.025, -distance_m]))


@pytest.mark.parametrize("distance_m", [0.010, 0.018, 0.025])
def test_a_panel_that_is_too_near_is_not_touched_by_the_calibration(distance_m: float) -> None:
    rig = machine(face=face_below(distance_m))
    assert isinstance(rig.end, CalibrationFailed), rig.end
    assert "lowered by 8.0 mm the stylus could touch the panel. Its tip is" in rig.end.reason
    further = re.search(r"Move the instrument ([\d.]+) mm away", rig.end.reason)
    assert further is not None and abs(float(further[1]) - (26.0 - 1e3 * distance_m)) < 0.5, "8, 17 and 1 mm"
    assert min(z for _, _, z in rig.goals) == 0.0, "the stylus was never lowered"


@pytest.mark.parametrize("distance_m", [0.027, 0.030, 0.033])
def test_the_stylus_is_lowered_less_where_there_is_less_room(distance_m: float) -> None:
    rig = machine(face=face_below(distance_m))
    assert isinstance(rig.end, CalibrationFinished), rig.end
    lowest_m = -min(z for _, _, z in rig.goals)
    assert abs(lowest_m - (distance_m - 0.018)) < 0.0004, "1 mm above what stands 17 mm high, with the ball"
    heights = face_below(distance_m).inverse().apply(POSE.apply(np.array(rig.goals)))[:, 2]
    assert heights.min() > 0.0175


def test_a_panel_that_is_far_enough_is_no_reason() -> None:
    rig = machine(face=face_below(0.035))
    assert isinstance(rig.end, CalibrationFinished)
    assert min(z for _, _, z in rig.goals) == -0.016


def test_a_place_that_was_not_seen_from_above_is_looked_at_again_before_the_stylus_is_lowered_there() -> None:
    def blind_at_the_first(rig: Machine, number: int) -> None:
        rig.blind = number == 1

    near = machine(fault=blind_at_the_first, face=face_below(0.018))
    assert isinstance(near.end, CalibrationFailed) and "the stylus could touch the panel" in near.end.reason
    assert near.goals == [(0.03, 0.03, 0.0), (0.03, 0.03, 0.0)]
    far = machine(fault=blind_at_the_first, face=face_below(0.036))
    assert isinstance(far.end, CalibrationFinished)
    assert far.goals[:3] == [(0.03, 0.03, 0.0), (0.03, 0.03, 0.0), (0.03, 0.03, -0.016)]
    assert (far.progress[-1].done, far.progress[-1].note) == (far.progress[-1].total, "1 missed")


def test_the_stylus_is_not_lowered_where_it_is_not_seen_from_above() -> None:
    def blind_at_the_first(rig: Machine, number: int) -> None:
        rig.blind = rig.goals[-1][:2] == (0.03, 0.03)

    rig = machine(fault=blind_at_the_first, face=face_below(0.036))
    assert isinstance(rig.end, CalibrationFinished)
    assert rig.goals[:2] == [(0.03, 0.03, 0.0), (0.03, 0.03, 0.0)]
    assert (0.03, 0.03, -0.016) not in rig.goals
    assert (rig.progress[-1].done, rig.progress[-1].note) == (rig.progress[-1].total, "2 missed")


def test_a_panel_that_leans_is_not_touched_at_the_held_out_places() -> None:
    lean = np.asarray(cv2.Rodrigues(np.array([0.0, np.radians(-3.0), 0.0]))[0], dtype=float)
    face = POSE @ Transform(lean, np.array([0.02, 0.025, -0.036]))
    rig = machine(face=face, heights_m=(0.0,), held_out_height_m=-0.012)
    heights = face.inverse().apply(POSE.apply(np.array(rig.goals)))[:, 2]
    print("above the panel, mm:", 1e3 * heights)
    assert heights[0] > 0.031, "enough room where the run begins"
    assert heights.min() > 0.017, "above the tallest control"
    assert isinstance(rig.end, CalibrationFailed) and "lowered by 6.0 mm the stylus could touch" in rig.end.reason


@pytest.mark.parametrize("scale", [2.0, 0.5, 0.0])
def test_a_stylus_that_goes_another_way_than_it_should_is_noticed_on_its_second_way_down(scale: float) -> None:
    def other_steps(rig: Machine, number: int) -> None:
        rig.stylus_scale = scale

    rig = machine(fault=other_steps)
    assert isinstance(rig.end, CalibrationFailed)
    found = re.match(r"lowered by 16\.0 mm the tip moved by ([\d.]+) mm: check .*\$102", rig.end.reason)
    assert found is not None and abs(float(found[1]) - 16.0 * scale) < 0.5, rig.end.reason
    assert [z for _, _, z in rig.goals].count(-0.016) == 2


def test_one_way_down_that_is_seen_wrongly_does_not_matter() -> None:
    def a_reflection(rig: Machine, number: int) -> None:
        rig.slip = np.array([0.0, 0.0, 0.006 * (number == 5)])

    assert isinstance(machine(fault=a_reflection).end, CalibrationFinished)


def test_a_few_unseen_places_do_not_matter() -> None:
    def blind_at_some(rig: Machine, number: int) -> None:
        rig.blind = number in (3, 9, 14)

    rig = machine(fault=blind_at_some)
    assert isinstance(rig.end, CalibrationFinished), rig.end
    assert rig.progress[-1].note == "3 missed"


def test_a_tip_that_is_nowhere_seen_is_no_matter_of_some_places() -> None:
    def swapped_cameras(rig: Machine, number: int) -> None:
        rig.blind = True

    rig = machine(fault=swapped_cameras)
    assert isinstance(rig.end, CalibrationFailed) and rig.end.reason.startswith(
        "7 of 24 positions gave no sample; last: the cameras saw the tip"
    )
    assert (
        "; the two cameras never saw the tip at once. Have left and right changed places, is one upside"
        in rig.end.reason
    )


def stale(rig: Machine, number: int) -> None:
    rig.outcome, rig.code = (Outcome.REJECTED, "stale") if number in (3, 4, 9) else (Outcome.REACHED, "")


def answered_late(rig: Machine, number: int) -> None:
    rig.silent = number in (5, 6)


@pytest.mark.parametrize(
    ("fault", "note", "repeated"),
    [
        (stale, "stale: the stamp is 0.527 s old (limit 0.5 s); repetition 1 of 4", 3),
        (answered_late, "the goal was not answered within 3 s; repetition 1 of 4", 2),
    ],
)
def test_a_goal_that_was_only_late_is_sent_again_and_the_samples_are_kept(fault: Any, note: str, repeated: int) -> None:
    rig = machine(fault=fault)
    assert isinstance(rig.end, CalibrationFinished), rig.end
    plain = machine()
    assert len(rig.goals) == len(plain.goals) + repeated
    assert note in {p.note for p in rig.progress}, {p.note for p in rig.progress}
    assert [p.done for p in rig.progress] == sorted(p.done for p in rig.progress), "nothing is lost"
    assert (rig.progress[-1].done, rig.progress[-1].note) == (rig.progress[-1].total, "")


def test_a_goal_that_stays_late_ends_the_run_after_a_bounded_number_of_repetitions() -> None:
    def always(rig: Machine, number: int) -> None:
        rig.outcome, rig.code = Outcome.REJECTED, "stale"

    rig = machine(fault=always)
    assert isinstance(rig.end, CalibrationFailed)
    assert rig.end.reason.endswith("was rejected: stale: the stamp is 0.527 s old (limit 0.5 s)")
    assert len(rig.goals) == 1 + run_config().retries

    def often(rig: Machine, number: int) -> None:
        rig.outcome, rig.code = (Outcome.REJECTED, "stale") if number % 2 else (Outcome.REACHED, "")

    rig = machine(fault=often, max_retries=5)
    assert isinstance(rig.end, CalibrationFailed)
    assert len(rig.goals) == 11, "five stops, each sent twice, and one more"


@pytest.mark.parametrize("code", ["", "alarm"])
def test_a_goal_that_was_rejected_for_something_else_ends_the_run_whatever_the_words_are(code: str) -> None:
    def refuses(rig: Machine, number: int) -> None:
        rig.outcome, rig.code = Outcome.REJECTED, code

    rig = machine(fault=refuses)
    assert isinstance(rig.end, CalibrationFailed) and "stale" in rig.end.reason
    assert len(rig.goals) == 1


@pytest.mark.parametrize(
    ("what", "late"),
    [
        ("dark", "no image of the resting machine arrived for "),
        ("lost", "the program has evaluated no image of the resting machine for "),
    ],
)
def test_images_that_are_late_are_waited_for_longer(what: str, late: str) -> None:
    run = CalibrationRun(run_config(enough_m=0.001), StillConfig(), HandEyeConfig(), CAMERAS, 10_000 * MS)
    rig = Machine(run, 1)
    rig.act(run.start(rig.now))
    rig.spin(2.0)
    done = rig.progress[-1].done
    assert 0 < done < 10
    setattr(rig, what, True)
    rig.spin(25.0)
    notes = [p.note for p in rig.progress]
    assert any(note.startswith(late) and note.endswith("repetition 2 of 4") for note in notes), notes
    assert rig.end is None and rig.progress[-1].done <= done + 2
    setattr(rig, what, False)
    rig.spin(100.0)
    assert isinstance(rig.end, CalibrationFinished), rig.end
    assert (rig.progress[-1].done, rig.progress[-1].note) == (rig.progress[-1].total, "")


def test_a_goal_that_is_sent_twice_counts_once() -> None:
    run = CalibrationRun(run_config(), StillConfig(), HandEyeConfig(), CAMERAS, 0)
    run.start(0)

    def answer(goal_id: str, outcome: Outcome, reason: str = "") -> list[Action]:
        return run.result(GoalResult(goal_id=goal_id, goal="", outcome=outcome, reason=reason), 3_200 * MS)

    (progress, again) = run.tick(3_000 * MS)
    assert isinstance(progress, Progress) and isinstance(again, SendCalibrationGoal) and again.stamp_ns == 3_000 * MS
    # The answers to the first goal come late; the second is rejected because the first is still running.
    assert answer("0", Outcome.ACCEPTED) == []
    assert answer(str(again.stamp_ns), Outcome.REJECTED, "busy with 'move to ...'") == []
    assert answer("0", Outcome.REACHED) == [] and not run.over
    assert answer("0", Outcome.ABORTED, "twice") == [], "it has arrived"


def test_an_alarm_of_the_driver_ends_the_run() -> None:
    run = CalibrationRun(run_config(), StillConfig(), HandEyeConfig(), CAMERAS, 0)
    run.start(0)
    assert run.driver_state("moving") == []
    assert run.driver_state("alarm: hard limit") == [CalibrationFailed("the driver reports 'alarm: hard limit'")]
    assert run.over and run.tick(10**15) == []


def test_answers_to_other_goals_are_ignored() -> None:
    run = CalibrationRun(run_config(), StillConfig(), HandEyeConfig(), CAMERAS, 0)
    run.start(77)
    other = GoalResult(goal_id="78", goal="", outcome=Outcome.ABORTED)
    assert run.result(other, 100) == []
    assert not run.over


def test_an_error_at_a_held_out_place_ends_the_run() -> None:
    checks = {(s.x, s.y) for s in plan(run_config()) if s.purpose is Purpose.CHECK}

    def elsewhere(rig: Machine, number: int) -> None:
        rig.slip = np.array([0.003, 0.0, 0.0]) * (rig.goals[-1][:2] in checks)

    rig = machine(fault=elsewhere)
    assert isinstance(rig.end, CalibrationFailed)
    assert re.match(r"at a held-out position the tip was [23]\.\d\d mm off \(limit 1\.00 mm\)", rig.end.reason)


@pytest.mark.parametrize("after", [10, 16, 22, 23])
def test_a_slipping_drive_is_noticed_wherever_it_slips(after: int) -> None:
    def slips(rig: Machine, number: int) -> None:
        rig.slip = np.array([0.003, 0.0, 0.0]) if number > after else np.zeros(3)

    rig = machine(fault=slips)
    assert isinstance(rig.end, CalibrationFailed), rig.end
    print(rig.end.reason)
    assert re.search(r"at a held-out position the tip was [23]|do not fit the rest|miss one another", rig.end.reason)


def test_still_watch_wants_a_resting_machine_and_a_steady_tip() -> None:
    watch = StillWatch(StillConfig(tips=4, settle_s=0.3, scatter_m=0.0005))
    assert watch.sample(0) == "no joint_states arrive"
    watch.reading(1000 * MS, np.array([0.1, 0.1, 0.0]))
    for k in range(4):
        watch.tip((1010 + 60 * k) * MS, np.array([0.0, 0.0, 0.6]))
    assert watch.sample(1300 * MS) == "the cameras saw the tip 0 of 4 times while the machine was at rest"
    for k in range(4):
        watch.tip((1310 + 60 * k) * MS, np.array([0.001 * k, 0.0, 0.6]))
    assert watch.sample(1600 * MS) == "the tip scatters by 1.12 mm (limit 0.50 mm)"
    watch.restart(1600 * MS)
    for k, x in enumerate((0.0001, -0.0001, 0.0001, -0.0001)):
        watch.tip((1910 + 60 * k) * MS, np.array([x, 0.0, 0.6]))
    sample = watch.sample(2000 * MS)
    assert not isinstance(sample, str)
    np.testing.assert_allclose(sample.tip, (0.0, 0.0, 0.6), atol=1e-9)
    np.testing.assert_allclose(sample.covariance[0, 0], 4 / 3 * 1e-8 / 4, rtol=1e-6)
    watch.reading(2100 * MS, np.array([0.1001, 0.1, 0.0]))
    assert isinstance(watch.sample(2150 * MS), str)
    assert watch.sample(9000 * MS) == "no joint_states arrive"


def test_still_watch_begins_anew_when_the_clock_is_set_back() -> None:
    watch = StillWatch(StillConfig(tips=4, panels=1, settle_s=0.0))
    nothing = FacePoints.joined([])
    for start_ms, x in ((900_000, 0.1), (100_000, 0.2)):
        for i in range(5):
            now = (start_ms + 100 * i) * MS
            watch.reading(now, np.array([x, 0.1, 0.0]))
            watch.tip(now, np.array([x, 0.0, 0.6 + 1e-5 * i]))
            watch.panel(now, POSE, nothing)
        sample, panel = watch.sample(now), watch.panel_sample(now)
        assert isinstance(sample, Sample) and isinstance(panel, PanelSample), (sample, panel)
        assert sample.reading[0] == panel.reading[0] == x and abs(sample.tip[0] - x) < 1e-9
    assert watch.sample(now + 2000 * MS) == "no joint_states arrive"
    watch.reading(50_000 * MS, np.array([0.2, 0.1, 0.0]))
    assert watch.sample(50_000 * MS) == "the cameras saw the tip 0 of 4 times while the machine was at rest"


def test_still_watch_forgets_a_panel_that_is_not_seen_any_more() -> None:
    watch = StillWatch(StillConfig(panels=3, settle_s=0.3, fresh_s=1.0))
    watch.reading(1000 * MS, np.array([0.1, 0.1, 0.0]))
    for k in range(3):
        watch.panel((1400 + 200 * k) * MS, POSE, FacePoints.joined([]))
    for now in (1900, 5000):
        watch.reading(now * MS, np.array([0.1, 0.1, 0.0]))
        sample = watch.panel_sample(now * MS)
        assert not isinstance(sample, str)
        np.testing.assert_allclose(sample.camera_from_panel.translation, POSE.translation)
    watch.reading(9000 * MS, np.array([0.1, 0.1, 0.0]))
    assert watch.panel_sample(9000 * MS) == "the cameras saw the panel 0 of 3 times while the machine was at rest"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"x_min_m": 0.001}, r"x_min_m = 0\.001: at least approach_m = 0\.003"),
        ({"y_max_m": 0.02}, r"y_max_m = 0\.02 is not above y_min_m = 0\.03"),
        ({"heights_m": ()}, "at least one height"),
        ({"heights_m": (0.01,)}, "above its maximum 0 m"),
        ({"columns": 2, "rows": 2}, "columns = 2, rows = 2; expected at least 3 of one, for two held-out places"),
    ],
)
def test_impossible_plans_are_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        run_config(**wrong)


@pytest.mark.parametrize(
    ("run", "solver", "message"),
    [
        ({"y_max_m": 0.08}, {}, r"\(300 mm long, 50\.0 mm across\)"),
        ({"x_max_m": 0.06, "y_max_m": 0.06}, {}, r"too close together \(.* mm\): move at least 60 mm in x and in y"),
        ({}, {"min_samples": 25}, "24 samples (at least 25"),
        ({"mounting": "carriage"}, {"min_samples": 13}, "12 samples (at least 13"),
    ],
)
def test_a_plan_that_cannot_be_solved_is_refused_before_it_moves(
    run: dict[str, Any], solver: dict[str, Any], message: str
) -> None:
    check_plan(run_config(), HandEyeConfig())
    with pytest.raises(DegenerateError, match=message):
        check_plan(run_config(**run), HandEyeConfig(**solver))


@pytest.mark.parametrize(("columns", "rows"), [(2, 3), (3, 3), (4, 3), (5, 4), (2, 11)])
def test_as_many_places_are_held_out_as_are_asked_for(columns: int, rows: int) -> None:
    between = (columns - 1) * (rows - 1)
    for held_out in (2, 4, 6, 12):
        stops = plan(run_config(columns=columns, rows=rows, held_out=held_out))
        places = {(s.x, s.y) for s in stops if s.purpose is Purpose.CHECK}
        assert len(places) == min(held_out, between)
