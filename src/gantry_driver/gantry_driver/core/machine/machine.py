"""The driver's state machine for its board: connect, check, home, move, stop, recover; no I/O and no clock.

It is the policy above :class:`~gantry_driver.core.grbl.session.GrblSession`. Every motion ends in a state with a
reason, a goal gets exactly one final answer, and no buffered line runs after a stop or an error.

Its parts build on one another, see the map of this folder. This module has the time-outs, and the effect of each
message of the board.
"""

from __future__ import annotations

import math

from gantry_driver.core.board_faults.reports import with_quote
from gantry_driver.core.grbl.grbl_messages import (
    Alarm,
    Dialect,
    Feedback,
    Firmware,
    GrblMessage,
    SettingValue,
    StartupLine,
    StatusReport,
    alarm_text,
    error_text,
)
from gantry_driver.core.grbl.lines import Acknowledged, CountBroken, LineRefused, WasReset
from gantry_driver.core.grbl.session import HOLD
from gantry_driver.core.grbl.trajectory_gcode import reading_m, stylus_dwell
from gantry_driver.core.machine.board_settings import READ_STARTUP
from gantry_driver.core.machine.connection import ASK_ALONE_S, REFUSED
from gantry_driver.core.machine.homing import HOME, HOMING_LEAST_S, Homing
from gantry_driver.core.machine.proof import OWN_RESET, RESTS
from gantry_driver.core.machine.stopping import elsewhere
from gantry_driver.core.states.machine_states import MachinePhase, Note
from gantry_driver.core.wire.faults import MotionFault
from icu_common.core.goals.results import Outcome
from icu_common.core.reasons.message import Message, quoted

BANNER_TIMEOUT_S = 5.0
BUILD_WITHIN_S = 0.5
"""Maximum seconds in which a board answers ``$I``; during a homing cycle a board answers nothing."""
CRITICAL_ALARM_PAUSE_S = 0.6
"""Seconds to wait after ALARM:1 and 2: GRBL ignores a reset for about 500 ms, until ``[MSG:Reset to continue]``."""
EEPROM_READ_FAILED = 7
"""Error of a startup line; GRBL and grblHAL then empty it, continue with the other one, and also answer ``ok``."""
HOMING_WANTED = {Dialect.GRBLHAL: 11, Dialect.FLUIDNC: 14}
"""Alarm with which a firmware reports after each reset that it has not been homed."""


