"""The goal in progress: the motion and the look that its phase waits for, and its end; no ROS, no clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gantry_driver.core.contact.memory import HeightMemory
from gantry_driver.core.contact.switch import StylusSwitch
from gantry_driver.core.goals.obstacles import first_delay
from gantry_driver.core.goals.servo import NO_LOOK, Look
from gantry_driver.core.goals.world import EXTENDED_M, World
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import (
    FREE_VIEW,
    MOVING,
    NANO,
    PUSHING,
    STANDING,
    UP,
    WAITING,
    Fault,
    Job,
    Phase,
    Step,
    intent_in,
)
from gantry_driver.core.job.patience import next_limit_s, since
from gantry_driver.core.motion import motion_plan
from gantry_driver.core.motion.motion_plan import OutOfReach, Path
from gantry_driver.core.sight.tip_noise import TipNoise
from icu_common.core.alignment.findings import Cause
from icu_common.core.geometry.geometry import Array
from icu_common.core.goals.intent import Intent
from icu_common.core.goals.results import Outcome
from icu_common.core.processes.delays import Delay, ResultCode
from icu_common.core.reasons.codes import STOP_ASKED, ControllerCode
from icu_common.core.reasons.message import Message

UNWATCHED_S = 1.2
"""Maximum age of the newest image that the stylus tracker has evaluated while the stylus touches. A touch without new
images must end within 2 s, the time to lift included."""
LONGER_S = 0.1
"""Seconds beyond ``press_max_s`` after which the age of images counts: those of a press may come while it lifts."""


class GoalRun:
    """One goal at a time, and the actions that it has requested."""

    def __init__(self, config: ControllerConfig) -> None:
        self.config = config
        self.heights = HeightMemory(config.contact)
        self.tips = TipNoise(height_m=config.contact.height.look_sigma_m, across_m=config.touch_error.across_sigma_m)
        self.switch = StylusSwitch()
        self.phase = Phase.IDLE
        self.counts = dict.fromkeys(Outcome, 0)
        self._world = World()
        self._job: Job | None = None
        self._actions: list[msg.Action] = []
        self._state = ""
        self.code = ControllerCode.WORKING
        """Code of the state's reason."""
        self._closed = False
        self._now_ns = 0
        self._deadline_ns = 0
        self._stamp_ns = 0
        self._phase_ns = 0
        self._end: Array | None = None
        self._entered_xy: Array | None = None
        """Readings x, y at the end of the last goal that was a move; None after any other motion across."""
        self._arrived_ns: int | None = None
        self._tip_look = self._rest_look = NO_LOOK
        self._asked_ns = 0
        self._base_s = self._limit_s = self._moved_s = 0.0
        self._path: Path | None = None
        self._sent = 0
        self._late: Delay | None = None
        """Input that was late when the phase timed out."""
        self._reported: set[str] = set()

    # The motion and the look that a phase waits for

    def _enter(self, phase: Phase, within_s: float) -> None:
        self.phase, self._phase_ns = phase, self._now_ns
        self._deadline_ns = self._now_ns + nanoseconds(within_s)
        self._base_s, self._limit_s, self._moved_s = within_s, within_s, 0.0
        self._late = None

    def _move_deadline(self, gap_s: float) -> None:
        """Extend a phase by the hold-up of the controller: the awaited message may be in the queue.

        A contact is never extended, and no phase lasts more than twice its time, however often hold-ups occur.
        """
        if self.phase is Phase.CONTACT:
            return
        gap_s = min(gap_s, self._base_s - self._moved_s)
        self._moved_s += gap_s
        self._deadline_ns += nanoseconds(gap_s)

    def _go(self, phase: Phase, path: Path) -> None:
        self._entered_xy = None
        self._enter(phase, 1.5 * path.duration_s + self.config.motion_timeout_s)
        # Stamps identify trajectories, so those of two trajectories at the same time must differ.
        self._stamp_ns = max(self._now_ns, self._stamp_ns + 1)
        if len(path.points):
            self._end, self._arrived_ns = path.points[-1], None
            self._path, self._sent = path, 1
            self._send(path)
        else:
            # The machine is already there; newer joint_states confirm it.
            self._end, self._arrived_ns = self._world.here, self._now_ns

    def _send_again(self, job: Job, delay: Delay) -> bool:
        """Send the path again if the driver rejected it only because it came late; return False if it may not be sent.

        The machine has not moved, so the path still starts at the machine's position.
        """
        if self._path is None or job.touched_ns or self._sent >= self.config.slow_tries:
            return False
        self._sent += 1
        then = Message("goal.sent_again_try", sent=self._sent, slow_tries=self.config.slow_tries)
        self._actions.append(msg.ReportDelay(delay=delay, then=then))
        self._enter(self.phase, 1.5 * self._path.duration_s + self.config.motion_timeout_s)
        self._stamp_ns = max(self._now_ns, self._stamp_ns + 1)
        self._send(self._path)
        return True

    def _send(self, path: Path) -> None:
        intent = Intent.MOVE if self._job is None else intent_in(self.phase, self._job.kind)
        self._actions.append(msg.SendTrajectory(stamp_ns=self._stamp_ns, path=path, intent=intent))

    def _try(self, job: Job, phase: Phase, plan: Callable[[], Path]) -> None:
        """Enter a phase whose path may leave the reachable area because of a correction."""
        try:
            path = plan()
        except OutOfReach as error:
            self._break_off(job, Fault(cause=Message("goal.corrected_aim", error=error)))
            return
        self._go(phase, path)

    def _lift(self, job: Job) -> None:
        job.left_ns = self._now_ns
        self._go(Phase.LIFT, motion_plan.lift(self._world.here, self.config.motion))

    def _way_to(self, job: Job) -> Path:
        """Return the path to the tip's position before a touch; raises OutOfReach."""
        first = job.aim.readings_at(job.tip_goal()[np.newaxis])[0]
        entered_xy = self._entered_xy if job.touch is None else None
        return motion_plan.travel(self._world.here, first[:2], first[2], self.config.motion, entered_xy)

    def _look(self, phase: Phase, settle_s: float, timeout_s: float, *, needed: int, kept: int) -> None:
        self.phase = phase
        self._tip_look = Look(after_ns=self._now_ns + nanoseconds(settle_s), needed=needed, kept=kept)
        self._deadline_ns = self._tip_look.after_ns + nanoseconds(timeout_s)
        self._base_s, self._limit_s, self._moved_s = timeout_s, timeout_s, 0.0
        self._late = None

    def _looked(self, job: Job, seen: bool) -> Step | None:
        return Step.SEEN if seen else Step.UNSEEN if self._is_over(job) else None

    def _is_over(self, job: Job) -> bool:
        """Whether the phase has timed out; while images are only late, its limit grows up to a bound."""
        if self._now_ns <= self._deadline_ns:
            return False
        self._late = self._image_delay(job)
        limit_s = next_limit_s(self._limit_s, self._base_s, self.config)
        if self._late is None or limit_s is None:
            return True
        self._deadline_ns += nanoseconds(limit_s - self._limit_s)
        self._limit_s = limit_s
        self._actions.append(msg.ReportDelay(delay=self._late, then=Message("goal.waiting_up", limit_s=limit_s)))
        return False

    def _image_delay(self, job: Job) -> Delay | None:
        """Return the delay of the images that the current phase waits for; None if they have been seen."""
        newest_ns, needed_ns = self._world.tracked_ns, 0
        what = Message("goal.image_stylus_tracker_evaluated")
        if self.phase is Phase.LOOK:
            if (delays := self._view_delays()) and self._seen_in_base(job) is not None:
                return delays[0]
            # The tracker has evaluated fewer than half of the images of this time.
            needed_ns = self._tip_look.after_ns + nanoseconds(self._base_s / 2)
        elif self.phase is Phase.MEASURE:
            needed_ns = self._tip_look.until_ns
        elif self.phase is Phase.SIGHT and (delay := first_delay(self._world, self.config)) is not None:
            return delay
        elif self.phase in WAITING and not job.touched_ns and self._world.seen is not None:
            newest_ns, needed_ns = self._world.seen.stamp_ns, self._phase_ns + nanoseconds(self.config.settle_s)
            what = Message("goal.image_controls_recognition_evaluated")
        if newest_ns > needed_ns or not needed_ns or not newest_ns:
            return None
        age_s = self._world.age_s(newest_ns)
        return Delay(code=ResultCode.LATE_IMAGE, what=what, measured_s=age_s, limit_s=self._limit_s)

    def _view_delays(self) -> list[Delay]:
        """Return the delays of images that are too late for a touch; a look may still wait for them."""
        return [delay for delay in self._world.delays(self.config) if delay.code is ResultCode.LATE_IMAGE]

    def _report_delays(self, job: Job) -> None:
        """Report once each delay for which a goal waits before it touches anything."""
        waits = not job.touched_ns and self.phase in (*WAITING, *FREE_VIEW)
        delays = {delay.what: delay for delay in (self._world.delays(self.config) if waits else ())}
        for what in delays.keys() - self._reported:
            self._actions.append(msg.ReportDelay(delay=delays[what], then=Message("goal.goal_waits")))
        self._reported = set(delays)

    def _standing(self) -> bool:
        # The driver's state, joints and result arrive on different topics, in any order.
        assert self._arrived_ns is not None
        idle = self._world.driver == "idle" or self._now_ns > self._arrived_ns + NANO
        return idle and self._world.readings_ns > self._arrived_ns

    def _check_arrival(self, job: Job) -> bool:
        assert self._end is not None
        off = float(np.linalg.norm(self._world.here - self._end))
        if off <= self.config.arrival_tolerance_m:
            return True
        cause = Message(
            "goal.driver_reports_end_motion_beside",
            off_mm=1000 * off,
            arrival_tolerance_mm=1000 * self.config.arrival_tolerance_m,
        )
        self._break_off(job, Fault(cause=cause, lift=False, stop=self._extended))
        return False

    @property
    def _extended(self) -> bool:
        """Whether the stylus may touch something, so that only a stop, which lifts it, is safe."""
        return bool(self._world.here[2] > EXTENDED_M)

    def _seen_in_base(self, job: Job) -> Array | None:
        assert job.scene is not None
        base_from_camera = self._world.base_from_camera(job.scene, self.config)
        return None if base_from_camera is None else self._tip_look.seen(base_from_camera, self.config.tip_spread_m)

    # Ends

    def _fault(self, job: Job) -> Fault | None:
        """Return the fault that ends the goal early, if any; called after every event."""
        pushing, crossing = self.phase in PUSHING, self.phase not in STANDING
        patient = not job.touched_ns
        waiting = patient and self.phase in WAITING
        fault = self._world.machine_fault(self.config, pushing=pushing, waiting=waiting)
        if fault is not None or job.touch is None or self.phase in UP:
            return fault
        assert job.scene is not None
        if self.phase in FREE_VIEW and (fault := self._world.view_fault(self.config, job.touch.control)) is not None:
            return fault
        if self.phase is Phase.CONTACT and (fault := self._unwatched_fault(job)) is not None:
            return fault
        return self._world.sight_fault(
            self.config,
            job.scene,
            job.touch.in_panel,
            pushing=pushing,
            crossing=crossing,
            patient=patient and self.phase in (*FREE_VIEW, *WAITING),
        )

    def _unwatched_fault(self, job: Job) -> Fault | None:
        """Return the fault of a contact without an image that the stylus tracker has evaluated for too long.

        The images of a press, which is shorter, may come while the stylus rises.
        """
        silent_s = self._world.age_s(self._world.tracked_ns)
        longer = self._now_ns > job.down_ns + nanoseconds(self.config.press_max_s + LONGER_S)
        if not longer or not UNWATCHED_S < silent_s < math.inf:
            return None
        cause = Message("goal.touched_but_not_measured_no", since=since(silent_s))
        return Fault(cause=cause, tells_touch=True)

    def _break_off(self, job: Job, fault: Fault) -> None:
        """End the goal early: hold the machine, or let a motion in the air end and then retract, or only report."""
        cause = fault.cause if job.fault is None else Message("goal.then", cause=job.fault.cause, more=fault.cause)
        delay = fault.delay if job.fault is None else None
        tells_touch = (job.fault or fault).tells_touch
        if fault.stop:
            self._actions.append(msg.CallStop(reason=cause))
            reason = Message("controller.machine_told_stop", cause=cause)
            self._abort(job, reason, delay, stopped=True, tells_touch=tells_touch)
        elif not fault.lift or job.fault is not None:
            self._abort(job, Message("goal.no_more_motion_ordered", cause=cause), delay, tells_touch=tells_touch)
        else:
            job.fault = fault
            if self.phase not in MOVING:
                self._lift_after_fault(job)

    def _lift_after_fault(self, job: Job) -> None:
        self._go(Phase.BREAK_OFF, motion_plan.lift(self._world.here, self.config.motion))

    def _finish_broken_off(self, job: Job) -> None:
        fault = job.fault
        assert fault is not None
        reason = Message("stylus.is_up", cause=fault.cause)
        self._abort(job, reason, fault.delay, code=fault.code, tells_touch=fault.tells_touch)

    def _abort(
        self,
        job: Job,
        reason: str,
        delay: Cause | None = None,
        *,
        stopped: bool = False,
        code: str = "",
        tells_touch: bool = False,
    ) -> None:
        """Abort a goal; warn if the stylus had gone down, because a repeated press may act twice.

        ``tells_touch`` is whether the reason says so itself.
        """
        if job.touched_ns and not tells_touch:
            reason = Message("goal.stylus_gone_down_look_panel", reason=reason)
        self._finish(job, Outcome.ABORTED, reason, delay, stopped=stopped, code=code)

    def _finish(
        self,
        job: Job,
        outcome: Outcome,
        reason: str = "",
        delay: Cause | None = None,
        *,
        stopped: bool = False,
        code: str = "",
    ) -> None:
        if outcome is Outcome.REACHED and job.measured_beside:
            beside = Message("goal.tip_measured_beside_target_could")
            reason = Message("text.and_also", first=beside, second=reason) if reason else beside
        self.phase = Phase.IDLE
        self._job = None
        self._reported = set()
        # A goal that has touched, or that needs a reset, must not be repeated without a person.
        repeatable = not job.touched_ns and not stopped
        self._publish(job, outcome, reason, delay, repeatable=repeatable, code=code, stop_asked=stopped)

    def _publish(
        self,
        job: Job,
        outcome: Outcome,
        reason: str = "",
        delay: Cause | None = None,
        *,
        repeatable: bool = False,
        code: str = "",
        stop_asked: bool = False,
    ) -> None:
        self.counts[outcome] += 1
        result = job.result(outcome, reason, self._now_ns, delay, repeatable=repeatable, code=code)
        if stop_asked:
            result = replace(result, details=(*result.details, (STOP_ASKED, "yes")))
        self._actions.append(msg.PublishResult(result=result))


def nanoseconds(seconds: float) -> int:
    """Return seconds in nanoseconds, the clock's unit."""
    return round(seconds * NANO)
