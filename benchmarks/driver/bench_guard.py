"""Measure the guard's reaction to each fault in each phase: seconds to hold and to lift, by the board's own record.

The driver's node and its guard run in separate processes, under bring-up if both are killed; the board is ``mock_grbl``
in real time. After each fault the board's log gives the first hold (or reset, while homing), and the
motors' position shows when the stylus is up. ``--write`` writes the table to docs/explanation/guard.md. The last rows
are the delays of the guard's sockets: a question and its answer, and a stop until its byte is on the port.
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
from typing import Any

import numpy as np

from icu_common.adapters.direct_stop.line import send_stop, stop_path

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from driver.guard_latency import questions, stops
from nodes.guard_client import Client
from nodes.guard_rig import DOWN_M, HOMED, BringUpRig, GuardRig
from rows import Row, bound, write
from support.ros_rig import Ros, participant

PAGE = Path(__file__).resolve().parents[2] / "docs/explanation/guard.md"
BEGIN, END = "<!-- matrix: begin -->\n", "<!-- matrix: end -->"
DOMAIN = 88
HOLD_S, LIFT_S, KILLED_HOLD_S, KILLED_LIFT_S = 0.1, 1.5, 0.5, 2.0
"""Limits: seconds to hold and to lift after a fault of the node, and after the guard was killed."""
RESTART_S, SOCKET_S = 0.5, 0.001
"""Limits: seconds until a killed guard's successor has opened the port, and the slowest hundredth of the socket."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """Result of one run: seconds to hold, to lift and until the port was opened again; None if it was not necessary."""

    held_s: float | None
    lifted_s: float | None
    deeper_mm: float
    opened_s: float | None = None


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


