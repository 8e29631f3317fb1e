"""A reset that is pressed while a stop still lifts the stylus waits for the end of the stop."""

from __future__ import annotations

import pytest
from unit.scope_ui_bridge.desk_rig import Rig, answer, logged, of_type

from icu_common.core.reasons.message import Message
from scope_ui_bridge.core.desk.early_reset import RESET_WAIT_S
from scope_ui_bridge.core.effects import CallService, Effect, Record, RepeatOrder, StopNow

NOT_YET = Message("driver.refused", refusal=Message("stop.stop_not_complete_yet"))
NOTHING = Message("driver.refused", refusal=Message("stop.nothing_reset_driver", state_text="idle"))


class Early(Rig):
    """A desk whose machine has just stopped; ``reset`` is the order of the reset pressed at once."""

    def __init__(self) -> None:
        super().__init__()
        (stop,) = of_type(self.ask(self.a, type="stop", press="p1"), StopNow)
        self.desk.set_state("driver", "stopped: stop requested")
        self.desk.answers.service_answered(stop.entry, True, "", self.now)
        self.seconds += 0.3
        (self.reset,) = of_type(self.ask(self.a, type="call", service="reset"), CallService)

    def answers(self, success: bool, text: str) -> list[Effect]:
        return self.desk.answers.service_answered(self.reset.entry, success, text, self.now)


def test_a_reset_during_the_lift_waits_and_is_sent_again_until_the_driver_accepts_it() -> None:
    rig = Early()
    effects = rig.answers(False, NOT_YET)
    (entry,) = logged(effects)
    assert (entry["status"], entry["reason"].code) == ("accepted", "bridge.reset_waits"), "no refusal is shown"
    assert of_type(effects, Record) == [], "the audit file gets the result only"
    for _ in range(5):
        (again,) = of_type(rig.wait(0.3, alive=True), RepeatOrder)
        assert again.order == rig.reset, "the same order, which the same stop voids"
        assert rig.desk.still_wanted(again.order, rig.now)
        assert rig.answers(False, NOT_YET) == [], "nothing new to show"
    assert of_type(rig.wait(0.3, alive=True), RepeatOrder)
    done = rig.answers(True, "accepted: reset")
    assert [entry["status"] for entry in logged(done)] == ["done"]
    assert [line.record["result"] for line in of_type(done, Record)] == ["done"]
    assert of_type(rig.wait(1.0, alive=True), RepeatOrder) == []


def test_a_reset_waits_longer_than_other_answers_but_not_for_ever() -> None:
    rig = Early()
    begun, effects = rig.seconds, list[Effect]()
    while rig.seconds - begun < RESET_WAIT_S - 0.3:
        assert logged(effects) == [] or logged(effects)[0]["status"] == "accepted"
        effects = rig.answers(False, NOT_YET) + rig.wait(0.3, alive=True)
    rig.wait(0.6, alive=True)
    (entry,) = logged(rig.answers(False, NOT_YET))
    assert (entry["status"], entry["reason"]) == ("rejected", NOT_YET)
    assert of_type(rig.wait(1.0, alive=True), RepeatOrder) == []


@pytest.mark.parametrize("what", ["stop", "release"])
def test_a_stop_or_a_change_of_control_ends_the_wait(what: str) -> None:
    rig = Early()
    rig.answers(False, NOT_YET)
    if what == "stop":
        rig.ask(rig.a, type="stop", press="p2")
    else:
        rig.ask(rig.a, type="lease", step="release")
    effects = rig.wait(0.3, alive=True)
    assert of_type(effects, RepeatOrder) == []
    (entry,) = [entry for entry in logged(effects) if entry["action"] == "reset"]
    assert (entry["status"], entry["reason"].code) == ("failed", "bridge.stopped_before_went_out")
    assert [line.record["result"] for line in of_type(effects, Record) if line.record["command"] == "reset"] == [
        "failed"
    ]


@pytest.mark.parametrize(
    "state", ["alarm: ALARM:1", "stopped: stop requested; the board did not lift the stylus, it may still press", ""]
)
def test_a_machine_in_another_state_than_the_person_has_seen_is_not_reset(state: str) -> None:
    rig = Early()
    rig.answers(False, NOT_YET)
    rig.desk.set_state("driver", state)
    effects = rig.wait(0.3, alive=True)
    assert of_type(effects, RepeatOrder) == []
    (entry,) = logged(effects)
    assert (entry["status"], entry["reason"].code) == ("failed", "bridge.reset_void")
    assert state in entry["reason"]


def test_a_second_press_while_a_reset_waits_is_the_same_reset() -> None:
    rig = Early()
    rig.answers(False, NOT_YET)
    again = rig.ask(rig.a, type="call", service="reset")
    assert answer(again)["ok"] and of_type(again, CallService) == logged(again) == []
    rig.ask(rig.a, type="stop", press="p2")
    rig.seconds += 0.1
    assert of_type(rig.ask(rig.a, type="call", service="reset"), CallService), "that stop has ended the first one"


@pytest.mark.parametrize("refused", [NOTHING, "refused: an old driver's text", Message("driver.refused", refusal="no")])
def test_another_refusal_of_a_reset_is_shown_at_once(refused: str) -> None:
    rig = Early()
    (entry,) = logged(rig.answers(False, refused))
    assert (entry["status"], entry["reason"]) == ("rejected", refused)
    assert of_type(rig.wait(1.0, alive=True), RepeatOrder) == []


def test_the_same_refusal_of_another_service_is_shown_at_once() -> None:
    rig = Early()
    rig.answers(True, "accepted: reset")
    rig.desk.set_state("driver", "idle")
    (home,) = of_type(rig.ask(rig.a, type="call", service="home"), CallService)
    (entry,) = logged(rig.desk.answers.service_answered(home.entry, False, NOT_YET, rig.now))
    assert entry["status"] == "rejected"
