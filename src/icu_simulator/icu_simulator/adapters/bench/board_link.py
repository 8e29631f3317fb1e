"""Link to the board: its motion moves the bench, and the stylus's switch acts on its probe input."""

from __future__ import annotations

import selectors
import time
from pathlib import Path

from icu_simulator.adapters.bench.motion_client import MotionClient, MotorSample
from icu_simulator.core.bench import Bench

RECONNECT_S = 0.25
BUSY_S = 0.3
"""Simulated seconds after a motion or an order in which steps stay short: one order follows another."""
PROBE_STEP_S = 0.005
"""Simulated time between two samples near the panel while the stylus has a switch."""
_POLL_BYTES = 2
"""Bytes of status requests in a step; an order has more, with its line end."""
_STATES_AT_REST = ("Idle", "Alarm", "Sleep")


class BoardLink:
    """A connection that reconnects whenever it is lost; without a path there is no board.

    The owner's selector serves it: the data of its key is the function to call.
    """

    def __init__(self, path: Path | None, bench: Bench, selector: selectors.BaseSelector) -> None:
        self._motion = MotionClient(path) if path is not None else None
        self._bench, self._selector = bench, selector
        self._reconnect_at = 0.0
        self._busy_until_s = 0.0

    @property
    def connected(self) -> bool:
        return self._motion is not None and self._motion.socket is not None

    @property
    def bad_lines(self) -> int:
        """Number of lines that could not be read."""
        return self._motion.bad_lines if self._motion is not None else 0

    @property
    def sent(self) -> int:
        """Number of bytes that the board has sent to the driver."""
        return self._motion.sent if self._motion is not None else 0

    @property
    def received(self) -> int:
        """Number of bytes that the board has received from the driver."""
        return self._motion.received if self._motion is not None else 0

    def retries_in_s(self, now: float) -> list[float]:
        """Return the seconds until the next attempt to connect; none while connected."""
        return [self._reconnect_at - now] if self._motion is not None and not self.connected else []

    def connect(self) -> None:
        """Connect, if that is due."""
        motion, now = self._motion, time.monotonic()
        if motion is None or motion.socket is not None or now < self._reconnect_at:
            return
        self._reconnect_at = now + RECONNECT_S
        if motion.connect() and motion.socket is not None:
            self._selector.register(motion.socket, selectors.EVENT_READ, self._read)

    def _read(self) -> None:
        motion = self._motion
        if motion is None or motion.socket is None:
            return
        link = motion.socket
        self._feed(motion, motion.read())
        if motion.socket is None:
            self._selector.unregister(link)

    def follow(self, until_s: float) -> None:
        """Run the board to a time, and process its motion up to then."""
        motion = self._motion
        if motion is None or motion.socket is None:
            return
        link, received = motion.socket, motion.received
        rests = True
        while motion.socket is not None:
            # A switch in the stylus acts on the board while it moves, so near the panel a step has parts.
            part_s = min(motion.board_s + PROBE_STEP_S, until_s) if self._bench.switch_is_near() else until_s
            samples = motion.advance(max(part_s, motion.board_s))
            rests = rests and all(sample.state in _STATES_AT_REST for sample in samples)
            self._feed(motion, samples)
            if part_s >= until_s or not samples:
                break
        if motion.socket is None:
            self._selector.unregister(link)
        if motion.received - received > _POLL_BYTES or not rests:
            self._busy_until_s = until_s + BUSY_S

    def is_busy(self, now_s: float) -> bool:
        """Whether the machine moves or has just received an order: board and driver then need short steps."""
        return now_s < self._busy_until_s

    def _feed(self, motion: MotionClient, samples: list[MotorSample]) -> None:
        """Process motor samples, and set the board's probe input to the resulting state of the stylus switch."""
        for sample in samples:
            self._bench.feed(sample.mpos_mm, sample.spindle, sample.coolant, sample.time_s)
        motion.set_probe(self._bench.switch_closed)

    def close(self) -> None:
        if self._motion is not None:
            self._motion.close()
