"""Sequences from the page: what may be started, how far it is, what ends it, and that nothing goes on by itself."""

from __future__ import annotations

import unicodedata
from pathlib import Path
from typing import Any

import pytest
from unit.scope_ui_bridge.desk_rig import Rig, answer, logged, of_type, refusal

from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.goals.sequence import SequenceError, parse_file, parse_steps
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen
from scope_ui_bridge.core.effects import Broadcast, Effect, SendCommand, SendSequence, StopNow
from scope_ui_bridge.core.status import stored_name

STEPS = ["press:RUN_STOP => effect", "turn:CH1_SCALE:30", "press:RUN_STOP"]


def start(rig: Rig, **what: Any) -> list[Effect]:
    return rig.ask(rig.a, type="sequence", camera="left", stamp=str(rig.stamp), **(what or {"steps": STEPS}))


def started(rig: Rig) -> SendSequence:
    (order,) = of_type(start(rig), SendSequence)
    assert isinstance(order, SendSequence)
    return order


def hear(rig: Rig, run_id: str, outcome: Outcome, done: int = 0, reason: str = "") -> list[Effect]:
    details = (("steps_done", str(done)),) if outcome.final else ()
    result = GoalResult(goal_id=run_id, goal="3 steps", outcome=outcome, reason=reason, details=details)
    return rig.desk.answers.sequence_result(result, rig.now)


def told(effects: list[Effect]) -> dict[str, Any]:
    return dict([e.message["sequence"] for e in of_type(effects, Broadcast) if e.message["type"] == "sequence"][-1])


def test_typed_steps_go_out_as_a_file_and_are_followed_step_by_step() -> None:
    rig = Rig()
    order = started(rig)
    run_id = order.record["goal_id"]
    first, _, text = order.text.partition("\n")
    assert first == f"id: {run_id}" and parse_file(text) == parse_steps(STEPS)
    assert order.record["command"] == "press:RUN_STOP => effect ; turn:CH1_SCALE:30.0 ; press:RUN_STOP"
    assert rig.desk.still_wanted(order, rig.now)
    assert logged(hear(rig, run_id, Outcome.ACCEPTED))[0]["status"] == "accepted"
    rig.desk.set_state("sequencer", "step 2/3: turn:CH1_SCALE:30.0")
    shown = told(rig.wait(0.1, alive=True))
    assert (shown["number"], shown["status"], len(shown["steps"]), shown["who"]) == (2, "accepted", 3, "Operator 1")
    step = GoalResult(goal_id=f"{run_id}.2", goal="turn:CH1_SCALE:30.0", outcome=Outcome.ACCEPTED)
    assert logged(rig.desk.answers.result(step, rig.now))[0]["who"] == "Operator 1", "its steps are the operator's"
    rig.desk.set_state("sequencer", "idle")
    (entry,) = logged(hear(rig, run_id, Outcome.REACHED, done=3))
    assert (entry["action"], entry["status"]) == ("sequence 3", "reached")
    assert told(rig.wait(0.1, alive=True))["status"] == "reached"


def test_the_step_that_fails_is_named_with_its_reason() -> None:
    rig = Rig()
    run_id = started(rig).record["goal_id"]
    hear(rig, run_id, Outcome.ACCEPTED)
    rig.desk.set_state("sequencer", "step 2/3: turn:CH1_SCALE:30.0")
    hear(rig, run_id, Outcome.ABORTED, 1, "step 2 of 3, turn:CH1_SCALE:30.0: rejected: too far")
    rig.desk.set_state("sequencer", "idle")
    shown = told(rig.wait(0.1, alive=True))
    assert (shown["number"], shown["status"]) == (2, "aborted") and "too far" in shown["reason"]
    _, hello = rig.desk.join("Operator 2")
    assert hello["sequence"] == shown
    assert of_type(start(rig), SendSequence), "another one may be started"


