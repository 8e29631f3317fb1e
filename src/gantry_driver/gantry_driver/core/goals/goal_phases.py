"""The phases of a goal: what each one does when the previous one has ended; the table lists every transition."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from gantry_driver.core.goals import goal_intake
from gantry_driver.core.goals.contact_phases import ContactPhases
from gantry_driver.core.goals.goal_run import nanoseconds
from gantry_driver.core.goals.obstacles import obstacles
from gantry_driver.core.goals.servo import judge, misplaced, places_beside
from gantry_driver.core.goals.touch_checks import contact_finding
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.effects import NONE_SEEN, Effect, EffectKind, Knob, effect, knob_of
from gantry_driver.core.job.goal_job import LOOKING, NANO, Aim, Fault, Job, Phase, Step
from gantry_driver.core.motion import motion_plan
from gantry_driver.core.motion.motion_plan import OutOfReach
from gantry_driver.core.motion.scene import Refused
from icu_common.core.goals.results import Felt, Outcome
from icu_common.core.reasons.message import Message


class GoalPhases(ContactPhases):
    """Carries out the phases of a goal: look, touch, verify."""

    # Every transition of a goal. A method either enters another phase or finishes the goal.
    _NEXT: ClassVar[dict[tuple[Phase, Step], Callable[[GoalPhases, Job], None]]] = {
        (Phase.MOVE, Step.ARRIVED): lambda self, job: self._finish_move(job),
        (Phase.SIGHT, Step.SEEN): lambda self, job: self._plan_in_sight(job),
        (Phase.SIGHT, Step.UNSEEN): lambda self, job: self._plan_in_sight(job),
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

    def _advance(self) -> None:
        """Follow the table while the current phase has ended."""
        while self._job is not None:
            step = self._ended(self._job)
            if step is None:
                return
            self._NEXT[self.phase, step](self, self._job)

    def _ended(self, job: Job) -> Step | None:
        if self.phase is Phase.SIGHT:
            return self._looked(job, self._may_plan())
        if self.phase is Phase.WAIT:
            return self._looked(job, job.touch is not None and job.touch.control not in self._world.hidden_ns)
        if self.phase is Phase.READ:
            return self._looked(job, self._effect_seen(job))
        if self.phase in LOOKING:
            if self.phase is Phase.CONTACT and self._holds(job):
                return None
            # No touch while images that may show an obstacle are late.
            timely = self.phase is not Phase.LOOK or not self._view_delays()
            timely = timely and (self.phase is not Phase.LOOK or self._tip_look.precise(self.config.tip_sigma_m))
            return self._looked(job, timely and self._seen_in_base(job) is not None)
        if self._arrived_ns is not None and self._standing():
            if job.fault is not None and self.phase is not Phase.BREAK_OFF:
                self._lift_after_fault(job)
                return None
            if self._check_arrival(job):
                return Step.ARRIVED
        elif self._now_ns > self._deadline_ns:
            wait_s = (self._now_ns - self._phase_ns) / NANO
            cause = Message("goal.no_result_motion_driver", wait_s=wait_s)
            self._break_off(job, Fault(cause=cause, stop=True))
        return None

    # Start

    def _start(self, job: Job) -> None:
        """Begin at once, or wait until the panel is seen, or until nothing hides the control any more."""
        if job.unplanned:
            self._enter(Phase.SIGHT, self.config.look_timeout_s)
            return
        self._actions.append(msg.ShowTarget(in_base=job.goal_base()))
        self._aim_lower(job)
        if job.touch is not None and job.touch.control in self._world.hidden_ns:
            self._enter(Phase.WAIT, self.config.hidden_wait_s)
        else:
            self._begin(job)

    def _may_plan(self) -> bool:
        """Whether the panel and its controls have been seen from here, or will not be seen."""
        world = self._world
        found = list(obstacles(world, self.config))
        if found:
            return not all(obstacle.passing for obstacle in found)
        return world.seen is None or world.from_here(world.seen.stamp_ns, self.config)

    def _plan_in_sight(self, waiting: Job) -> None:
        """Plan the goal as if it came now; its sender already has the first answer."""
        assert waiting.gesture is not None
        try:
            for obstacle in sorted(obstacles(self._world, self.config), key=lambda o: o.passing):
                raise Refused(obstacle.reason, obstacle.delay)
            job = goal_intake.gesture_job(waiting.gesture, waiting.text, waiting.goal_id, self._world, self.config)
            self._way_to(job)
        except (Refused, OutOfReach) as error:
            delay = error.delay if isinstance(error, Refused) else None
            self._finish(waiting, Outcome.ABORTED, Message("goal.nothing_moved", error=error), delay)
            return
        job.started_ns = waiting.started_ns
        self._job = job
        self._start(job)

    def _begin(self, job: Job) -> None:
        knob = job.knob
        if (fault := self._rests_misplaced(job)) is not None:
            reason = Message("goal.stylus_may_bent_another_one", cause=fault.cause)
            self._finish(job, Outcome.ABORTED, reason)
        elif knob is not None and self._is_to_be_read(job, knob):
            self._move_aside(job, knob.name)
        elif self._may_tell_by_lamp(job) and self._out_of_view(job):
            assert job.touch is not None
            self._move_aside(job, job.touch.control)
        elif knob is not None and job.kind == "set" and abs(knob.off_deg) <= self.config.set_tolerance_deg:
            self._finish(job, Outcome.REACHED)
        else:
            self._try(job, Phase.MOVE if job.touch is None else Phase.APPROACH, lambda: self._way_to(job))

    def _begin_anew(self, job: Job) -> None:
        """Begin with the current state: a knob hidden at acceptance may be readable, or a hand may have turned it."""
        if job.knob is not None:
            assert job.gesture is not None and job.scene is not None and self._world.seen is not None
            name = job.knob.name
            try:
                job.knob = knob_of(job.gesture, name, self._world.seen.control(name))
                job.touch = goal_intake.find_touch(job.gesture, job.knob, job.scene, self.config)
            except (Refused, OutOfReach) as error:
                self._finish(job, Outcome.ABORTED, Message("goal.nothing_moved", error=error))
                return
        self._begin(job)

    def _rests_misplaced(self, job: Job) -> Fault | None:
        """Return the fault of a tip seen at rest: a tip that is too low would press before the first look."""
        if job.scene is None:
            return None
        base_from_camera = self._world.base_from_camera(job.scene, self.config)
        seen = None if base_from_camera is None else self._rest_look.seen(base_from_camera, self.config.tip_spread_m)
        if seen is None:
            return None
        x, y = job.aim.base_from_reading @ self._world.here[:2]
        return misplaced(seen - (x, y, -self._world.here[2]), self.config)

    def _needs_marker(self, job: Job, knob: Knob) -> bool:
        """Whether the knob's marker must be read before a touch."""
        assert job.scene is not None
        return job.kind == "set" or job.scene.control(knob.name).dimple is not None

    def _is_to_be_read(self, job: Job, knob: Knob) -> bool:
        """Whether to move aside first to read the knob's marker."""
        return math.isnan(knob.seen_deg) and (self._needs_marker(job, knob) or self._out_of_view(job))

    def _may_tell_by_lamp(self, job: Job) -> bool:
        """Whether the goal looks for an effect, and its control may have a lamp."""
        looked_for = job.knob is None and job.before is not None and self.config.effect_wait_s > 0
        return looked_for and job.touch is not None and job.touch.control not in self._world.lampless

    def _out_of_view(self, job: Job) -> bool:
        """Whether the retracted stylus hides the control, or the control is outside the image."""
        seen = None if self._world.seen is None or job.touch is None else self._world.seen.control(job.touch.control)
        return seen is not None and seen.hidden_by in ("stylus", "edge")

    def _move_aside(self, job: Job, name: str) -> None:
        """Move the stylus aside so that the cameras see the whole control."""
        assert job.scene is not None
        control, config = job.scene.control(name), self.config
        top = job.scene.base_from_panel.apply(np.array([[*control.centre, control.height]]))
        by_m = config.aside_m + float(control.size[0]) / 2
        middle = job.aim.readings_at(top)[0, :2]
        self._try(job, Phase.ASIDE, lambda: motion_plan.aside(self._world.here, middle, by_m, config.motion))

    def _read_from_aside(self, job: Job) -> None:
        if job.knob is None and job.touched_ns:
            self._look_for_effect()
        else:
            self._enter(Phase.READ, self.config.read_timeout_s)

    def _look_for_effect(self) -> None:
        """Evaluate the images of ``effect_wait_s``, which may be up to ``read_timeout_s`` late on a busy computer."""
        self._enter(Phase.READ, self.config.effect_wait_s + self.config.read_timeout_s)

    def _finish_move(self, job: Job) -> None:
        readings = self._world.here
        self._entered_xy = job.aim.readings_at(job.tip_goal()[np.newaxis])[0, :2]
        at = np.array([*(job.aim.base_from_reading @ readings[:2]), -readings[2]])
        job.error_m = float(np.linalg.norm(at - job.goal_base()))
        self._finish(job, Outcome.REACHED)

    def _finish_hidden(self, job: Job) -> None:
        assert job.touch is not None
        cause = Message(
            "goal.something_hand_still_hides_after", control=job.touch.control, hidden_wait_s=self.config.hidden_wait_s
        )
        self._finish(job, Outcome.ABORTED, Message("goal.nothing_moved", error=cause))

    # Look, judge, correct, touch

    def _look_at_hover(self, job: Job) -> None:
        config = self.config
        most = max(config.tip_count, config.tip_count_max)
        self._look(Phase.LOOK, config.settle_s, config.look_timeout_s, needed=config.tip_count, kept=most)

    def _judge_hover(self, job: Job) -> None:
        seen = self._seen_in_base(job)
        assert seen is not None
        error = self._error_above(job, seen)
        job.pair = self._world.pair
        match judge(error, job.aim, self.config):
            case None:
                fault = self._take_air(job, seen)
                if fault is None:
                    self._touch_or_return(job)
                else:
                    self._break_off(job, fault)
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
        if self._late is not None:  # images from next to the target would be as late
            unseen = self._tip_look.unseen_text(self.config.tip_spread_m)
            cause = Message("text.more", first=unseen, second=self._late.text())
            self._break_off(job, Fault(cause=cause, delay=self._late))
            return
        job.beside = places_beside(job.touch, job.scene, job.aim, self.config) if job.beside is None else job.beside[1:]
        if job.beside:
            self._try(job, Phase.APPROACH, lambda: self._way_to(job))
        else:
            self._break_off(job, Fault(cause=self._tip_look.unseen_text(self.config.tip_spread_m)))

    def _touch_or_return(self, job: Job) -> None:
        """Touch; after a look from next to the target, first move above the target with the correction found there."""
        if job.beside:
            job.beside, job.measured_beside = [], True
            self._try(job, Phase.RETURN, lambda: self._way_to(job))
        else:
            self._touch_down(job)

    def _wait_for_pictures(self, job: Job) -> None:
        self._enter(Phase.MEASURE, self.config.picture_wait_s)

    def _judge_contact(self, job: Job) -> None:
        assert job.touch is not None
        # Cameras on the carriage have moved along the arc, so their pose now is not that of the measurement.
        gone_along = self.config.camera_on_carriage and len(job.touch.arc) > 0
        if not gone_along and (fault := self._measure_contact(job)) is not None:
            code = self._note_free(job)
            cause = Message("text.and_also", first=self._unfelt_text(job), second=fault.cause) if code else fault.cause
            self._finish(job, Outcome.ABORTED, Message("stylus.is_up", cause=cause), code=code)
            return
        if not gone_along and (finding := contact_finding(job, self._world, self.config)) is not None:
            job.felt = Felt.UNKNOWN
            reason = Message("goal.touched_but_not_confirmed_stylus", finding=finding.text())
            self._finish(job, Outcome.ABORTED, reason, finding, code=finding.code.value)
            return
        if not gone_along:
            self._judge_lag(job)
        if job.knob is not None and not math.isnan(job.knob.goal_deg):
            self._move_aside(job, job.knob.name)
        elif job.knob is None and job.before is not None and job.touch.control and self.config.effect_wait_s > 0:
            self._look_for_effect()
        else:
            self._finish_touch(job)

    # Verification

    def _effect_seen(self, job: Job) -> bool:
        """Look for an effect since the descent, or for the marker or the lamp since the stylus moved aside."""
        after = self._world.seen
        if after is None:
            return False
        still = after.stamp_ns > self._phase_ns + nanoseconds(self.config.settle_s)
        if job.knob is None and not job.touched_ns:
            return still and not self._out_of_view(job)
        if job.knob is None:
            assert job.before is not None and job.touch is not None
            # Contact, and so its effect, may precede the driver's report that the descent has ended.
            job.effect, told = effect(job.before, after, job.touch.control, job.plunge_ns, job.left_ns)
            late = after.stamp_ns > self._phase_ns + nanoseconds(self.config.effect_wait_s)
            # Cameras on the carriage have moved aside as well, and must locate the panel again from there.
            return told or (late and not (job.went_aside and self._out_of_view(job)))
        knob = after.control(job.knob.name)
        return still and knob is not None and not math.isnan(knob.angle_deg)

    def _judge_effect(self, job: Job) -> None:
        assert job.touch is not None
        if job.knob is not None:
            self._judge_knob(job, job.knob)
        elif not job.touched_ns:
            self._try(job, Phase.APPROACH, lambda: self._way_to(job))
        elif not job.went_aside and self._hides_lamp(job) and (job.effect is None or not job.effect.of_control):
            job.went_aside = True
            self._move_aside(job, job.touch.control)
        elif job.effect or not self.config.require_effect:
            job.effect = job.effect or self._unread(job) or NONE_SEEN
            self._finish_touch(job)
        else:
            wait_s, unread = self.config.effect_wait_s, self._unread(job)
            reason = Message("goal.touched_but_no_effect_seen", wait_s=wait_s)
            if unread is not None:
                reason = Message("goal.touched_but_effect_stylus_up", unread=unread.text)
            self._finish(job, Outcome.ABORTED, reason)

    def _unread(self, job: Job) -> Effect | None:
        """Return the effect "not seen" if no image of the panel was read since the touch, else None."""
        if self._world.seen is not None and self._world.seen.stamp_ns > job.left_ns:
            return None
        for_s = (self._now_ns - job.left_ns) / NANO
        text = Message("goal.not_seen_nothing_read_panel", for_s=for_s)
        return Effect(kind=EffectKind.UNREAD, text=text)

    def _hides_lamp(self, job: Job) -> bool:
        """Whether the lamp that may show the effect is still out of view although the stylus is up."""
        assert job.before is not None and job.touch is not None
        before = job.before.control(job.touch.control)
        return before is not None and before.lamp != "" and self._out_of_view(job)

    def _judge_knob(self, job: Job, knob: Knob) -> None:
        seen = None if self._world.seen is None else self._world.seen.control(knob.name)
        angle = math.nan if seen is None or not self._effect_seen(job) else seen.angle_deg
        if math.isnan(angle) and not knob.turns and not self._needs_marker(job, knob):
            self._try(job, Phase.APPROACH, lambda: self._way_to(job))  # it may have no marker: turn it once, unseen
            return
        if math.isnan(angle):
            wait_s = self.config.read_timeout_s
            cause = Message("goal.marker_not_seen_within", knob=knob.name, wait_s=wait_s)
            self._finish(job, Outcome.ABORTED, Message("stylus.is_up", cause=cause))
            return
        knob.look(angle)
        allowed = self.config.set_tolerance_deg
        if abs(knob.off_deg) <= allowed and (knob.turns or job.kind == "set"):
            job.effect = Effect(kind=EffectKind.KNOB, text=Message("goal.degrees", knob=knob.name, angle_deg=angle))
            if job.touched_ns:
                self._finish_touch(job)
            else:
                self._finish(job, Outcome.REACHED)
        elif knob.turns >= self.config.set_tries:
            reason = Message(
                "goal.stands_degrees_off_after_turns",
                knob=knob.name,
                off_deg=abs(knob.off_deg),
                turns=knob.turns,
                allowed=allowed,
            )
            self._finish(job, Outcome.ABORTED, reason)
        else:
            self._turn_again(job)

    def _turn_again(self, job: Job) -> None:
        assert job.gesture is not None and job.scene is not None
        job.aim, job.error_m = Aim(base_from_reading=job.aim.base_from_reading), math.nan
        self._aim_lower(job)
        try:
            job.touch = goal_intake.find_touch(job.gesture, job.knob, job.scene, self.config)
        except (Refused, OutOfReach) as error:
            self._finish(job, Outcome.ABORTED, Message("goal.next_turn_stylus_up", error=error))
            return
        self._try(job, Phase.APPROACH, lambda: self._way_to(job))
