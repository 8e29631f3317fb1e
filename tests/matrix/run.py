"""The matrix of faults: ``python -m matrix.run --runs 200``; a seeded fault in a seeded phase of the running graph.

Each run is one line of ``matrix.csv``, written at once; the next call with the same seed goes on after the last one.
``table.md`` has the slowest run of each cell. The exit code is 1 if a run was wrong.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from matrix.causes import WATCH_S, NoInput, prepared
from matrix.cells import TOUCHING, Cell, Record, all_cells, append_record, drawn, read_records, table
from matrix.stage import Stage
from matrix.witness import SETTLE_S, UP_MM, judge
from support.ros_rig import Ros, participant

DOMAIN = 96
FAILED = pytest.fail.Exception
"""Raised by the waiting functions that tests share."""
MACHINE_S, LIFT_S, GOAL_S = 3.0, 10.0, 20.0
"""Seconds of the machine's clock: to watch each run, to wait for the lift after a hold, and for a goal's end."""
PATIENCE_S = 200.0
"""Maximum seconds of the wall clock for these; a slow simulation takes longer than a machine."""


class Campaign:
    """Plays runs on one graph, and starts another one where the machine cannot be made ready."""

    def __init__(self, seed: int, ros: Ros, folder: Path, extra: Sequence[str]) -> None:
        self._seed, self._ros, self._folder, self._extra = seed, ros, folder, extra
        self._stage: Stage | None = None
        self._graphs = 0

    def play(self, run: int, cell: Cell) -> Record:
        """Play one run; what hinders it is its note."""
        base = {"run": run, "seed": self._seed, "program": cell.program, "fault": cell.fault, "phase": cell.phase}
        try:
            stage = self._ready()
            return self._watched(stage, cell, random.Random(f"{self._seed} {run}"), base)
        except NoInput as error:
            return Record(**base, note=f"{error} subscribes to nothing")
        except (Exception, FAILED) as error:
            self.close()
            return Record(**base, note=f"{type(error).__name__}: {error}"[:300].replace("\n", " "))

    def _ready(self) -> Stage:
        if self._stage is not None:
            try:
                self._stage.make_ready()
                return self._stage
            except (TimeoutError, OSError, AssertionError, FAILED):
                self.close()
        self._graphs += 1
        folder = self._folder / f"graph_{self._graphs}"
        folder.mkdir(parents=True)
        self._stage = Stage(folder, DOMAIN, self._ros, *self._extra)
        self._stage.make_ready()
        return self._stage

    def _watched(self, stage: Stage, cell: Cell, rng: random.Random, base: dict[str, object]) -> Record:
        operator, witness, page = stage.operator, stage.witness, stage.page
        assert witness is not None and page is not None
        with prepared(stage, cell, rng) as begin:
            goal = stage.begin(cell.phase)
            witness.samples[:] = witness.samples[-20:]
            mark = stage.graph.board()
            with contextlib.closing(mark):
                since, board = mark.mark(), float(mark.ask("counters")["t"])
            begun_s = time.monotonic()
            lasts_s = begin()
            stage.holds(lambda: time.monotonic() > begun_s + lasts_s, lasts_s + 1.0)

        def answer() -> str:
            if goal:
                mine = [r.outcome.value for r in operator.results if r.goal_id == goal and r.outcome.final]
                return mine[-1] if mine else "none"
            if cell.phase == "homing":
                return "homed" if operator.driver_state in ("idle", "disabled") else operator.driver_state
            if cell.phase == "calibration":
                return "calibrated" if not stage.calibrating else "calibrating"
            return ""

        def watched() -> bool:
            slow = witness.last.t < board + MACHINE_S  # of a slow simulation the wall clock says little
            return time.monotonic() > begun_s + lasts_s + WATCH_S and not slow

        stage.holds(watched, lasts_s + PATIENCE_S)
        holds = self._holds(stage, since)
        if not holds and goal:
            stage.holds(lambda: answer() != "none" or witness.last.t > board + GOAL_S, PATIENCE_S)
        held = [t - board for t in holds if t >= board]
        rests_from = board + held[0] if held else None
        if rests_from is None and (cell.phase == "rest" or (goal and answer() != "none")):
            rests_from = board if cell.phase == "rest" else witness.last.t
            stage.holds(lambda: witness.last.t > (rests_from or 0.0) + 2 * SETTLE_S, 5.0)
        if held:
            late = board + held[0] + LIFT_S
            stage.holds(lambda: self._settled(stage, board + held[0]) or witness.last.t > late, PATIENCE_S)
        touched = [sample.contact for sample in witness.samples if sample.t >= board]
        if cell.phase in TOUCHING and not (touched and touched[0]):
            return Record(**base, note="the stylus did not touch the panel when the fault came")  # type: ignore[arg-type]
        seen = judge(list(witness.samples), board, rests_from)
        return Record(
            **base,  # type: ignore[arg-type]
            held_s=held[0] if held else float("nan"),
            lifted_s=seen.lifted_s,
            pressed_s=seen.pressed_s,
            unasked_mm=seen.unasked_mm,
            pace=seen.pace,
            answer=answer(),
            page="; ".join(page.since(begun_s))[:600],
        )

    @staticmethod
    def _settled(stage: Stage, held_t: float) -> bool:
        """Return whether the stylus is up, and the machine has been watched for a while after its hold."""
        last = stage.witness.last if stage.witness is not None else None
        return last is not None and last.extension <= UP_MM and last.t > held_t + 2 * SETTLE_S

    @staticmethod
    def _holds(stage: Stage, since: int) -> list[float]:
        board = stage.graph.board()
        with contextlib.closing(board):
            entries = board.log(since, "realtime")
        found: list[float] = []
        for entry in entries:
            if entry["byte"] == ord("~"):  # one report was in doubt, and the next one let the machine go on
                found.clear()
            elif entry["byte"] in (ord("!"), 0x18):
                found.append(float(entry["t"]))
        return found

    def close(self) -> None:
        """End the graph; the next run starts another one."""
        stage, self._stage = self._stage, None
        if stage is not None:
            with contextlib.suppress(BaseException):
                stage.close()
            self._ros.executor.remove_node(stage.operator.node)
            self._ros.nodes.remove(stage.operator.node)
            stage.operator.node.destroy_node()


@contextlib.contextmanager
def campaign(seed: int, folder: Path, extra: Sequence[str] = ()) -> Iterator[Campaign]:
    """Play runs in a ROS domain of their own."""
    os.environ["ROS_LOG_DIR"] = str(folder / "ros_log")
    with participant(DOMAIN) as ros:
        made = Campaign(seed, ros, folder, extra)
        try:
            yield made
        finally:
            made.close()


def chosen(options: argparse.Namespace) -> list[Cell]:
    """Return the cells that the options leave."""
    return [
        cell
        for cell in all_cells()
        if (not options.programs or cell.program in options.programs)
        and (not options.faults or cell.fault in options.faults)
        and (not options.phases or cell.phase in options.phases)
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the matrix."""
    parser = argparse.ArgumentParser(prog="matrix", description=__doc__)
    parser.add_argument("--runs", type=int, default=200, help="number of runs (%(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of cells and faults (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("artifacts/matrix"), help="folder of matrix.csv and table.md")
    parser.add_argument("--programs", nargs="*", help="only these programs")
    parser.add_argument("--faults", nargs="*", help="only these faults")
    parser.add_argument("--phases", nargs="*", help="only these phases")
    parser.add_argument("--real-time", action="store_true", help="run the simulated machine by the wall clock")
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    log, cells = options.out / "matrix.csv", drawn(options.runs, options.seed, chosen(options))
    records = read_records(log, options.seed)
    print(f"seed {options.seed}: {options.runs} runs, {len(records)} of them done before", flush=True)
    extra = ["--real-time"] if options.real_time else []
    with tempfile.TemporaryDirectory(prefix="matrix_") as folder, campaign(options.seed, Path(folder), extra) as made:
        for run, cell in enumerate(cells):
            if run in records and records[run].cell == cell:
                continue
            records[run] = made.play(run, cell)
            append_record(log, records[run])
            print(f"{run + 1} of {len(cells)}: {text_of(records[run])}", flush=True)
    found = [records[run] for run in sorted(records) if run < len(cells) and not records[run].note]
    (options.out / "table.md").write_text(f"{table(found)}\n", encoding="utf-8")
    print(f"\n{table(found)}\n")
    wrong = [record for record in found if record.wrong()]
    for record in wrong:
        print(f"run {record.run} ({record.cell}): {record.wrong()}")
    print(f"{len(found)} runs with seed {options.seed}: {len(wrong)} wrong, {len(cells) - len(found)} hindered")
    return 1 if wrong else 0


def text_of(record: Record) -> str:
    """Return a record as one line for people."""
    if record.note:
        return f"{record.cell}: hindered: {record.note}"
    times = f"held {record.held_s:.2f} s, lifted {record.lifted_s:.2f} s, pressed until {record.pressed_s:.2f} s"
    verdict = record.wrong() or ("goes on" if record.goes_on else "safe")
    return (
        f"{record.cell}: {verdict}; {times}; {record.answer or 'no goal'}; pace {record.pace:.2f}; {record.page[:160]}"
    )


if __name__ == "__main__":
    raise SystemExit(main())
