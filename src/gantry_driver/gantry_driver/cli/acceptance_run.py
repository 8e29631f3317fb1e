"""Steps of ``gantry_accept``: moves and touches over the graph, and what the cameras see meanwhile."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from gantry_driver.acceptance.axes_fit import fit_axes
from gantry_driver.acceptance.coverage import along_outline, mask_of, view_of
from gantry_driver.acceptance.measured import Beyond, CameraSnapshot, Measured, MeasuredTouch, Visit
from gantry_driver.acceptance.sharpness import edge_blur_px
from gantry_driver.acceptance.stops import beyond, plan_stops
from gantry_driver.acceptance.touch_points import choose_points
from gantry_driver.cli.operator_session import OperatorSession, say
from gantry_driver.core.job.goal_job import WORKING
from icu_common.core.geometry.camera_model import StereoModel
from icu_common.core.geometry.frames import BASE, JOINT_X, JOINT_Y, PANEL
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.processes.delays import ResultCode
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import camera_model, image_array
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.messages.joints import joint_positions
from icu_common.nodes.messages.panels import controls_of_message
from icu_common.nodes.messages.places import axes_of_message, point_array, point_message, transform_of_pose

CONTROLLER = "gantry/gantry_controller"
LIMITS = ("motion.x_min_m", "motion.y_min_m", "motion.x_max_m", "motion.y_max_m")
ON_CARRIAGE = "camera_on_carriage"
START_S, GOAL_S, LOOK_S = 30.0, 60.0, 2.0
"""Maximum seconds for the first messages, for a goal, and for a look at the tip."""
SETTLE_S = 0.1
"""Seconds between the arrival and the first image that counts, for the stylus to stop swinging."""
TIPS = 4
"""Number of tips whose median counts at a stop."""
STALE_TRIES = 3
CAMERAS = ("left", "right")


class NotPossible(Exception):
    """The graph cannot be tested as it is; the message gives the reason and the remedy."""


class AcceptanceRun:
    """Carries out the test on a session of an operator; :attr:`measured` grows while it runs."""

    def __init__(self, session: OperatorSession, touches: int) -> None:
        self._session, self._touches = session, touches
        node = session.node
        self._goals = node.create_publisher(PointStamped, "gantry/goal", qos.COMMAND)
        self._newest: dict[str, Any] = {}
        self._tips: list[PointStamped] = []
        self._stamp_ns = 0
        for topic, kind, profile in (
            ("joint_states", JointState, qos.SENSOR),
            ("panel/pose", PoseStamped, qos.LATCHED),
            ("panel/controls", MarkerArray, qos.LATCHED),
            ("calibration/axes", Float64MultiArray, qos.LATCHED),
            *((f"stereo/{side}/camera_info", CameraInfo, qos.SENSOR) for side in CAMERAS),
        ):
            node.create_subscription(kind, topic, self._keep(topic), profile)
        node.create_subscription(PointStamped, "stylus/tip", self._tips.append, qos.SENSOR)
        self.measured = Measured(low=np.zeros(2), high=np.zeros(2), outline=np.zeros((0, 2)), wanted_touches=touches)

    def _keep(self, topic: str) -> Callable[[Any], None]:
        return lambda message: self._newest.__setitem__(topic, message)

    def prepare(self) -> None:
        """Wait for the graph, and read the limits from the controller.

        Raises
        ------
        NotPossible, TimedOut, Interrupted
        """
        session, until = self._session, time.monotonic() + START_S
        session.wait_until_taken(self._goals, "gantry/result", until)
        if session.latest("gantry/state") != "ready":
            state = session.latest("gantry/state")
            raise NotPossible(f"the controller is {state!r}, not ready: run gantry_prepare first")
        client = AsyncParameterClient(session.node, CONTROLLER)
        session.wait_for(client.services_are_ready, until, lambda: f"no parameters of {CONTROLLER}")
        future = client.get_parameters([*LIMITS, ON_CARRIAGE])
        session.wait_for(future.done, until, lambda: f"{CONTROLLER} does not answer")
        values = future.result().values
        if values[-1].bool_value:
            raise NotPossible("the cameras are on the carriage: this test needs cameras that do not move")
        low_high = np.array([value.double_value for value in values[:-1]]).reshape(2, 2)
        wanted = ("joint_states", "panel/pose", "panel/controls", "calibration/axes", "stereo/left/camera_info")
        missing = lambda: f"no {', '.join(topic for topic in wanted if topic not in self._newest)}"  # noqa: E731
        session.wait_for(lambda: all(topic in self._newest for topic in wanted), until, missing)
        self.measured.low, self.measured.high = low_high
        self._controls, self.measured.outline = controls_of_message(self._newest["panel/controls"])
        if self._axes() is None:
            raise NotPossible("the calibration of the axes was withdrawn: run gantry_prepare --calibrate")

    def travel(self) -> None:
        """Visit the stops, and order goals outside the limits."""
        stops = plan_stops(self.measured.low, self.measured.high)
        for number, stop in enumerate(stops, start=1):
            x, y = 1e3 * stop.reading
            result = self._goal((*self._base_at(stop.reading), 0.0), BASE)
            problem = "" if result.outcome is Outcome.REACHED else f"{x:.1f}, {y:.1f} mm: {_reason(result)}"
            tip = None if problem else self._tip_on_panel()
            self.measured.visits.append(Visit(stop=stop, reading=self._reading(), tip=tip, problem=problem))
            seen = problem or ("tip seen" if tip is not None else "tip not seen")
            say(f"stop {number} of {len(stops)}: {x:.1f}, {y:.1f} mm, {seen}")
        seen_visits = self.measured.seen
        readings = np.array([visit.reading for visit in seen_visits]).reshape(-1, 2)
        tips = np.array([visit.tip for visit in seen_visits]).reshape(-1, 3)
        try:
            self.measured.fit = fit_axes([visit.stop for visit in seen_visits], readings, tips)
        except ValueError as error:
            self.measured.fit_problem = str(error)
        for reading in beyond(self.measured.low, self.measured.high):
            before = self._reading()
            result = self._goal((*self._base_at(reading), 0.0), BASE)
            moved = float(np.hypot(*(self._reading() - before)))
            rejected = result.outcome is Outcome.REJECTED
            self.measured.beyond.append(
                Beyond(reading=reading, rejected=rejected, reason=_reason(result), moved_m=moved)
            )
            say(f"outside the limits: {_reason(result)}")

    def touch(self) -> None:
        """Touch points of the panel that are away from its controls."""
        fit, measured = self.measured.fit, self.measured
        if not self._touches or fit is None:
            return
        low, high = measured.low, measured.high
        corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
        points = choose_points(measured.outline, self._controls, self._touches, fit.panel_at(corners))
        for number, point in enumerate(points, start=1):
            result = self._goal((*point, 0.0), PANEL)
            touched = result.outcome is Outcome.REACHED and result.touch is not None and result.touch.contact
            done = MeasuredTouch(
                point=point,
                touched=touched,
                error_m=result.error_m,
                duration_s=result.duration_s,
                reason="" if touched else _reason(result),
            )
            measured.touches.append(done)
            x, y = 1e3 * point
            told = f"touched, error {1e3 * done.error_m:.3f} mm" if touched else done.reason
            say(f"touch {number} of {len(points)}: {x:.1f}, {y:.1f} mm, {told}")

    def look(self) -> None:
        """Take an image of each camera from the lower corner of the travel, where the stylus hides little."""
        self._goal((*self._base_at(self.measured.low), 0.0), BASE)
        session, until = self._session, time.monotonic() + START_S
        arrived_ns = session.now_ns()
        images: dict[str, Image] = {}
        ends = []
        for side in CAMERAS:
            ends.append(
                session.node.create_subscription(
                    Image, f"stereo/{side}/image_raw", lambda m, side=side: images.__setitem__(side, m), qos.NEWEST
                )
            )
        session.wait_for(
            lambda: (
                all(s in images and stamp_ns(images[s].header.stamp) >= arrived_ns for s in CAMERAS)
                and "stereo/right/camera_info" in self._newest
            ),
            until,
            lambda: (
                f"no image of {' and '.join(s for s in CAMERAS if s not in images) or 'a camera since the last move'}"
            ),
        )
        for end in ends:
            session.node.destroy_subscription(end)
        self._images = images

    def evaluate(self) -> None:
        """Measure focus and coverage in the images; the machine is at rest and no time counts."""
        models = [camera_model(self._newest[f"stereo/{side}/camera_info"], side) for side in CAMERAS]
        stereo, camera_from_panel = StereoModel(left=models[0], right=models[1]), self._camera_from_panel()
        outline = along_outline(self.measured.outline)
        touches = np.array([touch.point for touch in self.measured.touches]).reshape(-1, 2)
        for side, model in zip(CAMERAS, models):
            project = model.project if side == "left" else stereo.project_right
            image = _bgr(self._images[side])
            pixels = [
                project(camera_from_panel.apply(np.column_stack([points, np.zeros(len(points))])))
                for points in (outline, touches)
            ]
            view = view_of(pixels[0], model.width, model.height)
            blur = edge_blur_px(image.mean(axis=2).astype(np.uint8), mask_of(view, model.width, model.height))
            self.measured.cameras.append(
                CameraSnapshot(name=side, image=image, view=view, blur_px=blur, touch_px=pixels[1])
            )

    def _axes(self) -> Array | None:
        return axes_of_message(self._newest["calibration/axes"])

    def _base_at(self, reading: Array) -> Array:
        axes = self._axes()
        if axes is None:
            raise NotPossible("the calibration of the axes was withdrawn during the test")
        return np.asarray(axes @ reading)

    def _camera_from_panel(self) -> Transform:
        return transform_of_pose(self._newest["panel/pose"].pose)

    def _reading(self) -> Array:
        """Return the newest readings (2,) after all messages that have arrived."""
        message = self._newest["joint_states"]
        now = self._session.now_ns()
        self._session.wait_for(
            lambda: (
                stamp_ns(self._newest["joint_states"].header.stamp) >= now
                and self._newest["joint_states"] is not message
            ),
            time.monotonic() + START_S,
            lambda: "no new joint_states: is the driver connected?",
        )
        return joint_positions(self._newest["joint_states"], (JOINT_X, JOINT_Y))

    def _tip_on_panel(self) -> Array | None:
        """Return the median (3,) of the next tips in the panel's frame, None if too few are seen in time."""
        session = self._session
        since_ns = session.now_ns() + int(SETTLE_S * 1e9)
        end_ns = since_ns + int(LOOK_S * 1e9)
        self._tips.clear()

        def tips() -> list[PointStamped]:
            return [tip for tip in self._tips if stamp_ns(tip.header.stamp) >= since_ns]

        session.wait_for(
            lambda: len(tips()) >= TIPS or session.now_ns() > end_ns,
            time.monotonic() + START_S,
            lambda: "the time of the graph has stopped",
        )
        if len(found := tips()) < TIPS:
            return None
        panel_from_camera = self._camera_from_panel().inverse()
        return np.asarray(np.median(panel_from_camera.apply([point_array(tip) for tip in found]), axis=0))

    def _goal(self, xyz: tuple[float, ...], frame: str) -> GoalResult:
        """Send a goal and return its final answer; a goal that arrives too late on a busy computer is sent again."""
        session = self._session
        for _ in range(STALE_TRIES):
            self._stamp_ns = max(self._stamp_ns + 1, session.now_ns())
            goal_id = str(self._stamp_ns)
            self._goals.publish(point_message(xyz, header(self._stamp_ns, frame)))
            result: GoalResult = session.wait_for_answer(
                functools.partial(self._answer_to, goal_id),
                "gantry/result",
                self._resting,
                time.monotonic() + GOAL_S,
                lambda: f"no final answer; the controller was last {session.latest('gantry/state')!r}",
            )
            if not (result.outcome is Outcome.REJECTED and result.code == ResultCode.STALE):
                break
        return result

    def _answer_to(self, goal_id: str) -> GoalResult | None:
        """Return the final answer to a goal, None before it has arrived."""
        return next((r for r in self._session.results if r.goal_id == goal_id and r.outcome.final), None)

    def _resting(self) -> str:
        state = self._session.latest("gantry/state")
        return "" if state in WORKING else f"the controller has been {state!r}"


def _reason(result: GoalResult) -> str:
    if result.outcome is Outcome.REACHED:
        error = "not measured" if math.isnan(result.error_m) else f"{1e3 * result.error_m:.3f} mm"
        return f"reached, error {error}"
    return f"{result.outcome.value}: {result.reason}"


def _bgr(message: Image) -> Any:
    image = image_array(message)
    if image.ndim == 2:
        image = np.repeat(image[:, :, np.newaxis], 3, axis=2)
    return image[:, :, ::-1] if message.encoding == "rgb8" else image
