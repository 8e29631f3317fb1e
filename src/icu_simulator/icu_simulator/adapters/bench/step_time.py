"""Simulated time in steps: each step begins after the graph has finished the previous one, at most at real speed."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from icu_common.adapters.steps.step_gate import Laggard, StepGate
from icu_common.adapters.steps.step_ledger import BYTES_READ, BYTES_WRITTEN, StepLedger

CATCH_UP_S = 0.1
"""Wall seconds of delay that later steps may make up for; a longer delay makes the simulation slower."""
FACTOR_WINDOW_S = 3.0
"""Wall seconds over which the simulation factor is measured."""
SERIAL_PATIENCE_S = 0.3
"""Wall seconds after which bytes that neither end of the serial line takes count as discarded: a port was opened or
closed."""


class StepTime:
    """The simulated clock.

    It begins at the ledger's time, which bring-up sets to the system time so that stamps stay readable. After a restart
    of the bench it continues from there. It never overtakes the system time.

    Parameters
    ----------
    ledger
        The graph's counts.
    step_ns
        Length of a step while the machine moves or takes orders.
    publish, publish_image
        Publish a time in ns: of each step on ``/clock``, of each image on ``/clock_of_images``.
    """

    def __init__(
        self,
        ledger: StepLedger,
        step_ns: int,
        publish: Callable[[int], None],
        publish_image: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._ledger, self._step_ns = ledger, step_ns
        self._publish, self._publish_image = publish, publish_image
        self._gate = StepGate(ledger)
        if not ledger.time_ns:
            ledger.time_ns = time.time_ns()
        self.start_ns, self.now_ns = ledger.origin_ns, ledger.time_ns
        self._begin_s = time.monotonic()
        self._history: deque[tuple[float, int]] = deque([(self._begin_s, self.now_ns)])
        self._discarded = {BYTES_READ: 0, BYTES_WRITTEN: 0}
        self._serial_differs_s: float | None = None

    @property
    def now_s(self) -> float:
        """Seconds since the start of the simulation."""
        return (self.now_ns - self.start_ns) / 1e9

    def wait_s(self) -> float:
        """Return the wall seconds until the next step may begin."""
        return max(self._begin_s - time.monotonic(), 0.0)

    def advance(self, image_ns: int, *, long: bool = False) -> None:
        """Begin the next step, which ends at the next image or earlier; only a ``long`` one may exceed ``step_ns``."""
        now_s = time.monotonic()
        step_ns = image_ns - self.now_ns if long else min(self._step_ns, image_ns - self.now_ns)
        self._begin_s = max(self._begin_s, now_s - CATCH_UP_S) + step_ns / 1e9
        self.now_ns += step_ns
        self._ledger.time_ns = self.now_ns
        self._publish(self.now_ns)
        if self.now_ns == image_ns:
            self._publish_image(self.now_ns)
        self._history.append((now_s, self.now_ns))
        while len(self._history) > 2 and now_s - self._history[1][0] > FACTOR_WINDOW_S:
            self._history.popleft()

    def settled(self) -> bool:
        """Return whether every process has finished this step."""
        return self._gate.settled()

    def serial_settled(self, sent: int, received: int) -> bool:
        """Return whether the driver has processed what the board sent, and the board has what the driver wrote.

        Parameters
        ----------
        sent, received
            Bytes that the board has sent and received since its start.
        """
        ends = {BYTES_READ: sent, BYTES_WRITTEN: received}
        missing = {key: self._ledger.finished(key) - count - self._discarded[key] for key, count in ends.items()}
        if not any(missing.values()):
            self._serial_differs_s = None
            return True
        now_s = time.monotonic()
        if self._serial_differs_s is None:
            self._serial_differs_s = now_s
        if now_s - self._serial_differs_s < SERIAL_PATIENCE_S:
            return False
        for key, count in missing.items():
            self._discarded[key] += count
        self._serial_differs_s = None
        return True

    @property
    def left_behind(self) -> tuple[Laggard, ...]:
        """Processes without which the time advanced."""
        return self._gate.left_behind

    def factor(self) -> float:
        """Return the ratio of simulated to wall time over the last seconds; 1 is real time."""
        (begin_s, begin_ns), now_s = self._history[0], time.monotonic()
        # A step may begin slightly before the delay of its predecessors has been made up for.
        return min((self._history[-1][1] - begin_ns) / 1e9 / max(now_s - begin_s, 1e-3), 1.0)
