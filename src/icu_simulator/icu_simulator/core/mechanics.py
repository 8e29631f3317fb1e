"""True position of the stylus from motor positions, with errors that only the bench has.

Each axis has backlash: the carriage follows its motor only after the backlash is used up. The axes have scale errors, y
is not perpendicular to x, and z is tilted. The frame is base_link, whose origin is the centre of the homed, retracted
ball.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.geometry import Array
from icu_simulator.core.configuration import BenchStylusConfig, MechanicsConfig
from icu_simulator.mechanisms.configuration import MechanismsConfig
from icu_simulator.mechanisms.drives import Drives


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Errors:
    """The hidden errors: ``play_mm`` of x, y and the stylus; ``base_from_carriage`` (2, 2); ``lean`` (2,) per unit."""

    play_mm: Array
    base_from_carriage: Array
    lean: Array


def draw_errors(config: MechanicsConfig, rng: np.random.Generator) -> Errors:
    """Draw the errors within their bounds."""
    play = np.append(rng.uniform(config.backlash_mm[0], config.backlash_mm[1], 2), rng.uniform(0, config.backlash_z_mm))
    scale = 1 + rng.uniform(-config.scale, config.scale, 2)
    skew = rng.uniform(-config.skew_rad, config.skew_rad)
    lean = rng.uniform(-config.tilt_rad, config.tilt_rad, 2)
    # x runs along the lower rail, which is base_link's x axis; y deviates from the right angle by the skew.
    matrix = np.array([[scale[0], -scale[1] * np.sin(skew)], [0.0, scale[1] * np.cos(skew)]])
    return Errors(play_mm=play, base_from_carriage=matrix, lean=lean)


class Mechanism:
    """Follows the motors; keeps the position of each axis within its backlash."""

    def __init__(
        self, config: MechanicsConfig, stylus: BenchStylusConfig, errors: Errors, drives: Drives | None = None
    ) -> None:
        self._drives = drives if drives is not None else Drives(MechanismsConfig(), 0)
        self._stylus = stylus
        self._errors = errors
        self._homed = np.asarray(config.homed_mm)
        self.shift(config)
        self._carriage: Array | None = None
        self._stroke_mm = 0.0
        self._last_s = 0.0
        self.carriage: Array = np.zeros(2)
        """(2,) m: true displacement of the carriage in base_link."""

    def shift(self, config: MechanicsConfig) -> None:
        """Apply changes since the calibration of the machine: missed steps, and a height error of the stylus."""
        self._missed_mm = np.array([*config.missed_mm, 0.0])
        self._z_offset_mm = config.z_offset_mm

    def tip(self, mpos_mm: npt.ArrayLike, spindle: float, coolant: bool, now_s: float) -> Array:
        """Return the centre of an unobstructed ball, (3,) metres in base_link.

        Parameters
        ----------
        mpos_mm
            (3,) true motor positions in the frame of the homed machine.
        spindle, coolant
            States of the tool pins; they move a stylus with a servo or a solenoid.
        now_s
            Time of the sample; must not go back.
        """
        motor = np.asarray(mpos_mm, dtype=np.float64) - self._homed + self._missed_mm
        motor[2] = -motor[2] if self._stylus.kind == "z_axis" else self._stroke(spindle, coolant, now_s)
        motor = self._drives.motors(motor)
        if self._carriage is None:
            self._carriage = motor.copy()
        # Backlash: the motor pushes the carriage from one side or the other. After homing the last move was upwards,
        # so the origin is where the motor pushes in the positive direction.
        self._carriage = np.clip(self._carriage, motor, motor + self._errors.play_mm)
        true = self._drives.carriage(self._carriage, now_s)
        extension = true[2]
        self.carriage = self._errors.base_from_carriage @ true[:2] / 1000
        xy = self.carriage * 1000 + self._errors.lean * extension
        return np.array([xy[0], xy[1], self._z_offset_mm - extension]) / 1000

    def _stroke(self, spindle: float, coolant: bool, now_s: float) -> float:
        config = self._stylus
        if config.kind == "servo_m3":
            span = config.servo_down - config.servo_up
            share = (spindle - config.servo_up) / span if span and spindle > 0 else 0.0
            target = float(np.clip(share, 0, 1)) * config.travel_mm
        else:
            target = config.travel_mm if coolant else 0.0
        reach = config.speed_mm_s * max(now_s - self._last_s, 0.0)
        self._last_s = now_s
        self._stroke_mm += float(np.clip(target - self._stroke_mm, -reach, reach))
        return self._stroke_mm
