"""The goal in progress, and the state of its proof."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from gantry_driver.core.program.marks import LineMarks
from gantry_driver.core.wire.stages import Confirm, Item, MotionStage
from gantry_driver.core.wire.watch import Deviation, PathWatch

Reading = tuple[float, float, float]


@dataclass(slots=True, kw_only=True)
class Goal:
    """The goal in progress: its stages, and the state of the current one.

    Parameters
    ----------
    goal_id, text, started
        Values for the answer.
    end_m
        Readings at the end, m.
    stages
        Stages that have not started; a program has none.
    items
        Unsent items of the current stage; a long program is read while it runs.
    origin_mm
        Frame of the path, None outside a frame.
    limit_s
        Maximum duration without pauses, s.
    touching
        Whether the stylus is extended anywhere on the path.
    """

    goal_id: str
    text: str
    end_m: Reading
    started: float
    items: Iterator[Item]
    stages: deque[MotionStage] = field(default_factory=deque)
    stage: MotionStage = field(default_factory=MotionStage)
    origin_mm: Reading | None = None
    limit_s: float = math.inf
    touching: bool = False
    watch: PathWatch | None = None
    marks: LineMarks | None = None
    """Ends of a program's lines along its path; the stages of a trajectory are short and need none."""
    sent_all: bool = False
    """Whether every line of the current stage is queued."""
    last_line: int = 0
    unasked: int = 0
    """Number of lines since the last ``$G`` that was sent between them."""
    feed: str = ""
    confirming: Confirm | None = None
    confirm_line: int = 0
    modes_text: str = ""
    """Text of the last ``[GC:..]`` since the query."""
    tries: int = 0
    frame: Confirm | None = None
    """Order that sets the frame of the path."""
    doubt: Deviation | None = None
    """Deviation of the last report, after which the board was held; the next report decides."""
    elsewhere_at: float = math.inf
    """Time at which the board first reported rest at a position other than the end of the stage."""
    paused_s: float = 0.0
    slowest_percent: float = 100.0
