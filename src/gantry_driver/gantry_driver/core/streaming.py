"""What the driver follows: a trajectory or a program, checked, streamed, paused, arrived; no I/O and no clock."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
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
from gantry_driver.core.wire.faults import MotionFault
from gantry_driver.core.wire.modes import ASK_MODES
from gantry_driver.core.wire.stages import CLEAR_FRAME, FEED_WORD, LINE_S, SURPLUS_S, Confirm, Send, make_script
from gantry_driver.core.wire.watch import PathWatch
from icu_common.core.delays import Delay, ResultCode
from icu_common.core.results import GoalResult, Outcome

CONFIRM_TRIES = 4
"""Number of times that modes, feed and frame are sent and asked for."""
ELSEWHERE_S = 0.1
"""Seconds for which a board must be at rest elsewhere: it starts a move a moment after it has acknowledged the line."""
FRAME_MM = 0.02
"""Largest difference between the frame and the reported one: a motor step, for lines end between two of them."""
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
        self._feed_percent = 100.0
        """The board's feed override in the last report that had it."""
        self._stylus_line = 0
        """The last line queued that moves a stylus without a Z axis."""
        self._paused_at = 0.0
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
        self._hold_sent = self._paused_at = now
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
        if self._goal is not None:
            self._goal.paused_s += now - self._paused_at
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
        # A frame that outlasts a reset, as on others than GRBL, would outlast a stop as well.
        framed = self.dialect is Dialect.GRBL and self.session.tells_mpos
        script = make_script(motion, self.config, framed=framed, frame_mm=self._frame_mm)
        goal = Goal(
            goal_id=goal_id,
            text=text,
            end_m=motion.end_m,
            started=now,
            items=iter(()),
            stages=deque(script.stages),
            origin_mm=script.origin_mm,
            limit_s=script.limit_s,
            touching=any(stage.touching or stage.frame for stage in script.stages),
        )
        goal.stages[0].head[:0] = [Send(text=line) for line in self._limp_lift()]
        self._next_stage(goal, now)
        return self._start(goal, now)

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
        modes = (Send(text=mode) for mode in (*self._limp_lift(), *PROGRAM_MODES))
        lines = (Send(text=line.text, dwell_s=line.seconds) for line in checked)
        items = chain(modes, lines, [Send(text=SYNCHRONISE)])
        limit_s = 2.0 * (checker.seconds + LINE_S * len(checked)) + SURPLUS_S
        return self._start(Goal(goal_id=goal_id, text=text, end_m=end, started=now, items=items, limit_s=limit_s), now)

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

    def _limp_lift(self) -> tuple[str, ...]:
        """Return what lifts a servo that may have no pulses: it is neither surely up nor surely down."""
        return stylus_lines(False, self.config) if self._stylus.limp() else ()

    def _start(self, goal: Goal, now: float) -> GoalResult:
        self._goal = goal
        accepted = self._answer(GoalResult(goal_id=goal.goal_id, goal=goal.text, outcome=Outcome.ACCEPTED))
        self._enter(Phase.MOVING, now)
        return accepted

    def output(self, now: float) -> bytes:
        """Return the bytes to write."""
        if self.phase is Phase.MOVING and self._goal is not None:
            self._queue_more(self._goal)
        return super().output(now)

    def _queue_more(self, goal: Goal) -> None:
        """Queue lines while they are few, so that the start of a long program keeps nobody waiting."""
        while not (goal.sent_all or goal.confirming) and self.session.unsent < QUEUED_LINES:
            item = next(goal.items, None)
            if item is None:
                goal.sent_all = True
            elif isinstance(item, Confirm):
                goal.confirming, goal.tries = item, 0
                goal.frame = item if "G92" in item.lines[0] else goal.frame
                self._queue_confirm(goal, item)
            else:
                self._queue_line(goal, item.text, item.dwell_s)

    def _queue_confirm(self, goal: Goal, item: Confirm) -> None:
        for text in item.lines:
            self._queue_line(goal, text, 0.0)
        goal.modes_text = ""
        self._queue_line(goal, ASK_MODES, 0.0)
        goal.confirm_line = goal.last_line

    def _queue_line(self, goal: Goal, text: str, seconds: float) -> None:
        if "G92" in text:
            self._has_g92 = CLEAR_FRAME not in text
            self._frame_mm = None
        if match := FEED_WORD.match(text):
            goal.feed = match[1]
        line = self.session.queue(text, answer_within_s=self._answer_time() + seconds)
        self._order_stylus(line)
        goal.last_line = line.number

    def _order_stylus(self, line: Line) -> None:
        """Note what a line that was queued may do with the stylus."""
        if self.config.stylus.kind == "z_axis":
            if "Z" in line.text:
                self._stylus = Stylus.UNDER_WAY
        elif (down := may_be_down_after(line.text, self.config)) is not None:
            self._stylus, self._stylus_line = self._stylus.ordered(down), line.number

    # --- proof -------------------------------------------------------------------------------------------------------

    def _next_stage(self, goal: Goal, now: float) -> None:
        """Release the lines of the next stage; the one before is proved."""
        stage = goal.stage = goal.stages.popleft()
        goal.items = stage.items(self._frame_mm, goal.feed, self.config)
        goal.sent_all, goal.elsewhere_at = False, math.inf
        if stage.start_mm is not None:
            axes = 3 if self.config.stylus.kind == "z_axis" else 2
            goal.watch = PathWatch(stage.start_mm, stage.segments(), axes, now)

    def _stage_sent(self, goal: Goal) -> bool:
        return goal.sent_all and goal.confirming is None and goal.last_line <= self._acked

    def _modes_answered(self, goal: Goal, now: float) -> None:
        """Compare what ``$G`` has said; noise may have spoilt order or answer, so try again before giving up."""
        item = goal.confirming
        if item is None:
            return
        missing = item.modes.missing(goal.modes_text)
        goal.tries += 1
        if not missing:
            goal.confirming = None
        elif goal.tries < CONFIRM_TRIES:
            self._queue_confirm(goal, item)
        else:
            text = f"$G shows no {missing} after {' '.join(item.lines)!r}: {goal.modes_text or 'nothing'}"
            self._fault(MotionFault.MODES_DIFFER, text, now)

    def _fault(self, code: MotionFault, reason: str, now: float, details: tuple[tuple[str, str], ...] = ()) -> None:
        """Answer the goal with a code, and begin the way down."""
        self._finish(Outcome.ABORTED, reason, now, code=code.value, details=details)
        self._halt(reason, now)
        self._distrusted = code is MotionFault.LEFT_PATH

    def _leaves_path(self, report: Report, now: float) -> bool:
        """Compare a report of a moving board with the path; return whether it is not to be believed.

        The first report beside the path holds the board. The next decides: noise spoils one report, hardly two.
        """
        goal = self._goal
        if goal is None or goal.watch is None or report.mpos_mm is None or self.phase is not Phase.MOVING:
            return False
        raised = max(self._feed_percent, 100.0) / 100.0
        deviation = goal.watch.check(report.mpos_mm, (report.feed_mm_min or 0.0) / raised, now)
        if deviation is None:
            if goal.doubt is not None:
                goal.doubt = None
                if not self._pausing:
                    self.session.paused, self._resuming = False, True
                    self._hold_sent = now
            return False
        self.session.poll_now()
        if goal.doubt is None:
            goal.doubt, self._hold_sent = deviation, now
            self.session.paused = True
            self.session.withdraw(RESUME)
            self.session.realtime(HOLD)
        else:
            text = f"the board left the path: {deviation.text()}"
            self._fault(MotionFault.LEFT_PATH, text, now, deviation.details())
        return True

    def _check_time(self, now: float) -> None:
        """End a goal that takes too long, by a feed or a coordinate that is not the one sent."""
        goal = self._goal
        if goal is None or self.phase is not Phase.MOVING or self._pausing:
            return
        limit_s = goal.limit_s * 100.0 / max(goal.slowest_percent, 1.0)
        if (took_s := now - goal.started - goal.paused_s) > limit_s:
            text = f"the motion has taken {took_s:.1f} s (limit {limit_s:.1f} s, twice the expected time)"
            details = (("duration_s", f"{took_s:.1f}"), ("limit_s", f"{limit_s:.1f}"))
            self._fault(MotionFault.OVERDUE, text, now, details)

    # --- what the board says meanwhile -------------------------------------------------------------------------------

    def _report_moving(self, report: Report, now: float) -> None:
        goal = self._goal
        if report.state == "Alarm":
            self._to_alarm(LOCKED, now)
        elif (self._pausing or self._resuming) and report.state in ("Idle", "Run", "Hold"):
            self._report_paused(report, now)
        elif report.state in ("Hold", "Door", "Check", "Sleep", "Tool", "Home", "Jog"):
            self._halt(f"the board went to {report.state_text}", now)
        elif report.state == "Idle" and goal is not None and self._stage_sent(goal):
            self._at_rest(goal, report, now)

    def _at_rest(self, goal: Goal, report: Report, now: float) -> None:
        """Take the proof of a stage, or wait for a second report that says that there is none."""
        here = self.reading_m
        if here is None or report.mpos_mm is None:
            return
        tolerance_m = max(self.config.arrival_tolerance_m, self.config.rounding_m())
        axes = 3 if self.config.stylus.kind == "z_axis" else 2  # where another stylus is no board tells
        error_m = math.dist(goal.end_m[:axes], here[:axes])
        if goal.stages and goal.watch is not None:
            error_m = goal.watch.off_end_mm(report.mpos_mm) / 1000.0
        if error_m > tolerance_m:
            goal.elsewhere_at = min(goal.elsewhere_at, now)
            self.session.poll_now()
            if now - goal.elsewhere_at >= ELSEWHERE_S:
                self._fault(MotionFault.TOUCH_UNPROVED, self._unproved_text(goal, here, error_m), now)
        elif not goal.stages:
            self._arrive(goal, error_m, now)
        elif not goal.stages[0].frame or self._frame_is_set(goal, report, now):
            self._next_stage(goal, now)

    def _unproved_text(self, goal: Goal, here: Reading, error_m: float) -> str:
        end_m = goal.end_m
        if goal.stages and goal.stage.end_mm is not None:
            end_m = reading_m(goal.stage.end_mm, self._stylus_is_down(), self.config)
        return f"the board stands at {_metres(here)} instead of {_metres(end_m)}, {1000.0 * error_m:.2f} mm off"

    def _frame_is_set(self, goal: Goal, report: Report, now: float) -> bool:
        """Whether the board reports the frame of the path; if it reports another, order it again."""
        offset, origin = self.session.wco_mm, goal.origin_mm
        if origin is None:
            return True
        if offset is not None and all(abs(o - f) <= FRAME_MM for o, f in zip(offset, origin)):
            self._frame_mm = _three(offset[:3])
            return True
        self.session.poll_now()
        if report.wco_mm is not None:
            goal.tries += 1
            if goal.frame is None or goal.tries >= CONFIRM_TRIES:
                found = "none" if offset is None else ", ".join(f"{v:.3f}" for v in offset[:3])
                wanted = ", ".join(f"{v:.3f}" for v in origin)
                text = f"the board reports the work offset {found} mm instead of {wanted} mm"
                self._fault(MotionFault.MODES_DIFFER, text, now)
            else:
                goal.confirming = goal.frame
                self._queue_confirm(goal, goal.frame)
        return False

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

    def _arrive(self, goal: Goal, error_m: float, now: float) -> None:
        self.session.executed_all()
        self._stylus = self._stylus.settled()
        self._enter(Phase.IDLE, now)
        self._finish(Outcome.REACHED, "", now, error_m)


def _three(values: Sequence[float]) -> Reading:
    x, y, z = values
    return x, y, z


def _metres(reading: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{v:.4f}" for v in reading) + ") m"
