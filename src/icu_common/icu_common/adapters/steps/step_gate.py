"""Decides when simulated or recorded time may advance: when every process has finished what was published."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from icu_common.adapters.steps.step_ledger import Counts, StepLedger
from icu_common.core.processes.outstanding import Outstanding

PATIENCE_S = 5.0
"""Longest wait for a process that is in no callback: it is suspended, or a message was lost."""
CALLBACK_PATIENCE_S = 120.0
"""Longest wait for a callback; bring-up ends a process that stays in one for longer."""
GONE_S = 0.5
"""Longest such wait on a topic that has just lost a subscription: a publisher may have counted the ending one."""
_LOOK_FOR_ENDED_S = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Laggard:
    """A process that has not finished some messages: its number, program name and topic."""

    process: int
    program: str
    topic: str


class StepGate:
    """Watches a ledger from the process that advances the time.

    Parameters
    ----------
    ledger
        The graph's counts.
    patience_s, callback_patience_s
        Wall seconds without progress after which the time advances without a process that is idle, or in a
        callback.
    clock
        Wall clock in seconds.

    Attributes
    ----------
    left_behind
        Processes without which the time advanced at the last time-out.
    """

    def __init__(
        self,
        ledger: StepLedger,
        *,
        patience_s: float = PATIENCE_S,
        callback_patience_s: float = CALLBACK_PATIENCE_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ledger = ledger
        self._patience_s, self._callback_patience_s = patience_s, callback_patience_s
        self._clock = clock
        self._outstanding = Outstanding()
        self._finished: Counts = np.zeros(0, np.int64)
        self._since_s: npt.NDArray[np.float64] = np.zeros(0)
        self._subscriptions: Counts = np.zeros(0, np.int64)
        self._lost_s: npt.NDArray[np.float64] = np.zeros(0)
        """Time at which each topic last lost a subscription."""
        self._looked_s = clock()
        self._processes: dict[int, int] = {}
        self._suspended: dict[int, tuple[Counts, int]] = {}
        """Subscriptions and finished messages of each process at the time it was left behind, by row."""
        self.left_behind: tuple[Laggard, ...] = ()

    def settled(self) -> bool:
        """Return whether no message is outstanding, or the processes that owe one have timed out."""
        now_s = self._clock()
        self._resume_suspended()
        finished, expected, subscriptions = self._ledger.totals()
        owed = self._outstanding.update(finished, expected, subscriptions)
        patience_s = self._patience_of_topics(subscriptions, now_s)
        if (processes := self._ledger.processes()) != self._processes:
            # The sums no longer contain the counts of an ended process.
            self._processes = processes
            self._outstanding.forgive(owed)
            return False
        since_s = self._note_progress(finished, owed, now_s)
        if not owed.any():
            return True
        if now_s - self._looked_s > _LOOK_FOR_ENDED_S:
            self._looked_s = now_s
            self._ledger.forget_ended()
        stuck = np.where((owed > 0) & (now_s - since_s > patience_s), owed, 0)
        if not stuck.any():
            return False
        busy = any(self._ledger.is_busy(row) for row in self._laggards(stuck))
        if busy and (now_s - since_s[stuck > 0]).max() <= self._callback_patience_s:
            return False
        # The gate does not wait for messages to an ended process, and no running process counts as a laggard for them.
        late = self._laggards(np.where(patience_s < self._patience_s, 0, stuck))
        self.left_behind = tuple(late.values())
        for row in late:
            self._suspended[row] = self._ledger.suspend(row), self._ledger.progress(row)
        self._outstanding.forgive(stuck)
        return not (owed - stuck).any()

    def _patience_of_topics(self, subscriptions: Counts, now_s: float) -> npt.NDArray[np.float64]:
        """Return, for each topic, the longest wait without progress."""
        if added := len(subscriptions) - len(self._subscriptions):
            self._subscriptions = np.pad(self._subscriptions, (0, added))
            self._lost_s = np.pad(self._lost_s, (0, added), constant_values=-np.inf)
        self._lost_s[subscriptions < self._subscriptions] = now_s
        self._subscriptions = subscriptions
        return np.where(now_s - self._lost_s <= self._patience_s, min(GONE_S, self._patience_s), self._patience_s)

    def _note_progress(self, finished: Counts, owed: Counts, now_s: float) -> npt.NDArray[np.float64]:
        """Return the time of each topic's last progress; a topic with nothing outstanding counts as progressing."""
        if added := len(finished) - len(self._finished):
            self._finished = np.pad(self._finished, (0, added))
            self._since_s = np.pad(self._since_s, (0, added), constant_values=now_s)
        self._since_s[(finished != self._finished) | (owed == 0)] = now_s
        self._finished = finished
        return self._since_s

    def owed(self) -> list[str]:
        """Return the topics with outstanding messages."""
        owed = self._outstanding.update(*self._ledger.totals())
        topics = self._ledger.topics()
        return [topics[column] for column in np.flatnonzero(owed)]

    def unmatched(self) -> list[str]:
        """Return topics whose publishers have not found every registered subscription yet."""
        _, subscriptions, matched = self._ledger.by_process()
        readers, topics = subscriptions.sum(axis=0), self._ledger.topics()
        short = (matched > 0) & (matched - 1 < readers)
        return [topics[column] for column in np.flatnonzero(short.any(axis=0))]

    def processes(self) -> int:
        """Return how many processes are registered and running."""
        self._ledger.forget_ended()
        return len(self._ledger.processes())

    def restart(self) -> None:
        """Count only what is published from now on."""
        self._outstanding.forgive(self._outstanding.update(*self._ledger.totals()))

    def _resume_suspended(self) -> None:
        """Wait again for processes that have continued."""
        for row, (subscriptions, progress) in list(self._suspended.items()):
            if row not in self._ledger.processes():
                del self._suspended[row]
            elif self._ledger.progress(row) != progress:
                self._ledger.resume(row, subscriptions)
                del self._suspended[row]

    def _laggards(self, owed: Counts) -> dict[int, Laggard]:
        """Return row -> process for those that have finished fewer messages of an outstanding topic than others."""
        finished, subscriptions, _ = self._ledger.by_process()
        topics, found = self._ledger.topics(), {}
        for column in np.flatnonzero(owed):
            rows = np.flatnonzero(subscriptions[:, column])
            if not rows.size:  # an entry that is not a topic, such as the driver's steps
                continue
            share = finished[rows, column] / subscriptions[rows, column]
            for row in rows[(share < share.max()) | (len(rows) == 1)]:
                process = self._ledger.processes().get(int(row), 0)
                found[int(row)] = Laggard(process=process, program=_program(process), topic=topics[column])
        return found


def _program(process: int) -> str:
    """Return the name of a process's program, empty for one that has ended."""
    with contextlib.suppress(OSError):
        words = Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace").split("\0")
        named = [word.removeprefix("__node:=") for word in words if word.startswith("__node:=")]
        return named[0] if named else Path(words[1 if len(words) > 1 else 0]).name
    return ""
