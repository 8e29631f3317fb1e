"""Measure touches and knobs on the simulated bench over several seeds of mechanical errors, against the physical truth.

For each seed, a robot is prepared as in `make demo` (home, calibrate by the cameras, recognise). Then it touches named
controls and free points in turn. The error is the distance of the ball's true centre from the target at first contact:
from the manufactured control's centre, or from the point as the print shows it.
Everything runs on a virtual clock (see virtual_robot), so the times are the robot's and do not depend on this
computer's load. There is no peer to run; the published reference is a camera-guided gantry of this kind.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from gantry_driver.core.job.goal_job import LOOKING, GoalPhase
from icu_common.core.goals.results import Outcome
from icu_common.core.panel.panel_layout import Control, PanelLayout
from icu_simulator.manufacture.layout import print_offset_mm

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from rows import OUT, Row, bound, row, write
from support.virtual_robot import VirtualRobot

REFERENCE_MM = 5.94
LOOK_EVERY = 5
"""Number of touches between two recognitions of the whole panel, which does not move here."""
SPLIT = {
    "move": (GoalPhase.APPROACH, GoalPhase.CORRECT, GoalPhase.LIFT),
    "look": (GoalPhase.LOOK, GoalPhase.MEASURE),
    "touch": (GoalPhase.TOUCH, GoalPhase.CONTACT),
}
LIMITS_MM = {"ideal": (0.15, 0.3), "workshop": (0.15, 0.3), "ward": (0.25, 0.5)}
"""Limits of the mean and of the 95 % quantile of the touch error in each room."""
PRESSED = {"ideal": 98.0, "workshop": 98.0, "ward": 95.0}
"""Minimum share of keys that act at the first try, percent."""
KNOBS = {"knobs": "dso_bench_4", "dimple": "ventilator_v1"}
"""Layouts with knobs to set: by friction on their face, and by the ball in a dimple."""
assert {GoalPhase.LOOK, GoalPhase.CONTACT, GoalPhase.MEASURE} <= set(LOOKING)


def free_point(layout: PanelLayout, rng: np.random.Generator) -> tuple[float, float]:
    """Return a random point of the face in mm that is not on a connector and not too near to a tall control."""
    while True:
        x, y = (float(rng.uniform(12, side - 12)) for side in layout.size_mm)
        for c in layout.controls:
            distance, radius = float(np.hypot(x - c.position_mm[0], y - c.position_mm[1])), max(c.size_mm) / 2
            if c.height_mm > 5 and distance < radius + 5 and not (c.kind == "knob" and distance < radius - 3):
                break
            beside = np.abs(np.array([x, y]) - c.position_mm) - np.array(c.size_mm) / 2
            if 0 < c.height_mm <= 5 and -1.0 < beside.max() < 4.5:
                break
        else:
            return x, y


def lies_on(control: Control, x: float, y: float) -> bool:
    """Return whether the point (x, y) in mm lies on the control's face."""
    across, up = (abs(p - centre) / (side / 2) for p, centre, side in zip((x, y), control.position_mm, control.size_mm))
    return across**2 + up**2 <= 1 if control.shape == "circle" else max(across, up) <= 1


def meant(layout: PanelLayout, x: float, y: float) -> str:
    """Return the name of the control whose face is under the point, "FACE" if there is none."""
    inside = [c for c in layout.controls if lies_on(c, x, y)]
    return min(inside, key=lambda c: c.size_mm[0] * c.size_mm[1]).name if inside else "FACE"


