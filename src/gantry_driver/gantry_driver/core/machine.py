"""What the driver does with its board: connect, check, home, move, stop, recover; no I/O and no clock.

The policy above :class:`~gantry_driver.core.session.GrblSession`: every way out of a motion ends in a state that says
why, a goal gets exactly one final answer, and nothing that was buffered runs after a stop or an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

from gantry_driver.core.connection import (
    ASK_ALONE_S,
    HOLD_REPEAT_S,
    OLD_HOLDS,
    READ_STARTUP,
    REFUSED,
    Connection,
    Goal,
    Reading,
)
from gantry_driver.core.gcode_check import Bounds, CheckedLine, GcodeError, ProgramChecker
from gantry_driver.core.grbl_messages import (
    Alarm,
    Dialect,
    Feedback,
    Firmware,
    Message,
    Report,
    SettingValue,
    StartupLine,
    alarm_text,
    error_text,
)
from gantry_driver.core.machine_states import (
    Note,
    Phase,
    Position,
)
from gantry_driver.core.session import (
    FULL_FEED,
    FULL_SPINDLE,
    HOLD,
    RESUME,
    Acknowledged,
    CountBroken,
    Line,
    Refused,
    WasReset,
)
from gantry_driver.core.stylus_state import MAY_PRESS, MAY_SINK, Stylus
from gantry_driver.core.trajectory_gcode import (
    SYNCHRONISE,
    TrajectoryError,
    Waypoint,
    lift_lines,
    may_be_down_after,
    mpos_mm,
    reading_m,
    stylus_dwell,
    write_motion,
)
from icu_common.core.results import GoalResult, Outcome

BANNER_TIMEOUT_S = 5.0
CRITICAL_ALARM_PAUSE_S = 0.6
"""After ALARM:1 and 2 GRBL swallows a reset for about 500 ms, until ``[MSG:Reset to continue]``."""
EEPROM_READ_FAILED = 7
"""Of a startup line; GRBL and grblHAL empty it then, go on with the other one, and answer ``ok`` besides."""
HOMING_FIRST = 22, 4
"""The setting, and its bit, with which a grblHAL that has not been homed is not unlocked by ``$X`` either."""
HOMING_WANTED = {Dialect.GRBLHAL: 11, Dialect.FLUIDNC: 14}
"""The alarm with which a firmware says after each reset that it has not been homed."""
SAME_PLACE_MM = 0.05
QUEUED_LINES = 600
"""Of a goal, ahead of the board: more than the shortest lines that any receive buffer holds."""
LOCKED = "the board is locked by an alarm whose number was not received"
PROGRAM_MODES = ("G49", "G0G17G21G40G54G90G94")
"""What a program may rely on at its first line."""


class Machine(Connection):
    """The state machine of one gantry.

    Calls that people make (:meth:`home`, :meth:`reset`, :meth:`run`, ...) return an empty string or the reason of the
    refusal, at once; what follows is seen in :meth:`take_events`.
    """

    # --- what the link says ------------------------------------------------------------------------------------

    def receive(self, data: bytes, now: float) -> None:
        """Take bytes from the board."""
        self._heard_bytes += len(data)
        for message in self.session.receive(data, now):
            self._on_message(message, now)

    def tick(self, now: float) -> None:
        """Let time-outs happen."""
        age = now - self._since
        phase = self.phase
        if phase in (Phase.SYNCHRONISE, Phase.IDENTIFY, Phase.SETTINGS, Phase.WRITING):
            if age > self.config.connect_timeout_s:
                text = self._no_answer_text()
                self._close(text, now)
                self._unanswered = text if phase is Phase.SYNCHRONISE else ""
                return
            if phase is Phase.SYNCHRONISE and now >= self._probe_from:
                self._rouse(age, now)
                asked = 0.0 < self._probed > now - ASK_ALONE_S
                self.session.polling = not self.session.awaiting_banner and not asked
        elif phase is Phase.HOLDING:
            self._tick_holding(age, now)
        elif phase is Phase.RESETTING and self.session.awaiting_banner and age > BANNER_TIMEOUT_S:
            self._close(f"no banner within {BANNER_TIMEOUT_S:g} s of a reset", now)
        elif phase is Phase.ALARM_RESET:
            if not self.session.awaiting_banner and now >= self._reset_not_before and self._marker == 0:
                self._marker = -1
                self.session.soft_reset(now)
            elif age > BANNER_TIMEOUT_S + CRITICAL_ALARM_PAUSE_S:
                self._close(f"no banner within {BANNER_TIMEOUT_S:g} s of a reset", now)
        elif phase is Phase.HOMING and age > self.config.homing_timeout_s:
            self._halt(f"homing took longer than {self.config.homing_timeout_s:g} s", now)
        elif phase is Phase.LIFTING and age > self._lift_timeout_s:
            self._enter(Phase.STOPPED, now, self.reason, not_lifted="the stylus was not lifted in time")
        self._watch(now)

    def _watch(self, now: float) -> None:
        rested, allowed = now - self._since, self.config.max_rest_extended_s
        paused = self._pausing and self._stylus_is_down()
        if (self._rests_extended() or paused) and rested > allowed:
            # Whoever lowered it has gone, though the operator has not.
            self._halt(f"the stylus was left extended for {rested:.1f} s, {allowed:g} s are allowed", now)
        busy = self.phase in (Phase.MOVING, Phase.HOMING)
        if (busy or self._rests_extended()) and (refusal := self._heartbeat_refusal(now)):
            self._halt(refusal, now)
        excused = self.phase in (Phase.CLOSED, Phase.HOMING) or self._critical or self.session.awaiting_banner
        silent = self.session.silent_for(now)
        if not excused and silent > self.config.status_timeout_s:
            self._close(f"no status report for {silent:.1f} s", now)
            self.session.realtime(HOLD)  # The last byte before the port is closed: perhaps the board still hears.

    # --- what people ask for -------------------------------------------------------------------------------------

    def heartbeat(self, at: float) -> None:
        """Note that the operator was there at ``at`` (the clock of ``now``)."""
        self._heartbeat_at = max(self._heartbeat_at, at)

    def enable(self, on: bool, now: float) -> str:
        """Allow or forbid motion; forbidding it while moving or with the stylus extended is a stop."""
        if not on:
            self._stop_what_moves("disabled", now)
        before = self.state_text
        self.enabled = on
        self._say_if_changed(before)
        return ""

    def activate(self, on: bool, now: float) -> None:
        """Let the machine move, or end what moves and only watch the board: the lifecycle of its node."""
        if not on:
            self._stop_what_moves("deactivated", now)
        before = self.state_text
        self.active = on
        self._say_if_changed(before)

    def _stop_what_moves(self, reason: str, now: float) -> None:
        if self.phase in (Phase.MOVING, Phase.HOMING) or self._rests_extended():
            self.stop(reason, now)

    def home(self, now: float) -> str:
        """Begin a homing cycle."""
        if self.phase not in (Phase.UNHOMED, Phase.IDLE) and not self._misplaced:
            return f"the driver is {self.state_text}"
        if refusal := self._permission(now) or self._unlock_refusal():
            return refusal
        self._forget_position()
        self._enter(Phase.HOMING, now)
        self._marker_done = False
        if self.config.stylus.kind != "z_axis":
            # The stylus may be down and a locked board takes no M3 or M9: unlock, lift, and only then travel.
            for text in ("$X", *lift_lines(self.config)):
                self._order_stylus(self.session.queue(text, answer_within_s=self.config.homing_timeout_s))
        # Only GRBL is known to forget a tool's length and a chosen system at a reset; what others report as their work
        # offset is the sum of all, and is G54's, with which a program is checked, only once both are ended.
        ends: tuple[str, ...] = () if self.dialect is Dialect.GRBL else ("G49", "G54")
        if ends and self._is_servo():
            ends = (*ends, *lift_lines(self.config))  # grblHAL switches the spindle off before it homes
        for text in ("$H", *ends):
            self._marker = self.session.queue(text, answer_within_s=self.config.homing_timeout_s).number
        return ""

    def _unlock_refusal(self) -> str:
        """Return why the board takes no line that lifts the stylus before homing, which itself lifts a Z axis only."""
        number, bit = HOMING_FIRST
        value = self._settings.get(number, "")
        locked = self.dialect is Dialect.GRBLHAL and value.isdecimal() and int(value) & bit
        if self.config.stylus.kind == "z_axis" or self.homed or not locked:
            return ""
        return (
            f"the board must be homed before it takes any line (${number} is {value}), but the stylus has to be lifted "
            f"before that: set ${number} to 1, as gantry/write_settings does"
        )

    def stop(self, reason: str, now: float, *, hold_written: bool = False) -> None:
        """Hold, flush everything that is buffered, lift the stylus, and stay stopped until :meth:`reset`.

        Parameters
        ----------
        reason
            Published as ``stopped: reason``.
        hold_written
            The ``!`` is on the wire already.
        """
        if self.phase is Phase.ALARM or self.dialect in REFUSED:
            return
        self._latched = self._latched or reason
        if self.phase in (Phase.SYNCHRONISE, Phase.IDENTIFY, Phase.SETTINGS, Phase.WRITING):
            self._synchronise(now, "")
            if not hold_written:
                self.session.realtime(HOLD)
        if self.phase in (Phase.CLOSED, Phase.SYNCHRONISE, Phase.ALARM_RESET):
            return
        if self.phase is Phase.LIFTING and not hold_written:
            return  # The retreat is the way into the safe state already: a repeated stop lets it finish.
        if self.phase is Phase.STOPPED:
            self._lift = self.config.lift_on_stop and not self._lift_barred  # also where a lost count ended the retreat
        self._halt(reason, now, hold_written=hold_written, lift_again=True)

    def pause(self, now: float) -> str:
        """Hold a motion where it is; what is buffered stays, and so does the stylus for as long as it may rest down."""
        if self.phase is not Phase.MOVING or self._pausing:
            return f"nothing to pause: the driver is {self.state_text}"
        self.session.paused = self._pausing = True
        self._resuming = False
        self._hold_sent = now
        self.session.realtime(HOLD)
        self._enter(Phase.MOVING, now, "paused")
        return ""

    def resume(self, now: float) -> str:
        """Go on with a motion that was paused."""
        if self.phase is not Phase.MOVING or not self._pausing:
            return f"nothing to resume: the driver is {self.state_text}"
        if refusal := self._permission(now):
            return refusal
        self._pausing, self._resuming = False, True
        self.session.paused = False
        self._enter(Phase.MOVING, now)
        return ""

    def reset(self, now: float) -> str:
        """Leave ``stopped``, ``alarm``, or the ``mismatch`` of a machine that homed in another place."""
        if self.phase is Phase.STOPPED:
            self._latched = ""
            self._enter(self._resting_phase(), now, self._mismatch if self._blocked() else "")
            return ""
        if self.phase is Phase.ALARM:
            self._enter(Phase.ALARM_RESET, now, self.reason)
            self._marker = 0
            return ""
        if self._misplaced:
            self._enter(Phase.UNHOMED, now)
            return ""
        if self.phase in (Phase.HOLDING, Phase.RESETTING, Phase.LIFTING):
            return "the stop is not complete yet"
        return f"nothing to reset: the driver is {self.state_text}"

    def run(
        self, goal_id: str, names: Sequence[str], points: Sequence[Waypoint], *, age_s: float, now: float
    ) -> GoalResult:
        """Start a trajectory, or refuse it; the answer is returned and also in the events.

        Parameters
        ----------
        goal_id
            Returned in the answers.
        names, points
            The trajectory's joints and points, readings in metres.
        age_s
            Age of the trajectory's stamp; 0 for "now".
        """
        text = f"{len(points)} points" + (f" to {tuple(points[-1].positions_m)}" if points else "")
        try:
            if refusal := self._goal_refusal(age_s, now):
                raise TrajectoryError(refusal)
            x, y, z = self.reading_m or (0.0, 0.0, 0.0)
            if self.config.stylus.kind != "z_axis":
                # The reading may be of a moment ago.
                z = self.config.stylus.stroke_m if self._stylus_is_down() else 0.0
            start = x, y, z
            motion = write_motion(names, points, start, self.config)
        except TrajectoryError as error:
            return self._answer(GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=str(error)))
        timed = ((line, 0.0) for line in motion.lines)
        return self._start(goal_id, text, timed, len(motion.lines), motion.end_m, now)

    def run_program(self, goal_id: str, source: Iterable[str], now: float) -> GoalResult:
        """Check a whole G-code program and start it; or refuse it, with line and column, before a byte is sent."""
        try:
            if refusal := self._goal_refusal(0.0, now):
                raise TrajectoryError(refusal)
            checker = self.program_checker()
            checked = list(checker.check_all(source))
        except (TrajectoryError, GcodeError) as error:
            return self._refuse_program(goal_id, error)
        return self.run_checked(goal_id, checker, checked, now)

    def program_checker(self) -> ProgramChecker:
        """Return what checks a program that is to start here and now.

        Raises
        ------
        TrajectoryError
            While the board's work offset is not known.
        """
        if self.session.wco_mm is None:
            raise TrajectoryError("the board has not told its work offset (WCO) yet")
        bounds, start = self.bounds(), mpos_mm(self.reading_m or (0.0, 0.0, 0.0), self.config)
        inside = [min(max(place, low), high) for place, low, high in zip(start, bounds.low_mm, bounds.high_mm)]
        steps_mm = (1.0 / scale for scale in self.config.machine.steps_per_mm)
        # At its end an axis reports the motor step that is nearest, which may lie beyond it.
        start = _three([i if abs(i - place) < step else place for i, place, step in zip(inside, start, steps_mm)])
        kept_g92 = self.dialect is not Dialect.GRBL if self._has_g92 is None else self._has_g92
        return ProgramChecker(bounds, start, {"G54": _three(self.session.wco_mm[:3])}, kept_g92=kept_g92)

    def run_checked(
        self, goal_id: str, checker: ProgramChecker, checked: Sequence[CheckedLine], now: float
    ) -> GoalResult:
        """Start a program that :meth:`program_checker` has passed; checking a long one takes seconds."""
        try:
            if refusal := self._goal_refusal(0.0, now):
                raise TrajectoryError(refusal)
            if self.program_checker().begins != checker.begins:
                raise TrajectoryError("place or work offset have changed since the program was checked")
        except TrajectoryError as error:
            return self._refuse_program(goal_id, error)
        text = f"program of {len(checked)} lines, about {checker.seconds:.1f} s"
        end = reading_m(checker.position_mm, False, self.config)
        # The checker begins with these modes; the board may have been left with others.
        modes = ((mode, 0.0) for mode in PROGRAM_MODES)
        lines = ((line.text, line.seconds) for line in checked)
        count = len(PROGRAM_MODES) + len(checked) + 1
        return self._start(goal_id, text, chain(modes, lines, [(SYNCHRONISE, 0.0)]), count, end, now)

    def _refuse_program(self, goal_id: str, error: Exception) -> GoalResult:
        return self._answer(GoalResult(goal_id=goal_id, goal="program", outcome=Outcome.REJECTED, reason=str(error)))

    def _order_stylus(self, line: Line) -> None:
        """Note what a line that was queued may do with the stylus."""
        if self.config.stylus.kind == "z_axis":
            if "Z" in line.text:
                self._stylus = Stylus.UNDER_WAY
        elif (down := may_be_down_after(line.text, self.config)) is not None:
            self._stylus, self._stylus_line = self._stylus.ordered(down), line.number

    def _start(
        self, goal_id: str, text: str, lines: Iterator[tuple[str, float]], count: int, end_m: Reading, now: float
    ) -> GoalResult:
        """Send ``count`` lines, each with the seconds that its dwell may take, and wait for the last one."""
        self._goal = Goal(goal_id=goal_id, text=text, end_m=end_m, started=now, rest=lines, left=count)
        accepted = self._answer(GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.ACCEPTED))
        self._enter(Phase.MOVING, now)
        return accepted

    def output(self, now: float) -> bytes:
        """Return the bytes to write."""
        if self.phase is Phase.MOVING and self._goal is not None:
            self._queue_more(self._goal)
        return super().output(now)

    def _queue_more(self, goal: Goal) -> None:
        """Queue lines while they are few, so that the start of a long program keeps nobody waiting."""
        while goal.left and self.session.unsent < QUEUED_LINES:
            text, seconds = next(goal.rest)
            goal.left -= 1
            if "G92" in text:
                self._has_g92 = "G92.1" not in text
            line = self.session.queue(text, answer_within_s=self._answer_time() + seconds)
            self._order_stylus(line)
            goal.marker = 0 if goal.left else line.number

    def bounds(self) -> Bounds:
        """Return the travel in machine coordinates and the rates of rapid moves."""
        ends = mpos_mm((0.0, 0.0, 0.0), self.config), mpos_mm(self.config.limits_m(), self.config)
        low, high = (_three([pick(pair) for pair in zip(*ends)]) for pick in (min, max))
        return Bounds(low_mm=low, high_mm=high, rapid_mm_min=_three(self.config.machine.max_rate_mm_min))

    def _goal_refusal(self, age_s: float, now: float) -> str:
        if not abs(age_s) <= self.config.goal_max_age_s:
            return f"stale: its stamp is {age_s:.3f} s old, {self.config.goal_max_age_s:g} s are allowed"
        if self.phase is not Phase.IDLE:
            return f"the driver is {self.state_text}"
        return self._permission(now)

    def _permission(self, now: float) -> str:
        if not self.active:
            return "the driver is inactive"
        return "not enabled" if not self.enabled else self._heartbeat_refusal(now)

    def _heartbeat_refusal(self, now: float) -> str:
        age = now - self._heartbeat_at
        if age <= self.config.heartbeat_timeout_s:
            return ""
        if math.isinf(age):
            return "no operator's heartbeat yet"
        return f"operator's heartbeat lost: {age:.2f} s old, {self.config.heartbeat_timeout_s:g} s are allowed"

    def _answer_time(self) -> float:
        return self.config.answer_timeout_s + self.config.stylus.dwell_s

    # --- transitions ---------------------------------------------------------------------------------------------

    def _halt(self, reason: str, now: float, *, hold_written: bool = False, lift_again: bool = False) -> None:
        """Begin the way down: hold, wait for it, reset, lift; the goal is answered now."""
        self._finish(Outcome.ABORTED, reason, now)
        if self.phase in (Phase.STOPPED, Phase.HOLDING, Phase.RESETTING, Phase.LIFTING):
            # The first reason is the one that explains; a retreat that failed is not repeated.
            reason, self._lift = self.reason, self._lift and (lift_again or self.phase is not Phase.LIFTING)
        else:
            self._lift, self._lift_barred = self.config.lift_on_stop, False
        self._latched = reason
        if self.phase in (Phase.HOLDING, Phase.RESETTING):
            return
        if self.phase is Phase.HOMING:
            # GRBL does not hold in a homing cycle; a reset ends it with ALARM:6, and nothing is known to be lost.
            self._forget_position()
            self._enter(Phase.RESETTING, now, reason)
            self.session.soft_reset(now)
            return
        self._old_holds = OLD_HOLDS if self._resuming else 0
        self.session.withdraw(RESUME)
        if not hold_written or self._resuming:  # a `~` may be on its way behind the hold that is written
            self.session.realtime(HOLD)
        self._hold_sent = now
        self.session.paused = True
        self._enter(Phase.HOLDING, now, reason)

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
        self._enter(Phase.RESETTING, now, self.reason)
        self.session.soft_reset(now)

    # --- what the board says -------------------------------------------------------------------------------------

    def _on_message(self, message: Message, now: float) -> None:
        if isinstance(message, Report):
            self._on_report(message, now)
        elif isinstance(message, Acknowledged):
            self._on_acknowledged(message, now)
        elif isinstance(message, Refused):
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
        elif isinstance(message, Feedback) and message.key == "MSG" and "reset to continue" in message.text.lower():
            self._reset_not_before = now

    def _on_reset(self, event: WasReset, now: float) -> None:
        banner = event.banner
        if banner.dialect is Dialect.MARLIN or (banner.dialect in REFUSED and self.phase is Phase.SYNCHRONISE):
            self._refuse(banner.dialect, now)
            return
        self._critical, self._has_g92 = False, None
        if self.phase is Phase.SYNCHRONISE or (event.expected and self.phase is Phase.ALARM_RESET):
            # Also after an alarm: it may have come before the settings were known, or the board is another one.
            self.dialect, self.firmware = banner.dialect, banner.version
            self._identify(now, self.reason if self.phase is Phase.SYNCHRONISE else "")
        elif event.expected and self.phase in (Phase.RESETTING, Phase.ALARM):
            self._stylus = self._stylus.powerless(self.config.stylus.kind)
            self.session.poll_now()
        elif self.phase in (Phase.ALARM, Phase.ALARM_RESET):
            # GRBL resets itself after most alarms, which are still the reason; what is on the wire must not run.
            self.session.realtime(HOLD)
        elif self.phase in (Phase.IDENTIFY, Phase.SETTINGS):
            # The board's own banner and that of the reset sent to it crossed.
            self._identify(now, self.reason)
        else:
            reason = "the board was reset by itself, its position is lost"
            self._finish(Outcome.ABORTED, reason, now)
            self._forget_position()
            self._events.append(Note(level="error", text=f"{reason}; {len(event.lost)} lines unanswered"))
            # Lines that were on the wire may reach the fresh board and be executed: hold, and reset once more.
            self._synchronise(now, reason)
            self.session.realtime(HOLD)
        self._stylus = self._stylus.was_reset(self.config.stylus.kind)

    def _on_acknowledged(self, event: Acknowledged, now: float) -> None:
        number = event.line.number
        z_axis = self.config.stylus.kind == "z_axis"
        if not z_axis and number > self._stylus_line and event.line.text == stylus_dwell(self.config):
            self._stylus = self._stylus.settled()
        if self._goal is not None and number == self._goal.marker:
            self._goal.acknowledged = True
            self.session.poll_now()
        if number != self._marker:
            return
        if self.phase is Phase.IDENTIFY:
            self._read_settings(now, self.reason)
        elif self.phase is Phase.WRITING:
            self._read_settings(now, "")
        elif self.phase is Phase.SETTINGS:
            self._read_startup(now)
        elif self.phase in (Phase.HOMING, Phase.LIFTING):
            self._marker_done = True
            self.session.poll_now()

    def _on_refused(self, event: Refused, now: float) -> None:
        text = f"{error_text(event.code)} at line {event.line.number} {event.line.text!r}"
        self._events.append(Note(level="error", text=text))
        if self.phase in (Phase.MOVING, Phase.IDLE):
            self._halt(text, now)
        elif self.phase is Phase.HOMING:
            self._halt(f"homing refused: {text}", now)
        elif self.phase is Phase.LIFTING:
            self._enter(Phase.STOPPED, now, self.reason, not_lifted=f"the stylus was not lifted: {text}")
        elif self.phase is Phase.WRITING and event.line.number == self._marker:
            self._read_settings(now, "")
        elif self.phase is Phase.SETTINGS and event.line.text in READ_STARTUP:
            if event.code != EEPROM_READ_FAILED:  # a firmware that does not know the question has no such lines
                self._startup = dict.fromkeys(READ_STARTUP[event.line.text], "") | self._startup
            if event.line.number == self._marker:
                self._read_startup(now)
        elif self.phase in (Phase.IDENTIFY, Phase.SETTINGS) and event.line.number == self._marker:
            self._close(f"{event.line.text} was refused: {text}", now)

    def _on_alarm(self, alarm: Alarm, now: float) -> None:
        text = alarm_text(alarm.code, self.dialect)
        if self.phase in (Phase.SYNCHRONISE, Phase.CLOSED):
            return
        if self.phase is Phase.RESETTING and not self.homed:
            # The reset of an unknown position (homing cycle, a hold that did not complete) may say ALARM:3 or 6.
            self._events.append(Note(level="warn", text=text))
            return
        if not self.homed and self.phase is not Phase.HOMING and alarm.code == HOMING_WANTED.get(self.dialect):
            return
        self._critical = alarm.code in (1, 2, 10)
        self._reset_not_before = now + (CRITICAL_ALARM_PAUSE_S if self._critical else 0.0)
        self._to_alarm(text, now)

    def _to_alarm(self, text: str, now: float) -> None:
        if self.phase.state == "stopped":
            told_anew = self._not_lifted in (MAY_PRESS, MAY_SINK)
            text = f"{text}, after: {self.reason if told_anew else self._whole_reason()}"
        self._finish(Outcome.ABORTED, text, now)
        self._forget_position()
        self._stylus = self._stylus.powerless(self.config.stylus.kind)
        self.session.last_report_at = now  # In a homing cycle it is the first that the board says.
        self._latched = ""  # The alarm is latched itself, and its reset is the same call.
        if self.phase is Phase.ALARM_RESET:  # an emergency stop is still pressed: no banner comes
            self.session.awaiting_banner = False
        if self.phase is not Phase.ALARM:
            self._enter(Phase.ALARM, now, text)

    def _on_count_broken(self, event: CountBroken, now: float) -> None:
        self._events.append(Note(level="error", text=event.reason))
        if self.phase in (Phase.IDENTIFY, Phase.SETTINGS, Phase.WRITING, Phase.MISMATCH, Phase.UNHOMED):
            self._synchronise(now, event.reason)
        elif self.phase in (Phase.MOVING, Phase.IDLE, Phase.HOMING, Phase.LIFTING):
            self._halt(event.reason, now)

    def _on_report(self, report: Report, now: float) -> None:
        if self.homed and report.mpos_mm is not None:
            # On its way up it counts as down: should an alarm end that way, this is the last that anybody hears of it.
            self.reading_m = reading_m(report.mpos_mm, self._stylus_is_down(), self.config)
            self._events.append(Position(reading_m=self.reading_m))
        if report.overrides_percent is not None:
            self._set_overrides_back(*report.overrides_percent)
        handler = {
            Phase.SYNCHRONISE: self._report_synchronise,
            Phase.IDENTIFY: self._report_connecting,
            Phase.SETTINGS: self._report_connecting,
            Phase.WRITING: self._report_connecting,
            Phase.HOMING: self._report_homing,
            Phase.IDLE: self._report_resting,
            Phase.UNHOMED: self._report_resting,
            Phase.MISMATCH: self._report_resting,
            Phase.STOPPED: self._report_resting,
            Phase.MOVING: self._report_moving,
            Phase.HOLDING: self._report_holding,
            Phase.RESETTING: self._report_resetting,
            Phase.LIFTING: self._report_lifting,
        }.get(self.phase)
        if handler is not None:
            handler(report, now)

    def _set_overrides_back(self, feed: float, _rapid: float, spindle: float) -> None:
        """End what a pendant has raised: no touch is faster, and no servo elsewhere, than it is configured.

        Somebody who slows the machine down does so with care, and is let.
        """
        raised = feed > 100.0 or (spindle != 100.0 and self._is_servo())
        if raised:
            self.session.realtime(FULL_FEED)
            self.session.realtime(FULL_SPINDLE)
            if not self._raised:
                told = f"the board's overrides were {feed:g} % (feed) and {spindle:g} % (spindle): set back to 100 %"
                self._events.append(Note(level="warn", text=told))
        self._raised = raised

    def _report_homing(self, report: Report, now: float) -> None:
        if not self._marker_done or report.state == "Home":
            return
        if report.state != "Idle":
            self._to_alarm(f"after homing the board is {report.state_text}", now)
            return
        if report.mpos_mm is None:
            return  # A work position; its offset comes with one of the next reports.
        # A stage whose stylus is no Z axis need not have one, and its Z stays where it was at power-up.
        expected = self.config.machine.homed_mpos_mm()[: 3 if self.config.stylus.kind == "z_axis" else 2]
        if _elsewhere(report.mpos_mm, expected):
            found = ", ".join(f"{v:.3f}" for v in report.mpos_mm[:3])
            text = f"homed at MPos {found} mm, the configuration says {', '.join(f'{v:g}' for v in expected)} mm"
            self._enter(Phase.MISMATCH, now, text)
            self._misplaced = True
            return
        self.homed, self._stylus = True, Stylus.lifted(self.config.stylus.kind)
        self.session.executed_all()
        self.reading_m = reading_m(report.mpos_mm, False, self.config)
        self._events.append(Position(reading_m=self.reading_m))
        self._enter(Phase.IDLE, now)

    def _report_resting(self, report: Report, now: float) -> None:
        if report.state == "Idle" or (report.state == "Alarm" and not self.homed):
            return
        if report.state == "Alarm":
            self._to_alarm(LOCKED, now)
        elif self.phase is Phase.STOPPED and report.state == "Door" and report.substate != 0:
            return
        elif self.phase is Phase.STOPPED and report.state in ("Hold", "Door"):
            self._halt(self.reason, now)
        else:
            self._halt(f"the board is in {report.state_text} without a command from here", now)

    def _report_moving(self, report: Report, now: float) -> None:
        if report.state == "Alarm":
            self._to_alarm(LOCKED, now)
        elif (self._pausing or self._resuming) and report.state in ("Idle", "Run", "Hold"):
            self._report_paused(report, now)
        elif report.state in ("Hold", "Door", "Check", "Sleep", "Tool", "Home", "Jog"):
            self._halt(f"the board went to {report.state_text}", now)
        elif report.state == "Idle" and self._goal is not None and self._goal.acknowledged:
            self._arrive(now)

    def _report_paused(self, report: Report, now: float) -> None:
        """Hold until it shows; resume only from a complete hold, for before that GRBL swallows ``~``."""
        if self._pausing:
            if report.state != "Hold" and now - self._hold_sent >= HOLD_REPEAT_S:
                self._hold_sent = now
                self.session.realtime(HOLD)
        elif report.state != "Hold":
            # Just after it the report may be older than the hold that is to be left.
            self._resuming = now - self._hold_sent <= 1.5 * HOLD_REPEAT_S
        elif report.substate == 0:
            self.session.realtime(RESUME)

    def _arrive(self, now: float) -> None:
        goal, here = self._goal, self.reading_m
        if goal is None or here is None:
            return
        self.session.executed_all()
        self._stylus = self._stylus.settled()
        axes = 3 if self.config.stylus.kind == "z_axis" else 2  # where another stylus is no board tells
        error = math.dist(goal.end_m[:axes], here[:axes])
        if error > max(self.config.arrival_tolerance_m, self.config.rounding_m()):
            self._halt(f"the board stands at {_metres(here)} instead of {_metres(goal.end_m)}", now)
            return
        self._enter(Phase.IDLE, now)
        self._finish(Outcome.REACHED, "", now, error)

    def _report_holding(self, report: Report, now: float) -> None:
        self._stood_mm = report.mpos_mm
        if report.state == "Hold" and self._old_holds:
            # Older than the resume, perhaps: a reset now could find the board moving, and lose its position.
            self._old_holds -= 1
            self.session.poll_now()
        elif report.state == "Alarm" and self.homed:
            self._to_alarm(LOCKED, now)
        elif report.state in ("Idle", "Check"):
            # Older than the hold, or a firmware that does not hold while idle: give the hold time to show.
            if now - self._since > 1.5 * HOLD_REPEAT_S:
                self._reset_after_hold(now)
        elif report.state in ("Alarm", "Sleep", "Tool") or report.substate == 0 or report.state_text == "Door:1":
            self._reset_after_hold(now)

    def _report_resetting(self, report: Report, now: float) -> None:
        if self.session.awaiting_banner:
            return
        if report.state == "Hold" or report.state_text == "Door:0":
            self._reset_after_hold(now)
        elif report.state == "Door":
            # Still open: a reset does not leave this state, and nothing may move, not even when it is closed later.
            self._lift, self._lift_barred = False, True
            self._enter(Phase.STOPPED, now, self.reason)
        elif report.state == "Alarm" and self.homed:
            self._to_alarm("the reset left the board locked, its position is lost", now)
        elif self.homed and self._stood_mm and report.mpos_mm and _elsewhere(report.mpos_mm, self._stood_mm):
            # A reset keeps the place; this was a loss of power. Noise spoils one report, hardly two alike.
            found, stood = (", ".join(f"{v:.3f}" for v in place[:3]) for place in (report.mpos_mm, self._stood_mm))
            if self._moved_mm == report.mpos_mm:
                text = f"after the reset the board reports MPos {found} mm instead of {stood} mm, its position is lost"
                self._to_alarm(text, now)
            self._moved_mm = report.mpos_mm
            self.session.poll_now()
        elif report.state in ("Idle", "Alarm"):
            self._after_reset(report, now)

    def _after_reset(self, report: Report, now: float) -> None:
        if not (self._lift and report.state == "Idle" and self.homed and self._stylus_is_down()):
            self._enter(Phase.STOPPED, now, self.reason)
            return
        self._enter(Phase.LIFTING, now, self.reason)
        self._marker_done = False
        config = self.config
        # The board moves no axis faster than its own limit, and what is under way does not know of later parameters.
        speed_m_s = min(config.stylus_feed_m_s, config.machine.max_rate_mm_min[2] / 60_000.0)
        speeding_s = speed_m_s * 1000.0 / config.machine.acceleration_mm_s2[2]
        self._lift_timeout_s = 2.0 + config.stylus.dwell_s + config.stylus_limit_m() / speed_m_s + speeding_s
        for text in lift_lines(self.config):
            self._marker = self.session.queue(text, answer_within_s=self._answer_time()).number

    def _report_lifting(self, report: Report, now: float) -> None:
        if report.state == "Alarm":
            self._to_alarm(LOCKED, now)
        elif report.state == "Idle" and self._marker_done:
            self.session.executed_all()
            self._stylus = Stylus.lifted(self.config.stylus.kind)
            self._enter(Phase.STOPPED, now, self.reason, not_lifted="")
        elif report.state in ("Hold", "Door"):
            # The hold of a stop that was written just before the retreat began must not leave the stylus down.
            self._lift_barred = report.state == "Door"
            self._halt(self.reason, now, lift_again=report.state == "Hold")


def _three(values: Sequence[float]) -> Reading:
    x, y, z = values
    return x, y, z


def _elsewhere(mpos_mm: Sequence[float], place_mm: Sequence[float]) -> bool:
    """Whether a board stands elsewhere, on the axes that both name."""
    return any(abs(a - b) > SAME_PLACE_MM for a, b in zip(mpos_mm, place_mm))


def _metres(reading: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{v:.4f}" for v in reading) + ") m"
