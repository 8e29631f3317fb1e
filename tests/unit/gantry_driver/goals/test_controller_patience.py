"""Retries of the controller where only slowness made it exceed a limit, and actions that it never retries."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from unit.gantry_driver.controller_bench import MS, Bench, config

from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.goal_job import GoalPhase
from gantry_driver.core.job.patience import HoldUp, goal_limit_s, next_limit_s, patient_limit_s
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.processes.delays import Delay, ResultCode, delay_of

SECOND = 1000 * MS


def silence(*what: str) -> Callable[[Bench], None]:
    return lambda bench: bench.talking.difference_update(what)


def delays(bench: Bench) -> list[msg.ReportDelay]:
    return [action for action in bench.actions if isinstance(action, msg.ReportDelay)]


class LateBench(Bench):
    """Everything that comes of an image arrives ``late_s`` after the image was taken."""

    late_s = 0.0

    def __init__(self, given: object = None) -> None:
        super().__init__(given)  # type: ignore[arg-type]
        self.waiting: list[tuple[int, msg.Event]] = []

    def tell(self, event: msg.Event) -> None:
        images = msg.CameraSeen | msg.PanelPose | msg.TipSeen | msg.TipUnseen | msg.PanelState
        if self.late_s and isinstance(event, images):
            self.waiting.append((self.now_ns + round(self.late_s * 1e9), event))
            return
        while self.waiting and self.waiting[0][0] <= self.now_ns:
            super().tell(self.waiting.pop(0)[1])
        super().tell(event)


def test_limits_double_up_to_a_bound() -> None:
    settings = config(slow_tries=3, slow_limit_max_s=10.0)
    assert patient_limit_s(1.0, settings) == 4.0 and patient_limit_s(3.0, settings) == 10.0
    assert patient_limit_s(20.0, settings) == 20.0, "never below the configured limit"
    assert [next_limit_s(limit, 3.0, settings) for limit in (3.0, 6.0, 10.0)] == [6.0, 10.0, None]
    assert next_limit_s(3.0, 3.0, config(slow_tries=1)) is None


def test_a_goal_reaches_its_target_with_images_that_are_late_by_more_than_a_look() -> None:
    bench = LateBench(config(look_timeout_s=1.0, camera_timeout_s=5.0, panel_max_age_s=20.0, state_max_age_s=5.0))
    bench.start()
    bench.late_s = 1.5
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REACHED, result
    assert result.error_m < 0.0005 and dict(result.details)["measured_by"] == "cameras"
    report = delays(bench)[0]
    assert report.then == "waiting up to 2 s"
    assert report.delay.what == "image that the stylus tracker has evaluated"
    assert 1.4 < report.delay.measured_s < 1.7 and report.delay.limit_s == 1.0


def test_a_hiccup_of_the_images_before_the_touch_costs_only_time() -> None:
    bench = Bench().start()

    def hiccup(bench: Bench) -> None:
        bench.talking.discard("camera")
        bench.on_phase[GoalPhase.TOUCH] = lambda b: touched_at.append(b.now_ns)
        until.append(bench.now_ns + 3 * SECOND)

    until: list[int] = []
    touched_at: list[int] = []
    bench.on_phase[GoalPhase.LOOK] = hiccup
    bench.tell(msg.Command(text="press:RUN_STOP"))
    while not bench.finals:
        bench.run(0.02)
        if until and bench.now_ns > until[0]:
            bench.talking.add("camera")
    assert bench.finals[0].outcome is Outcome.REACHED, bench.finals
    assert touched_at[0] > until[0], "nothing is touched while the images are late"
    late = [report.delay for report in delays(bench)]
    assert [delay.what for delay in late] == ["image of the left camera", "pose of the panel"]
    assert late[0].code is ResultCode.LATE_IMAGE and late[0].limit_s == 1.0 and 1.0 < late[0].measured_s < 1.1


def test_a_goal_that_finds_the_images_late_waits_for_them() -> None:
    bench = Bench().start()
    bench.talking.discard("camera")
    bench.run(1.5)
    bench.tell(msg.Command(text="press:RUN_STOP"))
    assert bench.controller.phase is GoalPhase.SIGHT and bench.results[-1].outcome is Outcome.ACCEPTED
    bench.run(1.0)
    assert not bench.paths, "nothing moves before images have come"
    bench.talking.add("camera")
    assert bench.run_goal().outcome is Outcome.REACHED


def test_images_that_stay_away_fail_the_goal_with_a_code_and_figures() -> None:
    bench = Bench().start()
    bench.on_phase[GoalPhase.LOOK] = silence("camera")
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and result.code == "late_image"
    delay = delay_of(result)
    assert delay is not None and delay.what == "image of the left camera" and 4.0 < delay.measured_s < 4.1
    assert bench.stops == 0 and bench.readings[2] == 0.0


def test_a_silent_tracker_fails_the_look_as_late_and_a_tracker_that_sees_no_tip_does_not() -> None:
    late = Bench().start()
    late.on_phase[GoalPhase.LOOK] = silence("tip", "tracker")
    result = late.do("press:RUN_STOP")
    assert result.code == "late_image" and "the cameras saw the tip 0 times" in result.reason
    assert [report.then for report in delays(late)] == ["waiting up to 6 s", "waiting up to 10 s"]

    unseen = Bench(config(beside_m=0.0)).start()
    unseen.on_phase[GoalPhase.LOOK] = silence("tip")
    result = unseen.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and result.code == "" and not delays(unseen)
    assert "the cameras saw the tip 0 times" in result.reason


def test_a_recognition_that_reports_no_panel_is_not_late() -> None:
    bench = Bench().start()

    def cover(bench: Bench) -> None:
        bench.confidence = 0.05
        silence("tip", "tracker")(bench)

    bench.on_phase[GoalPhase.LOOK] = cover
    result = bench.do("press:RUN_STOP")
    assert "no recognition of the panel for 2.0 s" in result.reason and result.code == ""


def test_after_contact_no_limit_grows_and_no_code_asks_for_a_repetition() -> None:
    bench = Bench().start()
    bench.on_phase[GoalPhase.TOUCH] = silence("camera")
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.ABORTED and result.code == ""
    assert "no image for 1.0 s" in result.reason and "check the panel before you try again" in result.reason
    assert dict(result.details)["delayed"] == "image of the left camera"


def test_late_joint_states_stop_a_motion_and_only_delay_a_machine_at_rest() -> None:
    moving = Bench().start()
    moving.on_phase[GoalPhase.APPROACH] = silence("joints")
    result = moving.do("press:RUN_STOP")
    assert moving.stops == 1 and "no joint_states for 1.0 s" in result.reason and result.code == ""

    resting = Bench().start()
    resting.on_phase[GoalPhase.LOOK] = silence("joints", "tip", "tracker")
    result = resting.do("press:RUN_STOP")
    assert resting.stops == 0 and result.code == "slow" and "no joint_states for 4.0 s" in result.reason


@pytest.mark.parametrize("tries", [1, 2, 3])
def test_a_trajectory_that_reaches_the_driver_late_is_sent_again(tries: int) -> None:
    bench = Bench().start()
    refused = [tries - 1]

    def answer(action: msg.SendTrajectory, outcome: Outcome) -> None:
        assert bench.driver == "moving"
        bench._motion = None
        late = Delay(code=ResultCode.STALE, what="trajectory at the driver", measured_s=1.2, limit_s=1.0)
        stale = GoalResult(
            goal_id=str(action.stamp_ns), goal="", outcome=outcome, code=late.code.value, details=late.details()
        )
        refused[0] -= 1
        if refused[0] == 0:
            bench.answer = Outcome.REACHED
            bench._answer = original  # type: ignore[method-assign]
        bench._say_driver("idle")
        bench.tell(msg.MotionResult(result=stale))

    original = bench._answer
    if tries > 1:
        bench.answer = Outcome.REJECTED
        bench._answer = answer  # type: ignore[method-assign]
    result = bench.go(0.2, 0.1)
    assert result.outcome is Outcome.REACHED, result
    assert [report.then for report in delays(bench)] == [
        f"the controller sends it again, try {n} of 3" for n in range(2, tries + 1)
    ]
    sent = [action for action in bench.actions if isinstance(action, msg.SendTrajectory)]
    assert len({action.stamp_ns for action in sent}) == len(sent) == tries
    assert all(np.array_equal(action.path.points, sent[0].path.points) for action in sent)


def test_a_driver_that_rejects_every_try_ends_the_goal_as_slow_and_one_with_another_reason_at_once() -> None:
    bench = Bench().start()
    bench.answer = Outcome.REJECTED
    late = Delay(code=ResultCode.STALE, what="trajectory at the driver", measured_s=1.2, limit_s=1.0)
    real = bench.tell

    def stale(event: msg.Event) -> None:
        if isinstance(event, msg.MotionResult):
            told = dataclasses.replace(event.result, code=late.code.value, details=late.details())
            event = msg.MotionResult(result=told)
        real(event)

    bench.tell = stale  # type: ignore[method-assign]
    result = bench.go(0.2, 0.1)
    assert result.outcome is Outcome.ABORTED and result.code == "slow" and len(bench.paths) == 3

    other = Bench().start()
    other.answer, other.answer_reason = Outcome.REJECTED, "the driver is 'alarm'"
    result = other.go(0.2, 0.1)
    assert result.code == "" and len(other.paths) == 1


def test_a_goal_is_stale_by_its_sender_and_not_by_the_controllers_own_hold_up() -> None:
    late = Bench().start()
    result = late.go(0.2, 0.1, stamp_ns=late.now_ns - 600 * MS)
    assert result.outcome is Outcome.REJECTED and result.code == "stale"
    delay = delay_of(result)
    assert delay is not None and (delay.what, delay.measured_s, delay.limit_s) == ("goal", 0.6, 0.5)

    held = Bench().start()
    held.now_ns += 1200 * MS
    result = held.go(0.2, 0.1, stamp_ns=held.now_ns - 1100 * MS)
    assert result.outcome is Outcome.REACHED, result

    old = Bench().start()
    old.now_ns += 5 * SECOND
    result = old.go(0.2, 0.1, stamp_ns=old.now_ns - 2001 * MS)
    assert result.outcome is Outcome.REJECTED and result.code == "stale" and not old.paths


def test_a_command_that_may_be_older_than_two_seconds_moves_nothing() -> None:
    bench = Bench().start()
    bench.now_ns += 2100 * MS
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REJECTED and result.code == "stale" and not bench.paths
    bench.run(0.5)
    assert bench.do("press:RUN_STOP").outcome is Outcome.REACHED


@pytest.mark.parametrize("held_ms", [1500, 6000])
def test_a_hold_up_of_the_controller_alone_ends_no_goal(held_ms: int) -> None:
    bench = Bench(config(motion_timeout_s=0.5)).start()

    def hold_up(bench: Bench) -> None:
        bench.now_ns += held_ms * MS  # heartbeat, joint_states, images and the motion's result wait in the queue

    bench.on_phase[GoalPhase.APPROACH] = hold_up
    result = bench.do("press:RUN_STOP")
    assert result.outcome is Outcome.REACHED, result


def test_a_heartbeat_that_stays_away_ends_the_goal_soon_after_a_hold_up() -> None:
    bench = Bench().start()

    def hold_up(bench: Bench) -> None:
        bench.talking.discard("heartbeat")
        bench.now_ns += 1500 * MS
        held_at.append(bench.now_ns)

    held_at: list[int] = []
    bench.on_phase[GoalPhase.APPROACH] = hold_up
    result = bench.do("press:RUN_STOP")
    assert "lost the operator" in result.reason and result.code == ""
    assert bench.readings[2] == 0.0


def test_a_controller_that_is_held_up_all_the_time_still_gives_up_a_motion() -> None:
    bench = Bench(config(motion_timeout_s=1.0)).start()
    bench.tell(msg.PointGoal(frame="base_link", xyz=np.array([0.2, 0.1, 0.0]), stamp_ns=0))
    (sent,) = (action for action in bench.actions if isinstance(action, msg.SendTrajectory))
    limit_s = 1.5 * sent.path.duration_s + 1.0
    began_ns, bench._motion = bench.now_ns, None  # the driver never answers
    while not bench.finals:
        bench.now_ns += 250 * MS
        for event in (msg.OperatorHeartbeat(), msg.Joints(readings=bench.readings.copy()), msg.Tick()):
            bench.tell(event)
        assert bench.now_ns - began_ns < 3 * limit_s * 1e9
    assert "no result of the motion" in bench.finals[0].reason and bench.stops == 1
    assert limit_s < (bench.now_ns - began_ns) / 1e9 < 2 * limit_s + 0.5


def test_a_hold_up_counts_only_until_the_queue_is_empty() -> None:
    hold_up = HoldUp()
    assert hold_up.note(0) == 0.0 and hold_up.note(150 * MS) == 0.0
    assert hold_up.note(1150 * MS) == 1.0 and hold_up.recent_s(1150 * MS) == 1.0
    assert hold_up.note(1360 * MS) == 0.21 and hold_up.recent_s(1360 * MS) == 1.0, "the longer one of two in a row"
    assert hold_up.recent_s(1700 * MS) == 0.0
    assert hold_up.note(100 * MS) == 0.0, "a clock that was set back"
    settings = config(goal_max_age_s=0.5)
    assert [goal_limit_s(held, settings) for held in (0.0, 1.0, 9.0)] == [0.5, 1.5, 2.0]
    assert goal_limit_s(9.0, config(goal_max_age_s=5.0)) == 5.0
