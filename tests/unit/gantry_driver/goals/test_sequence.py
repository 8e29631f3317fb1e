"""Sequences: what is read, errors with lines, and a run that checks each step and stops at the first that fails."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from gantry_driver.core.goals.sequence import SendStepCommand, SequenceConfig, SequenceReport, SequenceRun, StopMachine
from gantry_driver.core.job.effects import SCREEN_CHANGED
from icu_common.core.goals.results import EffectMissing, GoalResult, Outcome
from icu_common.core.goals.sequence import SequenceError, parse_file, parse_steps, unfit
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen

S = 1_000_000_000
FILE = """\
name: capture
steps:
  - press:AUTO_SET => screen
  - do: click:CH1_SCALE:2
    check: [effect, "angle:CH1_SCALE=-36"]
    within_s: 2
  - "press:RUN_STOP => lamp:RUN_STOP=red"
"""


def test_file_and_command_line_say_the_same() -> None:
    sequence = parse_file(FILE)
    assert sequence.name == "capture" and len(sequence.steps) == 3
    assert [c.text() for c in sequence.steps[1].checks] == ["effect", "angle:CH1_SCALE=-36"]
    assert sequence.steps[1].within_s == 2
    given = parse_steps(["press:AUTO_SET => screen", "press:RUN_STOP=>lamp:RUN_STOP=red"])
    assert given.steps == (sequence.steps[0], sequence.steps[2])


def test_a_sequence_survives_its_text() -> None:
    sequence = parse_file(FILE)
    assert parse_file(sequence.text()) == sequence
    assert [step.text() for step in sequence.steps][1] == "click:CH1_SCALE:2.0 => effect, angle:CH1_SCALE=-36"
    bare = parse_steps(["press:A"])
    assert parse_file(bare.text()) == bare and bare.steps[0].text() == "press:A"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("press:AUTO_SET", "poke:AUTO_SET", r"f\.yaml:3: gesture 'poke' is none of"),
        ("=> screen", "=> smoke", r"f\.yaml:3: check 'smoke' is none of effect, screen, lamp"),
        ("RUN_STOP=red", "RUN_STOP=rde", r"f\.yaml:7: lamp 'rde' is none of off, white, red, amber"),
        ("within_s: 2", "within_s: 0", r"f\.yaml:4: within_s = 0; expected seconds above 0"),
        ("within_s: 2", "within: 2", r"f\.yaml:4: unknown key within; known keys: do"),
        ("do: click", "dont: click", r"f\.yaml:4: unknown key dont"),
        ("name: capture", "title: capture", r"f\.yaml:1: 'title'; known keys: name"),
        ("press:RUN_STOP", "press:RUN_STOP id=7", r"f\.yaml:7: .* the sequencer gives the ids"),
        ("steps:\n", "steps: [\n", r"f\.yaml:\d+: "),
        ("within_s: 2", "within_s: 2026-13-45", r"f\.yaml:6: month must be in 1\.\.12"),
        ("within_s: 2", "within_s: !!int two", r"f\.yaml:6: invalid literal"),
        ("within_s: 2", "within_s: !!timestamp two", r"f\.yaml:6: "),
        ("within_s: 2", "within_s: !!python/name:os.x", r"f\.yaml:6: could not determine a constructor"),
        ("within_s: 2", "{a: b}: 2", r"f\.yaml:6: found unhashable key"),
        ("- press", "- &a [*a]\n  - press", r"f\.yaml:3: found unconstructable recursive node"),
        ("within_s: 2", "check: screen", r"f\.yaml:6: key 'check' occurs twice"),
        ("within_s: 2", "do: press:MENU", r"f\.yaml:6: key 'do' occurs twice"),
        ("name: capture", "name: capture\nname: other", r"f\.yaml:2: key 'name' occurs twice"),
        ("name: capture", "steps: [press:MENU]", r"f\.yaml:2: key 'steps' occurs twice"),
        pytest.param(
            "within_s: 2",
            "within_s: 1" + 400 * "0",
            r"f\.yaml:4: within_s = 1000\d* \(361 more characters\); expected seconds",
            id="huge",
        ),
        ("steps:\n", "steps:\n\0", r"f\.yaml:1: unacceptable character #x0000"),
        pytest.param("name: capture", "name: " + 900 * "[", r"f\.yaml:1: more than 12 open brackets", id="deep"),
        ("within_s: 2", "within_s: 0:02", r"f\.yaml:4: within_s = '0:02'; expected seconds"),
        ("within_s: 2", "within_s: 02", r"f\.yaml:4: within_s = '02'; expected seconds"),
        pytest.param("name: capture", "name: " + 65 * "x", r"f\.yaml:1: a name of 65 characters; expected up to 64"),
        pytest.param("name: capture", 'name: "a\\eb"', r"f\.yaml:1: a name of 3 characters; expected .* printable"),
        pytest.param("name: capture", "name: " + 70_000 * "x", r"the text has 70\d+ bytes \(limit 65536", id="large"),
        pytest.param("- press", 14 * "- " + "press", r"f\.yaml:3: more than 12 levels", id="deep without brackets"),
        pytest.param("name: capture", "name: [" + 4001 * "a," + "a]", r"f\.yaml:1: more than 4000 values", id="many"),
    ],
)
def test_errors_name_the_line(old: str, new: str, message: str) -> None:
    with pytest.raises(SequenceError, match=message):
        parse_file(FILE.replace(old, new, 1), "f.yaml")


def test_a_step_of_the_command_line_is_named_by_its_number() -> None:
    with pytest.raises(SequenceError, match="step 2: gesture 'poke'"):
        parse_steps(["press:A", "poke:B"])
    with pytest.raises(SequenceError, match=r"0 steps \(limits 1 to 100\)"):
        parse_steps([])


PANEL = PanelSeen(
    stamp_ns=0,
    controls=(
        ControlSeen(name="RUN_STOP", kind="button", lamp="green"),
        ControlSeen(name="ALARM", kind="button", hidden_by="stylus"),
        ControlSeen(name="SAVE", kind="button"),
        ControlSeen(name="MODE", kind="knob", marks=(("AUTO", 30.0), ("OFF", -30.0))),
        ControlSeen(name="SCALE", kind="knob", angle_deg=0.0, detent_deg=18.0),
        ControlSeen(name="INPUT", kind="connector"),
    ),
)


@pytest.mark.parametrize(
    ("step", "what"),
    [
        ("press:SAVED", "this panel has no SAVED; nearest: SAVE, SCALE"),
        ("press:SAVE => lamp:RUNSTOP=red", "this panel has no RUNSTOP; nearest: RUN_STOP"),
        ("press:INPUT", "INPUT is a connector; the stylus never presses connectors"),
        ("turn:SAVE:30", "SAVE is a button; only a knob can turn"),
        ("click:MODE:1", "MODE has no clicks (detent_deg in its layout)"),
        ("set:MODE:MAN", "MODE has no mark 'MAN'; it has AUTO, OFF"),
        ("set:SCALE:AUTO", "SCALE has no mark 'AUTO'; it has none"),
        ("press:SAVE => effect, lamp:SAVE=red", "the cameras see no lamp on SAVE, only on RUN_STOP"),
        ("press:SAVE => angle:SAVE=30", "SAVE is a button; only a knob has an angle"),
        ("set:MODE:AUTO => angle:MODE=MAN", "MODE has no mark 'MAN'; it has AUTO, OFF"),
        ("press:SAVE => screen", "this panel has no screen"),
    ],
)
def test_what_this_panel_can_never_fulfil_is_known_before_anything_moves(step: str, what: str) -> None:
    assert unfit(parse_steps(["press:RUN_STOP", step]), PANEL) == f"step 2: {what}"


def test_what_this_panel_may_fulfil_is_not_refused() -> None:
    """A lamp that is hidden now may be seen later; points are the controller's business."""
    steps = ["press:ALARM => lamp:ALARM=red, effect", "set:MODE:AUTO => angle:MODE=AUTO", "set:MODE:-20.5"]
    steps += ["click:SCALE:2 => angle:SCALE=-36, lamp:RUN_STOP=off", "turn:MODE:30", "press:0.1,0.1@panel_link"]
    assert unfit(parse_steps(steps), PANEL) == ""


