"""What a goal must prove while it runs: modes, places at rest, path and time; no I/O and no clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gantry_driver.core.grbl_messages import Report
from gantry_driver.core.machine_config import DriverConfig
from gantry_driver.core.machine_states import Note, Phase
from gantry_driver.core.session import FULL_FEED, FULL_SPINDLE, HOLD, RESUME, Line
from gantry_driver.core.stopping import SAME_PLACE_MM, Stopping, elsewhere
from gantry_driver.core.stylus_state import Stylus
from gantry_driver.core.trajectory_gcode import may_be_down_after, reading_m
from gantry_driver.core.wire.faults import MotionFault
from gantry_driver.core.wire.goal import Goal, Reading
from gantry_driver.core.wire.modes import ASK_MODES
from gantry_driver.core.wire.stages import CLEAR_FRAME, FEED_WORD, Confirm
from gantry_driver.core.wire.watch import REPORT_LATE_S, PathWatch
from icu_common.core.results import Outcome

CONFIRM_TRIES = 4
"""Number of times that modes, feed and frame are sent and asked for."""
ELSEWHERE_S = 0.1
"""Seconds for which a board must be at rest elsewhere: it starts a move a moment after it has acknowledged the line."""
OWN_RESET = "the board was reset by itself, its position is lost"
ELSEWHERE = "the board stands elsewhere without a command from here, its position is lost"
BEYOND_MM = 0.5
"""Distance beyond the travel that a report may show: a switch that was set by hand, and rounding."""
FRAME_MM = 0.02
"""Largest difference between the frame and the reported one: a motor step, for lines end between two of them."""
SEEN_S = 1.0
"""Maximum age of a message that the stylus was seen off the panel."""
ASK_EVERY = 20
"""Lines after which ``$G`` is sent to a board that does not report its buffers: answered out of turn, it shows that an
answer before it is missing."""
QUEUED_LINES = 600
"""Of a goal, ahead of the board: more than the shortest lines that any receive buffer holds."""


class Proving(Stopping):
    """One board whose motion is compared with what it was sent."""

    def __init__(self, config: DriverConfig, *, active: bool = True, left_down: bool = False) -> None:
        super().__init__(config, active=active, left_down=left_down)
        self._feed_percent = math.nan
        """The board's feed override in the last report that had it."""
        self._stylus_line = 0
        """The last line queued that moves a stylus without a Z axis."""
        self._has_g92: bool | None = None
        """Whether a G92 is in force; None after a reset, which only some firmwares keep it over."""

    @property
    def _axes(self) -> int:
        """Number of axes that reports show: where another stylus is no board tells."""
        return 3 if self.config.stylus.kind == "z_axis" else 2

    def output(self, now: float) -> bytes:
        """Return the bytes to write."""
        if self.phase is Phase.MOVING and self._goal is not None:
            self._queue_more(self._goal)
        # Not with an override below 100 %: an operator has set it, and it must stay.
        self.session.sets_feed_back = self.phase is Phase.MOVING and self._feed_percent == 100.0
        return super().output(now)

    def seen_clear(self, height_m: float, age_s: float) -> None:
        """Note that images show the stylus off the panel; this counts only at rest and without a position."""
        seen = self._stylus.seen_clear(self.config.stylus.kind)
        if seen is self._stylus or age_s > SEEN_S or self.homed or not self.at_rest:
            return
        self._stylus, self._not_lifted = seen, None
        told = f"the cameras show the stylus {1000.0 * height_m:.1f} mm above the panel: it presses nothing"
        self._events.append(Note(level="warn", text=told))
        self._say_if_changed()

    def _queue_more(self, goal: Goal) -> None:
        """Queue lines up to a limit, so that a long program starts at once."""
        while not (goal.sent_all or goal.confirming) and self.session.unsent < QUEUED_LINES:
            if goal.unasked >= ASK_EVERY and not self.session.tells_buffers:
                goal.unasked = 0
                self._queue_line(goal, ASK_MODES, 0.0)
            item = next(goal.items, None)
            if item is None:
                goal.sent_all = True
            elif isinstance(item, Confirm):
                goal.confirming, goal.tries = item, 0
                goal.frame = item if "G92" in item.lines[0] else goal.frame
                self._queue_confirm(goal, item)
            else:
                self._queue_line(goal, item.text, item.dwell_s)
                goal.unasked += 1
                if goal.marks is not None and item.along_mm is not None:
                    goal.marks.append(goal.last_line, item.along_mm)

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

    def _next_stage(self, goal: Goal, now: float) -> None:
        """Release the lines of the next stage; the one before is proved."""
        stage = goal.stage = goal.stages.popleft()
        goal.items = stage.items(self._frame_mm, goal.feed, self.config)
        goal.sent_all, goal.elsewhere_at = False, math.inf
        if stage.start_mm is not None:
            goal.watch = PathWatch.along(stage.start_mm, stage.segments(), self._axes, now)

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

    def _confirms_again(self, line: Line, now: float) -> bool:
        """Return whether to resend a rejected line: it only sets or requests modes, so the board has done nothing."""
        goal = self._goal
        if goal is None or goal.confirming is None or self.phase is not Phase.MOVING or goal.tries >= CONFIRM_TRIES - 1:
            return False
        first = goal.confirm_line - len(goal.confirming.lines)
        if not first <= line.number <= goal.confirm_line:
            return False
        if line.number == goal.confirm_line:
            self._modes_answered(goal, now)
        return True

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
        if goal.marks is not None:
            executed_mm = goal.marks.executed_mm(self._acked, self.session.blocks_waiting)
            goal.watch.bound(executed_mm, goal.marks.along_mm(self.session.sent_number))
        raised = max(100.0, self._feed_percent) / 100.0  # max() returns 100 if the other is NaN
        deviation = goal.watch.check(
            report.mpos_mm, (report.feed_mm_min or 0.0) / raised, now, self.session.report_asked_at
        )
        if deviation is None and goal.watch.early:
            self.session.poll_now()
            return True
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

    def _at_rest(self, goal: Goal, report: Report, now: float) -> None:
        """Take the proof of a stage, or wait for a second report that says that there is none."""
        here = self.reading_m
        if here is None or report.mpos_mm is None:
            return
        tolerance_m = max(self.config.arrival_tolerance_m, self.config.rounding_m())
        error_m = math.dist(goal.end_m[: self._axes], here[: self._axes])
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
            self._frame_mm = three(offset[:3])
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

    def _arrive(self, goal: Goal, error_m: float, now: float) -> None:
        self.session.executed_all()
        self._stylus = self._stylus.settled()
        self._enter(Phase.IDLE, now)
        self._finish(Outcome.REACHED, "", now, error_m)

    def _strayed(self, report: Report, now: float) -> str:
        """Return why the place that a report tells is none where the board can have gone; empty if it can."""
        place, before = report.mpos_mm, self._stood_mm
        if not self.homed or place is None or before is None or self.phase is Phase.RESETTING:
            return ""
        if self.phase in (Phase.IDLE, Phase.STOPPED) and report.state == "Idle":
            there = len(place) == len(before) and not elsewhere(place, before)
        else:
            there = self._can_be_at(place, before, now - self._stood_at)
        if there:
            return ""
        return ELSEWHERE if any(place) else OWN_RESET

    def _can_be_at(self, place: Sequence[float], before: Sequence[float], after_s: float) -> bool:
        """Whether the axes can have gone from one place to the other, and neither lies outside the travel."""
        machine, way_s = self.config.machine, after_s + REPORT_LATE_S
        near = all(
            abs(now_mm - was_mm) <= SAME_PLACE_MM + rate * way_s / 60.0
            for now_mm, was_mm, rate in zip(place, before, machine.max_rate_mm_min)
        )
        inside = all(-t - BEYOND_MM <= p <= BEYOND_MM for p, t in zip(place[: self._axes], machine.travel_mm))
        return near and inside and len(place) == len(before)

    def _set_overrides_back(self, now: float, feed: float, _rapid: float, spindle: float) -> None:
        """End what a pendant has raised: no touch is faster, and no servo elsewhere, than it is configured.

        A lower override stays: an operator may slow the machine down.
        """
        rises = feed > self._feed_percent > 100.0
        self._feed_percent = feed
        if rises and self.phase is Phase.MOVING:
            # What is to set it back arrives as something else, each time.
            self._halt(f"the board's feed override rises to {feed:g} % although it is set back", now)
        if self._goal is not None:
            self._goal.slowest_percent = min(self._goal.slowest_percent, feed)
        raised = feed > 100.0 or (spindle != 100.0 and self._is_servo())
        if raised:
            self.session.realtime(FULL_FEED)
            self.session.realtime(FULL_SPINDLE)
            if not self._raised:
                told = f"the board's overrides were {feed:g} % (feed) and {spindle:g} % (spindle): set back to 100 %"
                self._events.append(Note(level="warn", text=told))
        self._raised = raised


def three(values: Sequence[float]) -> Reading:
    """Return the first three values as a place."""
    x, y, z = values
    return x, y, z


def _metres(reading: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{v:.4f}" for v in reading) + ") m"
