"""Arcs of G2 and G3: their length, their extent, and chords for the comparison with reports."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

CHORD_MM = 0.02
"""Maximum distance of a chord from its arc in mm: a small fraction of the tube around a path."""
_NO_TURN = 5e-7
"""Angle of an arc in radians up to which GRBL adds a whole turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arc:
    """An arc or helix in machine coordinates, mm.

    Parameters
    ----------
    start, end
        (3,) each.
    plane
        Numbers of the two axes of the circle, and of the axis along which a helix goes.
    centre
        (2,), in the two axes.
    clockwise
        As seen from the positive end of the third axis.
    """

    start: Sequence[float]
    end: Sequence[float]
    plane: tuple[int, int, int]
    centre: tuple[float, float]
    clockwise: bool

    @property
    def radius(self) -> float:
        return math.dist(self._flat(self.start), self.centre)

    @property
    def begin(self) -> float:
        """Angle at the start, in radians."""
        return self._angle(self.start)

    @property
    def sweep(self) -> float:
        """Angle from start to end in radians, negative clockwise; a whole turn if start and end are the same point."""
        turn = self._angle(self.end) - self.begin
        turn = -turn % math.tau if self.clockwise else turn % math.tau
        turn += math.tau if turn <= _NO_TURN else 0.0
        return -turn if self.clockwise else turn

    @property
    def length(self) -> float:
        normal = self.plane[2]
        return math.hypot(self.radius * self.sweep, self.end[normal] - self.start[normal])

    def extremes(self) -> list[Sequence[float]]:
        """Return the end, and the extreme points of the arc along its plane's axes."""
        begin, sweep, found = self.begin, self.sweep, [self.end]
        for quarter in range(-8, 9):
            angle = quarter * math.pi / 2
            if min(begin, begin + sweep) < angle < max(begin, begin + sweep):
                found.append(self._at(angle, self.end[self.plane[2]]))
        return found

    def chords(self) -> list[Sequence[float]]:
        """Return the ends of chords that stay within :data:`CHORD_MM` of the arc."""
        begin, sweep, normal = self.begin, self.sweep, self.plane[2]
        step = 2.0 * math.acos(max(1.0 - CHORD_MM / self.radius, 0.0)) if self.radius else math.tau
        count = math.ceil(abs(sweep) / step)
        rise = (self.end[normal] - self.start[normal]) / count
        points = [self._at(begin + sweep * n / count, self.start[normal] + rise * n) for n in range(1, count)]
        return [*points, self.end]

    def _flat(self, place: Sequence[float]) -> tuple[float, float]:
        return place[self.plane[0]], place[self.plane[1]]

    def _angle(self, place: Sequence[float]) -> float:
        a, b = self._flat(place)
        return math.atan2(b - self.centre[1], a - self.centre[0])

    def _at(self, angle: float, height: float) -> list[float]:
        a, b, normal = self.plane
        point, radius = [0.0, 0.0, 0.0], self.radius
        point[a], point[b] = self.centre[0] + radius * math.cos(angle), self.centre[1] + radius * math.sin(angle)
        point[normal] = height
        return point