def touches(seed: int, count: int, room: str) -> list[dict[str, Any]]:
    """Touch ``count`` positions with one robot; return the result of each touch."""
    robot = VirtualRobot(seed, room=room)
    robot.prepare()
    layout, rng = robot.layout, np.random.default_rng(1000 + seed)
    named = [c for c in layout.controls if c.kind != "connector"]
    printed = np.array(print_offset_mm(layout, robot.bench.layout))
    done = []
    for number in range(count):
        if number % 2:
            name = named[int(rng.integers(len(named)))].name
            true_mm, text = np.array(robot.bench.layout.control(name).position_mm), f"press:{name}"
        else:
            x, y = free_point(layout, rng)
            true_mm, text = (x, y) + printed, f"press:{x / 1000!r},{y / 1000!r}@panel_link"
            name = meant(robot.bench.layout, *true_mm.tolist())
        if number % LOOK_EVERY == 0:
            robot.look_at_panel()
        robot.run_for(1.0)
        robot.take_records()
        robot.phases.clear()
        result = robot.command(text)
        records = robot.take_records()
        contacts = [r for r in records if r["event"] == "contact"]
        pressed = [r["control"] for r in records if r["event"] in ("press", "contact")]
        entry: dict[str, Any] = {"goal": text, "outcome": result.outcome.value, "reason": result.reason}
        entry["touch"] = "" if result.touch is None else result.touch.value
        acted = any(r["event"] == "press" and r["control"] == name for r in records)
        key = any(c.name == name and c.kind == "button" for c in layout.controls)
        if key and text.startswith("press:") and "@" not in text:
            entry["acted"] = acted
        # A press without an effect visible to the cameras counts as a touch, but a claimed contact must be true.
        entry["false_claim"] = (entry["touch"] == "pressed" and key and not acted) or (
            entry["touch"] in ("pressed", "touched") and not contacts
        )
        entry["wrong"] = [p for p in pressed if p != name]
        entry["collisions"] = [r["control"] for r in records if r["event"] == "collision"]
        if contacts:
            entry["error_mm"] = float(np.hypot(*(np.array(contacts[0]["tip_panel_mm"][:2]) - true_mm)))
        if result.outcome is Outcome.REACHED:
            entry["reported_mm"] = 1000 * result.error_m
            entry["time_s"] = result.duration_s
            entry |= {
                f"{part}_s": sum(robot.phases.get(p.value, 0.0) for p in phases) for part, phases in SPLIT.items()
            }
        done.append(entry)
    return done


def machine(seed: int, touch_count: int, knob_count: int, room: str) -> dict[str, list[dict[str, Any]]]:
    """Return the results of one machine."""
    done = {"touches": touches(seed, touch_count, room)}
    for part, layout in KNOBS.items():
        done[part] = knobs(seed, knob_count, layout, room) if knob_count else []
    return done


def _record(seed: int, room: str) -> Path:
    return OUT / f"operating_{room}_machine_{seed}.json"


def knobs(seed: int, count: int, layout: str, room: str) -> list[dict[str, Any]]:
    """Set knobs with one robot to random angles; return the result for each."""
    robot = VirtualRobot(seed, layout=layout, room=room)
    robot.prepare()
    rng = np.random.default_rng(2000 + seed)
    names = [c.name for c in robot.layout.controls if c.kind == "knob"]
    done = []
    for number in range(count):
        name, goal = names[number % len(names)], round(float(rng.uniform(-180, 180)), 1)
        robot.look_at_panel()
        robot.take_records()
        result = robot.command(f"set:{name}:{goal}")
        off = (robot.bench.state.knob_deg(name) - goal + 180) % 360 - 180
        touched = {r["control"] for r in robot.take_records() if r["event"] in ("contact", "press", "collision")}
        entry = {"goal": f"set:{name}:{goal}", "outcome": result.outcome.value, "reason": result.reason}
        entry |= {"off_deg": abs(off), "time_s": result.duration_s, "wrong": sorted(touched - {name})}
        entry["turns"] = int(dict(result.details).get("turns", "0"))
        done.append(entry)
    return done


def knob_rows(flat: list[dict[str, Any]], how: str) -> list[Row]:
    """Return the rows about knobs turned by one method."""
    off, times = [k["off_deg"] for k in flat], [k["time_s"] for k in flat]
    reached = 100 * sum(k["outcome"] == "reached" for k in flat) / len(flat)
    return [
        bound(f"knobs{how} set, of {len(flat)} [%]", reached, 100, at_least=True),
        bound(f"knobs{how}: true angle off, greatest [deg]", float(max(off)), 3.0),
        row(f"knobs{how}: true angle off, mean [deg]", float(np.mean(off)), None, ""),
        row(f"knobs{how}: setting one, p50 [s]", float(np.percentile(times, 50)), None, ""),
        row(f"knobs{how}: setting one, p95 [s]", float(np.percentile(times, 95)), None, ""),
        bound(f"knobs{how}: another control touched", float(sum(bool(k["wrong"]) for k in flat)), 0),
    ]