def test_a_stored_sequence_is_started_by_its_name() -> None:
    rig = Rig()
    rig.desk.sequence.stored = {"capture": parse_file("name: Capture it\nsteps: ['press:RUN_STOP']")}
    _, hello = rig.desk.join("Operator 2")
    assert hello["sequences"] == [{"name": "capture", "title": "Capture it", "steps": ["press:RUN_STOP"]}]
    (order,) = of_type(start(rig, stored="capture"), SendSequence)
    assert "name: Capture it" in order.text
    assert refusal(start(Rig(), stored="../capture")) == "sequence_unknown"


@pytest.mark.parametrize(
    ("steps", "code", "words"),
    [
        ([], "malformed", "1 to 100"),
        (["press:RUN_STOP"] * 101, "malformed", "1 to 100"),
        ("press:RUN_STOP", "malformed", "steps"),
        (["press:RUN_STOP", "poke:RUN_STOP"], "sequence_wrong", "step 2: gesture 'poke' is none of"),
        (["press:RUN_STOP => smoke"], "sequence_wrong", "check 'smoke'"),
        (["hold:RUN_STOP:31"], "sequence_wrong", "up to 30"),
        (["press:RUN_STOP id=7"], "sequence_wrong", "the sequencer gives the ids"),
        (["press:RUN_STOP", "press:MENU"], "sequence_control", "MENU"),
        (["press:RUN_STOP => lamp:MENU=red"], "sequence_control", "MENU"),
        (["press:RUN_STOP\npress:X"], "malformed", "steps"),
        (["press:RUN_STOP", "press:\tMENU"], "malformed", r"steps 2 = 'press:\\tMENU'; expected a text of up to 300"),
        (["press:RUN_STOP", "press:" + "M" * 301], "malformed", "steps 2 = 'press:" + "M" * 34 + "'"),
        (["press:RUN_STOP"] * 120, "malformed", "steps = '120'; expected 1 to 100 texts"),
        (["press:RUN_STOP => lamp:RUN_STOP=rde"], "sequence_wrong", "lamp 'rde' is none of off, white, red"),
        (["press:RUN_STOP", "turn:RUN_STOP:30"], "sequence_wrong", "step 2: RUN_STOP is a button; only a knob"),
        (["press:RUN_STOP => lamp:CH1_SCALE=red"], "sequence_wrong", "only on RUN_STOP"),
    ],
)
def test_wrong_sequences_are_refused_and_nothing_goes_out(steps: Any, code: str, words: str) -> None:
    rig = Rig()
    lit, knob = (ControlSeen(name="RUN_STOP", kind="button", lamp="red"), ControlSeen(name="CH1_SCALE", kind="knob"))
    rig.desk.panel.show(PanelSeen(stamp_ns=rig.now.ros_ns, controls=(lit, knob)), rig.now)
    effects = start(rig, steps=steps)
    assert refusal(effects) == code
    assert words in str(answer(effects)["values"])


def test_a_sequence_of_as_many_steps_as_are_allowed_and_as_long_ones_goes_out() -> None:
    step = "press:RUN_STOP => " + ", ".join(["lamp:RUN_STOP=red"] * 13) + ", lamp:RUN_STOP=yellow, effect"
    assert len(step) <= 300
    (order,) = of_type(start(Rig(), steps=[step] * 100), SendSequence)
    assert parse_file(order.text.partition("\n")[2]) == parse_steps([step] * 100)


def test_a_stored_sequence_is_found_by_its_name_however_its_letters_are_composed() -> None:
    for system in ("NFC", "NFD"):  # of the file system, and of a page's messages
        for page in ("NFC", "NFD"):
            rig = Rig()
            name = stored_name(unicodedata.normalize(system, "Überdruck_prüfen"))
            rig.desk.sequence.stored = {name: parse_steps(STEPS)}
            (order,) = of_type(start(rig, stored=unicodedata.normalize(page, "Überdruck_prüfen")), SendSequence)
            assert order.record["target"] == "Überdruck_prüfen"


