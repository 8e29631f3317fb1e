"""What the controller knows of the goal in work: its phases, what ends them, and what ends the goal early."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from gantry_driver.core.effects import Knob
from gantry_driver.core.scene import Scene
from gantry_driver.core.targets import Touch
from icu_common.core.delays import Delay
from icu_common.core.geometry import Array
from icu_common.core.gesture import Gesture
from icu_common.core.intent import Intent
from icu_common.core.panel_state import PanelSeen
from icu_common.core.results import GoalResult, Outcome

NANO = 1_000_000_000


class Phase(str, Enum):
    """Where a goal stands; the value is for diagnostics."""

    IDLE = "idle"
    SIGHT = "waiting for the panel to be seen"
    WAIT = "waiting for a free view"
    MOVE = "moving to the point"
    APPROACH = "moving above the target"
    LOOK = "looking at the tip"
    CORRECT = "moving by the seen error"
    RETURN = "moving back above the target"
    TOUCH = "touching down"
    CONTACT = "touching: looking at the contact"
    TURN = "touching: turning"
    LIFT = "moving up"
    MEASURE = "waiting for the pictures of the contact"
    ASIDE = "moving out of the way"
    READ = "looking for the effect"
    BREAK_OFF = "moving up after a fault"


MOVING = (
    Phase.MOVE,
    Phase.APPROACH,
    Phase.CORRECT,
    Phase.RETURN,
    Phase.TOUCH,
    Phase.TURN,
    Phase.LIFT,
    Phase.ASIDE,
    Phase.BREAK_OFF,
)
LOOKING = (Phase.LOOK, Phase.CONTACT, Phase.MEASURE)
"""Here the tip is looked at."""
UP = (Phase.LIFT, Phase.MEASURE, Phase.ASIDE, Phase.READ)
"""Here the touch is done, and neither a stalled camera nor a moved panel matters any more."""
FREE_VIEW = (Phase.APPROACH, Phase.LOOK, Phase.CORRECT, Phase.RETURN)
"""Here nothing but the stylus may hide the control."""
STANDING = (Phase.LOOK, Phase.TOUCH, Phase.CONTACT)
"""Here x and y rest: what cameras on the carriage see belongs to what is read."""
WAITING = (Phase.SIGHT, Phase.WAIT, Phase.LOOK, Phase.READ)
"""Here the machine stands still, in the air before the touch."""
PUSHING = (Phase.TOUCH, Phase.TURN)
"""Here a panel that has moved or is in doubt stops the machine at once; elsewhere the stylus is in the air, goes up."""
# What /gantry/state shows; every other phase is OTHERWISE.
STATES = {
    Phase.LOOK: "looking",
    Phase.TOUCH: "touching",
    Phase.CONTACT: "touching",
    Phase.TURN: "touching",
    Phase.MEASURE: "looking",
    Phase.READ: "looking",
    Phase.WAIT: "looking",
    Phase.SIGHT: "looking",
}
OTHERWISE = "moving"
WORKING = frozenset((*STATES.values(), OTHERWISE))
"""What it shows while a goal is in work."""


def intent_in(phase: Phase, kind: str) -> Intent:
    """Return what the motion of a phase is for, in a goal of a kind."""
    if phase is Phase.TURN:
        return Intent.DRAG if kind == "drag" else Intent.TURN
    return Intent.PRESS if phase is Phase.TOUCH else Intent.MOVE


class Step(str, Enum):
    """What ends a phase."""

    ARRIVED = "arrived"
    SEEN = "seen"
    UNSEEN = "unseen"


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Why a goal ends early: ``lift`` when the stylus may go up, ``stop`` when the machine must be held at once.

    ``delay`` names what was slow, where slowness alone is the cause.
    """

    cause: str
    lift: bool = True
    stop: bool = False
    delay: Delay | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstacle:
    """A reason to start no goal: ``state`` for /gantry/state, ``reason`` with value and limit for a rejection.

    A ``passing`` obstacle may end by itself: cameras on the carriage have not seen the panel from their position, or
    an input is late. ``delay`` names the late input, if nothing else is wrong.
    """

    state: str
    reason: str
    every_goal: bool
    passing: bool = False
    delay: Delay | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aim:
    """How points of base_link become readings: by the axes (2, 2), and by the correction (2,) in readings found so far.

    ``corrections`` counts what it was found by.
    """

    base_from_reading: Array
    correction: Array = field(default_factory=lambda: np.zeros(2))
    corrections: int = 0

    def readings_at(self, base_points: Array) -> Array:
        """Map (N, 3) base points to readings."""
        xy = np.linalg.solve(self.base_from_reading, base_points[:, :2].T).T + self.correction
        return np.column_stack([xy, -base_points[:, 2]])

    def corrected(self, error_xy: Array) -> Aim:
        """Return the aim after a tip was seen ``error_xy`` (2,) in base_link from its place."""
        correction = self.correction - np.linalg.solve(self.base_from_reading, error_xy)
        return replace(self, correction=correction, corrections=self.corrections + 1)


