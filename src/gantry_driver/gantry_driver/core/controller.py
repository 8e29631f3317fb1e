"""The gantry controller as a state machine: events and time in, actions out; no ROS, no clock.

One goal at a time. A goal runs through phases; the table ``Controller._NEXT`` lists every transition. How it becomes a
job stands in ``goal_intake``; what ends it early, and what keeps one from starting, in ``world``; what is made of a
look at the tip, in ``servo``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np

from gantry_driver.core import controller_messages as msg
from gantry_driver.core import goal_intake, motion_plan
from gantry_driver.core.controller_config import ControllerConfig
from gantry_driver.core.effects import Knob, effect, knob_of
from gantry_driver.core.goal_job import (
    FREE_VIEW,
    LOOKING,
    MOVING,
    NANO,
    OTHERWISE,
    PUSHING,
    STANDING,
    STATES,
    UP,
    Aim,
    Fault,
    Job,
    Phase,
    Step,
)
from gantry_driver.core.motion_plan import OutOfReach, Path
from gantry_driver.core.scene import Refused
from gantry_driver.core.servo import NO_LOOK, Look, contact_complaint, judge, misplaced, places_beside
from gantry_driver.core.world import CROSSED_M, EXTENDED_M, World
from icu_common.core.geometry import Array
from icu_common.core.gesture import GestureError, parse_gesture
from icu_common.core.results import GoalResult, Outcome

MAX_TIPS = 50
ASK_AGAIN_S = 0.5
CLOCK_JUMP_S = 0.5
"""Time that runs back farther than this between two events ends the goal: no deadline would hold any more."""


class Controller:
    """See the module's text. Feed every event to :meth:`handle` and carry out the actions in their order."""

    def __init__(self, config: ControllerConfig) -> None:
        self.config = config
        self.phase = Phase.IDLE
        self.counts = dict.fromkeys(Outcome, 0)
        self._world = World()
        self._job: Job | None = None
        self._actions: list[msg.Action] = []
        self._state = ""
        self._closed = False
        self._now_ns = 0
        self._deadline_ns = 0
        self._stamp_ns = 0
        self._phase_ns = 0
        self._end: Array | None = None
        self._arrived_ns: int | None = None
        self._tip_look = self._rest_look = NO_LOOK
        self._asked_ns = 0

    # Every transition of a goal. A method either enters another phase or finishes the goal.
    _NEXT: ClassVar[dict[tuple[Phase, Step], Callable[[Controller, Job], None]]] = {
        (Phase.MOVE, Step.ARRIVED): lambda self, job: self._finish_move(job),
        (Phase.WAIT, Step.SEEN): lambda self, job: self._begin_anew(job),
        (Phase.WAIT, Step.UNSEEN): lambda self, job: self._finish_hidden(job),
        (Phase.APPROACH, Step.ARRIVED): lambda self, job: self._look_at_hover(job),
        (Phase.LOOK, Step.SEEN): lambda self, job: self._judge_hover(job),
        (Phase.LOOK, Step.UNSEEN): lambda self, job: self._unseen_hover(job),
        (Phase.CORRECT, Step.ARRIVED): lambda self, job: self._look_at_hover(job),
        (Phase.RETURN, Step.ARRIVED): lambda self, job: self._touch_down(job),
        (Phase.TOUCH, Step.ARRIVED): lambda self, job: self._look_at_contact(job),
        (Phase.CONTACT, Step.SEEN): lambda self, job: self._leave_contact(job),
        (Phase.CONTACT, Step.UNSEEN): lambda self, job: self._leave_contact(job),
        (Phase.TURN, Step.ARRIVED): lambda self, job: self._lift(job),
        (Phase.LIFT, Step.ARRIVED): lambda self, job: self._wait_for_pictures(job),
        (Phase.MEASURE, Step.SEEN): lambda self, job: self._judge_contact(job),
        (Phase.MEASURE, Step.UNSEEN): lambda self, job: self._judge_contact(job),
        (Phase.ASIDE, Step.ARRIVED): lambda self, job: self._read_from_aside(job),
        (Phase.READ, Step.SEEN): lambda self, job: self._judge_effect(job),
        (Phase.READ, Step.UNSEEN): lambda self, job: self._judge_effect(job),
        (Phase.BREAK_OFF, Step.ARRIVED): lambda self, job: self._finish_broken_off(job),
    }

    @property
    def state(self) -> str:
        """What was last given to SetState."""
        return self._state

    @property
    def goal(self) -> str:
        """The goal in work as text, empty without one."""
        return self._job.text if self._job is not None else ""

    def handle(self, event: msg.Event, now_ns: int) -> list[msg.Action]:
        """Take one event at ROS time ``now_ns`` and return what is to be done, in order."""
        if self._closed:
            return []
        jumped_back_s = (self._now_ns - now_ns) / NANO
        self._now_ns = self._world.now_ns = now_ns
        self._actions = []
        if jumped_back_s > CLOCK_JUMP_S:
            self._world.forget_times()
            self._rest_look = NO_LOOK
            self._stamp_ns = self._asked_ns = 0  # the driver refuses stamps of the old time
            if self._job is not None:
                self._break_off(self._job, Fault(cause=f"the clock jumped back by {jumped_back_s:.1f} s", stop=True))
        self._take(event)
        if self._job is not None:
            fault = self._fault(self._job)
            # On the way out after one fault only those count that forbid the rest of the way.
            if fault is not None and (self._job.fault is None or not fault.lift or fault.stop):
                self._break_off(self._job, fault)
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
                    count, settled_ns = self.config.tip_count, self._now_ns + _nanoseconds(self.config.settle_s)
                    self._rest_look = Look(after_ns=settled_ns, needed=count, kept=count)
                world.take_readings(event.readings)
                self._check_left_behind()
            case msg.MotionResult():
                self._take_motion_result(event.result)
            case msg.PanelPose():
                world.reported_panel = event
            case msg.PanelConfidence():
                world.take_confidence(event.value, self.config.min_confidence)
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
            case msg.TipSeen():
                # Pictures come late: those of the contact still count when the stylus is on its way up.
                self._tip_look = self._tip_look.with_tip(event.in_camera, event.stamp_ns)
                self._rest_look = self._rest_look.with_tip(event.in_camera, event.stamp_ns)
            case msg.CameraSeen():
                world.camera, world.camera_stamp_ns = event.camera, event.stamp_ns
            case msg.Heartbeat():
                world.heartbeat_ns = self._now_ns
            case msg.Tick():
                pass

    def _take_driver(self, text: str) -> None:
        self._world.driver = text
        state = text.partition(":")[0]
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
            cause = f"the driver {result.outcome.value} the motion: {result.reason or 'no reason given'}"
            # A driver that has broken a motion off lifts the stylus itself; one that has refused it rests as it is.
            stop = result.outcome is Outcome.REJECTED and self._extended
            self._break_off(self._job, Fault(cause=cause, lift=False, stop=stop))

    @property
    def _extended(self) -> bool:
        """Whether the stylus may touch, so that only a stop, which lifts, leaves it safe."""
        return bool(self._world.here[2] > EXTENDED_M)

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
            self._reject(_id_in(text), text, str(error))
            return
        goal_id = gesture.id or text
        make_job = partial(goal_intake.gesture_job, gesture, text, goal_id, self._world, self.config)
        self._accept_or_reject(goal_id, text, make_job)

    def _accept_or_reject(self, goal_id: str, text: str, make_job: Callable[[], Job]) -> None:
        try:
            if self._job is not None:
                raise Refused(f"busy with {self._job.text!r}")
            job = make_job()
            self._way_to(job)
        except OutOfReach as error:
            self._reject(goal_id, text, f"{text}: {error}")
            return
        except Refused as error:
            self._reject(goal_id, text, str(error))
            return
        self._job = job
        self._world.unchecked = False
        self._publish(job, Outcome.ACCEPTED)
        self._actions.append(msg.ShowTarget(in_base=job.goal_base()))
        self._start(job)

    def _way_to(self, job: Job) -> Path:
        """Return the way to where the job's tip goes before a touch; raises OutOfReach."""
        first = job.aim.readings_at(job.tip_goal()[np.newaxis])[0]
        return motion_plan.travel(self._world.here, first[:2], first[2], self.config.motion)

    # Phases: each entry sets what the phase waits for and its deadline

    def _start(self, job: Job) -> None:
        """Begin at once, or wait until whatever hides the control has gone."""
        if job.touch is not None and job.touch.control in self._world.hidden_ns:
            self._enter(Phase.WAIT, self.config.hidden_wait_s)
        else:
            self._begin(job)

    def _rests_misplaced(self, job: Job) -> Fault | None:
        """Return what is wrong with a tip seen at rest: one that hangs too low presses before it is looked at."""
        if job.scene is None:
            return None
        base_from_camera = self._world.base_from_camera(job.scene, self.config)
        seen = None if base_from_camera is None else self._rest_look.seen(base_from_camera, self.config.tip_spread_m)
        if seen is None:
            return None
        x, y = job.aim.base_from_reading @ self._world.here[:2]
        return misplaced(seen - (x, y, -self._world.here[2]), self.config)

    def _begin(self, job: Job) -> None:
        knob = job.knob
        if (fault := self._rests_misplaced(job)) is not None:
            reason = f"{fault.cause}; the stylus may be bent, or another one; nothing was moved"
            self._finish(job, Outcome.ABORTED, reason)
        elif knob is not None and math.isnan(knob.seen_deg) and (self._needs_marker(job, knob) or self._under(job)):
            self._move_aside(job, knob.name)
        elif self._may_tell_by_lamp(job) and self._under(job):
            assert job.touch is not None
            self._move_aside(job, job.touch.control)
        elif knob is not None and job.kind == "set" and abs(knob.off_deg) <= self.config.set_tolerance_deg:
            self._finish(job, Outcome.REACHED)
        else:
            self._try(job, Phase.MOVE if job.touch is None else Phase.APPROACH, lambda: self._way_to(job))

    def _begin_anew(self, job: Job) -> None:
        """Begin with what is seen now: what was hidden when the goal was taken may be read, or was turned by a hand."""
        if job.knob is not None:
            assert job.gesture is not None and job.scene is not None and self._world.seen is not None
            name = job.knob.name
            try:
                job.knob = knob_of(job.gesture, name, self._world.seen.control(name))
                job.touch = goal_intake.find_touch(job.gesture, job.knob, job.scene, self.config)
            except (Refused, OutOfReach) as error:
                self._finish(job, Outcome.ABORTED, f"{error}; nothing was moved")
                return
        self._begin(job)

    def _needs_marker(self, job: Job, knob: Knob) -> bool:
        """Whether the knob is not touched before its marker has been read."""
        assert job.scene is not None
        return job.kind == "set" or job.scene.control(knob.name).dimple is not None

    def _may_tell_by_lamp(self, job: Job) -> bool:
        """Whether the effect is looked for at a control that may have a lamp."""
        looked_for = job.knob is None and job.before is not None and self.config.effect_wait_s > 0
        return looked_for and job.touch is not None and job.touch.control not in self._world.lampless

    def _under(self, job: Job) -> bool:
        """Whether the stylus, though it is up, hides the control."""
        seen = None if self._world.seen is None or job.touch is None else self._world.seen.control(job.touch.control)
        return seen is not None and seen.hidden_by == "stylus"

    def _move_aside(self, job: Job, name: str) -> None:
        """Let the cameras see the whole control, wherever on it the stylus has been."""
        assert job.scene is not None
        control, config = job.scene.control(name), self.config
        top = job.scene.base_from_panel.apply(np.array([[*control.centre, control.height]]))
        by_m = config.aside_m + float(control.size[0]) / 2
        middle = job.aim.readings_at(top)[0, :2]
        self._try(job, Phase.ASIDE, lambda: motion_plan.aside(self._world.here, middle, by_m, config.motion))

    def _read_from_aside(self, job: Job) -> None:
        for_effect = job.knob is None and job.touched_ns
        self._enter(Phase.READ, self.config.effect_wait_s if for_effect else self.config.read_timeout_s)

    def _enter(self, phase: Phase, within_s: float) -> None:
        self.phase, self._phase_ns = phase, self._now_ns
        self._deadline_ns = self._now_ns + _nanoseconds(within_s)

    def _go(self, phase: Phase, path: Path) -> None:
        self._enter(phase, 1.5 * path.duration_s + self.config.motion_timeout_s)
        # Stamps identify trajectories, so two of one instant must differ.
        self._stamp_ns = max(self._now_ns, self._stamp_ns + 1)
        if len(path.points):
            self._end, self._arrived_ns = path.points[-1], None
            self._actions.append(msg.SendTrajectory(stamp_ns=self._stamp_ns, path=path))
        else:
            # The machine stands there already; joint_states younger than this moment confirm it.
            self._end, self._arrived_ns = self._world.here, self._now_ns

    def _look_at_hover(self, job: Job) -> None:
        config = self.config
        self._look(Phase.LOOK, config.settle_s, config.look_timeout_s, needed=config.tip_count, kept=config.tip_count)

    def _look_at_contact(self, job: Job) -> None:
        config = self.config
        job.down_ns = self._now_ns
        most_s = config.press_max_s
        if job.touch is not None and len(job.touch.arc):
            most_s = config.look_timeout_s
        elif job.kind in ("hold", "long"):
            most_s = job.hold_s
        # The machine came down slowly, stood for as long as its report took, and did not move sideways.
        self._look(Phase.CONTACT, 0.0, most_s, needed=config.contact_tip_count, kept=MAX_TIPS)

    def _look(self, phase: Phase, settle_s: float, timeout_s: float, *, needed: int, kept: int) -> None:
        self.phase = phase
        self._tip_look = Look(after_ns=self._now_ns + _nanoseconds(settle_s), needed=needed, kept=kept)
        self._deadline_ns = self._tip_look.after_ns + _nanoseconds(timeout_s)

    def _advance(self) -> None:
        """Find out whether the phase has ended and follow the table, until nothing more happens at this instant."""
        while self._job is not None:
            step = self._ended(self._job)
            if step is None:
                return
            self._NEXT[self.phase, step](self, self._job)

    def _ended(self, job: Job) -> Step | None:
        if self.phase is Phase.WAIT:
            return self._looked(job.touch is not None and job.touch.control not in self._world.hidden_ns)
        if self.phase is Phase.READ:
            return self._looked(self._effect_seen(job))
        if self.phase in LOOKING:
            if self.phase is Phase.CONTACT and self._now_ns < job.down_ns + _nanoseconds(job.hold_s):
                return None  # also when enough has been seen
            if self._seen_in_base(job) is not None:
                return Step.SEEN
            return Step.UNSEEN if self._now_ns > self._deadline_ns else None
        if self._arrived_ns is not None and self._standing():
            if job.fault is not None and self.phase is not Phase.BREAK_OFF:
                self._lift_after_fault(job)
                return None
            if self._check_arrival(job):
                return Step.ARRIVED
        elif self._now_ns > self._deadline_ns:
            wait_s = (self._now_ns - self._phase_ns) / NANO
            cause = f"no result of the motion from the driver for {wait_s:.1f} s"
            self._break_off(job, Fault(cause=cause, stop=True))
        return None

    def _looked(self, seen: bool) -> Step | None:
        return Step.SEEN if seen else Step.UNSEEN if self._now_ns > self._deadline_ns else None

    def _effect_seen(self, job: Job) -> bool:
        """Look for the effect since the way down, or for the marker or the lamp since the stylus has gone aside."""
        after = self._world.seen
        if after is None:
            return False
        still = after.stamp_ns > self._phase_ns + _nanoseconds(self.config.settle_s)
        if job.knob is None and not job.touched_ns:
            return still and not self._under(job)
        if job.knob is None:
            assert job.before is not None and job.touch is not None
            # Contact comes before the driver reports the end of the way down, and what it does may be seen as early.
            job.effect, told = effect(job.before, after, job.touch.control, job.plunge_ns)
            return told
        knob = after.control(job.knob.name)
        return still and knob is not None and not math.isnan(knob.angle_deg)

    def _standing(self) -> bool:
        # The driver's state and joints come on other topics than its result, in any order.
        assert self._arrived_ns is not None
        idle = self._world.driver == "idle" or self._now_ns > self._arrived_ns + NANO
        return idle and self._world.readings_ns > self._arrived_ns

    def _check_arrival(self, job: Job) -> bool:
        assert self._end is not None
        off = float(np.linalg.norm(self._world.here - self._end))
        if off <= self.config.arrival_tolerance_m:
            return True
        cause = (
            f"the driver reports the end of the motion {1000 * off:.2f} mm beside it, "
            f"{1000 * self.config.arrival_tolerance_m:g} mm are allowed"
        )
        self._break_off(job, Fault(cause=cause, lift=False, stop=self._extended))
        return False

    # Look, judge, correct, touch

    def _seen_in_base(self, job: Job) -> Array | None:
        assert job.scene is not None
        base_from_camera = self._world.base_from_camera(job.scene, self.config)
        return None if base_from_camera is None else self._tip_look.seen(base_from_camera, self.config.tip_spread_m)

    def _judge_hover(self, job: Job) -> None:
        seen = self._seen_in_base(job)
        assert seen is not None
        error = seen - job.tip_goal()
        job.hover_error_m = float(np.linalg.norm(error[:2]))
        match judge(error, job.aim, self.config):
            case None:
                self._touch_or_return(job)
            case Fault() as fault:
                self._break_off(job, fault)
            case aim:
                job.aim = aim
                place = aim.readings_at(job.tip_goal()[np.newaxis])[0, :2]
                self._try(job, Phase.CORRECT, lambda: motion_plan.shift(self._world.here, place, self.config.motion))

    def _unseen_hover(self, job: Job) -> None:
        if not self.config.require_servo:
            self._touch_down(job)
            return
        assert job.touch is not None and job.scene is not None
        job.beside = places_beside(job.touch, job.scene, job.aim, self.config) if job.beside is None else job.beside[1:]
        if job.beside:
            self._try(job, Phase.APPROACH, lambda: self._way_to(job))
        else:
            self._break_off(job, Fault(cause=self._tip_look.unseen_text(self.config.tip_spread_m)))

    def _touch_or_return(self, job: Job) -> None:
        """Touch, or first go from beside to above the target, with the correction that was found there."""
        if job.beside:
            job.beside, job.measured_beside = [], True
            self._try(job, Phase.RETURN, lambda: self._way_to(job))
        else:
            self._touch_down(job)

    def _touch_down(self, job: Job) -> None:
        assert job.touch is not None
        depth, config = -job.touch.touch_z, self.config
        here = self._world.here
        job.plunge_ns = self._now_ns
        job.touched_ns = job.touched_ns or self._now_ns
        if job.kind == "double":
            between = config.motion.stylus_max_m if config.motion.stylus_two_positions else config.double_lift_m
            self._try(job, Phase.TOUCH, lambda: motion_plan.plunge_twice(here, depth, between, config.motion))
        else:
            self._try(job, Phase.TOUCH, lambda: motion_plan.plunge(here, depth, config.motion))

    def _leave_contact(self, job: Job) -> None:
        self._tip_look = replace(self._tip_look, until_ns=self._now_ns)
        assert job.touch is not None
        if not len(job.touch.arc):
            self._lift(job)
        elif complaint := self._measure_contact(job):
            # A knob is turned, or a touch drawn on, only from a place that is known to be right.
            self._break_off(job, Fault(cause=complaint))
        else:
            if job.knob is not None:
                job.knob.turns += 1
            arc = job.aim.readings_at(job.touch.arc)
            motion = self.config.motion
            speed = motion.drag_speed_m_s if job.kind == "drag" else motion.turn_speed_m_s
            self._try(job, Phase.TURN, lambda: motion_plan.follow(self._world.here, arc, speed, motion))

    def _measure_contact(self, job: Job) -> str:
        """Measure the error at contact; return what is wrong with it, empty for nothing."""
        assert job.touch is not None
        seen, above_m = self._seen_in_base(job), math.nan
        if seen is not None:
            off = seen - job.touch.in_base
            job.error_m, job.measured_beside = float(np.linalg.norm(off[:2])), False
            above_m = float(off[2]) - self.config.touch.ball_radius_m
        elif job.measured_beside:
            job.error_m = job.hover_error_m
        return contact_complaint(job.error_m, above_m, self._tip_look, self.config)

    def _wait_for_pictures(self, job: Job) -> None:
        self._enter(Phase.MEASURE, self.config.picture_wait_s)

    def _judge_contact(self, job: Job) -> None:
        assert job.touch is not None
        if complaint := self._measure_contact(job):
            self._finish(job, Outcome.ABORTED, f"{complaint}; the stylus is up")
        elif job.knob is not None and not math.isnan(job.knob.goal_deg):
            self._move_aside(job, job.knob.name)
        elif job.knob is None and job.before is not None and job.touch.control and self.config.effect_wait_s > 0:
            self._enter(Phase.READ, self.config.effect_wait_s)
        else:
            self._finish(job, Outcome.REACHED)

    def _judge_effect(self, job: Job) -> None:
        assert job.touch is not None
        if job.knob is not None:
            self._judge_knob(job, job.knob)
        elif not job.touched_ns:
            self._try(job, Phase.APPROACH, lambda: self._way_to(job))
        elif not job.effect and not job.went_aside and self._hides_lamp(job):
            job.went_aside = True
            self._move_aside(job, job.touch.control)
        elif job.effect or not self.config.require_effect:
            job.effect = job.effect or "none seen"
            self._finish(job, Outcome.REACHED)
        else:
            wait_s = self.config.effect_wait_s
            self._finish(job, Outcome.ABORTED, f"touched, but no effect was seen within {wait_s:g} s; the stylus is up")

    def _hides_lamp(self, job: Job) -> bool:
        """Whether the stylus, though it is up, still hides the lamp that may tell the effect."""
        assert job.before is not None and job.touch is not None
        before = job.before.control(job.touch.control)
        return before is not None and before.lamp != "" and self._under(job)

    def _judge_knob(self, job: Job, knob: Knob) -> None:
        seen = None if self._world.seen is None else self._world.seen.control(knob.name)
        angle = math.nan if seen is None or not self._effect_seen(job) else seen.angle_deg
        if math.isnan(angle) and not knob.turns and not self._needs_marker(job, knob):
            self._try(job, Phase.APPROACH, lambda: self._way_to(job))  # it has no marker, perhaps: turned once, unseen
            return
        if math.isnan(angle):
            wait_s = self.config.read_timeout_s
            cause = f"the marker of {knob.name} was not seen within {wait_s:g} s"
            self._finish(job, Outcome.ABORTED, f"{cause}; the stylus is up")
            return
        knob.look(angle)
        allowed = self.config.set_tolerance_deg
        if abs(knob.off_deg) <= allowed and (knob.turns or job.kind == "set"):
            job.effect = f"{knob.name} at {angle:+.1f} degrees"
            self._finish(job, Outcome.REACHED)
        elif knob.turns >= self.config.set_tries:
            reason = (
                f"{knob.name} stands {abs(knob.off_deg):.1f} degrees off after {knob.turns} turns, "
                f"{allowed:g} are allowed; the stylus is up"
            )
            self._finish(job, Outcome.ABORTED, reason)
        else:
            self._turn_again(job)

    def _turn_again(self, job: Job) -> None:
        assert job.gesture is not None and job.scene is not None
        job.aim, job.error_m = Aim(base_from_reading=job.aim.base_from_reading), math.nan
        try:
            job.touch = goal_intake.find_touch(job.gesture, job.knob, job.scene, self.config)
        except (Refused, OutOfReach) as error:
            self._finish(job, Outcome.ABORTED, f"the next turn: {error}; the stylus is up")
            return
        self._try(job, Phase.APPROACH, lambda: self._way_to(job))

    def _lift(self, job: Job) -> None:
        self._go(Phase.LIFT, motion_plan.lift(self._world.here, self.config.motion))

    def _try(self, job: Job, phase: Phase, plan: Callable[[], Path]) -> None:
        """Enter a phase whose path may leave the reachable area because of a correction."""
        try:
            path = plan()
        except OutOfReach as error:
            self._break_off(job, Fault(cause=f"corrected aim: {error}"))
            return
        self._go(phase, path)

    # Ends

    def _finish_move(self, job: Job) -> None:
        readings = self._world.here
        at = np.array([*(job.aim.base_from_reading @ readings[:2]), -readings[2]])
        job.error_m = float(np.linalg.norm(at - job.goal_base()))
        self._finish(job, Outcome.REACHED)

    def _finish_hidden(self, job: Job) -> None:
        assert job.touch is not None
        cause = f"something (a hand?) hides {job.touch.control}, and did so for {self.config.hidden_wait_s:g} s"
        self._finish(job, Outcome.ABORTED, f"{cause}; nothing was moved")

    def _finish_broken_off(self, job: Job) -> None:
        assert job.fault is not None
        self._abort(job, f"{job.fault.cause}; the stylus is up")

    def _abort(self, job: Job, reason: str) -> None:
        """End a goal that was broken off: who presses once more what has acted presses twice."""
        if job.touched_ns and not reason.startswith("touched"):
            reason = f"{reason}; the stylus had gone down: look at the panel before trying again"
        self._finish(job, Outcome.ABORTED, reason)

    def _fault(self, job: Job) -> Fault | None:
        """Return what ends the goal early, if anything; asked after every event."""
        pushing, crossing = self.phase in PUSHING, self.phase not in STANDING
        fault = self._world.machine_fault(self.config, pushing=pushing)
        if fault is not None or job.touch is None or self.phase in UP:
            return fault
        assert job.scene is not None
        if self.phase in FREE_VIEW and (fault := self._world.view_fault(self.config, job.touch.control)) is not None:
            return fault
        return self._world.sight_fault(self.config, job.scene, job.touch.in_panel, pushing=pushing, crossing=crossing)

    def _break_off(self, job: Job, fault: Fault) -> None:
        """End the goal early: hold the machine, or let a motion in the air end and retract, or only report."""
        cause = fault.cause if job.fault is None else f"{job.fault.cause}; then {fault.cause}"
        if fault.stop:
            self._actions.append(msg.CallStop(reason=cause))
            self._abort(job, f"{cause}; the machine was told to stop")
        elif not fault.lift or job.fault is not None:
            self._abort(job, f"{cause}; nothing more was moved")
        else:
            job.fault = fault
            if self.phase not in MOVING:
                self._lift_after_fault(job)

    def _lift_after_fault(self, job: Job) -> None:
        self._go(Phase.BREAK_OFF, motion_plan.lift(self._world.here, self.config.motion))

    def _finish(self, job: Job, outcome: Outcome, reason: str = "") -> None:
        if outcome is Outcome.REACHED and job.measured_beside:
            reason = "the tip was measured beside the target, as it could not be seen before it"
        self.phase = Phase.IDLE
        self._job = None
        self._publish(job, outcome, reason)

    def _publish(self, job: Job, outcome: Outcome, reason: str = "") -> None:
        self.counts[outcome] += 1
        self._actions.append(msg.PublishResult(result=job.result(outcome, reason, self._now_ns)))

    def _reject(self, goal_id: str, text: str, reason: str) -> None:
        self.counts[Outcome.REJECTED] += 1
        result = GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=reason)
        self._actions.append(msg.PublishResult(result=result))


def _nanoseconds(seconds: float) -> int:
    return round(seconds * NANO)


def _id_in(text: str) -> str:
    """Return the id of a command that is otherwise wrong, so that who asked finds the answer; else its text."""
    _, found, identifier = text.partition(" id=")
    return identifier.strip()[:64] if found and identifier.strip() else text[:200]
