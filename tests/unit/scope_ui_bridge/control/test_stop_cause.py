"""Each stop names its own cause: pages show it instead of the driver's "stop requested"."""

from __future__ import annotations

from typing import Any

import pytest
from unit.scope_ui_bridge.desk_rig import Rig, moving, of_type

from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.reasons.codes import CODE, REASON, STOP_ASKED, ControllerCode, DriverCode
from scope_ui_bridge.core.effects import Ping, StopNow

REQUESTED = {CODE: DriverCode.STOP_REQUESTED.value, REASON: "stop requested"}
ASKED = ((STOP_ASKED, "yes"),)


def driver_stops(
    rig: Rig, text: str = "stopped: stop requested", values: dict[str, str] = REQUESTED
) -> dict[str, Any] | None:
    """Make the driver stop, and report the code of that state; return the cause that pages get."""
    rig.wait(0.1)
    rig.desk.set_state("driver", text)
    rig.desk.set_report("driver", text, values)
    rig.wait(0.1)
    cause: dict[str, Any] | None = rig.desk.join("Operator 2")[1]["state"]["stop_cause"]
    return cause


def test_a_person_is_named() -> None:
    rig = moving()
    rig.ask(rig.a, type="stop")
    assert driver_stops(rig) == {"code": "stopped_by_person", "who": "Operator 1", "silence_s": 0.0}


def test_missing_pictures_are_named_with_how_long() -> None:
    rig = moving(pictures=True)
    for _ in range(20):
        rig.desk.machine.picture_came(rig.now)
        assert of_type(rig.wait(0.05, alive=True), StopNow) == []
    (stop,) = of_type(rig.wait(0.7, alive=True), StopNow)
    assert stop.record["target"] == "stopped_no_picture"
    assert driver_stops(rig) == {"code": "stopped_no_picture", "who": "Watchdog", "silence_s": 0.6}


@pytest.mark.parametrize(("answers", "code"), [(True, "stopped_page_frozen"), (False, "stopped_link_lost")])
def test_a_browser_that_answers_tells_a_frozen_page_from_a_lost_link(answers: bool, code: str) -> None:
    rig = moving()
    assert of_type(rig.wait(0.15), Ping) == []
    assert of_type(rig.wait(0.2), Ping) == [Ping(viewer=rig.a)], "once in a silence"
    rig.desk.pong("somebody else")
    if answers:
        rig.desk.pong(rig.a)
    (stop,) = of_type(rig.wait(0.4), StopNow)
    assert stop.record["target"] == code
    assert driver_stops(rig) == {"code": code, "who": "Watchdog", "silence_s": 0.6}


def test_an_answer_in_an_earlier_silence_does_not_count() -> None:
    rig = moving()
    rig.wait(0.3)
    rig.desk.pong(rig.a)
    rig.alive()
    rig.desk.pong(rig.a)  # of a heartbeat of the socket's own: no reader was asked
    assert of_type(rig.wait(0.7), StopNow)[0].record["target"] == "stopped_link_lost"


def test_a_hidden_page_stops_at_once_what_it_moves_and_only_that() -> None:
    rig = moving()
    viewer, _ = rig.desk.join("Operator 2")
    assert rig.ask(viewer, type="hidden") == []
    (stop,) = of_type(rig.ask(rig.a, type="hidden"), StopNow)
    assert stop.record["target"] == "stopped_page_hidden"
    assert rig.desk.lease.holder == ""
    rig = Rig()
    assert rig.ask(rig.a, type="hidden") == []
    assert rig.desk.lease.holder == rig.a, "at rest a glance elsewhere costs nothing"


@pytest.mark.parametrize(("back", "code"), [(False, "stopped_page_hidden"), (True, "stopped_link_lost")])
def test_a_page_that_was_hidden_before_the_motion_began_is_not_called_lost(back: bool, code: str) -> None:
    rig = Rig()
    rig.ask(rig.a, type="hidden")
    if back:
        rig.alive()
    rig.wait(0.4)
    rig.desk.machine.set_state("driver", "homing")
    (stop,) = of_type(rig.wait(0.5), StopNow)
    assert stop.record["target"] == code


def test_a_page_that_sees_no_new_picture_stops_what_it_moves_once_and_keeps_control() -> None:
    rig = moving()
    viewer, _ = rig.desk.join("Operator 2")
    assert rig.ask(viewer, type="blind", silence_ms=1100) == []
    (stop,) = of_type(rig.ask(rig.a, type="blind", silence_ms=1100), StopNow)
    assert (stop.record["who"], stop.record["target"]) == ("Watchdog", "stopped_page_blind")
    rig.wait(0.7, alive=True)
    assert of_type(rig.ask(rig.a, type="blind", silence_ms=1800), StopNow) == []
    assert rig.desk.lease.holder == rig.a
    assert driver_stops(rig) == {"code": "stopped_page_blind", "who": "Watchdog", "silence_s": 1.1}
    assert Rig().ask(rig.a, type="blind", silence_ms=1100) == [], "at rest nothing is at stake"