def answer(
    goal_id: str,
    outcome: Outcome = Outcome.REACHED,
    effect: str = "none seen",
    reason: str = "",
    missing: EffectMissing | None = None,
) -> GoalResult:
    details = (("effect", effect), *(() if missing is None else (("effect_missing", missing.value),)))
    return GoalResult(goal_id=goal_id, goal="", outcome=outcome, reason=reason, details=details)


def seen(stamp: int, lamp: str = "green", angle: float = 0.0) -> PanelSeen:
    controls = (
        ControlSeen(name="RUN_STOP", kind="button", lamp=lamp),
        ControlSeen(name="CH1_SCALE", kind="knob", angle_deg=angle),
    )
    return PanelSeen(stamp_ns=stamp, controls=controls)


def run_of(text: str = FILE) -> SequenceRun:
    return SequenceRun(parse_file(text), "r", SequenceConfig())


def test_every_step_waits_for_its_answer_and_its_checks() -> None:
    run = run_of()
    first = run.start(0)
    assert isinstance(first[0], SequenceReport) and first[0].result.outcome is Outcome.ACCEPTED
    assert first[1] == SendStepCommand(text="press:AUTO_SET id=r.1")
    assert run.result(answer("r.1", Outcome.ACCEPTED), S) == []
    assert run.result(answer("other"), S) == []
    assert run.result(answer("r.1", effect=SCREEN_CHANGED), 2 * S) == [
        SendStepCommand(text="click:CH1_SCALE:2.0 id=r.2")
    ]
    assert run.result(answer("r.2", effect="CH1_SCALE at -36.5 degrees"), 5 * S) == []
    assert run.panel(seen(4 * S, angle=-36.0), 5 * S) == [], "a picture from before the answer"
    assert run.panel(seen(6 * S, angle=-30.0), 6 * S) == []
    assert run.panel(seen(6 * S + 1, angle=-35.0), 6 * S) == [SendStepCommand(text="press:RUN_STOP id=r.3")]
    assert run.result(answer("r.3"), 9 * S) == [] and run.tick(10 * S) == []
    (last,) = run.panel(seen(10 * S, "red"), 10 * S)
    assert isinstance(last, SequenceReport) and last.result.outcome is Outcome.REACHED and run.done
    assert last.result.duration_s == 10 and dict(last.result.details)["steps_done"] == "3"


