"""Parameters of a bench with small images without noise."""

from __future__ import annotations

from pathlib import Path

LAYOUT_FILE = Path(__file__).parents[2] / "config/scopes/dso_bench_4.yaml"
SMALL = {
    "camera.width_px": 640,
    "camera.height_px": 360,
    "camera.focal_px": 850.0,
    "camera.centre_px": (321.2, 177.4, 316.3, 181.9),
    "light.noise": 0.0,
}