@pytest.mark.parametrize("missing", ["page", "pictures"])
def test_a_bridge_that_was_held_up_blames_itself(missing: str) -> None:
    rig = moving(pictures=missing == "pictures")
    rig.seconds += 0.9  # no tick in all this time
    if missing == "pictures":
        rig.alive()
    (stop,) = of_type(rig.desk.tick(rig.now), StopNow)
    assert stop.record["target"] == "stopped_bridge_held_up"


def test_the_first_cause_explains_and_a_reset_forgets_it() -> None:
    rig = moving()
    rig.ask(rig.a, type="stop")
    rig.wait(0.7)
    cause = driver_stops(rig)
    assert cause is not None and cause["code"] == "stopped_by_person"
    rig.ask(rig.a, type="stop")
    rig.desk.machine.set_state("driver", "idle")
    cause = driver_stops(rig)
    assert cause is not None and cause["code"] == "stopped_elsewhere"


def test_what_the_driver_or_the_controller_stopped_is_not_claimed() -> None:
    assert driver_stops(moving(), "stopped: the board went to Door:1", {}) is None
    rig = moving()
    pushed = "the panel has moved by 4.0 mm"
    rig.desk.answers.result(
        GoalResult(goal_id="7", goal="press:MENU", outcome=Outcome.ABORTED, reason=pushed, details=ASKED), rig.now
    )
    assert driver_stops(rig) == {"code": "stopped_by_controller", "who": pushed, "silence_s": 0.0}
    rig = moving()
    rig.desk.answers.result(
        GoalResult(goal_id="7", goal="press:MENU", outcome=Outcome.ABORTED, reason=pushed, details=ASKED), rig.now
    )
    rig.wait(3.0, alive=True)
    cause = driver_stops(rig)
    assert cause is not None and cause["code"] != "stopped_by_controller", (
        "an abort of long ago has nothing to do with it"
    )


def test_a_machine_that_is_not_stopped_has_no_cause() -> None:
    rig = moving()
    rig.ask(rig.a, type="stop")
    assert rig.desk.join("Operator 2")[1]["state"]["stop_cause"] is None


def test_controller_that_stops_a_machine_at_rest_is_named_with_its_reason() -> None:
    rig = Rig()
    rig.wait(0.1)
    text = "two programs publish panel/pose: /foreign and /panel/recognition"
    rig.desk.set_state("controller", f"stopped: {text}")
    rig.desk.set_report("controller", f"stopped: {text}", {CODE: ControllerCode.CONFLICT.value})
    assert driver_stops(rig) == {"code": "stopped_by_controller", "who": text, "silence_s": 0.0}
    rig.desk.set_state("controller", f"stopped: stop requested; {text}")
    rig.desk.set_report("controller", f"stopped: stop requested; {text}", {CODE: ControllerCode.DRIVER_STOPPED.value})
    assert driver_stops(rig) == {"code": "stopped_by_controller", "who": text, "silence_s": 0.0}


def test_lost_heartbeat_is_named_by_its_code() -> None:
    text = "stopped: operator's heartbeat lost: 0.61 s old, 0.6 s are allowed"
    assert driver_stops(moving(), text, {}) is None, "no words decide"
    heartbeat = {CODE: DriverCode.HEARTBEAT_LOST.value}
    assert driver_stops(moving(), text, heartbeat) == {"code": "stopped_heartbeat", "who": "", "silence_s": 0.0}


def test_requested_stop_that_left_the_stylus_down_is_shown_with_all_its_clauses() -> None:
    rig = moving()
    rig.ask(rig.a, type="stop")
    assert driver_stops(rig, "stopped: stop requested; the stylus was not lifted, it may still press") is None


def test_code_of_an_earlier_state_explains_no_later_one() -> None:
    rig = moving()
    rig.ask(rig.a, type="stop")
    rig.desk.set_report("driver", "stopped: stop requested", REQUESTED)
    rig.desk.set_state("driver", "stopped: the board went to Door:1")
    rig.wait(0.1)
    assert rig.desk.join("Operator 2")[1]["state"]["stop_cause"] is None


def test_abort_without_a_stop_of_the_controller_is_no_cause_of_one() -> None:
    rig = moving()
    aborted = GoalResult(goal_id="7", goal="press:MENU", outcome=Outcome.ABORTED, reason="the panel has moved")
    rig.desk.answers.result(aborted, rig.now)
    assert driver_stops(rig) == {"code": "stopped_elsewhere", "who": "", "silence_s": 0.0}
