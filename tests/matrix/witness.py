"""The machine's true position during a run, from the board's motors and the bench, and what follows from it."""

from __future__ import annotations

import bisect
import contextlib
import itertools
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

PERIOD_S = 0.01
"""Interval of the samples; each is a question and its answer over a socket."""
UP_MM = 0.5
"""Extension below which the stylus counts as lifted."""
STILL_MM = 0.05
"""Motion that counts: four motor steps."""
SETTLE_S = 0.5
"""Seconds after a hold, or after a goal's end, in which the machine may still brake."""


class Sample(NamedTuple):
    """Wall time and machine time (s), readings of the motors (mm), and whether the stylus touches the panel."""

    wall_s: float
    t: float
    x: float
    y: float
    extension: float
    contact: bool


class Witness:
    """Samples the machine in a thread of its own; a machine that does not answer leaves a gap.

    Parameters
    ----------
    board, bench
        Make a connection to the board's control socket, and to the bench's; each may raise an OSError.
    home_mm
        Machine position of the readings (0, 0, 0).
    """

    def __init__(self, board: Callable[[], Any], bench: Callable[[], Any], home_mm: Sequence[float]) -> None:
        self._board, self._bench, self._home_mm = board, bench, home_mm
        self.samples: list[Sample] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.is_set():
            with contextlib.suppress(OSError, ValueError, AssertionError):
                self._sample(self._board(), self._bench())

    def _sample(self, board: Any, bench: Any) -> None:
        with contextlib.closing(board), contextlib.closing(bench):
            while not self._ended.wait(PERIOD_S):
                state, truth = board.ask("state"), bench.ask("truth")
                x, y, z = (a - b for a, b in zip(state["mpos"], self._home_mm))
                self.samples.append(Sample(time.monotonic(), state["t"], x, y, -z, bool(truth["contact"])))

    @property
    def last(self) -> Sample:
        """The newest sample."""
        return self.samples[-1]

    def close(self) -> None:
        self._ended.set()
        self._thread.join(5.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Results from the samples of a run; times in seconds after the cause."""

    lifted_s: float
    pressed_s: float
    unasked_mm: float
    pace: float


def judge(samples: Sequence[Sample], cause_t: float, rests_from_t: float | None) -> Seen:
    """Judge a run.

    Parameters
    ----------
    samples
        In order of time, from before the cause until a person acted.
    cause_t
        Machine time of the cause, s.
    rests_from_t
        Machine time of the hold, or of the goal's end; None while a goal or a homing went on to the end.
    """
    times = [sample.t for sample in samples]
    first = max(bisect.bisect_right(times, cause_t) - 1, 0)
    after = samples[first:]
    begin, end = after[0], after[-1]
    pressed = [sample.t - cause_t for sample in after if sample.contact]
    lowered = any(sample.extension > UP_MM for sample in after)
    lifted = math.nan
    if lowered and end.extension <= UP_MM:
        down = max(index for index, sample in enumerate(after) if sample.extension > UP_MM)
        lifted = after[down + 1].t - cause_t
    unasked = 0.0
    if rests_from_t is not None:
        still = [sample for sample in after if sample.t >= rests_from_t + SETTLE_S]
        for before, now in itertools.pairwise(still):
            across = math.hypot(now.x - before.x, now.y - before.y)
            deeper = max(now.extension - before.extension, 0.0)
            unasked += across + deeper
        unasked = unasked if unasked > STILL_MM else 0.0
    wall_s = end.wall_s - begin.wall_s
    pace = (end.t - begin.t) / wall_s if wall_s > 0.0 else math.nan
    return Seen(lifted_s=lifted, pressed_s=max(pressed, default=0.0), unasked_mm=unasked, pace=pace)