KILLED, BOTH, FLOOD = "guard SIGKILL", "both SIGKILL", "node flood"
CAUSES: dict[str, Callable[[GuardRig], None]] = {
    "node SIGKILL": signalled(signal.SIGKILL),
    "node SIGSTOP": signalled(signal.SIGSTOP),
    "node SIGSTOP for 1 s": signalled(signal.SIGSTOP, 1.0),
    KILLED: kill_guard,
    "guard SIGSTOP": stop_guard,
    BOTH: kill_both,
    "direct STOP": direct_stop,
    FLOOD: lambda rig: None,
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


def first_hold_s(log: list[dict[str, Any]], begun_s: float) -> float | None:
    """Return the seconds until the first hold or reset in the board's log, None if there is none."""
    holds = [e for e in log if e["kind"] == "realtime" and e["byte"] in (ord("!"), 0x18)]
    return min((float(e["t"]) - begun_s for e in holds), default=None)


def flooded(ros: Ros, load: int) -> Seen:
    """Return the result of a flood of frames in contact, from a client that has the node's place."""
    with tempfile.TemporaryDirectory() as folder:
        client = Client(Path(folder))
        try:
            client.press()
            with busy(ros, load):
                since, z = int(client.board.log()[-1]["n"]), float(client.board.mpos()[2])
                begun_s = float(client.board.ask("state")["t"])
                client.flood()
                client.until(client.lifted)
                lifted_s = float(client.board.ask("state")["t"]) - begun_s
            held_s = first_hold_s(client.board.log(since), begun_s)
            return Seen(held_s=held_s, lifted_s=lifted_s, deeper_mm=max(0.0, z - float(client.board.mpos()[2])))
        finally:
            client.close()


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
            log = rig.board.log(since)
            opened = [float(e["t"]) - begun_s for e in log if e["kind"] == "opened"]
            return Seen(
                held_s=first_hold_s(log, begun_s),
                lifted_s=lifted_s,
                deeper_mm=z - deepest,
                opened_s=min(opened, default=None),
            )
        finally:
            rig.close()
            for node in (rig.op.node,):
                ros.executor.remove_node(node)
                node.destroy_node()
                ros.nodes.remove(node)


def cell(seen: list[Seen]) -> str:
    if not seen:
        return "-"
    holds = [s.held_s for s in seen if s.held_s is not None]
    lifts = [s.lifted_s for s in seen if s.lifted_s is not None]
    if not holds:
        return "goes on" if lifts == [] else "-"
    return f"{max(holds):.2f} / {max(lifts):.2f}" if lifts else f"{max(holds):.2f} / -"


def rows_of(seen: dict[tuple[str, str], list[Seen]]) -> list[Row]:
    """Return the slowest hold, lift and restart of each fault, with their limits.

    A guard that hangs has none: its node waits for seconds before it restarts it.
    """
    rows = []
    for cause in dict.fromkeys(cause for cause, _ in seen if cause != "guard SIGSTOP"):
        killed = cause in (KILLED, BOTH)
        idle = ("rest", "homing") if killed else ()
        runs = [s for (c, p), found in seen.items() if c == cause and p not in idle for s in found]
        hold_s, lift_s = (KILLED_HOLD_S, KILLED_LIFT_S) if killed else (HOLD_S, LIFT_S)
        times = [("hold", hold_s, [s.held_s for s in runs]), ("lift", lift_s, [s.lifted_s for s in runs])]
        if cause == KILLED:
            times.append(("restart and open the port", RESTART_S, [s.opened_s for s in runs]))
        for verb, limit_s, found_s in times:
            if known := [t for t in found_s if t is not None]:
                rows.append(bound(f"guard: seconds to {verb} after {cause}", max(known), limit_s))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=2, help="runs of each pair of fault and phase")
    parser.add_argument("--seed", type=int, default=1, help="seed of the order of the runs")
    parser.add_argument("--causes", nargs="*", default=list(CAUSES), help="faults to run")
    parser.add_argument("--phases", nargs="*", default=list(PHASES), help="phases to run")
    parser.add_argument("--busy", type=int, default=0, help="busy processes beside each fault")
    parser.add_argument("--write", action="store_true", help="put the table into docs/explanation/guard.md")
    options = parser.parse_args()
    possible = [(c, p) for c in options.causes for p in options.phases if c != FLOOD or p == "contact"]
    pairs = [pair for pair in possible for _ in range(options.repeats)]
    random.Random(options.seed).shuffle(pairs)
    seen: dict[tuple[str, str], list[Seen]] = {}
    with participant(DOMAIN) as ros:
        for cause, phase in pairs:
            result = flooded(ros, options.busy) if cause == FLOOD else once(ros, cause, phase, options.busy)
            seen.setdefault((cause, phase), []).append(result)
            print(f"{cause}, {phase}: {seen[cause, phase][-1]}", flush=True)
    head = [f"| fault | {' | '.join(options.phases)} |", "|---" * (len(options.phases) + 1) + "|"]
    lines = [f"| {c} | {' | '.join(cell(seen.get((c, p), [])) for p in options.phases)} |" for c in options.causes]
    low, high = np.quantile(questions(), (0.5, 0.99))
    stop_low, stop_high = np.quantile(stops(), (0.5, 0.99))
    load = os.getloadavg()[0]
    text = "\n".join([*head, *lines]) + (
        f"\n\nRuns of each pair: {options.repeats}; {os.cpu_count()} cores, load {load:.1f}. A question to the guard "
        f"and its answer over the socket: median {1000 * low:.2f} ms, slowest hundredth {1000 * high:.2f} ms. A stop's "
        f"datagram until its byte is on the port: median {1000 * stop_low:.2f} ms, slowest hundredth "
        f"{1000 * stop_high:.2f} ms.\n"
    )
    print(text)
    if options.write:
        before, _, rest_of = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}{text}{END}{rest_of.partition(END)[2]}", encoding="utf-8")
    rows = rows_of(seen)
    rows += [
        bound("guard: question and answer, median [s]", float(low), SOCKET_S),
        bound("guard: question and answer, slowest hundredth [s]", float(high), SOCKET_S),
        bound("guard: stop to its byte on the port, median [s]", float(stop_low), SOCKET_S),
        bound("guard: stop to its byte on the port, slowest hundredth [s]", float(stop_high), SOCKET_S),
    ]
    return 0 if write("guard", rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
