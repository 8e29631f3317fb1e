"""The driver on the mock board in virtual time, with bytes damaged on the wire, and where the stylus truly was."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable, Sequence

from campaign.faults import CONFIG, HOMED
from campaign.virtual_link import VirtualRig

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.states.machine_states import Position
from icu_common.core.goals.results import GoalResult

Place = tuple[float, float, float]
TRACE_S = 0.005
KINDS = ("flip", "flip", "flip", "loss", "double", "swap", "burst")
Damage = Callable[[bytes], bytes]


class DamagedRig(VirtualRig):
    """``to_board`` and ``from_board`` change the bytes on their way."""

    def __init__(self, config: DriverConfig = CONFIG, seed: int = 0, dialect: str = "GRBL") -> None:
        self.to_board: Damage | None = None
        self.from_board: Damage | None = None
        self.published: list[tuple[Place, Place]] = []
        """Readings that were published, with where the stylus was, both in mm of extension and travel."""
        self.truth: list[tuple[float, Place, float]] = []
        """Time, machine position (mm) and feed (mm/min) of the motors."""
        self.answered_at = 0.0
        super().__init__(config, seed, dialect)

    def home(self) -> None:
        super().home()
        self.truth.clear()

    def once(self, sent: bytes, received: bytes, direction: str = "to_board") -> None:
        """Replace these bytes the next time they are sent."""

        def damage(data: bytes) -> bytes:
            if sent in data:
                setattr(self, direction, None)
                return data.replace(sent, received, 1)
            return data

        setattr(self, direction, damage)

    def finish(self, points: Sequence[Place], within_s: float = 120.0) -> GoalResult:
        """Follow a path, wait for its answer and for rest, and return the answer."""
        self.results.clear()
        self.go(points, "goal")
        self.until(lambda: self.results and self.results[-1].outcome.final, within_s)
        self.answered_at = self.now
        answer = self.results[-1]
        self.until(lambda: self.machine.connected and self.machine.at_rest, 60.0)
        return answer

    def deepest_mm(self) -> float:
        """Return the largest true extension so far."""
        return max(HOMED[2] - place[2] for _, place, _ in self.truth)

    def _write(self, data: bytes) -> None:
        super()._write(self.to_board(data) if self.to_board is not None and data else data)

    def _turn(self, data: bytes) -> None:
        super()._turn(self.from_board(data) if self.from_board is not None and data else data)

    def _step(self, end: float) -> None:
        super()._step(min(end, self.now + TRACE_S))
        self.truth.append((self.now, self.mpos(), 60.0 * self.board.motion.speed(self.now)))

    def _collect(self) -> None:
        for event in self.machine._events:
            if isinstance(event, Position):
                x, y, z = (1000.0 * value for value in event.reading_m)
                at = self.mpos()
                self.published.append(((x, y, z), (at[0] - HOMED[0], at[1] - HOMED[1], HOMED[2] - at[2])))
        super()._collect()


def damaged(rng: random.Random, data: bytes) -> bytes:
    """Return bytes of which one is flipped, lost, doubled or swapped, or up to eight are noise."""
    kind, changed, at = rng.choice(KINDS), bytearray(data), rng.randrange(len(data))
    if kind == "loss":
        del changed[at]
    elif kind == "double":
        changed.insert(at, changed[at])
    elif kind == "swap" and at + 1 < len(changed):
        changed[at], changed[at + 1] = changed[at + 1], changed[at]
    elif kind == "burst":
        for place in range(at, min(at + rng.randrange(2, 9), len(changed))):
            changed[place] = rng.randrange(256)
    else:
        changed[at] ^= 1 << rng.randrange(8)
    return bytes(changed)


def damage_at(rng: random.Random, count: int) -> Damage:
    """Return what damages the piece in which byte number ``count`` travels, and no other."""
    seen, done = 0, False

    def damage(data: bytes) -> bytes:
        nonlocal seen, done
        seen += len(data)
        if done or seen <= count:
            return data
        done = True
        return damaged(rng, data)

    return damage


def machine_mm(point: Place) -> Place:
    """Return the machine position of readings in metres."""
    return HOMED[0] + 1000.0 * point[0], HOMED[1] + 1000.0 * point[1], HOMED[2] - 1000.0 * point[2]


def off_path_mm(place: Sequence[float], points: Sequence[Sequence[float]]) -> float:
    """Return the distance of a place from the lines between points, in the plane."""
    best = min(math.dist(place[:2], point[:2]) for point in points)
    for start, end in itertools.pairwise(points):
        length = math.dist(start[:2], end[:2])
        if length > 0.0:
            share = sum((p - a) * (b - a) for p, a, b in zip(place[:2], start[:2], end[:2])) / length**2
            near = [a + min(max(share, 0.0), 1.0) * (b - a) for a, b in zip(start[:2], end[:2])]
            best = min(best, math.dist(place[:2], near))
    return best
