"""Measure presses under each effect of the simulated bench, at its ordinary size and twice that, against the truth.

Each case has its own robot on a virtual clock: it homes, calibrates, recognises, and presses buttons in turn. A result
is false if it is `reached` and no key acted, or if the true error is more than three times the stated one.
Results: out/effects.csv and out/effects.md, a table with the sources of the sizes.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from effect_cases import NOMINAL, Case, cases
from rows import OUT

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from support.virtual_robot import VirtualRobot

from icu_common.core.goals.results import Outcome

LEAST_STATED_MM = 0.05
"""Lower bound of the stated error in the verdict; a touch need not be better than this."""
SIGMAS = 3.0
RAMP_S = 60.0
"""Duration of a drift's ramp, so that a few minutes of presses include all of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """Results of the presses of one case; errors in millimetres, means over the presses that were carried out."""

    effect: str
    size: str
    presses: int
    pressed: int
    refused: int
    false: int
    error_mm: float | None
    stated_mm: float | None
    note: str
    source: str


def press_all(case: Case, *, presses: int, seed: int, room: str) -> Count:
    """Return the results of one robot under one effect."""
    values = dict(case.values)
    if "imaging.warming.ramp_s" in values:
        values["imaging.warming.ramp_s"] = RAMP_S
    pressed = refused = false = done = 0
    errors: list[float] = []
    stated: list[float] = []
    notes: list[str] = []
    try:
        robot = VirtualRobot(seed, room=room, bench={} if case.later else values)
        robot.prepare()
        if case.later:
            robot.set(values)
        buttons = [c for c in robot.layout.controls if c.kind == "button"]
        rng = np.random.default_rng(46 + seed)
        order = [buttons[int(i)] for i in rng.permutation(len(buttons))]
        for number in range(presses):
            control = order[number % len(order)]
            robot.look_at_panel()
            robot.run_for(0.5)
            robot.take_records()
            result = robot.command(f"press:{control.name}")
            done += 1
            records = robot.take_records()
            acted = any(r["event"] == "press" and r["control"] == control.name for r in records)
            touched = [r["tip_panel_mm"] for r in records if r["event"] == "contact"]
            error = float(np.hypot(*np.subtract(touched[0][:2], control.position_mm))) if touched else None
            if error is not None:
                errors.append(error)
            if result.outcome is not Outcome.REACHED:
                refused += 1
                notes.append(result.reason)
                continue
            said = 1000 * result.error_m
            stated.append(said)
            pressed += acted
            wrong = error is not None and error > SIGMAS * max(said, LEAST_STATED_MM)
            false += not acted or wrong
    except (TimeoutError, RuntimeError, AssertionError) as error:  # no calibration or no result
        notes.append(f"{type(error).__name__}: {error}")
        refused += presses - done
    note = max(set(notes), key=notes.count) if notes else ""
    return Count(
        effect=case.effect,
        size=case.size,
        presses=presses,
        pressed=pressed,
        refused=refused,
        false=false,
        error_mm=round(float(np.mean(errors)), 3) if errors else None,
        stated_mm=round(float(np.mean(stated)), 3) if stated else None,
        note=note,
        source=case.source,
    )


def table(counts: Sequence[Count], *, room: str, presses: int, seed: int) -> str:
    """Return the results as a Markdown table."""
    lines = [
        f"Room `{room}`, seed {seed}, {presses} presses for each case. Errors are means in millimetres.",
        "",
        "| effect | size | pressed | refused | false | error | stated | most frequent refusal | source of the size |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for c in counts:
        cells: list[Any] = [f"`{c.effect}`", c.size, c.pressed, c.refused, c.false]
        cells += ["" if value is None else f"{value:.3f}" for value in (c.error_mm, c.stated_mm)]
        cells += [c.note.replace("|", "/"), c.source.replace("|", "/") if c.size == NOMINAL else ""]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def write(counts: Sequence[Count], *, room: str, presses: int, seed: int) -> None:
    """Write the CSV file and the table."""
    OUT.mkdir(exist_ok=True)
    with (OUT / "effects.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(asdict(counts[0])))
        writer.writeheader()
        writer.writerows(asdict(c) for c in counts)
    (OUT / "effects.md").write_text(table(counts, room=room, presses=presses, seed=seed), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=10, help="of each case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--room", default="ideal", help="room in config/rooms to which each effect is added")
    parser.add_argument("--effect", action="append", default=[], help="only effects with this in their name")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(arguments)
    chosen = [c for c in cases() if not options.effect or any(part in c.effect for part in options.effect)]
    if not chosen:
        parser.error(f"no effect has {', '.join(options.effect)} in its name")
    counts: dict[tuple[str, str], Count] = {}
    begin_s = time.monotonic()
    given = {"presses": options.presses, "seed": options.seed, "room": options.room}
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        waiting = {pool.submit(press_all, case, **given): case for case in chosen}
        for number, future in enumerate(as_completed(waiting), 1):
            c = future.result()
            counts[c.effect, c.size] = c
            spent_s = time.monotonic() - begin_s
            left_s = spent_s / number * (len(chosen) - number)
            print(
                f"[{number}/{len(chosen)}, {left_s / 60:.0f} min left] {c.effect} {c.size}: pressed {c.pressed}, "
                f"refused {c.refused}, false {c.false}, error {c.error_mm} mm, stated {c.stated_mm} mm {c.note}",
                flush=True,
            )
            # After each case, so that an interrupted run keeps its results.
            write([counts[k] for k in ((w.effect, w.size) for w in chosen) if k in counts], **given)
    ordered = [counts[c.effect, c.size] for c in chosen]
    print(f"{OUT / 'effects.csv'}, {OUT / 'effects.md'}: {sum(c.false for c in ordered)} false answers")
    return 0


if __name__ == "__main__":
    sys.exit(main())
