"""Measure the guard's reaction to each fault in each phase: seconds to hold and to lift, by the board's own record.

The driver's node and its guard run in separate processes, under bring-up if both are killed; the board is ``mock_grbl``
in real time. After each fault the board's log gives the first hold (or reset, while homing), and the
motors' position shows when the stylus is up. ``--write`` writes the table to docs/explanation/guard.md. The last row is
the time from a query to the guard to its answer over the socket.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gantry_driver.adapters.guard.client import GuardLink
from gantry_driver.core.configuration.machine_config import DriverConfig
from icu_common.adapters.direct_stop.line import guard_folder, send_stop, stop_path

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from nodes.guard_rig import DOWN_M, HOMED, BringUpRig, GuardRig
from rows import bound, write
from support.ros_rig import Ros, participant

PAGE = Path(__file__).resolve().parents[2] / "docs/explanation/guard.md"
BEGIN, END = "<!-- matrix: begin -->\n", "<!-- matrix: end -->"
DOMAIN = 88
HOLD_S, LIFT_S, KILLED_HOLD_S, KILLED_LIFT_S = 0.1, 1.5, 0.5, 2.0
"""Limits: seconds to hold and to lift after a fault of the node, and after the guard was killed."""
QUESTIONS = 3000


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Result of one run: seconds to hold and to lift; None if neither was necessary."""

    held_s: float | None
    lifted_s: float | None
    deeper_mm: float


def slow_descent(rig: GuardRig) -> None:
    rig.op.go((0.05, 0.05, 0.0), (0.05, 0.05, 2 * DOWN_M))
    rig.op.until(lambda: rig.z_mm() < HOMED[2] - 500.0 * DOWN_M)


def travel(rig: GuardRig) -> None:
    rig.op.go((0.05, 0.05, 0.0), (0.3, 0.05, 0.0), last_m_s=0.05)
    rig.op.until(lambda: rig.board.mpos()[0] > HOMED[0] + 60.0)


def homing(rig: GuardRig) -> None:
    rig.op.go((0.2, 0.1, 0.0))
    rig.op.until(lambda: rig.op.results and rig.op.results[-1].outcome.value == "reached")
    assert rig.op.call("home").success
    rig.op.until(lambda: rig.board.ask("state")["state"] == "Home")


def rest(rig: GuardRig) -> None:
    """Bring the machine to rest with the stylus up."""


PHASES: dict[str, Callable[[GuardRig], None]] = {
    "rest": rest,
    "travel": travel,
    "descent": slow_descent,
    "contact": GuardRig.press,
    "drag": GuardRig.drag,
    "homing": homing,
}


def signalled(number: signal.Signals, seconds: float = 0.0) -> Callable[[GuardRig], None]:
    def act(rig: GuardRig) -> None:
        rig.node.send_signal(number)
        if seconds:
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                rig.ros.executor.spin_once(timeout_sec=0.01)
            rig.node.send_signal(signal.SIGCONT)

    return act


def kill_guard(rig: GuardRig) -> None:
    os.kill(rig.guards()[0], signal.SIGKILL)


def stop_guard(rig: GuardRig) -> None:
    os.kill(rig.guards()[0], signal.SIGSTOP)


def kill_both(rig: GuardRig) -> None:
    """Kill the node and the guard; bring-up starts both again."""
    assert isinstance(rig, BringUpRig)
    rig.kill_node()
    kill_guard(rig)


def direct_stop(rig: GuardRig) -> None:
    assert send_stop(stop_path(DOMAIN, "/stop_request"), "stop requested")


BOTH = "both SIGKILL"
CAUSES: dict[str, Callable[[GuardRig], None]] = {
    "node SIGKILL": signalled(signal.SIGKILL),
    "node SIGSTOP": signalled(signal.SIGSTOP),
    "node SIGSTOP for 1 s": signalled(signal.SIGSTOP, 1.0),
    "guard SIGKILL": kill_guard,
    "guard SIGSTOP": stop_guard,
    BOTH: kill_both,
    "direct STOP": direct_stop,
}


@contextlib.contextmanager
def busy(ros: Ros, count: int) -> Iterator[None]:
    """Run busy processes, which start one second before the measurement."""
    code = "while True: pass"
    running = [subprocess.Popen([sys.executable, "-S", "-c", code]) for _ in range(count)]
    try:
        end = time.monotonic() + (1.0 if count else 0.0)
        while time.monotonic() < end:
            ros.executor.spin_once(timeout_sec=0.01)
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def once(ros: Ros, cause: str, phase: str, load: int) -> Seen:
    """Return the result of one fault in one phase, on a new board that restarts at the edge of DTR."""
    with tempfile.TemporaryDirectory() as folder:
        kind = BringUpRig if cause == BOTH else GuardRig
        rig = kind(ros, Path(folder), stylus_file=f"{folder}/stylus")
        try:
            rig.op.ready()
            PHASES[phase](rig)
            with busy(ros, load):
                since, z, begun_s = rig.entry(), rig.z_mm(), rig.now_s()
                CAUSES[cause](rig)
                down = z < HOMED[2] - 0.05
                lifted_s = rig.until_lifted(30.0) - begun_s if down else None
            end = time.monotonic() + (0.0 if down else 3.0)
            deepest = z
            while time.monotonic() < end:
                ros.executor.spin_once(timeout_sec=0.01)
                deepest = min(deepest, rig.z_mm())
            holds = [
                float(e["t"]) - begun_s
                for e in rig.board.log(since)
                if e["kind"] == "realtime" and e["byte"] in (ord("!"), 0x18)
            ]
            return Seen(held_s=min(holds, default=None), lifted_s=lifted_s, deeper_mm=z - deepest)
        finally:
            rig.close()
            for node in (rig.op.node,):
                ros.executor.remove_node(node)
                node.destroy_node()
                ros.nodes.remove(node)


