"""State of the goal in progress: its phases, their ends, and the faults that end the goal early."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from gantry_driver.core.contact.heights import HeightFinding
from gantry_driver.core.contact.lag import Height, Lag
from gantry_driver.core.contact.press import Evidence
from gantry_driver.core.job.effects import NOT_LOOKED_FOR, Effect, Knob
from gantry_driver.core.motion.scene import Scene
from gantry_driver.core.motion.targets import Touch
from gantry_driver.core.motion.touch_error import TouchError
from icu_common.core.alignment.findings import Cause
from icu_common.core.alignment.pair import PairState
from icu_common.core.geometry.geometry import Array
from icu_common.core.goals.intent import Intent
from icu_common.core.goals.results import Felt, GoalResult, Outcome
from icu_common.core.panel.gesture import Gesture
from icu_common.core.panel.panel_state import PanelSeen
from icu_common.core.reasons.codes import ControllerCode
from icu_common.core.reasons.message import Message

NANO = 1_000_000_000


class Phase(str, Enum):
    """Phase of a goal; the value is for diagnostics."""

    IDLE = "idle"
    SIGHT = Message("goal.waiting_panel_seen")
    WAIT = Message("goal.waiting_free_view")
    MOVE = Message("goal.moving_point")
    APPROACH = Message("goal.moving_above_target")
    LOOK = Message("goal.looking_tip")
    CORRECT = Message("goal.moving_seen_error")
    RETURN = Message("goal.moving_back_above_target")
    TOUCH = Message("goal.touching_down")
    CONTACT = Message("goal.touching_looking_contact")
    TURN = Message("goal.touching_turning")
    LIFT = Message("goal.moving_up")
    MEASURE = Message("goal.waiting_pictures_contact")
    ASIDE = Message("goal.moving_out_way")
    READ = Message("goal.looking_effect")
    BREAK_OFF = Message("goal.moving_up_after_fault")


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
"""Phases with a look at the tip."""
UP = (Phase.LIFT, Phase.MEASURE, Phase.ASIDE, Phase.READ)
"""Phases after the touch, in which neither a stalled camera nor a moved panel matters."""
FREE_VIEW = (Phase.APPROACH, Phase.LOOK, Phase.CORRECT, Phase.RETURN)
"""Phases in which only the stylus may hide the control."""
STANDING = (Phase.LOOK, Phase.TOUCH, Phase.CONTACT)
"""Phases with x and y at rest, so that images of cameras on the carriage match the readings."""
WAITING = (Phase.SIGHT, Phase.WAIT, Phase.LOOK, Phase.READ)
"""Phases in which the machine is at rest in the air, before the touch."""
PUSHING = (Phase.TOUCH, Phase.TURN)
"""Phases in which a moved or doubtful panel stops the machine at once; in others the stylus is in the air, or rises."""
# Texts of /gantry/state; every other phase shows OTHERWISE.
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
"""Texts of /gantry/state while a goal is in progress."""


def intent_in(phase: Phase, kind: str) -> Intent:
    """Return the intent of a phase's motion, in a goal of a kind."""
    if phase is Phase.TURN:
        return Intent.DRAG if kind == "drag" else Intent.TURN
    return Intent.PRESS if phase is Phase.TOUCH else Intent.MOVE


class Step(str, Enum):
    """End of a phase."""

    ARRIVED = "arrived"
    SEEN = "seen"
    UNSEEN = "unseen"


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """Cause of a goal's early end: ``lift`` if the stylus may rise, ``stop`` if the machine must be held at once.

    ``delay`` is the late input if lateness is the only cause, or the finding that is the cause. ``code`` is for
    ``GoalResult.code``. ``tells_touch`` is whether the cause says that the stylus has touched.
    """

    cause: str
    lift: bool = True
    stop: bool = False
    delay: Cause | None = None
    code: str = ""
    tells_touch: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstacle:
    """Reason not to start a goal: ``state`` for /gantry/state, ``reason`` with value and limit for a rejection.

    ``code`` is that of the state, by which other programs decide.

    A ``passing`` obstacle may end by itself: cameras on the carriage have not seen the panel from their position, or
    an input is late. ``delay`` names the late input, if nothing else is wrong.
    """

    code: ControllerCode
    state: str
    reason: str
    every_goal: bool
    passing: bool = False
    delay: Cause | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Aim:
    """Conversion of points in base_link to readings: the axes (2, 2), and the correction (2,) in readings found so far.

    ``corrections`` is the number of corrections. ``lower_m`` is the additional extension of the stylus for a height.
    ``found`` (2,) is the mean of the corrections that ``looks`` looks have shown.
    """

    base_from_reading: Array
    lower_m: float = 0.0
    correction: Array = field(default_factory=lambda: np.zeros(2))
    corrections: int = 0
    looks: int = 0
    found: Array = field(default_factory=lambda: np.zeros(2))

    def readings_at(self, base_points: Array) -> Array:
        """Map (N, 3) base points to readings."""
        xy = np.linalg.solve(self.base_from_reading, base_points[:, :2].T).T + self.correction
        return np.column_stack([xy, self.lower_m - base_points[:, 2]])

    def looked(self, error_xy: Array, agreement_m: float) -> Aim:
        """Return the aim after a look at the tip, ``error_xy`` (2,) in base_link off its target.

        Looks that differ by more than ``agreement_m`` are not averaged: the tip has moved since the earlier ones.
        """
        found = self.correction - np.linalg.solve(self.base_from_reading, error_xy)
        looks = self.looks if np.linalg.norm(self.base_from_reading @ (found - self.found)) <= agreement_m else 0
        return replace(self, looks=looks + 1, found=(looks * self.found + found) / (looks + 1))

    def rest(self) -> Array:
        """Return the tip's offset (2,) m from its target in base_link, by all looks."""
        return np.asarray(self.base_from_reading @ (self.correction - self.found))

    def corrected(self, error_xy: Array) -> Aim:
        """Return the corrected aim for a tip that was seen ``error_xy`` (2,) in base_link off its target."""
        correction = self.correction - np.linalg.solve(self.base_from_reading, error_xy)
        return replace(self, correction=correction, corrections=self.corrections + 1)