def test_a_check_that_is_not_seen_stops_it() -> None:
    run = run_of("steps: ['press:RUN_STOP => lamp:RUN_STOP=red', 'press:SAVE']")
    run.start(0)
    run.result(answer("r.1"), S)
    run.panel(seen(2 * S, "green"), 2 * S)
    (end,) = run.tick(4 * S + 1)
    assert isinstance(end, SequenceReport) and end.result.outcome is Outcome.ABORTED
    assert end.result.reason == ("step 1 of 2, press:RUN_STOP: not seen in time: lamp:RUN_STOP=red (lamp green)")
    assert run.result(answer("r.2"), 5 * S) == [] and run.tick(500 * S) == []


def test_a_screen_that_changed_before_the_touch_is_none_that_the_touch_has_changed() -> None:
    def screen(changed_ns: int, stamp_ns: int) -> PanelSeen:
        control = ControlSeen(name="SCREEN", kind="touch_area", changed_ns=changed_ns)
        return PanelSeen(stamp_ns=stamp_ns, controls=(control,))

    for changed_ns, passes in ((S, False), (3 * S, True)):  # an alarm that came up on the way there; what the touch did
        run = run_of("steps: ['press:AUTO_SET => screen']")
        run.start(0)
        run.panel(screen(changed_ns, 4 * S), 4 * S)
        reached = answer("r.1", effect="lamp off -> green")
        told = replace(reached, details=(*reached.details, ("touched_ns", str(2 * S))))
        actions = run.result(told, 5 * S) or run.tick(9 * S)
        assert isinstance(actions[0], SequenceReport)
        assert actions[0].result.outcome is (Outcome.REACHED if passes else Outcome.ABORTED)
        assert passes or actions[0].result.reason.endswith("not seen in time: screen (no change)")


