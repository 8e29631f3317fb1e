"""Planner and step generator: blocks in, position at any time out, advancing in real time.

Speeds at block borders follow the junction deviation of GRBL's planner (S. K. Jeon, "Improving Grbl: cornering
algorithm", 2011); within a block the speed is the usual trapezoid. The profile is solved in closed form instead of
being stepped, so the board can sleep until the next border. The position is kept in whole steps.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

Vector = tuple[float, float, float]
Triple = tuple[int, int, int]

_MIN_RATE_MM_S = 1.0 / 60.0
_TINY_MM = 1e-9
_TINY_S = 1e-9
_FREE = (None, None, None)
"""Value of ``freeze`` with no axis's steps locked."""


class MotionEvent(Enum):
    """Kind of a due event of the motion."""

    BLOCK_DONE = auto()
    ALL_DONE = auto()
    HELD = auto()
    TRIGGER = auto()


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Settings of the axes; mm, mm/s, mm/s^2."""

    steps_per_mm: Vector
    max_rate: Vector
    acceleration: Vector
    junction_deviation: float


@dataclass(slots=True, kw_only=True)
class Block:
    """One straight move."""

    start: Triple
    steps: Triple
    length: float
    unit: Vector
    acceleration: float
    programmed: float
    axis_limit: float
    rapid: bool
    fixed_rate: bool
    junction_sqr: float
    max_entry_sqr: float = 0.0
    entry_sqr: float = 0.0
    freeze: tuple[float | None, float | None, float | None] = _FREE
    """Distances along the block (mm) at which the axes' steps are locked, as in a homing search."""
    trigger: float | None = None
    """Distance along the block (mm) of a :attr:`MotionEvent.TRIGGER`."""

    def position(self, done: float) -> Triple:
        """Return the counters after ``done`` mm of the block."""
        if self.freeze == _FREE:
            (x, y, z), (to_x, to_y, to_z), length = self.start, self.steps, self.length
            return x + round(to_x * done / length), y + round(to_y * done / length), z + round(to_z * done / length)
        ends = [done if stop is None else min(done, stop) for stop in self.freeze]
        x, y, z = (s + round(n * e / self.length) for s, n, e in zip(self.start, self.steps, ends))
        return x, y, z


@dataclass(frozen=True, slots=True)
class _Phase:
    start_s: float
    done: float
    speed: float
    acceleration: float
    duration_s: float


def _limited(unit: Vector, limits: Vector) -> float:
    """Return the maximum speed along ``unit`` at which no axis exceeds its limit."""
    return min(limit / abs(u) for limit, u in zip(limits, unit) if u)


