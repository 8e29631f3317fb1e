"""Seeded faults against the mock board, judged by what the board itself has seen.

Each seed is one run with a board and a link of its own: a random path, one fault at a random moment, and then the
promises: no line lost, doubled or reordered without being reported; no false done; nothing moves after the answer but
the stylus upwards; no byte beyond the buffer; no unbounded wait. ``CAMPAIGN_SEEDS=1000`` (or ``FIRST:LAST``) chooses
the seeds; a failure names its own.
"""

from __future__ import annotations

import os
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from nodes.grbl_board import GrblBoard, LinkRig

from gantry_driver.core.machine_config import DriverConfig

HOMED = (-359.0, -219.0, -1.0)
SCALE = 8.0
ANSWER_WITHIN_S = 20.0
REST_WITHIN_S = 12.0


@dataclass(frozen=True, kw_only=True)
class Fault:
    """What happens; ``before`` marks those that are armed before the path is sent."""

    name: str
    do: Callable[[GrblBoard, LinkRig, random.Random], Any]
    before: bool = False
    must_reach: bool = False


def inject(kind: str, **arguments: Any) -> Callable[[GrblBoard, LinkRig, random.Random], Any]:
    return lambda board, rig, rng: board.fault(kind, **arguments)


FAULTS = [
    Fault(name="none", do=lambda board, rig, rng: None, must_reach=True),
    Fault(name="unplug", do=lambda b, r, g: b.fault("unplug", seconds=g.uniform(0.5, 5.0))),
    Fault(name="brown-out", do=inject("brown_out")),
    Fault(name="soft reset", do=inject("soft_reset")),
    Fault(name="error", do=lambda b, r, g: b.fault("error", number=22, after=g.randrange(12)), before=True),
    Fault(name="garbage", do=lambda b, r, g: b.fault("garbage", count=g.randrange(1, 200))),
    Fault(name="stray ok", do=lambda b, r, g: b.fault("stray_ok", count=g.randrange(1, 3))),
    Fault(name="lost", do=lambda b, r, g: b.fault("answers", how="lost", count=g.randrange(1, 3)), before=True),
    Fault(name="delayed", do=lambda b, r, g: b.fault("answers", how="delayed", count=2, seconds=2.0), before=True),
    Fault(name="split", do=inject("answers", how="split", count=5), before=True, must_reach=True),
    Fault(name="merged", do=inject("answers", how="merged", count=3), before=True),
    Fault(name="alarm", do=lambda b, r, g: b.fault("alarm", number=g.choice([1, 2]))),
    Fault(name="hang", do=lambda b, r, g: b.fault("hang", seconds=g.uniform(0.2, 20.0))),
    Fault(name="full", do=lambda b, r, g: b.fault("stop_reading", seconds=g.uniform(0.5, 12.0))),
    Fault(name="door", do=inject("door", on=True)),
    Fault(name="stop button", do=inject("stop_button", on=True)),
    Fault(name="limit", do=inject("limit", axis="X", on=True)),
    Fault(name="operator stop", do=lambda b, r, g: r.link.stop("stop requested")),
]


def seeds() -> range:
    first, _, last = os.environ.get("CAMPAIGN_SEEDS", str(len(FAULTS))).rpartition(":")
    return range(int(first or 0), int(last))


def path(rng: random.Random) -> list[tuple[float, float, float]]:
    down = rng.choice([0.0, 0.0, 0.02])
    return [
        (round(rng.uniform(0.0, 0.359), 3), round(rng.uniform(0.0, 0.219), 3), down)
        for _ in range(rng.randrange(4, 40))
    ]


def still(board: GrblBoard, seconds: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return where the motors stood and where they stand ``seconds`` later."""
    before, end = board.mpos(), time.monotonic() + seconds
    while time.monotonic() < end:
        board.counters()
    return before, board.mpos()


@pytest.mark.parametrize("seed", seeds())
def test_promises_hold_under_a_fault(seed: int, tmp_path: Path) -> None:
    rng = random.Random(seed)
    fault = FAULTS[seed % len(FAULTS)] if seed < len(FAULTS) else rng.choice(FAULTS)
    print(f"seed {seed}: {fault.name}")
    config = DriverConfig(enabled_at_start=True, answer_timeout_s=1.5)
    board = GrblBoard(tmp_path, "--seed", str(seed), time_scale=SCALE)
    rig = LinkRig(board.port, config)
    try:
        rig.home()
        since = board.log()[-1]["n"] + 1
        way = path(rng)
        if fault.before:
            fault.do(board, rig, rng)
        assert rig.go(*way, goal_id=str(seed)).outcome.value == "accepted"
        if not fault.before:
            rig.link.wait_for(lambda machine: len(rig.results) == 2, rng.uniform(0.0, 0.8))
            fault.do(board, rig, rng)
        rig.until(lambda: len(rig.results) >= 2, ANSWER_WITHIN_S)
        answer = rig.results[-1]
        judge(board, rig, fault, way, since)
        assert board.counters().get("bytes_lost_overflow", 0) == 0, "more bytes than the buffer holds"
        assert [r.goal_id for r in rig.results] == [str(seed)] * 2, "one acceptance and one final answer"
        assert answer.outcome.value == "reached" or answer.reason
    finally:
        rig.close()
        board.close()


def judge(board: GrblBoard, rig: LinkRig, fault: Fault, way: list[tuple[float, float, float]], since: int) -> None:
    answer = rig.results[-1]
    reached = answer.outcome.value == "reached"
    if reached:
        truth = board.mpos()
        x, y, z = way[-1]
        target = (HOMED[0] + 1000 * x, HOMED[1] + 1000 * y, HOMED[2] - 1000 * z)
        assert truth == pytest.approx(target, abs=0.05), "a false done"
    assert reached or not fault.must_reach, answer
    # A link that is gone, or a board that hangs, cannot be stopped; the answer says so. Rest begins when it is back.
    rig.until(lambda: rig.machine.connected and rig.machine.at_rest, REST_WITHIN_S)
    before, after = still(board, 0.3)
    assert after[:2] == pytest.approx(before[:2], abs=1e-6) and after[2] >= before[2] - 1e-6, "motion after the answer"
    if fault.name not in ("unplug", "brown-out"):  # the log's lines end with the power, and so do the promises
        sent = moves_of(way)
        taken = [
            e["text"] for e in board.lines(since) if e["text"].startswith("G53G1X") or e["text"].startswith("G53G1Y")
        ]
        assert taken == sent[: len(taken)], "lost, doubled or reordered"
        assert not reached or len(taken) == len(sent)


def moves_of(way: list[tuple[float, float, float]]) -> list[str]:
    """Return the lines that this path must become, computed anew and not by the driver."""
    lines, here = [], (0.0, 0.0, 0.0)
    for point in way:
        words = "".join(
            f"{letter}{format(home + sign * 1000 * value, '.3f').rstrip('0').rstrip('.')}"
            for letter, home, sign, value, old in zip("XYZ", HOMED, (1, 1, -1), point, here)
            if value != old
        )
        seconds = max(
            ((point[0] - here[0]) ** 2 + (point[1] - here[1]) ** 2) ** 0.5 / 0.15, abs(point[2] - here[2]) / 0.03
        )
        length = sum((1000 * (a - b)) ** 2 for a, b in zip(point, here)) ** 0.5
        if words:
            lines.append(f"G53G1{words}F{format(length / seconds * 60, '.1f').rstrip('0').rstrip('.')}")
        here = point
    return lines
