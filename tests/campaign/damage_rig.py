"""A driver and a board on one virtual clock with one damaged byte (or burst) on the wire between them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from campaign.truth import TracedMachine, Vertex
from campaign.virtual_link import VirtualRig

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.machine.board_state import TICK_S
from gantry_driver.core.states.machine_states import Note, Position, StateChanged
from gantry_driver.mock.serial_line import Damage
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.results import Outcome

Point = tuple[float, float, float]

TO_BOARD, FROM_BOARD = "to_board", "from_board"
DIRECTIONS = (TO_BOARD, FROM_BOARD)
WELL = frozenset({"unhomed", "homing", "idle", "moving"})
"""States without trouble."""
ANSWER_FACTOR, ANSWER_EXTRA_S = 3.0, 25.0
"""An answer counts as none if it takes longer than this multiple of the planned time, and this in addition."""
SETTLE_S = 90.0
WATCH_S = 1.5
"""Duration of the watch, at rest, for motion without a goal."""


@dataclass(slots=True)
class Plan:
    """Order of one goal: points in readings, mm, and the feed in mm/s of the segment that ends at each."""

    points: list[Point]
    feeds: list[float]

    @property
    def seconds(self) -> float:
        legs = zip(self.points, self.points[1:], self.feeds[1:])
        return sum(math.dist(a, b) / feed for a, b, feed in legs)


@dataclass(slots=True)
class Goal:
    """One goal: its plan, when it was sent and answered (s), and the driver's answer."""

    plan: Plan
    sent: float
    answered: float = math.inf
    reached: bool = False
    reason: str = ""


@dataclass(slots=True)
class Window:
    """A time in which the board may move without a goal: it homes."""

    begin: float
    end: float = math.inf


@dataclass(slots=True)
class Story:
    """Requests of a run, and the driver's messages."""

    goals: list[Goal] = field(default_factory=list)
    homings: list[Window] = field(default_factory=list)
    positions: list[tuple[float, Point]] = field(default_factory=list)
    """Published readings in mm, by the time of their publication."""
    told: list[str] = field(default_factory=list)
    """Answers and states other than those that the phase expects."""
    panel_mm: float = 0.0
    """Extension at which the stylus meets the panel."""