class MotionPlanner:
    """The planned moves, and the one in progress.

    ``watch`` is called at the start of each block; it returns the distance (mm along it) at which to raise
    :attr:`MotionEvent.TRIGGER`.
    """

    capacity = 15

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.blocks: deque[Block] = deque()
        self.running = False
        self.stopping = False
        self.feed_override = 1.0
        self.rapid_override = 1.0
        self.watch: Callable[[Block], float | None] = lambda block: None
        self._rest: Triple = (0, 0, 0)
        self._planned: Triple = (0, 0, 0)
        self._done = 0.0
        self._speed = 0.0
        self._phases: list[_Phase] = []
        self._last_unit: Vector = (0.0, 0.0, 0.0)

    @property
    def room(self) -> int:
        """Number of blocks that the planner can accept."""
        return self.capacity - len(self.blocks)

    @property
    def done(self) -> float:
        """Distance in mm along the first block at its last start, stop or change of plan."""
        return self._done

    def set_position(self, steps: Triple) -> None:
        """Set the counters while nothing moves."""
        self._rest = self._planned = steps

    def position(self, now: float) -> Triple:
        """Return the counters in steps."""
        if not self.blocks:
            return self._rest
        return self.blocks[0].position(self._state(now)[0])

    def speed(self, now: float) -> float:
        """Return the speed along the path in mm/s."""
        return self._state(now)[1] if self.running else 0.0

    def axis_speeds(self, now: float) -> Vector:
        """Return the axes' speeds in mm/s; 0 for locked axes."""
        if not (self.running and self.blocks):
            return 0.0, 0.0, 0.0
        done, speed = self._state(now)
        block = self.blocks[0]
        x, y, z = (
            0.0 if stop is not None and done >= stop - _TINY_MM else u * speed
            for u, stop in zip(block.unit, block.freeze)
        )
        return x, y, z

    def add(
        self,
        target: Triple,
        now: float,
        *,
        rate: float,
        rapid: bool = False,
        inverse_time: bool = False,
        fixed_rate: bool = False,
    ) -> Block | None:
        """Plan a straight move to ``target`` (steps) at ``rate`` (mm/s, or 1/s if ``inverse_time``).

        Returns the block, or None if the target is the end of the last block.
        """
        limits = self.limits
        steps = (target[0] - self._planned[0], target[1] - self._planned[1], target[2] - self._planned[2])
        if steps == (0, 0, 0):
            return None
        delta = [n / s for n, s in zip(steps, limits.steps_per_mm)]
        length = math.sqrt(sum(d * d for d in delta))
        unit = (delta[0] / length, delta[1] / length, delta[2] / length)
        block = Block(
            start=self._planned,
            steps=steps,
            length=length,
            unit=unit,
            acceleration=_limited(unit, limits.acceleration),
            programmed=rate * length if inverse_time else rate,
            axis_limit=_limited(unit, limits.max_rate),
            rapid=rapid,
            fixed_rate=fixed_rate,
            junction_sqr=self._junction_sqr(unit) if self.blocks else 0.0,
        )
        self.blocks.append(block)
        self._planned = target
        self._last_unit = unit
        self._replan(now)
        return block

    def start(self, now: float) -> None:
        """Begin or resume moving."""
        self.running = bool(self.blocks)
        self.stopping = False
        if self.running:
            self._arm()
            self._replan(now)

    def hold(self, now: float) -> None:
        """Decelerate to a stop; :attr:`MotionEvent.HELD` follows."""
        if self.running:
            self._advance(now)
            self.stopping = True
            self._profile(now)

    def halt(self, now: float) -> Triple:
        """Stop the steps at once, drop all blocks, and return the counters."""
        here = self.position(now)
        self.blocks.clear()
        self.running = self.stopping = False
        self._done = self._speed = 0.0
        self._phases = []
        self.set_position(here)
        return here

    def override(self, now: float, *, feed: float, rapid: float) -> None:
        """Set the override factors, which also apply to the move in progress."""
        self._advance(now)
        self.feed_override, self.rapid_override = feed, rapid
        self._replan(now)

    def due(self) -> float | None:
        """Return the time of the next event, None if nothing moves."""
        if not self.running or not self._phases:
            return None
        last = self._phases[-1]
        end = last.start_s + last.duration_s
        trigger = self.blocks[0].trigger
        if trigger is not None:
            reached = self._time_at(trigger)
            if reached is not None:
                return min(end, reached)
        return end

    def step(self, now: float) -> MotionEvent:
        """Carry out the event that is due at ``now``."""
        block = self.blocks[0]
        # Compared as times, as in due(): with a coarse clock the position at that time may still be before it.
        reached = None if block.trigger is None else self._time_at(block.trigger)
        self._advance(now)
        if block.trigger is not None and reached is not None and reached <= now:
            self._done = block.trigger
            block.trigger = None
            self._profile(now)
            return MotionEvent.TRIGGER
        complete = self._done >= block.length - 1e-6
        if complete:
            self._rest = block.position(block.length)
            self.blocks.popleft()
            self._done = 0.0
        # A speed that rounding has left over, too small for a phase of the next block, counts as 0.
        least = 2.0 * _TINY_S * self.blocks[0].acceleration if self.blocks else 0.0
        held = self.stopping and self._speed < max(1e-6, least)
        if held or not self.blocks:
            self.running = self.stopping = False
            self._speed = 0.0
            self._phases = []
            return MotionEvent.HELD if held else MotionEvent.ALL_DONE
        self._arm()
        self._profile(now)
        return MotionEvent.BLOCK_DONE

    def _arm(self) -> None:
        block = self.blocks[0]
        block.trigger = self.watch(block)

    def _state(self, now: float) -> tuple[float, float]:
        """Return the completed distance of the first block, and the speed."""
        if not self.running or not self._phases:
            return self._done, self._speed
        for phase in self._phases:
            over = now >= phase.start_s + phase.duration_s
            if not over:
                break
        # A phase is over at its end, even if the clock can hardly distinguish its end from its start.
        dt = phase.duration_s if over else now - phase.start_s
        dt = dt if dt > 0.0 else 0.0
        done = phase.done + phase.speed * dt + 0.5 * phase.acceleration * dt * dt
        speed, length = phase.speed + phase.acceleration * dt, self.blocks[0].length
        return done if done < length else length, speed if speed > 0.0 else 0.0

    def _advance(self, now: float) -> None:
        self._done, self._speed = self._state(now)

    def _time_at(self, distance: float) -> float | None:
        for phase in self._phases:
            end = phase.speed * phase.duration_s + 0.5 * phase.acceleration * phase.duration_s**2 + phase.done
            if distance > end + _TINY_MM:
                continue
            need = max(distance - phase.done, 0.0)
            root = math.sqrt(max(phase.speed**2 + 2.0 * phase.acceleration * need, 0.0))
            total = phase.speed + root
            return phase.start_s + (2.0 * need / total if total > 0.0 else 0.0)
        return None

    def _nominal(self, block: Block) -> float:
        if block.rapid:
            rate = block.axis_limit * self.rapid_override
        else:
            rate = min(block.programmed * (1.0 if block.fixed_rate else self.feed_override), block.axis_limit)
        return max(rate, _MIN_RATE_MM_S)

    def _junction_sqr(self, unit: Vector) -> float:
        cosine = -sum(a * b for a, b in zip(self._last_unit, unit))
        if cosine > 0.999999:
            return 0.0
        if cosine < -0.999999:
            return math.inf
        change = [b - a for a, b in zip(self._last_unit, unit)]
        size = math.sqrt(sum(c * c for c in change))
        across = (change[0] / size, change[1] / size, change[2] / size)
        sine_half = math.sqrt(0.5 * (1.0 - cosine))
        acceleration = _limited(across, self.limits.acceleration)
        return acceleration * self.limits.junction_deviation * sine_half / (1.0 - sine_half)

    def _replan(self, now: float) -> None:
        """Set the speeds at all borders: backwards from rest at the end, then forwards from the current speed."""
        self._advance(now)
        blocks = self.blocks
        if not blocks:
            return
        before = self._nominal(blocks[0])
        for block in list(blocks)[1:]:
            nominal = self._nominal(block)
            block.max_entry_sqr = min(block.junction_sqr, nominal**2, before**2)
            before = nominal
        leave = 0.0
        for index in range(len(blocks) - 1, 0, -1):
            block = blocks[index]
            leave = min(block.max_entry_sqr, leave + 2.0 * block.acceleration * block.length)
            block.entry_sqr = leave
        speed_sqr, length = self._speed**2, blocks[0].length - self._done
        for index in range(1, len(blocks)):
            previous = blocks[index - 1]
            reach = speed_sqr + 2.0 * previous.acceleration * length
            blocks[index].entry_sqr = speed_sqr = min(blocks[index].entry_sqr, reach)
            length = blocks[index].length
        if self.running:
            self._profile(now)

    def _profile(self, now: float) -> None:
        """Divide the rest of the first block, from the current speed, into phases of constant acceleration."""
        block = self.blocks[0]
        a, speed, left = block.acceleration, self._speed, block.length - self._done
        self._phases = []
        clock, done = now, self._done

        def phase(acceleration: float, duration_s: float) -> None:
            nonlocal clock, done, speed
            if duration_s > _TINY_S:
                self._phases.append(_Phase(clock, done, speed, acceleration, duration_s))
                clock += duration_s
                done += speed * duration_s + 0.5 * acceleration * duration_s**2
                speed = max(speed + acceleration * duration_s, 0.0)

        if self.stopping:
            leave = math.sqrt(max(speed**2 - 2.0 * a * left, 0.0))
            phase(-a, (speed - leave) / a)
        else:
            leave = math.sqrt(self.blocks[1].entry_sqr) if len(self.blocks) > 1 else 0.0
            nominal = self._nominal(block)
            leave = max(leave, math.sqrt(max(speed**2 - 2.0 * a * left, 0.0)))
            peak = math.sqrt(max(0.5 * (speed**2 + leave**2) + a * left, 0.0))
            if speed > nominal:  # an override has lowered the rate: brake to it first
                target = max(nominal, leave)
                left -= (speed**2 - target**2) / (2.0 * a)
                phase(-a, (speed - target) / a)
                peak = target
            top = min(peak, max(nominal, leave))
            rise = (top**2 - speed**2) / (2.0 * a)
            fall = (top**2 - leave**2) / (2.0 * a)
            phase(a, (top - speed) / a)
            if top > 0.0:
                phase(0.0, max(left - rise - fall, 0.0) / top)
            phase(-a, (top - leave) / a)
        if not self._phases:
            self._phases.append(_Phase(now, self._done, self._speed, 0.0, 0.0))
