"""The mock board's own record of where the stylus was: every leg of its motion, also between two reports."""

from __future__ import annotations

from typing import Any, NamedTuple

from gantry_driver.mock.firmware.board import FirmwareBoard
from gantry_driver.mock.machine import MockMachine

HOME_MM, SIGN = (-359.0, -219.0, -1.0), (1.0, 1.0, -1.0)
"""Machine coordinates of the readings (0, 0, 0), and the directions in which the readings grow."""
TINY_S = 1e-9


class Vertex(NamedTuple):
    """Readings in mm of the motors (x, y, extension), and the speed along the path in mm/s, at board time ``t`` in s.

    From one vertex to the next the path is straight and the speed grows or falls evenly.
    """

    t: float
    x: float
    y: float
    e: float
    speed: float


class TracedBoard(FirmwareBoard):
    """A board that keeps a vertex wherever direction or acceleration change, and whenever it is asked."""

    def __init__(self, *arguments: Any) -> None:
        self.track: list[Vertex] = []
        self._motors: list[int] = []
        self._rests = False
        super().__init__(*arguments)

    def _motion_events(self) -> None:
        super()._motion_events()
        if self.motion.running:
            self._catch_up()

    def _catch_up(self) -> None:
        super()._catch_up()
        mechanics = self.mechanics
        rests = mechanics.motor == self._motors and bool(self.track)
        if rests and self.now == self.track[-1].t:
            return
        speed = self.motion.speed(self.now)
        if rests:
            # A rest has two vertices, its begin and its end.
            last = self.track[-1]
            if self._rests:
                self.track[-1] = Vertex(self.now, *last[1:4], speed)
            elif self.now > last.t:
                self.track.append(Vertex(self.now, *last[1:4], speed))
                self._rests = True
            return
        self._rests = False
        self._motors = list(mechanics.motor)
        x, y, e = (
            sign * (steps / scale - home)
            for steps, scale, home, sign in zip(self._motors, mechanics.steps_per_mm, HOME_MM, SIGN)
        )
        self.track.append(Vertex(self.now, x, y, e, speed))

    def _internal_due(self) -> float | None:
        due = super()._internal_due()
        if self.powered and self.motion.running:
            for phase in self.motion._phases:
                end = phase.start_s + phase.duration_s
                if end > self.now + TINY_S:
                    return end if due is None else min(due, end)
        return due


class TracedMachine(MockMachine):
    """The mock machine with such a board."""

    board: TracedBoard

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        board = self.board
        self.board = TracedBoard(board.eeprom, self.mechanics, self.rng, board.options)

    @property
    def track(self) -> list[Vertex]:
        return self.board.track
