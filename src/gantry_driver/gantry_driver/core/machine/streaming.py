"""Trajectories and programs: check, stream, pause and complete them; no I/O and no clock."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.envelope.keeper import Envelope
from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.core.grbl.grbl_messages import Dialect, StatusReport
from gantry_driver.core.grbl.lines import SYNCHRONISE
from gantry_driver.core.grbl.session import HOLD, RESUME
from gantry_driver.core.grbl.trajectory_gcode import (
    TrajectoryError,
    Waypoint,
    mpos_mm,
    reading_m,
    stylus_lines,
    write_motion,
)
from gantry_driver.core.machine.connection import HOLD_REPEAT_S
from gantry_driver.core.machine.proof import Proving, three
from gantry_driver.core.machine.stopping import LOCKED
from gantry_driver.core.program.gcode_check import Bounds, CheckedLine, ProgramChecker
from gantry_driver.core.program.gcode_words import GcodeError
from gantry_driver.core.program.marks import LineMarks
from gantry_driver.core.states.machine_states import MachinePhase, Note
from gantry_driver.core.states.reasons import Reason, Why
from gantry_driver.core.wire.goal import Goal
from gantry_driver.core.wire.stages import DOWN_MM, LINE_S, SURPLUS_S, SendLine, depth_mm, make_script
from gantry_driver.core.wire.watch import PathWatch
from icu_common.core.admission.rivals import RivalTopics
from icu_common.core.goals.intent import Intent
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.processes.delays import Delay, ResultCode
from icu_common.core.reasons.codes import DriverCode
from icu_common.core.reasons.message import Message, joined
from icu_common.core.reasons.state_text import as_message, because, split_state

PROGRAM_MODES = ("G49", "G0G17G21G40G54G90G94")
"""Modes in force at a program's first line."""
_RESTS = frozenset(
    (
        MachinePhase.CLOSED,
        MachinePhase.MISMATCH,
        MachinePhase.UNHOMED,
        MachinePhase.IDLE,
        MachinePhase.STOPPED,
        MachinePhase.ALARM,
    )
)


