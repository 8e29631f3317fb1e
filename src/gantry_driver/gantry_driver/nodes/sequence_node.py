"""Node that carries out sequences of gestures, one step after the other, and stops at the first failed step.

``sequence`` takes the text of a sequence file (icu_common.core.goals.sequence). If the first line is ``id: TEXT``, the
answers carry this id. The node sends the controller one command at a time, so a stop of a gesture stops the sequence.
Between two gestures, a stop or the loss of the operator or the driver ends the sequence; it does not continue when they
return. A blockage of this process also ends it, because the sender has meanwhile got the result that no answer came.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Empty, String

from gantry_driver.core.goals.sequence import Action, SendStepCommand, SequenceConfig, SequenceRun, StopMachine
from gantry_driver.core.job.goal_job import WORKING
from icu_common.adapters.real_time import steady_s
from icu_common.core.configuration.text_bounds import plain
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.goals.sequence import GestureSequence, SequenceError, parse_file, unfit
from icu_common.core.reasons.codes import CODE, MAX_REPORTS, NOT_OPERABLE
from icu_common.core.reasons.message import Message, quoted
from icu_common.core.reasons.state_text import because, state_name
from icu_common.nodes import qos
from icu_common.nodes.diagnostics import Diagnostics
from icu_common.nodes.graph_node import GraphNode
from icu_common.nodes.messages.heads import check_not_ahead
from icu_common.nodes.messages.panels import panel_state_of_message
from icu_common.nodes.messages.results import result_message, result_of_message
from icu_common.nodes.parameters import LiveParameters
from icu_common.nodes.runtime import run
from icu_common.nodes.state_codes import StateCodes, code_values
from icu_common.nodes.timers import every, runs_by_clock_topic, seconds_of

TICK_S = 0.1
HELD_UP_S = 3.0
"""Maximum seconds without a tick; a longer blockage ends the sequence: the page abandons a sequencer silent for 5 s."""


class SequenceNode(GraphNode):
    """Carries out one sequence at a time.

    It subscribes to ``sequence``, ``result``, ``state``, ``driver_state`` and ``panel/state``, and publishes
    ``command``, ``stop_request``, ``sequence_result`` and ``sequence_state``.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("sequencer", **options)
        self._live = LiveParameters(self, SequenceConfig)
        self._run: SequenceRun | None = None
        # A slow simulation delays the timers of every node, and the senders' time limits as well.
        self._steady_s = seconds_of(self) if runs_by_clock_topic(self) else steady_s
        self._awake_s = self._steady_s()
        self._panel: DiagnosticArray | None = None
        self._controller = self._driver = ""
        self._unjudged: deque[str] = deque(maxlen=MAX_REPORTS)
        """States of the controller since the start of the sequence whose codes have not been reported yet."""
        self._count = 0
        self._command = self.create_publisher(String, "command", qos.COMMAND)
        self._stop = self.create_publisher(Empty, "stop_request", qos.RESULTS)
        self._answers = self.create_publisher(DiagnosticArray, "sequence_result", qos.RESULTS)
        self._state = self.create_publisher(String, "sequence_state", qos.LATCHED)
        self._diagnostics = Diagnostics(self)
        # After a blockage, executors other than our own take waiting messages in this order: a stop comes first.
        self._codes = StateCodes(self, "state", self._judge_controller)
        self._driver_reports = self._codes.of_another("driver_state")
        self.create_subscription(String, "state", self._on_controller, qos.EACH_LATCHED)
        self._drivers = self.create_subscription(String, "driver_state", self._on_driver, qos.EACH_LATCHED)
        self._results = self.create_subscription(DiagnosticArray, "result", self._on_result, qos.RESULTS)
        self.create_subscription(DiagnosticArray, "panel/state", self._on_panel, qos.SENSOR)
        self.create_subscription(String, "sequence", self._on_sequence, qos.COMMAND)
        every(self, TICK_S, self._on_tick)
        every(self, 1.0, self._report)
        self._state.publish(String(data="idle"))

    def close(self) -> None:
        """Report the end of an unfinished sequence; the controller finishes its gesture and then rests."""
        if self._run is not None:
            self._act(self._run.abort(Message("sequence.sequencer_ending"), self._now_ns()))

    def hindrance(self) -> str:
        """Return why no sequence can be carried out now, empty if one can: without a controller, commands are lost."""
        heard = self._command.get_subscription_count() and self._results.get_publisher_count()
        return "" if heard else Message("sequence.no_gantry_controller_listens")

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _at_work(self) -> SequenceRun | None:
        """Return the sequence in progress; first end one during which this process was blocked."""
        before_s, self._awake_s = self._awake_s, self._steady_s()
        held_up_s = self._awake_s - before_s
        if self._run is not None and held_up_s > HELD_UP_S:
            self._act(self._run.abort(Message("sequence.sequencer_held_up", held_up_s=held_up_s), self._now_ns()))
        return self._run

    def _on_sequence(self, message: String) -> None:
        first, _, rest = message.data.partition("\n")
        self._count += 1
        run_id = f"sequence-{self._count}"
        text = message.data
        if first.startswith("id:"):
            # The line is emptied, not removed, so that errors name the sender's line numbers.
            run_id, text = plain(first[3:60].strip()[:48]), "\n" + rest
        try:
            if (run := self._at_work()) is not None:
                raise SequenceError(Message("sequence.busy", run_id=quoted(run.run_id), state=run.state))
            if hindrance := self.hindrance():
                raise SequenceError(hindrance)
            sequence = parse_file(text)
            self._check(sequence)
        except SequenceError as error:
            refused = GoalResult(goal_id=run_id, goal="sequence", outcome=Outcome.REJECTED, reason=str(error))
            self._answers.publish(result_message(refused, self._now_ns()))
            return
        self._unjudged.clear()
        self._run = SequenceRun(sequence, run_id, self._live.config)
        self._act(self._run.start(self._now_ns()))

    def _check(self, sequence: GestureSequence) -> None:
        """Raise SequenceError for a step that the panel, as seen so far, can never fulfil."""
        if self._panel is None:
            return
        try:
            wrong = unfit(sequence, panel_state_of_message(self._panel))
        except ValueError as error:
            self.get_logger().error(f"panel/state: {error}")
            return
        if wrong:
            raise SequenceError(wrong)

    def _on_result(self, message: DiagnosticArray) -> None:
        if (run := self._at_work()) is None:
            return
        try:
            answer = result_of_message(message)
        except ValueError as error:
            self.get_logger().error(f"result: {error}")
            return
        self._act(run.result(answer, self._now_ns()))

    def _on_panel(self, message: DiagnosticArray) -> None:
        self._panel = message
        if (run := self._at_work()) is None:
            return
        try:
            check_not_ahead(message.header, self.get_clock())
            seen = panel_state_of_message(message)
        except ValueError as error:
            self.get_logger().error(f"panel/state: {error}", throttle_duration_sec=5.0)
            return
        self._act(run.panel(seen, self._now_ns()))

    def _on_controller(self, message: String) -> None:
        state = plain(message.data)
        changed, self._controller = state != self._controller, state
        if (run := self._at_work()) is None:
            return
        if changed:
            run.sign(self._now_ns())
        self._unjudged.append(state)
        self._judge_controller()

    def _judge_controller(self) -> None:
        """End the sequence in progress if the machine cannot continue: by the name of a state, or by its code."""
        texts, self._unjudged = self._unjudged, deque(maxlen=MAX_REPORTS)
        for text in texts:
            values = self._codes.values_of(text)
            stopped = state_name(text) in ("stopped", "alarm") or (values or {}).get(CODE) in NOT_OPERABLE
            if values is None and not stopped:
                self._unjudged.append(text)
            elif stopped and (run := self._at_work()) is not None:
                self._act(run.stopped(self._codes.message_of(text), self._now_ns()))

    def _on_driver(self, message: String) -> None:
        state = plain(message.data)
        changed, self._driver = state != self._driver, state
        if (run := self._at_work()) is not None and changed:
            run.sign(self._now_ns())

    def _on_tick(self) -> None:
        if (run := self._at_work()) is not None:
            at_rest = state_name(self._controller) not in WORKING or bool(self.hindrance())
            # After a driver has died during a motion, its latched state is still "moving".
            driver = self._driver_reports.message_of(self._driver) if self._drivers.get_publisher_count() else ""
            self._act(run.tick(self._now_ns(), at_rest=at_rest, driver=driver))

    def _report(self) -> None:
        hindrance = self.hindrance()
        level, text = (
            ("warn", because("waiting", hindrance)) if hindrance else ("ok", self._run.state if self._run else "idle")
        )
        codes = code_values(self._state.topic_name, {})
        self._diagnostics.tell(level, text, [("sequences", self._count), *codes])

    def _act(self, actions: list[Action]) -> None:
        for action in actions:
            if isinstance(action, SendStepCommand):
                self._command.publish(String(data=action.text))
            elif isinstance(action, StopMachine):
                self.get_logger().error("stop: nobody is known to be at work on a step")
                self._stop.publish(Empty())
            else:
                self.get_logger().info(f"{action.result.goal}: {action.result.outcome.value} {action.result.reason}")
                self._answers.publish(result_message(action.result, self._now_ns()))
        if actions and self._run is not None:
            self._state.publish(String(data="idle" if self._run.done else self._run.state))
            self._run = None if self._run.done else self._run


def main() -> int:
    return run(SequenceNode, shared_memory=False)


if __name__ == "__main__":
    raise SystemExit(main())
