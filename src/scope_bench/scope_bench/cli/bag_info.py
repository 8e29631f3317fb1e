"""Show the contents of a rosbag2 bag, or save the readable part of a broken one."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from collections.abc import Sequence
from datetime import datetime, timezone

from icu_common.adapters.program_end import ends_quietly
from icu_common.core.option_bounds import named_path
from scope_bench.adapters.bag_repair import repair
from scope_bench.adapters.bags import BagError, BagReader


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="bag_info", description=__doc__)
    result.add_argument("bag", type=named_path, help="folder with metadata.yaml, or a .mcap or .db3 file")
    result.add_argument("--check", action="store_true", help="read every message")
    result.add_argument("--repair", type=named_path, metavar="NEW_BAG", help="save all whole messages into a new bag")
    return result


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 1 if the bag is broken."""
    options = parser().parse_args(arguments)
    try:
        if options.repair is not None:
            count, end = repair(options.bag, options.repair)
            if end and not count:
                shutil.rmtree(options.repair)
                raise BagError(f"{options.bag}: no message can be saved: {end}")
            print(f"{count} messages saved in {options.repair}" + (f"; not all: {end}" if end else ""))
            return 0
        with BagReader(options.bag) as bag:
            print(description(bag), flush=True)
            if options.check:
                print(f"{bag.check()} messages can be read")
    except BagError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # whoever reads this has seen enough, as head does; the end must not flush to it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def description(bag: BagReader) -> str:
    """Return what is in a bag, a line for each topic."""
    files = [bag.path] if bag.path.is_file() else [p for p in bag.path.iterdir() if p.is_file()]
    start = datetime.fromtimestamp(bag.start_ns / 1e9, timezone.utc)
    seconds = bag.duration_ns / 1e9
    lines = [
        f"{bag.path}: {sum(p.stat().st_size for p in files) / 1e6:.1f} MB, {bag.count} messages, "
        f"{seconds:.2f} s from {start:%Y-%m-%d %H:%M:%S} UTC"
    ]
    width = max((len(topic.name) for topic in bag.topics), default=0)
    for topic in bag.topics:
        rate = f"{topic.count / seconds:8.1f} Hz" if seconds else " " * 11
        kinds = {f"{qos.reliability.name.lower()}, {qos.durability.name.lower()}" for qos in topic.qos}
        lines.append(f"  {topic.name:<{width}} {topic.count:7d} {rate}  {topic.type}  {'; '.join(sorted(kinds))}")
        if topic.announced > topic.count:
            lines.append(
                f"  {'':<{width}} metadata.yaml lists {topic.announced} messages, the files have {topic.count}"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
