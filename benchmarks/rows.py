"""Rows of all benchmarks: ours against a peer, printed as a table and written to out/<name>.json.

Functions are timed interleaved, so that other load on the machine affects all of them alike.
"""

from __future__ import annotations

import gc
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

OUT = Path(__file__).parent / "out"


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One claim: ours is better by the factor ``ratio``; ``goal`` is the required factor."""

    what: str
    ours: float
    peer: float | None
    peer_name: str
    ratio: float | None
    goal: float | None
    met: bool | None


def row(
    what: str,
    ours: float,
    peer: float | None,
    peer_name: str,
    goal: float | None = None,
    *,
    higher_is_better: bool = False,
) -> Row:
    """Return a row; lower is better for times and errors. Without a peer (None) there is no ratio and no verdict."""
    ratio = None
    if peer is not None:
        better, worse = (ours, peer) if higher_is_better else (peer, ours)
        ratio = better / worse if worse else float("inf")
    met = None if goal is None or ratio is None else bool(ratio >= goal)
    return Row(what=what, ours=ours, peer=peer, peer_name=peer_name, ratio=ratio, goal=goal, met=met)


def bound(what: str, value: float, limit: float, *, at_least: bool = False) -> Row:
    """Return a row for a value with a limit and no peer."""
    met = value >= limit if at_least else value <= limit
    return Row(what=what, ours=value, peer=None, peer_name="", ratio=None, goal=limit, met=bool(met))


def write(name: str, rows: Iterable[Row], *, title: str = "") -> bool:
    """Print a table, write ``out/<name>.json``, and return whether every row with a goal has met it."""
    rows = list(rows)
    print(f"\n{title or name}")
    print(f"{'what':<66} {'ours':>10} {'peer':>10} {'ratio':>7} {'goal':>7}  met  peer is")
    for r in rows:
        cells = [_number(r.ours, 10), _number(r.peer, 10), _number(r.ratio, 7), _number(r.goal, 7)]
        verdict = {True: "yes", False: "NO", None: ""}[r.met]
        print(f"{r.what:<66} {' '.join(cells)}  {verdict:<3}  {r.peer_name}")
    OUT.mkdir(exist_ok=True)
    (OUT / f"{name}.json").write_text(json.dumps([asdict(r) for r in rows], indent=1) + "\n")
    return all(r.met is not False for r in rows)


def _number(value: float | None, width: int) -> str:
    return f"{'':>{width}}" if value is None else f"{value:>{width}.4g}"


def interleaved_ms(
    functions: Mapping[str, Callable[[], Any]], *, repeats: int = 40, warm: int = 2, slow: Sequence[str] = ()
) -> dict[str, float]:
    """Return each function's time in ms: the fastest tenth of its turns, which other load affects least.

    The functions take turns; those in ``slow`` have a tenth of the turns.
    """
    times: dict[str, list[float]] = {name: [] for name in functions}
    for function in functions.values():
        for _ in range(warm):
            function()
    gc.disable()
    try:
        for turn in range(repeats):
            for name, function in functions.items():
                if name in slow and turn % 10:
                    continue
                start = time.perf_counter()
                function()
                times[name].append(1e3 * (time.perf_counter() - start))
    finally:
        gc.enable()
    return {name: sorted(values)[len(values) // 10] for name, values in times.items()}


def data_folder() -> Path | None:
    """Return the folder of images with known truth from the environment, if it is set."""
    name = os.environ.get("ICU_TEST_DATA", "")
    return Path(name) if name and Path(name).is_dir() else None
