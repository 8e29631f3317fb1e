"""One board as the driver knows it: phase, stylus, goal, and the published state with its reason; no I/O, no clock."""

from __future__ import annotations

import math
from operator import attrgetter

from gantry_driver.core.board_faults.kept_place import KeptPlace
from gantry_driver.core.board_faults.resets import ResetLog
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.grbl_messages import Dialect
from gantry_driver.core.grbl.lines import Counts
from gantry_driver.core.grbl.session import GrblSession
from gantry_driver.core.states.machine_states import (
    OPEN_ENDS,
    TRANSITIONS,
    Answered,
    Event,
    MachinePhase,
    StateChanged,
)
from gantry_driver.core.states.reasons import Why, code_of
from gantry_driver.core.states.stylus_state import IS_RELEASED, MAY_PRESS, MAY_SINK, Stylus
from gantry_driver.core.wire.goal import Goal, Reading
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.reasons.codes import CODE, REASON, DriverCode
from icu_common.core.reasons.message import Message, joined
from icu_common.core.reasons.state_text import because

TICK_S = 0.05
"""Maximum seconds between two ticks."""


class BoardState:
    """State of one board and of the goal in progress; each event changes it, and other programs read it as text."""

    def __init__(self, config: DriverConfig, *, active: bool = True, left_down: bool = False) -> None:
        self.config = config
        self.active = active
        self.counts = Counts()
        self.session = GrblSession(self.counts)
        self.phase = MachinePhase.CLOSED
        self.reason: Why = Message("driver.not_opened_yet")
        self._not_lifted: str | None = None
        """Why a stop has not lifted the stylus, empty if it has; None if no stop has decided about the stylus."""
        self._suspended = ""
        self.homed = False
        self.enabled = config.enabled_at_start
        self.dialect = Dialect.UNKNOWN
        self.firmware = ""
        self.connects = 0
        self._heard_bytes = 0
        self._unanswered = ""
        self.reading_m: tuple[float, float, float] | None = None
        self.probe: bool | None = None
        """Whether the stylus's switch is closed in the newest report with a position; None without such a switch."""
        self._settings: dict[int, str] = {}
        self._startup: dict[str, str] = {}
        self._startup_tries = 0
        self._kept: dict[int, str] = {}
        """Settings that a write of other settings must not change."""
        self._profile: dict[int, float] = {}
        self._latched: Why = ""
        self._mismatch = ""
        self._settings_differ = False
        """Whether the mismatch is, or includes, settings that differ from the configuration."""
        self._misplaced = False
        self._accepted_mismatch = ""
        self._events: list[Event] = []
        self._told = ""
        self._goal: Goal | None = None
        self._since = 0.0
        self._marker = 0
        self._marker_done = False
        self._resets, self._kept_place = ResetLog(), KeptPlace()
        self._stylus = Stylus.LEFT_UNSEEN if left_down else Stylus.AS_READ
        self.left_moving = False
        """Whether the board may still execute lines of a lost connection or an ended guard."""
        self._released_at = math.inf
        """Time at which a solenoid that an alarm has switched off will be up."""
        self._raised = False
        """Whether the overrides in the last report that had them must be reset."""
        self._critical = False
        self._reset_not_before = 0.0
        self._hold_sent = 0.0
        self._probed = 0.0
        self._probe_from = 0.0
        self._asked_again = False
        """Whether a board that did not answer ``$I`` was reset since the port was opened."""
        self._pausing = self._resuming = False
        self._acked = 0
        """Number of the last line that the board has acknowledged."""
        self._frame_mm: Reading | None = None
        """Work offset of the active frame, as the board has reported it."""
        self._distrusted = False
        """Whether the position counts as lost once the stop in progress has lifted the stylus."""
        self._say_if_changed()

    def configure(self, config: DriverConfig, now: float) -> None:
        """Continue with other parameters."""
        before, self.config = self.config, config
        self._poll_at_rate()
        of_silence = attrgetter("status_rate_hz", "moving_status_rate_hz", "status_timeout_s")
        if self.session.last_report_at is not None and of_silence(before) != of_silence(config):
            self.session.last_report_at = now  # The silence so far belongs to the old rate.

    # --- interface of the node -----------------------------------------------------------------------------------

    @property
    def state(self) -> str:
        """The published state without its reason; ``disabled`` if the machine could move once enabled and active."""
        return (
            "disabled" if self.phase is MachinePhase.IDLE and not (self.enabled and self.active) else self.phase.state
        )

    @property
    def state_text(self) -> str:
        """The published state: ``state`` or ``state: reason``."""
        reason = "inactive" if self.phase is MachinePhase.IDLE and not self.active else self._whole_reason()
        return because(self.state, reason)

    def codes(self) -> tuple[tuple[str, str], ...]:
        """Return the code and the text of the published state's first reason, if it has a code.

        Further clauses may follow this text in the published state, as on a stylus that was not lifted.
        """
        code = code_of(self.reason) if self.phase.state in ("stopped", "mismatch") else ""
        if self.phase is MachinePhase.MISMATCH and self._settings_differ:
            code = code or DriverCode.SETTINGS_DIFFER.value
        return ((CODE, code), (REASON, str(self.reason))) if code else ()

    @property
    def at_rest(self) -> bool:
        """Whether no motion and no stop is in progress."""
        return self.phase not in (
            MachinePhase.HOLDING,
            MachinePhase.RESETTING,
            MachinePhase.LIFTING,
            MachinePhase.MOVING,
            MachinePhase.HOMING,
        )

    @property
    def retreating(self) -> bool:
        """Whether only the stylus moves, off the panel, after a stop; a hold would leave it down."""
        return self.phase is MachinePhase.LIFTING

    @property
    def connected(self) -> bool:
        """Whether a board has been identified on the port."""
        return self.phase.state not in ("disconnected", "connecting")

    @property
    def may_be_down(self) -> bool:
        """Whether the stylus may be down, or lines in progress may lower it; homing ends this state."""
        return self._stylus is Stylus.UNDER_WAY or self._stylus_is_down()

    @property
    def needs_way_out(self) -> bool:
        """Whether the machine would keep moving or pressing if the driver ended now."""
        return not self.at_rest or self._rests_extended()

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def output(self, now: float) -> bytes:
        """Return the bytes to write."""
        return self.session.output(now)

    def deadline(self, now: float) -> float:
        """Return the time at which :meth:`tick` and :meth:`output` are due even if nothing happens."""
        return min(self.session.deadline(now), now + TICK_S)

    def diagnostics(self) -> list[tuple[str, str]]:
        """Return names and values for the diagnostics topic."""
        counts = self.counts
        values: dict[str, object] = {name: getattr(counts, name) for name in counts.__slots__}
        values |= {
            "reconnects": max(0, self.connects - 1),
            "under_way_bytes": self.session.in_flight_bytes,
            "receive_buffer_bytes": self.session.rx_bytes,
            "answer_latency_ms": f"{1000.0 * self.session.latency_s:.2f}",
            "dialect": self.dialect.value,
            "firmware": self.firmware,
            "homed": self.homed,
            "enabled": self.enabled,
            "active": self.active,
            "probe_pin": {None: "none", False: "open", True: "triggered"}[self.probe],
        }
        return [(name, str(value)) for name, value in values.items()]

    # --- transitions ---------------------------------------------------------------------------------------------

    def _enter(self, phase: MachinePhase, now: float, reason: Why = "", not_lifted: str | None = None) -> None:
        if phase is not self.phase and phase not in TRANSITIONS[self.phase] and phase not in OPEN_ENDS:
            raise AssertionError(f"{self.phase.name} to {phase.name} is not in the table")
        self.phase, self.reason, self._since = phase, reason, now
        self._misplaced = False
        self._not_lifted, self._suspended = not_lifted, ""
        if phase is not MachinePhase.MOVING:
            self._pausing = self._resuming = False
        if phase is MachinePhase.STOPPED and self._distrusted:
            self._distrusted = False
            self._forget_position()
        self._poll_at_rate()
        self._say_if_changed()

    def _poll_at_rate(self) -> None:
        moving = self.phase in (MachinePhase.MOVING, MachinePhase.HOLDING, MachinePhase.RESETTING, MachinePhase.LIFTING)
        rate = self.config.moving_status_rate_hz if moving else self.config.status_rate_hz
        touching = self.phase is MachinePhase.MOVING and self._goal is not None and self._goal.touching
        if touching:
            rate = max(rate, self.config.touch_status_rate_hz)
        self.session.polls_spared = not touching
        self.session.poll_interval_s = 1.0 / rate
        self.session.poll_now()

    def _say_if_changed(self) -> None:
        if (text := self.state_text) != self._told:
            self._told = text
            logged = not self._resets.repeats(text)
            self._events.append(StateChanged(text=text, logged=logged, codes=self.codes()))

    def _forget_position(self) -> None:
        self._stylus = self._stylus.lost(self._extension_m)
        self._distrusted = False
        self.homed = False
        self.reading_m = self.probe = None

    def _finish(
        self,
        outcome: Outcome,
        reason: Why,
        now: float,
        error_m: float = math.nan,
        *,
        code: str = "",
        details: tuple[tuple[str, str], ...] = (),
    ) -> None:
        if self._goal is None:
            return
        goal, self._goal = self._goal, None
        self._answer(
            GoalResult(
                goal_id=goal.goal_id,
                goal=goal.text,
                outcome=outcome,
                reason=str(reason),
                error_m=error_m,
                duration_s=now - goal.started,
                code=code,
                details=details,
            )
        )

    def _answer(self, result: GoalResult) -> GoalResult:
        self._events.append(Answered(result=result))
        return result

    def _blocked(self) -> bool:
        return bool(self._mismatch) and self._mismatch != self._accepted_mismatch

    def _resting_phase(self) -> MachinePhase:
        if self._blocked():
            return MachinePhase.MISMATCH
        return MachinePhase.IDLE if self.homed else MachinePhase.UNHOMED

    @property
    def _extension_m(self) -> float | None:
        return None if self.reading_m is None else self.reading_m[2]

    @property
    def _left_down(self) -> bool:
        """Return whether the position was lost while the stylus may be down."""
        return self._stylus in (Stylus.LEFT_SEEN, Stylus.LEFT_UNSEEN)

    def _stylus_is_down(self) -> bool:
        return self._stylus.presses(self._extension_m)

    def _whole_reason(self) -> str:
        """Return the reason, and the states that may end before it: stylus not lifted, board suspended."""
        return joined((str(self.reason), self._stylus_text(), self._suspended))

    def _stylus_text(self) -> str:
        """Return a clause if nothing has lifted the stylus, because readers assume that ``stopped`` means lifted."""
        if self._not_lifted is not None:
            return self._not_lifted
        phase = self.phase
        rests = phase in (
            MachinePhase.STOPPED,
            MachinePhase.ALARM,
            MachinePhase.ALARM_RESET,
            MachinePhase.UNHOMED,
            MachinePhase.MISMATCH,
        )
        # After an alarm no stop has decided about the stylus, and nothing lifts it.
        tells = (
            self.config.lift_on_stop
            if phase is MachinePhase.STOPPED
            else phase in (MachinePhase.ALARM, MachinePhase.ALARM_RESET)
        )
        tells = tells or (self._left_down and (rests or phase is MachinePhase.CLOSED))
        if tells and self._stylus is not Stylus.LIMP and self._stylus_is_down():
            return MAY_PRESS
        if rests and self._stylus.may_be_limp(self.config.stylus.kind):
            return MAY_SINK
        # If the position is lost as well, other programs have only the last reading, of a stylus that was down.
        return IS_RELEASED if rests and not self.homed and self._stylus is Stylus.RELEASED else ""

    def _is_servo(self) -> bool:
        return self.config.stylus.kind == "servo_m3"

    def _rests_extended(self) -> bool:
        return self.phase is MachinePhase.IDLE and self._stylus_is_down()
