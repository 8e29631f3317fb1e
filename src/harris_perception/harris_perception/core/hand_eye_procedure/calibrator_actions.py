"""Actions of the hand-eye node, as the calibrator orders them."""

from __future__ import annotations

from dataclasses import dataclass

from harris_perception.core.hand_eye_procedure.calibration_run import SendCalibrationGoal
from icu_common.core.geometry.geometry import Array, Transform


@dataclass(frozen=True, slots=True)
class SetState:
    """Publish the state."""

    text: str


@dataclass(frozen=True, slots=True, eq=False)
class SetAxes:
    """Publish (2, 2) base_from_reading; None: the calibration is withdrawn."""

    base_from_reading: Array | None


@dataclass(frozen=True, slots=True)
class SetSigma:
    """Publish the predicted error of the calibration in use, m."""

    sigma_m: float


@dataclass(frozen=True, slots=True, eq=False)
class SetPose:
    """Publish the pose of base_link."""

    camera_from_base: Transform
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Keep:
    """Write the calibration in use to the file."""


@dataclass(frozen=True, slots=True)
class LogNote:
    """Write a log message; the level is ``info``, ``warn`` or ``error``."""

    level: str
    text: str


Action = SendCalibrationGoal | SetState | SetAxes | SetSigma | SetPose | Keep | LogNote


class StateText:
    """The node's state as text, as it was last published."""

    def __init__(self) -> None:
        self.text = "uncalibrated"

    def set(self, text: str) -> list[Action]:
        """Change the state; return the action that publishes it."""
        self.text = text
        return [SetState(text)]
