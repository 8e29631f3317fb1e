"""Checks of a running goal by the board's reports: modes, positions at rest, path and time; no I/O and no clock."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.grbl_messages import StatusReport
from gantry_driver.core.grbl.lines import GrblLine
from gantry_driver.core.grbl.modes import ASK_MODES
from gantry_driver.core.grbl.session import FULL_FEED, FULL_SPINDLE, HOLD, RESUME
from gantry_driver.core.grbl.trajectory_gcode import may_be_down_after, reading_m
from gantry_driver.core.machine.stopping import SAME_PLACE_MM, Stopping, elsewhere
from gantry_driver.core.states.machine_states import MachinePhase, Note
from gantry_driver.core.states.stylus_state import Stylus
from gantry_driver.core.wire.faults import MotionFault
from gantry_driver.core.wire.goal import Goal, Reading
from gantry_driver.core.wire.stages import CLEAR_FRAME, FEED_WORD, Confirm
from gantry_driver.core.wire.watch import REPORT_LATE_S, PathWatch
from icu_common.core.goals.results import Outcome
from icu_common.core.reasons.message import Message, quoted

CONFIRM_TRIES = 4
"""Maximum number of times that modes, feed and frame are sent and requested."""
ELSEWHERE_S = 0.1
"""Seconds at rest at another position after which a goal fails: a board starts a move shortly after the line's answer.
"""
OWN_RESET = Message("proof.board_reset_itself_position_lost")
ELSEWHERE = Message("proof.board_stands_elsewhere_without_command")
RESTS = MachinePhase.IDLE, MachinePhase.STOPPED
"""Phases of a homed machine in which the board moves only without a command."""
BEYOND_MM = 0.5
"""Maximum distance beyond the travel in a report: a switch that was adjusted by hand, and rounding."""
FRAME_MM = 0.02
"""Maximum difference between the ordered and the reported frame: one motor step, because lines end between two steps.
"""
SEEN_S = 1.0
"""Maximum age in seconds of a message that the stylus was seen off the panel."""
ASK_EVERY = 20
"""Number of lines after which ``$G`` is sent to a board that does not report its buffers: an answer out of turn shows
that an earlier answer is missing."""
QUEUED_LINES = 600
"""Maximum number of a goal's queued lines: more than any receive buffer holds of the shortest lines."""


