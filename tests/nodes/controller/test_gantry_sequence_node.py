"""The sequencer as a node: text in, commands to the controller one by one, one answer for the whole."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from std_msgs.msg import Empty, String

from gantry_driver.nodes.sequence_node import SequenceNode
from icu_common.adapters.real_time import steady_s
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen
from icu_common.core.reasons.codes import CODE, ControllerCode
from icu_common.nodes import qos
from icu_common.nodes.messages.heads import header
from icu_common.nodes.messages.panels import panel_state_message
from icu_common.nodes.messages.results import diagnostic_status, result_message, result_of_message
from icu_common.nodes.state_codes import code_values


class Rig:
    """The node, and a controller played by the test."""

    def __init__(self, ros: Any, **parameters: float) -> None:
        self.ros = ros
        self.node = ros.node(SequenceNode, {"check_s": 0.5, **parameters})
        self.probe = ros.plain()
        self.commands: list[String] = ros.collect(self.probe, String, "command", qos.COMMAND)
        self.answers: list[DiagnosticArray] = ros.collect(self.probe, DiagnosticArray, "sequence_result", qos.RESULTS)
        self.states: list[String] = ros.collect(self.probe, String, "sequence_state", qos.LATCHED)
        self.sequence = self.probe.create_publisher(String, "sequence", qos.COMMAND)
        self.result = self.probe.create_publisher(DiagnosticArray, "result", qos.RESULTS)
        self.panel = self.probe.create_publisher(DiagnosticArray, "panel/state", qos.RESULTS)
        self.state = self.probe.create_publisher(String, "state", qos.LATCHED)
        self.driver = self.probe.create_publisher(String, "driver_state", qos.LATCHED)
        self.reports = self.probe.create_publisher(DiagnosticArray, "/diagnostics", qos.RESULTS)
        self.stops: list[Empty] = ros.collect(self.probe, Empty, "stop_request", qos.RESULTS)
        for publisher in (self.sequence, self.result, self.panel, self.state, self.driver, self.reports):
            ros.spin_until(lambda p=publisher: p.get_subscription_count() == 1, 10.0)
        for topic in ("command", "sequence_result", "sequence_state", "stop_request"):
            ros.spin_until(lambda t=topic: self.probe.count_publishers(t) == 1, 10.0)
        ros.spin_until(lambda: self.states, 10.0)
        ros.spin_until(lambda: not self.node.hindrance(), 10.0)

    def now_ns(self) -> int:
        return int(self.probe.get_clock().now().nanoseconds)

    def wait_for_command(self, count: int) -> str:
        self.ros.spin_until(lambda: len(self.commands) >= count, 10.0)
        return str(self.commands[count - 1].data)

    def reach(self, goal_id: str) -> None:
        done = GoalResult(goal_id=goal_id, goal="", outcome=Outcome.REACHED, details=(("effect", "none seen"),))
        self.result.publish(result_message(done, self.now_ns()))

    def see(self, lamp: str, ahead_s: float = 0.0) -> None:
        stamp = self.now_ns() + int(ahead_s * 1e9)
        seen = PanelSeen(stamp_ns=stamp, controls=(ControlSeen(name="RUN_STOP", kind="button", lamp=lamp),))
        self.panel.publish(panel_state_message(seen, header(seen.stamp_ns, "camera")))

    def report(self, state: str, code: ControllerCode) -> None:
        values = code_values(self.state.topic_name, {CODE: code.value})
        self.reports.publish(DiagnosticArray(status=[diagnostic_status("gantry controller", "warn", state, values)]))

    def final(self, goal_id: str) -> GoalResult:
        def last() -> GoalResult | None:
            results = [r for r in map(result_of_message, self.answers) if r.goal_id == goal_id]
            return results[-1] if results and results[-1].outcome.final else None

        result = self.ros.spin_until(last, 10.0)
        assert isinstance(result, GoalResult)
        return result


def test_steps_follow_each_other_and_the_whole_is_answered(ros: Any) -> None:
    rig = Rig(ros, check_s=20.0)
    assert rig.states[-1].data == "idle"
    rig.sequence.publish(String(data="id: mine\nsteps: ['press:RUN_STOP => lamp:RUN_STOP=red', 'press:SAVE']\n"))
    assert rig.wait_for_command(1) == "press:RUN_STOP id=mine.1"
    ros.spin_until(lambda: rig.states[-1].data == "step 1/2: press:RUN_STOP", 10.0)
    rig.sequence.publish(String(data="id: other\nsteps: ['press:MENU']\n"))
    ros.spin_until(lambda: any(result_of_message(m).outcome is Outcome.REJECTED for m in rig.answers), 10.0)
    busy = next(r for r in map(result_of_message, rig.answers) if r.outcome is Outcome.REJECTED)
    assert busy.goal_id == "other" and "busy with 'mine'" in busy.reason
    rig.reach("mine.1")
    # The check wants a picture from after the answer.
    ros.spin_until(lambda: (rig.see("red"), len(rig.commands) == 2)[1], 10.0)
    assert rig.wait_for_command(2) == "press:SAVE id=mine.2"
    rig.reach("mine.2")
    result = rig.final("mine")
    assert result.goal_id == "mine" and result.outcome is Outcome.REACHED
    assert dict(result.details)["steps_done"] == "2"
    ros.spin_until(lambda: rig.states[-1].data == "idle", 10.0)


def test_a_wrong_text_is_refused_with_its_line_and_a_missing_check_ends_it(ros: Any) -> None:
    rig = Rig(ros)
    rig.sequence.publish(String(data="id: bad\nsteps:\n  - press:RUN_STOP\n  - poke:MENU\n"))
    refused = rig.final("bad")
    assert refused.goal_id == "bad" and refused.outcome is Outcome.REJECTED
    assert "sequence:4: gesture 'poke'" in refused.reason
    assert rig.commands == []
    rig.sequence.publish(String(data="steps: ['press:RUN_STOP => lamp:RUN_STOP=red', 'press:SAVE']"))
    goal_id = rig.wait_for_command(1).partition(" id=")[2]
    rig.reach(goal_id)
    ended = rig.final(goal_id.rpartition(".")[0])
    assert ended.outcome is Outcome.ABORTED and "not seen in time: lamp:RUN_STOP=red" in ended.reason
    assert len(rig.commands) == 1


def test_a_step_that_this_panel_cannot_fulfil_is_refused_before_the_first_one_moves(ros: Any) -> None:
    rig = Rig(ros)
    ros.spin_until(lambda: (rig.see("green"), rig.node._panel)[1], 10.0)
    for run_id, step, what in (("a", "press:SAVE", "no SAVE"), ("b", "press:RUN_STOP => screen", "no screen")):
        rig.sequence.publish(String(data=f"id: {run_id}\nsteps: ['press:RUN_STOP', '{step}']"))
        refused = rig.final(run_id)
        assert refused.outcome is Outcome.REJECTED and f"step 2: this panel has {what}" in refused.reason
    assert rig.commands == []


def test_what_a_camera_with_a_clock_ahead_has_seen_does_not_count(ros: Any) -> None:
    rig = Rig(ros)
    rig.sequence.publish(String(data="id: mine\nsteps: ['press:RUN_STOP => lamp:RUN_STOP=red']\n"))
    rig.wait_for_command(1)
    rig.see("red", ahead_s=3600.0)
    rig.reach("mine.1")
    assert rig.final("mine").outcome is Outcome.ABORTED


def test_a_value_that_cannot_be_read_does_not_end_the_sequencer(ros: Any) -> None:
    rig = Rig(ros)
    rig.sequence.publish(String(data="id: bad\nsteps:\n  - {do: press:MENU, within_s: 2026-13-45}\n"))
    assert rig.final("bad").reason == "sequence:3: month must be in 1..12"
    rig.sequence.publish(String(data="id: good\nsteps: ['press:SAVE']"))
    assert rig.wait_for_command(1) == "press:SAVE id=good.1"


@pytest.mark.parametrize(
    ("state", "code"),
    [
        ("stopped: operator", None),
        ("alarm: 1 hard limit", None),
        ("waiting: no operator (heartbeat)", ControllerCode.NO_OPERATOR),
        ("waiting: not enabled", ControllerCode.DRIVER_NOT_READY),
        ("waiting: driver disconnected: unplugged", ControllerCode.DRIVER_NOT_READY),
    ],
)
@pytest.mark.parametrize("first", ["text", "code"])
def test_what_ends_a_gesture_ends_a_sequence_that_waits_for_a_check_too(
    ros: Any, state: str, code: ControllerCode | None, first: str
) -> None:
    rig = Rig(ros)
    steps = "{do: press:RUN_STOP, check: 'lamp:RUN_STOP=red', within_s: 60}, 'press:SAVE'"
    rig.sequence.publish(String(data=f"id: mine\nsteps: [{steps}]"))
    rig.wait_for_command(1)
    rig.reach("mine.1")
    ros.spin_until(lambda: rig.node._run._answer is not None, 10.0)
    if first == "code" and code is not None:
        rig.report(state, code)
        ros.spin_until(lambda: rig.node._codes.values_of(state), 10.0)
    rig.state.publish(String(data=state))
    if first == "text" and code is not None:
        ros.spin_until(lambda: rig.node._controller == state, 10.0)
        assert rig.node._run is not None, "no program decides by the words"
        rig.report(state, code)
    ended = rig.final("mine")
    assert ended.outcome is Outcome.ABORTED and ended.reason.endswith(f"press:RUN_STOP: {state}")
    rig.state.publish(String(data="ready"))
    rig.see("red")
    ros.spin_until(lambda: rig.states[-1].data == "idle", 10.0)
    assert len(rig.commands) == 1, "the second step was never sent"


def rig_that_waits_for_a_check(ros: Any) -> Rig:
    """Return a rig whose sequencer has had the answer of its only gesture, and waits for a red lamp."""
    rig = Rig(ros)
    rig.sequence.publish(
        String(data="id: mine\nsteps: [{do: press:RUN_STOP, check: 'lamp:RUN_STOP=red', within_s: 60}]")
    )
    rig.wait_for_command(1)
    rig.reach("mine.1")
    ros.spin_until(lambda: rig.node._run._answer is not None, 10.0)
    return rig


def test_a_stop_that_was_reset_while_the_sequencer_was_held_up_ends_it(ros: Any) -> None:
    """Only the newest state was kept for a node that was held up: it never received the stop, and continued to
    press."""
    rig = rig_that_waits_for_a_check(ros)
    rig.state.publish(String(data="stopped: operator"))
    rig.state.publish(String(data="ready"))
    ros.spin_until(lambda: (rig.see("red"), rig.node._run is None)[1], 10.0)
    ended = rig.final("mine")
    assert ended.outcome is Outcome.ABORTED and ended.reason.endswith("press:RUN_STOP: stopped: operator")


def test_an_operator_who_was_absent_while_the_sequencer_was_held_up_ends_it(ros: Any) -> None:
    """The codes of both states come after the newer state: the older one still has its own."""
    rig = rig_that_waits_for_a_check(ros)
    rig.state.publish(String(data="waiting: no operator (heartbeat)"))
    rig.state.publish(String(data="ready"))
    ros.spin_until(lambda: rig.node._controller == "ready", 10.0)
    rig.report("ready", ControllerCode.READY)
    rig.report("waiting: no operator (heartbeat)", ControllerCode.NO_OPERATOR)
    ended = rig.final("mine")
    assert ended.outcome is Outcome.ABORTED and ended.reason.endswith("waiting: no operator (heartbeat)")


def test_a_state_in_which_the_machine_can_continue_ends_no_sequence(ros: Any) -> None:
    rig = Rig(ros)
    rig.sequence.publish(
        String(data="id: mine\nsteps: [{do: press:RUN_STOP, check: 'lamp:RUN_STOP=red', within_s: 60}, 'press:SAVE']")
    )
    rig.wait_for_command(1)
    rig.reach("mine.1")
    ros.spin_until(lambda: rig.node._run._answer is not None, 10.0)
    rig.report("waiting: not calibrated", ControllerCode.NOT_CALIBRATED)
    rig.state.publish(String(data="waiting: not calibrated"))
    ros.spin_until(lambda: rig.node._controller and not rig.node._unjudged, 10.0)
    ros.spin_until(lambda: (rig.see("red"), len(rig.commands) == 2)[1], 10.0)


def test_a_clock_that_was_set_back_ends_it_at_once_and_not_when_the_time_has_come_again(ros: Any) -> None:
    rig = Rig(ros)
    rig.sequence.publish(String(data="id: mine\nsteps: ['press:RUN_STOP']"))
    rig.wait_for_command(1)
    clock = rig.node.get_clock()
    now = clock.now()
    clock._set_ros_time_is_active(True)
    # All following steps take less than the minute: for a timer of this clock no time passes.
    clock.set_ros_time_override(now - Duration(seconds=60.0))
    ended = rig.final("mine")
    assert ended.outcome is Outcome.ABORTED and "the clock jumped back by " in ended.reason


def test_without_a_controller_it_is_refused_and_nothing_is_sent_later(ros: Any) -> None:
    """Just after its start the sequencer has not found the controller yet; the first command reached no program."""
    node = ros.node(SequenceNode, {})
    probe = ros.plain()
    answers = ros.collect(probe, DiagnosticArray, "sequence_result", qos.RESULTS)
    reports = ros.collect(probe, DiagnosticArray, "/diagnostics", qos.RESULTS)
    sequence = probe.create_publisher(String, "sequence", qos.COMMAND)
    ros.spin_until(lambda: sequence.get_subscription_count() == 1, 10.0)
    ros.spin_until(lambda: probe.count_publishers("sequence_result") == 1, 10.0)

    def refusal(run_id: str) -> GoalResult:
        def mine() -> list[GoalResult]:
            return [r for r in map(result_of_message, answers) if r.goal_id == run_id]

        sequence.publish(String(data=f"id: {run_id}\nsteps: ['press:SAVE']"))
        found = ros.spin_until(mine, 10.0)
        return found[0]

    alone = refusal("alone")
    assert (alone.outcome, alone.reason) == (Outcome.REJECTED, "no gantry controller is running")
    ros.spin_until(
        lambda: any(s.message == "waiting: no gantry controller is running" for m in reports for s in m.status), 10.0
    )
    commands = ros.collect(probe, String, "command", qos.COMMAND)
    ros.spin_until(lambda: node.count_subscribers("command") == 1, 10.0)
    mute = refusal("mute")
    assert (mute.outcome, mute.reason) == (Outcome.REJECTED, "no gantry controller is running"), "it could not answer"
    probe.create_publisher(DiagnosticArray, "result", qos.RESULTS)
    ros.spin_until(lambda: not node.hindrance(), 10.0)
    sequence.publish(String(data="id: heard\nsteps: ['press:SAVE']"))
    ros.spin_until(lambda: commands, 10.0)
    assert [m.data for m in commands] == ["press:SAVE id=heard.1"]


def test_a_sequencer_that_was_held_up_gives_no_step_that_nobody_expects_any_more(ros: Any) -> None:
    """Its sender received "no answer" long ago, and may be working by hand, or in the room."""
    rig = Rig(ros, check_s=5.0)
    done = GoalResult(goal_id="", goal="", outcome=Outcome.REACHED)
    red = PanelSeen(stamp_ns=0, controls=(ControlSeen(name="RUN_STOP", kind="button", lamp="red"),))
    waking = {
        "answer": lambda node: node._on_result(result_message(replace(done, goal_id="answer.1"), rig.now_ns())),
        "picture": lambda node: node._on_panel(panel_state_message(red, header(rig.now_ns(), "camera"))),
        "state": lambda node: node._on_controller(String(data="ready")),
        "clock": lambda node: node._on_tick(),
        "other": lambda node: node._on_sequence(String(data="id: next\nsteps: ['double:RUN_STOP']")),
    }
    for run_id, wake in waking.items():
        rig.node._steady_s = steady_s
        check = "" if run_id == "answer" else " => lamp:RUN_STOP=red"
        rig.commands.clear()
        rig.sequence.publish(String(data=f"id: {run_id}\nsteps: ['press:RUN_STOP{check}', 'long:RUN_STOP']"))
        assert rig.wait_for_command(1) == f"press:RUN_STOP id={run_id}.1"
        if run_id != "answer":
            rig.reach(f"{run_id}.1")
            ros.spin_until(lambda: rig.node._run._answer is not None, 10.0)
        rig.node._steady_s = lambda later_s=rig.node._awake_s + 4.0: later_s
        wake(rig.node)
        ended = rig.final(run_id)
        assert ended.outcome is Outcome.ABORTED
        assert re.search(r"step 1 of 2, press:RUN_STOP: the sequencer was blocked for [45]\.\d s$", ended.reason)
        assert not [command.data for command in rig.commands if "long" in command.data]
    ros.spin_until(lambda: rig.commands, 10.0)
    assert rig.commands[-1].data == "double:RUN_STOP id=next.1"


@pytest.mark.parametrize("state", ["waiting: not calibrated", "ready", "stopped: stop requested"])
def test_a_controller_that_was_started_anew_in_a_step_ends_the_sequence(ros: Any, state: str) -> None:
    rig = Rig(ros)
    rig.state.publish(String(data="moving"))
    ros.spin_until(lambda: rig.node._controller == "moving", 10.0)
    rig.sequence.publish(String(data="id: mine\nsteps: ['press:RUN_STOP', 'press:SAVE']"))
    rig.wait_for_command(1)
    taken = GoalResult(goal_id="mine.1", goal="", outcome=Outcome.ACCEPTED)
    rig.result.publish(result_message(taken, rig.now_ns()))
    ros.spin_until(lambda: rig.node._run._taken, 10.0)
    rig.node._run._config = replace(rig.node._run._config, accept_timeout_s=1.0)
    begun_ns = rig.now_ns()
    ros.spin_until(lambda: rig.now_ns() > begun_ns + 2_000_000_000, 10.0)
    assert rig.states[-1].data == "step 1/2: press:RUN_STOP", "it works on it"
    assert rig.stops == []
    rig.driver.publish(String(data="idle"))
    rig.state.publish(String(data=state))
    ros.spin_until(lambda: rig.stops, 10.0)
    rig.driver.publish(String(data="stopped: stop requested"))
    ended = rig.final("mine")
    assert ended.outcome is Outcome.ABORTED and "at rest for 1 s without an answer to it" in ended.reason
    assert ended.reason.endswith("; the sequencer has ordered a stop, and the driver is 'stopped: stop requested'")
    assert len(rig.commands) == 1 and len(rig.stops) == 1


def test_a_gesture_that_takes_longer_than_the_time_without_a_sign_is_followed(ros: Any) -> None:
    rig = Rig(ros, answer_timeout_s=2.0)
    rig.sequence.publish(String(data="id: mine\nsteps: ['press:RUN_STOP', 'press:SAVE']"))
    rig.wait_for_command(1)
    taken = GoalResult(goal_id="mine.1", goal="", outcome=Outcome.ACCEPTED)
    rig.state.publish(String(data="moving"))
    rig.result.publish(result_message(taken, rig.now_ns()))
    rig.driver.publish(String(data="moving"))
    begun_ns = rig.now_ns()
    ros.spin_until(lambda: rig.now_ns() > begun_ns + 5_000_000_000, 15.0)
    assert rig.states[-1].data == "step 1/2: press:RUN_STOP" and rig.stops == []
    rig.driver.publish(String(data="idle"))
    ros.spin_until(lambda: rig.stops, 10.0)
    rig.driver.publish(String(data="stopped: stop requested"))
    ended = rig.final("mine")
    assert "no sign of progress for 2 s; the controller has ordered a stop" in ended.reason
    rig.reach("mine.1")
    ros.spin_until(lambda: rig.states[-1].data == "idle", 10.0)
    assert len(rig.commands) == 1, "an answer that comes late starts no next step"


def test_a_clock_that_jumps_back_ends_a_sequence(ros: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else it would wait for pictures of the old time, and go on by itself when they come."""
    rig = Rig(ros)
    rig.sequence.publish(String(data="id: mine\nsteps: ['press:RUN_STOP => lamp:RUN_STOP=red', 'press:SAVE']"))
    rig.wait_for_command(1)
    rig.reach("mine.1")
    ros.spin_until(lambda: rig.node._run._answer is not None, 10.0)
    monkeypatch.setattr(rig.node, "_now_ns", lambda: rig.now_ns() - 60_000_000_000)
    ended = rig.final("mine")
    assert ended.outcome is Outcome.ABORTED and "the clock jumped back by " in ended.reason
    ros.spin_until(lambda: rig.states[-1].data == "idle", 10.0)
    assert len(rig.commands) == 1


def test_a_text_that_a_parser_chokes_on_is_refused_at_once_and_shown_cut(ros: Any) -> None:
    rig = Rig(ros)
    for text, why in (
        (f"steps: {3000 * '['}", "more than 12 open brackets"),
        (f"name: {70_000 * 'x'}", "the text has 70007 bytes (limit 65536)"),
        ("steps: [poke\x1b[2J:A]", "unacceptable character"),
        (f"steps: [{{do: press:A, check: {{k: {900 * 'z'}}}}}]", "more characters)"),
    ):
        before, begin_s = len(rig.answers), time.process_time()
        rig.sequence.publish(String(data=f"id: a\x1b[31m\n{text}"))
        ros.spin_until(lambda n=before: len(rig.answers) > n, 10.0)
        assert time.process_time() - begin_s < 1.0
        raw = rig.answers[-1].status[0].values
        assert all(len(pair.value) < 600 and pair.value.isprintable() for pair in raw), raw
        answer = result_of_message(rig.answers[-1])
        assert (answer.outcome, answer.goal_id) == (Outcome.REJECTED, "a\\x1b[31m")
        assert why in answer.reason
    assert rig.commands == []
