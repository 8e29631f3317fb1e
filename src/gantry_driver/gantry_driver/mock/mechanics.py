"""What hangs on the board's pins: three motors on rails with home switches, a probe surface, and a stop button.

The board counts the steps it has sent; here is what the motors made of them. The two differ after power-up, after an
abrupt halt (the carriage overshoots) and when an axis runs against its end.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

from gantry_driver.mock.settings import Eeprom

Triple = tuple[int, int, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class MechanicsOptions:
    """The machine's body; its size, steps per mm and home ends are taken from the settings at start."""

    start_mm: tuple[float, float, float] = (-180.0, -110.0, -5.0)
    """Where the axes stand at power-up, in the frame in which a homed board counts."""
    overtravel_mm: float = 2.0
    """From a home switch to the hard end behind it, and from the end of travel to the other hard end."""
    home_jitter_mm: float = 0.0
    """Standard deviation of a home switch's trip point."""
    slip_s: float = 0.001
    """After an abrupt halt each axis overshoots by up to its speed times this; 0 makes motors that never slip."""
    slip_speed_mm_s: float = 5.0
    """Below this speed an abrupt halt loses nothing."""


@dataclass(slots=True)
class Mechanics:
    """Motors, switches and pins; positions in motor steps, frame as of a homed board."""

    options: MechanicsOptions
    rng: random.Random
    steps_per_mm: tuple[float, float, float]
    home_sign: tuple[int, int, int]
    """-1 where the axis homes at its negative end."""
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
    door_open: bool = False
    stop_pressed: bool = False
    spindle_rpm: float = 0.0
    spindle: int = 5
    """3, 4 or 5 as the M-code that set it."""
    flood: bool = False
    mist: bool = False

    @classmethod
    def build(cls, eeprom: Eeprom, options: MechanicsOptions, rng: random.Random) -> Mechanics:
        """Build the body that fits the settings the board starts with."""
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
        """Return where the motors truly are, (3,) in mm."""
        return [self.motor[i] / self.steps_per_mm[i] for i in range(3)]

    def follow(self, commanded: Triple) -> None:
        """Turn the motors by what the board's counters have moved; an axis at its hard end stalls."""
        if commanded == self.commanded:
            return
        for i in range(3):
            target = self.motor[i] + commanded[i] - self.commanded[i]
            self.motor[i] = min(max(target, self.low[i]), self.high[i])
        self.commanded = commanded

    def renumber(self, commanded: Triple) -> None:
        """The board's counters were set; the motors stay."""
        self.commanded = commanded

    def halt(self, speed_mm_s: tuple[float, float, float]) -> None:
        """Let the axes overshoot after the steps have stopped at these speeds, which the board does not see."""
        for i in range(3):
            if abs(speed_mm_s[i]) > self.options.slip_speed_mm_s:
                slip = speed_mm_s[i] * self.options.slip_s * self.rng.uniform(0.5, 1.0)
                target = self.motor[i] + round(slip * self.steps_per_mm[i])
                self.motor[i] = min(max(target, self.low[i]), self.high[i])

    def pressed(self, axis: int) -> bool:
        """Tell whether an axis's limit switch is closed."""
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
        """Return how many steps in ``direction`` close the switch, 0 if it is closed, None if never."""
        if self.pressed(axis):
            return 0.0
        if axis in self.broken_switches or direction != self.home_sign[axis]:
            return None
        return abs(self.trip[axis] - self.motor[axis])

    def probe_closed(self) -> bool:
        """Tell whether the probe touches."""
        return self.probe_z_mm is not None and self.motor[2] <= self.probe_z_mm * self.steps_per_mm[2]

    def pins(self) -> str:
        """Return the letters of the pins that are active, as the report's ``Pn:`` has them."""
        letters = "".join("XYZ"[i] for i in range(3) if self.pressed(i))
        return "P" * self.probe_closed() + letters + "D" * self.door_open + "R" * self.stop_pressed


def _triple(values: list[int]) -> Triple:
    return values[0], values[1], values[2]
