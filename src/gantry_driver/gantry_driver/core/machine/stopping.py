"""The stop: hold, reset, lift, and stay stopped until an operator resets it; no I/O and no clock.

docs/decisions/stopping.md explains what a stop does, and why.
"""

from __future__ import annotations

from collections.abc import Sequence

from gantry_driver.core.configuration.clearance import TUBE_MM
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.grbl_messages import Dialect, StatusReport
from gantry_driver.core.grbl.session import HOLD, RESUME
from gantry_driver.core.grbl.trajectory_gcode import lift_lines, reading_m
from gantry_driver.core.machine.board_settings import BoardSettings
from gantry_driver.core.machine.connection import HOLD_REPEAT_S, REFUSED
from gantry_driver.core.states.machine_states import MachinePhase, Note
from gantry_driver.core.states.reasons import Why
from gantry_driver.core.states.stylus_state import STYLUS_DOWN_M, Stylus
from icu_common.core.goals.results import Outcome
from icu_common.core.reasons.message import Message
from icu_common.core.reasons.state_text import as_message

LIFTS = 2
"""Maximum number of repeated retreats after a retreat that did not go up."""
OLD_HOLDS_S = 0.15
"""Minimum seconds between the first and the believed report of a hold just after a resume: on a busy computer, reports
from before the resume arrive late, and together."""
SAME_PLACE_MM = 0.05
SWITCHED_OFF_BY = dict.fromkeys((Dialect.GRBL, Dialect.GRBLHAL), frozenset((1, 2, 3, 6, 7, 8, 9, 10)))
"""Alarms that switch coolant and spindle off at once; at others, and on FluidNC, only the reset after them does."""
LEFT_DOWN = Message("stop.stylus_left_down_while_no")
LOCKED = Message("stop.board_locked_alarm_whose_number")


