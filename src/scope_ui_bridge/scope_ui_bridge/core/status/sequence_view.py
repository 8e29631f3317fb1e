"""Sequences on the page: stored sequences, checks before a start, and progress of the running one."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from typing import Any

from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.goals.sequence import GestureSequence, SequenceError, parse_steps, unfit
from icu_common.core.panel.gesture import parse_gesture
from icu_common.core.panel.panel_state import PanelSeen
from icu_common.core.reasons.message import Message, quoted
from icu_common.core.reasons.state_text import state_name
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.wire import Refusal

_STATE = re.compile(r"step (\d+)/(\d+): ")


def stored_name(stem: str) -> str:
    """Return the name of a stored sequence on pages: its file's name with composed letters.

    Raises
    ------
    SequenceError
        If a page could not request this name, for example because of invisible characters.
    """
    name = unicodedata.normalize("NFC", stem)
    if len(name) > wire.MAX_TEXT or not name.isprintable():
        shown, limit = name[: wire.MAX_TEXT], wire.MAX_TEXT
        raise SequenceError(
            Message("sequence.file_name_characters_all_seen", shown=quoted(shown), name=len(name), limit=limit)
        )
    return name


class SequenceView:
    """State of sequences for pages; ``stored`` has the sequences read from files, by file name."""

    def __init__(self) -> None:
        self.stored: dict[str, GestureSequence] = {}
        self.run_id = ""
        self.who = ""
        self._name = ""
        self._steps: list[str] = []
        self._state = ""
        self._number = 0
        self._status = ""
        self._reason = ""

    def chosen(
        self, message: wire.RunSequence, controls: Iterable[str], seen: PanelSeen | None
    ) -> tuple[str, GestureSequence]:
        """Return name and steps of the sequence that a page requests; ``controls`` are those of the panel.

        Raises
        ------
        Refusal
            ``sequence_unknown``, ``sequence_wrong`` with the step and the problem, ``sequence_control``.
        """
        if message.stored:
            if message.stored not in self.stored:
                raise Refusal("sequence_unknown", name=message.stored)
            sequence = self.stored[message.stored]
        else:
            try:
                sequence = parse_steps(message.steps)
            except SequenceError as error:
                raise Refusal("sequence_wrong", what=str(error)) from error
        known = set(controls)
        for number, step in enumerate(sequence.steps, 1):
            target = parse_gesture(step.gesture).target
            missing = {target} if isinstance(target, str) else set()
            missing = (missing | {check.control for check in step.checks if check.control}) - known
            if missing:
                raise Refusal("sequence_control", step=number, control=", ".join(sorted(missing)))
        if seen is not None and (wrong := unfit(sequence, seen)):
            raise Refusal("sequence_wrong", what=wrong)
        return message.stored or sequence.name, sequence

    def started(self, run_id: str, who: str, name: str, sequence: GestureSequence) -> None:
        """Record a sequence sent to the sequencer."""
        self.run_id, self.who, self._name = run_id, who, name
        self._steps = [step.text() for step in sequence.steps]
        self._number, self._status, self._reason = 0, "sent", ""

    def set_state(self, text: str) -> None:
        """Set the sequencer's state, ``idle`` or ``step 2/3: press:RUN_STOP``; empty if there is no sequencer."""
        self._state = text
        found = _STATE.match(text)
        if found and self._status in ("sent", "accepted"):
            self._number = int(found[1])

    def result(self, result: GoalResult) -> None:
        """Process a result of the sequencer."""
        if result.goal_id != self.run_id:
            return
        self._status, self._reason = result.outcome.value, result.reason
        done = dict(result.details).get("steps_done", "")
        if result.outcome.final and done.isdigit():
            self._number = int(done) + (result.outcome is Outcome.ABORTED)

    def ended(self, run_id: str, status: str, reason: str) -> None:
        """Record that the sequence was not sent (failed), or that no answer arrived."""
        if run_id and run_id == self.run_id and self._status in ("sent", "accepted"):
            self._status, self._reason = status, reason

    @property
    def at_work(self) -> bool:
        """Whether the sequencer is running a sequence of any client."""
        return state_name(self._state) == "step"

    def check_idle(self) -> None:
        """Refuse while a sequence is running: ``sequence_runs``."""
        if self.at_work:
            raise Refusal("sequence_runs", step=self._state)

    def owner_of(self, goal_id: str) -> str:
        """Return the user who started the sequence of a step's goal; empty for other goals."""
        return self.who if self.run_id and goal_id.rpartition(".")[0] == self.run_id else ""

    def message(self) -> dict[str, Any]:
        """Return the message for pages; ``number`` is the current or failed step, from 1."""
        return {
            "name": self._name,
            "who": self.who,
            "steps": self._steps,
            "number": self._number,
            "status": self._status,
            "reason": self._reason,
            "state": self._state,
        }

    def stored_message(self) -> list[dict[str, Any]]:
        """Return the stored sequences for a new page."""
        return [
            {"name": name, "title": sequence.name, "steps": [step.text() for step in sequence.steps]}
            for name, sequence in sorted(self.stored.items())
        ]
