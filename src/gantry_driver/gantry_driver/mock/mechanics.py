"""Devices on the board's pins: three motors on rails with home switches, a probe surface, and a stop button.

The board counts the steps that it has sent; this module has the true positions of the motors. The two differ after
power-up, after an abrupt halt (the carriage overshoots), and if an axis runs against its end.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from gantry_driver.mock.settings import Eeprom

Triple = tuple[int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class MechanicsOptions:
    """Properties of the mechanics; size, steps per mm and home ends come from the settings at the start."""

    start_mm: tuple[float, float, float] = (-180.0, -110.0, -5.0)
    """Positions of the axes at power-up, in the frame of a homed board."""
    overtravel_mm: float = 2.0
    """Distance from a home switch to the hard end behind it, and from the end of travel to the other hard end."""
    home_jitter_mm: float = 0.0
    """Standard deviation of a home switch's trip point."""
    slip_s: float = 0.001
    """Maximum overshoot of an axis after an abrupt halt, divided by its speed; with 0, motors never slip."""
    slip_speed_mm_s: float = 5.0
    """Speed below which an abrupt halt loses no steps."""


@dataclass(slots=True)
class Mechanics:
    """Motors, switches and pins; positions in motor steps, in the frame of a homed board."""

    options: MechanicsOptions
    rng: random.Random
    steps_per_mm: tuple[float, float, float]
    home_sign: tuple[int, int, int]
    """-1 for an axis that homes at its negative end."""
    switch: list[float]
    """Nominal trip points in steps."""
    low: Triple
    high: Triple
    motor: list[int]
    commanded: Triple = (0, 0, 0)
    trip: list[float] = field(default_factory=list)
    broken_switches: set[int] = field(default_factory=set)
    held_switches: set[int] = field(default_factory=set)
    probe_z_mm: float | None = None
    probe_contact: bool = False
    """Whether a switch connects the probe input with ground, independently of a surface at ``probe_z_mm``."""
    door_open: bool = False
    stop_pressed: bool = False
    spindle_rpm: float = 0.0
    spindle: int = 5
    """Number of the M-code that set it: 3, 4 or 5."""
    flood: bool = False
    mist: bool = False

    @classmethod
    def build(cls, eeprom: Eeprom, options: MechanicsOptions, rng: random.Random) -> Mechanics:
        """Return the mechanics for the settings with which the board starts."""
        scale, travel = eeprom.axis_values(100), eeprom.axis_values(130)
        mask = int(eeprom.values[23])
        sign = tuple(-1 if mask >> axis & 1 else 1 for axis in range(3))
        switch = [(-travel[i] if sign[i] < 0 else 0.0) * scale[i] for i in range(3)]
        over = options.overtravel_mm
        made = cls(
            options=options,
            rng=rng,
            steps_per_mm=scale,
            home_sign=(sign[0], sign[1], sign[2]),
            switch=switch,
            low=_triple([round((-travel[i] - over) * scale[i]) for i in range(3)]),
            high=_triple([round(over * scale[i]) for i in range(3)]),
            motor=[round(options.start_mm[i] * scale[i]) for i in range(3)],
        )
        made.trip = list(switch)
        return made

    def mpos_mm(self) -> list[float]:
        """Return the true positions of the motors, (3,) in mm."""
        return [self.motor[i] / self.steps_per_mm[i] for i in range(3)]

    def follow(self, commanded: Triple) -> None:
        """Turn the motors by the change of the board's counters; an axis at its hard end stalls."""
        if commanded == self.commanded:
            return
        for i in range(3):
            target = self.motor[i] + commanded[i] - self.commanded[i]
            self.motor[i] = min(max(target, self.low[i]), self.high[i])
        self.commanded = commanded

    def lose_steps(self, axis: int, mm: float) -> None:
        """Move one motor without a change of the board's counter, like steps lost under load."""
        target = self.motor[axis] + round(mm * self.steps_per_mm[axis])
        self.motor[axis] = min(max(target, self.low[axis]), self.high[axis])

    def renumber(self, commanded: Triple) -> None:
        """Take new values of the board's counters; the motors do not move."""
        self.commanded = commanded

    def halt(self, speed_mm_s: tuple[float, float, float]) -> None:
        """Let the axes overshoot after the steps have stopped at these speeds; the board does not count that."""
        for i in range(3):
            if abs(speed_mm_s[i]) > self.options.slip_speed_mm_s:
                slip = speed_mm_s[i] * self.options.slip_s * self.rng.uniform(0.5, 1.0)
                target = self.motor[i] + round(slip * self.steps_per_mm[i])
                self.motor[i] = min(max(target, self.low[i]), self.high[i])

    def pressed(self, axis: int) -> bool:
        """Return whether an axis's limit switch is closed."""
        if axis in self.held_switches:
            return True
        if axis in self.broken_switches:
            return False
        return (self.motor[axis] - self.trip[axis]) * self.home_sign[axis] >= 0

    def draw_trips(self) -> None:
        """Draw the switches' trip points for the next approach."""
        jitter = self.options.home_jitter_mm
        for i in range(3):
            offset = self.rng.gauss(0.0, jitter) * self.steps_per_mm[i] if jitter > 0 else 0.0
            self.trip[i] = float(round(self.switch[i] + offset))

    def steps_to_switch(self, axis: int, direction: int) -> float | None:
        """Return the number of steps in ``direction`` that close the switch, 0 if it is closed, None if none do."""
        if self.pressed(axis):
            return 0.0
        if axis in self.broken_switches or direction != self.home_sign[axis]:
            return None
        return abs(self.trip[axis] - self.motor[axis])

    def probe_closed(self) -> bool:
        """Return whether the probe input is connected with ground."""
        touches = self.probe_z_mm is not None and self.motor[2] <= self.probe_z_mm * self.steps_per_mm[2]
        return touches or self.probe_contact

    def pins(self, probe: bool) -> str:
        """Return the letters of the active pins, as in the report's ``Pn:``.

        Parameters
        ----------
        probe
            Whether the probe counts as triggered for the firmware, which depends on its settings.
        """
        letters = "".join("XYZ"[i] for i in range(3) if self.pressed(i))
        return "P" * probe + letters + "D" * self.door_open + "R" * self.stop_pressed


def _triple(values: list[int]) -> Triple:
    return values[0], values[1], values[2]
