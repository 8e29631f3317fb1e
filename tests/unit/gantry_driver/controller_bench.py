"""A bench in virtual time for the controller's core: a machine with hidden errors, cameras, an operator, faults."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from support.pinhole import pinhole

from gantry_driver.core.goals.controller import Controller
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import GoalPhase
from gantry_driver.core.motion.scene import PanelControl, PanelMap
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.panel_state import ControlSeen, PanelSeen

MS = 1_000_000
START_NS = 1_700_000_000_000 * MS


def turned(axis: int, degrees: float) -> Array:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


# The camera looks at the panel from the side of -y, 25 degrees off the normal, from 0.65 m.
_AXES = turned(0, -25.0) @ np.diag([1.0, -1.0, -1.0])
_CENTRE = np.array([0.18, 0.10, -0.035])
CAMERA_FROM_BASE = Transform(_AXES, np.array([0.0, 0.0, 0.65]) - _AXES @ _CENTRE)
PANEL_TILT = turned(2, 1.2) @ turned(0, 0.3) @ turned(1, -0.2)
BASE_FROM_PANEL = Transform(PANEL_TILT, np.array([0.020, 0.025, -0.035]))
CAMERA_FROM_PANEL = CAMERA_FROM_BASE @ BASE_FROM_PANEL
CAMERA = pinhole(k1=-0.08)


def control(
    name: str, kind: str, x_mm: float, y_mm: float, w: float, h: float, up: float, r: bool = False
) -> PanelControl:
    return PanelControl(
        name=name,
        kind=kind,
        centre=np.array([x_mm, y_mm]) / 1000,
        size=np.array([w, h]) / 1000,
        height=up / 1000,
        round=r,
    )


PANEL = PanelMap(
    controls=(
        control("SCREEN", "touch_area", 100, 82, 170, 105, 0),
        control("RUN_STOP", "button", 208, 127, 16, 9, 3),
        control("SINGLE", "button", 232, 127, 16, 9, 3),
        control("CH1", "button", 211, 71, 14, 8, 3),
        control("CRAMPED", "button", 250, 71, 6, 6, 3),
        control("CRAMPING", "knob", 258, 71, 12, 12, 15, True),
        control("CH1_SCALE", "knob", 211, 92, 18, 18, 15, True),
        control("CH1_IN", "connector", 211, 13, 14, 14, 12, True),
    ),
    extent=np.array([[0.0, 0.0], [0.320, 0.150]]),
)


KNOB, BUTTON = np.array([0.211, 0.092, 0.015]), np.array([0.208, 0.127, 0.003])
BUTTON_Z = float(BASE_FROM_PANEL.apply([0.208, 0.127, 0.003])[2]) + 0.002
"""Height over base_link, in metres, below which the tip presses RUN_STOP."""
"""The centres of the tops of CH1_SCALE and RUN_STOP in panel_link."""
BALL_M, ROUNDING_M = 0.002, 1e-6
"""Radius of the stylus ball; it touches a surface from which its centre is as far, apart from rounding."""


class Bench:
    """Feeds a controller as the graph would, in steps of 20 ms, and keeps what it wanted done.

    The machine: readings become places by ``true_axes`` after each axis has lost ``backlash`` in its direction; the
    cameras see the tip with ``noise_m`` (standard deviation, per axis of base_link).
    """

    def __init__(self, config: ControllerConfig | None = None, seed: int = 1) -> None:
        self.controller = Controller(config or ControllerConfig())
        self.rng = np.random.default_rng(seed)
        self.now_ns = START_NS
        self.true_axes = np.eye(2)
        self.tip_offset = np.zeros(3)
        self.backlash = np.zeros(2)
        self.noise_m = np.zeros(3)
        self.stroke_m = 0.0015
        self.sunk_m = 0.0  # how much lower the whole panel is than the cameras see it
        self.carriage = np.zeros(2)
        self.readings = np.zeros(3)
        self.confidence = 0.9
        self.camera_from_panel = CAMERA_FROM_PANEL
        self.driver = "idle"
        self.talking = {"heartbeat", "joints", "camera", "tip", "tracker", "panel", "driver"}
        self.calibration: tuple[Transform, Array] | None = (CAMERA_FROM_BASE, np.eye(2))
        self.answer: Outcome = Outcome.REACHED
        self.answer_reason = ""
        self.on_phase: dict[GoalPhase, Callable[[Bench], None]] = {}
        # States of the controls, for tests that make them visible ("state" in talking).
        self.knob_deg = 20.0
        self.knob_slips = 0.0
        self.lamp = "green"
        self.dazzle_m = 0.0  # so near to RUN_STOP its lamp, if it shines, hides the tip
        self.hidden: dict[str, str] = {}
        self.state_late_s = 0.0  # delay from an image to the states of the controls in it
        self.screen_changed_ns = 0
        self.actions: list[msg.Action] = []
        self.lowest: list[Array] = []
        self._motion: tuple[msg.SendTrajectory, int, Array] | None = None
        self._steps = 0
        self._states: deque[PanelSeen] = deque()

    # Inputs of the controller

    def tell(self, event: msg.Event) -> None:
        before = self.controller.phase
        actions = self.controller.handle(event, self.now_ns)
        self.actions += actions
        for action in actions:
            if isinstance(action, msg.SendTrajectory):
                self._motion = (action, self.now_ns, self.readings.copy())
                self._say_driver("moving")
            elif isinstance(action, msg.CallStop):
                self._motion = None
                self._say_driver("stopped: on request")
        after = self.controller.phase
        if after is not before and after in self.on_phase:
            self.on_phase.pop(after)(self)

    def _say_driver(self, text: str) -> None:
        self.driver = text
        if "driver" in self.talking:
            self.tell(msg.DriverState(text=text))

    def start(self) -> Bench:
        self._say_driver(self.driver)
        if self.calibration is not None:
            self.tell(msg.CameraFromBase(transform=self.calibration[0]))
            self.tell(msg.Axes(base_from_reading=self.calibration[1]))
        self.run(0.3)
        return self

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self._step()

    def run_goal(self, within_s: float = 60.0) -> GoalResult:
        """Run until the goal has its final answer and return it."""
        count = len(self.finals)
        for _ in range(round(within_s / 0.02)):
            self._step()
            if len(self.finals) > count:
                return self.finals[-1]
        raise AssertionError(f"no final answer within {within_s} s; phase {self.controller.phase}")

    def do(self, command: str) -> GoalResult:
        """Give a command and return its final answer."""
        count = len(self.finals)
        self.tell(msg.Command(text=command))
        return self.finals[-1] if len(self.finals) > count else self.run_goal()

    def go(self, x: float, y: float, z: float = 0.0, frame: str = "base_link", stamp_ns: int = 0) -> GoalResult:
        """Give a point goal and return its final answer."""
        count = len(self.finals)
        self.tell(msg.PointGoal(frame=frame, xyz=np.array([x, y, z]), stamp_ns=stamp_ns))
        return self.finals[-1] if len(self.finals) > count else self.run_goal()

    # What it did

    @property
    def results(self) -> list[GoalResult]:
        return [a.result for a in self.actions if isinstance(a, msg.PublishResult)]

    @property
    def finals(self) -> list[GoalResult]:
        return [r for r in self.results if r.outcome.final]

    @property
    def paths(self) -> list[Array]:
        return [a.path.points for a in self.actions if isinstance(a, msg.SendTrajectory)]

    @property
    def states(self) -> list[str]:
        return [a.text for a in self.actions if isinstance(a, msg.PublishState)]

    @property
    def stops(self) -> int:
        return sum(isinstance(a, msg.CallStop) for a in self.actions)

    def tip_in_base(self) -> Array:
        """The ball's true centre: a surface stops it, a button only at the end of its stroke."""
        tip = np.array([*(self.true_axes @ self.carriage), -self.readings[2]]) + self.tip_offset
        x, y, z = BASE_FROM_PANEL.inverse().apply(tip)
        under = [c for c in PANEL.controls if c.gap(np.array([x, y])) == 0]
        tops = [c.height - (self.stroke_m if c.kind == "button" else 0.0) for c in under]
        lowest = max([0.0, *tops]) + BALL_M - self.sunk_m
        return BASE_FROM_PANEL.apply(np.array([x, y, max(z, lowest)]))

    def tip_seen_in_base(self) -> Array:
        """Where the cameras take the ball's centre to be."""
        return self.tip_in_base()

    # The world

    def _step(self) -> None:
        self.now_ns += 20 * MS
        self._steps += 1
        self._move()
        if "heartbeat" in self.talking and self._steps % 10 == 0:
            self.tell(msg.OperatorHeartbeat())
        if "joints" in self.talking and self._steps % 3 == 0:
            self.tell(msg.Joints(readings=self.readings.copy()))
        if self._steps % 3 == 1:
            self._take_picture()
        while self._states and self._states[0].stamp_ns <= self.now_ns - self.state_late_s * 1e9:
            self.tell(msg.PanelState(seen=self._states.popleft()))
        self.tell(msg.Tick())

    def _take_picture(self) -> None:
        if "camera" not in self.talking:
            return
        self.tell(msg.CameraSeen(camera=CAMERA, stamp_ns=self.now_ns))
        if "panel" in self.talking:
            self.tell(msg.PanelPose(camera_from_panel=self.camera_from_panel, stamp_ns=self.now_ns))
            self.tell(msg.PanelConfidence(value=self.confidence))
            if self._steps < 10:
                self.tell(msg.PanelControls(panel=PANEL))
        if "state" in self.talking and self._steps % 9 == 1:
            self._states.append(self._panel_seen())
        if "tip" in self.talking and not self._dazzled():
            seen = self.tip_seen_in_base() + self.noise_m * self.rng.standard_normal(3)
            self.tell(msg.TipSeen(in_camera=self.camera_from_base().apply(seen), stamp_ns=self.now_ns))
        elif "tracker" in self.talking:
            self.tell(msg.TipUnseen(stamp_ns=self.now_ns))

    def _dazzled(self) -> bool:
        place = BASE_FROM_PANEL.inverse().apply(self.tip_in_base())[:2]
        return self.lamp != "off" and float(np.linalg.norm(place - BUTTON[:2])) < self.dazzle_m

    def camera_from_base(self) -> Transform:
        """Where base_link truly is in the camera's frame."""
        return CAMERA_FROM_BASE

    def _panel_seen(self) -> PanelSeen:
        over = float(np.linalg.norm((BASE_FROM_PANEL.inverse().apply(self.tip_in_base()) - KNOB)[:2])) < 0.02
        hidden = {**({"CH1_SCALE": "stylus"} if over else {}), **self.hidden}
        seen = [
            ControlSeen(
                name="RUN_STOP",
                kind="button",
                lamp="" if "RUN_STOP" in hidden else self.lamp,
                hidden_by=hidden.get("RUN_STOP", ""),
            ),
            ControlSeen(
                name="CH1_SCALE",
                kind="knob",
                angle_deg=float("nan") if "CH1_SCALE" in hidden else self.knob_deg,
                hidden_by=hidden.get("CH1_SCALE", ""),
                detent_deg=18.0,
                marks=(("UP", 0.0), ("LEFT", 90.0)),
            ),
            ControlSeen(name="SCREEN", kind="touch_area", changed_ns=self.screen_changed_ns),
        ]
        return PanelSeen(stamp_ns=self.now_ns, controls=tuple(seen))

    def _move(self) -> None:
        if self._motion is None:
            return
        action, since_ns, start = self._motion
        path = action.path
        elapsed_s = (self.now_ns - since_ns) / 1e9
        if self.answer is not Outcome.REACHED and elapsed_s > 0.05:
            self._answer(action, self.answer)
            return
        times, points = np.concatenate([[0.0], path.times_s]), np.vstack([start, path.points])
        last_s = elapsed_s - 0.02
        for time_s in [*times[(times > last_s) & (times < elapsed_s)], elapsed_s]:
            self._stand_at(np.array([np.interp(time_s, times, points[:, i]) for i in range(3)]))
        if elapsed_s > path.times_s[-1] + 0.1:
            self._answer(action, Outcome.REACHED)

    def _stand_at(self, readings: Array) -> None:
        before = BASE_FROM_PANEL.inverse().apply(self.tip_in_base()) - KNOB
        self.readings = readings
        # Play: the carriage stays behind by up to the backlash, in either direction.
        self.carriage = np.clip(self.carriage, readings[:2] - self.backlash, readings[:2])
        after = BASE_FROM_PANEL.inverse().apply(self.tip_in_base()) - KNOB
        touches = max(before[2], after[2]) < BALL_M + ROUNDING_M
        if touches and max(np.linalg.norm(before[:2]), np.linalg.norm(after[:2])) < 0.009:
            turned = np.degrees(np.arctan2(after[1], after[0]) - np.arctan2(before[1], before[0]))
            self.knob_deg += (1 - self.knob_slips) * ((turned + 180) % 360 - 180)
            self.knob_deg = (self.knob_deg + 180) % 360 - 180
        self.lowest.append(self.tip_in_base())

    def _answer(self, action: msg.SendTrajectory, outcome: Outcome) -> None:
        self._motion = None
        if "driver" in self.talking:
            result = GoalResult(goal_id=str(action.stamp_ns), goal="", outcome=outcome, reason=self.answer_reason)
            self.tell(msg.MotionResult(result=result))
            if self.driver == "moving":
                self._say_driver("idle")


