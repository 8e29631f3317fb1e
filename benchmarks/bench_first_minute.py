"""Measure the first minute next to busy programs: start, calibration, and a press on the page that changes the lamp.

Each run is a new machine with an empty state folder, its own ROS domain and page. The browser adds to the load.
``--runs 20 --busy 0 2 4 8`` is the whole measurement, ``--plot FILE`` draws it.

    .venv/bin/python benchmarks/bench_first_minute.py --busy 0 4 --runs 3
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from rows import OUT, Row, bound, write

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from system.operator_browser import OPTIONS, Operator, browser_program  # noqa: E402

BRING_UP = ROOT / "ros2_ws" / "install" / "icu_bringup" / "lib" / "icu_bringup" / "bring_up"
KEPT = OUT / "first_minute_runs.csv"
"""File of all runs, written after each run, because the whole measurement takes hours."""
READY_S = 900.0
READY_GOAL_S = 45.0
"""Goal in seconds for a new machine on two idle cores."""
END_S = 3.0
"""Limit in seconds from Ctrl-C to the end of every program."""
FIRST_DOMAIN = 150


@dataclass(slots=True)
class Run:
    """Result of one run; times in wall seconds since the start of bring-up."""

    busy: int
    up_s: float = float("nan")
    ready_s: float = float("nan")
    pressed_s: float = float("nan")
    """Duration of the press, from the confirming click to the row "done"."""
    ended_s: float = float("nan")
    factor: float = float("nan")
    """Simulation factor shown on the page before the press."""
    error_mm: float = float("nan")
    why: str = ""
    lines: list[str] = field(default_factory=list)


@contextlib.contextmanager
def busy_programs(count: int) -> Iterator[None]:
    """Keep ``count`` processes busy."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def first_minute(browser: Any, busy: int, number: int, extra: list[str]) -> Run:
    """Start the demo for a new machine, press RUN/STOP on its page, and end it."""
    run = Run(busy=busy)
    with tempfile.TemporaryDirectory() as home, busy_programs(busy):
        environment = {**os.environ, "HOME": home, "ROS_DOMAIN_ID": str(FIRST_DOMAIN + number % 60)}
        environment.pop("XDG_STATE_HOME", None)
        command = [str(BRING_UP), "--profile", "bench", "--prepare", "--state", f"{home}/state"]
        command += ["--set", f"ui_bridge.port={free_port()}", *extra]
        begin_s = time.monotonic()
        graph = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, bufsize=1
        )
        ready, address = threading.Event(), ""

        def read() -> None:
            nonlocal address
            assert graph.stdout is not None
            for line in graph.stdout:
                run.lines.append(f"{time.monotonic() - begin_s:7.1f} {line.rstrip()}")
                if found := re.search(r"https?://\S+\?token=\S+", line):
                    address = found[0]
                if line.startswith("started "):
                    run.up_s = time.monotonic() - begin_s
                if "Ready" in line:
                    run.ready_s = time.monotonic() - begin_s
                    ready.set()
            ready.set()

        reader = threading.Thread(target=read, daemon=True)
        reader.start()
        try:
            ready.wait(READY_S)
            if np.isnan(run.ready_s):
                run.why = "not ready"
            else:
                press(browser, address, run)
        except (AssertionError, Exception) as error:
            run.why = f"{type(error).__name__}: {error}"
        finally:  # also on Ctrl-C
            begin_s = time.monotonic()
            graph.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                graph.wait(60.0)
            run.ended_s = time.monotonic() - begin_s
            graph.kill()
            reader.join(5.0)
            if run.ended_s > END_S or run.why:
                shutil.copytree(f"{home}/state/logs", OUT / f"first_minute_{number}", dirs_exist_ok=True)
    return run


def press(browser: Any, address: str, run: Run) -> None:
    """Press RUN/STOP as a person does, and wait until the lamp changes."""
    person = Operator(browser, address)
    try:
        person.takes_control()
        person.sees("#chip-controller", "Ready", within_s=60.0)
        before = person.lit()
        slow = re.search(r"at ([\d.]+)", person.page.inner_text("#chip-simulation"))
        run.factor = float(slow[1]) if slow else 1.0
        person.selects("RUN_STOP", "Run")
        person.confirms()
        begin_s = time.monotonic()
        row = person.logs("Press Run.*(done|aborted|refused|no answer)", 300.0)
        run.pressed_s = time.monotonic() - begin_s
        if "done" not in row:
            run.why = row
            return
        run.error_mm = float(re.findall(r"([\d.]+) mm", row)[-1])
        person.until(lambda: person.lit() is not before, 60.0, lambda: "the lamp in the live picture does not change")
    finally:
        person.leaves()


