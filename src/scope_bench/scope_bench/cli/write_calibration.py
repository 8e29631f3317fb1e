"""Writes the two calibration files that belong to the bench's cameras, as a perfect calibration would find them."""

from __future__ import annotations

import argparse
from pathlib import Path

import yaml

from scope_bench.core.configuration import BenchConfig
from scope_bench.core.optics import stereo_rig


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="write_calibration", description=__doc__)
    parser.add_argument("folder", type=Path, help="where bench_left.yaml and bench_right.yaml go")
    options = parser.parse_args(arguments)
    rig = stereo_rig(BenchConfig().camera)
    for side in ("left", "right"):
        text = yaml.safe_dump(rig.calibration(side), sort_keys=False, default_flow_style=None, width=120)
        head = f"# The bench's {side} camera; written by `python -m scope_bench.cli.write_calibration`.\n"
        (options.folder / f"bench_{side}.yaml").write_text(head + text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