def questions() -> np.ndarray:
    """Return the seconds from a query to its answer over the guard's socket, (n,)."""
    link = GuardLink(
        DriverConfig(port=f"/dev/none{os.getpid()}"), lambda events: None, stop_path=guard_folder() / "bench"
    )
    link.start()
    try:
        end = time.monotonic() + 10.0
        while link.ask("home").endswith("not opened yet"):
            if time.monotonic() > end:
                raise RuntimeError("the guard has not started")
            time.sleep(0.01)
        times = []
        for _ in range(QUESTIONS):
            begin = time.perf_counter()
            link.ask("home")
            times.append(time.perf_counter() - begin)
            time.sleep(0.001)
        return np.array(times)
    finally:
        link.close("the benchmark has ended")


def cell(seen: list[Seen]) -> str:
    holds = [s.held_s for s in seen if s.held_s is not None]
    lifts = [s.lifted_s for s in seen if s.lifted_s is not None]
    if not holds:
        return "goes on" if lifts == [] else "-"
    return f"{max(holds):.2f} / {max(lifts):.2f}" if lifts else f"{max(holds):.2f} / -"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=2, help="runs of each pair of fault and phase")
    parser.add_argument("--seed", type=int, default=1, help="seed of the order of the runs")
    parser.add_argument("--causes", nargs="*", default=list(CAUSES), help="faults to run")
    parser.add_argument("--phases", nargs="*", default=list(PHASES), help="phases to run")
    parser.add_argument("--busy", type=int, default=0, help="busy processes beside each fault")
    parser.add_argument("--write", action="store_true", help="put the table into docs/explanation/guard.md")
    options = parser.parse_args()
    pairs = [(c, p) for c in options.causes for p in options.phases for _ in range(options.repeats)]
    random.Random(options.seed).shuffle(pairs)
    seen: dict[tuple[str, str], list[Seen]] = {}
    with participant(DOMAIN) as ros:
        for cause, phase in pairs:
            seen.setdefault((cause, phase), []).append(once(ros, cause, phase, options.busy))
            print(f"{cause}, {phase}: {seen[cause, phase][-1]}", flush=True)
    head = [f"| fault | {' | '.join(options.phases)} |", "|---" * (len(options.phases) + 1) + "|"]
    lines = [f"| {c} | {' | '.join(cell(seen[c, p]) for p in options.phases)} |" for c in options.causes]
    asked = questions()
    low, high = np.quantile(asked, (0.5, 0.99))
    load = os.getloadavg()[0]
    text = "\n".join([*head, *lines]) + (
        f"\n\nRuns of each pair: {options.repeats}; {os.cpu_count()} cores, load {load:.1f}. A question to the guard "
        f"and its answer over the socket: median {1000 * low:.2f} ms, slowest hundredth {1000 * high:.2f} ms.\n"
    )
    print(text)
    if options.write:
        before, _, rest_of = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}{text}{END}{rest_of.partition(END)[2]}", encoding="utf-8")
    of_node = [s for (c, p), found in seen.items() if c.startswith(("node", "direct")) for s in found]
    moving = [(c, p) for c, p in seen if c in ("guard SIGKILL", BOTH) and p not in ("rest", "homing")]
    of_guard = [s for pair in moving for s in seen[pair]]
    rows = [
        bound(
            "guard: seconds to hold after a fault of the node",
            max((s.held_s or 0.0 for s in of_node), default=0.0),
            HOLD_S,
        ),
        bound(
            "guard: seconds to lift after a fault of the node",
            max((s.lifted_s or 0.0 for s in of_node), default=0.0),
            LIFT_S,
        ),
        bound(
            "guard: seconds to hold after a kill of the guard",
            max((s.held_s or 0.0 for s in of_guard), default=0.0),
            KILLED_HOLD_S,
        ),
        bound(
            "guard: seconds to lift after a kill of the guard",
            max((s.lifted_s or 0.0 for s in of_guard), default=0.0),
            KILLED_LIFT_S,
        ),
        bound("guard: question and answer, slowest hundredth [s]", float(high), 0.001),
    ]
    return 0 if write("guard", rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
