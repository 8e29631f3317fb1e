"""Writes the two calibration files that belong to the bench's cameras, as a perfect calibration would find them."""

from __future__ import annotations

import argparse
import sys

import yaml

from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.config import from_mapping
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.configuration.parameter_file import values_for
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.optics import stereo_rig


@ends_quietly
def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="write_calibration", description=__doc__)
    parser.add_argument("folder", type=named_path, help="where bench_left.yaml and bench_right.yaml go")
    parser.add_argument(
        "--params",
        type=named_path,
        metavar="YAML",
        help="the bench's parameter file (default: params/bench.yaml beside the folder, where there is one)",
    )
    options = parser.parse_args(arguments)
    beside = options.folder.resolve().parent / "params" / "bench.yaml"
    params = options.params or (beside if beside.exists() else None)
    try:
        rig = stereo_rig(from_mapping(BenchConfig, values_for("bench", params) if params else {}).camera)
        for side in ("left", "right"):
            text = yaml.safe_dump(rig.calibration(side), sort_keys=False, default_flow_style=None, width=120)
            head = f"# The bench's {side} camera; written by `python -m icu_simulator.cli.write_calibration`.\n"
            (options.folder / f"bench_{side}.yaml").write_text(head + text, encoding="utf-8")
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{options.folder}: the cameras of {params or 'the default bench'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
