"""Cells of the matrix of faults: program, fault and phase, the seeded order of runs, their records, and the table."""

from __future__ import annotations

import csv
import math
import random
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

BOARD, GUARD, GRAPH = "mock_grbl", "gantry_guard", "all programs"
PROGRAMS = (
    *("serial_driver", GUARD, "gantry_controller", "sequencer", "ui_bridge", "camera", "corners_left", "corners_right"),
    *("stereo", "dense_stereo", "stylus_tracker", "recognition", "hand_eye"),
)
"""The project's programs on the machine; the board and the bench stand for the hardware."""
FAULTS = ("kill", "stop 1 s", "stop 60 s", "flood", "garbage", "disk full")
CLOCK = "clock jump"
"""Fault of all programs at once: the graph has one clock."""
PHASES = ("rest", "travel", "descent", "contact", "turn", "drag", "homing", "calibration")
TOUCHING = ("contact", "turn", "drag")
"""Phases with the stylus on the panel."""
NO_INPUT = {("camera", "flood"), ("camera", "garbage")}
"""The camera subscribes to nothing."""
PRESSING_LIMIT_S = 2.0


@dataclass(frozen=True, slots=True, order=True)
class Cell:
    """A program, what happens to it, and what the machine does meanwhile."""

    program: str
    fault: str
    phase: str

    def __str__(self) -> str:
        return f"{self.program}, {self.fault}, {self.phase}"


def all_cells() -> list[Cell]:
    """Return every cell of the matrix."""
    pairs = [(p, f) for p in PROGRAMS for f in FAULTS if (p, f) not in NO_INPUT]
    return [Cell(p, f, phase) for p, f in (*pairs, (GRAPH, CLOCK)) for phase in PHASES]


def drawn(runs: int, seed: int, chosen: Iterable[Cell] | None = None) -> list[Cell]:
    """Return the cells of a seed's runs: all in a random order, then all again in another one.

    So the first ``n`` runs of a longer campaign are those of a shorter one with the same seed.
    """
    cells = sorted(all_cells() if chosen is None else chosen)
    rng, found = random.Random(seed), []
    while len(found) < runs:
        found += rng.sample(cells, len(cells))
    return found[:runs]


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """Result of one run; times in seconds of the machine's clock after the cause, NaN where nothing happened."""

    run: int
    seed: int
    program: str
    fault: str
    phase: str
    held_s: float = math.nan
    lifted_s: float = math.nan
    pressed_s: float = 0.0
    """Last contact with the panel after the cause, counted from the cause."""
    unasked_mm: float = 0.0
    """Motion without a person after the machine was at rest, other than the stylus upwards."""
    pace: float = math.nan
    """Seconds of the machine's clock in a second of the wall clock: below 1 the simulation was slow."""
    answer: str = ""
    page: str = ""
    note: str = ""
    """Obstacle of the run; a run with a note is repeated by the next call and not in the table."""

    @property
    def cell(self) -> Cell:
        return Cell(self.program, self.fault, self.phase)

    @property
    def goes_on(self) -> bool:
        """Whether the fault left the goal intact: nothing was held, and it ended as the operator wanted."""
        return math.isnan(self.held_s) and self.answer in ("", "reached", "homed", "calibrated")

    def wrong(self) -> str:
        """Return what must not happen and did, empty for nothing."""
        found = []
        if self.pressed_s > PRESSING_LIMIT_S and not self.goes_on:
            found.append(f"pressed until {self.pressed_s:.2f} s after the cause (limit {PRESSING_LIMIT_S:g} s)")
        if self.unasked_mm > 0.0:
            found.append(f"moved {self.unasked_mm:.2f} mm without a person")
        return "; ".join(found)


def read_records(path: Path, seed: int) -> dict[int, Record]:
    """Return the records of a seed by the number of their run; those with a note are left out."""
    if not path.is_file():
        return {}
    kinds = {field.name: field.type for field in fields(Record)}
    found = {}
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            values = {n: {"int": int, "float": float}.get(str(kinds[n]), str)(text) for n, text in row.items()}
            record = Record(**values)  # type: ignore[arg-type]
            if record.seed == seed and not record.note:
                found[record.run] = record
    return found


def append_record(path: Path, record: Record) -> None:
    """Add a record to the file at once, so that a campaign that is broken off can go on."""
    new = not path.is_file()
    with path.open("a", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, [field.name for field in fields(Record)])
        if new:
            writer.writeheader()
        writer.writerow(asdict(record))


def table(records: Sequence[Record]) -> str:
    """Return the slowest run of each cell as a Markdown table: seconds to hold / to lift (number of runs)."""
    rows = [f"| program | fault | {' | '.join(PHASES)} |", f"|---|---|{'---|' * len(PHASES)}"]
    for program in (*PROGRAMS, GRAPH):
        for fault in (*FAULTS, CLOCK):
            mine = [record for record in records if (record.program, record.fault) == (program, fault)]
            if mine:
                cells = [_text([record for record in mine if record.phase == phase]) for phase in PHASES]
                rows.append(f"| {program} | {fault} | {' | '.join(cells)} |")
    return "\n".join(rows)


def _text(found: Sequence[Record]) -> str:
    if not found:
        return ""
    count = f" ({len(found)})" if len(found) > 1 else ""
    if any(record.wrong() for record in found):
        return f"**wrong**{count}"
    held = [record.held_s for record in found if not math.isnan(record.held_s)]
    lifted = [record.lifted_s for record in found if not math.isnan(record.lifted_s)]
    if all(record.goes_on for record in found):
        return f"goes on{count}"
    return f"{_longest(held)} / {_longest(lifted)}{count}"


def _longest(seconds: Sequence[float]) -> str:
    return f"{max(seconds):.2f}" if seconds else "-"
