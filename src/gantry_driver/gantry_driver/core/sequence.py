"""Sequences of gestures with a check after each: text in, steps out, and the run as a state machine without a clock.

A step is a gesture of the command grammar, and after ``=>`` what must be seen then, several checks separated by commas:
``press:RUN_STOP => lamp:RUN_STOP=red, effect``. A file is YAML, a mapping with ``steps`` (a list of such texts, or of
mappings with ``do``, ``check`` and ``within_s``) and maybe ``name``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence as Sequence_
from dataclasses import dataclass
from typing import Any

import yaml

from icu_common.core.config import Config, setting
from icu_common.core.gesture import GestureError, parse_gesture
from icu_common.core.panel_state import PanelSeen, angle_between
from icu_common.core.results import GoalResult, Outcome

NANO = 1_000_000_000
MAX_STEPS = 100
ANGLE_TOLERANCE_DEG = 3.0
_CHECK = re.compile(r"(?:(effect|screen)|(lamp|angle):([A-Za-z][A-Za-z0-9_]*)=([^\s=]+))\Z")


class SequenceError(ValueError):
    """A sequence is wrong; the message names the line or the step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceConfig(Config):
    """Parameters of the sequencer."""

    answer_timeout_s: float = setting(90.0, "Time for a step's final answer", minimum=1.0, maximum=600.0, unit="s")
    check_s: float = setting(
        3.0, "Time for what a check wants to be seen, where the step names none", minimum=0.1, maximum=60.0, unit="s"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """What must be seen after a step: ``kind`` is effect, screen, lamp or angle."""

    kind: str
    control: str = ""
    value: str = ""

    def text(self) -> str:
        return f"{self.kind}:{self.control}={self.value}" if self.control else self.kind


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One gesture and its checks; ``within_s`` is NaN where the configuration decides."""

    gesture: str
    checks: tuple[Check, ...] = ()
    within_s: float = math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequence:
    """Steps in their order."""

    steps: tuple[Step, ...]
    name: str = ""


def parse_steps(texts: Sequence_[str]) -> Sequence:
    """Read steps as they stand on a command line.

    Raises
    ------
    SequenceError
        With the step's number and what is wrong.
    """
    return _sequence([(f"step {number}", text) for number, text in enumerate(texts, 1)], "")


def parse_file(text: str, file_name: str = "sequence") -> Sequence:
    """Read the text of a file.

    Raises
    ------
    SequenceError
        In the form ``file:line: what is wrong``.
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise SequenceError(f"{file_name}:{line}: {error.problem}") from error
    if not isinstance(root, yaml.MappingNode):
        raise SequenceError(f"{file_name}:1: a mapping with steps is needed")
    entries: list[tuple[str, Any]] = []
    name = ""
    for key, value in root.value:
        place = f"{file_name}:{key.start_mark.line + 1}"
        if key.value == "name" and isinstance(value, yaml.ScalarNode):
            name = value.value
        elif key.value == "steps" and isinstance(value, yaml.SequenceNode):
            for node in value.value:
                entries.append((f"{file_name}:{node.start_mark.line + 1}", _plain(node)))
        else:
            raise SequenceError(f"{place}: {key.value!r}: name (a text) and steps (a list) are known")
    return _sequence(entries, name)


def _plain(node: yaml.Node) -> Any:
    return yaml.SafeLoader("").construct_object(node, deep=True)


def _sequence(entries: Sequence_[tuple[str, Any]], name: str) -> Sequence:
    if not 0 < len(entries) <= MAX_STEPS:
        raise SequenceError(f"{len(entries)} steps; 1 to {MAX_STEPS} are needed")
    return Sequence(steps=tuple(_step(place, entry) for place, entry in entries), name=name)


def _step(place: str, entry: Any) -> Step:
    if isinstance(entry, dict):
        unknown = set(entry) - {"do", "check", "within_s"}
        if unknown or not isinstance(entry.get("do"), str):
            found = f"unknown key {', '.join(sorted(map(str, unknown)))}" if unknown else "no gesture"
            raise SequenceError(f"{place}: {found}; do (a gesture), check and within_s are known")
        checks = entry.get("check", [])
        texts = [checks] if isinstance(checks, str) else checks
        within = entry.get("within_s", math.nan)
        good = isinstance(within, (int, float)) and not isinstance(within, bool)
        if not good or not (math.isnan(within) or 0 < within <= 60):
            raise SequenceError(f"{place}: within_s = {within!r}: seconds above 0 and up to 60 are needed")
        if not isinstance(texts, list) or not all(isinstance(t, str) for t in texts):
            raise SequenceError(f"{place}: check = {checks!r}: a text or a list of texts is needed")
        gesture, within_s = entry["do"], float(within)
    elif isinstance(entry, str):
        gesture, arrow, after = entry.partition("=>")
        texts, within_s = after.split(",") if arrow else [], math.nan
    else:
        raise SequenceError(f"{place}: {entry!r} is neither a text nor a mapping")
    try:
        parsed = parse_gesture(gesture.strip())
    except GestureError as error:
        raise SequenceError(f"{place}: {error}") from error
    if parsed.id:
        raise SequenceError(f"{place}: {gesture.strip()!r}: ids are given by the sequencer")
    return Step(gesture=parsed.text(), checks=tuple(_check(place, t.strip()) for t in texts), within_s=within_s)


def _check(place: str, text: str) -> Check:
    found = _CHECK.match(text)
    if found is None:
        known = "effect, screen, lamp:NAME=COLOUR (or off), angle:NAME=DEGREES (or MARK)"
        raise SequenceError(f"{place}: check {text!r} is none of {known}")
    return Check(kind=found[1] or found[2], control=found[3] or "", value=found[4] or "")


@dataclass(frozen=True, slots=True, kw_only=True)
class SendCommand:
    """Give this command to the controller."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Tell who asked."""

    result: GoalResult


Action = SendCommand | Report


class SequenceRun:
    """One sequence on its way; the methods return what is to be done.

    Parameters
    ----------
    sequence
        The steps.
    run_id
        What the answers are matched on; step N is commanded with the id ``run_id.N``.
    config
        Times.
    """

    def __init__(self, sequence: Sequence, run_id: str, config: SequenceConfig) -> None:
        self.sequence, self.run_id, self._config = sequence, run_id, config
        self.done = False
        self._number = 0
        self._started_ns = self._step_ns = self._deadline_ns = 0
        self._answer: GoalResult | None = None
        self._answered_ns = 0
        self._seen: PanelSeen | None = None

    @property
    def state(self) -> str:
        """Where it is, for people."""
        return f"step {self._number}/{len(self.sequence.steps)}: {self._step.gesture}"

    @property
    def _step(self) -> Step:
        return self.sequence.steps[self._number - 1]

    def start(self, now_ns: int) -> list[Action]:
        self._started_ns = now_ns
        return [Report(result=self._result(Outcome.ACCEPTED, now_ns)), *self._next(now_ns)]

    def result(self, answer: GoalResult, now_ns: int) -> list[Action]:
        """Hear an answer of the controller."""
        if self.done or self._answer is not None or answer.goal_id != f"{self.run_id}.{self._number}":
            return []
        if not answer.outcome.final:
            return []
        if answer.outcome is not Outcome.REACHED:
            return self._fail(f"{answer.outcome.value}: {answer.reason}", now_ns)
        self._answer, self._answered_ns = answer, now_ns
        within_s = self._config.check_s if math.isnan(self._step.within_s) else self._step.within_s
        self._deadline_ns = now_ns + round(within_s * NANO)
        return self._look(now_ns)

    def panel(self, seen: PanelSeen, now_ns: int) -> list[Action]:
        """Hear what is seen of the panel."""
        self._seen = seen
        return self._look(now_ns)

    def tick(self, now_ns: int) -> list[Action]:
        """Let time pass."""
        if self.done or now_ns <= self._deadline_ns:
            return []
        if self._answer is None:
            return self._fail(f"no answer within {self._config.answer_timeout_s:g} s", now_ns)
        missing = ", ".join(self._missing(self._answer))
        return self._fail(f"not seen in time: {missing}", now_ns)

    def abort(self, cause: str, now_ns: int) -> list[Action]:
        """End it from outside."""
        return [] if self.done else self._fail(cause, now_ns)

    def _next(self, now_ns: int) -> list[Action]:
        if self._number == len(self.sequence.steps):
            self.done = True
            return [Report(result=self._result(Outcome.REACHED, now_ns))]
        self._number += 1
        self._answer, self._step_ns = None, now_ns
        self._deadline_ns = now_ns + round(self._config.answer_timeout_s * NANO)
        return [SendCommand(text=f"{self._step.gesture} id={self.run_id}.{self._number}")]

    def _look(self, now_ns: int) -> list[Action]:
        if self.done or self._answer is None or self._missing(self._answer):
            return []
        return self._next(now_ns)

    def _missing(self, answer: GoalResult) -> list[str]:
        """Return the checks that are not fulfilled yet, with what is seen instead."""
        found = []
        for check in self._step.checks:
            instead = self._unlike(check, answer)
            if instead:
                found.append(f"{check.text()} ({instead})")
        return found

    def _unlike(self, check: Check, answer: GoalResult) -> str:
        """Return what is seen instead of what the check wants, empty when it is fulfilled."""
        effect = dict(answer.details).get("effect", "not looked for")
        if check.kind == "effect":
            return effect if effect in ("none seen", "not looked for") else ""
        # Only a picture of this step says what the step has done.
        seen = self._seen if self._seen is not None and self._seen.stamp_ns > self._step_ns else None
        if check.kind == "screen":
            changed = effect == "screen changed" or (seen is not None and seen.changed_ns() > self._step_ns)
            return "" if changed else "no change"
        control = seen.control(check.control) if seen is not None and seen.stamp_ns > self._answered_ns else None
        if control is None:
            return "not seen yet"
        if check.kind == "lamp":
            return "" if control.lamp == check.value else control.text()
        try:
            wanted = dict(control.marks)[check.value] if check.value in dict(control.marks) else float(check.value)
        except ValueError:
            return f"no mark {check.value}"
        off = abs(angle_between(control.angle_deg, wanted)) if not math.isnan(control.angle_deg) else math.inf
        return "" if off <= ANGLE_TOLERANCE_DEG else control.text()

    def _fail(self, cause: str, now_ns: int) -> list[Action]:
        self.done = True
        reason = f"step {self._number} of {len(self.sequence.steps)}, {self._step.gesture}: {cause}"
        return [Report(result=self._result(Outcome.ABORTED, now_ns, reason))]

    def _result(self, outcome: Outcome, now_ns: int, reason: str = "") -> GoalResult:
        return GoalResult(
            goal_id=self.run_id,
            goal=self.sequence.name or f"{len(self.sequence.steps)} steps",
            outcome=outcome,
            reason=reason,
            duration_s=(now_ns - self._started_ns) / NANO if outcome.final else math.nan,
            details=(("steps_done", str(self._number - (outcome is Outcome.ABORTED))),) if outcome.final else (),
        )