@dataclass(slots=True, kw_only=True, eq=False)
class Job:
    """The goal in work."""

    goal_id: str
    text: str
    kind: str
    started_ns: int
    aim: Aim
    scene: Scene | None = None
    point: Array | None = None
    """Where in base_link (3,) a mere move goes."""
    touch: Touch | None = None
    gesture: Gesture | None = None
    knob: Knob | None = None
    before: PanelSeen | None = None
    """What was seen last before the stylus went down, with the control's lamp where it has one that could be read."""
    effect: str = ""
    went_aside: bool = False
    hold_s: float = 0.0
    beside: list[Array] | None = None
    """Places beside the target to look at the tip from, the present one first; None where no look needs them yet."""
    measured_beside: bool = False
    hover_error_m: float = math.nan
    error_m: float = math.nan
    plunge_ns: int = 0
    touched_ns: int = 0
    """When the stylus first went down to touch, 0 before."""
    down_ns: int = 0
    left_ns: int = 0
    """When the stylus began to leave what it had touched."""
    fault: Fault | None = None

    @property
    def unplanned(self) -> bool:
        """Whether it is not known yet where it goes: the panel has not been seen from where the cameras are."""
        return self.point is None and self.touch is None

    def look_before(self, seen: PanelSeen) -> None:
        """Take what is seen before the touch: a lamp may have changed since the goal was taken, or been hidden then."""
        if self.touch is None or self.touched_ns:
            return
        control = seen.control(self.touch.control)
        if self.before is None or (control is not None and control.lamp):
            self.before = seen

    def goal_base(self) -> Array:
        """Return the goal (3,) in base_link: what is touched, or where a mere move goes."""
        goal = self.point if self.touch is None else self.touch.in_base
        assert goal is not None
        return goal

    def tip_goal(self) -> Array:
        """Return where in base_link (3,) the tip goes before a touch: the point itself, above the target, or beside."""
        if self.touch is None:
            return self.goal_base()
        return self.beside[0] if self.beside else np.array([*self.touch.in_base[:2], self.touch.hover_z])

    def result(
        self, outcome: Outcome, reason: str, now_ns: int, delay: Delay | None = None, *, repeatable: bool = False
    ) -> GoalResult:
        """Return the answer to the sender.

        ``delay`` is the cause if slowness alone is; ``repeatable``: the same goal may succeed unchanged.
        """
        touch, knob = self.touch, self.knob
        details = [("gesture", self.kind)]
        if touch is not None:
            place = " ".join(f"{v:.5f}" for v in touch.in_base)
            details += [("control", touch.control), ("target_base_m", place)]
        if outcome.final:
            cameras = "cameras beside it" if self.measured_beside else "cameras"
            measured = "readings" if touch is None else cameras
            details.append(("measured_by", "nothing" if math.isnan(self.error_m) else measured))
        if outcome.final and touch is not None:
            details.append(("corrections", str(self.aim.corrections)))
            details.append(("hover_error_m", f"{self.hover_error_m:.6f}"))
            details.append(("effect", self.effect or "not looked for"))
        if outcome.final and self.touched_ns:
            details.append(("touched_ns", str(self.touched_ns)))
        if outcome.final and knob is not None:
            details.append(("turns", str(knob.turns)))
            details += [("knob_deg", f"{knob.seen_deg:.2f}"), ("knob_off_deg", f"{knob.off_deg:.2f}")]
        return GoalResult(
            goal_id=self.goal_id,
            goal=self.text,
            outcome=outcome,
            reason=reason,
            error_m=self.error_m,
            duration_s=(now_ns - self.started_ns) / NANO if outcome.final else math.nan,
            details=(*details, *(() if delay is None else delay.details())),
            code=delay.code.value if delay is not None and repeatable else "",
        )
