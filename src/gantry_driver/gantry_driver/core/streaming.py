"""What the driver follows: a trajectory or a program, checked, streamed, paused, arrived; no I/O and no clock."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

from gantry_driver.core.connection import HOLD_REPEAT_S, Goal, Reading
from gantry_driver.core.gcode_check import Bounds, CheckedLine, GcodeError, ProgramChecker
from gantry_driver.core.grbl_messages import Dialect, Report
from gantry_driver.core.machine_config import DriverConfig
from gantry_driver.core.machine_states import Phase
from gantry_driver.core.session import HOLD, RESUME, Line
from gantry_driver.core.stopping import LOCKED, Stopping
from gantry_driver.core.stylus_state import Stylus
from gantry_driver.core.trajectory_gcode import (
    SYNCHRONISE,
    TrajectoryError,
    Waypoint,
    may_be_down_after,
    mpos_mm,
    reading_m,
    stylus_lines,
    write_motion,
)
from icu_common.core.delays import Delay, ResultCode
from icu_common.core.results import GoalResult, Outcome

QUEUED_LINES = 600
"""Of a goal, ahead of the board: more than the shortest lines that any receive buffer holds."""
PROGRAM_MODES = ("G49", "G0G17G21G40G54G90G94")
"""What a program may rely on at its first line."""


class Streaming(Stopping):
    """One board that follows a goal at a time."""

    def __init__(self, config: DriverConfig, *, active: bool = True) -> None:
        super().__init__(config, active=active)
        self._heartbeat_at = -math.inf
        self.wall_s: float | None = None
        """Wall time, by which the heartbeat is judged where ``now`` is simulated; None: ``now`` is wall time."""
        self._stylus_line = 0
        """The last line queued that moves a stylus without a Z axis."""
        self._has_g92: bool | None = None
        """Whether a program has left a G92; None after a reset, which only some firmwares keep it over."""

    def heartbeat(self, at: float) -> None:
        """Note that the operator was there at ``at``, in wall time."""
        self._heartbeat_at = max(self._heartbeat_at, at)

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
        if not abs(age_s) <= (limit_s := self.config.goal_max_age_s):
            # The sender may send the same path with a new stamp: nothing has moved. One of the future has no code.
            delay = Delay(code=ResultCode.STALE, what="trajectory at the driver", measured_s=age_s, limit_s=limit_s)
            reason = f"stale: its stamp is {age_s:.3f} s old, {limit_s:g} s are allowed"
            stale = GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=reason)
            return self._answer(replace(stale, code=delay.code.value, details=delay.details()) if age_s > 0 else stale)
        try:
            if refusal := self._goal_refusal(now):
                raise TrajectoryError(refusal)
            x, y, z = self.reading_m or (0.0, 0.0, 0.0)
            if self.config.stylus.kind != "z_axis":
                # The reading may be of a moment ago; one without pulses is lifted first.
                z = self.config.stylus.stroke_m if self._stylus_is_down() and not self._stylus.limp() else 0.0
            start = x, y, z
            motion = write_motion(names, points, start, self.config)
        except TrajectoryError as error:
            return self._answer(GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=str(error)))
        timed = ((line, 0.0) for line in motion.lines)
        return self._start(goal_id, text, timed, len(motion.lines), motion.end_m, now)

    def run_program(self, goal_id: str, source: Iterable[str], now: float) -> GoalResult:
        """Check a whole G-code program and start it; or refuse it, with line and column, before a byte is sent."""
        try:
            if refusal := self._goal_refusal(now):
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
            if refusal := self._goal_refusal(now):
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

    def bounds(self) -> Bounds:
        """Return the travel in machine coordinates and the rates of rapid moves."""
        ends = mpos_mm((0.0, 0.0, 0.0), self.config), mpos_mm(self.config.limits_m(), self.config)
        low, high = (_three([pick(pair) for pair in zip(*ends)]) for pick in (min, max))
        return Bounds(low_mm=low, high_mm=high, rapid_mm_min=_three(self.config.machine.max_rate_mm_min))

    # --- what may start ----------------------------------------------------------------------------------------------

    def _goal_refusal(self, now: float) -> str:
        if self.phase is not Phase.IDLE:
            return f"the driver is {self.state_text}"
        return self._permission(now)

    def _permission(self, now: float) -> str:
        if not self.active:
            return "the driver is inactive"
        return "not enabled" if not self.enabled else self._heartbeat_refusal(now)

    def _heartbeat_refusal(self, now: float) -> str:
        age = (now if self.wall_s is None else self.wall_s) - self._heartbeat_at
        if age <= self.config.heartbeat_timeout_s:
            return ""
        if math.isinf(age):
            return "no operator's heartbeat yet"
        return f"operator's heartbeat lost: {age:.2f} s old, {self.config.heartbeat_timeout_s:g} s are allowed"

    def _refuse_program(self, goal_id: str, error: Exception) -> GoalResult:
        return self._answer(GoalResult(goal_id=goal_id, goal="program", outcome=Outcome.REJECTED, reason=str(error)))

    # --- lines, one after the other ----------------------------------------------------------------------------------

    def _start(
        self, goal_id: str, text: str, lines: Iterator[tuple[str, float]], count: int, end_m: Reading, now: float
    ) -> GoalResult:
        """Send ``count`` lines, each with the seconds that its dwell may take, and wait for the last one.

        A servo that may have no pulses is lifted before them: it is neither surely up nor surely down.
        """
        lift = stylus_lines(False, self.config) if self._stylus.limp() else ()
        rest = chain(((line, 0.0) for line in lift), lines)
        self._goal = Goal(goal_id=goal_id, text=text, end_m=end_m, started=now, rest=rest, left=len(lift) + count)
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

    def _order_stylus(self, line: Line) -> None:
        """Note what a line that was queued may do with the stylus."""
        if self.config.stylus.kind == "z_axis":
            if "Z" in line.text:
                self._stylus = Stylus.UNDER_WAY
        elif (down := may_be_down_after(line.text, self.config)) is not None:
            self._stylus, self._stylus_line = self._stylus.ordered(down), line.number

    # --- what the board says meanwhile -------------------------------------------------------------------------------

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


def _three(values: Sequence[float]) -> Reading:
    x, y, z = values
    return x, y, z


def _metres(reading: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{v:.4f}" for v in reading) + ") m"