@pytest.mark.parametrize(
    ("stem", "shown"),
    [("ü" * 65, f"'{'ü' * 64}' of 65"), ("a\u202eb", r"'a\u202eb' of 3"), ("a\nb", r"'a\nb' of 3")],
)
def test_a_stored_sequence_that_no_page_could_name_is_refused(stem: str, shown: str) -> None:
    with pytest.raises(SequenceError) as caught:
        stored_name(stem)
    assert str(caught.value) == f"file's name {shown} characters (limit 64, all visible)"


@pytest.mark.parametrize(
    ("steps", "code"),
    [(["press:RUN_STOP => screen" + " " * 400] * 90, "oversized"), (["press:RUN_STOP\t=> screen"], "malformed")],
)
def test_what_cannot_be_read_is_answered_by_its_number(steps: list[str], code: str) -> None:
    # Without the number the page would wait for an answer until it says that there is no link.
    rig = Rig()
    found = answer(rig.ask(rig.a, type="sequence", steps=steps, camera="left", stamp=str(rig.stamp)))
    assert (found["seq"], found["code"]) == (rig.seq, code)


def test_a_sequence_needs_what_a_gesture_needs() -> None:
    rig = Rig()
    other, _ = rig.desk.join("Operator 2")
    ask = {"type": "sequence", "steps": STEPS, "camera": "left", "stamp": str(rig.stamp)}
    assert refusal(rig.ask(other, **ask)) == "no_lease"
    assert refusal(rig.ask(rig.a, **ask, epoch=0)) == "stale_epoch"
    assert refusal(rig.ask(rig.a, **ask, seq=1)) == "replayed"
    assert refusal(rig.ask(rig.a, **ask | {"stamp": "5"})) == "frame_unknown"
    rig.see(0.2)
    assert refusal(start(rig)) == "low_confidence"
    rig.see()
    rig.desk.machine.set_state("controller", "stopped: operator")
    assert refusal(start(rig)) == "not_ready"
    rig.desk.machine.set_state("controller", "ready")
    started(rig)
    assert refusal(start(rig)) == "busy_pending"


def test_while_a_sequence_is_at_work_nothing_else_is_begun_even_between_two_gestures() -> None:
    rig = Rig()
    rig.select(control="RUN_STOP")
    rig.desk.set_state("sequencer", "step 1/2: press:RUN_STOP")
    effects = rig.act()
    assert refusal(effects) == "sequence_runs"
    assert answer(effects)["values"] == {"step": "step 1/2: press:RUN_STOP"}
    assert refusal(rig.move(10.0, 10.0)) == "sequence_runs"
    assert rig.desk.moving
    other, _ = rig.desk.join("Operator 2")
    rig.ask(other, type="lease", step="request")
    assert refusal(rig.ask(rig.a, type="lease", step="grant", to="v2")) == "busy_moving"
    rig.desk.set_state("sequencer", "")
    assert of_type(rig.act(), SendCommand), "a sequencer that is gone holds nobody up"


def test_a_silent_page_stops_a_sequence_between_two_gestures() -> None:
    rig = Rig()
    hear(rig, started(rig).record["goal_id"], Outcome.ACCEPTED)
    rig.desk.set_state("sequencer", "step 1/3: press:RUN_STOP")
    rig.wait(5.0, alive=True)
    (stop,) = of_type(rig.wait(0.7), StopNow)
    assert stop.record["target"] == "stopped_link_lost", "nothing tells of a page that still answers"
    assert rig.desk.lease.holder == ""


def test_a_stop_voids_a_sequence_that_has_not_gone_out() -> None:
    rig = Rig()
    order = started(rig)
    rig.ask(rig.a, type="stop")
    assert not rig.desk.still_wanted(order, rig.now)
    rig.desk.answers.order_failed(order, "stopped before it went out", rig.now)
    assert told(rig.wait(0.1, alive=True))["status"] == "failed"


def test_a_sequencer_that_does_not_answer_is_noticed() -> None:
    rig = Rig()
    started(rig)
    assert told(rig.wait(3.2, alive=True))["status"] == "no_answer"


def test_the_stored_example_is_right() -> None:
    for path in (Path(__file__).parents[4] / "config" / "sequences").glob("*.yaml"):
        assert parse_file(path.read_text(), str(path)).steps
