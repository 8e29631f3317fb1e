"""Write a bag in the forms of other programs: parquet, images, videos, a LeRobot dataset, a Rerun recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.core.bag.account import INCOMPLETE
from icu_bringup.export.adapters.lerobot import Dataset
from icu_bringup.export.adapters.pictures import write_images, write_videos
from icu_bringup.export.adapters.reading import cameras, namespace_of, require, session_of
from icu_bringup.export.adapters.rerun_file import Recording
from icu_bringup.export.adapters.tables import write_tables
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.option_bounds import check_bounds, named_path

FORMS = {"parquet": ("pyarrow",), "images": (), "video": (), "lerobot": ("pyarrow",), "rerun": ("rerun",)}
"""Forms, and the optional libraries that each needs."""
BROKEN, UNUSABLE = 1, 2


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="bag_export", description=__doc__)
    result.add_argument("bag", type=named_path, help="folder with metadata.yaml, or a .mcap or .db3 file")
    result.add_argument("--out", type=named_path, required=True, metavar="FOLDER", help="new folder to write into")
    result.add_argument(
        "--form",
        action="append",
        choices=FORMS,
        help="what to write; may be given several times (parquet and images)",
    )
    result.add_argument("--fps", type=int, default=10, help="moments a second of the LeRobot dataset (%(default)s)")
    result.add_argument(
        "--namespace", type=namespace_of, default="", help="robot whose topics are meant, as bed_1 (none)"
    )
    return result


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 1 if a form cannot be written, 2 for wrong options, 3 if parts were left out."""
    options = parser().parse_args(arguments)
    forms: list[str] = list(dict.fromkeys(options.form or ["parquet", "images"]))
    try:
        check_bounds(options, fps=(1, 240))
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE
    try:
        require(*(module for form in forms for module in FORMS[form]))
        if options.out.exists():
            raise BagError(f"{options.out} exists already; name a new folder")
        with BagReader(options.bag) as bag:
            left_out = False
            for form in forms:
                text, problems = _write(form, bag, options)
                print(text, flush=True)
                for name, reasons in problems.items():
                    left_out = True
                    print(f"{name}: {len(reasons)} left out: {reasons[0]}", file=sys.stderr)
    except (BagError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return BROKEN
    return INCOMPLETE if left_out else 0


def _write(form: str, bag: BagReader, options: argparse.Namespace) -> tuple[str, dict[str, list[str]]]:
    """Write one form; return a summary, and the reasons for each omitted part by topic or task."""
    namespace: str = options.namespace
    out: Path = options.out
    if form == "parquet":
        rows = write_tables(bag, session_of(bag, namespace), out / "parquet")
        return f"{out}/parquet: " + ", ".join(f"{name} {count}" for name, count in rows.items()) + " rows", {}
    if form == "lerobot":
        dataset = Dataset(out / "lerobot", session_of(bag, namespace), options.fps, cameras(bag, namespace))
        dataset.write(bag)
        return f"{out}/lerobot: {dataset.count} episodes, {dataset.frames} frames", dataset.problems
    if form == "rerun":
        out.mkdir(parents=True, exist_ok=True)
        recording = Recording(out / "session.rrd", bag, namespace)
        return f"{out}/session.rrd: {recording.write()} messages", recording.problems
    count, problems = (write_images if form == "images" else write_videos)(bag, out / form)
    return f"{out}/{form}: {count} images", problems


if __name__ == "__main__":
    raise SystemExit(main())
