"""State and decisions of the hand-eye node, without the node."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from datetime import datetime
from typing import Any

import cv2
import numpy as np
import pytest
from unit.harris_perception.rectified_pair import AXES, POSE, camera, stored_calibration

from harris_perception.core.hand_eye.calibration_file import StoredCalibration
from harris_perception.core.hand_eye.carriage_camera import Contact
from harris_perception.core.hand_eye.drift import DriftConfig
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig, plan
from harris_perception.core.hand_eye_procedure.calibration_run import SendCalibrationGoal
from harris_perception.core.hand_eye_procedure.calibrator import Calibrator
from harris_perception.core.hand_eye_procedure.calibrator_actions import (
    Action,
    LogNote,
    SetAxes,
    SetPose,
    SetState,
)
from harris_perception.core.hand_eye_procedure.calibrator_config import CalibratorConfig
from harris_perception.core.hand_eye_procedure.conditions import CalibrationRefused
from harris_perception.core.hand_eye_procedure.still_watch import StillConfig
from harris_perception.core.pose.planar_pose import FacePoints
from icu_common.core.alignment.pair import PairCode, PairState
from icu_common.core.geometry.frames import PANEL
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult, Outcome

NOW_NS = 1_772_600_000_000_000_000
NANO = 1_000_000_000
MS = 1_000_000
CONFIG = CalibratorConfig(
    machine="bench",
    run=RunConfig(columns=3, rows=2, held_out=2, backlash_places=0),
    still=StillConfig(tips=3, settle_s=0.0),
    drift=DriftConfig(times=2),
)
STORED = stored_calibration(POSE, AXES)


def calibrated(stored: StoredCalibration = STORED, config: CalibratorConfig = CONFIG) -> Calibrator:
    calibrator = Calibrator(config)
    calibrator.offer(stored)
    for side, baseline in (("left", 0.0), ("right", 0.12)):
        calibrator.take_camera(side, camera(baseline_m=baseline), NOW_NS)
    assert calibrator.state == f"calibrated: {stored.summary()}"
    return calibrator


def look(calibrator: Calibrator, reading: Array, now_ns: int, off_m: float = 0.0) -> list[Action]:
    """Rest at a reading (3,) and be seen there three times, ``off_m`` off the tip's position."""
    calibrator.take_reading(now_ns, reading)
    tip = POSE.apply(np.array([*(AXES @ reading[:2]) + off_m, -reading[2]]))
    rng = np.random.default_rng(3)
    actions = []
    for sighting in range(1, 4):
        stamp = now_ns + sighting * MS
        actions += calibrator.take_tip(stamp, tip + rng.normal(0, 1e-5, 3), stamp)
    return actions


def kinds(actions: Sequence[Action]) -> list[str]:
    return [type(action).__name__ for action in actions]


def test_a_run_ends_in_a_calibration_that_is_used_and_then_kept() -> None:
    calibrator = Calibrator(CONFIG)
    for side, baseline in (("left", 0.0), ("right", 0.12)):
        calibrator.take_camera(side, camera(baseline_m=baseline), NOW_NS)
    calibrator.take_driver("idle", NOW_NS)
    now, actions = NOW_NS, calibrator.run(NOW_NS)
    with pytest.raises(CalibrationRefused, match="a calibration is already running"):
        calibrator.run(now)
    while goals := [action for action in actions if isinstance(action, SendCalibrationGoal)]:
        now += 100 * MS
        (goal,) = goals
        reading = np.array([goal.xyz[0], goal.xyz[1], -goal.xyz[2]])
        calibrator.take_reading(now, reading)
        actions = []
        for outcome in (Outcome.ACCEPTED, Outcome.REACHED):
            answer = GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=outcome)
            actions += calibrator.take_result(answer, now)
        actions += look(calibrator, reading, now)
    assert kinds(actions)[-4:] == ["SetAxes", "SetPose", "SetState", "Keep"]
    assert calibrator.stored is not None and not calibrator.running
    np.testing.assert_allclose(calibrator.stored.base_from_reading, AXES, atol=0.001)
    made_at = datetime.fromisoformat(calibrator.stored.made_at).timestamp()
    assert made_at == now // NANO, "by the time that it was given"
    assert (calibrator.level, dict(calibrator.values())["drift"]) == ("ok", "none")