class RidingBench(Bench):
    """The same with the cameras on the carriage; the panel's pose is given by way of them."""

    def __init__(self, config: ControllerConfig | None = None, seed: int = 1) -> None:
        super().__init__(config or ControllerConfig(camera_on_carriage=True), seed)
        self.calibration = None
        self.base_from_panel = BASE_FROM_PANEL

    def start(self) -> Bench:
        self.tell(msg.Axes(base_from_reading=self.true_axes))
        return super().start()

    def camera_from_base(self) -> Transform:
        moved = self.true_axes @ self.carriage - (0.18, 0.10)
        return self._from(moved)

    def _from(self, moved: Array) -> Transform:
        shift = CAMERA_FROM_BASE.rotation @ np.array([*moved, 0.0])
        return Transform(CAMERA_FROM_BASE.rotation, CAMERA_FROM_BASE.translation - shift)

    def _take_picture(self) -> None:
        # Hand-eye knows the readings and the axes, not the backlash.
        self.tell(msg.CameraFromBase(transform=self._from(self.true_axes @ self.readings[:2] - (0.18, 0.10))))
        self.camera_from_panel = self.camera_from_base() @ self.base_from_panel
        super()._take_picture()


def config(**changes: object) -> ControllerConfig:
    return replace(ControllerConfig(), **changes)  # type: ignore[arg-type]


def details(result: GoalResult) -> dict[str, str]:
    return dict(result.details)
