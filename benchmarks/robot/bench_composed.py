"""Compare all nodes in one process (bring_up --composed) with one process each: CPU, memory, delay, time of a press.

Both run the same graph on the simulated bench, alternately, from one stored calibration.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))
from rows import Row, row, write
from watched_graph import median, press, programs, usage, watched

CONTROLS = ("RUN_STOP", "AUTO_SET")
SIMULATED = ("bench", "mock_grbl")


def measure(folder: Path, domain: int, seconds: float, presses: int, *extra: str) -> dict[str, float]:
    """Measure one start of the graph, without the simulated device's own use."""
    with watched(folder, domain, *extra) as (graph, watcher):
        ours = [pid for name, pid in programs(graph.process.pid).items() if name not in SIMULATED]
        watcher.spin(30.0, lambda: len(watcher.ages_ms) > 30)
        watcher.ages_ms.clear()
        before, start = [usage(pid) for pid in ours], time.monotonic()
        watcher.spin(seconds)
        span = time.monotonic() - start
        after = [usage(pid) for pid in ours]
        touches = [press(graph, CONTROLS[i % len(CONTROLS)]) for i in range(presses)]
    return {
        "cpu": 100.0 * sum(b.cpu_s - a.cpu_s for a, b in zip(before, after, strict=True)) / span,
        "memory": sum(u.memory_mb for u in after),
        "threads": float(sum(u.threads for u in after)),
        "rate": len(watcher.ages_ms) / span,
        "p50": float(np.percentile(watcher.ages_ms, 50)),
        "p99": float(np.percentile(watcher.ages_ms, 99)),
        "press": median([t["duration_s"] for t in touches]),
        "error": median([t["error_mm"] for t in touches]),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0, help="of watching the graph at rest, each turn")
    parser.add_argument("--presses", type=int, default=6)
    parser.add_argument("--turns", type=int, default=2)
    arguments = parser.parse_args()
    domain = 100 + os.getpid() % 100
    found: dict[str, list[dict[str, float]]] = {"composed": [], "processes": []}
    with tempfile.TemporaryDirectory(prefix="icu_composed_") as temporary:
        stored: Path | None = None
        for turn in range(arguments.turns):
            for way, extra in (("processes", ()), ("composed", ("--composed",))):
                print(f"turn {turn + 1} of {arguments.turns}, {way} ...", flush=True)
                folder = Path(temporary) / f"{way}_{turn}"
                if stored:
                    shutil.copytree(stored, folder / "state")
                else:
                    folder.mkdir()
                found[way].append(measure(folder, domain, arguments.seconds, arguments.presses, *extra))
                stored = stored or folder / "state"
    ours, peer = ({k: median([m[k] for m in found[way]]) for k in found[way][0]} for way in ("composed", "processes"))
    name = "one process each"
    rows: list[Row] = [
        row("graph at rest: CPU of all nodes, % of one core", ours["cpu"], peer["cpu"], name),
        row("graph at rest: memory (PSS), MB", ours["memory"], peer["memory"], name),
        row("graph at rest: threads", ours["threads"], peer["threads"], name),
        row("pictures of one camera a second with corners", ours["rate"], peer["rate"], name, higher_is_better=True),
        row("camera's stamp to corners in another process, p50, ms", ours["p50"], peer["p50"], name),
        row("camera's stamp to corners in another process, p99, ms", ours["p99"], peer["p99"], name),
        row("a press, median, s", ours["press"], peer["press"], name),
        row("a press's error, median, mm", ours["error"], peer["error"], name),
    ]
    write("composed", rows, title="all nodes in one process (ours) against one process each (peer)")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
