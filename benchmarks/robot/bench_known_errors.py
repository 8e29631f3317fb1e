"""Measure the stated error's coverage on the simulated bench under effects on camera or panel after the calibration.

Each robot calibrates, then one effect is added, then it touches named controls and free points in turn. A touch is
covered if the true offset lies in the 95 % ellipse of its result. Times are virtual, as in bench_operating.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.panel.panel_layout import PanelLayout, load_layout

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from robot.bench_operating import LOOK_EVERY, free_point
from rows import Row, row, write
from support.parameter_files import CONFIG
from support.virtual_robot import VirtualRobot

ELLIPSE = 5.991
"""Squared Mahalanobis distance that contains 95 % of a normal distribution in the plane."""
TURNED_S = 12
"""Number of recognitions of the panel between the effect and the first touch, 0.2 s apart."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """Rotation of the right camera about its x, y, z, and bounds of the offsets of controls in position and height."""

    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    place_mm: float = 0.0
    height_mm: float = 0.0


EFFECTS = {
    "nominal": Effect(),
    "yaw 0.02 deg": Effect(turn_deg=(0.0, 0.02, 0.0)),
    "yaw -0.04 deg": Effect(turn_deg=(0.0, -0.04, 0.0)),
    "pitch 0.02 deg": Effect(turn_deg=(0.02, 0.0, 0.0)),
    "yaw 0.08 deg": Effect(turn_deg=(0.0, 0.08, 0.0)),
    "layout 0.2 mm": Effect(place_mm=0.2, height_mm=0.2),
    "layout 0.6/0.8 mm": Effect(place_mm=0.6, height_mm=0.8),
}


def manufactured(layout: PanelLayout, effect: Effect, rng: np.random.Generator) -> PanelLayout:
    """Return the panel as manufactured: its raised controls have uniform random offsets."""
    controls = []
    for control in layout.controls:
        x, y, z = (float(v) for v in rng.uniform(-1, 1, 3) * (effect.place_mm, effect.place_mm, effect.height_mm))
        if control.height_mm > 0:
            at = control.position_mm[0] + x, control.position_mm[1] + y
            control = dataclasses.replace(control, position_mm=at, height_mm=control.height_mm + z)
        controls.append(control)
    return dataclasses.replace(layout, controls=tuple(controls))


def covered(result: GoalResult, true_mm: np.ndarray[Any, Any]) -> bool:
    """Return whether the true offset (2,) mm in the panel lies in the result's ellipse."""
    details, keys = dict(result.details), ("offset_x_m", "offset_y_m", "sigma_x_m", "sigma_y_m", "correlation")
    of = {key: float(details[key]) for key in keys}
    sigma = 1e3 * np.array([of["sigma_x_m"], of["sigma_y_m"]])
    covariance = np.outer(sigma, sigma) * np.array([[1.0, of["correlation"]], [of["correlation"], 1.0]])
    off = true_mm - 1e3 * np.array([of["offset_x_m"], of["offset_y_m"]])
    return bool(off @ np.linalg.solve(covariance, off) <= ELLIPSE)


def touches(name: str, seed: int, count: int) -> list[dict[str, Any]]:
    """Touch ``count`` positions with one robot under an effect; return the result of each touch."""
    effect, rng = EFFECTS[name], np.random.default_rng(3000 + seed)
    nominal = load_layout(CONFIG / "scopes" / "dso_bench_4.yaml")
    truth = manufactured(nominal, effect, rng)
    robot = VirtualRobot(seed, true_layout=truth)
    robot.prepare()
    robot.turn_right_camera(effect.turn_deg)
    robot.look_at_panel(TURNED_S)
    named = [c.name for c in nominal.controls if c.kind != "connector"]
    done = []
    for number in range(count):
        if number % 2:
            control = truth.control(named[int(rng.integers(len(named)))])
            (x, y), text = control.position_mm, f"press:{control.name}"
        else:
            x, y = free_point(truth, rng)
            text = f"press:{x / 1000!r},{y / 1000!r}@panel_link"
        if number % LOOK_EVERY == 0:
            robot.look_at_panel()
        robot.run_for(1.0)
        robot.take_records()
        result = robot.command(text)
        contacts = [r for r in robot.take_records() if r["event"] == "contact"]
        entry: dict[str, Any] = {"goal": text, "outcome": result.outcome.value, "reason": result.reason}
        if contacts and result.outcome is Outcome.REACHED:
            off = np.array(contacts[0]["tip_panel_mm"][:2]) - (x, y)
            stated = 1e3 * float(dict(result.details)["error_95_m"])
            entry |= {"error_mm": float(np.hypot(*off)), "stated_mm": stated, "covered": covered(result, off)}
        done.append(entry)
    return done


def summary(name: str, flat: list[dict[str, Any]]) -> list[Row]:
    """Return the rows about one effect."""
    good = [t for t in flat if "error_mm" in t]
    points = [t for t in good if "@panel_link" in t["goal"]]
    rows = [row(f"{name}: confirmed of {len(flat)} touches [%]", 100 * len(good) / len(flat), None, "")]
    for what, entries in (("", good), ("points: ", points), ("controls: ", [t for t in good if t not in points])):
        if entries:
            covers = 100 * float(np.mean([t["covered"] for t in entries]))
            rows.append(row(f"{name}: {what}in the stated 95 % region [%]", covers, None, ""))
    errors = [t["error_mm"] for t in good]
    rows.append(row(f"{name}: true error, mean [mm]", float(np.mean(errors)), None, ""))
    rows.append(row(f"{name}: true error, greatest [mm]", float(np.max(errors)), None, ""))
    rows.append(row(f"{name}: stated 95 % bound, mean [mm]", float(np.mean([t["stated_mm"] for t in good])), None, ""))
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--touches", type=int, default=40, help="of each seed and effect")
    parser.add_argument("--effects", nargs="+", choices=list(EFFECTS), default=list(EFFECTS))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    jobs = [(name, seed, options.touches) for name in options.effects for seed in options.seeds]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        results = list(pool.map(touches, *zip(*jobs)))
    rows = []
    for name in options.effects:
        flat = [t for job, done in zip(jobs, results) if job[0] == name for t in done]
        for entry in (t for t in flat if "error_mm" not in t or not t["covered"]):
            print(name, entry)
        rows += summary(name, flat)
    title = f"{options.touches} touches on each of {len(options.seeds)} simulated machines, seeds {options.seeds}"
    return 0 if write("known_errors", rows, title=title) else 1


if __name__ == "__main__":
    sys.exit(main())
