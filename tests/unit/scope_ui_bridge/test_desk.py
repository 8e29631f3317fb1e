"""The desk: what a click becomes, when it is refused, and when the machine is stopped."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import pytest
from unit.scope_ui_bridge.desk_rig import BOOT, Rig, answer, logged, of_type, pose, refusal, selected, shown_selections

from icu_common.core.geometry.frames import BASE, CAMERA_LEFT
from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.gesture import Gesture, Point, parse_gesture
from icu_common.core.processes.delays import ResultCode
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.access import SHORT, Role
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.effects import (
    Broadcast,
    CallService,
    Effect,
    End,
    Heartbeat,
    Order,
    Record,
    Send,
    SendCommand,
    SendGoal,
    StopNow,
)
from scope_ui_bridge.core.status import split_state

# --- from click to command ---


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
        ((("measured_by", "cameras"), ("effect", "not looked for")), "", 0.234),
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


# --- refusals ---


def test_a_click_on_an_old_picture_is_refused_with_age_and_bound() -> None:
    rig = Rig()
    rig.seconds += 0.51
    answered = answer(rig.select(control="RUN_STOP"))
    assert (answered["code"], answered["values"]) == ("frame_old", {"age_ms": 510, "limit_ms": 500})


def test_a_picture_in_many_forms_is_remembered_as_long_as_in_one() -> None:
    rig = Rig(BridgeConfig(frame_max_age_s=2.0))
    for number in range(1, 31):  # two seconds at 15 pictures a second
        for _ in range(5):  # pages behind five kinds of links
            rig.desk.machine.frame_offered("left", rig.stamp + number)
    rig.seconds += 1.9
    assert answer(rig.select(control="RUN_STOP"))["ok"]


def test_a_click_on_a_picture_that_was_never_sent_is_refused() -> None:
    assert refusal(Rig().select(control="RUN_STOP", stamp="123")) == "frame_unknown"


def test_a_picture_from_the_future_is_refused_since_its_age_is_not_known() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    ahead = rig.now.ros_ns + 150_000_000
    rig.desk.machine.frame_offered("left", ahead)
    answered = answer(rig.act(stamp=str(ahead)))
    assert (answered["code"], answered["values"]) == ("frame_ahead", {"ahead_ms": 150, "limit_ms": 100})
    slightly = rig.now.ros_ns + 50_000_000
    rig.desk.machine.frame_offered("left", slightly)
    assert of_type(rig.act(stamp=str(slightly)), SendCommand), "clocks never agree wholly"


def test_a_selection_can_be_confirmed_later_but_only_on_a_fresh_picture() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    old = str(rig.stamp)
    rig.wait(3.0, alive=True)
    assert refusal(rig.act(stamp=old)) == "frame_old"
    assert of_type(rig.act(), SendCommand)


def test_a_control_stays_selected_though_cameras_on_the_carriage_have_moved() -> None:
    """Each press moved them, and the next one of the same control was refused for a panel that moved by as much."""
    for shift_m, panel_m in ((0.1, 0.0), (0.1, 0.0025)):
        rig = Rig()
        camera_from_base = Transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 0.6]))
        rig.desk.scene.camera_from_base = camera_from_base
        rig.select(control="RUN_STOP")
        gone = np.array([shift_m, 0.0, 0.0])
        rig.desk.scene.camera_from_base = Transform(camera_from_base.rotation, camera_from_base.translation + gone)
        rig.desk.scene.place_panel(pose(shift_m + panel_m))
        if panel_m:
            assert answer(rig.act())["values"] == {"moved_mm": 2.5, "limit_mm": 2.0}
        else:
            assert of_type(rig.act(), SendCommand)
    rig.select(u=600.0, v=300.0)
    rig.desk.scene.camera_from_base = camera_from_base
    rig.desk.scene.place_panel(pose(0.0))
    assert refusal(rig.act()) == "panel_moved", "a pixel is another place then"


def test_a_panel_that_moved_since_the_selection_voids_it() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.desk.scene.place_panel(pose(0.0015))
    assert of_type(rig.act(), SendCommand), "1.5 mm is within the bound of 2 mm"
    rig.desk.answers.order_failed(Order(entry=2, stops=0, epoch=1, record={}), "test", rig.now)
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.desk.scene.place_panel(pose(0.0025))
    answered = answer(rig.act())
    assert (answered["code"], answered["values"]) == ("panel_moved", {"moved_mm": 2.5, "limit_mm": 2.0})
    assert refusal(rig.act()) == "selection_gone"


@pytest.mark.parametrize("there", [True, False])
def test_a_selection_is_void_on_another_panel_that_has_a_control_of_the_same_name(there: bool) -> None:
    """A panel was taught, or recognition was started anew for another one, since RUN_STOP was chosen."""
    rig = Rig()
    rig.select(control="RUN_STOP")
    run_stop, *others = rig.desk.scene.faces
    rig.desk.scene.faces = (dataclasses.replace(run_stop, centre=(0.05, 0.03, 0.003)), *others) if there else ()
    assert refusal(rig.act()) == "selection_gone"
    assert shown_selections(rig.act()) == []
    assert rig.desk.join("Operator 2")[1]["selection"] is None
    if there:
        rig.select(control="RUN_STOP")
        rig.desk.scene.faces = tuple(dataclasses.replace(face) for face in rig.desk.scene.faces)
        assert of_type(rig.act(), SendCommand), "the same panel, told once more"


@pytest.mark.parametrize(
    ("choice", "code"),
    [
        ({"control": "CH1_IN"}, "not_operable"),
        ({"u": 5.0, "v": 5.0}, "off_panel"),
        ({"control": "CH1_SCALE", "stamp": "1"}, "frame_unknown"),
    ],
)
def test_a_click_that_is_refused_leaves_nothing_selected(choice: dict[str, Any], code: str) -> None:
    """Who has just clicked on something else and confirms does not mean what was selected before."""
    rig = Rig()
    rig.select(control="RUN_STOP")
    effects = rig.select(**choice)
    assert answer(effects)["code"] == code
    assert shown_selections(effects) == [None]
    assert refusal(rig.act()) == "selection_gone"
    assert shown_selections(rig.select(**choice)) == [], "said once"


def test_pages_are_told_that_the_selection_is_void_since_the_panel_has_moved() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.desk.scene.place_panel(pose(0.0025))
    assert shown_selections(rig.act()) == [None]


@pytest.mark.parametrize("u, v", [(1e9, -1e9), (-1.0, 300.0), (640.0, 720.0), (592.0, -1.6e9)])
def test_a_point_outside_the_picture_is_refused(u: float, v: float) -> None:
    rig = Rig()
    answered = answer(rig.select(u=u, v=v))
    assert (answered["code"], answered["values"]) == ("off_picture", {"u": u, "v": v, "width": 1280, "height": 720})
    assert answer(rig.select(u=u, v=v, to_u=600.0, to_v=300.0))["code"] == "off_picture"


@pytest.mark.parametrize(
    ("confidence", "code"), [(0.0, "low_confidence"), (0.49, "low_confidence"), (math.nan, "panel_not_seen")]
)
def test_low_confidence_refuses_selection_and_action(confidence: float, code: str) -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.see(confidence)
    assert refusal(rig.act()) == code
    assert refusal(rig.select(control="RUN_STOP")) == code


def test_a_silent_recognition_refuses() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.wait(2.1, alive=True, see=False)
    rig.stamp = rig.now.ros_ns
    rig.desk.machine.frame_offered("left", rig.stamp)
    assert refusal(rig.act()) == "recognition_silent"


@pytest.mark.parametrize(
    ("state", "code"),
    [("", "no_controller"), ("waiting: not homed", "not_ready"), ("moving", "not_ready"), ("stopped: x", "not_ready")],
)
def test_a_controller_that_is_not_ready_refuses_with_its_reason(state: str, code: str) -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.desk.machine.set_state("controller", state)
    answered = answer(rig.act())
    assert answered["code"] == code
    if code == "not_ready":
        assert f"{answered['values']['state']}: {answered['values']['reason']}".strip(": ") == state
    shown = [e.message for e in of_type(rig.wait(0.2, alive=True), Broadcast) if e.message["type"] == "state"]
    assert shown[-1]["refusal"]["code"] == code, "the page shows the reason before anybody clicks"


def test_what_cannot_be_done_is_refused() -> None:
    rig = Rig()
    assert refusal(rig.select(control="NO_SUCH")) == "unknown_control"
    assert refusal(rig.select(control="CH1_IN")) == "not_operable"
    assert refusal(rig.select(u=5.0, v=5.0)) == "off_panel"
    rig.desk.machine.frame_offered("right", rig.stamp)
    assert refusal(rig.select(camera="right", u=700.0, v=300.0)) == "point_needs_left"
    assert refusal(rig.act()) == "selection_gone"
    rig.select(control="RUN_STOP")
    assert refusal(rig.act("turn", 10.0)) == "wrong_gesture"
    assert refusal(rig.act("hold", 31.0)) == "bad_gesture"
    assert refusal(rig.act(selection=0)) == "selection_gone"


def test_one_command_at_a_time() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    assert of_type(rig.act(), SendCommand)
    assert refusal(rig.act()) == "busy_pending"


def test_a_command_without_an_answer_fails_visibly_and_frees_the_desk() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.act()
    effects = rig.wait(3.2, alive=True)
    assert [entry["status"] for entry in logged(effects)] == ["no_answer"]
    (line,) = of_type(effects, Record)
    assert (line.record["command"], line.record["result"]) == ("press", "no_answer")
    assert of_type(rig.act(), SendCommand)


def test_an_order_that_is_held_up_until_it_is_given_up_does_not_go_out_any_more() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    (command,) = of_type(rig.act(), SendCommand)  # its record waits for a disk that hangs
    rig.wait(2.8, alive=True)
    assert rig.desk.still_wanted(command, rig.now)
    rig.wait(0.4, alive=True)
    (again,) = of_type(rig.act(), SendCommand)
    assert not rig.desk.still_wanted(command, rig.now), "both would press a button that was meant to be pressed once"
    assert rig.desk.still_wanted(again, rig.now)


def test_an_order_does_not_go_out_when_the_bridge_goes_on_after_it_stood_still() -> None:
    """Its record was written while the process was stopped; that is heard before the watchdogs have looked."""
    rig = Rig()
    rig.wait(0.2, alive=True)
    rig.select(control="RUN_STOP")
    (command,) = of_type(rig.act(), SendCommand)
    rig.seconds += 0.5
    assert rig.desk.still_wanted(command, rig.now), "a hiccup costs nothing"
    rig.seconds += 0.2
    assert not rig.desk.still_wanted(command, rig.now), "what moves would have been stopped"
    assert of_type(rig.desk.tick(rig.now), StopNow)


def test_a_recording_that_ended_by_itself_is_in_the_log_and_in_the_records() -> None:
    rig = Rig()
    effects = rig.desk.answers.recording_ended(False, "the disk is full", rig.now)
    (entry,) = logged(effects)
    assert (entry["who"], entry["action"], entry["status"]) == ("bag_record", "end_record", "failed")
    assert entry["reason"] == "the disk is full"
    (line,) = of_type(effects, Record)
    assert (line.record["command"], line.record["result"]) == ("end_record", "failed")
    assert logged(rig.desk.answers.recording_ended(True, "7 messages", rig.now))[0]["status"] == "done"
    assert not rig.desk.moving


def test_a_recorder_may_take_its_time_and_holds_nobody_up() -> None:
    rig = Rig()
    rig.ask(rig.a, type="call", service="end_record")
    rig.select(control="RUN_STOP")
    assert of_type(rig.act(), SendCommand)
    ended = [(entry["action"], entry["status"]) for entry in logged(rig.wait(30.0, alive=True))]
    assert ended == [("press", "no_answer")]
    ended = [(entry["action"], entry["status"]) for entry in logged(rig.wait(31.0, alive=True))]
    assert ended == [("end_record", "no_answer")]


def test_an_accepted_goal_whose_end_was_lost_is_given_up_once_the_controller_rests() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    (command,) = of_type(rig.act(), SendCommand)
    rig.desk.answers.result(
        GoalResult(goal_id=parse_gesture(command.text).id, goal="", outcome=Outcome.ACCEPTED), rig.now
    )
    rig.desk.machine.set_state("controller", "moving")
    assert logged(rig.wait(10.0, alive=True)) == [], "a goal may take its time"
    rig.desk.machine.set_state("controller", "ready")
    assert [entry["status"] for entry in logged(rig.wait(3.2, alive=True))] == ["no_answer"]


# --- moves, and moving on while held ---


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
    rig.desk.answers.order_failed(first, "no gantry controller listens", rig.now)
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


# --- who may ---


def test_a_viewer_may_stop_and_never_gets_control() -> None:
    rig = Rig(operator=False)
    viewer, hello = rig.desk.join("Guest", Role.VIEWER)
    assert hello["you"]["role"] == "viewer"
    for step in ("take", "request"):
        answered = answer(rig.ask(viewer, type="lease", step=step))
        assert (answered["code"], answered["values"]["role"]) == ("role_needed", "operator")
    assert rig.desk.lease.holder == ""
    assert of_type(rig.ask(viewer, type="stop"), StopNow)


def test_a_recorded_session_is_looked_at_only() -> None:
    rig = Rig(BridgeConfig(replay=True), operator=False)
    for step in ("take", "request"):
        assert refusal(rig.ask(rig.a, type="lease", step=step)) == "replay"
    assert refusal(rig.ask(rig.a, type="call", service="home")) == "no_lease"
    assert rig.hello["replay"] is True
    assert of_type(rig.ask(rig.a, type="stop"), StopNow), "a stop is always good"


def test_what_programs_say_goes_to_engineers_and_their_reports_to_all() -> None:
    rig = Rig()
    engineer, _ = rig.desk.join("Ada", Role.ENGINEER)
    for number in range(60):
        rig.desk.said({"wall_ms": 1, "level": "warn", "name": "serial_driver", "text": f"line {number}"})
    rig.desk.machine.set_facts("calibration", {"rms_mm": "0.03"})
    effects = rig.wait(0.05, alive=True)
    (said,) = [e for e in of_type(effects, Send) if e.message["type"] == "console"]
    assert said.viewer == engineer
    assert len(said.message["lines"]) == 40, "a chatty program does not fill the link"
    (facts,) = [e.message["facts"] for e in of_type(effects, Broadcast) if e.message["type"] == "facts"]
    assert facts == {"calibration": {"rms_mm": "0.03"}}
    later = rig.wait(0.2, alive=True)
    assert not [e for e in of_type(later, (Send, Broadcast)) if e.message["type"] in ("console", "facts")]


def test_an_engineer_who_comes_later_reads_what_was_said_before() -> None:
    rig = Rig()
    for number in range(150):
        rig.desk.said({"wall_ms": number, "level": "warn", "name": "serial_driver", "text": f"line {number}"})
        rig.wait(0.05, alive=True)
    rig.desk.said({"wall_ms": 150, "level": "error", "name": "serial_driver", "text": "line 150"})
    _, viewers = rig.desk.join("Guest", Role.VIEWER)
    engineer, hello = rig.desk.join("Ada", Role.ENGINEER)
    assert (viewers["console"], [line["text"] for line in hello["console"]]) == (
        [],
        [f"line {n}" for n in range(50, 150)],
    )
    (said,) = [e for e in of_type(rig.wait(0.05, alive=True), Send) if e.message["type"] == "console"]
    assert (said.viewer, [line["text"] for line in said.message["lines"]]) == (engineer, ["line 150"]), "once each"


def test_other_settings_are_accepted_by_engineers_only() -> None:
    rig = Rig()
    assert refusal(rig.ask(rig.a, type="call", service="accept_settings")) == "role_needed"
    rig.ask(rig.a, type="lease", step="release")
    engineer, _ = rig.desk.join("Ada", Role.ENGINEER)
    rig.ask(engineer, type="lease", step="take")
    assert of_type(rig.ask(engineer, type="call", service="accept_settings"), CallService)


def test_without_the_lease_nothing_but_stop_is_done() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Operator 2")
    head = {"camera": "left", "stamp": str(rig.stamp)}
    assert refusal(rig.ask(viewer, type="select", control="RUN_STOP", **head)) == "no_lease"
    assert refusal(rig.ask(viewer, type="act", gesture="press", selection=1, **head)) == "no_lease"
    assert refusal(rig.ask(viewer, type="call", service="home")) == "no_lease"
    assert refusal(rig.ask(viewer, type="lease", step="take")) == "lease_held"
    effects = rig.ask(viewer, type="stop")
    assert of_type(effects, StopNow)
    assert logged(effects)[0]["who"] == "Operator 2"


def test_replays_stale_epochs_and_old_boots_are_refused_but_a_stop_is_always_good() -> None:
    rig = Rig()
    message = {"type": "call", "service": "home", "seq": 50, "boot": BOOT, "epoch": 1}
    assert of_type(rig.desk.message(rig.a, json.dumps(message), rig.now), CallService)
    assert refusal(rig.desk.message(rig.a, json.dumps(message), rig.now)) == "replayed"
    assert refusal(rig.desk.message(rig.a, json.dumps(message | {"seq": 51, "epoch": 0}), rig.now)) == "stale_epoch"
    assert refusal(rig.desk.message(rig.a, json.dumps(message | {"seq": 52, "boot": "old"}), rig.now)) == "old_boot"
    stop = {"type": "stop", "seq": 1, "boot": "old", "epoch": 0}
    assert of_type(rig.desk.message(rig.a, json.dumps(stop), rig.now), StopNow)


def test_a_flood_is_dropped_unread_and_then_ended_and_the_stop_in_it_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    read: list[str] = []
    monkeypatch.setattr(wire, "decode", lambda text, real=wire.decode: read.append(text) or real(text))
    answers = [rig.ask(rig.a, type="call", service="enable") for _ in range(159)]
    codes = [e.message.get("code") for effects in answers for e in of_type(effects, Send)]
    assert codes.count("rate_limited") == 1, "told once a second, not with every message"
    assert answers[-1] == []
    assert len(read) <= 80
    assert of_type(rig.ask(rig.a, type="stop"), StopNow)
    assert rig.ask(rig.a, type="call", service="enable") == [End(viewer=rig.a)]
    rig.seconds += 2.0
    (alive,) = of_type(rig.ask(rig.a, type="alive", client_ms=5.0), Send)
    clocks = {"bridge_ms": rig.seconds * 1e3, "wall_ms": rig.now.wall_s * 1e3}
    assert alive.message == {"type": "alive", "client_ms": 5.0, **clocks}


def test_a_flood_of_garbage_is_answered_as_seldom_as_any_other() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Operator 2")
    effects = [e for _ in range(500) for e in rig.desk.message(viewer, "{", rig.now)]
    assert [e.message["code"] for e in of_type(effects, Send)] == ["malformed"] * 80 + ["rate_limited"]
    assert effects[-1] == End(viewer=viewer)
    assert of_type(rig.ask(viewer, type="stop"), StopNow)


def test_a_flood_of_stops_stops_and_is_ended_as_any_other() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Eve", Role.VIEWER)
    effects = [e for _ in range(500) for e in rig.ask(viewer, type="stop")]
    assert len(of_type(effects, StopNow)) == 1
    assert effects[-1] == End(viewer=viewer)


def test_only_the_page_in_control_may_send_long_messages() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Eve", Role.ENGINEER)
    long = {"type": "sequence", "steps": ["press:RUN_STOP => effect"] * 99, "camera": "left", "stamp": str(rig.stamp)}
    (answer,) = of_type(rig.ask(viewer, **long), Send)
    assert answer.message["code"] == "oversized" and answer.message["values"]["limit"] == SHORT
    assert answer.message["seq"] is not None, "the answer names the rejected message"
    assert "oversized" not in str(rig.ask(rig.a, **long))


def test_hand_over_is_asked_for_and_not_done_while_something_moves() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    other, _ = rig.desk.join("Operator 2")
    rig.ask(other, type="lease", step="request")
    rig.desk.machine.set_state("driver", "moving")
    assert refusal(rig.ask(rig.a, type="lease", step="grant", to=other)) == "busy_moving"
    rig.desk.machine.set_state("driver", "idle")
    effects = rig.ask(rig.a, type="lease", step="grant", to=other)
    assert rig.desk.lease.holder == other
    assert {"type": "selection", "selection": None} in [e.message for e in of_type(effects, Broadcast)]
    assert refusal(rig.select(control="RUN_STOP")) == "no_lease"


def test_control_is_handed_over_only_to_whose_request_was_read() -> None:
    rig = Rig()
    read, _ = rig.desk.join("Operator 2")
    quick, _ = rig.desk.join("Operator 3")
    rig.ask(read, type="lease", step="request")
    rig.ask(quick, type="lease", step="request")
    assert refusal(rig.ask(rig.a, type="lease", step="grant", to=read)) == "other_request"
    assert refusal(rig.ask(rig.a, type="lease", step="decline", to=read)) == "other_request"
    assert refusal(rig.ask(rig.a, type="lease", step="grant")) == "malformed"
    assert (rig.desk.lease.holder, rig.desk.lease.requester) == (rig.a, quick)
    assert answer(rig.ask(rig.a, type="lease", step="grant", to=quick))["ok"]
    assert rig.desk.lease.holder == quick


def control_lines(effects: list[Effect]) -> list[tuple[str, str, str, str, str]]:
    """Return what the audit file is told of who has control: who did what to whom, which page, and why."""
    fields = ("who", "command", "target", "page", "reason")
    lines = [e.record for e in of_type(effects, Record) if e.record["command"].endswith(" control")]
    assert all(line["result"] == "done" and line["wall_s"] > 1.7e9 for line in lines)
    return [tuple(str(line.get(field, "")) for field in fields) for line in lines]  # type: ignore[misc]


def test_the_audit_file_tells_who_was_in_control_at_each_moment() -> None:
    rig = Rig(operator=False)
    other, _ = rig.desk.join("Operator 2")
    control = lambda viewer, step, **more: control_lines(rig.ask(viewer, type="lease", step=step, **more))  # noqa: E731
    assert control(rig.a, "take") == [("Operator 1", "take control", "", rig.a, "")]
    assert control(rig.a, "take") == control(other, "take") == control(other, "request") == [], "nothing has changed"
    assert control(rig.a, "decline", to=other) == control(other, "request") == []
    assert control(rig.a, "grant", to=other) == [("Operator 1", "hand over control", "Operator 2", other, "")]
    assert control(rig.a, "release") == [], "who has none gives none up"
    assert control(other, "release") == [("Operator 2", "release control", "", other, "")]
    assert control(rig.a, "request") == [("Operator 1", "take control", "", rig.a, "")], "what is free is taken"
    assert control_lines(rig.desk.leave(other, rig.now)) == []
    assert control_lines(rig.wait(5.2)) == [("Operator 1", "lose control", "", rig.a, "link lost")]
    control(rig.a, "take")
    gone = rig.desk.leave(rig.a, rig.now, "stopped_signed_out")
    assert control_lines(gone) == [("Operator 1", "lose control", "", rig.a, "signed out")]


@pytest.mark.parametrize("how", ["hidden", "silent", "gone", "released"])
def test_the_stop_goes_out_before_it_is_written_who_lost_control(how: str) -> None:
    rig = Rig()
    rig.desk.machine.set_state("driver", "moving")
    if how == "hidden":
        effects = rig.ask(rig.a, type="hidden")
    elif how == "silent":
        effects = rig.wait(0.7)
    else:
        effects = rig.desk.leave(rig.a, rig.now) if how == "gone" else rig.ask(rig.a, type="lease", step="release")
    stop, passed = (e for e in effects if isinstance(e, (StopNow, Record)))
    assert isinstance(stop, StopNow)
    ((_, command, _, _, reason),) = control_lines([passed])
    why = {"hidden": "page hidden", "silent": "link lost", "gone": "page gone", "released": ""}[how]
    assert (command, reason) == ("release control" if how == "released" else "lose control", why)
    assert passed.record["epoch"] == rig.desk.lease.epoch


def test_there_is_room_for_so_many_pages() -> None:
    rig = Rig(BridgeConfig(max_viewers=1))
    with pytest.raises(Exception, match="too_many_viewers limit=1"):
        rig.desk.join("Operator 2")
    rig.desk.join("Operator 1")
    for page in ("v1", "v2"):
        rig.desk.leave(page, rig.now)
    rig.desk.join("Operator 2")
    rig.desk.join("Operator 1")


# --- heartbeat and watchdog ---


def test_the_heartbeat_follows_the_operators_keep_alives() -> None:
    rig = Rig()
    assert 9 <= len(of_type(rig.wait(1.0, alive=True), Heartbeat)) <= 10
    assert of_type(rig.wait(0.3), Heartbeat)
    rig.wait(0.15)
    silent = rig.wait(1.6)
    assert of_type(silent, Heartbeat) == [], "none after 400 ms of silence"
    assert of_type(silent, StopNow) == [], "nothing moves, so there is nothing to stop"
    assert of_type(rig.wait(0.5, alive=True), Heartbeat)


def test_without_an_operator_there_is_no_heartbeat_even_with_live_viewers() -> None:
    rig = Rig(operator=False)
    assert of_type(rig.wait(2.0, alive=True), Heartbeat) == []


@pytest.mark.parametrize("moving", ["driver", "controller", "calibration", "pending"])
def test_600_ms_of_silence_while_something_moves_stops_it_once_and_takes_the_lease(moving: str) -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    if moving == "pending":
        rig.act()
    else:
        rig.desk.machine.set_state(moving, {"calibration": "calibrating 3/12"}.get(moving, "moving"))
    assert of_type(rig.wait(0.55), StopNow) == []
    effects = rig.wait(0.1)
    (stop,) = of_type(effects, StopNow)
    assert (stop.record["who"], stop.record["target"]) == ("Watchdog", "stopped_link_lost")
    assert rig.desk.lease.holder == ""
    assert of_type(rig.wait(2.0, alive=True), (Heartbeat, StopNow)) == [], "nothing resumes by itself"
    assert refusal(rig.act()) == "no_lease"


def test_a_motion_whose_pictures_stop_is_stopped_once() -> None:
    rig = Rig()
    rig.desk.machine.picture_came(rig.now)
    rig.desk.machine.set_state("driver", "moving")
    assert of_type(rig.wait(0.55, alive=True), StopNow) == []
    (stop,) = of_type(rig.wait(0.5, alive=True), StopNow)
    assert stop.record["target"] == "stopped_no_picture"
    assert rig.desk.lease.holder == rig.a


def test_a_motion_begun_without_pictures_or_by_nobody_here_goes_on() -> None:
    rig = Rig()
    rig.desk.machine.picture_came(rig.now)
    rig.wait(3.0, alive=True)
    rig.desk.machine.set_state("driver", "homing")
    assert of_type(rig.wait(3.0, alive=True), StopNow) == [], "homing needs no picture"
    rig = Rig(operator=False)
    rig.desk.machine.picture_came(rig.now)
    rig.desk.machine.set_state("driver", "moving")
    assert of_type(rig.wait(3.0), StopNow) == []


def test_a_page_that_goes_away_stops_what_it_moved_at_once() -> None:
    rig = Rig()
    rig.desk.machine.set_state("controller", "touching")
    (stop,) = of_type(rig.desk.leave(rig.a, rig.now), StopNow)
    assert stop.record["target"] == "stopped_page_gone"
    rig = Rig()
    assert of_type(rig.desk.leave(rig.a, rig.now), StopNow) == []
    assert rig.desk.lease.holder == ""


def test_a_viewers_page_may_go_away_while_others_work() -> None:
    rig = Rig()
    viewer, _ = rig.desk.join("Operator 2")
    rig.desk.machine.set_state("controller", "moving")
    assert rig.desk.leave(viewer, rig.now) == []
    assert rig.desk.lease.holder == rig.a


def test_what_others_move_from_the_command_line_is_not_stopped_without_an_operator() -> None:
    rig = Rig(operator=False)
    rig.desk.machine.set_state("controller", "moving")
    assert of_type(rig.wait(2.0), StopNow) == []


def test_an_idle_operator_loses_control_after_the_timeout() -> None:
    rig = Rig()
    assert of_type(rig.wait(5.2), StopNow) == []
    assert rig.desk.lease.holder == ""


@pytest.mark.parametrize("timeout_s", [2.0, 8.0])
def test_a_change_of_the_timeout_is_in_force_at_once(timeout_s: float) -> None:
    rig = Rig()
    rig.desk.config = BridgeConfig(lease_timeout_s=timeout_s)
    rig.wait(timeout_s - 0.2)
    assert rig.desk.lease.holder == rig.a
    rig.wait(0.4)
    assert rig.desk.lease.holder == ""


def test_a_stop_voids_an_order_that_has_not_gone_out() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    (command,) = of_type(rig.act(), SendCommand)
    rig.ask(rig.a, type="stop")
    assert not rig.desk.still_wanted(command, rig.now)
    effects = rig.desk.answers.order_failed(command, "stopped", rig.now)
    assert logged(effects)[0]["status"] == "failed"
    (line,) = of_type(effects, Record)
    assert (line.record["result"], line.record["reason"]) == ("failed", "stopped"), (
        "the records tell that it did not go out"
    )
    rig.select(control="RUN_STOP")
    (command,) = of_type(rig.act(), SendCommand)
    rig.ask(rig.a, type="lease", step="release")
    assert not rig.desk.still_wanted(command, rig.now)


def test_one_press_of_stop_is_one_stop_however_late_its_second_way_is() -> None:
    rig = Rig()
    assert of_type(rig.ask(rig.a, type="stop", press="p1"), StopNow)
    rig.seconds += 3.0
    assert rig.desk.stop("Operator 1", rig.now, press="p1") == []
    assert of_type(rig.desk.stop("Operator 1", rig.now, press="p2"), StopNow)


def test_what_was_sent_before_a_stop_and_comes_after_it_is_not_done() -> None:
    """The connection hangs: reset, home and STOP are pressed, and STOP alone comes at once, as a request."""
    rig = Rig()
    rig.select(control="RUN_STOP")
    assert of_type(rig.desk.stop("Operator 1", rig.now, press="p1"), StopNow)
    rig.desk.stop_overtakes(rig.a, "Operator 1", rig.seq + 4)
    for service in ("reset", "home"):
        assert refusal(rig.ask(rig.a, type="call", service=service)) == "before_stop"
    assert refusal(rig.act()) == "before_stop"
    assert of_type(rig.ask(rig.a, type="stop", press="p1"), StopNow) == []
    (reset,) = of_type(rig.ask(rig.a, type="call", service="reset"), CallService)  # this was pressed afterwards
    rig.desk.answers.service_answered(reset.entry, True, "", rig.now)
    rig.desk.stop_overtakes("v99", "Operator 1", 1000)
    rig.desk.stop_overtakes(rig.a, "Operator 2", 1000)
    rig.desk.stop_overtakes(rig.a, "Operator 1", 1)
    assert of_type(rig.act(), SendCommand), "a page that is gone, somebody else, and a late request void nothing more"


def test_stops_that_follow_each_other_quickly_are_one_stop() -> None:
    rig = Rig()
    assert len(of_type(rig.desk.stop("Operator 1", rig.now), StopNow)) == 1
    assert rig.desk.stop("Operator 1", rig.now) == [], "a second one would end the lifting of the stylus"
    assert of_type(rig.desk.stop("Operator 2", rig.now), StopNow), "another person's stop is another stop"
    rig.seconds += 0.6
    assert of_type(rig.desk.stop("Operator 2", rig.now), StopNow)
    rig.ask(rig.a, type="call", service="reset")
    assert of_type(rig.desk.stop("Operator 2", rig.now), StopNow), "something was ordered in between"


def test_a_stop_is_done_when_the_driver_has_answered_and_not_before() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    effects = rig.ask(rig.a, type="stop")
    (stop,) = of_type(effects, StopNow)
    (entry,) = logged(effects)
    assert (entry["action"], entry["status"], entry["entry"]) == ("stop", "sent", stop.entry)
    assert not rig.desk.moving, "it is no motion that is waited for"
    assert of_type(rig.act(), SendCommand), "and it holds nobody up"
    effects = rig.desk.answers.service_answered(stop.entry, True, "", rig.now)
    assert (logged(effects)[0]["status"], logged(effects)[0]["reason"]) == ("done", "")
    (line,) = of_type(effects, Record)
    assert (line.record["command"], line.record["result"]) == ("stop", "done")


def test_a_stop_whose_answer_was_lost_is_done_when_the_driver_says_that_it_has_stopped() -> None:
    rig = Rig()
    rig.ask(rig.a, type="stop")
    rig.desk.set_state("driver", "stopped: stop requested")
    assert [entry["status"] for entry in logged(rig.wait(4.0, alive=True))] == ["done"]


def test_a_stop_that_nobody_heard_is_not_told_to_be_done() -> None:
    rig = Rig()
    (alone,) = of_type(rig.ask(rig.a, type="stop"), StopNow)
    (failed,) = logged(rig.desk.answers.service_answered(alone.entry, False, "no driver listens", rig.now))
    assert (failed["status"], failed["reason"]) == ("failed", "no driver listens")
    for press in ("again", "and again"):
        rig.seconds += 1.0
        rig.ask(rig.a, type="stop", press=press)
    effects = rig.wait(3.2, alive=True)
    assert [entry["status"] for entry in logged(effects)] == ["no_answer", "no_answer"]
    assert {e.record["result"] for e in of_type(effects, Record)} == {"no_answer"}, "in the audit file, too"


def test_an_end_that_comes_after_a_command_was_given_up_is_still_told() -> None:
    """Else the log and the audit file would say for ever that it is not known whether the button was pressed."""
    rig = Rig()
    rig.select(control="RUN_STOP")
    (command,) = of_type(rig.act(), SendCommand)
    assert [entry["status"] for entry in logged(rig.wait(3.2, alive=True))] == ["no_answer"]
    late = GoalResult(goal_id=command.record["goal_id"], goal="", outcome=Outcome.REACHED, error_m=0.0002)
    effects = rig.desk.answers.result(late, rig.now)
    (entry,) = logged(effects)
    assert (entry["entry"], entry["status"], entry["error_mm"]) == (command.entry, "reached", 0.2)
    (line,) = of_type(effects, Record)
    assert (line.record["result"], line.record["goal_id"]) == ("reached", command.record["goal_id"])
    assert rig.desk.answers.result(late, rig.now) == [], "once"
    (stop,) = of_type(rig.ask(rig.a, type="stop"), StopNow)
    assert [entry["status"] for entry in logged(rig.wait(3.2, alive=True))] == ["no_answer"]
    assert logged(rig.desk.answers.service_answered(stop.entry, True, "", rig.now))[0]["status"] == "done"


# --- services and state ---


def test_a_call_that_was_long_on_its_way_is_not_done_any_more() -> None:
    """After 3 s its page has said that there is no link: nobody expects that the machine homes then."""
    rig = Rig()
    rig.seconds += 3.1
    pressed_ms = (rig.seconds - 1.2) * 1e3
    late = answer(rig.ask(rig.a, type="call", service="home", sent_ms=pressed_ms))
    assert (late["code"], late["values"]) == ("came_late", {"late_ms": 1200, "limit_ms": 1000})
    assert of_type(rig.ask(rig.a, type="call", service="disable", sent_ms=pressed_ms), CallService), "it moves nothing"
    in_time = rig.ask(rig.a, type="call", service="home", sent_ms=(rig.seconds - 0.9) * 1e3)
    assert of_type(in_time, CallService)


@pytest.mark.parametrize("service", ["reset", "home"])
@pytest.mark.parametrize("how", ["another person", "once more, which is the same stop", "the desk itself"])
def test_a_call_from_before_a_stop_of_somebody_else_does_not_undo_it(service: str, how: str) -> None:
    """Its link is slow: it is pressed at 0.0 s, STOP at 0.4 s, and it comes at 0.8 s."""
    rig = Rig()
    pressed_ms = rig.seconds * 1e3
    rig.seconds += 0.2
    if how == "the desk itself":
        rig.desk.set_state("controller", "moving")
    elif how.startswith("once more"):
        assert of_type(rig.desk.stop("Operator 2", rig.now, press="p1"), StopNow)
        pressed_ms += 300
    rig.seconds += 0.2
    if how == "the desk itself":
        stopped = rig.ask(rig.a, type="blind", silence_ms=1100)
        assert of_type(stopped, StopNow)
        rig.desk.set_state("controller", "stopped: blind")
    else:
        assert bool(rig.desk.stop("Operator 2", rig.now, press="p2")) is (how == "another person")
    stop_ms = rig.seconds * 1e3
    rig.seconds += 0.4
    assert refusal(rig.ask(rig.a, type="call", service=service, sent_ms=pressed_ms)) == "before_stop"
    assert of_type(rig.ask(rig.a, type="call", service="disable", sent_ms=pressed_ms), CallService), "it moves nothing"
    assert of_type(rig.ask(rig.a, type="call", service=service, sent_ms=stop_ms + 100), CallService)
    assert of_type(rig.ask(rig.a, type="call", service=service), CallService), "who tells no time is not judged by it"


def test_the_second_way_of_a_stop_does_not_void_what_was_pressed_after_it() -> None:
    rig = Rig()
    assert of_type(rig.ask(rig.a, type="stop", press="p1"), StopNow)
    rig.seconds += 0.4
    pressed_ms = rig.seconds * 1e3
    rig.seconds += 0.2
    assert rig.desk.stop("Operator 1", rig.now, press="p1") == []
    rig.seconds += 0.2
    assert of_type(rig.ask(rig.a, type="call", service="reset", sent_ms=pressed_ms), CallService)


def test_the_second_way_of_a_press_that_counted_as_one_with_another_is_no_stop_either() -> None:
    rig = Rig()
    assert of_type(rig.ask(rig.a, type="stop", press="p1"), StopNow)
    rig.seconds += 0.3
    assert not of_type(rig.ask(rig.a, type="stop", press="p2"), StopNow)
    rig.seconds += 2.0
    assert rig.desk.stop("Operator 1", rig.now, press="p2") == []


@pytest.mark.parametrize("service", ["home", "calibrate"])
@pytest.mark.parametrize(
    ("part", "state"), [("controller", "touching"), ("sequencer", "step 2/3"), ("driver", "moving")]
)
def test_nothing_is_begun_while_another_thing_moves(service: str, part: str, state: str) -> None:
    rig = Rig()
    rig.desk.set_state(part, state)
    effects = rig.ask(rig.a, type="call", service=service)
    assert refusal(effects) == "not_at_rest" and not of_type(effects, CallService)
    rig.desk.set_state(part, {"controller": "ready", "sequencer": "idle", "driver": "idle"}[part])
    assert of_type(rig.ask(rig.a, type="call", service=service), CallService)


def test_services_are_called_and_their_answers_shown() -> None:
    rig = Rig()
    (call,) = of_type(rig.ask(rig.a, type="call", service="home"), CallService)
    assert call.service == "home"
    assert not rig.desk.moving, "asking is not moving; the driver says homing"
    entry = logged(rig.desk.answers.service_answered(call.entry, False, "not enabled", rig.now))[0]
    assert (entry["status"], entry["reason"]) == ("rejected", "not enabled")


def test_the_state_is_sent_on_change_at_most_ten_times_a_second_and_at_least_once() -> None:
    def states(effects: list[Effect]) -> list[dict]:
        return [e.message for e in of_type(effects, Broadcast) if e.message["type"] == "state"]

    rig = Rig()
    assert 2 <= len(states(rig.wait(3.0, alive=True))) <= 5
    sent = []
    for step in range(40):
        rig.desk.machine.set_position(0.001 * step, 0.02, 0.003, rig.now)
        sent += states(rig.wait(0.05, alive=True))
    assert 15 <= len(sent) <= 21
    assert sent[-1]["position_mm"][1:] == [20.0, 3.0]
    assert sent[-1]["driver"] == {"state": "idle", "reason": ""}


def test_a_place_that_no_driver_reports_any_more_is_not_shown() -> None:
    rig = Rig()
    for _ in range(4):
        rig.desk.machine.set_position(0.1, 0.05, 0.0, rig.now)
        rig.wait(0.5, alive=True)
        assert rig.desk.machine.message()["position_mm"] == [100.0, 50.0, 0.0]
    rig.wait(1.0, alive=True)
    assert rig.desk.machine.message()["position_mm"] is None, "the driver hangs or has ended; the stylus may be down"
    assert refusal(rig.jog(1, 0)) == "position_unknown"


def test_a_tip_that_was_seen_before_the_clock_was_set_back_is_not_seen_now() -> None:
    rig = Rig()
    rig.desk.scene.tip_ns = rig.now.ros_ns
    rig.wait(0.1)
    assert rig.desk.join("Operator 2")[1]["state"]["tip_seen"]
    rig.desk.scene.tip_ns += 3600 * 1_000_000_000
    rig.wait(0.1)
    assert not rig.desk.join("Operator 3")[1]["state"]["tip_seen"]


def test_a_new_page_gets_the_log_the_selection_and_the_state() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.act()
    _, hello = rig.desk.join("Operator 2")
    assert (hello["boot"], hello["you"]["name"], hello["title"]) == (BOOT, "Operator 2", "DSO")
    assert [entry["action"] for entry in hello["log"]] == ["press"]
    assert hello["selection"]["control"] == "RUN_STOP"
    assert hello["state"]["calibration"] == {"state": "calibrated", "reason": "rms 0.1 mm"}
    assert hello["limits"] == {"amber_ms": 250.0, "max_age_ms": 500.0, "stale_ms": 1000.0, "jog_step_mm": 10.0}


def test_pages_that_are_open_follow_limits_that_change() -> None:
    rig = Rig()
    rig.wait(0.2)
    rig.desk.config = BridgeConfig(frame_max_age_s=0.8, jog_step_max_m=0.005)
    told = [e.message for e in of_type(rig.wait(0.5), Broadcast) if e.message["type"] == "limits"]
    changed = {"amber_ms": 250.0, "max_age_ms": 800.0, "stale_ms": 1000.0, "jog_step_mm": 5.0}
    assert told == [{"type": "limits", "limits": changed}]


def test_a_gesture_at_a_pixel_survives_its_text() -> None:
    gesture = Gesture(kind="hold", target=Point(x=700.25, y=3.0, frame="camera_left_optical_frame"), argument=1.0)
    assert parse_gesture(gesture.text()) == gesture
    assert np.isfinite(parse_gesture(gesture.text()).argument)


@pytest.mark.parametrize(
    ("text", "state", "reason"),
    [
        ("calibrating 3/12, 9 s left", "calibrating", "3/12, 9 s left"),
        (
            "calibrating 3/12, 9 s left (stale: 0.5 s; repetition 1 of 4)",
            "calibrating",
            "3/12, 9 s left (stale: 0.5 s; repetition 1 of 4)",
        ),
        ("stopped: by the operator", "stopped", "by the operator"),
        ("idle", "idle", ""),
    ],
)
def test_progress_keeps_what_it_waits_for_in_one_piece(text: str, state: str, reason: str) -> None:
    assert split_state(text) == (state, reason)
