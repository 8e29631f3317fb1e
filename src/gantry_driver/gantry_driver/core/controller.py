"""The gantry controller as a state machine: events and time in, actions out; no ROS, no clock.

One goal at a time. A goal runs through phases; the table ``Controller._NEXT`` lists every transition, ``_fault`` lists
what ends a goal early, and ``_obstacles`` what keeps one from starting. Look-move-touch follows image-based
look-and-move control (Hutchinson, Hager, Corke, "A tutorial on visual servo control", 1996): move, stand still, measure
tip against target, correct, and only then touch.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import ClassVar

import numpy as np

from gantry_driver.core import controller_messages as msg
from gantry_driver.core import motion_plan, targets
from gantry_driver.core.motion_plan import MotionConfig, OutOfReach, Path
from gantry_driver.core.targets import PanelMap, Refused, Scene, Touch, TouchConfig
from icu_common.core.camera_model import CameraModel
from icu_common.core.config import Config, nested, setting
from icu_common.core.frames import BASE, CAMERA_LEFT
from icu_common.core.geometry import Array, Transform
from icu_common.core.gesture import Gesture, GestureError, Point, parse_gesture
from icu_common.core.results import GoalResult, Outcome

NANO = 1_000_000_000
EXTENDED_M = 0.0005
"""Extension above which a stylus that was left behind may be pressing something."""
ASK_AGAIN_S = 0.5
CROSSED_M = 2e-5
"""Readings of x and y that differ more are motion."""
CLOCK_JUMP_S = 0.5
"""Time that runs back farther than this between two events ends the goal: no deadline would hold any more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerConfig(Config):
    """Parameters of the gantry controller."""

    tolerance_m: float = setting(
        0.00015, "Seen error at which no further correction is made", minimum=1e-5, maximum=0.01, unit="m"
    )
    max_error_m: float = setting(
        0.0005, "Seen error above which nothing is touched", minimum=1e-5, maximum=0.01, unit="m"
    )
    max_corrections: int = setting(3, "Corrections before the error is judged by max_error_m", minimum=0, maximum=20)
    max_correction_m: float = setting(
        0.005, "Seen error that means a wrong calibration or a wrong tip", minimum=1e-4, maximum=0.05, unit="m"
    )
    max_depth_error_m: float = setting(
        0.003, "Seen error along base z that means the same", minimum=1e-4, maximum=0.05, unit="m"
    )
    require_servo: bool = setting(True, "Touch only what the cameras see the tip above")
    tip_count: int = setting(5, "Tip observations averaged in one look", minimum=1, maximum=50)
    tip_spread_m: float = setting(
        0.0006, "Largest distance of one of them from their mean, sideways", minimum=1e-5, maximum=0.01, unit="m"
    )
    settle_s: float = setting(0.15, "Standstill before a picture counts", minimum=0.0, maximum=5.0, unit="s")
    look_timeout_s: float = setting(3.0, "Time for one look", minimum=0.1, maximum=30.0, unit="s")
    press_s: float = setting(0.3, "Time in contact of a press", minimum=0.0, maximum=5.0, unit="s")
    press_max_s: float = setting(
        0.6,
        "The same while fewer pictures than needed have come; instruments take longer for another gesture",
        minimum=0.0,
        maximum=5.0,
        unit="s",
    )
    picture_wait_s: float = setting(
        1.0, "Time for the pictures of the contact to arrive after the lift", minimum=0.0, maximum=10.0, unit="s"
    )
    contact_tip_count: int = setting(2, "Tip observations needed from the time in contact", minimum=1, maximum=50)
    motion_timeout_s: float = setting(
        6.0, "Time beyond the nominal duration for a trajectory's result", minimum=0.5, maximum=120.0, unit="s"
    )
    arrival_tolerance_m: float = setting(
        0.0002, "Reading against commanded point at the end of a motion", minimum=1e-5, maximum=0.01, unit="m"
    )
    goal_max_age_s: float = setting(0.5, "Older goals are refused as stale", minimum=0.05, maximum=10.0, unit="s")
    heartbeat_timeout_s: float = setting(
        0.6, "Age at which the operator counts as gone", minimum=0.1, maximum=10.0, unit="s"
    )
    joints_timeout_s: float = setting(
        1.0, "Age of joint_states at which the driver counts as silent", minimum=0.1, maximum=10.0, unit="s"
    )
    camera_timeout_s: float = setting(
        1.0, "Age of the newest picture at which the camera counts as stalled", minimum=0.1, maximum=10.0, unit="s"
    )
    min_confidence: float = setting(0.3, "Recognition needed for a touch", minimum=0.0, maximum=1.0)
    panel_max_age_s: float = setting(2.0, "Age of the panel's pose for a touch", minimum=0.1, maximum=60.0, unit="s")
    camera_on_carriage: bool = setting(
        False, "The cameras ride on the carriage: the panel is seen anew at each place, and errors are seen in it"
    )
    panel_moved_m: float = setting(
        0.0015, "Shift of the target in the picture that ends a goal", minimum=1e-4, maximum=0.05, unit="m"
    )
    motion: MotionConfig = nested(MotionConfig)
    touch: TouchConfig = nested(TouchConfig)


