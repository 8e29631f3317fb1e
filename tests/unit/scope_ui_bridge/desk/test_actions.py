"""From click to command: selections, gestures and their results."""

from __future__ import annotations

import dataclasses

import pytest
from unit.scope_ui_bridge.desk_rig import Rig, logged, of_type, selected

from icu_common.core.geometry.frames import CAMERA_LEFT
from icu_common.core.goals.results import EFFECT_MISSING, EffectMissing, GoalResult, Outcome
from icu_common.core.panel.gesture import Point, parse_gesture
from scope_ui_bridge.core.effects import (
    CallService,
    Record,
    SendCommand,
    SendGoal,
)


def test_a_control_is_selected_then_pressed_and_its_result_is_shown() -> None:
    rig = Rig()
    shown = selected(rig.select(control="RUN_STOP"))
    assert (shown["label"], shown["panel_mm"]) == ("Run / Stop", [200.0, 120.0])
    assert shown["gestures"] == ["press", "double", "long", "hold"]
    effects = rig.act("press")
    (command,) = of_type(effects, SendCommand)
    gesture = parse_gesture(command.text)
    assert (gesture.kind, gesture.target) == ("press", "RUN_STOP")
    assert command.record["frame"] == str(rig.stamp)
    assert command.record["who"] == "Operator 1"
    assert rig.desk.still_wanted(command, rig.now)
    assert logged(effects)[0]["status"] == "sent"
    done = GoalResult(goal_id=gesture.id, goal="", outcome=Outcome.ACCEPTED)
    assert logged(rig.desk.answers.result(done, rig.now))[0]["status"] == "accepted"
    done = GoalResult(
        goal_id=gesture.id,
        goal="",
        outcome=Outcome.REACHED,
        error_m=0.000234,
        duration_s=3.456,
        details=(("error_95_m", "0.000310"),),
    )
    effects = rig.desk.answers.result(done, rig.now)
    entry = logged(effects)[0]
    assert entry["bound_mm"] == of_type(effects, Record)[0].record["bound_mm"] == 0.31
    assert (entry["status"], entry["error_mm"], entry["duration_s"]) == ("reached", 0.234, 3.46)
    assert of_type(effects, Record)[0].record["error_mm"] == 0.234
    assert not rig.desk.moving


@pytest.mark.parametrize(
    ("details", "effect", "error_mm"),
    [
        ((("measured_by", "cameras"), ("effect", "lamp green -> red")), "lamp green -> red", 0.234),
        (
            (
                ("measured_by", "cameras"),
                ("effect", "not looked for"),
                (EFFECT_MISSING, EffectMissing.NOT_LOOKED_FOR.value),
            ),
            "",
            0.234,
        ),
        ((("measured_by", "readings"),), "", None),
    ],
)
def test_what_a_press_did_is_told_and_readings_are_no_measurement(
    details: tuple[tuple[str, str], ...], effect: str, error_mm: float | None
) -> None:
    rig = Rig()
    done = GoalResult(goal_id="7", goal="press:RUN_STOP", outcome=Outcome.REACHED, error_m=0.000234, details=details)
    rig.desk.answers.result(dataclasses.replace(done, outcome=Outcome.ACCEPTED, details=()), rig.now)
    effects = rig.desk.answers.result(done, rig.now)
    assert (logged(effects)[0]["effect"], logged(effects)[0]["error_mm"]) == (effect, error_mm)
    written = of_type(effects, Record)[0].record
    assert (written["effect"], written["error_mm"]) == (effect, error_mm)


def test_a_result_names_its_control_as_the_page_does_elsewhere() -> None:
    rig = Rig()

    def told(goal: str, reason: str, effect: str) -> tuple[str, str]:
        done = GoalResult(
            goal_id=goal, goal=goal, outcome=Outcome.ABORTED, reason=reason, details=(("effect", effect),)
        )
        rig.desk.answers.result(dataclasses.replace(done, outcome=Outcome.ACCEPTED), rig.now)
        (entry,) = logged(rig.desk.answers.result(done, rig.now))
        return entry["reason"], entry["effect"]

    hidden = "something (a hand?) has hidden RUN_STOP for 0.4 s"
    assert told("click:CH1_SCALE:2 id=7", "", "CH1_SCALE at -32.0 degrees") == ("", "Scale at -32.0 degrees")
    assert told("press:RUN_STOP", hidden, "none seen")[0] == hidden.replace("RUN_STOP", "Run / Stop")
    assert told("hold:RUN_STOP:1", "not RUN_STOPPED", "")[0] == "not RUN_STOPPED", "another word"
    assert told("press:0.1,0.05@panel_link", hidden, "")[0] == hidden
    assert told("press:NOBODY", "there is no control NOBODY", "")[0] == "there is no control NOBODY"


