"""The gantry controller as a state machine: events and time in, actions out; no ROS, no clock.

It carries out one goal at a time. ``goal_phases`` has the phases of a goal with the table of all transitions, and
``goal_run`` has the waits of a phase and the end of a goal. ``goal_intake`` turns a goal into a job. ``world`` has the
faults that end a goal early, ``obstacles`` those that keep one from starting, and ``servo`` the evaluation of a look at
the tip.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from gantry_driver.core.envelope.estimate import PlaneEstimate, plane_below
from gantry_driver.core.goals import goal_intake
from gantry_driver.core.goals.goal_phases import GoalPhases
from gantry_driver.core.goals.goal_run import nanoseconds
from gantry_driver.core.goals.obstacles import obstacles
from gantry_driver.core.goals.servo import NO_LOOK, Look
from gantry_driver.core.goals.world import CROSSED_M
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import MOVING, NANO, OTHERWISE, STATES, Fault, Job, Phase
from gantry_driver.core.job.patience import CLICK_MAX_AGE_S, HoldUp
from gantry_driver.core.motion.motion_plan import OutOfReach, is_at
from gantry_driver.core.motion.scene import Refused
from icu_common.core.alignment.findings import Cause
from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.geometry import Array
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.gesture import GestureError, parse_gesture
from icu_common.core.processes.delays import Delay, ResultCode, delay_of
from icu_common.core.reasons.codes import ControllerCode
from icu_common.core.reasons.message import Message, quoted
from icu_common.core.reasons.state_text import because, state_name

ASK_AGAIN_S = 0.5
CLEAR_AGAIN_S = 1.0
PLANE_AGAIN_S = 1.0
CLOCK_JUMP_S = 0.5
"""Seconds by which time may run back between two events; a larger jump ends the goal, as no deadline would hold."""


class Controller(GoalPhases):
    """The state machine described above. Pass every event to :meth:`handle` and carry out the actions in order."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__(config)
        self._hold_up, self._wall_hold_up = HoldUp(), HoldUp()
        self._face, self._sigma_m, self._plane_ns = PlaneEstimate(), math.nan, 0

    @property
    def state(self) -> str:
        """Text of the last SetState."""
        return self._state

    @property
    def goal(self) -> str:
        """The goal in progress as text, empty without one."""
        return self._job.text if self._job is not None else ""

    def unrest(self) -> str:
        """Return why safety settings must not change now; empty at rest with the stylus up."""
        if self._job is not None:
            return Message("controller.busy", job=quoted(self._job.text))
        return self._world.unrest()

    def handle(self, event: msg.Event, now_ns: int, wall_ns: int | None = None) -> list[msg.Action]:
        """Take one event at ROS time ``now_ns`` and return the actions, in order.

        The age of the operator's heartbeat counts by ``wall_ns`` if ROS time is simulated, else by ``now_ns``.
        """
        if self._closed:
            return []
        self._world.wall_ns = now_ns if wall_ns is None else wall_ns
        self._wall_hold_up.note(self._world.wall_ns)
        self._world.wall_held_up_s = self._wall_hold_up.recent_s(self._world.wall_ns)
        jumped_back_s = (self._now_ns - now_ns) / NANO
        self._now_ns = self._world.now_ns = now_ns
        self._actions = []
        gap_s = self._hold_up.note(now_ns)
        self._world.held_up_s = self._hold_up.recent_s(now_ns)
        self._move_deadline(gap_s)
        if jumped_back_s > CLOCK_JUMP_S:
            self._world.forget_times()
            self._rest_look = NO_LOOK
            self._face.forget()
            self._stamp_ns = self._asked_ns = self._plane_ns = 0  # the driver rejects stamps of the old time
            if self._job is not None:
                self._break_off(
                    self._job,
                    Fault(cause=Message("controller.clock_jumped_back", jumped_back_s=jumped_back_s), stop=True),
                )
        self._take(event)
        self._world.plane_due = math.isfinite(self._sigma_m) and not self._plane_ns
        if self._job is not None:
            fault = self._fault(self._job)
            # While a fault is being handled, only faults that forbid the lift count.
            if fault is not None and (self._job.fault is None or not fault.lift or fault.stop):
                self._break_off(self._job, fault)
        if self._job is not None and self._job.fault is None:
            self._report_delays(self._job)
        self._advance()
        self._show_state()
        actions, self._actions = self._actions, []
        return actions

    def fail(self, cause: str, now_ns: int) -> list[msg.Action]:
        """End after an internal error: hold the machine, abort the goal, and ignore all later events.

        Of the pending actions only the answers remain: an untrusted state must not move anything.
        """
        if self._closed:
            return []
        answers = [action for action in self._actions if isinstance(action, msg.PublishResult)]
        self._now_ns, self._closed = now_ns, True
        self._actions = [msg.CallStop(reason=cause), *answers]
        if self._job is not None:
            self._abort(self._job, Message("controller.machine_told_stop", cause=cause), stopped=True)
        self._set_state(because("stopped", cause), ControllerCode.FAILED)
        return self._actions

    def close(self, now_ns: int) -> list[msg.Action]:
        """Shut down: hold the machine if a goal is in progress, end the goal, and ignore all later events."""
        if self._closed:
            return []
        self._now_ns = self._world.now_ns = now_ns
        self._actions = []
        if self._job is not None:
            self._break_off(self._job, Fault(cause=Message("controller.controller_shutting_down"), stop=True))
        self._set_state(
            because("waiting", Message("controller.controller_ended")),
            ControllerCode.ENDED,
        )
        self._closed = True
        return self._actions

    # Inputs

    def _take(self, event: msg.Event) -> None:
        world = self._world
        match event:
            case msg.PointGoal():
                goal_id, text = str(event.stamp_ns), goal_intake.text_of(event)
                self._accept_or_reject(goal_id, text, lambda: goal_intake.point_job(event, world, self.config))
            case msg.Command():
                self._take_command(event.text)
            case msg.DriverState():
                self._take_driver(event.text)
            case msg.Joints():
                if world.readings is None or np.abs(event.readings - world.readings).max() > CROSSED_M:
                    count, settled_ns = self.config.tip_count, self._now_ns + nanoseconds(self.config.settle_s)
                    self._rest_look = Look(after_ns=settled_ns, needed=count, kept=count)
                world.take_readings(event.readings)
                self._note_other_motion()
                self.switch.take(event.probe)
                self._check_left_behind()
                self._report_plane()  # between two goals the machine may rest for no longer than this
            case msg.MotionResult():
                self._take_motion_result(event.result)
            case msg.PanelPose():
                world.reported_panel = event
            case msg.PanelConfidence():
                world.take_confidence(event.value, self.config)
                self._report_plane()
            case msg.PanelAlarm():
                world.panel_alarm = event.text
            case msg.PanelControls():
                world.panel = event.panel
            case msg.PanelState():
                world.take_seen(event.seen)
                if self._job is not None:
                    self._job.look_before(event.seen)
            case msg.CameraFromBase():
                world.camera_from_base = event.transform
            case msg.Axes():
                if not _same(world.base_from_reading, event.base_from_reading):
                    # A calibration measures the stylus's height as well.
                    self.heights.forget(world.height_correction_m())
                    self.tips.forget()
                world.base_from_reading = event.base_from_reading
            case msg.PairSeen():
                world.pair = event.pair
            case msg.LayoutSeen():
                world.deviations = event.deviations
            case msg.CalibrationSigma():
                self._sigma_m = event.value_m
            case msg.TipSeen():
                # Images arrive late: those of the contact still count while the stylus rises.
                self._tip_look = self._tip_look.with_tip(event.in_camera, event.stamp_ns)
                self._rest_look = self._rest_look.with_tip(event.in_camera, event.stamp_ns)
                world.take_tip(event.in_camera, event.stamp_ns, self.config)
                self._report_clear()
            case msg.TipUnseen():
                world.tracked_ns = max(world.tracked_ns, event.stamp_ns)
            case msg.CameraSeen():
                world.camera, world.camera_stamp_ns = event.camera, event.stamp_ns
            case msg.Heartbeat():
                seen_ns, last_ns = world.wall_ns - event.age_ns, world.heartbeat_ns
                # An older stamp does not replace a newer one.
                if last_ns is None or not seen_ns < last_ns <= world.wall_ns:
                    world.heartbeat_ns = seen_ns
            case msg.Rivals():
                begins = world.rivals.take(event.topic, event.text)
                if begins and self._job is None:  # also at rest; a running job ends by its fault
                    self._actions.append(msg.CallStop(reason=event.text))
            case msg.Tick():
                pass

    def _report_clear(self) -> None:
        """Report to the driver, at most once a second, that images show a stylus of unknown position off the panel."""
        height_m = self._world.seen_clear_m(self.config)
        if height_m is not None and self._world.age_s(self._world.clear_ns) > CLEAR_AGAIN_S:
            self._world.clear_ns = self._now_ns
            self._actions.append(msg.ReportClear(height_m=height_m))

    def _report_plane(self) -> None:
        """Report the panel's plane to the driver, at most once a second, while the machine rests with the stylus up."""
        world = self._world
        pose, axes, panel = world.resting_base_from_panel, world.base_from_reading, world.panel
        if world.rivals.text or world.panel_alarm:
            self._face.forget()
            return
        if pose is None or axes is None or panel is None or not math.isfinite(self._sigma_m):
            return
        if not world.panel_is_still(self.config):
            return
        self._face.take(pose, world.panel_stamp_ns)
        reported = world.age_s(self._plane_ns) < PLANE_AGAIN_S or self._face.stamp_ns <= self._plane_ns
        if reported or world.readings is None or world.unrest():
            return
        middle, ball_m = panel.extent.mean(axis=0), self.config.touch.ball_radius_m
        with contextlib.suppress(ValueError):  # a panel that leans this far is never touched
            if (plane := self._face.plane(axes, middle, ball_m, self._sigma_m)) is not None:
                plane = plane_below(plane, self.heights.stylus)
                self._plane_ns, world.plane = self._now_ns, plane
                self._actions.append(msg.ReportPlane(plane=plane, stamp_ns=self._face.stamp_ns))

    def _take_driver(self, text: str) -> None:
        self._world.driver = text
        state = state_name(text)
        if state not in ("idle", "moving"):
            self._entered_xy = None  # the motors may be off, or the machine is homed again
        if state in ("disconnected", "connecting"):
            self._plane_ns = 0  # a new guard does not have the panel's plane
        self._world.rivals.driver_is(state)
        if state == "stopped":
            self._world.unchecked = False
        elif not self._world.unchecked and state == "idle":
            self._world.left_behind = ""

    def _note_other_motion(self) -> None:
        """Forget on which side a position was entered after a motion that no goal has ordered."""
        entered_xy = self._entered_xy
        if entered_xy is not None and self._job is None and not is_at(self._world.here[:2], entered_xy):
            self._entered_xy = None

    def _check_left_behind(self) -> None:
        """Request a stop, which lifts, if the stylus was left extended before the start; repeat it until it works."""
        if not self._world.unchecked or self._world.driver != "idle":
            return
        self._world.unchecked = self._extended
        self._world.left_behind = self._world.left_behind_text() if self._world.unchecked else ""
        if self._world.unchecked and self._world.age_s(self._asked_ns) > ASK_AGAIN_S:
            self._asked_ns = self._now_ns
            self._actions.append(msg.CallStop(reason=self._world.left_behind))

    def _take_motion_result(self, result: GoalResult) -> None:
        if self._job is None or self.phase not in MOVING or result.goal_id != str(self._stamp_ns):
            return
        if result.outcome is Outcome.REACHED:
            self._arrived_ns = self._now_ns
        elif result.outcome.final:
            delay = delay_of(result)
            if delay is not None and self._send_again(self._job, delay):
                return
            cause = Message(
                "controller.driver_motion",
                outcome=result.outcome.value,
                reason=result.reason or Message("controller.no_reason_given"),
            )
            # A driver that has aborted a motion lifts the stylus itself; one that has rejected it leaves it as it is.
            stop = result.outcome is Outcome.REJECTED and self._extended
            if delay is not None:  # STALE would mean that the goal itself is too old
                delay = replace(delay, code=ResultCode.SLOW)
            self._break_off(self._job, Fault(cause=cause, lift=False, stop=stop, delay=delay))

    def _show_state(self) -> None:
        if self._job is not None:
            self._set_state(STATES.get(self.phase, OTHERWISE), ControllerCode.WORKING)
        elif (obstacle := next(obstacles(self._world, self.config), None)) is None:
            self._set_state("ready", ControllerCode.READY)
        else:
            self._set_state(obstacle.state, obstacle.code)

    def _set_state(self, text: str, code: ControllerCode) -> None:
        if text != self._state:
            self._state, self.code = text, code
            self._actions.append(msg.SetState(text=text))

    # Goals

    def _take_command(self, text: str) -> None:
        try:
            gesture = parse_gesture(text)
        except GestureError as error:
            self._reject(plain(_id_in(text)), plain(text), plain(str(error)))
            return
        if (held_s := self._world.held_up_s) > CLICK_MAX_AGE_S:
            # A command has no stamp: this one may have waited during the whole hold-up.
            delay = Delay(
                code=ResultCode.STALE, what=Message("goal.command"), measured_s=held_s, limit_s=CLICK_MAX_AGE_S
            )
            reason = Message(
                "controller.stale_controller_held_up_allowed", held_s=held_s, click_max_age_s=CLICK_MAX_AGE_S
            )
            self._reject(gesture.id or text, text, reason, delay)
            return
        goal_id = gesture.id or text
        make_job = partial(goal_intake.gesture_job, gesture, text, goal_id, self._world, self.config)
        self._accept_or_reject(goal_id, text, make_job)

    def _accept_or_reject(self, goal_id: str, text: str, make_job: Callable[[], Job]) -> None:
        try:
            if self._job is not None:
                raise Refused(Message("controller.busy", job=quoted(self._job.text)))
            job = make_job()
            if not job.unplanned:
                self._way_to(job)
        except OutOfReach as error:
            self._reject(goal_id, text, Message("text.more", first=text, second=error))
            return
        except Refused as error:
            self._reject(goal_id, text, str(error), error.delay)
            return
        self._job = job
        self._world.unchecked = False
        self._publish(job, Outcome.ACCEPTED, Phase.SIGHT.value if job.unplanned else "")
        self._start(job)

    def _reject(self, goal_id: str, text: str, reason: str, delay: Cause | None = None) -> None:
        self.counts[Outcome.REJECTED] += 1
        result = GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=reason)
        if delay is not None:
            result = replace(result, code=delay.code.value, details=delay.details())
        self._actions.append(msg.PublishResult(result=result))


def _same(one: Array | None, other: Array | None) -> bool:
    return one is other or (one is not None and other is not None and bool(np.array_equal(one, other)))


def _id_in(text: str) -> str:
    """Return the id in an invalid command, so that the sender finds its answer; without an id, the command's text."""
    _, found, identifier = text.partition(" id=")
    return identifier.strip()[:64] if found and identifier.strip() else text[:200]
