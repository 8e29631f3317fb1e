"""The gantry controller as a state machine: events and time in, actions out; no ROS, no clock.

One goal at a time. A goal runs through phases, which ``goal_phases`` has with the table of all transitions; what a
phase waits for, and how a goal ends, stands in ``goal_run``. How it becomes a job stands in ``goal_intake``; what ends
it early, and what keeps one from starting, in ``world``; what is made of a look at the tip, in ``servo``.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from gantry_driver.core import controller_messages as msg
from gantry_driver.core import goal_intake
from gantry_driver.core.controller_config import ControllerConfig
from gantry_driver.core.envelope.estimate import PlaneEstimate
from gantry_driver.core.goal_job import MOVING, NANO, OTHERWISE, STATES, Fault, Job, Phase
from gantry_driver.core.goal_phases import GoalPhases
from gantry_driver.core.goal_run import nanoseconds
from gantry_driver.core.motion_plan import OutOfReach
from gantry_driver.core.patience import CLICK_MAX_AGE_S, HoldUp
from gantry_driver.core.scene import Refused
from gantry_driver.core.servo import NO_LOOK, Look
from gantry_driver.core.world import CROSSED_M
from icu_common.core.delays import Delay, ResultCode, delay_of
from icu_common.core.gesture import GestureError, parse_gesture
from icu_common.core.results import GoalResult, Outcome
from icu_common.core.text_bounds import plain

ASK_AGAIN_S = 0.5
CLEAR_AGAIN_S = 1.0
PLANE_AGAIN_S = 1.0
CLOCK_JUMP_S = 0.5
"""Time that runs back farther than this between two events ends the goal: no deadline would hold any more."""


class Controller(GoalPhases):
    """See the module's text. Feed every event to :meth:`handle` and carry out the actions in their order."""

    def __init__(self, config: ControllerConfig) -> None:
        super().__init__(config)
        self._hold_up, self._wall_hold_up = HoldUp(), HoldUp()
        self._face, self._sigma_m, self._plane_ns = PlaneEstimate(), math.nan, 0

    @property
    def state(self) -> str:
        """What was last given to SetState."""
        return self._state

    @property
    def goal(self) -> str:
        """The goal in work as text, empty without one."""
        return self._job.text if self._job is not None else ""

    def unrest(self) -> str:
        """Return why safety settings must not change now, empty at rest with the stylus up."""
        if self._job is not None:
            return f"busy with {self._job.text!r}"
        return self._world.unrest()

    def handle(self, event: msg.Event, now_ns: int, wall_ns: int | None = None) -> list[msg.Action]:
        """Take one event at ROS time ``now_ns`` and return what is to be done, in order.

        The operator's heartbeat is judged by ``wall_ns``, where ROS time is simulated; without it by ``now_ns``.
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
            self._stamp_ns = self._asked_ns = self._plane_ns = 0  # the driver refuses stamps of the old time
            if self._job is not None:
                self._break_off(self._job, Fault(cause=f"the clock jumped back by {jumped_back_s:.1f} s", stop=True))
        self._take(event)
        self._world.plane_due = math.isfinite(self._sigma_m) and not self._plane_ns
        if self._job is not None:
            fault = self._fault(self._job)
            # On the way out after one fault only those count that forbid the rest of the way.
            if fault is not None and (self._job.fault is None or not fault.lift or fault.stop):
                self._break_off(self._job, fault)
        if self._job is not None and self._job.fault is None:
            self._report_delays(self._job)
        self._advance()
        self._show_state()
        actions, self._actions = self._actions, []
        return actions

    def fail(self, cause: str, now_ns: int) -> list[msg.Action]:
        """End everything after an error in here: the machine is held, the goal aborted, and nothing is heard any more.

        Of what was about to be done only the answers remain; a state that is not trusted must not move anything.
        """
        if self._closed:
            return []
        answers = [action for action in self._actions if isinstance(action, msg.PublishResult)]
        self._now_ns, self._closed = now_ns, True
        self._actions = [msg.CallStop(reason=cause), *answers]
        if self._job is not None:
            self._abort(self._job, f"{cause}; the machine was told to stop")
        self._set_state(f"stopped: {cause}")
        return self._actions

    def close(self, now_ns: int) -> list[msg.Action]:
        """End the goal in work because the controller goes away: the machine is held, and nothing is heard any more."""
        if self._closed:
            return []
        self._now_ns = self._world.now_ns = now_ns
        self._actions = []
        if self._job is not None:
            self._break_off(self._job, Fault(cause="the controller is shutting down", stop=True))
        self._set_state("waiting: the controller has ended")
        self._closed = True
        return self._actions

    # What is heard

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
                world.base_from_reading = event.base_from_reading
            case msg.CalibrationSigma():
                self._sigma_m = event.value_m
            case msg.TipSeen():
                # Pictures come late: those of the contact still count when the stylus is on its way up.
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
        """Report to the driver, at most once a second, that a stylus of unknown position is seen off the panel."""
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
                self._plane_ns = self._now_ns
                self._actions.append(msg.ReportPlane(plane=plane, stamp_ns=self._face.stamp_ns))

    def _take_driver(self, text: str) -> None:
        self._world.driver = text
        state = text.partition(":")[0]
        if state in ("disconnected", "connecting"):
            self._plane_ns = 0  # a new guard does not know the panel
        self._world.rivals.driver_is(state)
        if state == "stopped":
            self._world.unchecked = False
        elif not self._world.unchecked and state == "idle":
            self._world.left_behind = ""

    def _check_left_behind(self) -> None:
        """Ask for a stop, which lifts, if the stylus was left extended before the start; again until it is heard."""
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
            cause = f"the driver {result.outcome.value} the motion: {result.reason or 'no reason given'}"
            # A driver that has broken a motion off lifts the stylus itself; one that has refused it rests as it is.
            stop = result.outcome is Outcome.REJECTED and self._extended
            if delay is not None:  # STALE would say that the goal itself is too old
                delay = replace(delay, code=ResultCode.SLOW)
            self._break_off(self._job, Fault(cause=cause, lift=False, stop=stop, delay=delay))

    def _show_state(self) -> None:
        if self._job is not None:
            self._set_state(STATES.get(self.phase, OTHERWISE))
        else:
            obstacle = next(self._world.obstacles(self.config), None)
            self._set_state("ready" if obstacle is None else obstacle.state)

    def _set_state(self, text: str) -> None:
        if text != self._state:
            self._state = text
            self._actions.append(msg.SetState(text=text))

    # Goals

    def _take_command(self, text: str) -> None:
        try:
            gesture = parse_gesture(text)
        except GestureError as error:
            self._reject(plain(_id_in(text)), plain(text), plain(str(error)))
            return
        if (held_s := self._world.held_up_s) > CLICK_MAX_AGE_S:
            # A command has no stamp: this one may have waited for as long.
            delay = Delay(code=ResultCode.STALE, what="command", measured_s=held_s, limit_s=CLICK_MAX_AGE_S)
            reason = f"stale: the controller was held up for {held_s:.1f} s, {CLICK_MAX_AGE_S:g} s are allowed"
            self._reject(gesture.id or text, text, reason, delay)
            return
        goal_id = gesture.id or text
        make_job = partial(goal_intake.gesture_job, gesture, text, goal_id, self._world, self.config)
        self._accept_or_reject(goal_id, text, make_job)

    def _accept_or_reject(self, goal_id: str, text: str, make_job: Callable[[], Job]) -> None:
        try:
            if self._job is not None:
                raise Refused(f"busy with {self._job.text!r}")
            job = make_job()
            if not job.unplanned:
                self._way_to(job)
        except OutOfReach as error:
            self._reject(goal_id, text, f"{text}: {error}")
            return
        except Refused as error:
            self._reject(goal_id, text, str(error), error.delay)
            return
        self._job = job
        self._world.unchecked = False
        self._publish(job, Outcome.ACCEPTED, Phase.SIGHT.value if job.unplanned else "")
        self._start(job)

    def _reject(self, goal_id: str, text: str, reason: str, delay: Delay | None = None) -> None:
        self.counts[Outcome.REJECTED] += 1
        result = GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=reason)
        if delay is not None:
            result = replace(result, code=delay.code.value, details=delay.details())
        self._actions.append(msg.PublishResult(result=result))


def _id_in(text: str) -> str:
    """Return the id of a command that is otherwise wrong, so that who asked finds the answer; else its text."""
    _, found, identifier = text.partition(" id=")
    return identifier.strip()[:64] if found and identifier.strip() else text[:200]