class Phase(str, Enum):
    """Where a goal stands; the value is for diagnostics."""

    IDLE = "idle"
    MOVE = "moving to the point"
    APPROACH = "moving above the target"
    LOOK = "looking at the tip"
    CORRECT = "moving by the seen error"
    TOUCH = "touching down"
    CONTACT = "touching: looking at the contact"
    TURN = "touching: turning"
    LIFT = "moving up"
    MEASURE = "waiting for the pictures of the contact"
    BREAK_OFF = "moving up after a fault"


MOVING = (Phase.MOVE, Phase.APPROACH, Phase.CORRECT, Phase.TOUCH, Phase.TURN, Phase.LIFT, Phase.BREAK_OFF)
LOOKING = (Phase.LOOK, Phase.CONTACT, Phase.MEASURE)
MAX_TIPS = 50
PUSHING = (Phase.TOUCH, Phase.TURN)
"""Here a moved panel stops the machine at once; elsewhere the stylus is in the air and goes up."""
# What /gantry/state shows; every other phase is "moving".
STATES = {
    Phase.LOOK: "looking",
    Phase.TOUCH: "touching",
    Phase.CONTACT: "touching",
    Phase.TURN: "touching",
    Phase.MEASURE: "looking",
}


class Step(str, Enum):
    """What ends a phase."""

    ARRIVED = "arrived"
    SEEN = "seen"
    UNSEEN = "unseen"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fault:
    """Why a goal ends early: ``lift`` when the stylus may go up, ``stop`` when the machine must be held at once."""

    cause: str
    lift: bool = True
    stop: bool = False


@dataclass(slots=True, kw_only=True, eq=False)
class _World:
    """The newest of everything heard; times are those of reception unless named stamp."""

    driver: str = "disconnected: nothing heard from the driver"
    readings: Array | None = None
    readings_ns: int = 0
    crossed_ns: int = 0
    """When x or y was last seen to change, or heard of first."""
    heartbeat_ns: int | None = None
    camera: CameraModel | None = None
    camera_stamp_ns: int | None = None
    reported_panel: msg.PanelPose | None = None
    camera_from_panel: Transform | None = None
    panel_stamp_ns: int = 0
    confidence: float = 0.0
    panel: PanelMap | None = None
    camera_from_base: Transform | None = None
    base_from_reading: Array | None = None


@dataclass(slots=True, kw_only=True, eq=False)
class _Job:
    """The goal in work."""

    goal_id: str
    text: str
    kind: str
    started_ns: int
    base_from_reading: Array
    scene: Scene | None = None
    touch: Touch | None = None
    goal_base: Array
    hold_s: float = 0.0
    correction: Array = field(default_factory=lambda: np.zeros(2))
    corrections: int = 0
    hover_error_m: float = math.nan
    error_m: float = math.nan
    down_ns: int = 0
    complaint: str = ""
    fault: _Fault | None = None

    def tip_goal(self) -> Array:
        """Return where in base_link (3,) the tip goes first: the point itself, or above the place to touch."""
        return self.goal_base if self.touch is None else np.array([*self.goal_base[:2], self.touch.hover_z])

    def readings_at(self, base_points: Array) -> Array:
        """Map (N, 3) base points to readings, with the correction found so far."""
        xy = np.linalg.solve(self.base_from_reading, base_points[:, :2].T).T + self.correction
        return np.column_stack([xy, -base_points[:, 2]])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Obstacle:
    """What keeps goals from starting: ``state`` for /gantry/state, ``reason`` with value and bound for a rejection."""

    state: str
    reason: str
    every_goal: bool


