"""Settings of the hand-eye node: the file, the machine and the procedure."""

from __future__ import annotations

from dataclasses import dataclass

from harris_perception.core.hand_eye.drift import DriftConfig
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye_procedure.calibration_plan import RunConfig
from harris_perception.core.hand_eye_procedure.still_watch import StillConfig
from icu_common.core.configuration.config import Config, nested, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratorConfig(Config):
    """Settings of the file, the machine and the procedure."""

    calibration_file: str = setting("", "File that stores the calibration; empty: not stored", read_only=True)
    machine: str = setting("default", "Name of the machine's configuration; a calibration is valid only for it")
    ball_radius_m: float = setting(
        0.002, "Radius of the stylus's ball, for contacts", minimum=0.0, maximum=0.05, unit="m"
    )
    run: RunConfig = nested(RunConfig)
    still: StillConfig = nested(StillConfig)
    solver: HandEyeConfig = nested(HandEyeConfig)
    drift: DriftConfig = nested(DriftConfig)
