"""The robot without processes: hidden mechanics, drawn pictures, the real tracker, recogniser and calibration run.

What the nodes do over topics is done here by calls, so that a calibration takes seconds instead of a minute and can be
repeated over many seeds. The truth comes from scope_bench, which shares no geometry with the perception.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from gantry_driver.core import motion_plan
from gantry_driver.core.motion_plan import MotionConfig
from harris_perception.core.calibration_run import (
    Action,
    CalibrationRun,
    Failed,
    Finished,
    RunConfig,
    SendGoal,
    StillConfig,
)
from harris_perception.core.hand_eye import HandEyeConfig
from harris_perception.core.harris import HarrisConfig, HarrisDetector
from harris_perception.core.recognition import PanelRecogniser
from harris_perception.core.stylus import StylusConfig, StylusTracker
from icu_common.core.camera_model import CameraModel, StereoModel
from icu_common.core.geometry import Array, Transform
from icu_common.core.panel_layout import load_layout
from icu_common.core.results import GoalResult, Outcome
from scope_bench.core.configuration import BenchConfig
from scope_bench.core.instrument import InstrumentState
from scope_bench.core.mechanics import Mechanism, draw_errors
from scope_bench.core.renderer import Moment, Renderer, base_from_panel

ROOT = Path(__file__).parents[1]
LAYOUT = load_layout(ROOT / "config/scopes/dso_bench_4.yaml")
STEPS_PER_M = np.array([80e3, 80e3, 400e3])
_MS = 1_000_000
_PERIOD_NS = 66 * _MS
_NOISE_REACH_PX = 90
Picture = npt.NDArray[np.uint8]


class Studio:
    """What is slow to make and the same for every seed: the pictures' renderer (without noise) and the recogniser."""

    def __init__(self, config: BenchConfig) -> None:
        self.config = config
        quiet = replace(config, light=replace(config.light, noise=0.0))
        self.base_from_panel = base_from_panel(config.panel)
        self.renderer = Renderer(LAYOUT, quiet, self.base_from_panel)
        left, right = (CameraModel.from_mapping(self.renderer.rig.calibration(s)) for s in ("left", "right"))
        self.stereo = StereoModel(left=left, right=right)
        self.camera_from_base = self.renderer.rig.rectified_left_from_base()
        self.recogniser = PanelRecogniser(LAYOUT)
        self.detector = HarrisDetector(HarrisConfig())

    def stand(self, base_from_panel_now: Transform) -> None:
        """Put the panel elsewhere."""
        self.base_from_panel = base_from_panel_now
        self.renderer.move_panel(base_from_panel_now)


class Machine:
    """Motors, hidden errors and the true tip."""

    def __init__(self, config: BenchConfig, seed: int) -> None:
        self.motion = MotionConfig()
        self._homed = np.asarray(config.mechanics.homed_mm)
        self.errors = draw_errors(config.mechanics, np.random.default_rng(seed))
        self._mechanism = Mechanism(config.mechanics, config.stylus, self.errors)
        self.readings: Array = np.zeros(3)
        self.tip: Array = np.zeros(3)
        self._drive([np.zeros(3)])

    def go(self, aim_xy: Array, extension_m: float) -> None:
        """Travel as the controller does, by way of the approach point."""
        self._drive(motion_plan.travel(self.readings, aim_xy, extension_m, self.motion).points)

    def _drive(self, points: Iterable[Array]) -> None:
        for point in points:
            self.readings = np.round(np.asarray(point) * STEPS_PER_M) / STEPS_PER_M
            motor = self._homed + self.readings * (1e3, 1e3, -1e3)
            self.tip = self._mechanism.tip(motor, 0.0, False, 0.0)