class DamageRig(VirtualRig):
    """A run; bytes are damaged only within :meth:`damaging`."""

    mock: TracedMachine

    def __init__(self, config: DriverConfig, seed: int, damage: Damage | None, direction: str) -> None:
        super().__init__(config, seed, make_mock=TracedMachine)
        self.damage = damage
        self.story = Story()
        self.expected_states = {"disconnected", "connecting"}
        """States, besides those without trouble, that the phase itself brings about."""
        self._line = self.board.inbound if direction == TO_BOARD else self.board.outbound
        self._driver_due = self._session_due = 0.0

    @contextlib.contextmanager
    def damaging(self) -> Iterator[None]:
        self._line.damage = self.damage
        try:
            yield
        finally:
            # A damage that has begun continues: half a swap is a lost byte.
            if self.damage is not None and not (self.damage.begun and not self.damage.done):
                self._line.damage = None

    @property
    def hit(self) -> bool:
        """Whether the damage has happened; without one to come it counts as done."""
        return self.damage is None or self.damage.done

    @property
    def here(self) -> Point:
        """Where the stylus truly is: readings in mm."""
        last = self.mock.track[-1]
        return last.x, last.y, last.e

    @property
    def track(self) -> list[Vertex]:
        return self.mock.track

    def goal(self, points: Sequence[Point], times: Sequence[float] = ()) -> bool:
        """Send a trajectory (mm, s) and wait for its answer; return whether it was reached.

        Without times the driver's own speeds hold.
        """
        plan = Plan([self.here], [0.0])
        before = 0.0
        for number, point in enumerate(points):
            last = plan.points[-1]
            seconds = times[number] - before if times else own_seconds(self.machine.config, last, point)
            before = times[number] if times else 0.0
            plan.points.append(point)
            plan.feeds.append(math.dist(last, point) / seconds if seconds else math.inf)
        goal = Goal(plan, self.now)
        self.story.goals.append(goal)
        way = [
            Waypoint(
                positions_m=(x / 1000.0, y / 1000.0, e / 1000.0),
                time_s=times[number] if times else 0.0,
            )
            for number, (x, y, e) in enumerate(points)
        ]
        count = len(self.results)
        self.machine.run(str(len(self.story.goals)), JOINTS, way, age_s=0.0, now=self.now)
        self._collect()
        self.until(lambda: self.results[count:] and self.results[-1].outcome.final, limit_s(plan.seconds))
        answer = self.results[-1]
        goal.answered, goal.reason = self.now, answer.reason
        goal.reached = answer.outcome is Outcome.REACHED
        if not goal.reached:
            self.story.told.append(f"{answer.outcome.value}: {answer.reason}")
        return goal.reached

    def homing(self) -> bool:
        """Home and wait for the end of it; return whether the machine is homed and idle then."""
        window = Window(self.now)
        self.story.homings.append(window)
        refusal = self.machine.home(self.now)
        if refusal:
            self.story.told.append(f"not homed: {refusal}")
            return False
        self.until(lambda: self.machine.phase.state != "homing", 100.0)
        window.end = self.now
        return self.machine.phase.state == "idle"

    def connected(self) -> bool:
        """Wait until the board is recognised; return whether it only waits for homing."""
        self.until(lambda: self.machine.connected and self.machine.at_rest, SETTLE_S)
        return self.machine.phase.state == "unhomed"

    def settle(self) -> None:
        """Wait until nothing is in transit, and then for messages without a request."""
        self.until(lambda: self.machine.connected and self.machine.at_rest, SETTLE_S)
        self.run_for(WATCH_S)
        self.until(lambda: self.machine.connected and self.machine.at_rest, SETTLE_S)

    def until(self, condition: Callable[[], Any], within_s: float) -> None:
        self._driver_due = 0.0  # the caller may have asked the driver for something
        super().until(condition, within_s)

    def run_for(self, seconds: float) -> None:
        self._driver_due = 0.0
        super().run_for(seconds)

    def _deadline(self) -> float:
        # Between two turns nothing but the clock changes it.
        return min(self._session_due, self.now + TICK_S) if self._driver_due else super()._deadline()

    def _run_board(self, end: float) -> bytes:
        # The board's actions between two turns of the driver change nothing that a run waits for.
        while True:
            data = super()._run_board(end)
            if data or self.now >= end or (self._open and self.now >= self._driver_due):
                return data

    def _receive(self, data: bytes) -> None:
        # As one piece: the reader's result does not depend on them, which other tests show.
        if data:
            self.machine.receive(data, self.now)

    def _turn(self, data: bytes) -> None:
        """Let the driver act only on bytes and at its own times, as the link's thread does."""
        if data or self.now >= self._driver_due:
            super()._turn(data)
            self._session_due = self.machine.session.deadline(self.now)
            self._driver_due = min(self._session_due, self.now + TICK_S)

    def _collect(self) -> None:
        for event in self.machine._events:
            if isinstance(event, StateChanged) and (state := event.text.partition(":")[0]) not in WELL:
                if state not in self.expected_states and event.text not in self.story.told:
                    self.story.told.append(event.text)
            elif isinstance(event, Note) and "may be homing" in event.text:
                self.story.told.append(event.text)
            elif isinstance(event, Position):
                x, y, e = event.reading_m
                self.story.positions.append((self.now, (1000.0 * x, 1000.0 * y, 1000.0 * e)))
        super()._collect()


def own_seconds(config: DriverConfig, start: Point, end: Point) -> float:
    """Return the time that the driver plans for a segment whose point names none."""
    across = math.hypot(end[0] - start[0], end[1] - start[1])
    return max(across / config.feed_m_s, abs(end[2] - start[2]) / config.stylus_feed_m_s) / 1000.0


def limit_s(seconds: float) -> float:
    return ANSWER_FACTOR * seconds + ANSWER_EXTRA_S