class Machine(Homing):
    """The state machine of one gantry.

    Commands (:meth:`home`, :meth:`reset`, :meth:`run`, ...) return at once: an empty string, or the reason of the
    rejection. :meth:`take_events` returns their later effects.
    """

    # --- messages and time -------------------------------------------------------------------------------------------

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the board."""
        self._heard_bytes += len(data)
        for message in self.session.receive(data, now):
            self._on_message(message, now)

    def tick(self, now: float) -> None:
        """Apply the time-outs."""
        age = now - self._since
        phase = self.phase
        self._events += self._resets.tick(now)
        if now >= self._released_at:
            self._was_reset()  # for a solenoid, the same as a reset
        if phase in (MachinePhase.SYNCHRONISE, MachinePhase.IDENTIFY, MachinePhase.SETTINGS, MachinePhase.WRITING):
            if age > self.config.connect_timeout_s:
                text = self._no_answer_text()
                self._close(text, now)
                self._unanswered = text if phase is MachinePhase.SYNCHRONISE else ""
                return
            if phase is MachinePhase.IDENTIFY and age > BUILD_WITHIN_S and not self._asked_again:
                self._ask_again(now)
                return
            if phase is MachinePhase.SYNCHRONISE and now >= self._probe_from:
                self._rouse(age, now)
                asked = 0.0 < self._probed > now - ASK_ALONE_S
                self.session.polling = not self.session.awaiting_banner and not asked
        elif phase is MachinePhase.HOLDING:
            self._tick_holding(age, now)
        elif phase is MachinePhase.RESETTING and self.session.awaiting_banner and age > BANNER_TIMEOUT_S:
            self._close(Message("machine.no_banner_within_reset", banner_timeout_s=BANNER_TIMEOUT_S), now)
        elif phase is MachinePhase.ALARM_RESET:
            if not self.session.awaiting_banner and now >= self._reset_not_before and self._marker == 0:
                self._marker = -1
                self.session.soft_reset(now)
            elif age > BANNER_TIMEOUT_S + CRITICAL_ALARM_PAUSE_S:
                self._close(Message("machine.no_banner_within_reset", banner_timeout_s=BANNER_TIMEOUT_S), now)
        elif phase is MachinePhase.HOMING and age > self.config.homing_timeout_s:
            self._halt(Message("machine.homing_took_longer", homing_timeout_s=self.config.homing_timeout_s), now)
        elif phase is MachinePhase.LIFTING and age > self._lift_timeout_s:
            self._enter(MachinePhase.STOPPED, now, self.reason, not_lifted=Message("machine.stylus_not_lifted_time"))
        self._watch(now)

    def _watch(self, now: float) -> None:
        rested, allowed = now - self._since, self.config.max_rest_extended_s
        paused = self._pausing and self._stylus_is_down()
        if (self._rests_extended() or paused) and rested > allowed:
            # The program that lowered the stylus has ended, although the operator is present.
            self._halt(Message("machine.stylus_left_extended_allowed", rested_s=rested, allowed_s=allowed), now)
        if self.moves_or_presses and (refusal := self._heartbeat_refusal(now)):
            self._halt(refusal, now)
        self._check_time(now)
        excused = (
            self.phase in (MachinePhase.CLOSED, MachinePhase.HOMING) or self._critical or self.session.awaiting_banner
        )
        silent = self.session.silent_for(now)
        if not excused and silent > self.config.status_timeout_s:
            self._close(
                with_quote(Message("machine.no_status_report", silent_s=silent), self.session.unread_report), now
            )
            self.session.realtime(HOLD)  # The last byte before the port is closed: the board may still receive it.

    # --- commands ----------------------------------------------------------------------------------------------------

    def enable(self, on: bool, now: float) -> str:
        """Allow or forbid motion; forbidding it while moving, or with the stylus extended, stops the machine."""
        if not on:
            self._stop_what_moves("disabled", now)
        self.enabled = on
        self._say_if_changed()
        return ""

    def activate(self, on: bool, now: float) -> None:
        """Follow the node's lifecycle: active, the machine may move; inactive, it stops and only monitors the board."""
        if not on:
            self._stop_what_moves("deactivated", now)
        self.active = on
        self._say_if_changed()

    def _stop_what_moves(self, reason: str, now: float) -> None:
        if self.moves_or_presses:
            self.stop(reason, now)

    # --- messages of the board ---------------------------------------------------------------------------------------

    def _on_message(self, message: GrblMessage, now: float) -> None:
        if isinstance(message, StatusReport):
            self._on_report(message, now)
        elif isinstance(message, Acknowledged):
            self._on_acknowledged(message, now)
        elif isinstance(message, LineRefused):
            self._on_refused(message, now)
        elif isinstance(message, WasReset):
            self._on_reset(message, now)
        elif isinstance(message, Alarm):
            self._on_alarm(message, now)
        elif isinstance(message, CountBroken):
            self._on_count_broken(message, now)
        elif isinstance(message, SettingValue):
            self._settings[message.number] = message.text
        elif isinstance(message, StartupLine):
            self._startup[message.name] = message.text
        elif isinstance(message, Firmware):
            self._on_firmware(message, now)
        elif isinstance(message, Feedback) and message.key == "GC":
            if self._goal is not None and self.session.answers_number == self._goal.confirm_line:
                self._goal.modes_text = message.text
        elif isinstance(message, Feedback) and message.key == "MSG" and "reset to continue" in message.text.lower():
            self._reset_not_before = now

    def _on_reset(self, event: WasReset, now: float) -> None:
        banner = event.banner
        if self.dialect in REFUSED and banner.dialect in REFUSED:
            return
        if banner.dialect in REFUSED and self.phase is MachinePhase.SYNCHRONISE:
            self._refuse(banner.dialect, now)
            return
        self._critical, self._has_g92, self._frame_mm = False, None, None
        self._kept_place.was_reset(expected=event.expected)
        if self.phase is MachinePhase.SYNCHRONISE or (event.expected and self.phase is MachinePhase.ALARM_RESET):
            # Also after an alarm: it may have come before the settings were read, or the board may be another one.
            self.dialect, self.firmware = banner.dialect, banner.version
            self._identify(now, self.reason if self.phase is MachinePhase.SYNCHRONISE else "")
        elif event.expected and self.phase in (MachinePhase.RESETTING, MachinePhase.ALARM):
            self._stylus = self._stylus.powerless(self.config.stylus.kind)
            self.session.poll_now()
        elif self.phase in (MachinePhase.ALARM, MachinePhase.ALARM_RESET):
            # GRBL resets itself after most alarms, which remain the reason; lines in transit must not run.
            self.session.realtime(HOLD)
        elif self.phase in (MachinePhase.IDENTIFY, MachinePhase.SETTINGS):
            # The board's own banner and the banner of the requested reset crossed.
            self._identify(now, self.reason)
        else:
            self._on_own_reset(OWN_RESET, len(event.lost), now)
        self._was_reset()

    def _ask_again(self, now: float) -> None:
        """Reset a board that does not answer ``$I``: one flipped bit makes it ``$H``, which homes."""
        self._asked_again = True
        reason = Message("machine.board_not_answered_within_may", build_within_s=BUILD_WITHIN_S)
        self._events.append(Note(level="error", text=reason))
        self._synchronise(now, reason)
        self.session.soft_reset(now)

    def _on_own_reset(self, reason: str, lost: int, now: float) -> None:
        self._finish(Outcome.ABORTED, reason, now)
        self._forget_position()
        self._events += self._resets.reset(reason, lost, now)
        # Lines in transit may reach the restarted board and run: hold, and reset once more.
        self._synchronise(now, reason)
        self.session.realtime(HOLD)

    def _was_reset(self) -> None:
        self._released_at = math.inf
        self._stylus = self._stylus.was_reset(self.config.stylus.kind)
        self._say_if_changed()

    def _on_acknowledged(self, event: Acknowledged, now: float) -> None:
        number = event.line.number
        z_axis = self.config.stylus.kind == "z_axis"
        if not z_axis and number > self._stylus_line and event.line.text == stylus_dwell(self.config):
            self._stylus = self._stylus.settled()
        self._acked = number
        if (goal := self._goal) is not None:
            if goal.confirming is not None and number == goal.confirm_line:
                self._modes_answered(goal, now)
            if self._stage_sent(goal):
                self.session.poll_now()
        if event.line.text == HOME and self.phase is MachinePhase.HOMING and self.session.latency_s < HOMING_LEAST_S:
            # A damaged $H is a query that is answered at once, or a comment.
            text = Message("machine.homing_answered_after_board_not", latency_s=self.session.latency_s)
            self._halt(text, now)
            return
        if number != self._marker:
            return
        if self.phase is MachinePhase.IDENTIFY:
            self._read_settings(now, self.reason)
        elif self.phase is MachinePhase.WRITING:
            self._read_settings(now, "")
        elif self.phase is MachinePhase.SETTINGS:
            self._read_startup(now)
        elif self.phase in (MachinePhase.HOMING, MachinePhase.LIFTING):
            self._marker_done = True
            self.session.poll_now()

    def _on_refused(self, event: LineRefused, now: float) -> None:
        text = Message(
            "machine.line", error_text=error_text(event.code), number=event.line.number, line=quoted(event.line.text)
        )
        self._events.append(Note(level="error", text=text))
        if self._confirms_again(event.line, now):
            return
        if self.phase in (MachinePhase.MOVING, MachinePhase.IDLE):
            self._halt(text, now)
        elif self.phase is MachinePhase.HOMING:
            self._halt(Message("machine.homing_refused", text=text), now)
        elif self.phase is MachinePhase.LIFTING:
            self._enter(
                MachinePhase.STOPPED, now, self.reason, not_lifted=Message("machine.stylus_not_lifted", text=text)
            )
        elif self.phase is MachinePhase.WRITING and event.line.number == self._marker:
            self._read_settings(now, "")
        elif self.phase is MachinePhase.SETTINGS and event.line.text in READ_STARTUP:
            if event.code != EEPROM_READ_FAILED:  # a firmware without this query has no such lines
                self._startup = dict.fromkeys(READ_STARTUP[event.line.text], "") | self._startup
            if event.line.number == self._marker:
                self._read_startup(now)
        elif self.phase in (MachinePhase.IDENTIFY, MachinePhase.SETTINGS) and event.line.number == self._marker:
            self._close(Message("machine.refused", line=event.line.text, text=text), now)

    def _on_alarm(self, alarm: Alarm, now: float) -> None:
        text = alarm_text(alarm.code, self.dialect)
        if self.phase in (MachinePhase.SYNCHRONISE, MachinePhase.CLOSED):
            return
        if self.phase is MachinePhase.RESETTING and not self.homed:
            # A reset with an unknown position (homing cycle, incomplete hold) may cause ALARM:3 or 6.
            self._events.append(Note(level="warn", text=text))
            return
        if not self.homed and self.phase is not MachinePhase.HOMING and alarm.code == HOMING_WANTED.get(self.dialect):
            return
        self._critical = alarm.code in (1, 2, 10)
        self._reset_not_before = now + (CRITICAL_ALARM_PAUSE_S if self._critical else 0.0)
        self._to_alarm(text, now, code=alarm.code)

    def _on_count_broken(self, event: CountBroken, now: float) -> None:
        if self.phase in (MachinePhase.ALARM, MachinePhase.ALARM_RESET):
            return  # the reset discards the unanswered lines
        self._events.append(Note(level="error", text=event.reason))
        if self.phase in (
            MachinePhase.IDENTIFY,
            MachinePhase.SETTINGS,
            MachinePhase.WRITING,
            MachinePhase.MISMATCH,
            MachinePhase.UNHOMED,
        ):
            self._synchronise(now, event.reason)
        elif self.phase is MachinePhase.MOVING:
            self._fault(MotionFault.LOST_ANSWER, event.reason, now)
        elif self.phase in (MachinePhase.IDLE, MachinePhase.HOMING, MachinePhase.LIFTING):
            self._halt(event.reason, now)

    def _on_report(self, report: StatusReport, now: float) -> None:
        if (
            report.state == "Alarm"
            and self.homed
            and self.phase not in (MachinePhase.RESETTING, MachinePhase.ALARM_RESET)
        ):
            self._handle_report(report, now)  # its position is no longer valid
            return
        if strayed := self._strayed(report, now):
            # A board that counts from zero was reset and its banner was damaged; not every board locks itself then.
            # Otherwise its steps per mm were changed, or a pendant moved it. Noise damages no two reports alike.
            last, place = self._moved_mm, report.mpos_mm
            alike = last is not None and place is not None and self._can_be_at(place, last, now - self._moved_at)
            if self._moved_mm == place or (alike and self.phase not in RESTS):
                self._on_own_reset(strayed, self.session.pending, now)
            self._moved_mm, self._moved_at = place, self.session.report_asked_at
            self.counts.disbelieved += 1
            self.session.poll_now()
            return
        if report.overrides_percent is not None:
            self._set_overrides_back(now, *report.overrides_percent)
        if self._leaves_path(report, now) or self._moves_at_rest(report, now):
            self.counts.disbelieved += 1
            return
        if self.phase is not MachinePhase.RESETTING:
            asked_at = self.session.report_asked_at
            self._stood_mm, self._stood_at, self._moved_mm = report.mpos_mm, asked_at, None
        stood = self._stood_mm
        moved = self.phase is MachinePhase.RESETTING and stood and report.mpos_mm and elsewhere(report.mpos_mm, stood)
        if self.homed and report.mpos_mm is not None and not moved:
            # A rising stylus counts as down: if an alarm ends the retreat, this is the last reading of it.
            self.reading_m = reading_m(report.mpos_mm, self._stylus_is_down(), self.config)
            self._append_position(report)
        self._handle_report(report, now)

    def _handle_report(self, report: StatusReport, now: float) -> None:
        handler = {
            MachinePhase.SYNCHRONISE: self._report_synchronise,
            MachinePhase.IDENTIFY: self._report_connecting,
            MachinePhase.SETTINGS: self._report_connecting,
            MachinePhase.WRITING: self._report_connecting,
            MachinePhase.HOMING: self._report_homing,
            MachinePhase.IDLE: self._report_resting,
            MachinePhase.UNHOMED: self._report_resting,
            MachinePhase.MISMATCH: self._report_resting,
            MachinePhase.STOPPED: self._report_resting,
            MachinePhase.MOVING: self._report_moving,
            MachinePhase.HOLDING: self._report_holding,
            MachinePhase.RESETTING: self._report_resetting,
            MachinePhase.LIFTING: self._report_lifting,
        }.get(self.phase)
        if handler is not None:
            handler(report, now)