@pytest.mark.parametrize(
    ("control", "gesture", "argument", "expected"),
    [("RUN_STOP", "hold", 2.0, ("hold", 2.0)), ("CH1_SCALE", "turn", -15.0, ("turn", -15.0))],
)
def test_hold_and_turn_carry_their_argument(control: str, gesture: str, argument: float, expected: tuple) -> None:
    rig = Rig()
    rig.select(control=control)
    (command,) = of_type(rig.act(gesture, argument), SendCommand)
    sent = parse_gesture(command.text)
    assert (sent.kind, sent.argument) == expected


def test_a_press_on_a_point_is_a_pixel_goal_and_a_hold_is_a_gesture_there() -> None:
    rig = Rig()
    shown = selected(rig.select(u=700.0, v=300.0))
    # 700 px is 60.5 px right of the axis: 60.5 / 1700 * 0.65 m = 23.1 mm from the centre at 160 mm (distortion: < 0.1)
    assert shown["panel_mm"] == pytest.approx([183.1, 97.8], abs=0.1)
    (goal,) = of_type(rig.act("press"), SendGoal)
    assert (goal.frame, goal.point) == (CAMERA_LEFT, (700.0, 300.0))
    assert goal.stamp_ns == rig.now.ros_ns
    finished = GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=Outcome.REJECTED, reason="too far")
    assert logged(rig.desk.answers.result(finished, rig.now))[0]["reason"] == "too far"
    (command,) = of_type(rig.act("hold", 1.5), SendCommand)
    sent = parse_gesture(command.text)
    assert sent.target == Point(x=700.0, y=300.0, frame="camera_left_optical_frame")


def test_goals_of_one_moment_still_have_names_of_their_own() -> None:
    rig = Rig()
    rig.select(u=700.0, v=300.0)
    stamps = []
    for _ in range(2):
        (goal,) = of_type(rig.act("press"), SendGoal)
        stamps.append(goal.stamp_ns)
        done = GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=Outcome.REJECTED)
        rig.desk.answers.result(done, rig.now)
    assert stamps[0] < stamps[1]


def test_results_of_others_are_shown_too() -> None:
    rig = Rig()
    started = GoalResult(goal_id="turn:CH1_SCALE:30", goal="turn:CH1_SCALE:30.0 id=7", outcome=Outcome.ACCEPTED)
    assert logged(rig.desk.answers.result(started, rig.now))[0] | {"entry": 0, "wall_ms": 0} == {
        "entry": 0,
        "wall_ms": 0,
        "who": "Graph",
        "action": "turn 30",
        "target": "Scale",
        "status": "accepted",
        "reason": "",
        "error_mm": None,
        "bound_mm": None,
        "duration_s": None,
        "effect": "",
        "touch": "",
    }
    assert rig.desk.moving
    for goal in ("press:UNKNOWN", "press:0.1,0.2@base_link", "move to (0.1, 0.2, 0) m in base_link"):
        started = GoalResult(goal_id=goal, goal=goal, outcome=Outcome.ACCEPTED)
        (entry,) = logged(rig.desk.answers.result(started, rig.now))
        assert (entry["action"], entry["target"]) == (goal, ""), "what has no name here stays as it was published"


def test_services_are_called_and_their_answers_shown() -> None:
    rig = Rig()
    (call,) = of_type(rig.ask(rig.a, type="call", service="home"), CallService)
    assert call.service == "home"
    assert not rig.desk.moving, "asking is not moving; the driver says homing"
    entry = logged(rig.desk.answers.service_answered(call.entry, False, "not enabled", rig.now))[0]
    assert (entry["status"], entry["reason"]) == ("rejected", "not enabled")
