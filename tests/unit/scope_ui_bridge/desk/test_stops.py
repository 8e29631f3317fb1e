"""Stops, and orders that a stop makes void."""

from __future__ import annotations

import pytest
from unit.scope_ui_bridge.desk_rig import Rig, answer, logged, of_type, refusal

from icu_common.core.goals.results import GoalResult, Outcome
from scope_ui_bridge.core.effects import (
    CallService,
    Record,
    SendCommand,
    StopNow,
)


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
    (failed,) = logged(rig.desk.answers.service_answered(alone.entry, False, "no driver is running", rig.now))
    assert (failed["status"], failed["reason"]) == ("failed", "no driver is running")
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


def test_a_call_that_was_long_on_its_way_is_not_done_any_more() -> None:
    """After 3 s its page has reported a lost link: no user expects that the machine homes then."""
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
