"""The driver's machine and the mock board on one virtual clock, with a link between them that can break.

Behaviour of the serial link on a real port, without waiting (tests of the link use a pseudo-terminal). Bytes come in
pieces of any size, a port disappears and returns, one accepts no more bytes, and a hold passes all queues.
"""

from __future__ import annotations

import dataclasses
import math
import random
from collections.abc import Callable, Sequence
from typing import Any

from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.states.machine_states import Answered, CloseRequested, Note, StateChanged
from gantry_driver.mock.firmware.options import BoardOptions
from gantry_driver.mock.machine import MockMachine
from gantry_driver.mock.settings import make_eeprom
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.goals.results import GoalResult

RETRY_S = 0.1
KERNEL_BYTES = 4096
"""Bytes that a terminal accepts although no program reads it."""


class VirtualRig:
    """One run; ``now`` is the only clock, in seconds for both sides."""

    def __init__(
        self, config: DriverConfig, seed: int, dialect: str = "GRBL", make_mock: type[MockMachine] = MockMachine
    ) -> None:
        self.mock = make_mock(make_eeprom({}), board=BoardOptions(dialect=dialect), seed=seed)
        self.board = self.mock.board
        self.machine = Machine(dataclasses.replace(config, envelope=EnvelopeConfig(free_space_m=0.2, crossing_m=0.2)))
        self.machine.heartbeat(math.inf)
        self.now = 0.0
        self.states: list[str] = []
        self.results: list[GoalResult] = []
        self.notes: list[str] = []
        self._rng = random.Random(seed)
        self._plugged = self._reading = True
        self._open = False
        self._next_open = 0.0
        self._pending = bytearray()
        self._kernel = bytearray()
        self._ends: dict[str, float] = {}
        self.board.power_on(0.0)

    # --- what a test does -----------------------------------------------------------------------------------------

    def fault(self, kind: str, **arguments: Any) -> None:
        port_fault = self.mock.inject(kind, arguments)
        if port_fault is None:
            return
        self._ends[port_fault.kind] = self.now + port_fault.seconds
        if port_fault.kind == "unplug":
            self._plugged = False
            self.board.power_off(self.now)
            if self._open:
                self._close()
                self.machine.closed("the device has gone", self.now)
        else:
            self._reading = False

    def call(self, action: Callable[[Machine, float], Any]) -> Any:
        return action(self.machine, self.now)

    def stop(self, reason: str) -> None:
        """Write a hold past all queues, as the link does from the caller's thread."""
        if self._open:
            self._pending.clear()
            self._kernel.clear()
            self._write(b"!")
        self.machine.stop(reason, self.now, hold_written=self._open)

    def go(self, points: Sequence[tuple[float, float, float]], goal_id: str) -> GoalResult:
        way = [Waypoint(positions_m=point) for point in points]
        return self.machine.run(goal_id, JOINTS, way, age_s=0.0, now=self.now)

    def home(self) -> None:
        self.until(lambda: self.machine.phase.state == "unhomed", 20.0)
        refusal = self.machine.home(self.now)
        assert not refusal, refusal
        self.until(lambda: self.machine.phase.state == "idle", 60.0)

    def until(self, condition: Callable[[], Any], within_s: float) -> None:
        """Run until the condition holds; a wait without a bound fails here."""
        end = self.now + within_s
        while not condition():
            assert self.now < end, (
                f"not within {within_s} s: {self.states[-4:]}, {self.results[-2:]}, {self.notes[-4:]}"
            )
            self._step(end)

    def run_for(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end:
            self._step(end)

    def mpos(self) -> tuple[float, float, float]:
        x, y, z = self.mock.mechanics.mpos_mm()
        return x, y, z

    def servo(self) -> float:
        return self.mock.mechanics.spindle_rpm

    def counter(self, name: str) -> int:
        return self.board.journal.counts[name]

    def lines(self, since: int, kind: str = "line") -> list[dict[str, Any]]:
        return self.board.journal.since(since, kind)

    @property
    def entry(self) -> int:
        """The number of the next entry of the board's journal."""
        entries = self.board.journal.entries
        return int(entries[-1]["n"]) + 1 if entries else 0

    # --- the link -------------------------------------------------------------------------------------------------

    def _step(self, end: float) -> None:
        times = [end, *self._ends.values()]
        if self._open:
            times.append(self._deadline())
        elif self._plugged:
            times.append(self._next_open)
        data = self._run_board(min(times))
        if self._open:
            self._turn(data)
        elif self._plugged and self.now >= self._next_open:
            self.board.power_on(self.now)  # opening the port resets an Arduino
            self._open = True
            self.machine.opened(self.now)
        self._collect()

    def _run_board(self, end: float) -> bytes:
        """Go on to the board's next event, to ``end`` at most; return what the board has sent."""
        due = self.board.next_due()
        self.now = max(end if due is None else min(end, due), self.now + 1e-6)
        if self._ends:
            self._end_faults()
        self.board.advance(self.now)
        return b"".join(self.board.take_output())

    def _deadline(self) -> float:
        return self.machine.deadline(self.now)

    def _receive(self, data: bytes) -> None:
        while data:
            size = self._rng.randint(1, len(data))
            self.machine.receive(data[:size], self.now)
            data = data[size:]

    def _turn(self, data: bytes) -> None:
        self._receive(data)
        self.machine.tick(self.now)
        self._pending += self.machine.output(self.now)
        if self._reading:
            self._write(bytes(self._pending))
            self._pending.clear()
        else:
            room = KERNEL_BYTES - len(self._kernel)
            self._kernel += self._pending[:room]
            del self._pending[:room]

    def _write(self, data: bytes) -> None:
        if not data:
            return
        if self._reading:
            self.board.receive(data, self.now)
        else:
            self._kernel += data

    def _end_faults(self) -> None:
        for kind in [kind for kind, end in self._ends.items() if end <= self.now]:
            del self._ends[kind]
            if kind == "unplug":
                self._plugged = True
                self.board.power_on(self.now)
            else:
                self._reading = True
                waiting, self._kernel = bytes(self._kernel), bytearray()
                self._write(waiting)

    def _close(self) -> None:
        self._open = False
        self._next_open = self.now + RETRY_S
        self._pending.clear()
        self._kernel.clear()

    def _collect(self) -> None:
        for event in self.machine.take_events():
            if isinstance(event, StateChanged):
                self.states.append(event.text)
            elif isinstance(event, Answered):
                self.results.append(event.result)
            elif isinstance(event, Note):
                self.notes.append(event.text)
            elif isinstance(event, CloseRequested):
                self._close()
