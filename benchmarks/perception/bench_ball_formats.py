"""Measure the ball in images of each camera pixel format: lateral error, and share of images with a measurement.

The five panels are rendered with the ball at seeded positions, 2.5 to 20 mm above the face and at the raised stylus's
height. Each format's chain (tests/support/camera_chain.py) is applied to the region around the ball, aligned to JPEG's
blocks.

    .venv/bin/python benchmarks/perception/bench_ball_formats.py --each 60
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from harris_perception.core.stylus.stylus import StylusTracker
from harris_perception.core.stylus.stylus_config import StylusSearchConfig
from icu_common.core.configuration.config import from_mapping
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.core import instrument
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.renderer import Moment, Renderer, base_from_panel

sys.path.append(str(Path(__file__).resolve().parents[1]))
sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
from support.camera_chain import CHAINS
from support.parameter_files import CONFIG, parameters

SIDE_PX, BLOCK_PX, GREY = 192, 16, 90
SEED = 1000


class Formats:
    """Errors by format, and the answers without a measurement."""

    def __init__(self, names: list[str]) -> None:
        self.errors_mm: dict[str, list[float]] = {name: [] for name in names}
        self.lost: dict[str, Counter[str]] = {name: Counter() for name in names}

    def add(self, name: str, tip: Any, found: Any) -> None:
        if found.tip is None:
            self.lost[name][found.reason] += 1
        else:
            self.errors_mm[name].append(float(np.hypot(*(found.tip - tip)[:2])) * 1e3)

    def show(self) -> None:
        print("| format | measured | mean | p95 | max (mm sideways) |\n|---|---|---|---|---|")
        for name, errors in self.errors_mm.items():
            total = len(errors) + sum(self.lost[name].values())
            values = np.array(errors) if errors else np.array([np.nan])
            mean, p95, most = values.mean(), np.percentile(values, 95), values.max()
            print(f"| {name} | {len(errors)} of {total} | {mean:.3f} | {p95:.3f} | {most:.3f} |")
            for reason, count in self.lost[name].most_common(3):
                print(f"  not measured: {count} x {reason}")


def measure(names: list[str], each: int) -> Formats:
    """Measure ``each`` positions of each panel in each format."""
    base = BenchConfig()
    config = replace(base, light=replace(base.light, noise=0.0))
    panel_from = base_from_panel(config.panel)
    formats, number = Formats(names), 0
    for k, path in enumerate(sorted((CONFIG / "scopes").glob("*.yaml"))):
        layout = load_layout(path)
        renderer = Renderer(layout, config, panel_from)
        left, right = (CameraModel.from_mapping(renderer.rig.calibration(side)) for side in ("left", "right"))
        stereo = StereoModel(left=left, right=right)
        camera_from_base = renderer.rig.rectified_left_from_base()
        rng = np.random.default_rng(SEED + k)
        for i in range(each):
            place = [rng.uniform(0.01, side / 1000 - 0.01) for side in layout.size_mm]
            tip = panel_from.apply(np.array([*place, 0.0]))
            low, raised = rng.uniform(0.0025, 0.02), -panel_from.translation[2] - 0.002
            tip = tip + np.array([0.0, 0.0, rng.choice([low, raised], p=[0.75, 0.25])])
            moment = Moment(tip=tuple(tip.tolist()), state=instrument.InstrumentState(), now_s=float(i))
            renderer.render(moment)  # the first image of a stylus that has just appeared is drawn coarsely
            images = renderer.render(moment)
            seen = camera_from_base.apply(tip)
            centres = (left.project(seen)[0], stereo.project_right(seen)[0])
            for name in names:
                noise = np.random.default_rng((7, number))
                given = [_through(name, image, at, noise) for image, at in zip(images, centres)]
                tracker = StylusTracker(from_mapping(StylusSearchConfig, parameters("stylus_tracker")), stereo)
                formats.add(name, seen, tracker.find(*given))
            number += 1
    return formats


def _through(name: str, image: Any, at: Any, rng: np.random.Generator) -> Any:
    """Return a uniform image with the region around ``at`` as the format's camera sends it."""
    height, width = image.shape[:2]
    corner = [round((a - SIDE_PX / 2) / BLOCK_PX) * BLOCK_PX for a in at]
    x, y = (int(np.clip(c, 0, size - SIDE_PX)) for c, size in zip(corner, (width, height)))
    whole = np.full_like(image, GREY)
    part = slice(y, y + SIDE_PX), slice(x, x + SIDE_PX)
    whole[part] = CHAINS[name](np.ascontiguousarray(image[part]), rng)
    return whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=60, help="places of each panel")
    parser.add_argument("--formats", nargs="*", default=list(CHAINS), choices=list(CHAINS))
    options = parser.parse_args()
    print(f"seeds {SEED} to {SEED + 4}, {options.each} places of each panel")
    measure(options.formats, options.each).show()


if __name__ == "__main__":
    main()