class Controller:
    """See the module's text. Feed every event to :meth:`handle` and carry out the actions in their order."""

    def __init__(self, config: ControllerConfig) -> None:
        self.config = config
        self.phase = Phase.IDLE
        self.counts = dict.fromkeys(Outcome, 0)
        self._world = _World()
        self._job: _Job | None = None
        self._actions: list[msg.Action] = []
        self._state = ""
        self._closed = False
        self._now_ns = 0
        self._deadline_ns = 0
        self._stamp_ns = 0
        self._phase_ns = 0
        self._end: Array | None = None
        self._arrived_ns: int | None = None
        self._look_after_ns = self._look_until_ns = 0
        self._tips: deque[Array] = deque()
        self._tips_needed = 1
        self._unchecked = True
        self._left_behind = ""
        self._asked_ns = 0

    # Every transition of a goal. A method either enters another phase or finishes the goal.
    _NEXT: ClassVar[dict[tuple[Phase, Step], Callable[[Controller, _Job], None]]] = {
        (Phase.MOVE, Step.ARRIVED): lambda self, job: self._finish_move(job),
        (Phase.APPROACH, Step.ARRIVED): lambda self, job: self._look_at_hover(job),
        (Phase.LOOK, Step.SEEN): lambda self, job: self._judge_hover(job),
        (Phase.LOOK, Step.UNSEEN): lambda self, job: self._unseen_hover(job),
        (Phase.CORRECT, Step.ARRIVED): lambda self, job: self._look_at_hover(job),
        (Phase.TOUCH, Step.ARRIVED): lambda self, job: self._look_at_contact(job),
        (Phase.CONTACT, Step.SEEN): lambda self, job: self._leave_contact(job),
        (Phase.CONTACT, Step.UNSEEN): lambda self, job: self._leave_contact(job),
        (Phase.TURN, Step.ARRIVED): lambda self, job: self._lift(job),
        (Phase.LIFT, Step.ARRIVED): lambda self, job: self._wait_for_pictures(job),
        (Phase.MEASURE, Step.SEEN): lambda self, job: self._judge_contact(job),
        (Phase.MEASURE, Step.UNSEEN): lambda self, job: self._judge_contact(job),
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
        self._now_ns = now_ns
        self._actions = []
        if jumped_back_s > CLOCK_JUMP_S:
            self._forget_times()
            if self._job is not None:
                self._break_off(self._job, _Fault(cause=f"the clock jumped back by {jumped_back_s:.1f} s", stop=True))
        self._take(event)
        if self._job is not None:
            fault = self._fault(self._job)
            # On the way out after one fault only those count that forbid the rest of the way.
            if fault is not None and (self._job.fault is None or not fault.lift):
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
            self._finish(self._job, Outcome.ABORTED, f"{cause}; the machine was told to stop")
        self._set_state(f"stopped: {cause}")
        return self._actions

    def close(self, now_ns: int) -> list[msg.Action]:
        """End the goal in work because the controller goes away: the machine is held, and nothing is heard any more."""
        if self._closed:
            return []
        self._now_ns = now_ns
        self._actions = []
        if self._job is not None:
            self._break_off(self._job, _Fault(cause="the controller is shutting down", stop=True))
        self._set_state("waiting: the controller has ended")
        self._closed = True
        return self._actions

    # What is heard

    def _take(self, event: msg.Event) -> None:
        world = self._world
        match event:
            case msg.PointGoal():
                self._accept_or_reject(str(event.stamp_ns), self._point_text(event), lambda: self._point_job(event))
            case msg.Command():
                self._take_command(event.text)
            case msg.DriverState():
                self._take_driver(event.text)
            case msg.Joints():
                if world.readings is None or np.abs(event.readings - world.readings)[:2].max() > CROSSED_M:
                    world.crossed_ns = self._now_ns
                world.readings, world.readings_ns = event.readings, self._now_ns
                self._check_left_behind()
            case msg.MotionResult():
                self._take_motion_result(event.result)
            case msg.PanelPose():
                world.reported_panel = event
            case msg.PanelConfidence():
                self._take_confidence(event.value)
            case msg.PanelControls():
                world.panel = event.panel
            case msg.CameraFromBase():
                world.camera_from_base = event.transform
            case msg.Axes():
                world.base_from_reading = event.base_from_reading
            case msg.TipSeen():
                # Pictures come late: those of the contact still count when the stylus is on its way up.
                if self._look_after_ns < event.stamp_ns <= self._look_until_ns:
                    self._tips.append(event.in_camera)
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
            self._unchecked = False
        elif not self._unchecked and state == "idle":
            self._left_behind = ""

    def _check_left_behind(self) -> None:
        """Ask for a stop, which lifts, if the stylus was left extended before the start; again until it is heard."""
        if not self._unchecked or self._world.driver != "idle":
            return
        self._unchecked = bool(self._readings()[2] > EXTENDED_M)
        self._left_behind = self._left_behind_text() if self._unchecked else ""
        if self._unchecked and self._age_s(self._asked_ns) > ASK_AGAIN_S:
            self._asked_ns = self._now_ns
            self._actions.append(msg.CallStop(reason=self._left_behind))

    def _left_behind_text(self) -> str:
        return f"the controller started with the stylus extended by {1000 * self._readings()[2]:.1f} mm"

    def _take_confidence(self, value: float) -> None:
        """Believe the pose that came before a good confidence; forget one that came before a bad one."""
        world = self._world
        world.confidence = value
        if world.reported_panel is not None and value >= self.config.min_confidence:
            world.camera_from_panel = world.reported_panel.camera_from_panel
            world.panel_stamp_ns = world.reported_panel.stamp_ns
        world.reported_panel = None

    def _take_motion_result(self, result: GoalResult) -> None:
        if self._job is None or self.phase not in MOVING or result.goal_id != str(self._stamp_ns):
            return
        if result.outcome is Outcome.REACHED:
            self._arrived_ns = self._now_ns
        elif result.outcome.final:
            cause = f"the driver {result.outcome.value} the motion: {result.reason or 'no reason given'}"
            self._break_off(self._job, _Fault(cause=cause, lift=False))

    def _panel_is_still(self) -> bool:
        """Whether the panel's pose was seen from where the cameras are now."""
        world = self._world
        settled_ns = world.crossed_ns + _nanoseconds(self.config.settle_s)
        return not self.config.camera_on_carriage or world.panel_stamp_ns > settled_ns

    def _forget_times(self) -> None:
        self._world.heartbeat_ns = None
        self._world.camera_stamp_ns = None
        self._world.panel_stamp_ns = 0

    # What keeps a goal from starting

    def _obstacles(self) -> Iterator[_Obstacle]:
        world, config = self._world, self.config
        state, _, reason = world.driver.partition(":")
        if state != "idle":
            shown = world.driver if state in ("stopped", "alarm") else f"waiting: {_DRIVER_TEXT.get(state, state)}"
            if state not in ("stopped", "alarm") and reason:
                shown += f": {reason.strip()}"
            if self._left_behind:
                shown += f"; {self._left_behind}"
            yield _Obstacle(state=shown, reason=f"the driver is {world.driver!r}, 'idle' is needed", every_goal=True)
        elif world.readings is None or self._age_s(world.readings_ns) > config.joints_timeout_s:
            text = f"no joint_states {_since(self._age_s(world.readings_ns))}"
            yield _Obstacle(
                state="waiting: no joint_states",
                reason=f"{text}, at most {config.joints_timeout_s:g} s are allowed",
                every_goal=True,
            )
        elif self._unchecked and world.readings[2] > EXTENDED_M:
            text = self._left_behind_text()
            yield _Obstacle(state=f"waiting: {text}", reason=f"{text}, a stop is asked for", every_goal=True)
        heartbeat_age = self._age_s(world.heartbeat_ns)
        if heartbeat_age > config.heartbeat_timeout_s:
            yield _Obstacle(
                state="waiting: no operator (heartbeat)",
                reason=f"no operator heartbeat {_since(heartbeat_age)}, "
                f"at most {config.heartbeat_timeout_s:g} s are allowed",
                every_goal=True,
            )
        if world.camera_from_base is None or world.base_from_reading is None:
            yield _Obstacle(state="waiting: not calibrated", reason="not calibrated", every_goal=False)
        camera_age = self._age_s(world.camera_stamp_ns)
        if camera_age > config.camera_timeout_s:
            yield _Obstacle(
                state="waiting: no picture from the left camera",
                reason=f"no picture from the left camera {_since(camera_age)}, "
                f"at most {config.camera_timeout_s:g} s are allowed",
                every_goal=False,
            )
        yield from self._panel_obstacles()

    def _panel_obstacles(self) -> Iterator[_Obstacle]:
        world, config = self._world, self.config
        pose_age = self._age_s(world.panel_stamp_ns if self._panel_is_still() else None)
        if not world.confidence >= config.min_confidence:
            yield _Obstacle(
                state="waiting: panel not recognised",
                reason=f"the panel is recognised with confidence {world.confidence:.2f}, "
                f"at least {config.min_confidence:g} is needed",
                every_goal=False,
            )
        elif world.camera_from_panel is None or world.panel is None:
            missing = "pose" if world.camera_from_panel is None else "controls"
            yield _Obstacle(
                state="waiting: panel not recognised",
                reason=f"the panel is not recognised: no {missing} yet",
                every_goal=False,
            )
        elif pose_age > config.panel_max_age_s:
            yield _Obstacle(
                state="waiting: panel pose is old",
                reason=f"no pose of the panel {_since(pose_age)}, at most {config.panel_max_age_s:g} s are allowed",
                every_goal=False,
            )

    def _show_state(self) -> None:
        if self._job is not None:
            self._set_state(STATES.get(self.phase, "moving"))
        else:
            obstacle = next(self._obstacles(), None)
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
        self._accept_or_reject(gesture.id or text, text, lambda: self._gesture_job(gesture, text, gesture.id or text))

    def _point_text(self, goal: msg.PointGoal) -> str:
        x, y, z = goal.xyz
        if goal.frame == BASE:
            return f"move to ({x:.4f}, {y:.4f}, {z:.4f}) m in {BASE}"
        unit = "px" if goal.frame == CAMERA_LEFT else "m"
        return f"press ({x:.4f}, {y:.4f}) {unit} in {goal.frame}"

    def _accept_or_reject(self, goal_id: str, text: str, make_job: Callable[[], _Job]) -> None:
        try:
            if self._job is not None:
                raise Refused(f"busy with {self._job.text!r}")
            job = make_job()
            first = job.readings_at(job.tip_goal()[np.newaxis])[0]
            path = motion_plan.travel(self._readings(), first[:2], first[2], self.config.motion)
        except (Refused, OutOfReach) as error:
            self._reject(goal_id, text, str(error))
            return
        self._job = job
        self._unchecked = False
        self._publish(job, Outcome.ACCEPTED)
        self._actions.append(msg.ShowTarget(in_base=job.goal_base))
        self._go(Phase.MOVE if job.touch is None else Phase.APPROACH, path)

    def _point_job(self, goal: msg.PointGoal) -> _Job:
        if not np.isfinite(goal.xyz).all():
            raise Refused(f"point ({', '.join(f'{v:g}' for v in goal.xyz)}) is not finite")
        if goal.frame not in targets.FRAMES:
            raise Refused(f"frame {goal.frame!r} is none of {', '.join(targets.FRAMES)}")
        if goal.stamp_ns != 0:
            age_s = (self._now_ns - goal.stamp_ns) / NANO
            if not -self.config.goal_max_age_s <= age_s <= self.config.goal_max_age_s:
                raise Refused(f"stale: the stamp is {age_s:.3f} s old, {self.config.goal_max_age_s:g} s are allowed")
        if goal.frame == BASE:
            return self._move_job(goal)
        x, y, z = (float(v) for v in goal.xyz)
        if z != 0.0:
            raise Refused(f"z = {z:g} in {goal.frame} must be 0: the surface is found from the panel")
        gesture = Gesture(kind="press", target=Point(x=x, y=y, frame=goal.frame))
        return self._gesture_job(gesture, self._point_text(goal), str(goal.stamp_ns))

    def _move_job(self, goal: msg.PointGoal) -> _Job:
        if goal.xyz[2] > 0:
            raise Refused(f"z = {goal.xyz[2]:g} m is above 0, where the stylus is retracted")
        if goal.xyz[2] < 0 and self.config.motion.stylus_two_positions:
            raise Refused(f"z = {goal.xyz[2]:g} m: this stylus can only be up, 0, or touch")
        for obstacle in self._obstacles():
            if obstacle.every_goal:
                raise Refused(obstacle.reason)
        axes = self._world.base_from_reading
        job = _Job(
            goal_id=str(goal.stamp_ns),
            text=self._point_text(goal),
            kind="move",
            started_ns=self._now_ns,
            base_from_reading=np.eye(2) if axes is None else axes,
            goal_base=goal.xyz,
        )
        motion_plan.check_reach(job.readings_at(goal.xyz[np.newaxis]), self.config.motion)
        if goal.xyz[2] < 0:
            self._check_clear(goal.xyz)
        return job

    def _check_clear(self, goal: Array) -> None:
        """Refuse a point (3,) in base_link at which the stylus would touch the panel, as far as the panel is known."""
        world, config = self._world, self.config.touch
        parts = (world.camera_from_base, world.base_from_reading, world.camera_from_panel, world.camera, world.panel)
        if any(part is None for part in parts) or not world.confidence >= self.config.min_confidence:
            return
        lowest = targets.highest_near(goal[:2], self._scene(), config.side_needed_m()) + config.ball_radius_m
        if goal[2] < lowest:
            raise Refused(
                f"z = {goal[2]:.4f} m would touch the panel there, {lowest:.4f} m is the lowest; use press to touch"
            )

    def _gesture_job(self, gesture: Gesture, text: str, goal_id: str) -> _Job:
        if isinstance(gesture.target, Point) and gesture.target.frame not in targets.FRAMES:
            raise Refused(f"frame {gesture.target.frame!r} is none of {', '.join(targets.FRAMES)}")
        for obstacle in self._obstacles():
            raise Refused(obstacle.reason)
        scene, config = self._scene(), self.config
        wander = config.max_correction_m + config.motion.approach_m * math.sqrt(2)
        touch = targets.resolve(gesture, scene, config.touch, wander_m=wander)
        if config.motion.stylus_two_positions:
            touch = targets.with_two_positions(touch, config.motion.stylus_max_m)
        job = _Job(
            goal_id=goal_id,
            text=text,
            kind=gesture.kind,
            started_ns=self._now_ns,
            base_from_reading=scene.base_from_reading,
            scene=scene,
            touch=touch,
            goal_base=touch.in_base,
            hold_s={"hold": gesture.argument, "press": config.press_s}.get(gesture.kind, 0.0),
        )
        heights = np.array([[*touch.in_base[:2], z] for z in (touch.hover_z, touch.touch_z)])
        motion_plan.check_reach(job.readings_at(np.vstack([heights, touch.arc])), config.motion)
        return job

    def _scene(self) -> Scene:
        world = self._world
        assert world.camera_from_base is not None and world.camera_from_panel is not None
        assert world.base_from_reading is not None and world.camera is not None and world.panel is not None
        return Scene(
            camera_from_base=world.camera_from_base,
            camera_from_panel=world.camera_from_panel,
            base_from_reading=world.base_from_reading,
            panel=world.panel,
            camera=world.camera,
        )

    # Phases: each entry sets what the phase waits for and its deadline

    def _go(self, phase: Phase, path: Path) -> None:
        self.phase, self._phase_ns = phase, self._now_ns
        # Stamps identify trajectories, so two of one instant must differ.
        self._stamp_ns = max(self._now_ns, self._stamp_ns + 1)
        self._deadline_ns = self._now_ns + _nanoseconds(1.5 * path.duration_s + self.config.motion_timeout_s)
        if len(path.points):
            self._end, self._arrived_ns = path.points[-1], None
            self._actions.append(msg.SendTrajectory(stamp_ns=self._stamp_ns, path=path))
        else:
            # The machine stands there already; joint_states younger than this moment confirm it.
            self._end, self._arrived_ns = self._readings(), self._now_ns

    def _look_at_hover(self, job: _Job) -> None:
        config = self.config
        self._look(Phase.LOOK, config.settle_s, config.look_timeout_s, needed=config.tip_count, kept=config.tip_count)

    def _look_at_contact(self, job: _Job) -> None:
        config = self.config
        job.down_ns = self._now_ns
        most_s = {"turn": config.look_timeout_s, "hold": job.hold_s}.get(job.kind, config.press_max_s)
        # The machine came down slowly, stood for as long as its report took, and did not move sideways.
        self._look(Phase.CONTACT, 0.0, most_s, needed=config.contact_tip_count, kept=MAX_TIPS)

    def _look(self, phase: Phase, settle_s: float, timeout_s: float, *, needed: int, kept: int) -> None:
        self.phase = phase
        self._tips, self._tips_needed = deque(maxlen=kept), needed
        self._look_after_ns, self._look_until_ns = self._now_ns + _nanoseconds(settle_s), _FAR_NS
        self._deadline_ns = self._look_after_ns + _nanoseconds(timeout_s)

    def _advance(self) -> None:
        """Find out whether the phase has ended and follow the table, until nothing more happens at this instant."""
        while self._job is not None:
            step = self._ended(self._job)
            if step is None:
                return
            self._NEXT[self.phase, step](self, self._job)

    def _ended(self, job: _Job) -> Step | None:
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
            self._break_off(job, _Fault(cause=cause, stop=True))
        return None

    def _standing(self) -> bool:
        # The driver's state and joints come on other topics than its result, in any order.
        assert self._arrived_ns is not None
        idle = self._world.driver == "idle" or self._now_ns > self._arrived_ns + NANO
        return idle and self._world.readings_ns > self._arrived_ns

    def _check_arrival(self, job: _Job) -> bool:
        assert self._end is not None
        off = float(np.linalg.norm(self._readings() - self._end))
        if off <= self.config.arrival_tolerance_m:
            return True
        cause = (
            f"the driver reports the end of the motion {1000 * off:.2f} mm beside it, "
            f"{1000 * self.config.arrival_tolerance_m:g} mm are allowed"
        )
        self._break_off(job, _Fault(cause=cause, lift=False))
        return False

    # Look, judge, correct, touch

    def _seen_in_base(self, job: _Job) -> Array | None:
        if len(self._tips) < self._tips_needed:
            return None
        assert job.scene is not None
        base_from_camera = job.scene.camera_from_base.inverse()
        if self.config.camera_on_carriage:
            # The tip rests in these pictures; it is the panel that shows how far it is from its place.
            if not self._panel_is_still() or self._world.camera_from_panel is None:
                return None
            base_from_camera = job.scene.base_from_panel @ self._world.camera_from_panel.inverse()
        tips = base_from_camera.apply(np.array(self._tips))
        mean: Array = tips.mean(axis=0)
        spread = float(np.linalg.norm((tips - mean)[:, :2], axis=1).max())
        return mean if spread <= self.config.tip_spread_m else None

    def _seen_error(self, job: _Job, height_z: float) -> Array:
        """(3,) seen tip minus target, the target being the surface point raised to base z ``height_z``."""
        assert job.touch is not None
        seen = self._seen_in_base(job)
        assert seen is not None
        error: Array = seen - np.array([*job.touch.in_base[:2], height_z])
        return error

    def _judge_hover(self, job: _Job) -> None:
        assert job.touch is not None
        config = self.config
        error = self._seen_error(job, job.touch.hover_z)
        sideways = float(np.linalg.norm(error[:2]))
        job.hover_error_m = sideways
        if sideways > config.max_correction_m or abs(error[2]) > config.max_depth_error_m:
            self._break_off(
                job,
                _Fault(
                    cause=f"the tip is seen {1000 * sideways:.2f} mm beside and {1000 * error[2]:+.2f} mm above its "
                    f"place, {1000 * config.max_correction_m:g} and {1000 * config.max_depth_error_m:g} mm are "
                    "allowed: calibrate again"
                ),
            )
        elif sideways <= config.tolerance_m:
            self._touch_down(job)
        elif job.corrections < config.max_corrections:
            self._correct(job, error[:2])
        elif sideways <= config.max_error_m:
            self._touch_down(job)
        else:
            self._break_off(
                job,
                _Fault(
                    cause=f"the seen error is {1000 * sideways:.2f} mm after {job.corrections} corrections, "
                    f"{1000 * config.max_error_m:g} mm are allowed"
                ),
            )

    def _correct(self, job: _Job, error_xy: Array) -> None:
        job.corrections += 1
        job.correction = job.correction - np.linalg.solve(job.base_from_reading, error_xy)
        assert job.touch is not None
        aim = job.readings_at(job.touch.in_base[np.newaxis])[0]
        self._try(job, Phase.CORRECT, lambda: motion_plan.shift(self._readings(), aim[:2], self.config.motion))

    def _unseen_hover(self, job: _Job) -> None:
        if self.config.require_servo:
            self._break_off(job, _Fault(cause=self._unseen_text()))
        else:
            self._touch_down(job)

    def _unseen_text(self) -> str:
        spread_mm = 1000 * self.config.tip_spread_m
        return f"the tip was seen {len(self._tips)} times, {self._tips_needed} times within {spread_mm:g} mm are needed"

    def _touch_down(self, job: _Job) -> None:
        assert job.touch is not None
        depth = -job.touch.touch_z
        self._try(job, Phase.TOUCH, lambda: motion_plan.plunge(self._readings(), depth, self.config.motion))

    def _leave_contact(self, job: _Job) -> None:
        self._look_until_ns = self._now_ns
        if job.kind != "turn":
            self._lift(job)
        elif not self._measure_contact(job):
            # A knob is turned only from a place that is known to be right.
            self._break_off(job, _Fault(cause=job.complaint))
        else:
            assert job.touch is not None
            arc = job.readings_at(job.touch.arc)
            self._try(job, Phase.TURN, lambda: motion_plan.follow(self._readings(), arc, self.config.motion))

    def _measure_contact(self, job: _Job) -> bool:
        """Measure the error at contact; return whether it is good, else leave the reason in ``job.complaint``."""
        assert job.touch is not None
        if self._seen_in_base(job) is not None:
            job.error_m = float(np.linalg.norm(self._seen_error(job, job.touch.touch_z)[:2]))
        if math.isnan(job.error_m) and self.config.require_servo:
            job.complaint = f"touched, but not measured: {self._unseen_text()}"
        elif job.error_m > self.config.max_error_m:
            bound = 1000 * self.config.max_error_m
            job.complaint = f"touched {1000 * job.error_m:.2f} mm beside the target, {bound:g} mm are allowed"
        return not job.complaint

    def _wait_for_pictures(self, job: _Job) -> None:
        self.phase = Phase.MEASURE
        self._deadline_ns = self._now_ns + _nanoseconds(self.config.picture_wait_s)

    def _judge_contact(self, job: _Job) -> None:
        if self._measure_contact(job):
            self._finish(job, Outcome.REACHED)
        else:
            self._finish(job, Outcome.ABORTED, f"{job.complaint}; the stylus is up")

    def _lift(self, job: _Job) -> None:
        self._go(Phase.LIFT, motion_plan.lift(self._readings(), self.config.motion))

    def _try(self, job: _Job, phase: Phase, plan: Callable[[], Path]) -> None:
        """Enter a phase whose path may leave the reachable area because of a correction."""
        try:
            path = plan()
        except OutOfReach as error:
            self._break_off(job, _Fault(cause=f"corrected aim: {error}"))
            return
        self._go(phase, path)

    # Ends

    def _finish_move(self, job: _Job) -> None:
        readings = self._readings()
        at = np.array([*(job.base_from_reading @ readings[:2]), -readings[2]])
        job.error_m = float(np.linalg.norm(at - job.goal_base))
        self._finish(job, Outcome.REACHED)

    def _finish_broken_off(self, job: _Job) -> None:
        assert job.fault is not None
        self._finish(job, Outcome.ABORTED, f"{job.fault.cause}; the stylus is up")

    def _fault(self, job: _Job) -> _Fault | None:
        """Return what ends the goal early, if anything; asked after every event."""
        world, config = self._world, self.config
        state = world.driver.partition(":")[0]
        if state not in ("idle", "moving"):
            return _Fault(cause=f"the driver is {world.driver!r}", lift=False)
        if self._age_s(world.readings_ns) > config.joints_timeout_s:
            age = _since(self._age_s(world.readings_ns))
            return _Fault(cause=f"no joint_states {age}", lift=False, stop=True)
        if self._age_s(world.heartbeat_ns) > config.heartbeat_timeout_s:
            age = _since(self._age_s(world.heartbeat_ns))
            return _Fault(cause=f"lost the operator: no heartbeat {age}")
        if job.touch is None or self.phase in (Phase.LIFT, Phase.MEASURE):
            return None
        if self._age_s(world.camera_stamp_ns) > config.camera_timeout_s:
            age = _since(self._age_s(world.camera_stamp_ns))
            return _Fault(cause=f"the camera has stalled: no picture {age}")
        assert job.scene is not None
        # A dip of the confidence alone means nothing: the arm hides a part of the panel.
        if world.confidence >= config.min_confidence and world.camera_from_panel is not None:
            before, now = job.scene.camera_from_panel, world.camera_from_panel
            if config.camera_on_carriage:
                if not self._panel_is_still() or world.camera_from_base is None:
                    return None
                before, now = job.scene.base_from_panel, world.camera_from_base.inverse() @ now
            moved = float(np.linalg.norm(now.apply(job.touch.in_panel) - before.apply(job.touch.in_panel)))
            if moved > config.panel_moved_m:
                return _Fault(
                    cause=f"the panel has moved by {1000 * moved:.1f} mm at the target, "
                    f"{1000 * config.panel_moved_m:g} mm are allowed",
                    stop=self.phase in PUSHING,
                )
        return None

    def _break_off(self, job: _Job, fault: _Fault) -> None:
        """End the goal early: hold the machine, or let a motion in the air end and retract, or only report."""
        cause = fault.cause if job.fault is None else f"{job.fault.cause}; then {fault.cause}"
        if fault.stop:
            self._actions.append(msg.CallStop(reason=cause))
            self._finish(job, Outcome.ABORTED, f"{cause}; the machine was told to stop")
        elif not fault.lift or job.fault is not None:
            self._finish(job, Outcome.ABORTED, f"{cause}; nothing more was moved")
        else:
            job.fault = fault
            if self.phase in LOOKING:
                self._lift_after_fault(job)

    def _lift_after_fault(self, job: _Job) -> None:
        self._go(Phase.BREAK_OFF, motion_plan.lift(self._readings(), self.config.motion))

    def _finish(self, job: _Job, outcome: Outcome, reason: str = "") -> None:
        self.phase = Phase.IDLE
        self._job = None
        self._publish(job, outcome, reason)

    def _publish(self, job: _Job, outcome: Outcome, reason: str = "") -> None:
        self.counts[outcome] += 1
        details: list[tuple[str, str]] = [("gesture", job.kind)]
        if job.touch is not None:
            details.append(("control", job.touch.control))
            details.append(("target_base_m", " ".join(f"{v:.5f}" for v in job.touch.in_base)))
        if outcome.final:
            measured = "readings" if job.touch is None else "cameras"
            details.append(("measured_by", "nothing" if math.isnan(job.error_m) else measured))
            if job.touch is not None:
                details.append(("corrections", str(job.corrections)))
                details.append(("hover_error_m", f"{job.hover_error_m:.6f}"))
        result = GoalResult(
            goal_id=job.goal_id,
            goal=job.text,
            outcome=outcome,
            reason=reason,
            error_m=job.error_m,
            duration_s=(self._now_ns - job.started_ns) / NANO if outcome.final else math.nan,
            details=tuple(details),
        )
        self._actions.append(msg.PublishResult(result=result))

    def _reject(self, goal_id: str, text: str, reason: str) -> None:
        self.counts[Outcome.REJECTED] += 1
        result = GoalResult(goal_id=goal_id, goal=text, outcome=Outcome.REJECTED, reason=reason)
        self._actions.append(msg.PublishResult(result=result))

    def _readings(self) -> Array:
        assert self._world.readings is not None
        return self._world.readings

    def _age_s(self, when_ns: int | None) -> float:
        return math.inf if not when_ns else (self._now_ns - when_ns) / NANO


_DRIVER_TEXT = {
    "disconnected": "driver disconnected",
    "connecting": "driver connecting",
    "unhomed": "not homed",
    "homing": "homing",
    "moving": "the driver is moving",
    "mismatch": "settings mismatch",
    "disabled": "not enabled",
}


_FAR_NS = 2**63


def _nanoseconds(seconds: float) -> int:
    return round(seconds * NANO)


def _since(age_s: float) -> str:
    return f"for {age_s:.1f} s" if math.isfinite(age_s) else "yet"


def _id_in(text: str) -> str:
    """Return the id of a command that is otherwise wrong, so that who asked finds the answer; else its text."""
    _, found, identifier = text.partition(" id=")
    return identifier.strip()[:64] if found and identifier.strip() else text[:200]
