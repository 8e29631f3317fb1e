"""Looks at the tip, their evaluation, and the check of a touch: values in, values out; no phases, no clock.

This is separate from the state machine because the tip's error and its correction do not depend on the cause of a look.
The procedure follows image-based look-and-move control (Hutchinson, Hager, Corke, "A tutorial on visual servo control",
1996): move, rest, measure the tip relative to the target, correct, and only then touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import Aim, Fault
from gantry_driver.core.motion import motion_plan, targets
from gantry_driver.core.motion.scene import Scene
from gantry_driver.core.motion.targets import Touch
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.reasons.message import Message

FAR_NS = 2**63
MOST_BESIDE = 2
"""Maximum number of positions next to a target from which to look for the tip: each takes seconds, over the panel."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """One look at the tip.

    Parameters
    ----------
    after_ns, until_ns
        Stamps of the images that count: after the first, up to the second.
    needed, kept
        Minimum number of observations, and maximum number of the last ones that are averaged.
    tips
        (3,) each, in the camera's frame.
    """

    after_ns: int
    until_ns: int = FAR_NS
    needed: int
    kept: int
    tips: tuple[Array, ...] = ()

    def precise(self, sigma_m: float) -> bool:
        """Whether the mean of the tips is known to ``sigma_m`` along the camera's axis, or no more tips are kept."""
        count = len(self.tips)
        if count >= self.kept or count < 2:
            return count >= self.needed
        return float(np.std([tip[2] for tip in self.tips], ddof=1)) <= sigma_m * math.sqrt(count)

    def with_tip(self, in_camera: Array, stamp_ns: int) -> Look:
        """Return the look with one more observation, if its image counts."""
        counts = self.after_ns < stamp_ns <= self.until_ns
        return replace(self, tips=(*self.tips, in_camera)[-self.kept :]) if counts else self

    def seen(self, base_from_camera: Transform, spread_m: float) -> Array | None:
        """Return the tip (3,) in base_link; None while too few observations agree laterally within ``spread_m``."""
        if len(self.tips) < self.needed:
            return None
        tips = base_from_camera.apply(np.array(self.tips))
        mean: Array = tips.mean(axis=0)
        spread = float(np.linalg.norm((tips - mean)[:, :2], axis=1).max())
        return mean if spread <= spread_m else None

    def unseen_text(self, spread_m: float) -> str:
        """Return a text on the number of observations, and on the number required."""
        spread_mm = 1000 * spread_m
        return Message(
            "servo.tip_seen_times_times_within", tips=len(self.tips), needed=self.needed, spread_mm=spread_mm
        )


NO_LOOK = Look(after_ns=0, until_ns=0, needed=1, kept=1)


def judge(error: Array, aim: Aim, config: ControllerConfig) -> Fault | Aim | None:
    """Evaluate a tip seen ``error`` (3,) in base_link off its position: return a fault, or the corrected aim.

    None: the error is small enough to touch.
    """
    rest = aim.rest() if aim.looks else error[:2]
    sideways = float(np.linalg.norm(rest))
    if (fault := misplaced(error, config)) is not None:
        return fault
    if sideways <= config.tolerance_m:
        return None
    if aim.corrections < config.max_corrections:
        return _corrected(rest, aim, config.max_correction_m)
    if sideways <= config.max_error_m:
        return None
    return Fault(
        cause=Message(
            "servo.seen_error_after_corrections_allowed",
            sideways_mm=1000 * sideways,
            corrections=aim.corrections,
            max_error_mm=1000 * config.max_error_m,
        )
    )


def misplaced(error: Array, config: ControllerConfig) -> Fault | None:
    """Return the fault of a tip seen ``error`` (3,) off its position, if that is too far for a correction."""
    sideways = float(np.linalg.norm(error[:2]))
    if sideways <= config.max_correction_m and abs(error[2]) <= config.max_depth_error_m:
        return None
    return Fault(
        cause=Message(
            "servo.tip_seen_beside_above_place",
            sideways_mm=1000 * sideways,
            error_mm=1000 * error[2],
            max_correction_m=1000 * config.max_correction_m,
            max_depth_error_mm=1000 * config.max_depth_error_m,
        )
    )


def _corrected(error_xy: Array, aim: Aim, most_m: float) -> Fault | Aim:
    corrected = aim.corrected(error_xy)
    total = float(np.linalg.norm(aim.base_from_reading @ corrected.correction))
    if total > most_m:
        # The seen tip does not follow the machine, and the path is known to be clear only within this distance.
        cause = Message("servo.seen_errors_add_up_correction", total_mm=1000 * total, most_mm=1000 * most_m)
        return Fault(cause=Message("contact.calibrate_again", cause=cause))
    return corrected


def contact_fault(error_m: float, above_m: float, look: Look, config: ControllerConfig) -> Fault | None:
    """Return the fault of a touch seen ``error_m`` to the side of its position and ``above_m`` above it, if any.

    NaN: not seen. A stylus that sticks, or a camera that repeats its last image, shows the tip at its hover position.
    """
    if math.isnan(error_m) and config.require_servo:
        return Fault(
            cause=Message("servo.touched_but_not_measured", unseen_text=look.unseen_text(config.tip_spread_m)),
            tells_touch=True,
        )
    if above_m > config.max_depth_error_m:
        return Fault(
            cause=Message(
                "servo.tip_seen_above_surface_when",
                above_mm=1000 * above_m,
                max_depth_error_mm=1000 * config.max_depth_error_m,
            )
        )
    if error_m > config.max_error_m:
        bound = 1000 * config.max_error_m
        cause = Message("servo.touched_beside_target_allowed", error_mm=1000 * error_m, bound_mm=bound)
        return Fault(cause=cause, tells_touch=True)
    return None


def places_beside(touch: Touch, scene: Scene, aim: Aim, config: ControllerConfig) -> list[Array]:
    """Return positions for a look at a tip that is not seen above the target, in front of things of the ball's colour.

    For an arc there are none, because an arc is followed only from a measured position.
    """
    if config.beside_m == 0 or len(touch.arc):
        return []
    places = targets.places_beside(touch, scene, config.touch, by_m=config.beside_m, wander_m=config.wander_m())
    reached = [p for p in places if motion_plan.reaches(aim.readings_at(p[np.newaxis]), config.motion)]
    return reached[:MOST_BESIDE]
