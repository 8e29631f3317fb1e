"""A mock board on a test clock: send bytes, advance the time, read the answers; without real waiting."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from gantry_driver.mock.firmware.options import BoardOptions
from gantry_driver.mock.machine import MockMachine
from gantry_driver.mock.mechanics import MechanicsOptions
from gantry_driver.mock.settings import make_eeprom

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
UNLOCK = b"[MSG:'$H'|'$X' to unlock]\r\n"
FREE = {20: 0, 21: 0, 22: 0}
"""Settings of a board without homing and limits: idle at (0, 0, 0) after power-up."""
REPORT = re.compile(rb"<([^|>]+)\|[MW]Pos:([-\d.]+),([-\d.]+),([-\d.]+)[^>]*>\r\n")


@dataclass
class Rig:
    """One machine, powered up, with its banner read."""

    settings: dict[int, float] = field(default_factory=dict)
    baud: int = 0
    line_s: float = 0.0
    latency_s: float = 0.0
    seed: int = 0
    mist: bool = False
    dialect: str = "GRBL"
    mechanics: MechanicsOptions = field(default_factory=MechanicsOptions)

    def __post_init__(self) -> None:
        self.machine = MockMachine(
            make_eeprom(self.settings),
            board=BoardOptions(
                baud=self.baud, line_s=self.line_s, latency_s=self.latency_s, mist=self.mist, dialect=self.dialect
            ),
            mechanics=self.mechanics,
            seed=self.seed,
        )
        self.board = self.machine.board
        self.board.power_on(0.0)
        self.greeting = self.run(0.5)

    @classmethod
    def homed(cls, **arguments) -> Rig:
        rig = cls(**arguments)
        rig.board.receive(b"$H\n", rig.board.now)
        assert rig.run(60.0) == b"ok\r\n"
        return rig

    @classmethod
    def free(cls, settings: dict[int, float] | None = None, **arguments) -> Rig:
        return cls(settings={**FREE, **(settings or {})}, **arguments)

    @property
    def now(self) -> float:
        return self.board.now

    def run(self, seconds: float) -> bytes:
        """Let time pass and return what arrived."""
        self.board.advance(self.board.now + seconds)
        return b"".join(self.board.take_output())

    def send(self, data: bytes, seconds: float = 0.0) -> bytes:
        """Send, let time pass, and return what arrived."""
        self.board.receive(data, self.board.now)
        return self.run(seconds)

    def until(self, expected: bytes, within_s: float) -> float:
        """Run to the moment at which ``expected`` has arrived and return the time it took."""
        start, seen = self.now, b""
        while True:
            seen += b"".join(self.board.take_output())
            if expected in seen:
                return self.now - start
            due = self.board.next_due()
            assert due is not None and due - start <= within_s, f"{expected!r} did not come; seen: {seen!r}"
            self.board.advance(max(due, self.now))

    def report(self) -> tuple[str, tuple[float, float, float]]:
        """Ask with ``?`` and return state and position."""
        answer = self.send(b"?")
        match = REPORT.search(answer)
        assert match, f"no report in {answer!r}"
        return match[1].decode(), (float(match[2]), float(match[3]), float(match[4]))

    def count(self, name: str) -> int:
        return self.board.journal.counts[name]