def summary(seeds: Sequence[int], all_touches: list[list[dict[str, Any]]], room: str) -> list[Row]:
    """Return the rows about touches."""
    mean_mm, p95_mm = LIMITS_MM[room]
    flat = [t for of_seed in all_touches for t in of_seed]
    good = [t for t in flat if t["outcome"] == "reached"]
    errors = np.array([t["error_mm"] for t in flat if "error_mm" in t])
    rows = [
        bound(f"of {len(flat)} touches made and confirmed [%]", 100 * len(good) / len(flat), 99, at_least=True),
        row("touch error, mean [mm]", float(errors.mean()), REFERENCE_MM, "published camera-guided gantry"),
        bound("touch error, mean [mm]", float(errors.mean()), mean_mm),
        bound("touch error, p95 [mm]", float(np.percentile(errors, 95)), p95_mm),
        bound("touch error, greatest [mm]", float(errors.max()), 1.0),
        bound("wrong controls touched", float(sum(bool(t["wrong"]) for t in flat)), 0),
        bound("false claims of a touch", float(sum(bool(t.get("false_claim")) for t in flat)), 0),
        bound("collisions", float(sum(bool(t["collisions"]) for t in flat)), 0),
        bound("error as the robot reports it, mean [mm]", float(np.mean([t["reported_mm"] for t in good])), 0.25),
    ]
    for seed, of_seed in zip(seeds, all_touches):
        own = np.array([t["error_mm"] for t in of_seed if "error_mm" in t])
        rows.append(bound(f"machine {seed}: greatest touch error [mm]", float(own.max()), 1.0))
    if keys := [t["acted"] for t in flat if "acted" in t]:
        what = f"of {len(keys)} keys pressed at the first try [%]"
        rows.append(bound(what, 100 * sum(keys) / len(keys), PRESSED[room], at_least=True))
    for part, name in (("time_s", "a press"), *((f"{part}_s", f"a press: {part}") for part in SPLIT)):
        values = [t[part] for t in good]
        for percentile in (50, 95):
            rows.append(row(f"{name}, p{percentile} [s]", float(np.percentile(values, percentile)), None, ""))
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--touches", type=int, default=200, help="of each seed")
    parser.add_argument("--knobs", type=int, default=14, help="of each seed")
    parser.add_argument("--keep", action="store_true", help="take the records of machines that have run before")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--room", default="workshop", choices=LIMITS_MM, help="room (default: %(default)s)")
    options = parser.parse_args(arguments)
    OUT.mkdir(exist_ok=True)
    wanted = [s for s in options.seeds if not (options.keep and _record(s, options.room).exists())]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        each = ([value] * len(wanted) for value in (options.touches, options.knobs, options.room))
        for seed, record in zip(wanted, pool.map(machine, wanted, *each)):
            _record(seed, options.room).write_text(json.dumps(record, indent=1))
    records = [json.loads(_record(seed, options.room).read_text()) for seed in options.seeds]
    results = [r["touches"] for r in records]
    turned = {part: [k for r in records for k in r[part]] for part in KNOBS}
    for entry in (k for part in turned.values() for k in part):
        if entry["outcome"] != "reached" or entry["off_deg"] > 3 or entry["wrong"]:
            print(entry)
    for seed, entries in zip(options.seeds, results):
        for entry in entries:
            if entry["outcome"] != "reached" or entry["wrong"] or entry["collisions"] or entry.get("error_mm", 0) > 0.5:
                print(seed, entry)
    title = f"{options.touches} touches on each of {len(options.seeds)} simulated machines, room {options.room}"
    rows = summary(options.seeds, results, options.room)
    for part, entries in turned.items():
        rows += knob_rows(entries, "" if part == "knobs" else " with a dimple") if entries else []
    return 0 if write(f"operating_{options.room}", rows, title=title) else 1


if __name__ == "__main__":
    sys.exit(main())
