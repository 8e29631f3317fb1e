"""Sparse and dense stereo against known disparity, compared with other methods, from the command line."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from harris_perception.adapters.picture_files import write_picture
from harris_perception.adapters.stereo_folders import scenes
from harris_perception.core.evaluation.stereo_evaluation import MAX_POINTS, error_picture, evaluate
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.option_bounds import named_path

DENSE = {
    "bad-0.5": "bad_half",
    "bad-1": "bad_1",
    "bad-2": "bad_2",
    "of known": "bad_2_of_known",
    "no strip": "bad_2_strip_apart",
    "invalid": "invalid",
    "rms px": "rms_px",
    "ms": "took_ms",
}
SPARSE = {
    "points": "points",
    "matches": "matches",
    "precision": "precision",
    "recall": "recall",
    "rms px": "rms_px",
    "ms": "took_ms",
}
NOTES = """dense: % of the pixels that both pictures show, holes filled alike for all; 'of known' is bad-2 before that,
'no strip' is bad-2 without the left columns that OpenCV's matchers leave empty, rms of what is within 2 px
sparse: % at 1 px, at most {points} points; the peers' matches across rows are dropped; rms of what is within 1 px"""


def _table(rows: Sequence[dict[str, Any]], kind: str, columns: dict[str, str]) -> None:
    mine = [row for row in rows if row["kind"] == kind]
    names = list(dict.fromkeys(row["scene"] for row in mine))
    print(f"\n{kind:<16}{'method':<26}" + "".join(f"{title:>10}" for title in columns))
    for scene in [*names, "mean"] if len(names) > 1 else names:
        for method in dict.fromkeys(row["method"] for row in mine):
            of = [r for r in mine if r["method"] == method and scene in (r["scene"], "mean")]
            cells = [float(np.mean([r[key] for r in of])) for key in columns.values()]
            print(f"{scene:<16}{method:<26}" + "".join(f"{cell:>10.4g}" for cell in cells))


def _evaluate(options: argparse.Namespace) -> int:
    rows: list[dict[str, Any]] = []
    found = list(scenes(options.folder, options.truth_scale, options.scale))
    options.output.mkdir(parents=True, exist_ok=True)
    for number, scene in enumerate(found, start=1):
        if sys.stderr.isatty():
            print(f"{number}/{len(found)} {scene.name}", file=sys.stderr)
        result = evaluate(scene, time.perf_counter)
        rows += result.rows()
        write_picture(options.output / f"{scene.name}.png", error_picture(result))
    # A method that found nothing has no precision; JSON has no NaN.
    written = [{key: None if value != value else value for key, value in row.items()} for row in rows]
    (options.output / "stereo.json").write_text(json.dumps(written, indent=1) + "\n")
    _table(rows, "dense", DENSE)
    _table(rows, "sparse", SPARSE)
    print("\n" + NOTES.format(points=MAX_POINTS))
    print(f"{len(found)} pairs; error pictures and stereo.json are in {options.output}")
    return 0


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; errors in the user's input end with code 2 and one line."""
    parser = argparse.ArgumentParser(prog="stereo evaluate", description=__doc__)
    parser.add_argument("folder", type=named_path, help="folder with rectified pairs and their disparity, at any depth")
    parser.add_argument(
        "-o", "--output", type=named_path, default=Path("stereo_evaluation"), help="folder for the results"
    )
    parser.add_argument("--scale", type=float, default=1.0, help="make pictures and disparities smaller first")
    parser.add_argument("--truth-scale", type=float, default=1.0, help="px of disparity for each unit in the file")
    try:
        return _evaluate(parser.parse_args(arguments))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def stereo() -> int:
    """Run ``stereo evaluate FOLDER``; without ``evaluate``, the node."""
    if sys.argv[1:2] == ["evaluate"]:
        return main(sys.argv[2:])
    from harris_perception.nodes.stereo_node import main as node  # needs ROS; the evaluation does not

    code = node()
    if {"-h", "--help"} & set(sys.argv[1:]):
        print("\n`stereo evaluate FOLDER` compares disparities with ground truth instead; it has a --help of its own.")
    return code


if __name__ == "__main__":
    raise SystemExit(main())