def test_a_run_lowers_the_stylus_onto_no_control_of_the_panel_that_is_seen() -> None:
    for controls, said in (({"KNOB": np.array([0.1, 0.05, 0.015])}, "could touch the panel"), ({}, "")):
        calibrator = Calibrator(CONFIG)
        for side, baseline in (("left", 0.0), ("right", 0.12)):
            calibrator.take_camera(side, camera(baseline_m=baseline), NOW_NS)
        calibrator.take_driver("idle", NOW_NS)
        calibrator.take_controls(controls)
        (goal,) = [action for action in calibrator.run(NOW_NS) if isinstance(action, SendCalibrationGoal)]
        face = POSE @ Transform(np.eye(3), np.array([0.0, 0.0, -0.025]))  # seen only after the run has begun
        now = NOW_NS + 50 * MS
        calibrator.take_panel(now, face, now)
        while goal is not None and goal.xyz[2] == 0.0:
            now += 100 * MS
            reading, actions = np.array([*goal.xyz[:2], 0.0]), []
            calibrator.take_reading(now, reading)
            for outcome in (Outcome.ACCEPTED, Outcome.REACHED):
                answer = GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=outcome)
                actions += calibrator.take_result(answer, now)
            actions += look(calibrator, reading, now)
            goal = next((action for action in actions if isinstance(action, SendCalibrationGoal)), None)
        assert (goal is None) is bool(said), "lowered only where there is room for it"
        assert said in calibrator.state and calibrator.running is not bool(said)


def ride(calibrator: Calibrator, base_from_panel: Transform, unseen: Sequence[int] = ()) -> list[Array]:
    """Run with cameras on the carriage, to which the panel and the tip show themselves; return the goals (3,)."""
    now, goals, actions = NOW_NS, list[Array](), calibrator.run(NOW_NS)
    while sent := [action for action in actions if isinstance(action, SendCalibrationGoal)]:
        (goal,) = sent
        x, y, z = goal.xyz
        goals.append(np.array(goal.xyz))
        now += 100 * MS
        calibrator.take_reading(now, np.array([x, y, -z]))
        actions = []
        for outcome in (Outcome.ACCEPTED, Outcome.REACHED):
            actions += calibrator.take_result(GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=outcome), now)
        if any(isinstance(action, SendCalibrationGoal) for action in actions):
            continue
        seen = POSE @ Transform(np.eye(3), np.array([-x, -y, 0.0])) @ base_from_panel
        for stamp in range(now + MS, now + 4 * MS, MS):
            actions += calibrator.take_panel(stamp, seen, stamp)
            actions += calibrator.take_points(stamp, FacePoints.joined([]), stamp)
            if len(goals) not in unseen:
                actions += calibrator.take_tip(stamp, POSE.apply(np.array([0.0, 0.0, z])), stamp)
        if not actions:
            now += 60 * NANO
            calibrator.take_reading(now, np.array([x, y, -z]))
            actions = calibrator.tick(now)
    return goals


def riding(**run: Any) -> Calibrator:
    """Return one with cameras on the carriage, and a panel with a knob of 15 mm, which with the ball is 17 mm."""
    config = RunConfig(**{"mounting": "carriage", "places": 6, **run})
    calibrator = Calibrator(CalibratorConfig(machine="bench", run=config, still=CONFIG.still))
    for side, baseline in (("left", 0.0), ("right", 0.12)):
        calibrator.take_camera(side, camera(baseline_m=baseline), NOW_NS)
    calibrator.take_driver("idle", NOW_NS)
    calibrator.take_controls({"KNOB": np.array([0.1, 0.05, 0.015])})
    return calibrator