class Proving(Stopping):
    """One board whose motion is compared with the sent path."""

    def __init__(self, config: DriverConfig, *, active: bool = True, left_down: bool = False) -> None:
        super().__init__(config, active=active, left_down=left_down)
        self._feed_percent = math.nan
        """Feed override of the board in percent, from the last report that had it."""
        self._stylus_line = 0
        """Number of the last queued line that moves a stylus without a Z axis."""
        self._has_g92: bool | None = None
        """Whether a G92 is in force; None after a reset, because only some firmwares keep it then."""

    @property
    def _axes(self) -> int:
        """Number of axes in reports: no board reports the position of a stylus without a Z axis."""
        return 3 if self.config.stylus.kind == "z_axis" else 2

    def output(self, now: float) -> bytes:
        """Return the bytes to write."""
        if self.phase is MachinePhase.MOVING and self._goal is not None:
            self._queue_more(self._goal)
        # Not with an override below 100 %: an operator has set it, and it must not change.
        self.session.sets_feed_back = self.phase is MachinePhase.MOVING and self._feed_percent == 100.0
        return super().output(now)

    def seen_clear(self, height_m: float, age_s: float) -> None:
        """Note that images show the stylus off the panel; this counts only at rest and without a position."""
        seen = self._stylus.seen_clear(self.config.stylus.kind)
        if seen is self._stylus or age_s > SEEN_S or self.homed or not self.at_rest:
            return
        self._stylus, self._not_lifted = seen, None
        told = Message("proof.cameras_show_stylus_above_panel", height_mm=1000.0 * height_m)
        self._events.append(Note(level="warn", text=told))
        self._say_if_changed()

    def _queue_more(self, goal: Goal) -> None:
        """Queue lines up to a limit, so that a long program starts without delay."""
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

    def _order_stylus(self, line: GrblLine) -> None:
        """Note how a queued line may move the stylus."""
        if self.config.stylus.kind == "z_axis":
            if "Z" in line.text:
                self._stylus = Stylus.UNDER_WAY
        elif (down := may_be_down_after(line.text, self.config)) is not None:
            self._stylus, self._stylus_line = self._stylus.ordered(down), line.number

    def _next_stage(self, goal: Goal, now: float) -> None:
        """Release the lines of the next stage after the proof of the previous one."""
        stage = goal.stage = goal.stages.popleft()
        goal.items = stage.items(self._frame_mm, goal.feed, self.config)
        goal.sent_all, goal.elsewhere_at = False, math.inf
        if stage.start_mm is not None:
            accelerations = self.config.machine.acceleration_mm_s2
            goal.watch = PathWatch.along(stage.start_mm, stage.segments(), self._axes, now, accelerations)

    def _stage_sent(self, goal: Goal) -> bool:
        return goal.sent_all and goal.confirming is None and goal.last_line <= self._acked

    def _modes_answered(self, goal: Goal, now: float) -> None:
        """Check the answer to ``$G``; noise may have damaged order or answer, so try again before the goal fails."""
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
            text = Message(
                "proof.shows_no_after",
                missing=missing,
                lines=quoted(" ".join(item.lines)),
                modes_text=goal.modes_text or "nothing",
            )
            self._fault(MotionFault.MODES_DIFFER, text, now)

    def _confirms_again(self, line: GrblLine, now: float) -> bool:
        """Return whether to resend a rejected line: it only sets or requests modes, so the board has done nothing."""
        goal = self._goal
        if (
            goal is None
            or goal.confirming is None
            or self.phase is not MachinePhase.MOVING
            or goal.tries >= CONFIRM_TRIES - 1
        ):
            return False
        first = goal.confirm_line - len(goal.confirming.lines)
        if not first <= line.number <= goal.confirm_line:
            return False
        if line.number == goal.confirm_line:
            self._modes_answered(goal, now)
        return True

    def _fault(self, code: MotionFault, reason: str, now: float, details: tuple[tuple[str, str], ...] = ()) -> None:
        """Answer the goal with a code, and begin the stop sequence."""
        self._finish(Outcome.ABORTED, reason, now, code=code.value, details=details)
        self._halt(reason, now)
        self._distrusted = code is MotionFault.LEFT_PATH

    def _leaves_path(self, report: StatusReport, now: float) -> bool:
        """Compare a report of a moving board with the path; return whether to ignore the report.

        The first report off the path holds the board, and the next decides: noise damages one report, hardly two.
        """
        goal = self._goal
        if goal is None or goal.watch is None or report.mpos_mm is None or self.phase is not MachinePhase.MOVING:
            return False
        if goal.marks is not None:
            executed_mm = goal.marks.executed_mm(self._acked, self.session.blocks_waiting)
            goal.watch.bound(executed_mm, goal.marks.along_mm(self.session.sent_number))
        raised = max(100.0, self._feed_percent) / 100.0  # max() returns 100 if the other is NaN
        feed_mm_min = None if report.feed_mm_min is None else report.feed_mm_min / raised
        deviation = goal.watch.check(report.mpos_mm, feed_mm_min, now, self.session.report_asked_at)
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
            text = Message("proof.board_left_path", deviation=deviation.text())
            self._fault(MotionFault.LEFT_PATH, text, now, deviation.details())
        return True

    def _check_time(self, now: float) -> None:
        """End a goal that takes too long, because of a damaged feed or coordinate."""
        goal = self._goal
        if goal is None or self.phase is not MachinePhase.MOVING or self._pausing:
            return
        limit_s = goal.limit_s * 100.0 / max(goal.slowest_percent, 1.0)
        if (took_s := now - goal.started - goal.paused_s) > limit_s:
            text = Message("proof.motion_taken_limit_twice_expected", took_s=took_s, limit_s=limit_s)
            details = (("duration_s", f"{took_s:.1f}"), ("limit_s", f"{limit_s:.1f}"))
            self._fault(MotionFault.OVERDUE, text, now, details)

    def _at_rest(self, goal: Goal, report: StatusReport, now: float) -> None:
        """Accept the proof of a stage, or fail the goal once a later report also shows another position."""
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
        return Message(
            "proof.board_stands_instead_off", metres=_metres(here), metres_2=_metres(end_m), error_mm=1000.0 * error_m
        )

    def _frame_is_set(self, goal: Goal, report: StatusReport, now: float) -> bool:
        """Whether the board reports the frame of the path; if it reports another one, order the frame again."""
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
                text = Message("proof.board_reports_work_offset_instead", found_mm=found, wanted_mm=wanted)
                self._fault(MotionFault.MODES_DIFFER, text, now)
            else:
                goal.confirming = goal.frame
                self._queue_confirm(goal, goal.frame)
        return False

    def _arrive(self, goal: Goal, error_m: float, now: float) -> None:
        self.session.executed_all()
        self._stylus = self._stylus.settled()
        self._enter(MachinePhase.IDLE, now)
        self._finish(Outcome.REACHED, "", now, error_m)

    def _strayed(self, report: StatusReport, now: float) -> str:
        """Return why the board cannot be at the position in a report; empty if it can."""
        place, before = report.mpos_mm, self._stood_mm
        if not self.homed or place is None or before is None or self.phase is MachinePhase.RESETTING:
            return ""
        if self.phase in RESTS and report.state == "Idle":
            there = len(place) == len(before) and not elsewhere(place, before)
        else:
            there = self._can_be_at(place, before, now - self._stood_at)
        if there:
            return ""
        return ELSEWHERE if any(place) else OWN_RESET

    def _moves_at_rest(self, report: StatusReport, now: float) -> bool:
        """Return whether a board that should rest reports another position; only the state of the report counts.

        A pendant may move the board, so the report holds the machine at once. It may also be an old report that
        arrives late; the reports of the hold then show the position.
        """
        place, before = report.mpos_mm, self._stood_mm
        if self.phase not in RESTS or not self.homed or place is None or before is None:
            return False
        if report.state == "Idle" or not elsewhere(place, before) or self._moved_mm == place:
            return False
        self._moved_mm, self._moved_at = place, self.session.report_asked_at
        self.session.poll_now()
        self._report_resting(report, now)
        return True

    def _can_be_at(self, place: Sequence[float], before: Sequence[float], after_s: float) -> bool:
        """Whether the axes can have moved from ``before`` to ``place``, and ``place`` is inside the travel."""
        machine, way_s = self.config.machine, after_s + REPORT_LATE_S
        near = all(
            abs(now_mm - was_mm) <= SAME_PLACE_MM + rate * way_s / 60.0
            for now_mm, was_mm, rate in zip(place, before, machine.max_rate_mm_min)
        )
        inside = all(-t - BEYOND_MM <= p <= BEYOND_MM for p, t in zip(place[: self._axes], machine.travel_mm))
        return near and inside and len(place) == len(before)

    def _set_overrides_back(self, now: float, feed: float, _rapid: float, spindle: float) -> None:
        """Reset overrides that a pendant has raised: no touch is faster, and no servo elsewhere, than configured.

        A lower override stays: an operator may slow the machine down.
        """
        rises = feed > self._feed_percent > 100.0
        self._feed_percent = feed
        if rises and self.phase is MachinePhase.MOVING:
            # Each byte that should reset the override arrives as a different one.
            self._halt(Message("proof.board_feed_override_rises_although", feed_percent=feed), now)
        if self._goal is not None:
            self._goal.slowest_percent = min(self._goal.slowest_percent, feed)
        raised = feed > 100.0 or (spindle != 100.0 and self._is_servo())
        if raised:
            self.session.realtime(FULL_FEED)
            self.session.realtime(FULL_SPINDLE)
            if not self._raised:
                told = Message("proof.board_overrides_feed_spindle_set", feed_percent=feed, spindle_percent=spindle)
                self._events.append(Note(level="warn", text=told))
        self._raised = raised


def three(values: Sequence[float]) -> Reading:
    """Return the three values as a position."""
    x, y, z = values
    return x, y, z


def _metres(reading: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{v:.4f}" for v in reading) + ") m"
