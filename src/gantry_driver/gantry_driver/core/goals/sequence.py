"""Execution of a sequence of gestures, as a state machine without a clock.

icu_common.core.goals.sequence has the grammar.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gantry_driver.core.job.effects import SCREEN_CHANGED
from icu_common.core.configuration.config import Config, setting
from icu_common.core.goals.results import EFFECT, EFFECT_MISSING, GoalResult, Outcome
from icu_common.core.goals.sequence import GestureSequence, SequenceStep, StepCheck
from icu_common.core.panel.panel_state import PanelSeen, angle_between
from icu_common.core.reasons.message import Message, joined, quoted
from icu_common.core.reasons.state_text import as_message, state_name

NANO = 1_000_000_000
ANGLE_TOLERANCE_DEG = 3.0
CLOCK_JUMP_S = 0.5
"""Seconds by which time may run back between two ticks; a larger jump ends the sequence, as its images are of another
time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceConfig(Config):
    """Parameters of the sequencer."""

    accept_timeout_s: float = setting(
        5.0,
        "Maximum time for the controller to accept or reject a step, and for an idle controller to answer it; "
        "also the maximum time for the machine to report that it has stopped",
        minimum=1.0,
        maximum=60.0,
        unit="s",
    )
    answer_timeout_s: float = setting(
        90.0,
        "Maximum time without progress on a step: a change of the controller's or the driver's state, or motion",
        minimum=1.0,
        maximum=600.0,
        unit="s",
    )
    check_s: float = setting(
        3.0,
        "Maximum time for the expectation of a check to be seen, where the step gives none",
        minimum=0.1,
        maximum=60.0,
        unit="s",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SendStepCommand:
    """Send this command to the controller."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceReport:
    """Report a result to the sender of the sequence."""

    result: GoalResult


@dataclass(frozen=True, slots=True, kw_only=True)
class StopMachine:
    """Request a stop of the driver: no program is known to work on the started step, and the stylus may press."""


Action = SendStepCommand | StopMachine | SequenceReport
STOPPED = ("stopped", "alarm", "disconnected", "connecting", "mismatch", "unhomed")
"""States of the driver in which it accepts no motion until a person acts."""


class SequenceRun:
    """One sequence in progress; the methods return the actions to carry out.

    Parameters
    ----------
    sequence
        The steps.
    run_id
        Id by which answers are matched; step N is commanded with the id ``run_id.N``.
    config
        Time limits.
    """

    def __init__(self, sequence: GestureSequence, run_id: str, config: SequenceConfig) -> None:
        self.sequence, self.run_id, self._config = sequence, run_id, config
        self.done = False
        self._number = 0
        self._started_ns = self._step_ns = self._deadline_ns = self._ticked_ns = 0
        self._taken = False
        self._worked_ns = self._sign_ns = 0
        self._given_up = ""
        self._answer: GoalResult | None = None
        self._answered_ns = 0
        self._stopped = ""
        """Reason for a stop of the machine since the start, empty without one."""
        self._seen: PanelSeen | None = None

    @property
    def state(self) -> str:
        """Progress of the sequence, as text for people."""
        return Message(
            "sequence.step_running", number=self._number, steps=len(self.sequence.steps), gesture=self._step.gesture
        )

    @property
    def _step(self) -> SequenceStep:
        return self.sequence.steps[self._number - 1]

    def start(self, now_ns: int) -> list[Action]:
        self._started_ns = self._ticked_ns = now_ns
        return [SequenceReport(result=self._result(Outcome.ACCEPTED, now_ns)), *self._next(now_ns)]

    def result(self, answer: GoalResult, now_ns: int) -> list[Action]:
        """Take an answer of the controller."""
        unasked = self.done or self._given_up or self._answer is not None
        if unasked or answer.goal_id != f"{self.run_id}.{self._number}":
            return []
        self._taken, self._worked_ns, self._sign_ns = True, now_ns, now_ns
        if not answer.outcome.final:
            return []
        if answer.outcome is not Outcome.REACHED:
            return self._fail(f"{answer.outcome.value}: {answer.reason}", now_ns)
        if self._stopped:  # state and answers use two topics: the stop came after the step of this answer
            return self._fail(self._stopped, now_ns)
        self._answer, self._answered_ns = answer, now_ns
        within_s = self._config.check_s if math.isnan(self._step.within_s) else self._step.within_s
        self._deadline_ns = now_ns + round(within_s * NANO)
        return self._look(now_ns)

    def panel(self, seen: PanelSeen, now_ns: int) -> list[Action]:
        """Take the seen state of the panel."""
        self._seen = seen
        return self._look(now_ns)

    def sign(self, now_ns: int) -> None:
        """Note progress: the controller's or the driver's state has changed."""
        self._sign_ns = now_ns

    def tick(self, now_ns: int, *, at_rest: bool = False, driver: str = "") -> list[Action]:
        """Take the time; ``at_rest`` is whether the controller is idle or absent.

        ``driver`` is the driver's state, empty without a driver.
        """
        jumped_back_s, self._ticked_ns = (self._ticked_ns - now_ns) / NANO, now_ns
        if jumped_back_s > CLOCK_JUMP_S:
            return self.abort(Message("controller.clock_jumped_back", jumped_back_s=jumped_back_s), now_ns)
        accept_s, state = self._config.accept_timeout_s, state_name(driver)
        if self._given_up:
            if state in STOPPED:
                return self.abort(
                    Message("sequence.machine_told_stop", given_up=self._given_up, driver=quoted(as_message(driver))),
                    now_ns,
                )
            late = now_ns > self._deadline_ns
            text = Message(
                "sequence.machine_told_stop_but_says",
                given_up=self._given_up,
                driver=quoted(as_message(driver) or Message("sequence.nothing")),
            )
            return self.abort(text, now_ns) if late else []
        if not self._taken and now_ns - self._step_ns > accept_s * NANO:
            return self._give_up(Message("sequence.controller_neither_taken_nor_refused", accept_s=accept_s), now_ns)
        if not at_rest:
            self._worked_ns = now_ns
        if self._taken and self._answer is None and now_ns - self._worked_ns > accept_s * NANO:
            # A restarted controller does not have the step.
            return self._give_up(Message("sequence.controller_rest_without_answer", accept_s=accept_s), now_ns)
        if state == "moving":
            self._sign_ns = now_ns
        if self._answer is None and now_ns - self._sign_ns > self._config.answer_timeout_s * NANO:
            # The latched state of a hanging controller still shows a goal in progress.
            return self._give_up(
                Message("sequence.no_sign_work", answer_timeout_s=self._config.answer_timeout_s), now_ns
            )
        if self.done or self._answer is None or now_ns <= self._deadline_ns:
            return []
        missing = joined(self._missing(self._answer), "text.listed")
        return self._fail(Message("sequence.not_seen_time", missing=missing), now_ns)

    def stopped(self, cause: str, now_ns: int) -> list[Action]:
        """Note that the machine was stopped, or lost its operator: the sequence must not continue later.

        A gesture in progress has its own answer.
        """
        self._stopped = self._stopped or cause
        return [] if self.done or self._answer is None else self._fail(cause, now_ns)

    def abort(self, cause: str, now_ns: int) -> list[Action]:
        """End the sequence from outside."""
        return [] if self.done else self._fail(cause, now_ns)

    def _give_up(self, cause: str, now_ns: int) -> list[Action]:
        """Stop the machine, and end once it reports the stop, so that a controller that is late finds it stopped."""
        if self.done:
            return []
        self._given_up, self._deadline_ns = cause, now_ns + round(self._config.accept_timeout_s * NANO)
        return [StopMachine()]

    def _next(self, now_ns: int) -> list[Action]:
        if self._number == len(self.sequence.steps):
            self.done = True
            return [SequenceReport(result=self._result(Outcome.REACHED, now_ns))]
        self._number += 1
        self._taken, self._answer = False, None
        self._step_ns = self._sign_ns = now_ns
        return [SendStepCommand(text=f"{self._step.gesture} id={self.run_id}.{self._number}")]

    def _look(self, now_ns: int) -> list[Action]:
        if self.done or self._answer is None or self._missing(self._answer):
            return []
        return self._next(now_ns)

    def _missing(self, answer: GoalResult) -> list[str]:
        """Return the unfulfilled checks, each with what is seen instead."""
        found: list[str] = []
        for check in self._step.checks:
            instead = self._unlike(check, answer)
            if instead:
                found.append(Message("sequence.unlike", check=check.text(), instead=instead))
        return found

    def _unlike(self, check: StepCheck, answer: GoalResult) -> str:
        """Return the observation that contradicts the check's expectation, empty if none does."""
        details = dict(answer.details)
        effect = details.get(EFFECT, Message("sequence.not_looked"))
        if check.kind == "effect":
            return effect if EFFECT not in details or EFFECT_MISSING in details else ""
        # Only an image taken during this step shows its effect.
        seen = self._seen if self._seen is not None and self._seen.stamp_ns > self._step_ns else None
        if check.kind == "screen":
            # A change during the approach, such as an alarm, is not an effect of the step.
            touched_ns = int(details.get("touched_ns", self._step_ns))
            screen = isinstance(effect, Message) and effect.code == SCREEN_CHANGED.code
            changed = screen or (seen is not None and seen.changed_ns() > touched_ns)
            return "" if changed else Message("sequence.no_change")
        control = seen.control(check.control) if seen is not None and seen.stamp_ns > self._answered_ns else None
        if control is None:
            return Message("sequence.not_seen_yet")
        if check.kind == "lamp":
            return "" if control.lamp == check.value else control.text()
        try:
            wanted = dict(control.marks)[check.value] if check.value in dict(control.marks) else float(check.value)
        except ValueError:
            return Message("sequence.no_mark", check=check.value)
        off = abs(angle_between(control.angle_deg, wanted)) if not math.isnan(control.angle_deg) else math.inf
        return "" if off <= ANGLE_TOLERANCE_DEG else control.text()

    def _fail(self, cause: str, now_ns: int) -> list[Action]:
        self.done = True
        reason = Message(
            "sequence.step_failed",
            number=self._number,
            steps=len(self.sequence.steps),
            gesture=self._step.gesture,
            cause=cause,
        )
        return [SequenceReport(result=self._result(Outcome.ABORTED, now_ns, reason))]

    def _result(self, outcome: Outcome, now_ns: int, reason: str = "") -> GoalResult:
        return GoalResult(
            goal_id=self.run_id,
            goal=self.sequence.name or Message("sequence.steps", steps=len(self.sequence.steps)),
            outcome=outcome,
            reason=reason,
            duration_s=(now_ns - self._started_ns) / NANO if outcome.final else math.nan,
            details=(("steps_done", str(self._number - (outcome is Outcome.ABORTED))),) if outcome.final else (),
        )
