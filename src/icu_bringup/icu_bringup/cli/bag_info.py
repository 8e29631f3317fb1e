"""Show topics, rates, gaps and goals of a rosbag2 bag, or save the readable part of a broken one."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_repair import repair
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.export.adapters.pictures import save_strip
from icu_bringup.export.adapters.reading import cameras, namespace_of, session_of
from icu_bringup.export.core.overview import check_lines, gap_text, gaps, goal_lines
from icu_bringup.export.core.session import GOAL_TOPICS, RESULT
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.option_bounds import named_path


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="bag_info", description=__doc__)
    result.add_argument("bag", type=named_path, help="folder with metadata.yaml, or a .mcap or .db3 file")
    result.add_argument("--check", action="store_true", help="count the messages that can be read")
    result.add_argument("--brief", action="store_true", help="topics only, without reading the messages")
    result.add_argument(
        "--strip", type=named_path, metavar="FILE", help="save an image: thumbnails over time (.png, .jpg)"
    )
    result.add_argument(
        "--namespace", type=namespace_of, default="", help="robot whose goals are meant, as bed_1 (none)"
    )
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
            if options.brief:
                print(description(bag), flush=True)
            else:
                print(overview(bag, options.namespace, options.strip), flush=True)
            if options.check:
                print(f"{bag.check()} messages can be read")
    except BagError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader, such as head, has ended; the interpreter must not flush to it at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def overview(bag: BagReader, namespace: str = "", picture: Path | None = None) -> str:
    """Return the description of a bag with gaps, goals, and the checks that its replay allows; save a picture strip.

    Raises
    ------
    BagError
        If the bag is broken, after its description was printed, or the picture cannot be saved.
    """
    try:
        times = bag.times()
        session = session_of(bag, namespace, GOAL_TOPICS)
    except BagError:
        print(description(bag), flush=True)
        raise
    found = {topic: gap_text(some, bag.start_ns) for topic, at in times.items() if (some := gaps(at)) is not None}
    topics = {name.removeprefix(namespace) for name in times if name.startswith(namespace + "/")}
    lines = [description(bag, found), *goal_lines(session.goals, bag.start_ns, RESULT in topics), *check_lines(topics)]
    if picture is not None:
        save_strip(bag, times, list(cameras(bag, namespace)), picture)
        lines.append(f"thumbnails: {picture}")
    return "\n".join(lines)


def description(bag: BagReader, gaps_of: Mapping[str, str] | None = None) -> str:
    """Return the contents of a bag: a line for each topic, and one for the gaps of a topic."""
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
        if text := (gaps_of or {}).get(topic.name):
            lines.append(f"  {'':<{width}} {text}")
    return "\n".join(lines)


if __name__ == "__main__":
    raise SystemExit(main())
