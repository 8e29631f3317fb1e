"""Robot without processes: hidden mechanics, drawn images, the real tracker, recogniser and calibration run.

Calls replace the topics between nodes, so that a calibration takes seconds instead of a minute and can be repeated over
many seeds. The truth comes from icu_simulator, which shares no geometry code with the perception.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from gantry_driver.core.motion import motion_plan
from gantry_driver.core.motion.motion_plan import MotionConfig
from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig
from harris_perception.core.hand_eye_procedure.calibration_run import Action, CalibrationRun, SendCalibrationGoal
from harris_perception.core.hand_eye_procedure.calibration_solution import CalibrationFailed, CalibrationFinished
from harris_perception.core.hand_eye_procedure.still_watch import StillConfig
from harris_perception.core.recognition.recognition import PanelRecogniser
from harris_perception.core.recognition.sighting import Sighting
from harris_perception.core.stylus.stylus import StylusTracker
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.instrument import InstrumentState
from icu_simulator.core.mechanics import Mechanism, draw_errors
from icu_simulator.core.optics import Camera
from icu_simulator.core.renderer import Moment, Renderer, base_from_panel
from icu_simulator.core.stylus_picture import StylusPainter

ROOT = Path(__file__).parents[2]
LAYOUT = load_layout(ROOT / "config/scopes/dso_bench_4.yaml")
STEPS_PER_M = np.array([80e3, 80e3, 400e3])
_MS = 1_000_000
_PERIOD_NS = 66 * _MS
_NOISE_REACH_PX = 90
_NOISE_ROOM = 256
OUT_OF_SIGHT = (-0.6, 0.6, 0.0)
Picture = npt.NDArray[np.uint8]


class Studio:
    """Objects that are slow to create and equal for all seeds: the renderer (without noise) and the recogniser."""

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
        size = (config.camera.height_px + _NOISE_ROOM, config.camera.width_px + _NOISE_ROOM)
        # A grey value is the weighted mean of three values, so its noise is 0.67 of theirs.
        field = np.random.default_rng(7).normal(0.0, 0.67 * config.light.noise, size)
        self.gray_noise = np.rint(field).astype(np.int16)
        self.on_carriage = config.camera.mounting == "carriage"
        self._drawn: dict[tuple[int, int, int], tuple[Array, list[Picture]]] = {}

    def stand(self, base_from_panel_now: Transform) -> None:
        """Move the panel to another position."""
        self.base_from_panel = base_from_panel_now
        self.renderer.move_panel(base_from_panel_now)
        self._drawn.clear()

    def pictures(self, moment: Moment, reading: Array) -> list[Picture]:
        """Draw the images of both cameras, without noise.

        Cameras on the carriage have another image at each of its positions, which takes long to draw. So each position
        is drawn once, at the first machine's actual carriage position. For the other machines the image is shifted as
        the panel's face shifts, by some tenths of a millimetre. Controls above the face are then off by up to 0.1 px;
        the recogniser does not measure them.
        """
        if not self.on_carriage:
            return self.renderer.render(moment)
        key = (round(reading[0] * 500), round(reading[1] * 500), round(reading[2] * 1000))
        if key not in self._drawn:
            away = replace(moment, tip=OUT_OF_SIGHT)
            self._drawn[key] = np.asarray(moment.carriage), self.renderer.render(away)
        place, drawn = self._drawn[key]
        shift = np.asarray(moment.carriage) - place
        # The panel is searched in the left image only; in the right one it is only background of the ball.
        pictures = [self._shifted(drawn[0], self.renderer.rig.left, shift, place), drawn[1].copy()]
        for picture, view in zip(pictures, self.renderer.views):
            tip = np.asarray(moment.tip) - np.array([*moment.carriage, 0.0])
            StylusPainter(view, self.config.stylus).draw(picture, tip)
        return pictures

    def _shifted(self, picture: Picture, camera: Camera, shift: Array, place: Array) -> Picture:
        """Return the image from a camera moved by ``shift`` (2,) m; exact for the panel's face."""
        # The map is smooth, so it is computed at every 32nd pixel.
        v, u = np.mgrid[0 : camera.height + 31 : 32, 0 : camera.width + 31 : 32].astype(np.float64)
        a, b = camera.slopes(u.ravel(), v.ravel())
        rays = np.column_stack([a, b, np.ones_like(a)]) @ camera.camera_from_base.rotation
        face = self.base_from_panel
        eye = camera.position + np.array([*(place + shift), 0.0])
        far = ((face.translation - eye) @ face.rotation[:, 2]) / (rays @ face.rotation[:, 2])
        seen = eye + rays * far[:, None] - np.array([*place, 0.0])
        pixels = camera.project(seen) - np.column_stack([u.ravel(), v.ravel()])
        rows, columns = u.shape
        moved = [
            _spread(part.reshape(rows, columns), camera.height, camera.width) for part in pixels.T.astype(np.float32)
        ]
        y, x = _pixels(camera.height, camera.width)
        return np.asarray(
            cv2.remap(picture, x + moved[0], y + moved[1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        )


def _spread(coarse: npt.NDArray[np.float32], height: int, width: int) -> npt.NDArray[np.float32]:
    """Interpolate values given at every 32nd pixel."""
    y, x = _pixels(height, width)
    return np.asarray(cv2.remap(coarse, x / 32, y / 32, cv2.INTER_LINEAR))


@functools.lru_cache(maxsize=2)
def _pixels(height: int, width: int) -> npt.NDArray[np.float32]:
    return np.mgrid[0:height, 0:width].astype(np.float32)


class Machine:
    """Motors, hidden errors and the tip's true position."""

    def __init__(self, config: BenchConfig, seed: int) -> None:
        self.motion = MotionConfig()
        self._homed = np.asarray(config.mechanics.homed_mm)
        self.errors = draw_errors(config.mechanics, np.random.default_rng(seed))
        self._mechanism = Mechanism(config.mechanics, config.stylus, self.errors)
        self.readings: Array = np.zeros(3)
        self.tip: Array = np.zeros(3)
        self.carriage: Array = np.zeros(2)
        self._drive([np.zeros(3)])

    def go(self, aim_xy: Array, extension_m: float) -> None:
        """Move as the controller does, by way of the approach point."""
        self._drive(motion_plan.travel(self.readings, aim_xy, extension_m, self.motion).points)

    def _drive(self, points: Iterable[Array]) -> None:
        for point in points:
            self.readings = np.round(np.asarray(point) * STEPS_PER_M) / STEPS_PER_M
            motor = self._homed + self.readings * (1e3, 1e3, -1e3)
            self.tip = self._mechanism.tip(motor, 0.0, False, 0.0)
            self.carriage = self._mechanism.carriage


class Robot:
    """One machine with its own hidden errors in view of the studio's cameras."""

    def __init__(self, studio: Studio, seed: int) -> None:
        self.studio, self.seed = studio, seed
        self.machine = Machine(studio.config, seed)
        self.rng = np.random.default_rng((seed, 1))
        self.now_ns = 10**12
        self._tracker = StylusTracker(StylusSearchConfig(), studio.stereo)
        self._noise = self.rng.normal(0.0, studio.config.light.noise, (400, 400, 3)).astype(np.float32)

    def calibrate(self, plan: RunConfig, still: StillConfig, solver: HandEyeConfig) -> CalibrationFinished:
        """Carry out a complete calibration run.

        Raises
        ------
        RuntimeError
            If the run fails, with the reason.
        """
        run = CalibrationRun(plan, still, solver, self.studio.stereo, self.now_ns)
        waiting: list[Action] = run.start(self.now_ns)
        while waiting:
            action = waiting.pop(0)
            if isinstance(action, CalibrationFailed):
                raise RuntimeError(f"seed {self.seed}: {action.reason}")
            if isinstance(action, CalibrationFinished):
                return action
            if isinstance(action, SendCalibrationGoal):
                waiting += self._obey(run, action, still)
        raise RuntimeError(f"seed {self.seed}: the run stopped in its middle")

    def _obey(self, run: CalibrationRun, goal: SendCalibrationGoal, still: StillConfig) -> list[Action]:
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
        looks = still.panels if self.studio.on_carriage else 0
        while not actions:
            self.now_ns += _PERIOD_NS
            run.reading(self.now_ns, self.machine.readings)
            found = self._tracker.find(*self.with_noise(pictures))
            if found.tip is not None:
                actions = run.tip(self.now_ns, found.tip, self.now_ns)
            if not actions and looks:
                seen = self._panel_in(pictures)
                if seen is not None:
                    looks -= 1
                    actions = run.panel(self.now_ns, seen.camera_from_panel, seen.points, self.now_ns)
            actions = actions or run.tick(self.now_ns)
        return actions

    def _answer(self, goal: SendCalibrationGoal, outcome: Outcome) -> GoalResult:
        return GoalResult(goal_id=str(goal.stamp_ns), goal="", outcome=outcome)

    def pictures(self) -> list[Picture]:
        """Draw the current images of both cameras, without noise."""
        x, y, z = (float(v) for v in self.machine.tip)
        a, b = (float(v) for v in self.machine.carriage)
        moment = Moment(tip=(x, y, z), state=InstrumentState(), now_s=0.0, carriage=(a, b))
        return self.studio.pictures(moment, self.machine.readings)

    def with_noise(self, pictures: list[Picture]) -> list[Picture]:
        """Add the sensor's noise around the ball; the tracker does not measure elsewhere."""
        rig = self.studio.renderer.rig
        noisy = []
        for picture, camera in zip(pictures, (rig.left, rig.right)):
            rides = self.machine.carriage if self.studio.on_carriage else np.zeros(2)
            u, v = np.round(camera.project(self.machine.tip - np.array([*rides, 0.0]))[0]).astype(int)
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
        """Recognise the panel in the left image, with noise everywhere; return camera_from_panel.

        Raises
        ------
        RuntimeError
            If the panel is not found.
        """
        for _ in range(5):
            seen = self._panel_in(self.pictures())
            if seen is not None:
                return seen.camera_from_panel
        raise RuntimeError(f"seed {self.seed}: the panel was not recognised")

    def _panel_in(self, pictures: list[Picture]) -> Sighting | None:
        gray = cv2.cvtColor(pictures[0], cv2.COLOR_BGR2GRAY)
        # One large field of noise, added to the image with another offset each time.
        top, left = self.rng.integers(0, _NOISE_ROOM, 2)
        noise = self.studio.gray_noise[top : top + gray.shape[0], left : left + gray.shape[1]]
        gray = cv2.add(gray, noise, dtype=cv2.CV_8U)
        recogniser, camera = self.studio.recogniser, self.studio.stereo.left
        # As the node does: first near the last sighting, after a long move everywhere.
        seen = recogniser.locate(gray, np.empty((0, 2)), camera)
        if seen is None:
            seen = recogniser.locate(gray, self.studio.detector.detect(gray).xy, camera)
        return seen
