"""Measure the CPU time of each process of the graph: at rest, while pressing, and on a small computer.

No page is open. The small computer is the same one with a quota of processor time: two cores at half the clock rate.
The sums are compared with those of the graph before images were read on demand, on the same computer
(docs/decisions/speed.md).
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from cpu_quota import NoQuota, cpu_quota
from rows import Row, bound, row, write
from watched_graph import RunningGraph, Watcher, programs, usage, watched

CONTROL = "RUN_STOP"
BEFORE = {"at rest": 110.3, "pressing": 128.0}
"""Sums in % of one core before images were read on demand; the guard was part of the driver at that time."""
LIMITS = {"at rest": 73.0, "pressing": 85.0}
"""Limits in % of one core: two thirds of BEFORE, including gantry_guard."""
SIMULATOR = ("bench", "mock_grbl")
"""Programs that simulate cameras, panel and board; a real robot does not run them."""
SMALL_CORES = 1.0
"""Quota in cores: two cores at half the clock rate have the processor time of one."""
RATE_HZ = 15.0
_JITTER = 0.97
"""Minimum share of the rate in a count over some seconds without lost images."""
_SETTLED_S = 15.0
"""Seconds after the calibration in which the graph compares the panel's depth with stereo, and each second the cameras
with each other, so it is not at rest."""
_CAMERA, _TRACKER = "camera", "stylus_tracker"


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """CPU use of the graph during one interval.

    Attributes
    ----------
    percent
        Percent of one core, by program.
    pairs_hz
        Rates of published image pairs, and of pairs in which the stylus tracker searched the tip.
    """

    percent: dict[str, float]
    pairs_hz: float
    tracked_hz: float

    @property
    def sum(self) -> float:
        """Sum of all programs, % of one core."""
        return sum(self.percent.values())

    @property
    def robot(self) -> float:
        """Sum of the programs that a real robot runs, % of one core."""
        return sum(percent for name, percent in self.percent.items() if name not in SIMULATOR)


def load_during(pids: dict[str, int], watcher: Watcher, action: Callable[[], object]) -> Load:
    """Measure while ``action`` runs in a thread."""
    counts = _counts(watcher)
    before, start = _cpu_s(pids), time.monotonic()
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(action)
        while not done.done():
            watcher.spin(0.5)
    done.result()
    after, span = _cpu_s(pids), time.monotonic() - start
    more = _counts(watcher)
    percent = {name: 100.0 * (after[name] - before[name]) / span for name in pids}
    pairs, tracked = ((b[1] - a[1]) / (b[0] - a[0]) for a, b in zip(counts, more, strict=True))
    return Load(percent=percent, pairs_hz=pairs, tracked_hz=tracked)


def _cpu_s(pids: dict[str, int]) -> dict[str, float]:
    return {name: usage(pid).cpu_s for name, pid in pids.items()}


def _counts(watcher: Watcher) -> tuple[tuple[float, int], tuple[float, int]]:
    """Return the time, and the numbers of pairs published by the camera and searched by the tracker."""
    watcher.spin(30.0, lambda: {_CAMERA, _TRACKER} <= watcher.reports.keys())
    (camera_s, camera), (tracker_s, tracker) = watcher.reports[_CAMERA], watcher.reports[_TRACKER]
    return (camera_s, int(camera["pictures"])), (tracker_s, int(tracker["seen"]) + int(tracker["missed"]))


def measure(
    folder: Path, domain: int, seconds: float, presses: int, started: Callable[[int], None]
) -> tuple[dict[str, Load], float]:
    """Start the graph and measure it at rest and while pressing; return the loads and the share of presses reached."""
    found: dict[str, Load] = {}
    with watched(folder, domain, corners=False, started=started) as (graph, watcher):
        pids = programs(graph.process.pid)
        watcher.spin(_SETTLED_S)
        found["at rest"] = load_during(pids, watcher, lambda: time.sleep(seconds))
        reached: list[int] = []
        found["pressing"] = load_during(pids, watcher, lambda: reached.append(_press(graph, presses)))
    print(f"{reached[0]} of {presses} presses reached")
    return found, reached[0] / presses


def _press(graph: RunningGraph, presses: int) -> int:
    """Press a control repeatedly by one program, whose start also costs the graph time; return how many succeeded."""
    done = graph.command("gantry_driver", "gantry_sequence", *[f"press:{CONTROL}"] * presses)
    if done.returncode:
        print(done.stdout + done.stderr)
    return len(re.findall(r"^reached", done.stdout, re.MULTILINE))


def _table(loads: dict[str, Load]) -> None:
    print(f"{'% of one core':<24}" + "".join(f"{name:>12}" for name in loads))
    programs_by_cost = sorted(loads["at rest"].percent, key=lambda name: -loads["at rest"].percent[name])
    for program in programs_by_cost:
        print(f"{program:<24}" + "".join(f"{load.percent[program]:>12.1f}" for load in loads.values()))
    print(f"{'sum':<24}" + "".join(f"{load.sum:>12.1f}" for load in loads.values()))
    print(f"{'without the simulator':<24}" + "".join(f"{load.robot:>12.1f}" for load in loads.values()))
    print(f"{'image pairs/s':<24}" + "".join(f"{load.pairs_hz:>12.2f}" for load in loads.values()))


def _free_rows(loads: dict[str, Load]) -> list[Row]:
    rows = []
    for name, load in loads.items():
        rows.append(bound(f"graph {name}: CPU of all programs, % of one core", load.sum, LIMITS[name]))
        rows.append(row(f"graph {name}: the same, against before", load.sum, BEFORE[name], "images always taken"))
        rows.append(row(f"graph {name}: CPU without the simulator, % of one core", load.robot, None, ""))
        rows.append(row(f"graph {name}: CPU for a pair of images, ms", 10.0 * load.sum / load.pairs_hz, None, ""))
        rows += [
            row(f"graph {name}: {program}, % of one core", percent, None, "")
            for program, percent in sorted(load.percent.items(), key=lambda item: -item[1])
        ]
    return rows


def _small_rows(folder: Path, domain: int, seconds: float, presses: int) -> list[Row]:
    """Measure with the quota; if there is none, print the reason and return no rows."""
    rows = []
    try:
        with cpu_quota(SMALL_CORES) as quota:
            loads, reached = measure(folder, domain, seconds, presses, quota.take)
            share = quota.throttling().share
    except NoQuota as reason:
        print(f"the small computer is left out: {reason}")
        return []
    _table(loads)
    print(f"the quota held the graph back in {100 * share:.0f} % of all periods, its start included")
    for name, load in loads.items():
        what = f"small computer {name}: image pairs in which the tip was looked for, 1/s"
        rows.append(bound(what, load.tracked_hz, _JITTER * RATE_HZ, at_least=True))
        rows.append(row(f"small computer {name}: CPU of all programs, % of one core", load.sum, None, ""))
    rows.append(bound("small computer: part of the presses reached", reached, 1.0, at_least=True))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0, help="of rest")
    parser.add_argument("--presses", type=int, default=6)
    parser.add_argument("--state", type=Path, help="state folder of a calibrated bench, which saves a calibration")
    parser.add_argument("--small", choices=("with", "without", "only"), default="with", help="the small computer")
    parser.add_argument("--domain", type=int, default=100 + os.getpid() % 100, help="ROS_DOMAIN_ID of the graph")
    arguments = parser.parse_args()
    domain, rows = arguments.domain, []
    with tempfile.TemporaryDirectory(prefix="icu_cpu_") as temporary:
        state = arguments.state
        for part in ("free", "small"):
            if arguments.small == {"free": "only", "small": "without"}[part]:
                continue
            folder = Path(temporary) / part
            folder.mkdir()
            if state is not None:
                shutil.copytree(state, folder / "state")
            if part == "free":
                loads, reached = measure(folder, domain, arguments.seconds, arguments.presses, lambda pid: None)
                _table(loads)
                rows += _free_rows(loads)
                rows.append(bound("graph: part of the presses reached", reached, 1.0, at_least=True))
                state = folder / "state"
            else:
                rows += _small_rows(folder, domain, arguments.seconds, arguments.presses)
    write("cpu", rows, title="CPU of the whole graph")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