class Streaming(Proving):
    """One board that follows one goal at a time."""

    def __init__(self, config: DriverConfig, *, active: bool = True, left_down: bool = False) -> None:
        super().__init__(config, active=active, left_down=left_down)
        self._heartbeat_at = -math.inf
        self.wall_s: float | None = None
        """Wall time for the age of the heartbeat where ``now`` is simulated; None: ``now`` is wall time."""
        self._paused_at = 0.0
        self._rivals = RivalTopics()
        self._envelope = Envelope()

    def rivals(self, topic: str, text: str, now: float) -> None:
        """Note the programs that publish a topic meant for one source (empty: only one does); several cause a stop."""
        if self._rivals.take(topic, text):
            self.stop(text, now)
        self._say_if_changed()

    @property
    def state_text(self) -> str:
        """The published state; a stop with another reason also names the conflicts that forbid the next motion."""
        text = super().state_text
        conflicts = self._rivals.besides(str(self.reason)) if self.phase.state == "stopped" else ""
        if not conflicts:
            return text
        name, reason = split_state(text)
        return because(name, joined([reason, conflicts]))

    def panel(self, plane: PanelPlane, age_s: float, now: float) -> str:
        """Accept the panel's plane, only at rest with the stylus up: a path keeps the plane it was checked with."""
        if refusal := self.unrest():
            return refusal
        if text := self._envelope.take(plane, now - max(age_s, 0.0), self.config):
            self._events.append(Note(level="warn", text=text))
        return ""

    def unrest(self) -> str:
        """Return why safety settings must not change now; empty at rest with the stylus up."""
        if self.phase in _RESTS and not self._stylus_is_down():
            return ""
        state = Message("homing.driver", state_text=as_message(self.state_text))
        return joined([state, Message("stylus.down") if self._stylus_is_down() else ""])

    def heartbeat(self, at: float) -> None:
        """Note a heartbeat of the operator at ``at``, in wall time."""
        self._heartbeat_at = max(self._heartbeat_at, at)

    def pause(self, now: float) -> str:
        """Pause a motion with a feed hold; buffered lines stay, as does the stylus, up to ``max_rest_extended_s``."""
        if self.phase is not MachinePhase.MOVING or self._pausing:
            return Message("stream.nothing_pause_driver", state_text=as_message(self.state_text))
        self.session.paused = self._pausing = True
        self._resuming = False
        self._hold_sent = self._paused_at = now
        self.session.realtime(HOLD)
        self._enter(MachinePhase.MOVING, now, "paused")
        return ""

    @property
    def paused(self) -> bool:
        """Whether a motion is paused, or its pause has begun."""
        return self.phase is MachinePhase.MOVING and self._pausing

    def resume(self, now: float) -> str:
        """Resume a paused motion."""
        if self.phase is not MachinePhase.MOVING or not self._pausing:
            return Message("stream.nothing_resume_driver", state_text=as_message(self.state_text))
        if refusal := self._permission(now):
            return refusal
        self._pausing, self._resuming = False, True
        self.session.paused = False
        assert self._goal is not None  # every motion has a goal
        self._goal.paused_s += now - self._paused_at
        self._enter(MachinePhase.MOVING, now)
        return ""

    def run(
        self,
        goal_id: str,
        names: Sequence[str],
        points: Sequence[Waypoint],
        *,
        age_s: float,
        now: float,
        distrust: str = "",
        intent: Intent = Intent.PRESS,
    ) -> GoalResult:
        """Start or reject a trajectory; the answer is returned and is also among the events.

        Parameters
        ----------
        goal_id
            Returned in the answers.
        names, points
            The trajectory's joints and points, readings in metres.
        age_s
            Age of the trajectory's stamp; 0 for "now".
        distrust
            Reason to doubt that the sender may move the machine; empty for none.
        intent
            Intent of the trajectory, which decides how it may use the space at the panel.
        """
        text = Message("guard.points", points=len(points))
        if points:
            text = Message("guard.points_to", points=len(points), place=tuple(points[-1].positions_m))
        if not abs(age_s) <= (limit_s := self.config.goal_max_age_s):
            # Nothing has moved, so the code allows the sender to send the path again with a new stamp. A stamp in the
            # future gets no code.
            delay = Delay(
                code=ResultCode.STALE, what=Message("stream.trajectory_driver"), measured_s=age_s, limit_s=limit_s
            )
            reason = Message("stream.stale_stamp_old_allowed", age_s=age_s, limit_s=limit_s)
            stale = GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=reason)
            return self._answer(replace(stale, code=delay.code.value, details=delay.details()) if age_s > 0 else stale)
        try:
            if refusal := self._rivals.text or distrust or self._goal_refusal(now):
                raise TrajectoryError(refusal)
            x, y, z = self.reading_m or (0.0, 0.0, 0.0)
            if self.config.stylus.kind != "z_axis":
                # The reading may be slightly old; a servo without pulses is lifted first.
                z = self.config.stylus.stroke_m if self._stylus_is_down() and not self._stylus.limp() else 0.0
            start = x, y, z
            motion = write_motion(names, points, start, self.config)
        except TrajectoryError as error:
            return self._answer(GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=str(error)))
        if breach := self._envelope.breach(motion, start, intent, self.config, now):
            refused = GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=breach.text())
            return self._answer(replace(refused, code=breach.code.value, details=breach.details()))
        # On firmwares other than GRBL a frame outlasts a reset, so it would outlast a stop as well.
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
        goal.stages[0].head[:0] = [SendLine(text=line) for line in self._limp_lift()]
        self._next_stage(goal, now)
        return self._start(goal, now)

    def run_program(self, goal_id: str, source: Iterable[str], now: float) -> GoalResult:
        """Check a whole G-code program and start it, or reject it with line and column before a byte is sent."""
        try:
            if refusal := self._goal_refusal(now):
                raise TrajectoryError(refusal)
            checker = self.program_checker()
            checked = list(checker.check_all(source))
        except (TrajectoryError, GcodeError) as error:
            return self._refuse_program(goal_id, error)
        return self.run_checked(goal_id, checker, checked, now)

    def program_checker(self) -> ProgramChecker:
        """Return the checker of a program that starts at the current position.

        Raises
        ------
        TrajectoryError
            While the board's work offset is unknown, or only one report has shown it.
        """
        if self.session.wco_mm is None:
            raise TrajectoryError(Message("stream.board_not_told_work_offset"))
        if not self.session.wco_is_sure:
            raise TrajectoryError(Message("stream.board_not_told_work_offset_2"))
        bounds, start = self.bounds(), mpos_mm(self.reading_m or (0.0, 0.0, 0.0), self.config)
        inside = [min(max(place, low), high) for place, low, high in zip(start, bounds.low_mm, bounds.high_mm)]
        steps_mm = (1.0 / scale for scale in self.config.machine.steps_per_mm)
        # At its end an axis reports the nearest motor step, which may be beyond the end.
        start = three([i if abs(i - place) < step else place for i, place, step in zip(inside, start, steps_mm)])
        kept_g92 = self.dialect is not Dialect.GRBL if self._has_g92 is None else self._has_g92
        return ProgramChecker(
            bounds, start, {"G54": three(self.session.wco_mm[:3])}, kept_g92=kept_g92, axes=self._axes
        )

    def run_checked(
        self, goal_id: str, checker: ProgramChecker, checked: Sequence[CheckedLine], now: float
    ) -> GoalResult:
        """Start a program that :meth:`program_checker` has passed; checking a long one takes seconds."""
        try:
            if refusal := self._goal_refusal(now):
                raise TrajectoryError(refusal)
            if self.program_checker().begins != checker.begins:
                raise TrajectoryError(Message("stream.place_work_offset_changed_since"))
        except TrajectoryError as error:
            return self._refuse_program(goal_id, error)
        text = Message("stream.program_lines_about", checked=len(checked), seconds_s=checker.seconds)
        end = reading_m(checker.position_mm, False, self.config)
        # The checker starts with these modes; the board may have been left in others.
        modes = (SendLine(text=mode) for mode in (*self._limp_lift(), *PROGRAM_MODES))
        lines = (SendLine(text=line.text, dwell_s=line.seconds, along_mm=line.along_mm) for line in checked)
        goal = Goal(
            goal_id=goal_id,
            text=text,
            end_m=end,
            started=now,
            items=chain(modes, lines, [SendLine(text=SYNCHRONISE)]),
            limit_s=2.0 * (checker.seconds + LINE_S * len(checked)) + SURPLUS_S,
            touching=self._axes == 3 and max(depth_mm(p, self.config) for p in checker.path.points) > DOWN_MM,
            watch=PathWatch(checker.path, now, self.config.machine.acceleration_mm_s2),
            marks=LineMarks(),
        )
        return self._start(goal, now)

    def bounds(self) -> Bounds:
        """Return the travel in machine coordinates and the rates of rapid moves."""
        ends = mpos_mm((0.0, 0.0, 0.0), self.config), mpos_mm(self.config.limits_m(), self.config)
        low, high = (three([pick(pair) for pair in zip(*ends)]) for pick in (min, max))
        return Bounds(low_mm=low, high_mm=high, rapid_mm_min=three(self.config.machine.max_rate_mm_min))

    # --- permission to start -----------------------------------------------------------------------------------------

    def _goal_refusal(self, now: float) -> str:
        if self.phase is not MachinePhase.IDLE:
            return Message("homing.driver", state_text=as_message(self.state_text))
        return self._permission(now)

    def _permission(self, now: float) -> str:
        if not self.active:
            return Message("stream.driver_inactive")
        if text := self._rivals.text:
            return text
        return Message("hold.not_enabled") if not self.enabled else str(self._heartbeat_refusal(now))

    def _heartbeat_refusal(self, now: float) -> Why:
        age = (now if self.wall_s is None else self.wall_s) - self._heartbeat_at
        if age <= self.config.heartbeat_timeout_s:
            return ""
        if math.isinf(age):
            return Message("stream.no_operator_heartbeat_yet")
        text = Message(
            "stream.operator_heartbeat_lost_old_allowed", age_s=age, heartbeat_timeout_s=self.config.heartbeat_timeout_s
        )
        return Reason(code=DriverCode.HEARTBEAT_LOST, text=text)

    def _refuse_program(self, goal_id: str, error: Exception) -> GoalResult:
        return self._answer(GoalResult(goal_id=goal_id, goal="program", outcome=Outcome.REJECTED, reason=str(error)))

    def _limp_lift(self) -> tuple[str, ...]:
        """Return the lines that lift a servo that may have no pulses, and so may be up or down."""
        return stylus_lines(False, self.config) if self._stylus.limp() else ()

    def _start(self, goal: Goal, now: float) -> GoalResult:
        self._goal = goal
        accepted = self._answer(GoalResult(goal_id=goal.goal_id, goal=goal.text, outcome=Outcome.ACCEPTED))
        self._enter(MachinePhase.MOVING, now)
        return accepted

    def _report_moving(self, report: StatusReport, now: float) -> None:
        goal = self._goal
        if report.state == "Alarm":
            self._to_alarm(LOCKED, now)
        elif (self._pausing or self._resuming) and report.state in ("Idle", "Run", "Hold"):
            self._report_paused(report, now)
        elif report.state in ("Hold", "Door", "Check", "Sleep", "Tool", "Home", "Jog"):
            self._halt(Message("stream.board_went", state_text=report.state_text), now)
        elif report.state == "Idle" and goal is not None and self._stage_sent(goal):
            self._at_rest(goal, report, now)

    def _report_paused(self, report: StatusReport, now: float) -> None:
        """Repeat the hold until a report shows it; resume only from a complete hold: before, GRBL discards ``~``."""
        if self._pausing:
            if report.state != "Hold" and now - self._hold_sent >= HOLD_REPEAT_S:
                self._hold_sent = now
                self.session.realtime(HOLD)
        elif report.state != "Hold":
            # Just after the hold was sent, the report may be older than the hold.
            self._resuming = now - self._hold_sent <= 1.5 * HOLD_REPEAT_S
        elif report.substate == 0:
            self.session.realtime(RESUME)