@pytest.mark.parametrize(
    ("distance_m", "lean_deg", "lowered"),
    [(0.0305, 0.0, 7), (0.0305, 1.0, 4), (0.0305, 2.0, 4), (0.0305, -2.0, 7), (0.036, 1.0, 7), (0.036, 2.0, 4)],
)
def test_a_panel_that_leans_is_not_touched_with_cameras_on_the_carriage(
    distance_m: float, lean_deg: float, lowered: int
) -> None:
    lean = np.asarray(cv2.Rodrigues(np.array([0.0, np.radians(-lean_deg), 0.0]))[0], dtype=float)
    panel = Transform(lean, np.array([0.03, 0.03, -distance_m]))
    calibrator = riding()
    goals = np.array(ride(calibrator, panel))
    assert panel.inverse().apply(goals)[:, 2].min() > 0.017, "above the knob and the ball's radius"
    assert int((goals[:, 2] < 0.0).sum()) == lowered
    assert ("could touch the panel" in calibrator.state) is (lowered < 7), calibrator.state
    assert not calibrator.running


def test_a_tip_that_is_unseen_from_above_is_not_lowered_with_cameras_on_the_carriage() -> None:
    calibrator = riding()
    # The third stop is the first way down: its place is looked at from above first.
    goals = ride(calibrator, Transform(np.eye(3), np.array([0.03, 0.03, -0.0305])), unseen=(3,))
    assert [float(goal[2]) for goal in goals[:4]] == [0.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose([goal[:2] for goal in goals[1:4]], ((0.0, 0.08), (0.03, 0.105), (0.006, 0.13)))
    assert int((np.array(goals)[:, 2] < 0.0).sum()) == 6


def test_cameras_that_see_no_tip_lower_nothing() -> None:
    calibrator = riding()
    calibrator.contacts = [Contact(reading=np.array([0.1, 0.1, 0.016]), in_panel=np.array([0.1, 0.1, 0.002]))]
    goals = ride(calibrator, Transform(np.eye(3), np.array([0.03, 0.03, -0.018])), unseen=range(100))
    assert len(goals) == len(plan(RunConfig(mounting="carriage", places=6), see_tip=False)), "all the way to its end"
    assert {float(goal[2]) for goal in goals} == {0.0}


def test_progress_is_told_as_text_and_as_values() -> None:
    calibrator = calibrated()
    calibrator.take_driver("idle", NOW_NS)
    assert "remaining_s" not in dict(calibrator.values())
    actions = calibrator.run(NOW_NS)
    (text,) = [action.text for action in actions if isinstance(action, SetState)]
    values = dict(calibrator.values())
    assert values["done"] == 0 and values["total"] == len(plan(CONFIG.run))
    assert 5.0 < float(values["remaining_s"]) < 60.0
    assert text == f"calibrating 0/{values['total']}, {float(values['remaining_s']):.0f} s left"


def test_images_and_unseen_tips_count_only_during_a_run() -> None:
    calibrator = calibrated()
    assert calibrator.take_image(NOW_NS, NOW_NS) == [] == calibrator.take_unseen(NOW_NS, NOW_NS)


def test_a_camera_that_changes_ends_the_run_and_withdraws_the_calibration() -> None:
    calibrator = calibrated()
    calibrator.take_driver("idle", NOW_NS)
    calibrator.run(NOW_NS)
    actions = calibrator.take_camera("left", camera(1710.0), NOW_NS)
    failed, state, axes, refused, last = actions
    why = "the left camera's calibration has changed"
    assert failed == LogNote("error", f"calibration failed: {why} meanwhile")
    assert state == SetState(f"failed: {why} meanwhile")
    assert isinstance(axes, SetAxes) and axes.base_from_reading is None
    assert refused == LogNote("error", f"the calibration in use does not fit: {why} by 10.00 px since this calibration")
    assert last == SetState(f"failed: the calibration in use does not fit: {why} by 10.00 px since this calibration")
    assert (calibrator.stored, calibrator.drift, calibrator.running, calibrator.level) == (None, None, False, "error")
    assert calibrator.close() == [], "there is no run any more that could be cut short"


def used_again(actions: Sequence[Action], calibrator: Calibrator) -> bool:
    """Return whether the stored calibration is in use, and was reported to be by these actions."""
    axes = [action.base_from_reading for action in actions if isinstance(action, SetAxes)]
    assert (calibrator.stored is STORED) is bool(axes), kinds(actions)
    if not axes:
        return False
    np.testing.assert_array_equal(axes[0], AXES)
    assert kinds(actions) == ["SetSigma", "SetAxes", "SetPose", "SetState"]
    assert calibrator.state == f"calibrated: {STORED.summary()}" and calibrator.level == "ok"
    return True


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_withdrawn_calibration_is_used_again_with_the_very_same_camera(side: str) -> None:
    calibrator, baseline_m = calibrated(), 0.12 * (side == "right")
    withdrawn = calibrator.lose_camera(side, 640, 360)
    assert isinstance(withdrawn[0], SetAxes) and withdrawn[0].base_from_reading is None
    for camera_seen, why in (
        (camera(1710.0, baseline_m=baseline_m), f"the {side} camera's calibration has changed by"),
        (
            dataclasses.replace(camera(baseline_m=baseline_m), width=640),
            f"a {side} picture of 1280 x 720 px, now it has",
        ),
    ):
        assert not used_again(calibrator.take_camera(side, camera_seen, NOW_NS), calibrator)
        assert calibrator.state.startswith("failed: the stored calibration does not fit: ") and why in calibrator.state
        assert not used_again(calibrator.take_settings("", NOW_NS), calibrator)
    assert used_again(calibrator.take_camera(side, camera(baseline_m=baseline_m), NOW_NS + 1), calibrator)
    changed = calibrator.take_camera("left", camera(1710.0), NOW_NS + 2)
    assert kinds(changed) == ["SetAxes", "LogNote", "SetState"]
    assert (
        "the calibration in use does not fit: the left camera's calibration has changed by 10.00 px" in calibrator.state
    )
    assert used_again(calibrator.take_camera("left", camera(), NOW_NS + 3), calibrator)


def test_the_file_is_used_once_its_cameras_come_after_others() -> None:
    calibrator = Calibrator(CONFIG)
    calibrator.offer(STORED)
    calibrator.take_camera("left", camera(1710.0), NOW_NS)
    assert kinds(calibrator.take_camera("right", camera(baseline_m=0.12), NOW_NS)) == ["LogNote", "SetState"]
    refused = (
        "failed: the stored calibration does not fit: the left camera's calibration has changed by 10.00 px since this"
    )
    assert calibrator.state.startswith(refused)
    assert calibrator.take_settings("$100=80.000", NOW_NS) == [], "that is said once"
    assert used_again(calibrator.take_camera("left", camera(), NOW_NS + 1), calibrator)


def test_settings_that_come_back_bring_the_calibration_back_but_not_into_a_run() -> None:
    stored = dataclasses.replace(STORED, settings="$100=80.000")
    calibrator = calibrated(stored)
    assert kinds(calibrator.take_settings("$100=40.000", NOW_NS)) == ["SetAxes", "LogNote", "SetState"]
    assert "the calibration in use does not fit: the machine's settings have changed" in calibrator.state
    calibrator.take_driver("idle", NOW_NS)
    calibrator.run(NOW_NS)
    assert calibrator.take_settings("$100=80.000", NOW_NS) == [], "the run's goals are made for other axes"
    calibrator.take_driver("alarm: hard limit", NOW_NS)
    assert calibrator.stored is None and calibrator.state == "failed: the driver reports 'alarm: hard limit'"
    assert kinds(calibrator.take_settings("$100=80.000", NOW_NS)) == ["SetSigma", "SetAxes", "SetPose", "SetState"]
    assert calibrator.stored is stored
    other = dataclasses.replace(CONFIG, machine="other")
    assert kinds(calibrator.configure(other, NOW_NS)) == ["SetAxes", "LogNote", "SetState"]
    assert kinds(calibrator.configure(CONFIG, NOW_NS)) == ["SetSigma", "SetAxes", "SetPose", "SetState"]
    assert calibrator.stored is stored


def test_a_withdrawn_calibration_does_not_replace_the_one_that_was_made_since() -> None:
    calibrator, now = calibrated(dataclasses.replace(STORED, settings="$100=80.000")), NOW_NS
    calibrator.take_settings("$100=40.000", now)
    for x, y in ((0.05, 0.05), (0.15, 0.05), (0.25, 0.05), (0.05, 0.15), (0.15, 0.15), (0.25, 0.15)):
        now += 1000 * MS
        look(calibrator, np.array([x, y, 0.0]), now)
        calibrator.add_sample(now + 4 * MS)
    calibrator.solve(now)
    made = calibrator.stored
    assert made is not None and (made.samples, made.settings) == (6, "$100=40.000")
    assert kinds(calibrator.take_settings("$100=80.000", now)) == ["SetAxes", "LogNote", "SetState"]
    assert calibrator.stored is None and "$100 was 40.000, now 80.000" in calibrator.state
    assert calibrator.take_settings("$100=80.000", now) == []
    calibrator.take_settings("$100=40.000", now)
    assert calibrator.stored is made


def test_cameras_on_the_carriage_move_with_every_reading_that_differs() -> None:
    riding = dataclasses.replace(CONFIG, run=dataclasses.replace(CONFIG.run, mounting="carriage"))
    calibrator = calibrated(dataclasses.replace(STORED, mounting="carriage"), riding)
    (pose,) = calibrator.take_reading(NOW_NS, np.array([0.1, 0.0, 0.0]))
    assert isinstance(pose, SetPose) and pose.stamp_ns == NOW_NS
    moved = POSE.translation - pose.camera_from_base.translation
    np.testing.assert_allclose(np.abs(POSE.rotation.T @ moved), np.abs([*(AXES @ (0.1, 0.0)), 0.0]), atol=1e-9)
    assert calibrator.take_reading(NOW_NS + MS, np.array([0.1, 0.0, 0.0])) == []


def test_drift_is_told_when_it_begins_and_when_it_ends() -> None:
    calibrator, reading = calibrated(), np.array([0.2, 0.1, 0.0])
    now, told = NOW_NS, []
    for off_m in (0.003, 0.003, 0.003, 0.0, 0.0):
        now += 1000 * MS
        look(calibrator, reading + np.array([off_m / 10, 0.0, 0.0]), now, off_m)
        told.append(kinds(calibrator.look_around(now + 10 * MS)))
    assert told == [[], ["LogNote", "SetState"], [], ["LogNote", "SetState"], []]
    assert calibrator.state == f"calibrated: {STORED.summary()}"


def test_one_burst_of_sightings_is_one_look_at_drift() -> None:
    calibrator, reading = calibrated(dataclasses.replace(STORED, base_from_panel=Transform.identity())), np.zeros(3)
    beside = Transform(POSE.rotation, POSE.translation + (0.003, 0.0, 0.0))
    for burst, told in enumerate(([], ["LogNote", "SetState"])):
        now = NOW_NS + burst * 1000 * MS
        look(calibrator, reading, now, 0.003)
        for sighting in range(1, 4):
            calibrator.take_panel(now + sighting * MS, beside, now + sighting * MS)
        for late_ms in (10, 300, 600):
            assert kinds(calibrator.look_around(now + late_ms * MS)) == (told if late_ms == 10 else [])
    assert "the tip is 4.2 mm" in calibrator.state and "the panel's corner is 3.0 mm" in calibrator.state
    # A recording that restarts, or a clock that was set back, is processed as before.
    for now in (NOW_NS - 100_000 * MS, NOW_NS - 99_000 * MS):
        look(calibrator, reading, now)
        calibrator.look_around(now + 10 * MS)
        assert calibrator.drifted.startswith("the panel's corner is")
    assert "the tip is" not in calibrator.state, "what the state says is what is still off"
    assert "drift: the panel's corner is 3.0 mm" in calibrator.state and "the panel has moved" in calibrator.state


def test_homing_begins_the_readings_anew() -> None:
    calibrator, reading = calibrated(), np.array([0.2, 0.1, 0.0])
    look(calibrator, reading, NOW_NS)
    assert calibrator.add_sample(NOW_NS + 4 * MS).startswith("sample 1 at readings x = 200.0, y = 100.0")
    (note,) = calibrator.take_contact(np.array([0.15, 0.08, 0.0]), PANEL, NOW_NS + 4 * MS)
    assert note == LogNote("info", "contact 1 at 0.1500, 0.0800 m of the panel")
    calibrator.take_driver("homing", NOW_NS)
    assert (calibrator.samples, calibrator.contacts) == ([], [])


def test_what_was_seen_with_the_camera_before_is_no_sample_and_no_place_of_the_panel() -> None:
    calibrator, reading = Calibrator(CONFIG), np.array([0.2, 0.1, 0.0])
    for side, baseline in (("left", 0.0), ("right", 0.12)):
        calibrator.take_camera(side, camera(baseline_m=baseline), NOW_NS)
    look(calibrator, reading, NOW_NS)
    calibrator.take_panel(NOW_NS, POSE, NOW_NS)
    calibrator.take_camera("left", camera(1710.0), NOW_NS + 4 * MS)
    with pytest.raises(CalibrationRefused, match="the cameras saw the tip 0 of 3 times"):
        calibrator.add_sample(NOW_NS + 5 * MS)
    calibrator.take_camera("left", camera(), NOW_NS + 6 * MS)
    now = NOW_NS
    for x, y in ((0.05, 0.05), (0.15, 0.05), (0.25, 0.05), (0.05, 0.15), (0.15, 0.15), (0.25, 0.15)):
        now += 1000 * MS
        look(calibrator, np.array([x, y, 0.0]), now)
        calibrator.add_sample(now + 4 * MS)
    calibrator.solve(now)
    assert calibrator.stored is not None and calibrator.stored.base_from_panel is None


def test_other_limits_of_drift_do_not_end_what_is_said_of_a_run() -> None:
    calibrator, now = calibrated(), NOW_NS
    for _ in range(2):
        now += 1000 * MS
        look(calibrator, np.array([0.2, 0.1, 0.0]), now, 0.003)
        calibrator.look_around(now + 10 * MS)
    assert "drift: the tip" in calibrator.state
    calibrator.take_driver("idle", now)
    calibrator.run(now)
    assert calibrator.configure(dataclasses.replace(CONFIG, drift=DriftConfig(times=2, max_tip_m=0.01)), now) == []
    assert calibrator.state.startswith("calibrating 0/")


def test_a_run_knows_the_correction_of_the_right_camera_from_before_and_during_it() -> None:
    calibrator, turn = calibrated(), np.array([0.0, 0.001, 0.0])
    calibrator.take_driver("idle", NOW_NS)
    calibrator.take_pair(PairState(code=PairCode.CORRECTED, rotation_rad=turn, stamp_ns=NOW_NS - MS))
    calibrator.run(NOW_NS)
    run = calibrator._run
    assert run is not None
    tip = np.array([0.02, 0.01, 0.6])
    seen = run._pair.neutral(NOW_NS, tip)
    # 0.001 rad are 3 mm in depth at 0.6 m with a baseline of 0.12 m.
    assert 0.002 < np.linalg.norm(seen - tip) < 0.004
    calibrator.take_pair(PairState(code=PairCode.CHANGING, rotation_rad=3 * turn, stamp_ns=NOW_NS + MS))
    np.testing.assert_array_equal(run._pair.newest(seen), run._pair.newest(run._pair.neutral(NOW_NS, tip)))
    calibrator.take_pair(PairState(stamp_ns=NOW_NS + 2 * MS))
    np.testing.assert_allclose(run._pair.neutral(NOW_NS + 3 * MS, tip), tip, atol=1e-12)