def plot(runs: list[Run], path: Path) -> None:
    """Plot time to ready and simulation factor over the number of busy programs."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(8, 3), layout="constrained")
    for axis, name, label in zip(axes, ("ready_s", "factor"), ("time to ready, s", "simulation factor")):
        busy = np.array([run.busy for run in runs])
        axis.plot(busy, [getattr(run, name) for run in runs], "o", alpha=0.4)
        steps = sorted(set(busy.tolist()))
        medians = [np.nanmedian([getattr(run, name) for run in runs if run.busy == step]) for step in steps]
        axis.plot(steps, medians, "-k")
        axis.set(xlabel="busy programs beside it, on two cores", ylabel=label, ylim=(0, None))
    figure.savefig(path)


def read_runs(path: Path) -> list[Run]:
    """Read the runs that :func:`write_runs` has written."""
    kinds = {f.name: f.type for f in fields(Run)}
    convert: dict[Any, Callable[[str], Any]] = {"int": int, "float": float, "str": str}
    with path.open(newline="") as file:
        return [Run(**{name: convert[kinds[name]](text) for name, text in row.items()}) for row in csv.DictReader(file)]


def write_runs(runs: list[Run], path: Path) -> None:
    """Write one row a run, without the output of its programs."""
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, [f.name for f in fields(Run) if f.name != "lines"], extrasaction="ignore")
        table.writeheader()
        table.writerows(asdict(run) for run in runs)


def rows_of(runs: list[Run]) -> list[Row]:
    """Return the rows of the claims."""
    found = []
    for busy in sorted({run.busy for run in runs}):
        mine = [run for run in runs if run.busy == busy]
        good = [run for run in mine if not run.why]
        found.append(bound(f"{busy} busy programs: runs that ended in a press", len(good), len(mine), at_least=True))
        if good:
            ready_s = float(np.median([run.ready_s for run in good]))
            if busy == 0:
                found.append(bound("time to ready of a new machine, s (median)", ready_s, READY_GOAL_S))
            else:
                found.append(bound(f"{busy} busy programs: time to ready, s (median)", ready_s, READY_S))
            ended_s = max(run.ended_s for run in good)
            limit_s = END_S if busy == 0 else 60.0
            found.append(bound(f"{busy} busy programs: time from Ctrl-C to the end, s (longest)", ended_s, limit_s))
    return found


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--busy", type=int, nargs="+", default=[0, 4], help="busy programs (default: 0 4)")
    parser.add_argument("--runs", type=int, default=1, help="runs for each number of them (default: 1)")
    parser.add_argument(
        "--add", action="store_true", help="add to the runs of an earlier measurement in benchmarks/out"
    )
    parser.add_argument("--plot", type=Path, help="SVG file for the plot")
    parser.add_argument("bring_up", nargs="*", help="further arguments for bring_up, after --")
    given = parser.parse_args()
    program = browser_program()
    if program is None:
        print("skipped: no browser (apt install chromium-headless-shell)")
        return 0
    from playwright.sync_api import sync_playwright

    runs: list[Run] = []
    if given.add and KEPT.is_file():
        runs = read_runs(KEPT)
    OUT.mkdir(exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=OPTIONS)
        for number in range(given.runs):
            for busy in given.busy:
                run = first_minute(browser, busy, len(runs), given.bring_up)
                runs.append(run)
                print(
                    f"{busy} busy, run {number + 1}: up {run.up_s:.1f} s, ready {run.ready_s:.1f} s, "
                    f"press {run.pressed_s:.1f} s, "
                    f"factor {run.factor:g}, error {run.error_mm:g} mm, end {run.ended_s:.1f} s {run.why}",
                    flush=True,
                )
                if run.why:
                    print("\n".join(run.lines[-30:]), flush=True)
                write_runs(runs, KEPT)
        browser.close()
    if given.plot:
        plot(runs, given.plot)
    return 0 if write("first_minute", rows_of(runs), title="The first minute beside busy programs") else 1


if __name__ == "__main__":
    raise SystemExit(main())
