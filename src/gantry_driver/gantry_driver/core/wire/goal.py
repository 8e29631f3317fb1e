"""The goal that the driver follows, and what is proved of it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from gantry_driver.core.program.marks import LineMarks
from gantry_driver.core.wire.stages import Confirm, Item, Stage
from gantry_driver.core.wire.watch import Deviation, PathWatch

Reading = tuple[float, float, float]


@dataclass(slots=True, kw_only=True)
class Goal:
    """The goal under way: its stages, and what is proved of the present one.

    Parameters
    ----------
    goal_id, text, started
        For the answer.
    end_m
        Readings at the end, m.
    stages
        Those that have not begun; a program has none.
    items
        What is still to be sent of the present stage; a long program is walked through while it runs.
    origin_mm
        The frame of the path, None outside a frame.
    limit_s
        Largest duration without pauses, s.
    touching
        Whether the stylus is extended anywhere on the path.
    """

    goal_id: str
    text: str
    end_m: Reading
    started: float
    items: Iterator[Item]
    stages: deque[Stage] = field(default_factory=deque)
    stage: Stage = field(default_factory=Stage)
    origin_mm: Reading | None = None
    limit_s: float = math.inf
    touching: bool = False
    watch: PathWatch | None = None
    marks: LineMarks | None = None
    """Where the lines of a program end; a goal's stages are short and need none."""
    sent_all: bool = False
    """Whether every line of the present stage is queued."""
    last_line: int = 0
    unasked: int = 0
    """Lines since the last ``$G`` that was sent between them."""
    feed: str = ""
    confirming: Confirm | None = None
    confirm_line: int = 0
    modes_text: str = ""
    """What the last ``[GC:..]`` said since the question."""
    tries: int = 0
    frame: Confirm | None = None
    """The order that sets the frame of the path."""
    doubt: Deviation | None = None
    """The deviation of the last report, after which the board was held; the next report decides."""
    elsewhere_at: float = math.inf
    """When the board was first seen at rest elsewhere than at the end of the stage."""
    paused_s: float = 0.0
    slowest_percent: float = 100.0