class Stopping(BoardSettings):
    """One board that can be brought to rest."""

    def __init__(self, config: DriverConfig, *, active: bool = True, left_down: bool = False) -> None:
        super().__init__(config, active=active, left_down=left_down)
        self._lift = True
        self._lift_barred = False
        self._lift_timeout_s = 0.0
        self._hold_doubted = False
        """Whether a reported hold may be older than the last resume."""
        self._hold_seen_at: float | None = None
        self._stood_mm: tuple[float, ...] | None = None
        """Position of the board in the last report before a stop's reset; None if the report had none."""
        self._stood_at = 0.0
        self._moved_at = 0.0
        self._lift_from_mm: tuple[float, ...] | None = None
        """Position at which the retreat of a Z axis began."""
        self._lifts_left = LIFTS
        self._moved_mm: tuple[float, ...] | None = None
        """Position in the last report, if the board cannot have moved there."""

    def stop(self, reason: Why, now: float, *, hold_written: bool = False) -> None:
        """Hold, discard all buffered lines, lift the stylus, and stay stopped until :meth:`reset`.

        Parameters
        ----------
        reason
            Published as ``stopped: reason``.
        hold_written
            Whether the ``!`` has already been written.
        """
        if self.phase is MachinePhase.ALARM or self.dialect in REFUSED:
            return
        self._latched = self._latched or reason
        if self.phase in (MachinePhase.SYNCHRONISE, MachinePhase.IDENTIFY, MachinePhase.SETTINGS, MachinePhase.WRITING):
            self._synchronise(now, "")
            if not hold_written:
                self.session.realtime(HOLD)
        if self.phase in (MachinePhase.CLOSED, MachinePhase.SYNCHRONISE, MachinePhase.ALARM_RESET):
            return
        if self.phase is MachinePhase.LIFTING and not hold_written:
            return  # The retreat already leads to the safe state: a repeated stop does not interrupt it.
        if self.phase is MachinePhase.STOPPED:
            self._lift = self.config.lift_on_stop and not self._lift_barred  # also if a lost count ended the retreat
        self._halt(reason, now, hold_written=hold_written, lift_again=True)

    def reset(self, now: float) -> str:
        """Leave ``stopped``, ``alarm``, or the ``mismatch`` of a machine that homed at another position."""
        if self.phase is MachinePhase.STOPPED:
            self._latched = ""
            self._enter(self._resting_phase(), now, self._mismatch if self._blocked() else "")
            return ""
        if self.phase is MachinePhase.ALARM:
            self._enter(MachinePhase.ALARM_RESET, now, self.reason)
            self._marker = 0
            return ""
        if self._misplaced:
            self._enter(MachinePhase.UNHOMED, now)
            return ""
        if self.phase in (MachinePhase.HOLDING, MachinePhase.RESETTING, MachinePhase.LIFTING):
            return Message("stop.stop_not_complete_yet")
        return Message("stop.nothing_reset_driver", state_text=as_message(self.state_text))

    @property
    def moves_or_presses(self) -> bool:
        """Whether the machine moves or presses, so that only a stop ends it."""
        return self.phase in (MachinePhase.MOVING, MachinePhase.HOMING) or self._rests_extended()

    # --- the stop sequence -------------------------------------------------------------------------------------------

    def _halt(self, reason: Why, now: float, *, hold_written: bool = False, lift_again: bool = False) -> None:
        """Begin the stop sequence: hold, wait for the hold, reset, lift; the goal is answered now."""
        self._finish(Outcome.ABORTED, reason, now)
        if self.phase in (MachinePhase.STOPPED, MachinePhase.HOLDING, MachinePhase.RESETTING, MachinePhase.LIFTING):
            # The first reason explains the stop; a failed retreat is not repeated.
            reason, self._lift = self.reason, self._lift and (lift_again or self.phase is not MachinePhase.LIFTING)
        else:
            self._lift, self._lift_barred = self.config.lift_on_stop, False
            self._lifts_left = LIFTS
        self._latched = reason
        if self.phase in (MachinePhase.HOLDING, MachinePhase.RESETTING):
            return
        if self.phase is MachinePhase.HOMING:
            # GRBL does not hold in a homing cycle. A reset ends the cycle with ALARM:6; no known position is lost.
            self._forget_position()
            self._enter(MachinePhase.RESETTING, now, reason)
            self.session.soft_reset(now)
            return
        self._hold_doubted, self._hold_seen_at = self._resuming, None
        self.session.withdraw(RESUME)
        if not hold_written or self._resuming:  # a `~` may follow the hold that has been written
            self.session.realtime(HOLD)
        self._hold_sent = now
        self.session.paused = True
        self._enter(MachinePhase.HOLDING, now, reason)

    def _tick_holding(self, age: float, now: float) -> None:
        if age > self.config.hold_timeout_s:
            self._events.append(Note(level="error", text=f"the hold did not complete in {age:.1f} s; resetting"))
            self._forget_position()
            self._reset_after_hold(now)
        elif now - self._hold_sent >= HOLD_REPEAT_S:
            self._hold_sent = now
            self.session.realtime(HOLD)

    def _reset_after_hold(self, now: float) -> None:
        self._moved_mm = None
        self._enter(MachinePhase.RESETTING, now, self.reason)
        self.session.soft_reset(now)

    def _to_alarm(self, text: str, now: float, *, code: int = 0) -> None:
        """Enter the alarm; ``code`` is its number, 0 if unknown."""
        if self.phase.state == "stopped":
            told_anew = self._not_lifted is None
            text = Message("stop.after", text=text, reason=self.reason if told_anew else self._whole_reason())
        self._finish(Outcome.ABORTED, text, now)
        self._forget_position()
        self._stylus = self._stylus.powerless(self.config.stylus.kind)
        if code in SWITCHED_OFF_BY.get(self.dialect, ()) and self.config.stylus.kind == "solenoid_m8":
            self._released_at = now + self.config.stylus.dwell_s
        self.session.last_report_at = now  # In a homing cycle the alarm is the board's first message.
        self._latched = ""  # The alarm itself is latched, and the same call resets it.
        if self.phase is MachinePhase.ALARM_RESET:  # an emergency stop is still pressed: no banner comes
            self.session.awaiting_banner = False
        if self.phase is not MachinePhase.ALARM:
            self._enter(MachinePhase.ALARM, now, text)

    def _after_reset(self, report: StatusReport, now: float) -> None:
        if not (self._lift and report.state == "Idle" and self.homed and self._stylus_is_down()):
            self._enter(MachinePhase.STOPPED, now, self.reason)
            return
        self._begin_lift(report.mpos_mm, self.reason, now)

    def _lift_left(self, now: float) -> bool:
        kept, z_axis = self._kept_place, self.config.stylus.kind == "z_axis"
        if not self._left_down or not self.config.lift_on_stop or not kept.unlocked:
            return False
        if z_axis:
            if kept.mpos_mm is None:
                return False
            self._stylus, self.reading_m = Stylus.AS_READ, reading_m(kept.mpos_mm, False, self.config)
            if not self._stylus_is_down():
                self._forget_position()
                return False
        # Trusted only for the lift: what the board did without a driver is unknown.
        self.homed = self._distrusted = True
        self._lift, self._lift_barred, self._lifts_left = True, False, LIFTS
        self._latched = self._latched or LEFT_DOWN
        self._begin_lift(kept.mpos_mm, self._latched, now)
        return True

    def _begin_lift(self, from_mm: tuple[float, ...] | None, reason: Why, now: float) -> None:
        self._enter(MachinePhase.LIFTING, now, reason)
        self._marker_done = False
        self._lift_from_mm = from_mm
        config = self.config
        # The board moves no axis faster than its own limit, and lines in progress do not use later parameters.
        speed_m_s = min(config.stylus_feed_m_s, config.machine.max_rate_mm_min[2] / 60_000.0)
        speeding_s = speed_m_s * 1000.0 / config.machine.acceleration_mm_s2[2]
        self._lift_timeout_s = 2.0 + config.stylus.dwell_s + config.stylus_limit_m() / speed_m_s + speeding_s
        for text in lift_lines(self.config):
            self._marker = self.session.queue(text, answer_within_s=self._answer_time()).number

    def _answer_time(self) -> float:
        return self.config.answer_timeout_s + self.config.stylus.dwell_s

    # --- reports during a stop ---------------------------------------------------------------------------------------

    def _report_holding(self, report: StatusReport, now: float) -> None:
        if report.state == "Hold" and self._is_old_hold(now):
            # A reset now could hit a moving board and lose its position.
            self.session.poll_now()
        elif report.state == "Alarm" and self.homed:
            self._to_alarm(LOCKED, now)
        elif report.state in ("Idle", "Check"):
            # The report is older than the hold, or the firmware does not hold while idle: wait for the hold to show.
            if now - self._since > 1.5 * HOLD_REPEAT_S:
                self._reset_after_hold(now)
        elif report.state in ("Alarm", "Sleep", "Tool") or report.substate == 0 or _at_door(report, 1):
            self._reset_after_hold(now)

    def _is_old_hold(self, now: float) -> bool:
        """Return whether a reported hold may be older than the resume."""
        if not self._hold_doubted:
            return False
        self._hold_seen_at = now if self._hold_seen_at is None else self._hold_seen_at
        return now - self._hold_seen_at < OLD_HOLDS_S

    def _report_resetting(self, report: StatusReport, now: float) -> None:
        if self.session.awaiting_banner:
            return
        if report.state == "Hold" or _at_door(report, 0):
            self._reset_after_hold(now)
        elif report.state == "Door":
            # The door is still open: a reset does not leave this state. Nothing may move, even if it closes later.
            self._lift, self._lift_barred = False, True
            self._enter(MachinePhase.STOPPED, now, self.reason)
        elif report.state == "Alarm" and self.homed:
            self._to_alarm(Message("stop.reset_left_board_locked_position"), now)
        elif self.homed and self._stood_mm and report.mpos_mm and elsewhere(report.mpos_mm, self._stood_mm):
            # A reset keeps the position, so the board lost its power. Noise damages one report, hardly two alike.
            found, stood = (", ".join(f"{v:.3f}" for v in place[:3]) for place in (report.mpos_mm, self._stood_mm))
            if self._moved_mm == report.mpos_mm:
                text = Message("stop.after_reset_board_reports_mpos", found_mm=found, stood_mm=stood)
                self._to_alarm(text, now)
            self._moved_mm = report.mpos_mm
            self.session.poll_now()
        elif report.state in ("Idle", "Alarm"):
            self._after_reset(report, now)

    def _report_resting(self, report: StatusReport, now: float) -> None:
        if report.state == "Idle" or (report.state == "Alarm" and not self.homed):
            return
        if report.state == "Alarm":
            self._to_alarm(LOCKED, now)
        elif self.phase is MachinePhase.STOPPED and report.state == "Door" and report.substate != 0:
            limp = self._stylus.powerless(self.config.stylus.kind)  # an open door ends a servo's pulses
            if limp is not self._stylus:
                self._stylus = limp
                self._enter(MachinePhase.STOPPED, now, self.reason)
        elif self.phase is MachinePhase.STOPPED and report.state in ("Hold", "Door"):
            self._halt(self.reason, now)
        else:
            self._halt(Message("stop.board_without_command_here", state_text=report.state_text), now)

    def _report_lifting(self, report: StatusReport, now: float) -> None:
        if report.state == "Alarm":
            self._to_alarm(LOCKED, now)
        elif self._lifts_wrongly(report) and self._lifts_left:
            self._lifts_left -= 1
            self._events.append(Note(level="error", text="the stylus does not rise, its line was damaged: held again"))
            self._halt(self.reason, now, lift_again=True)
        elif report.state == "Idle" and self._marker_done and report.mpos_mm and self._extended_by_axis():
            text = Message("stop.stylus_not_lifted_still_extended", extension_mm=1000.0 * (self._extension_m or 0.0))
            self._enter(MachinePhase.STOPPED, now, self.reason, not_lifted=text)
        elif report.state == "Idle" and self._marker_done:
            self.session.executed_all()
            self._stylus = Stylus.lifted(self.config.stylus.kind)
            self._enter(MachinePhase.STOPPED, now, self.reason, not_lifted="")
        elif report.state in ("Hold", "Door"):
            # A stop's hold that was written just before the retreat began must not leave the stylus down.
            self._lift_barred = report.state == "Door"
            self._halt(self.reason, now, lift_again=report.state == "Hold")

    def _lifts_wrongly(self, report: StatusReport) -> bool:
        """Whether x or y moves, or the stylus goes down."""
        start, place = self._lift_from_mm, report.mpos_mm
        if start is None or place is None or self.config.stylus.kind != "z_axis":
            return False
        deeper = (place[2] - start[2]) * self.config.machine.sign(2)
        return elsewhere(place[:2], start[:2]) or deeper > TUBE_MM

    def _extended_by_axis(self) -> bool:
        return self.config.stylus.kind == "z_axis" and (self._extension_m or 0.0) > STYLUS_DOWN_M


def _at_door(report: StatusReport, substate: int) -> bool:
    return report.state == "Door" and report.substate == substate


def elsewhere(mpos_mm: Sequence[float], place_mm: Sequence[float]) -> bool:
    """Whether two positions differ on the axes that both have."""
    return any(abs(a - b) > SAME_PLACE_MM for a, b in zip(mpos_mm, place_mm))
