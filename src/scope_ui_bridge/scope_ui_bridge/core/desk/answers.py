"""Answers and results: what became of an order, from here or from another client."""

from __future__ import annotations

from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.reasons.codes import STOP_ASKED
from scope_ui_bridge.core.desk.early_reset import EarlyReset
from scope_ui_bridge.core.desk.motions import Motions
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.effects import Broadcast, Effect, MachineOrder, Now
from scope_ui_bridge.core.orders import goal_words, result_words
from scope_ui_bridge.core.records import LogEntry, result_record, shown

_RECORDER = "bag_record"


class Answers:
    """Enters each answer in the command log, and returns what shows and records it."""

    def __init__(self, state: DeskState, motions: Motions, early: EarlyReset) -> None:
        self._state = state
        self._early = early
        self._motions = motions

    def tick(self, now: Now) -> list[Effect]:
        """Give up commands without an answer, and complete the stops of a driver that reports them."""
        state = self._state
        effects: list[Effect] = []
        if state.machine.state("driver")[0] == "stopped":  # its answer may be lost on an overloaded computer
            for number in state.log.open_entries("stop"):
                effects += self.service_answered(number, True, "", now)
        effects += self._early.tick(now)
        effects += state.log.expire(state.machine.active, state.config.answer_timeout_s, now)
        if state.log.goal(state.sequence.run_id) is None:
            state.sequence.ended(state.sequence.run_id, "no_answer", "")
        return effects

    def order_failed(self, order: MachineOrder, reason: str, now: Now) -> list[Effect]:
        """Record that an order was not sent (no controller, audit file not writable, stopped meanwhile)."""
        entry = self._state.log.open_entry(order.entry)
        if entry is None:
            return []
        self._motions.not_sent(order)
        self._state.sequence.ended(entry.goal_id, "failed", reason)
        return self._changed(entry, "failed", reason, now)

    def service_answered(self, number: int, success: bool, text: str, now: Now) -> list[Effect]:
        """Process the answer of a service to log entry ``number``, or of the driver to a stop."""
        entry = self._state.log.open_entry(number) or self._state.log.given_up(number=number)
        if entry is None:
            return []
        if not success and (put_off := self._early.put_off(entry, text, now)) is not None:
            return put_off
        refused = "failed" if entry.action == "stop" else "rejected"  # a stop is never refused
        return self._changed(entry, "done" if success else refused, text, now)

    def recording_ended(self, success: bool, text: str, now: Now) -> list[Effect]:
        """Record that a recording has ended by itself."""
        status = "done" if success else "failed"
        return self._changed(self._state.log.add(_RECORDER, "end_record", "", now, status=status), status, text, now)

    def taught(self, result: GoalResult, now: Now) -> list[Effect]:
        """Process perception's answer to a lesson."""
        known = self._state.log.goal(result.goal_id)
        if known is None:
            return []
        done = result.outcome is Outcome.REACHED
        details = {**dict(result.details), "type": "taught", "ok": done, "reason": result.reason}
        return [Broadcast(message=details), *self._state.log.ended(known, result, now)]

    def sequence_result(self, result: GoalResult, now: Now) -> list[Effect]:
        """Process a result of the sequencer, for a sequence from here or from another client."""
        self._state.sequence.result(result)
        return self.result(result, now)

    def result(self, result: GoalResult, now: Now) -> list[Effect]:
        """Process a result of the controller, for a command from here or from another client."""
        state = self._state
        if STOP_ASKED in dict(result.details):
            state.causes.aborted(result.reason, now.mono_s)
        known = state.log.goal(result.goal_id) or state.log.given_up(goal_id=result.goal_id)
        if known is None:
            if result.outcome.final and result.outcome is not Outcome.REJECTED:
                return []  # the end of a goal that this log no longer contains
            who = state.sequence.owner_of(result.goal_id) or "Graph"
            action, target = goal_words(result.goal, state.scene.faces)
            known = state.log.add(who, action, target, now, status="accepted", goal_id=result.goal_id)
        next_step = self._motions.ended(known, result, now)
        if next_step is not None:
            return next_step
        return state.log.ended(known, result_words(result, state.scene.faces), now)

    def _changed(self, entry: LogEntry, status: str, reason: str, now: Now) -> list[Effect]:
        changed = self._state.log.update(entry, status=status, reason=reason)
        return [shown(changed), result_record(changed, now)]
