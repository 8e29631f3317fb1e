"""Run the whole graph at full rate for a long time, with a press now and then: no resource use may grow.

Every ten seconds it records each process's memory, open files and threads, and the age of corners on arrival. The first
fifth of the time is warm-up. The medians of the last fifth are compared with those of the fifth after warm-up. Each
process may use at most LIMITS more, and the corners' age may rise by half. The output is a table (CSV), a plot and a
verdict. With ``--simulated`` the graph runs by simulated time, so a busy computer only makes it slow; the age is then
no claim.
"""

from __future__ import annotations

import argparse
import csv
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))
from rows import OUT, bound, write
from watched_graph import median, press, programs, usage, watched

EVERY_S = 10.0
PRESS_EVERY_S = 30.0
CONTROLS = ("RUN_STOP", "AUTO_SET", "MENU")
LIMITS = {"memory_mb": 12.0, "files": 2.0, "threads": 1.0}
AGE_RATIO = 1.5
WARM_UP = 0.2


class Log:
    """Recorded values: one row for each process and time, and one for the corners and the press of each time."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float | str]] = []
        self.failures: list[str] = []

    def series(self, program: str, what: str) -> tuple[np.ndarray, np.ndarray]:
        """Return times (s) and values of one program."""
        found = [(r["t_s"], r[what]) for r in self.rows if r["program"] == program and what in r]
        return np.array([t for t, _ in found], float), np.array([v for _, v in found], float)

    def programs(self) -> list[str]:
        """Return the programs that have rows, without that of the corners."""
        return sorted({str(r["program"]) for r in self.rows} - {"corners' age", "press"})


def soak(folder: Path, minutes: float, log: Log, *, simulated: bool) -> None:
    """Run the graph and fill the log."""
    with watched(folder, 100 + os.getpid() % 100, real_time=not simulated) as (graph, watcher):
        pids = programs(graph.process.pid)
        start = time.monotonic()
        next_press, pressed = PRESS_EVERY_S, 0
        while (now := time.monotonic() - start) < 60.0 * minutes:
            if programs(graph.process.pid) != pids:
                log.failures.append(f"at {now:.0f} s a program was not the same any more: see bring_up's log")
                break
            for name, pid in pids.items():
                use = usage(pid)
                log.rows.append(
                    {"t_s": now, "program": name, "cpu_s": use.cpu_s, "memory_mb": use.memory_mb}
                    | {"files": use.files, "threads": use.threads}
                )
            if watcher.ages_ms and not simulated:
                p50, p99 = np.percentile(watcher.ages_ms, (50, 99))
                rate = len(watcher.ages_ms) / EVERY_S
                log.rows.append({"t_s": now, "program": "corners' age", "p50_ms": p50, "p99_ms": p99, "rate_hz": rate})
            watcher.ages_ms.clear()
            watcher.spin(EVERY_S)
            if now >= next_press:
                try:
                    touch = press(graph, CONTROLS[pressed % len(CONTROLS)])
                    log.rows.append({"t_s": now, "program": "press", **touch})
                except RuntimeError as error:
                    log.failures.append(f"at {now:.0f} s {error}")
                watcher.ages_ms.clear()
                pressed, next_press = pressed + 1, now + PRESS_EVERY_S
            print(f"\r{now / 60:5.1f} of {minutes:g} min, {pressed} presses, {len(log.failures)} failed ", end="")
            sys.stdout.flush()
        print()


def growth(log: Log, program: str, what: str, minutes: float) -> float:
    """Return the median of the last fifth minus that of the fifth after warm-up."""
    times, values = log.series(program, what)
    part = 60.0 * minutes * WARM_UP
    first, last = values[(times >= part) & (times < 2 * part)], values[times >= 60.0 * minutes - part]
    return median(list(last)) - median(list(first))


def draw(log: Log, path: Path) -> None:
    """Plot the recorded values over time."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(4, 1, figsize=(10, 12), sharex=True)
    kinds = (("memory_mb", "memory (PSS), MB"), ("files", "open files"), ("threads", "threads"))
    for axis, (what, label) in zip(axes, kinds, strict=False):
        for program in log.programs():
            times, values = log.series(program, what)
            axis.plot(times / 60, values, label=program, linewidth=1)
        axis.set_ylabel(label)
    axes[0].legend(fontsize=6, ncol=4, loc="upper center")
    for what in ("p50_ms", "p99_ms"):
        times, values = log.series("corners' age", what)
        axes[3].plot(times / 60, values, label=what.replace("_ms", ""), linewidth=1)
    times, values = log.series("press", "duration_s")
    axes[3].plot(times / 60, 100 * values, ".", label="press, 10 ms", markersize=3)
    axes[3].set(ylabel="corners' age, ms", xlabel="time, min")
    axes[3].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--simulated", action="store_true", help="run by simulated time, without the age of corners")
    arguments = parser.parse_args()
    log = Log()
    folder = Path(tempfile.mkdtemp(prefix="icu_soak_"))
    try:
        soak(folder, arguments.minutes, log, simulated=arguments.simulated)
    finally:
        OUT.mkdir(exist_ok=True)
        fields = sorted({key for r in log.rows for key in r})
        with (OUT / "soak.csv").open("w", newline="") as stream:
            table = csv.DictWriter(stream, fields)
            table.writeheader()
            table.writerows(log.rows)
    rows = [
        bound(f"{program}: growth of {what}", growth(log, program, what, arguments.minutes), limit)
        for program in log.programs()
        for what, limit in LIMITS.items()
    ]
    times, ages = log.series("corners' age", "p50_ms")
    part = 60.0 * arguments.minutes * WARM_UP
    if not arguments.simulated:
        first = median(list(ages[(times >= part) & (times < 2 * part)]))
        last = median(list(ages[times >= 60.0 * arguments.minutes - part]))
        rows.append(bound("corners' age p50, last fifth against the first that counts", last / first, AGE_RATIO))
    _, errors = log.series("press", "error_mm")
    rows.append(bound("presses that failed", len(log.failures), 0))
    rows.append(bound("presses' error, largest, mm", float(errors.max()) if len(errors) else float("nan"), 1.0))
    good = write("soak", rows, title=f"{arguments.minutes:g} minutes of the whole graph")
    draw(log, OUT / "soak.png")
    for failure in log.failures:
        print(failure)
    print(f"table and picture: {OUT / 'soak.csv'}, {OUT / 'soak.png'}")
    if good:
        shutil.rmtree(folder)
    else:
        print(f"the graph's own logs: {folder}")
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
