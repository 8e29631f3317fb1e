"""The whole robot in one process on one virtual clock: every core of the graph, without ROS, sockets and waiting.

Real are the controller, the driver with its G-code and protocol, and the mock board with its planner. So are the bench
(hidden errors, contacts, pictures), the stylus tracker, recognition and the hand-eye procedure. Left out are the
processes between them; what those cost is a delay here: a picture's results come ``PICTURE_S`` after its exposure, a
message takes ``MESSAGE_S``. Images are drawn only while a program waits for them: recognition looks at the panel before
each goal and while an effect is awaited. In between its last answer is repeated (all the time with ``watch_panel``).
Recognition reads the left image of the newest pair, after the tracker has measured the tip in that pair.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.goals.controller import Controller
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import LOOKING, UP, GoalPhase
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.motion.scene import PanelMap
from gantry_driver.core.states.machine_states import Answered, Position, StateChanged
from gantry_driver.mock.machine import MockMachine
from gantry_driver.mock.settings import make_eeprom
from harris_perception.core.alignment.layout_config import LayoutConfig
from harris_perception.core.alignment.layout_watch import LayoutWatch
from harris_perception.core.alignment.pair_config import PairConfig
from harris_perception.core.alignment.pair_watch import PairWatch
from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig
from harris_perception.core.hand_eye_procedure.calibration_run import CalibrationRun, SendCalibrationGoal
from harris_perception.core.hand_eye_procedure.calibration_solution import CalibrationFailed, CalibrationFinished
from harris_perception.core.hand_eye_procedure.still_watch import StillConfig
from harris_perception.core.pose.pose_agreement import PoseAgreement
from harris_perception.core.recognition.panel_reader import PanelReader
from harris_perception.core.recognition.recognition import PanelRecogniser, RecognitionConfig
from harris_perception.core.recognition.state_config import StateConfig
from harris_perception.core.stylus.stylus import StylusTracker
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from harris_perception.core.stylus.tip_record import TipRecord
from harris_perception.pairing.free_pairs import FreePairs, ImagePair
from harris_perception.pairing.free_tips import FreeTips
from icu_common.core.alignment.pair import PairCode
from icu_common.core.configuration.config import from_mapping, to_mapping
from icu_common.core.configuration.parameter_file import values_for
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.frames import BASE, JOINTS
from icu_common.core.goals.results import GoalResult
from icu_common.core.panel.panel_layout import PanelLayout, load_layout
from icu_simulator.core.bench import Bench
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.optics import stereo_rig
from icu_simulator.core.renderer import Renderer
from icu_simulator.imaging.stream import CameraStream
from icu_simulator.imaging.timing import Shot, shots
from support.parameter_files import CONFIG, parameters

START_S = 1000.0
FRAME_S = 1 / 15
PICTURE_S = 0.06
"""From exposure to the tip's message: measured on the graph by bench_graph_latency."""
INFO_S = 0.02
"""From exposure to camera_info, which comes with the image."""
MESSAGE_S = 0.002
TICK_S = 0.05
HEARTBEAT_S = 0.2
PANEL_S = 0.2
SAMPLE_S = 0.004
PANEL_LOOKS = 6
Event = Callable[[], None]


