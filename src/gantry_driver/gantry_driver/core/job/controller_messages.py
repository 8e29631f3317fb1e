"""Inputs (events) and outputs (actions) of the controller, as values; time is ROS time in nanoseconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.core.motion.motion_plan import Path
from gantry_driver.core.motion.scene import PanelMap
from icu_common.core.alignment.layout import ControlDeviation
from icu_common.core.alignment.pair import PairState
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.goals.intent import Intent
from icu_common.core.goals.results import GoalResult
from icu_common.core.panel.panel_state import PanelSeen
from icu_common.core.processes.delays import Delay
from icu_common.core.reasons.message import Message

FARTHEST_M = 10.0
"""Maximum distance of a reading from home: twice the longest travel that the driver can be configured for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointGoal:
    """A point on /gantry/goal: ``xyz`` (3,) in metres of ``frame``, or raw pixels u, v and 0 in a camera's frame."""

    frame: str
    xyz: Array
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A gesture's text on /gantry/command."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverState:
    """The driver's ``state`` or ``state: reason``."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Joints:
    """Readings (3,) in metres, and whether the stylus's switch acts; None without such a switch.

    Raises
    ------
    ValueError
        If they are farther from home than any machine can reach.
    """

    readings: Array
    probe: bool | None = None

    def __post_init__(self) -> None:
        if not abs(self.readings).max() <= FARTHEST_M:
            raise ValueError(
                Message(
                    "controller.readings_most_home_believed", readings_m=self.readings.tolist(), farthest_m=FARTHEST_M
                )
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionResult:
    """The driver's answer to a trajectory; ``goal_id`` is the trajectory's stamp."""

    result: GoalResult


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PanelPose:
    camera_from_panel: Transform
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelConfidence:
    value: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelAlarm:
    """Reason not to use the panel's pose; empty if there is none."""

    text: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PanelControls:
    panel: PanelMap


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelState:
    """Seen states of the controls."""

    seen: PanelSeen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraFromBase:
    transform: Transform


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Axes:
    """``base_from_reading`` (2, 2), close to the identity; None: the calibration was withdrawn.

    Raises
    ------
    ValueError
        If the matrix is not finite, or too far from the identity for a real machine.
    """

    base_from_reading: Array | None

    def __post_init__(self) -> None:
        matrix = self.base_from_reading
        if matrix is None:
            return
        if matrix.shape != (2, 2) or not abs(matrix - ((1.0, 0.0), (0.0, 1.0))).max() <= 0.1:
            raise ValueError(Message("controller.axes_2_2_values_within", matrix=matrix.tolist()))


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSigma:
    """Standard deviation of the hand-eye calibration in metres.

    Raises
    ------
    ValueError
        If the value is not a standard deviation.
    """

    value_m: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.value_m < FARTHEST_M:
            raise ValueError(f"a standard deviation of {self.value_m} m: 0 to {FARTHEST_M:g} m are believed")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairSeen:
    """Rotation of the right camera as the stylus tracker has measured it."""

    pair: PairState


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LayoutSeen:
    """Known deviation of each control from the layout, by its name."""

    deviations: Mapping[str, ControlDeviation]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipSeen:
    """The centre of the stylus's ball (3,) in metres, in the left camera's rectified frame."""

    in_camera: Array
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TipUnseen:
    """The stylus tracker has evaluated an image in which the tip is not certain."""

    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSeen:
    camera: CameraModel
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class OperatorHeartbeat:
    """The operator was present ``age_ns`` ago, according to the heartbeat's stamp."""

    age_ns: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Rivals:
    """Programs that publish ``topic``, which only one may publish; ``text`` is empty once only one is left."""

    topic: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Tick:
    """Time passed."""


Event = (
    PointGoal
    | Command
    | DriverState
    | Joints
    | MotionResult
    | PanelPose
    | PanelConfidence
    | PanelAlarm
    | PanelControls
    | PanelState
    | CameraFromBase
    | Axes
    | CalibrationSigma
    | PairSeen
    | LayoutSeen
    | TipSeen
    | TipUnseen
    | CameraSeen
    | OperatorHeartbeat
    | Rivals
    | Tick
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SendTrajectory:
    """Request that the driver follow ``path``; ``stamp_ns`` is the trajectory's stamp and identity."""

    stamp_ns: int
    path: Path
    intent: Intent = Intent.MOVE


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishResult:
    result: GoalResult


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishState:
    text: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShowTarget:
    """The accepted target (3,) in base_link."""

    in_base: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class CallStop:
    """Hold the machine at once."""

    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportDelay:
    """Log a delay, and the controller's reaction: ``then``."""

    delay: Delay
    then: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportClear:
    """Images show the tip at least ``height_m`` above the panel; sent to a driver without a position."""

    height_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportPlane:
    """Send the panel's plane, as seen at ``stamp_ns``, to the driver."""

    plane: PanelPlane
    stamp_ns: int


Action = SendTrajectory | PublishResult | PublishState | ShowTarget | CallStop | ReportDelay | ReportClear | ReportPlane
