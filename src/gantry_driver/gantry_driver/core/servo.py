"""The looks at the tip, what is made of them, and when a touch is good: values in, values out; no phases, no clock.

Apart from the state machine, because how far the tip is off and what to do about it does not depend on how the look
came about; look-move-touch follows image-based look-and-move control (Hutchinson, Hager, Corke, "A tutorial on visual
servo control", 1996): move, stand still, measure tip against target, correct, and only then touch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gantry_driver.core import motion_plan, targets
from gantry_driver.core.controller_config import ControllerConfig
from gantry_driver.core.goal_job import Aim, Fault
from gantry_driver.core.scene import Scene
from gantry_driver.core.targets import Touch
from icu_common.core.geometry import Array, Transform

FAR_NS = 2**63
MOST_BESIDE = 2
"""From so many places beside a target is looked for the tip: each takes seconds, with the stylus over the panel."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """One look at the tip.

    Parameters
    ----------
    after_ns, until_ns
        Stamps of the pictures that count: after the one, up to the other.
    needed, kept
        So many sightings it takes, and so many are averaged at most: the last ones.
    tips
        (3,) each, in the camera's frame.
    """

    after_ns: int
    until_ns: int = FAR_NS
    needed: int
    kept: int
    tips: tuple[Array, ...] = ()

    def with_tip(self, in_camera: Array, stamp_ns: int) -> Look:
        """Return the look with one more sighting, if its picture counts."""
        counts = self.after_ns < stamp_ns <= self.until_ns
        return replace(self, tips=(*self.tips, in_camera)[-self.kept :]) if counts else self

    def seen(self, base_from_camera: Transform, spread_m: float) -> Array | None:
        """Return the tip (3,) in base_link; None as long as too few agree on it within ``spread_m`` sideways."""
        if len(self.tips) < self.needed:
            return None
        tips = base_from_camera.apply(np.array(self.tips))
        mean: Array = tips.mean(axis=0)
        spread = float(np.linalg.norm((tips - mean)[:, :2], axis=1).max())
        return mean if spread <= spread_m else None

    def unseen_text(self, spread_m: float) -> str:
        """Say what was seen, and what would have been enough."""
        spread_mm = 1000 * spread_m
        return f"the tip was seen {len(self.tips)} times, {self.needed} times within {spread_mm:g} mm are needed"


NO_LOOK = Look(after_ns=0, until_ns=0, needed=1, kept=1)


def judge(error: Array, aim: Aim, config: ControllerConfig) -> Fault | Aim | None:
    """Judge a tip seen ``error`` (3,) in base_link from its place: return what ends the goal, or the aim to correct to.

    None: it is good enough to touch.
    """
    sideways = float(np.linalg.norm(error[:2]))
    if (fault := misplaced(error, config)) is not None:
        return fault
    if sideways <= config.tolerance_m:
        return None
    if aim.corrections < config.max_corrections:
        return _corrected(error[:2], aim, config.max_correction_m)
    if sideways <= config.max_error_m:
        return None
    return Fault(
        cause=f"the seen error is {1000 * sideways:.2f} mm after {aim.corrections} corrections, "
        f"{1000 * config.max_error_m:g} mm are allowed"
    )


def misplaced(error: Array, config: ControllerConfig) -> Fault | None:
    """Return what ends the goal when a tip is seen ``error`` (3,) from its place, too far to be corrected."""
    sideways = float(np.linalg.norm(error[:2]))
    if sideways <= config.max_correction_m and abs(error[2]) <= config.max_depth_error_m:
        return None
    return Fault(
        cause=f"the tip is seen {1000 * sideways:.2f} mm beside and {1000 * error[2]:+.2f} mm above its "
        f"place, {1000 * config.max_correction_m:g} and {1000 * config.max_depth_error_m:g} mm are "
        "allowed: calibrate again"
    )


def _corrected(error_xy: Array, aim: Aim, most_m: float) -> Fault | Aim:
    corrected = aim.corrected(error_xy)
    total = float(np.linalg.norm(aim.base_from_reading @ corrected.correction))
    if total > most_m:
        # What is seen does not follow the machine, and only so far beside its place is the way known to be clear.
        cause = f"the seen errors add up to a correction by {1000 * total:.2f} mm, {1000 * most_m:g} mm are allowed"
        return Fault(cause=f"{cause}: calibrate again")
    return corrected


def contact_complaint(error_m: float, above_m: float, look: Look, config: ControllerConfig) -> str:
    """Say what is wrong with a touch that was seen ``error_m`` beside its place, ``above_m`` above it; else empty.

    NaN: was not seen. A stylus that sticks, or a camera that repeats its last picture, shows the tip where it hovered.
    """
    if math.isnan(error_m) and config.require_servo:
        return f"touched, but not measured: {look.unseen_text(config.tip_spread_m)}"
    if above_m > config.max_depth_error_m:
        return (
            f"the tip was seen {1000 * above_m:.1f} mm above the surface when it should touch, "
            f"{1000 * config.max_depth_error_m:g} mm are allowed: does the stylus come down, is the picture new?"
        )
    if error_m > config.max_error_m:
        bound = 1000 * config.max_error_m
        return f"touched {1000 * error_m:.2f} mm beside the target, {bound:g} mm are allowed"
    return ""


def places_beside(touch: Touch, scene: Scene, aim: Aim, config: ControllerConfig) -> list[Array]:
    """Return from where to look for a tip that is not seen above the target, before things of the ball's colour.

    An arc is followed only from a place that is known to be right, so for it there are none.
    """
    if config.beside_m == 0 or len(touch.arc):
        return []
    places = targets.places_beside(touch, scene, config.touch, by_m=config.beside_m, wander_m=config.wander_m())
    reached = [p for p in places if motion_plan.reaches(aim.readings_at(p[np.newaxis]), config.motion)]
    return reached[:MOST_BESIDE]
