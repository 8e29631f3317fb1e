"""Refusals of the desk, and the events that end them."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from unit.scope_ui_bridge.desk_rig import Rig, answer, logged, of_type, pose, refusal, shown_selections

from icu_common.core.geometry.geometry import Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.gesture import parse_gesture
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.effects import (
    Broadcast,
    MachineOrder,
    Record,
    SendCommand,
    StopNow,
)


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
    rig.desk.answers.order_failed(MachineOrder(entry=2, stops=0, epoch=1, record={}), "test", rig.now)
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.desk.scene.place_panel(pose(0.0025))
    answered = answer(rig.act())
    assert (answered["code"], answered["values"]) == ("panel_moved", {"moved_mm": 2.5, "limit_mm": 2.0})
    assert refusal(rig.act()) == "selection_gone"


@pytest.mark.parametrize("there", [True, False])
def test_a_selection_is_void_on_another_panel_that_has_a_control_of_the_same_name(there: bool) -> None:
    """A panel was taught, or recognition was restarted for another one, since RUN_STOP was chosen."""
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
    """A user who has just clicked on another control and confirms does not mean the earlier selection."""
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
    """Its record was written while the process was stopped; that is known before the watchdogs have looked."""
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
