"""A sequence of gestures on its way, as a state machine without a clock; its grammar is icu_common.core.sequence."""

from __future__ import annotations

import math
from dataclasses import dataclass

from icu_common.core.config import Config, setting
from icu_common.core.panel_state import PanelSeen, angle_between
from icu_common.core.results import GoalResult, Outcome
from icu_common.core.sequence import Check, Sequence, Step

NANO = 1_000_000_000
ANGLE_TOLERANCE_DEG = 3.0
CLOCK_JUMP_S = 0.5
"""Time that runs back farther than this between two ticks ends the sequence: its pictures are of another time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SequenceConfig(Config):
    """Parameters of the sequencer."""

    accept_timeout_s: float = setting(
        5.0,
        "Time in which the controller has to take or refuse a step, and to answer it when it is at rest; time for the "
        "machine to say that it has stopped when it has not",
        minimum=1.0,
        maximum=60.0,
        unit="s",
    )
    answer_timeout_s: float = setting(
        90.0,
        "Time without a sign of work on a step: a change of the controller's state or of the driver's, or motion",
        minimum=1.0,
        maximum=600.0,
        unit="s",
    )
    check_s: float = setting(
        3.0, "Time for what a check wants to be seen, where the step names none", minimum=0.1, maximum=60.0, unit="s"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SendCommand:
    """Give this command to the controller."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Tell who asked."""

    result: GoalResult


@dataclass(frozen=True, slots=True, kw_only=True)
class StopMachine:
    """Ask the driver for a stop: nobody is known to be at work on what was begun, and it may still press."""


Action = SendCommand | StopMachine | Report
STOPPED = ("stopped", "alarm", "disconnected", "connecting", "mismatch", "unhomed")
"""States of the driver in which it takes no motion before a person has done something."""


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
        self._started_ns = self._step_ns = self._deadline_ns = self._ticked_ns = 0
        self._taken = False
        self._worked_ns = self._sign_ns = 0
        self._given_up = ""
        self._answer: GoalResult | None = None
        self._answered_ns = 0
        self._stopped = ""
        """Why the machine has been stopped since the start."""
        self._seen: PanelSeen | None = None

    @property
    def state(self) -> str:
        """Where it is, for people."""
        return f"step {self._number}/{len(self.sequence.steps)}: {self._step.gesture}"

    @property
    def _step(self) -> Step:
        return self.sequence.steps[self._number - 1]

    def start(self, now_ns: int) -> list[Action]:
        self._started_ns = self._ticked_ns = now_ns
        return [Report(result=self._result(Outcome.ACCEPTED, now_ns)), *self._next(now_ns)]

    def result(self, answer: GoalResult, now_ns: int) -> list[Action]:
        """Hear an answer of the controller."""
        unasked = self.done or self._given_up or self._answer is not None
        if unasked or answer.goal_id != f"{self.run_id}.{self._number}":
            return []
        self._taken, self._worked_ns, self._sign_ns = True, now_ns, now_ns
        if not answer.outcome.final:
            return []
        if answer.outcome is not Outcome.REACHED:
            return self._fail(f"{answer.outcome.value}: {answer.reason}", now_ns)
        if self._stopped:  # state and answers are two topics: the stop came after what this answers
            return self._fail(self._stopped, now_ns)
        self._answer, self._answered_ns = answer, now_ns
        within_s = self._config.check_s if math.isnan(self._step.within_s) else self._step.within_s
        self._deadline_ns = now_ns + round(within_s * NANO)
        return self._look(now_ns)

    def panel(self, seen: PanelSeen, now_ns: int) -> list[Action]:
        """Hear what is seen of the panel."""
        self._seen = seen
        return self._look(now_ns)

    def sign(self, now_ns: int) -> None:
        """Hear that something goes on: the controller's state, or the driver's, has changed."""
        self._sign_ns = now_ns

    def tick(self, now_ns: int, *, at_rest: bool = False, driver: str = "") -> list[Action]:
        """Let time pass; ``at_rest`` says that the controller works on nothing, or is not there.

        ``driver`` is what the driver says of itself, empty without one.
        """
        jumped_back_s, self._ticked_ns = (self._ticked_ns - now_ns) / NANO, now_ns
        if jumped_back_s > CLOCK_JUMP_S:
            return self.abort(f"the clock jumped back by {jumped_back_s:.1f} s", now_ns)
        accept_s, state = self._config.accept_timeout_s, driver.partition(":")[0]
        if self._given_up:
            if state in STOPPED:
                return self.abort(f"{self._given_up}; the machine was told to stop and is {driver!r}", now_ns)
            late = now_ns > self._deadline_ns
            text = f"{self._given_up}; the machine was told to stop, but says {driver or 'nothing'!r}: look at it"
            return self.abort(text, now_ns) if late else []
        if not self._taken and now_ns - self._step_ns > accept_s * NANO:
            return self._give_up(f"the controller has neither taken nor refused it within {accept_s:g} s", now_ns)
        if not at_rest:
            self._worked_ns = now_ns
        if self._taken and self._answer is None and now_ns - self._worked_ns > accept_s * NANO:
            # One that died and was started anew knows nothing of the step.
            return self._give_up(f"the controller has been at rest for {accept_s:g} s without an answer to it", now_ns)
        if state == "moving":
            self._sign_ns = now_ns
        if self._answer is None and now_ns - self._sign_ns > self._config.answer_timeout_s * NANO:
            # A controller that hangs still "works" by its latched state.
            return self._give_up(f"no sign of work on it for {self._config.answer_timeout_s:g} s", now_ns)
        if self.done or self._answer is None or now_ns <= self._deadline_ns:
            return []
        missing = ", ".join(self._missing(self._answer))
        return self._fail(f"not seen in time: {missing}", now_ns)

    def stopped(self, cause: str, now_ns: int) -> list[Action]:
        """Hear that the machine was stopped or left alone: nothing may go on later. A gesture has its own answer."""
        self._stopped = self._stopped or cause
        return [] if self.done or self._answer is None else self._fail(cause, now_ns)

    def abort(self, cause: str, now_ns: int) -> list[Action]:
        """End it from outside."""
        return [] if self.done else self._fail(cause, now_ns)

    def _give_up(self, cause: str, now_ns: int) -> list[Action]:
        """Stop the machine, and end when it says that it has: who takes the step only now finds it stopped."""
        if self.done:
            return []
        self._given_up, self._deadline_ns = cause, now_ns + round(self._config.accept_timeout_s * NANO)
        return [StopMachine()]

    def _next(self, now_ns: int) -> list[Action]:
        if self._number == len(self.sequence.steps):
            self.done = True
            return [Report(result=self._result(Outcome.REACHED, now_ns))]
        self._number += 1
        self._taken, self._answer = False, None
        self._step_ns = self._sign_ns = now_ns
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
        details = dict(answer.details)
        effect = details.get("effect", "not looked for")
        if check.kind == "effect":
            return effect if effect.startswith(("none seen", "not seen: ", "not looked for")) else ""
        # Only a picture of this step says what the step has done.
        seen = self._seen if self._seen is not None and self._seen.stamp_ns > self._step_ns else None
        if check.kind == "screen":
            # What came up on the way there, such as an alarm, is none of its doing.
            touched_ns = int(details.get("touched_ns", self._step_ns))
            changed = effect == "screen changed" or (seen is not None and seen.changed_ns() > touched_ns)
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