def test_a_stop_between_two_gestures_ends_it_so_that_nothing_goes_on_after_a_reset() -> None:
    run = run_of()
    run.start(0)
    run.result(answer("r.1"), 2 * S)
    (end,) = run.stopped("stopped: operator", 3 * S)
    assert isinstance(end, SequenceReport) and end.result.outcome is Outcome.ABORTED
    assert end.result.reason == "step 1 of 3, press:AUTO_SET: stopped: operator"
    later = PanelSeen(stamp_ns=4 * S, controls=(ControlSeen(name="SCREEN", kind="touch_area", changed_ns=4 * S),))
    assert run.panel(later, 4 * S) == [] and run.done


def test_a_text_of_6_kb_that_takes_a_yaml_parser_seconds_is_refused_at_once() -> None:
    """PyYAML takes 3.1 s for 3000 open brackets; a sequencer that reads them receives no answer of the controller."""
    begin_s = time.process_time()
    for nested in (3000 * "[", 3000 * "- ", 1500 * "? ", 1500 * "{a: ", 32_000 * "a,", "[" + 32_000 * "a,"):
        with pytest.raises(SequenceError):
            parse_file(f"steps: {nested}")
    assert time.process_time() - begin_s < 1.5


def test_aliases_count_as_what_they_repeat() -> None:
    laughs = ["- &a0 [press:A, press:A]", *(f"- &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 30))]
    with pytest.raises(SequenceError, match="more than 4000 values"):
        parse_file("steps:\n" + "\n".join(laughs))


@pytest.mark.parametrize("checks", ["", " => lamp:RUN_STOP=red"])
def test_a_stop_that_overtakes_a_steps_answer_ends_the_sequence_also_when_it_was_reset_since(checks: str) -> None:
    """State and answers are two topics: the sequencer mistook it for one that the gesture would answer, and sent the
    next step."""
    run = run_of(f"steps: ['press:RUN_STOP{checks}', 'press:SAVE']")
    run.start(0)
    run.result(answer("r.1", Outcome.ACCEPTED), S)
    assert run.stopped("stopped: operator", 2 * S) == [], "the gesture may be answered by a better reason"
    (end,) = run.result(answer("r.1"), 2 * S) or run.panel(seen(3 * S, "red"), 3 * S)
    assert isinstance(end, SequenceReport) and end.result.outcome is Outcome.ABORTED and run.done
    assert end.result.reason == "step 1 of 2, press:RUN_STOP: stopped: operator"


@pytest.mark.parametrize(
    ("outcome", "reason"), [(Outcome.ABORTED, "the camera has stalled"), (Outcome.REJECTED, "unknown control")]
)
def test_a_step_that_fails_stops_it(outcome: Outcome, reason: str) -> None:
    run = run_of()
    run.start(0)
    (end,) = run.result(answer("r.1", outcome, reason=reason), S)
    assert isinstance(end, SequenceReport) and end.result.outcome is Outcome.ABORTED and reason in end.result.reason
    assert dict(end.result.details)["steps_done"] == "0"


def ended_with_a_stop(run: SequenceRun, now_ns: int, driver: str = "stopped: stop requested") -> str:
    """Return why it ended, once it has requested a stop and received it."""
    assert run.tick(now_ns, driver="idle") == [StopMachine()] and not run.done
    assert run.tick(now_ns + S, driver="moving") == [], "asked for once"
    number = run.state.partition("/")[0].removeprefix("step ")
    assert run.result(answer(f"r.{number}"), now_ns + 2 * S) == [], "an answer that comes now starts no next step"
    (end,) = run.tick(now_ns + 3 * S, driver=driver)
    assert isinstance(end, SequenceReport) and end.result.outcome is Outcome.ABORTED
    return end.result.reason


def test_a_step_that_reached_nobody_does_not_hold_the_sequence_up() -> None:
    run = run_of("steps: ['press:MENU', 'press:SAVE']")
    run.start(0)
    run.result(answer("r.1"), 2 * S)
    assert run.tick(7 * S) == []
    assert ended_with_a_stop(run, 7 * S + 1) == (
        "step 2 of 2, press:SAVE: the controller has neither accepted nor rejected it within 5 s; "
        "the sequencer has ordered a stop, and the driver is 'stopped: stop requested'"
    )


def test_a_step_that_a_controller_at_rest_no_longer_knows_ends_the_sequence() -> None:
    run = run_of()
    run.start(0)
    assert run.tick(4 * S, at_rest=True) == [], "it may not have heard of it yet"
    run.result(answer("r.1", Outcome.ACCEPTED), 4 * S)
    assert run.tick(9 * S, at_rest=True) == []
    assert run.tick(10 * S, at_rest=False) == [], "it works"
    assert run.tick(15 * S, at_rest=True) == []
    assert run.tick(15 * S + 1, at_rest=True, driver="idle") == [StopMachine()]
    assert run.tick(20 * S + 1, at_rest=True, driver="idle") == [], "the stop may be under way"
    (end,) = run.tick(20 * S + 2, at_rest=True, driver="idle")
    assert isinstance(end, SequenceReport) and end.result.outcome is Outcome.ABORTED
    assert end.result.reason == (
        "step 1 of 3, press:AUTO_SET: the controller has been at rest for 5 s without an answer to it; "
        "the sequencer has ordered a stop, but the driver reports 'idle': look at the machine"
    )
    waits = run_of()
    waits.start(0)
    waits.result(answer("r.1"), S)
    assert waits.tick(3 * S, at_rest=True) == [], "what is waited for now is the check"


def test_a_gesture_that_takes_long_is_followed_for_as_long_as_somebody_is_at_work_on_it() -> None:
    run = run_of()
    run.start(0)
    run.result(answer("r.1", Outcome.ACCEPTED), S)
    for second in range(2, 400):  # many corrections: each look and each way is a change of the controller's state
        assert run.tick(second * S, driver="idle") == []
        if second % 60 == 0:
            run.sign(second * S)
    for second in range(400, 800):  # one slow way
        assert run.tick(second * S, driver="moving") == []
    assert run.result(answer("r.1", effect=SCREEN_CHANGED), 800 * S) == [
        SendStepCommand(text="click:CH1_SCALE:2.0 id=r.2")
    ]


def test_a_controller_that_hangs_in_a_step_is_given_up_and_the_machine_stopped() -> None:
    run = run_of()
    run.start(0)
    run.result(answer("r.1", Outcome.ACCEPTED), S)
    assert run.tick(5 * S, driver="moving") == []
    assert run.tick(95 * S, driver="idle") == []
    assert ended_with_a_stop(run, 95 * S + 1, "alarm: ALARM:1") == (
        "step 1 of 3, press:AUTO_SET: no sign of progress for 90 s; "
        "the sequencer has ordered a stop, and the driver is 'alarm: ALARM:1'"
    )
    assert run.done and run.tick(200 * S) == []


def test_an_effect_that_is_missing_stops_it() -> None:
    for missing in EffectMissing:
        told = f"what is said of {missing}"
        strict = run_of("steps: ['press:SAVE => effect']")
        strict.start(0)
        strict.result(answer("r.1", effect=told, missing=missing), S)
        (end,) = strict.tick(5 * S)
        assert isinstance(end, SequenceReport) and f"effect ({told})" in end.result.reason
    seen_one = run_of("steps: ['press:SAVE => effect']")
    seen_one.start(0)
    (end,) = seen_one.result(answer("r.1", effect="none seen, as a name of a lamp"), S)
    assert isinstance(end, SequenceReport) and end.result.outcome is Outcome.REACHED, "no words decide"