class VirtualRobot:
    """One robot; ``now`` is the only clock, in seconds. It homes, calibrates and recognises by :meth:`prepare`."""

    def __init__(
        self,
        seed: int,
        *,
        layout: str = "dso_bench_4",
        bench: dict[str, Any] | None = None,
        true_layout: PanelLayout | None = None,
        driver: dict[str, Any] | None = None,
        room: str = "ideal",
    ) -> None:
        self.layout: PanelLayout = load_layout(CONFIG / "scopes" / f"{layout}.yaml")
        in_room = values_for("bench", CONFIG / "rooms" / f"{room}.yaml")
        self.config = from_mapping(BenchConfig, {**parameters("bench"), **in_room, "seed": seed, **(bench or {})})
        self._made = self.layout if true_layout is None else true_layout
        self.bench = Bench(self._made, self.config)
        self.renderer = Renderer(self._made, self.config, self.bench.panel_from)
        self._stream = CameraStream()
        self._pairs = FreePairs(tolerance_ns=round(parameters("stylus_tracker")["pair_tolerance_s"] * 1e9))
        # Contents of the calibration files; the bench's true cameras may differ.
        rig = stereo_rig(self.config.camera)
        self.cameras = [CameraModel.from_mapping(rig.calibration(side)) for side in ("left", "right")]
        self.stereo = StereoModel(left=self.cameras[0], right=self.cameras[1])
        self.tracker = StylusTracker(from_mapping(StylusSearchConfig, parameters("stylus_tracker")), self.stereo)
        self._free_tips = FreeTips(self.tracker)
        # The right view at a left image's instant is interpolated between the right images of two pairs.
        self._newest: deque[ImagePair] = deque(maxlen=2)
        self._tracked_ns = 0
        self._seen: tuple[Any, Any] = (None, None)
        self._recognition = from_mapping(RecognitionConfig, parameters("recognition", "recognition"))
        self.recogniser = PanelRecogniser(self.layout, self._recognition)
        self.pair = PairWatch(
            from_mapping(PairConfig, parameters("stylus_tracker", "pair")), self.recogniser.meter, self.stereo
        )
        self.reader = PanelReader(self.layout, from_mapping(StateConfig, parameters("recognition", "state")))
        self.controls = LayoutWatch(
            from_mapping(LayoutConfig, parameters("stylus_tracker", "controls")), self.layout, self.stereo
        )
        self.heart = self.camera_on = True
        self._detector = HarrisDetector(HarrisConfig())
        self.controller = Controller(from_mapping(ControllerConfig, parameters("gantry_controller")))
        drive = {**parameters("serial_driver"), "enabled_at_start": True, **(driver or {})}
        self.driver = Machine(from_mapping(DriverConfig, drive))
        self.board = MockMachine(make_eeprom({}), seed=seed)
        self.now = 0.0
        self.phases: dict[str, float] = {}
        self.results: list[GoalResult] = []
        self.state = ""
        self.records: list[dict[str, Any]] = []
        self.stops: list[str] = []
        self.pictures = 0
        self._procedure: CalibrationRun | None = None
        self._queue: list[tuple[float, int, Event]] = []
        self._number = itertools.count()
        self._pose: Any = None
        self._tips = TipRecord()
        self._panel_stamp = 0
        self._pair_ns = 0
        self._rested_ns = 0
        self.watch_panel = False
        self._confidence = 0.0
        self._phase_s = 0.0
        self._sampled_s = -math.inf
        self.board.board.power_on(0.0)
        self.driver.opened(0.0)
        self._beat()
        self._every(HEARTBEAT_S, self._beat)
        self._every(TICK_S, lambda: self._tell(msg.Tick()))
        self._every(FRAME_S, self._expose)
        self._every(PANEL_S, self._every_panel)

    def turn_right_camera(self, degrees: tuple[float, float, float]) -> None:
        """Turn the right camera of the bench about its x, y, z by degrees; the robot's calibration stays."""
        camera = self.config.camera
        skew = tuple(a + b for a, b in zip(camera.skew_deg, degrees))
        self.config = dataclasses.replace(self.config, camera=dataclasses.replace(camera, skew_deg=skew))
        self.renderer = Renderer(self._made, self.config, self.bench.panel_from)

    def accept_pair(self) -> None:
        """Inform the comparison of the cameras that a new hand-eye calibration was made."""
        self.pair.accept()
        self._tell(msg.PairSeen(pair=self.pair.state))

    # What a user does

    def prepare(self, *, calibrate: bool = True) -> None:
        """Connect, home, calibrate (or take the calibration from the truth, which is quicker), recognise."""
        self.until(lambda: self.driver.state == "unhomed", 20.0)
        refusal = self.driver.home(self.now)
        assert not refusal, refusal
        self.until(lambda: self.driver.state == "idle", 60.0)
        if calibrate:
            parts = [
                from_mapping(kind, parameters("hand_eye", name))
                for name, kind in (("run", RunConfig), ("still", StillConfig), ("solver", HandEyeConfig))
            ]
            self._procedure = CalibrationRun(parts[0], parts[1], parts[2], self.stereo, self.now_ns)
            self._act(self._procedure.start(self.now_ns))
            self.until(lambda: self._procedure is None, 240.0)
        else:
            self._tell(msg.CalibrationSigma(value_m=0.0))
            self._tell(msg.CameraFromBase(transform=self.renderer.rig.rectified_left_from_base()))
            self._tell(msg.Axes(base_from_reading=self.bench.errors.base_from_carriage))
            self.run_for(0.5)
        self.command("", place=(0.01, 0.01))
        self.look_at_panel(3 * PANEL_LOOKS)
        self.run_for(0.5)

    def command(self, text: str, *, place: tuple[float, float] | None = None) -> GoalResult:
        """Give a gesture, or a place in base_link (m) to go to, and return the final answer."""
        count = len(self.results)
        self.begin(text, place=place)
        return self.answer(count)

    def begin(self, text: str, *, place: tuple[float, float] | None = None) -> None:
        """Give a command and do not wait."""
        if place is None:
            self._tell(msg.Command(text=text))
        else:
            self._tell(msg.PointGoal(frame=BASE, xyz=np.array([*place, 0.0]), stamp_ns=self.now_ns))

    def answer(self, count: int) -> GoalResult:
        """Return the first final answer after the first ``count`` ones."""
        self.until(lambda: any(r.outcome.final for r in self.results[count:]), 120.0)
        return next(r for r in self.results[count:] if r.outcome.final)

    def look_at_panel(self, times: int = PANEL_LOOKS) -> None:
        """Let recognition look at picture after picture, as it does all the time in the graph."""
        self._agreement = PoseAgreement(self._recognition.agreement, self.layout.size_mm)
        for _ in range(times):
            self.run_for(PANEL_S)
            self._recognise()

    def _recognise(self) -> None:
        """Look for the panel in the newest pair that the tracker has received."""
        if not self._newest:
            return
        for pair in self._newest:
            if pair.left_ns > self._tracked_ns and (pair.apart or pair is self._newest[-1]):
                self._track(pair)
        left, right, stamp = *self._seen, self._tracked_ns
        gray = cv2.cvtColor(left, cv2.COLOR_BGR2GRAY)
        found = self.recogniser.locate(gray, self._detector.detect(gray).xy, self.cameras[0])
        pose = self._agreement.add(None if found is None else found.camera_from_panel)
        self._pose = pose if pose is not None else self._pose
        self._confidence = found.agreement if found is not None and pose is not None else 0.0
        if found is not None and pose is not None:
            settings = parameters("recognition")
            tip, age_ns = self._tips.at(stamp, 1e9 * settings["tip_max_age_s"])
            wander_m, camera = 1e-9 * age_ns * settings["tip_speed_m_s"], self.cameras[0]
            seen = self.reader.read(left, pose, camera, stamp, patches=found.patches, tip=tip, wander_m=wander_m)
            self._tell(msg.PanelState(seen=seen))
            self._watch_pair(gray, right, pose, stamp)
        self._panel_stamp = stamp
        self._say_panel_now()

    def _watch_pair(self, gray: Any, right: Any, pose: Any, stamp: int) -> None:
        period_ns = 1e9 * self.pair.config.period_s
        if stamp - self._pair_ns < period_ns - 1 and self.pair.state.code is not PairCode.CHANGING:
            return
        gray_right = cv2.cvtColor(right, cv2.COLOR_BGR2GRAY)
        if self.pair.unchanged(gray, gray_right, stamp):
            self._pair_ns = stamp
            self._tell(msg.PairSeen(pair=self.pair.state))
        elif self.pair.look(gray, gray_right, pose, stamp):
            self._pair_ns = stamp
            self.tracker.recalibrate(self.pair.cameras)
            self._free_tips.forget()
            self._tell(msg.PairSeen(pair=self.pair.state))
            if self.pair.views is not None and self.pair.state.known:
                self.controls.look(self.pair.views, self.pair.camera_from_panel, self.pair.state.rotation_rad)
                self._tell(msg.LayoutSeen(deviations=self.controls.deviations()))

    def until(self, condition: Callable[[], Any], within_s: float) -> None:
        """Let time pass until the condition holds."""
        end = self.now + within_s
        while not condition():
            if self.now > end:
                raise TimeoutError(f"not within {within_s} s: {self.state!r}, {self.driver.state_text!r}")
            self._step(end + 1.0)

    def run_for(self, seconds: float) -> None:
        """Let time pass."""
        end = self.now + seconds
        while self.now < end:
            self._step(end)

    def set(self, values: dict[str, Any]) -> None:
        """Change settings of the bench by their dotted names, as a test's socket does."""
        old, self.config = self.config, from_mapping(BenchConfig, {**to_mapping(self.config), **values})
        self.bench.reconfigure(self.config)
        if self.config.imaging != old.imaging:
            self.renderer.reimage(self.config)
        if self.config.light != old.light:
            self.renderer.relight(self.config.light)
        if self.config.panel != old.panel:
            self.renderer.move_panel(self.bench.panel_from)

    def take_records(self) -> list[dict[str, Any]]:
        """Return the physical truth since the last call."""
        self.records += self.bench.take_records()
        records, self.records = self.records, []
        return records

    @property
    def now_ns(self) -> int:
        """The clock as a stamp."""
        return round((START_S + self.now) * 1e9)

    # Time

    def _every(self, period_s: float, event: Event) -> None:
        def again() -> None:
            event()
            self._after(period_s, again)

        self._after(period_s, again)

    def _after(self, seconds: float, event: Event) -> None:
        heapq.heappush(self._queue, (self.now + seconds, next(self._number), event))

    def _step(self, end: float) -> None:
        board = self.board.board
        due = [end, self._queue[0][0], self.driver.deadline(self.now)]
        if (next_due := board.next_due()) is not None:
            due.append(next_due)
        if board.moving():
            due.append(self._sampled_s + SAMPLE_S)
        self.now = max(min(due), self.now + 1e-6)
        board.advance(self.now)
        moving = board.moving()
        if moving or self.now - self._sampled_s > 0.05:
            self._sample()
        data = b"".join(board.take_output())
        if data:
            self.driver.receive(data, self.now)
        self.driver.tick(self.now)
        written = self.driver.output(self.now)
        if written:
            board.receive(written, self.now)
        self._collect()
        while self._queue and self._queue[0][0] <= self.now:
            heapq.heappop(self._queue)[2]()

    def _sample(self) -> None:
        self._sampled_s = self.now
        truth = self.board.truth()
        self.bench.feed(truth["mpos"], truth["spindle"], truth["coolant"], self.now)
        self.board.board.set_probe(self.bench.switch_closed)

    def _collect(self) -> None:
        for event in self.driver.take_events():
            if isinstance(event, StateChanged):
                self._later(msg.DriverState(text=event.text))
                if self._procedure is not None:
                    self._act(self._procedure.driver_state(event.text))
            elif isinstance(event, Answered):
                self._later(msg.MotionResult(result=event.result))
            elif isinstance(event, Position):
                reading = np.array(event.reading_m)
                self._later(msg.Joints(readings=reading, probe=event.probe))
                if self._procedure is not None:
                    self._procedure.reading(self.now_ns, reading)

    # Messages

    def _later(self, event: msg.Event) -> None:
        self._after(MESSAGE_S, lambda: self._tell(event))

    def _tell(self, event: msg.Event) -> None:
        before = self.controller.phase.value
        actions = self.controller.handle(event, self.now_ns)
        if self.controller.phase.value != before:
            self.phases[before] = self.phases.get(before, 0.0) + self.now - self._phase_s
            self._phase_s = self.now
        for action in actions:
            match action:
                case msg.SendTrajectory():
                    path, goal_id, intent = action.path, str(action.stamp_ns), action.intent
                    points = [
                        Waypoint(positions_m=tuple(p), time_s=float(t)) for p, t in zip(path.points, path.times_s)
                    ]
                    self._after(
                        MESSAGE_S,
                        lambda goal_id=goal_id, points=points, intent=intent: self.driver.run(
                            goal_id, JOINTS, points, age_s=MESSAGE_S, now=self.now, intent=intent
                        ),
                    )
                case msg.ReportPlane():
                    age_s = (self.now_ns - action.stamp_ns) / 1e9
                    self._after(
                        MESSAGE_S,
                        lambda plane=action.plane, age_s=age_s: self.driver.panel(plane, age_s, self.now),
                    )
                case msg.PublishResult():
                    self.results.append(action.result)
                    if self._procedure is not None:
                        self._act(self._procedure.result(action.result, self.now_ns))
                case msg.PublishState():
                    self.state = action.text
                case msg.CallStop():
                    self.stops.append(action.reason)
                    self.driver.stop(action.reason, self.now)

    def _act(self, actions: Sequence[Any] | Any) -> None:
        for action in actions:
            if isinstance(action, SendCalibrationGoal):
                xyz, stamp = np.asarray(action.xyz, dtype=np.float64), action.stamp_ns
                self._later(msg.PointGoal(frame=BASE, xyz=xyz, stamp_ns=stamp))
            elif isinstance(action, CalibrationFinished):
                self._procedure = None
                self.pair.accept()
                corners = np.array([(x, y, 0.0) for x in (0.03, 0.33) for y in (0.03, 0.18)])
                self._later(msg.CalibrationSigma(value_m=action.calibration.sigma_m(corners)))
                self._later(msg.CameraFromBase(transform=action.calibration.camera_from_base))
                self._later(msg.Axes(base_from_reading=action.calibration.base_from_reading))
            elif isinstance(action, CalibrationFailed):
                raise RuntimeError(f"calibration failed: {action.reason}")

    def _beat(self) -> None:
        if not self.heart:
            return
        self.driver.heartbeat(self.now)
        self._tell(msg.OperatorHeartbeat())

    def _stamp_ns(self, shot: Shot) -> int:
        return round((START_S + shot.stamp_s) * 1e9)

    def _pictures(self, due: Sequence[Shot]) -> dict[int, Any]:
        """Return the images of shots by their cameras."""
        self.pictures += 1
        self.bench.advance(self.now)
        self.renderer.follow_panel(self.bench.panel_from)
        images = self._stream.render(self._stream.expose(due, self.config, self.bench), self.renderer)
        return {image.camera: image.picture for image in images}

    def _expose(self) -> None:
        if not self.camera_on:
            return
        if self.driver.state == "idle":
            self._rested_ns = self.now_ns
        for shot in shots(self.config, self.now):
            stamp = self._stamp_ns(shot)
            if shot.camera == 0:
                self._after(INFO_S, lambda stamp=stamp: self._announce(stamp))
                seen = msg.CameraSeen(camera=self.cameras[0], stamp_ns=stamp)
                self._after(PICTURE_S, lambda seen=seen: self._tell(seen))
            pair = self._pairs.add(shot.camera, stamp, shot)
            if pair is not None:
                self._after(PICTURE_S, lambda pair=pair: self._see(pair))

    def _announce(self, stamp: int) -> None:
        if self._procedure is not None:
            self._act(self._procedure.image(stamp, self.now_ns))

    def _see(self, pair: ImagePair) -> None:
        self._newest.append(pair)
        if self.controller.phase not in LOOKING and self._procedure is None:
            return
        if self._procedure is not None and pair.left_ns > self._rested_ns:
            return
        self._track(pair)

    def _track(self, pair: ImagePair) -> None:
        """Measure the tip in a pair of images, as the tracker does."""
        stamp = self._tracked_ns = pair.left_ns
        pictures = self._pictures((pair.left, pair.right))
        self._seen = pictures[0], pictures[1]
        found = self._free_tips.find(pair, *self._seen)
        self._tips.add(stamp, found.tip)
        if found.tip is not None:
            self._tell(msg.TipSeen(in_camera=found.tip, stamp_ns=stamp))
        else:
            self._tell(msg.TipUnseen(stamp_ns=stamp))
        if self._procedure is not None:
            self._act(self._procedure.tip(stamp, found.tip, self.now_ns))

    def _every_panel(self) -> None:
        if self._procedure is not None:
            self._act(self._procedure.tick(self.now_ns))
        if self._pose is None or not self.camera_on:
            return
        wanted = self.watch_panel or self.controller.phase in (*UP, GoalPhase.READ, GoalPhase.WAIT)
        if wanted:
            self._recognise()
        else:
            self._panel_stamp = self.now_ns
            self._say_panel_now()
            if self.pair.state.code is not PairCode.UNKNOWN:
                self._tell(msg.PairSeen(pair=dataclasses.replace(self.pair.state, stamp_ns=self.now_ns)))

    def _say_panel_now(self) -> None:
        outline = np.array([(0, 0), self.layout.size_mm]) / 1000
        self._tell(msg.PanelControls(panel=PanelMap.of(self.layout.controls, outline)))
        if self._confidence > 0:
            self._tell(msg.PanelPose(camera_from_panel=self._pose, stamp_ns=self._panel_stamp))
        self._tell(msg.PanelConfidence(value=self._confidence))