@dataclass(slots=True, kw_only=True, eq=False)
class Job:
    """The goal in progress."""

    goal_id: str
    text: str
    kind: str
    started_ns: int
    aim: Aim
    scene: Scene | None = None
    point: Array | None = None
    """Target (3,) in base_link of a goal that only moves."""
    touch: Touch | None = None
    gesture: Gesture | None = None
    knob: Knob | None = None
    before: PanelSeen | None = None
    """Last seen state before the stylus went down, with the control's lamp if it has a readable one."""
    effect: Effect | None = None
    went_aside: bool = False
    hold_s: float = 0.0
    beside: list[Array] | None = None
    """Positions next to the target for a look at the tip, the current one first; None until a look needs them."""
    measured_beside: bool = False
    hover_error_m: float = math.nan
    above: tuple[Array, Array] | None = None
    """Offset (2,) m of the tip from its target by the looks above it, and its covariance (2, 2)."""
    touch_error: TouchError | None = None
    """Last seen offset, with its covariance."""
    pair: PairState | None = None
    """State of the camera pair when the tip was last seen above the target."""
    error_m: float = math.nan
    air: Height | None = None
    """Height of the ball before the touch, the baseline of its descent."""
    lag: Lag | None = None
    surface_m: float = math.nan
    """Expected extension at which the ball meets the touched surface, from before the touch."""
    contact_m: float = math.nan
    """Extension of the last look in contact."""
    felt: Felt | None = None
    evidence: tuple[Evidence, ...] = ()
    findings: tuple[HeightFinding, ...] = ()
    plunge_ns: int = 0
    touched_ns: int = 0
    """Time at which the stylus first went down to touch, 0 before."""
    down_ns: int = 0
    pressed_ns: int = 0
    """Time at which the first descent of this touch ended; ``down_ns`` is that of the last step."""
    left_ns: int = 0
    """Time at which the stylus began to leave the touched surface."""
    fault: Fault | None = None

    @property
    def unplanned(self) -> bool:
        """Whether the target is still unknown: the cameras have not seen the panel from their current position."""
        return self.point is None and self.touch is None

    def look_before(self, seen: PanelSeen) -> None:
        """Take the state seen before the touch: since acceptance a lamp may have changed, or become visible."""
        if self.touch is None or self.touched_ns:
            return
        control = seen.control(self.touch.control)
        if self.before is None or (control is not None and control.lamp):
            self.before = seen

    def goal_base(self) -> Array:
        """Return the goal (3,) in base_link: the point to touch, or the target of a move."""
        goal = self.point if self.touch is None else self.touch.in_base
        assert goal is not None
        return goal

    def tip_goal(self) -> Array:
        """Return the tip's position (3,) in base_link before a touch: the point, above the goal, or next to it."""
        if self.touch is None:
            return self.goal_base()
        return self.beside[0] if self.beside else np.array([*self.touch.in_base[:2], self.touch.hover_z])

    def result(
        self,
        outcome: Outcome,
        reason: str,
        now_ns: int,
        delay: Cause | None = None,
        *,
        repeatable: bool = False,
        code: str = "",
    ) -> GoalResult:
        """Return the answer to the sender.

        ``delay`` is the cause if lateness is the only cause, and ``code`` is any other cause. ``repeatable`` is whether
        the same goal may succeed unchanged.
        """
        touch, knob = self.touch, self.knob
        details = [("gesture", self.kind)]
        if touch is not None:
            place = " ".join(f"{v:.5f}" for v in touch.in_base)
            details += [("control", touch.control), ("target_base_m", place)]
        if outcome.final:
            cameras = Message("goal.cameras_beside") if self.measured_beside else "cameras"
            measured = "readings" if touch is None else cameras
            details.append(("measured_by", "nothing" if math.isnan(self.error_m) else measured))
        if outcome.final and touch is not None:
            details.append(("corrections", str(self.aim.corrections)))
            details.append(("hover_error_m", f"{self.hover_error_m:.6f}"))
            details += (self.effect or NOT_LOOKED_FOR).details()
        if outcome.final and self.touch_error is not None:
            details += self.touch_error.details()
        if outcome.final and self.touched_ns:
            details.append(("touched_ns", str(self.touched_ns)))
            details.append(("evidence", " ".join(map(str, self.evidence)) or "none"))
            details += () if self.lag is None else self.lag.details()
        for finding in self.findings if outcome.final else ():
            details += finding.details()
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
            code=delay.code.value if delay is not None and repeatable else code,
            touch=self._felt(outcome),
        )

    def _felt(self, outcome: Outcome) -> Felt | None:
        """Return whether the touch was felt, None before the end and for a goal that touches nothing."""
        if not outcome.final or self.touch is None or (outcome is Outcome.REACHED and not self.touched_ns):
            return None
        return self.felt or (Felt.UNKNOWN if self.touched_ns else Felt.NOT_TOUCHED)
