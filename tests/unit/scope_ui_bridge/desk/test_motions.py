"""Moves, and moving on while an arrow is held."""

from __future__ import annotations

import math

import pytest
from unit.scope_ui_bridge.desk_rig import Rig, answer, logged, of_type, refusal

from icu_common.core.geometry.frames import BASE
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.processes.delays import ResultCode
from scope_ui_bridge.core.effects import (
    SendGoal,
)


def test_a_move_goes_to_base_link_with_the_stylus_up() -> None:
    rig = Rig()
    effects = rig.move(120.5, 80.0)
    (goal,) = of_type(effects, SendGoal)
    assert (goal.frame, goal.point, goal.stamp_ns) == (BASE, (0.1205, 0.08), rig.now.ros_ns)
    assert goal.record["frame"] == str(rig.stamp)
    assert logged(effects)[0]["target"] == "(120.5, 80.0) mm"
    assert refusal(rig.move(1.0, 2.0)) == "busy_pending"
    rig.end(goal.stamp_ns)
    rig.desk.machine.set_state("controller", "waiting: not calibrated")
    assert of_type(rig.move(1.0, 2.0), SendGoal), "a move needs no calibration"


def test_goals_are_not_of_the_future_after_the_clock_was_set_back() -> None:
    rig = Rig()
    rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
    (goal,) = of_type(rig.move(1.0, 2.0), SendGoal)
    rig.end(goal.stamp_ns)
    rig.set_s = -600.0
    rig.see()
    (goal,) = of_type(rig.jog(1, 0), SendGoal)
    assert goal.stamp_ns == rig.now.ros_ns, "the controller would refuse it for ten minutes"
    rig.set_s -= 600.0
    (step,) = of_type(rig.end(goal.stamp_ns), SendGoal)
    assert step.stamp_ns == rig.now.ros_ns


@pytest.mark.parametrize("state", ["", "unhomed", "disabled", "moving", "stopped: operator", "alarm: limit"])
def test_a_move_needs_a_machine_at_rest(state: str) -> None:
    rig = Rig()
    rig.desk.machine.set_state("driver", state)
    assert refusal(rig.move(1.0, 2.0)) == "not_at_rest"
    assert refusal(rig.jog(1, 0)) == "not_at_rest"


def test_a_held_jog_goes_on_in_steps_and_ends_when_let_go() -> None:
    rig = Rig()
    rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
    effects = rig.jog(0, 1)
    (goal,) = of_type(effects, SendGoal)
    entry = logged(effects)[0]
    assert (entry["action"], entry["target"], goal.point) == ("jog", "+y", (0.1, 0.055))
    rig.seconds += 0.2
    assert of_type(rig.jog(0, 1), SendGoal) == [], "holding on begins nothing while a step is under way"
    (second,) = of_type(rig.end(goal.stamp_ns), SendGoal)
    assert second.point == pytest.approx((0.1, 0.06))
    assert second.stamp_ns > goal.stamp_ns
    assert second.entry == entry["entry"], "one line of the log for one hold"
    rig.jog(0, 0)
    (ended,) = logged(rig.end(second.stamp_ns))
    assert (ended["entry"], ended["status"]) == (entry["entry"], "reached")


def test_a_jog_step_that_came_too_late_is_sent_again_while_the_button_is_held() -> None:
    rig = Rig()
    rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
    (goal,) = of_type(rig.jog(0, 1), SendGoal)
    stale = GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=Outcome.REJECTED, code=ResultCode.STALE.value)
    rig.wait(0.2, alive=True)
    (again,) = of_type(rig.desk.answers.result(stale, rig.now), SendGoal)
    assert again.point == goal.point and again.stamp_ns > goal.stamp_ns
    assert again.stamp_ns == rig.now.ros_ns, "the new stamp is the time of sending, not of the press"
    rig.wait(0.35, alive=True)  # let go
    late = GoalResult(goal_id=str(again.stamp_ns), goal="", outcome=Outcome.REJECTED, code=ResultCode.STALE.value)
    assert of_type(rig.desk.answers.result(late, rig.now), SendGoal) == []


@pytest.mark.parametrize("how", ["silence", "stop", "release", "rejected"])
def test_a_held_jog_ends_with(how: str) -> None:
    rig = Rig()
    rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
    (goal,) = of_type(rig.jog(-1, 0), SendGoal)
    outcome = Outcome.REACHED
    if how == "silence":
        rig.wait(0.35, alive=True)
    elif how == "stop":
        rig.ask(rig.a, type="stop")
    elif how == "release":
        rig.ask(rig.a, type="lease", step="release")
    else:
        outcome = Outcome.REJECTED
    assert of_type(rig.end(goal.stamp_ns, outcome), SendGoal) == []


@pytest.mark.parametrize("outcome", [Outcome.REJECTED, Outcome.ABORTED])
def test_a_jog_that_was_not_done_is_not_ordered_again_before_it_is_let_go(outcome: Outcome) -> None:
    """At a limit: the page asks again every 100 ms as long as the arrow is held."""
    rig = Rig()
    rig.desk.machine.set_position(0.3, 0.05, 0.0, rig.now)
    (goal,) = of_type(rig.jog(1, 0), SendGoal)
    refused = GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=outcome, reason="x is out of reach")
    rig.desk.answers.result(refused, rig.now)
    for _ in range(100):
        rig.wait(0.1, alive=True)
        rig.desk.machine.set_position(0.3, 0.05, 0.0, rig.now)
        answered = rig.jog(1, 0)
        assert refusal(answered) == "jog_refused"
        assert answer(answered)["values"] == {"what": "x is out of reach"}
    assert of_type(rig.jog(-1, 0), SendGoal), "the other way is free"
    rig.jog(0, 0)
    rig.end(rig.desk._book._last_goal_ns)
    assert of_type(rig.jog(1, 0), SendGoal), "and whoever presses it anew tries again"


def test_a_step_whose_record_was_long_in_writing_is_not_begun_once_it_is_let_go() -> None:
    rig = Rig()
    rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
    (first,) = of_type(rig.jog(1, 0), SendGoal)
    rig.jog(0, 0)
    assert rig.desk.still_wanted(first, rig.now), "a short press is one step"
    rig.wait(0.35, alive=True)
    assert not rig.desk.still_wanted(first, rig.now)
    assert logged(rig.desk.answers.order_failed(first, "let go", rig.now))[0]["status"] == "failed"
    rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
    (first,) = of_type(rig.jog(1, 0), SendGoal)
    for _ in range(5):
        rig.wait(0.2, alive=True)
        rig.jog(1, 0)
    assert rig.desk.still_wanted(first, rig.now), "it is held all the time"
    rig.desk.answers.order_failed(first, "no gantry controller is running", rig.now)
    rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
    assert of_type(rig.jog(1, 0), SendGoal), "what did not go out is begun anew, and not waited for"


def test_a_jog_that_cannot_be_is_refused() -> None:
    rig = Rig()
    assert refusal(rig.jog(1, 0)) == "position_unknown"
    rig.desk.machine.set_position(math.nan, 0.0, 0.0, rig.now)
    assert refusal(rig.jog(1, 0)) == "position_unknown"
    rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
    answered = answer(rig.jog(1, 0, step_mm=10.5))
    assert (answered["code"], answered["values"]) == ("jog_step", {"step_mm": 10.5, "limit_mm": 10.0})
    assert refusal(rig.jog(1, 0, step_mm=0.0)) == "jog_step"
    assert refusal(rig.jog(2, 0)) == "malformed"
    rig.seconds += 0.6
    assert refusal(rig.jog(1, 0)) == "frame_old"
