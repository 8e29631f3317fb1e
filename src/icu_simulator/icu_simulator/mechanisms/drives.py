"""Errors of the drives: lead screw, pulleys and belts, thermal growth, and a carriage that rings after a move."""

from __future__ import annotations

import math

import numpy as np

from icu_common.core.geometry.geometry import Array
from icu_simulator.mechanisms.configuration import MechanismsConfig, RingingConfig

_LONGEST_S = 1.0
"""Maximum gap between samples in seconds; after a longer one the vibration is unknown."""


class Drives:
    """Conversion of motor positions to carriage positions by the drives.

    Parameters
    ----------
    config
        The mechanisms.
    seed
        Seed of phases and signs: the zero of the error of each screw and pulley.
    """

    def __init__(self, config: MechanismsConfig, seed: int) -> None:
        rng = np.random.default_rng((seed, 3))
        self._phase = rng.uniform(0, 2 * np.pi, 5)
        self._lead = float(rng.uniform(-1, 1))
        self._start_s: float | None = None
        self._zero_mm = np.zeros(3)
        self._ringing = (Ringing(), Ringing())
        self.configure(config)

    def configure(self, config: MechanismsConfig) -> None:
        """Apply other sizes; phases stay, so that a size can be changed live."""
        self.config = config
        self._periodic = config.screw.enabled or config.pulley.enabled
        # The homed origin includes the errors of the drives there.
        self._zero_mm = self._errors_mm(np.zeros(3)) if self._periodic else np.zeros(3)

    def motors(self, motor_mm: Array) -> Array:
        """Return the positions behind screws and pulleys, (3,) mm; the frame has its origin at home."""
        if not self._periodic:
            return motor_mm
        return np.asarray(motor_mm + self._errors_mm(motor_mm) - self._zero_mm)

    def _errors_mm(self, motor_mm: Array) -> Array:
        x, y, z = (float(v) for v in motor_mm)
        pulley, screw, phase = self.config.pulley, self.config.screw, self._phase
        errors = np.zeros(3)
        if pulley.enabled:
            for axis, at in enumerate((x, y)):
                turn = 2 * math.pi * at / pulley.turn_mm + phase[axis]
                tooth = 2 * math.pi * at / pulley.pitch_mm + phase[2 + axis]
                errors[axis] = pulley.runout_mm * math.sin(turn) + pulley.tooth_mm * math.sin(tooth)
        if screw.enabled:
            turn = 2 * math.pi * z / screw.lead_mm + phase[4]
            errors[2] = screw.periodic_mm * math.sin(turn) + self._lead * screw.lead_error * z
        return errors

    def rise_k(self, now_s: float) -> float:
        """Return the rise of the machine's temperature since the first sample, in K."""
        thermal = self.config.thermal
        if self._start_s is None:
            self._start_s = now_s
        if not thermal.enabled:
            return 0.0
        return thermal.rise_k * -math.expm1(-(now_s - self._start_s) / thermal.time_constant_s)

    def carriage(self, carriage_mm: Array, now_s: float) -> Array:
        """Return the true position of the carriage, (3,) mm: with thermal expansion and ringing.

        Parameters
        ----------
        carriage_mm
            x, y and extension of a stiff machine at its first temperature.
        now_s
            Time of the sample; must not go back.
        """
        config = self.config
        rise = self.rise_k(now_s)
        if config.thermal.enabled:
            growth = config.thermal.expansion_per_k * rise
            carriage_mm = carriage_mm * np.array([1 + growth, 1 + growth, 1.0])
            carriage_mm[2] -= growth * config.thermal.column_mm
        if config.ringing.enabled:
            carriage_mm = carriage_mm.copy()
            for axis, ringing in enumerate(self._ringing):
                carriage_mm[axis] += ringing.follow(float(carriage_mm[axis]), now_s, config.ringing, axis)
        return carriage_mm


class Ringing:
    """One axis: a mass on a spring and a damper, whose other end moves at constant speed between two samples.

    The displacement obeys e'' + 2 d w e' + w^2 e = -u'', so each change of speed is an impulse, followed by free decay,
    which is integrated exactly.
    """

    def __init__(self) -> None:
        self._at: tuple[float, float] | None = None
        self._speed = self._e = self._v = 0.0

    def follow(self, position_mm: float, now_s: float, config: RingingConfig, axis: int) -> float:
        """Return the displacement in mm for a position of the driven end at a time."""
        last, self._at = self._at, (position_mm, now_s)
        dt = now_s - last[1] if last is not None else 0.0
        if last is None or dt > _LONGEST_S:
            self._speed = self._e = self._v = 0.0
            return 0.0
        if dt <= 0:
            return self._e
        speed = (position_mm - last[0]) / dt
        self._v -= speed - self._speed
        self._speed = speed
        natural = 2 * math.pi * config.frequency_hz[axis]
        decay = config.damping * natural
        damped = natural * math.sqrt(1 - config.damping**2)
        sine, cosine, fade = math.sin(damped * dt), math.cos(damped * dt), math.exp(-decay * dt)
        e, v = self._e, self._v
        self._e = fade * (e * cosine + (v + decay * e) / damped * sine)
        self._v = fade * (v * cosine - (decay * v + natural**2 * e) / damped * sine)
        return self._e