class Robot:
    """One machine with its own hidden errors before the studio's cameras."""

    def __init__(self, studio: Studio, seed: int) -> None:
        self.studio, self.seed = studio, seed
        self.machine = Machine(studio.config, seed)
        self.rng = np.random.default_rng((seed, 1))
        self.now_ns = 10**12
        self._tracker = StylusTracker(StylusConfig(), studio.stereo)
        self._noise = self.rng.normal(0.0, studio.config.light.noise, (400, 400, 3)).astype(np.float32)

    def calibrate(self, plan: RunConfig, still: StillConfig, solver: HandEyeConfig) -> Finished:
        """Carry out a whole run.

        Raises
        ------
        RuntimeError
            If the run fails; with its reason.
        """
        run = CalibrationRun(plan, still, solver, self.now_ns)
        waiting: list[Action] = run.start(self.now_ns)
        while waiting:
            action = waiting.pop(0)
            if isinstance(action, Failed):
                raise RuntimeError(f"seed {self.seed}: {action.reason}")
            if isinstance(action, Finished):
                return action
            if isinstance(action, SendGoal):
                waiting += self._obey(run, action)
        raise RuntimeError(f"seed {self.seed}: the run stopped in its middle")

    def _obey(self, run: CalibrationRun, goal: SendGoal) -> list[Action]:
        x, y, z = goal.xyz
        run.result(self._answer(goal, Outcome.ACCEPTED), self.now_ns)
        self.machine.go(np.array([x, y]), -z)
        self.now_ns += 1000 * _MS
        run.reading(self.now_ns, self.machine.readings)
        actions = run.result(self._answer(goal, Outcome.REACHED), self.now_ns)
        if actions:
            return actions
        self.now_ns += 500 * _MS
        pictures = self.pictures()
        while not actions:
            self.now_ns += _PERIOD_NS
            run.reading(self.now_ns, self.machine.readings)
            found = self._tracker.find(*self.with_noise(pictures))
            if found.tip is not None:
                actions = run.tip(self.now_ns, found.tip, self.now_ns)
            actions = actions or run.tick(self.now_ns)
        return actions

    def _answer(self, goal: SendGoal, outcome: Outcome) -> GoalResult:
        return GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=outcome)

    def pictures(self) -> list[Picture]:
        """Draw what both cameras see now, without noise."""
        x, y, z = (float(v) for v in self.machine.tip)
        return self.studio.renderer.render(Moment(tip=(x, y, z), state=InstrumentState(), now_s=self.now_ns * 1e-9))

    def with_noise(self, pictures: list[Picture]) -> list[Picture]:
        """Add the sensor's noise around the ball; elsewhere the tracker does not measure."""
        rig = self.studio.renderer.rig
        noisy = []
        for picture, camera in zip(pictures, (rig.left, rig.right)):
            u, v = np.round(camera.project(self.machine.tip)[0]).astype(int)
            rows = slice(max(v - _NOISE_REACH_PX, 0), v + _NOISE_REACH_PX)
            columns = slice(max(u - _NOISE_REACH_PX, 0), u + _NOISE_REACH_PX)
            part = picture[rows, columns]
            top, left = self.rng.integers(0, 400 - 2 * _NOISE_REACH_PX, 2)
            noise = self._noise[top : top + part.shape[0], left : left + part.shape[1]]
            copy = picture.copy()
            copy[rows, columns] = np.clip(np.rint(part + noise), 0, 255)
            noisy.append(copy)
        return noisy

    def see_panel(self) -> Transform:
        """Recognise the panel in the left picture, with noise everywhere: camera_from_panel.

        Raises
        ------
        RuntimeError
            If it is not found.
        """
        gray = cv2.cvtColor(self.pictures()[0], cv2.COLOR_BGR2GRAY)
        noise = self.rng.normal(0.0, 0.6 * self.studio.config.light.noise, gray.shape)
        gray = np.clip(np.rint(gray + noise), 0, 255).astype(np.uint8)
        self.studio.recogniser.forget()
        seen = self.studio.recogniser.locate(gray, self.studio.detector.detect(gray).xy, self.studio.stereo.left)
        if seen is None:
            raise RuntimeError(f"seed {self.seed}: the panel was not recognised")
        return seen.camera_from_panel
