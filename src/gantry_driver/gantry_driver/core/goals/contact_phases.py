"""The phases of a touch: go down, look at the contact, press further, and evaluate the evidence."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gantry_driver.core.contact.lag import Lag, height_of, lag_between
from gantry_driver.core.contact.press import ENVELOPE_SPARE_M, ContactCode, next_extension_m, verdict
from gantry_driver.core.envelope.rules import SIGMAS
from gantry_driver.core.goals.goal_run import GoalRun, nanoseconds
from gantry_driver.core.goals.servo import contact_fault
from gantry_driver.core.goals.touch_checks import note_error, touch_finding
from gantry_driver.core.job.effects import EffectKind
from gantry_driver.core.job.goal_job import Fault, Job, Phase
from gantry_driver.core.motion import motion_plan
from gantry_driver.core.motion.touch_error import ray_at
from gantry_driver.core.sight.tip_noise import combined, sideways
from icu_common.core.geometry.geometry import Array
from icu_common.core.goals.results import Felt, Outcome
from icu_common.core.reasons.message import Message, joined

MAX_TIPS = 50
PLANE_SIGMA_MAX_M = 0.0005
"""Maximum standard deviation of the panel's plane whose margin a press uses, as the driver's ``max_sigma_m``."""


class ContactPhases(GoalRun):
    """Lowers the stylus until something stops the ball, and reports whether a contact was felt."""

    # In the air

    def _aim_lower(self, job: Job) -> None:
        """Correct the extension of a touch by the stylus's height in earlier looks."""
        self.heights.config = self.config.contact
        if job.touch is not None and not self.config.motion.stylus_two_positions:
            job.aim = replace(job.aim, lower_m=self.heights.stylus.value_m)

    def _error_above(self, job: Job, seen: Array) -> Array:
        """Return the error (3,) of a tip seen above its target, without the part that its reading disproves."""
        assert job.touch is not None and job.scene is not None
        error, config = seen - job.tip_goal(), self.config
        ray = ray_at(seen, job.scene, self._world.pair)
        if not (config.motion.stylus_two_positions or config.camera_on_carriage):
            offset_m = float(seen[2] + self._world.here[2])
            height_m = self.tips.take_height(offset_m, self._world.height_correction_m())
            error[:2] -= sideways(ray, height_m)
        job.aim = job.aim.looked(error[:2], config.look_agreement_m)
        covariance = self.tips.in_air(ray, job.aim.looks)
        job.above = job.aim.rest(), covariance
        job.hover_error_m = float(np.linalg.norm(job.above[0]))
        note_error(job, *job.above, self._world, config)
        return error

    def _take_air(self, job: Job, seen: Array) -> Fault | None:
        """Take the last look before a touch as the baseline of its descent; correct the stylus's offset."""
        tips = self._tips_in_base(job)
        job.air = height_of(seen[np.newaxis] if tips is None else tips, float(self._world.here[2]))
        if self.config.motion.stylus_two_positions:
            return None
        contact = self.config.contact
        sigma = lag_between(job.air, job.air, contact).sigma_m / math.sqrt(2.0)
        offset_m, correction_m = job.air.seen_m + job.air.extension_m, self._world.height_correction_m()
        finding = self.heights.looked(offset_m, sigma, correction_m)
        job.findings += () if finding is None else (finding,)
        job.aim = replace(job.aim, lower_m=self.heights.stylus.value_m)
        if abs(self.heights.stylus.value_m) <= contact.height.max_offset_m:
            return None
        off_mm, limit_mm = 1000.0 * self.heights.stylus.value_m, 1000.0 * contact.height.max_offset_m
        cause = Message("contact.stylus_off_height_readings_say", off_mm=off_mm, limit_mm=limit_mm)
        self.heights.forget(correction_m)  # a rejection must not make the next one certain
        return Fault(cause=Message("contact.calibrate_again", cause=cause), code=ContactCode.STYLUS_OFFSET.value)

    # Down

    def _touch_down(self, job: Job) -> None:
        assert job.touch is not None
        if not job.touched_ns and (delays := self._view_delays()):
            cause = Message("contact.nothing_touched_late_images", delays=delays[0].text())
            self._break_off(job, Fault(cause=cause, delay=delays[0]))
            return
        if not job.touched_ns and (finding := touch_finding(job, self._world, self.config)) is not None:
            self._break_off(job, Fault(cause=finding.text(), delay=finding))
            return
        config, here = self.config, self._world.here
        job.plunge_ns, job.pressed_ns, job.lag = self._now_ns, 0, None
        job.touched_ns = job.touched_ns or self._now_ns
        self.switch.goes_down()
        depth = self._first_extension(job)
        if job.kind == "double":
            between = config.motion.stylus_max_m if config.motion.stylus_two_positions else config.double_lift_m
            self._try(job, Phase.TOUCH, lambda: motion_plan.plunge_twice(here, depth, between, config.motion))
        else:
            self._try(job, Phase.TOUCH, lambda: motion_plan.plunge(here, depth, config.motion))

    def _first_extension(self, job: Job) -> float:
        """Return the extension of the first descent, and note the expected height of the surface."""
        assert job.touch is not None
        touch, config = job.touch, self.config
        on_surface = np.array([*touch.in_base[:2], touch.in_base[2] + config.touch.ball_radius_m])
        job.surface_m = float(job.aim.readings_at(on_surface[np.newaxis])[0, 2])
        if config.motion.stylus_two_positions:
            return -touch.touch_z
        usual = config.contact.key_travel_m if touch.key else config.touch.overtravel_m
        travel = self.heights.travel_m(touch.control, touch.key, usual)
        return min(job.surface_m + travel, self._deepest(job))

    def _deepest(self, job: Job) -> float:
        """Return the maximum extension of a press here, by its travel and by the space that the driver allows."""
        config, plane = self.config, self._world.plane
        deepest = job.surface_m + config.contact.max_travel_m
        if plane is None:
            return deepest
        x, y = (float(v) for v in self._world.here[:2])
        margin = SIGMAS * min(plane.sigma_m(x, y), PLANE_SIGMA_MAX_M) - ENVELOPE_SPARE_M
        return min(deepest, plane.contact_m(x, y) + config.touch.overtravel_m + max(margin, 0.0))

    # In contact

    def _look_at_contact(self, job: Job) -> None:
        config = self.config
        job.down_ns = self._now_ns
        job.pressed_ns = job.pressed_ns or self._now_ns
        job.contact_m = float(self._world.here[2])
        most_s = config.press_max_s
        if job.touch is not None and len(job.touch.arc):
            most_s = config.look_timeout_s
        elif job.kind in ("hold", "long"):
            most_s = max(job.hold_s, config.press_max_s)
        # The machine came down slowly, was at rest for the duration of its report, and did not move sideways.
        self._look(Phase.CONTACT, 0.0, most_s, needed=config.contact_tip_count, kept=MAX_TIPS)

    def _holds(self, job: Job) -> bool:
        """Whether the contact continues although enough images were seen, because the press goes no deeper."""
        since_ns = job.down_ns if job.kind in ("hold", "long") else job.pressed_ns
        within = self._now_ns < since_ns + nanoseconds(job.hold_s)
        return (within or self._undecided(job)) and self._deeper(job) is None

    def _undecided(self, job: Job) -> bool:
        """Whether more images of a contact may still decide whether anything was touched."""
        config = self.config
        if job.kind != "press" or job.touch is None or job.air is None or self.switch.closed:
            return False
        most_s = config.press_max_s if job.touch.key else config.decide_max_s
        if config.motion.stylus_two_positions or self._now_ns >= job.pressed_ns + nanoseconds(most_s):
            return False
        lag = self._measured_lag(job)
        return lag is not None and not lag.stopped(config.contact) and not lag.free(config.contact)

    def _deeper(self, job: Job) -> float | None:
        """Return the extension of the next step, None at the end of the press."""
        config = self.config
        if config.motion.stylus_two_positions or job.kind == "double" or job.air is None:
            return None
        brief = job.kind == "press" and self._now_ns > job.pressed_ns + nanoseconds(config.press_max_s)
        lag = None if brief or self.switch.closed else self._measured_lag(job)
        return None if lag is None else next_extension_m(job.contact_m, self._deepest(job), lag, config.contact)

    def _leave_contact(self, job: Job) -> None:
        assert job.touch is not None
        if (deeper := self._deeper(job)) is not None:
            here, motion = self._world.here, self.config.motion
            self._try(job, Phase.TOUCH, lambda: motion_plan.plunge(here, deeper, motion))
            return
        self._tip_look = replace(self._tip_look, until_ns=self._now_ns)
        job.lag = self._measured_lag(job)
        if not len(job.touch.arc):
            self._lift(job)
        elif (fault := self._measure_contact(job)) is not None:
            # A turn or a drag starts only from a measured position.
            self._break_off(job, fault)
        elif job.lag is not None and not job.lag.stopped(self.config.contact) and not self.switch.closed:
            job.felt = Felt.NOT_TOUCHED if job.lag.free(self.config.contact) else Felt.UNKNOWN
            self._break_off(job, Fault(cause=self._unfelt_text(job), code=_code_of(job.felt)))
        else:
            if job.knob is not None:
                job.knob.turns += 1
            arc = job.aim.readings_at(job.touch.arc)
            if not self.config.motion.stylus_two_positions:
                first = -job.touch.touch_z + job.aim.lower_m
                arc[:, 2] += job.contact_m - first  # at the depth of the contact
            motion = self.config.motion
            speed = motion.drag_speed_m_s if job.kind == "drag" else motion.turn_speed_m_s
            self._try(job, Phase.TURN, lambda: motion_plan.follow(self._world.here, arc, speed, motion))

    def _tips_in_base(self, job: Job) -> Array | None:
        """Return the tips (N, 3) of the current look in base_link, None while their position there is unknown."""
        assert job.scene is not None
        base_from_camera = self._world.base_from_camera(job.scene, self.config)
        if base_from_camera is None or not self._tip_look.tips:
            return None
        return base_from_camera.apply(np.array(self._tip_look.tips))

    def _measured_lag(self, job: Job) -> Lag | None:
        """Return the ball's lag behind its drive; None until it has been measured here and in the air."""
        if job.air is None or self._seen_in_base(job) is None:
            return None
        tips = self._tips_in_base(job)
        return None if tips is None else lag_between(job.air, height_of(tips, job.contact_m), self.config.contact)

    def _measure_contact(self, job: Job) -> Fault | None:
        """Measure the error at contact; return its fault, if any."""
        assert job.touch is not None
        seen, above_m = self._seen_in_base(job), math.nan
        if seen is not None:
            off = seen - job.touch.in_base
            error, covariance = self._error_in_contact(job, seen, off[:2])
            job.error_m, job.measured_beside = float(np.linalg.norm(error)), False
            note_error(job, error, covariance, self._world, self.config)
            above_m = float(off[2]) - self.config.touch.ball_radius_m
        elif job.measured_beside:
            job.error_m = job.hover_error_m
        return contact_fault(job.error_m, above_m, self._tip_look, self.config)

    def _error_in_contact(self, job: Job, seen: Array, off: Array) -> tuple[Array, Array]:
        """Return the tip's offset (2,) from its target and its covariance (2, 2), by the looks above and in contact."""
        assert job.scene is not None
        ray = ray_at(seen, job.scene, self._world.pair)
        if job.above is None or job.measured_beside or self.config.motion.stylus_two_positions:
            return off, self.tips.in_contact(ray)
        if self.phase is Phase.MEASURE:
            self.tips.take_gap(off - job.above[0], ray)
        return combined(*job.above, off, self.tips.in_contact(ray))

    # Up again

    def _judge_lag(self, job: Job) -> None:
        """Evaluate all images of the contact, and correct the heights by them."""
        assert job.touch is not None
        job.lag = self._measured_lag(job) or job.lag
        lag, config = job.lag, self.config
        if lag is None or not lag.stopped(config.contact) or config.motion.stylus_two_positions:
            return
        end_m = job.contact_m - lag.lag_m - job.surface_m
        finding = self.heights.touched(job.touch.control, job.touch.key, end_m, lag.sigma_m)
        job.findings += () if finding is None else (finding,)

    def _note_free(self, job: Job) -> str:
        """Note a ball that has followed its drive to the end; return the code of this case, empty in other cases."""
        lag = self._measured_lag(job)
        if lag is None or not lag.free(self.config.contact) or self.switch.closed:
            return ""
        job.lag, job.felt = lag, Felt.NOT_TOUCHED
        return ContactCode.NOT_TOUCHED.value

    def _finish_touch(self, job: Job) -> None:
        """End a touch that was made: ``reached`` only with a contact."""
        effect = job.effect is not None and job.effect.seen
        own_lamp = job.effect is not None and job.effect.kind is EffectKind.LAMP
        job.felt, job.evidence = verdict(
            job.lag, effect=effect, own_lamp=own_lamp, switch=self.switch.closed, config=self.config.contact
        )
        if job.felt.contact:
            self._finish(job, Outcome.REACHED, joined(finding.text() for finding in job.findings))
            return
        reason = Message("stylus.is_up", cause=self._unfelt_text(job))
        self._finish(job, Outcome.ABORTED, reason, code=_code_of(job.felt))

    def _unfelt_text(self, job: Job) -> str:
        cause = Message("contact.not_known_whether_anything_touched")
        if job.lag is not None:
            beyond_mm, lag_mm = 1000.0 * (job.contact_m - job.surface_m), 1000.0 * job.lag.lag_m
            cause = Message("contact.not_known_whether_anything_touched_2", beyond_mm=beyond_mm, lag_mm=lag_mm)
            if job.felt is Felt.NOT_TOUCHED:
                cause = Message("contact.nothing_touched_down_beyond_surface", beyond_mm=beyond_mm)
                if beyond_mm < 0.0:
                    cause = Message("contact.nothing_touched_driver_allows_ends", beyond_mm=-beyond_mm)
        return joined((cause, *(finding.text() for finding in job.findings)))


def _code_of(felt: Felt) -> str:
    return str(ContactCode.NOT_TOUCHED if felt is Felt.NOT_TOUCHED else ContactCode.UNKNOWN)
