"""Record topics into a standard rosbag2 bag (MCAP or sqlite3); Ctrl-C ends it. `ros2 bag` of Jazzy reads the result."""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from icu_common.adapters.program_end import ends_quietly
from icu_common.core.option_bounds import check_bounds, named_path
from icu_common.nodes.runtime import Session, ros_session
from icu_common.nodes.topic_names import check_names
from scope_bench.adapters.bag_pictures import PictureCodec
from scope_bench.adapters.bag_sink import BagSink
from scope_bench.adapters.bags import STORAGES, BagError, BagWriter
from scope_bench.cli.progress import ProgressLine
from scope_bench.nodes.bag_recorder import BagRecorder

_BEHIND_S = 5.0
"""So long the end waits at most for what has come before it."""
_QUALITY = 85
_NICENESS = 10
"""Whoever is recorded comes first."""
_FOUND_S = 10.0
"""So long at most is waited for topics to be found before it is said that they are recorded."""


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="bag_record", description=__doc__, epilog="--ros-args ... as for every node")
    result.add_argument("topics", nargs="*", help="names; without any, all topics as they appear")
    result.add_argument("-o", "--output", type=named_path, help="folder to be made (default: the date and time)")
    result.add_argument("-s", "--storage", choices=STORAGES, default="mcap", help="default: %(default)s")
    result.add_argument("-x", "--exclude", default="", metavar="REGEX", help="leave these out when all are recorded")
    result.add_argument("--compress", choices=("jpeg", "png"), help="pictures as topic/compressed")
    result.add_argument("--quality", type=int, metavar="1..100", help=f"of JPEG (default: {_QUALITY})")
    result.add_argument("--duration", type=float, default=float("inf"), metavar="S", help="end after so long")
    result.add_argument("--child-of", type=int, metavar="PID", help="end when this parent process has ended")
    result.add_argument("--keep-free", type=float, default=64.0, metavar="MB", help="end when the disk has less")
    return result


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 1 if the recording ended by an error."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    split = given.index("--ros-args") if "--ros-args" in given else len(given)
    options = parser().parse_args(given[:split])
    path = options.output or default_name(datetime.now())
    try:
        check_bounds(options, duration=(0.0, math.inf), keep_free=(0.0, 1e9))
        check_names(options.topics)
        _check_pattern(options.exclude)
        keep_free = round(options.keep_free * 1e6)
        codec = _codec(options)
        if arguments is None:  # a program of its own, and all threads that it will have
            os.nice(_NICENESS)
        with ros_session(given[split:]) as session:
            sink = BagSink(lambda: BagWriter(path, options.storage, keep_free=keep_free), codec)
            try:
                _record(session, sink, path, options, given[split:])
            finally:
                sink.close()
    except (BagError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if not _orphaned(options):  # else nobody reads it
        print(f"{path}: {sink.messages} messages, {sink.bytes / 1e6:.1f} MB, {sink.dropped} dropped")
    if sink.failure:
        print(f"error: the recording has ended: {sink.failure}", file=sys.stderr)
    return 1 if sink.failure else 0


def default_name(begun: datetime) -> Path:
    """Return the folder of a recording that was given none, to the microsecond: two may begin at once."""
    return Path(f"bag_{begun:%Y_%m_%d-%H_%M_%S_%f}")


def _codec(options: argparse.Namespace) -> PictureCodec | None:
    if options.quality is not None and options.compress != "jpeg":
        raise ValueError(f"--quality {options.quality} is of JPEG: --compress jpeg is needed")
    quality = _QUALITY if options.quality is None else options.quality
    return PictureCodec(options.compress, quality) if options.compress else None


def _orphaned(options: argparse.Namespace) -> bool:
    return options.child_of is not None and os.getppid() != options.child_of


def _check_pattern(exclude: str) -> None:
    try:
        re.compile(exclude)
    except re.error as error:
        raise ValueError(f"--exclude {exclude!r} is no regular expression: {error}") from error


def _record(session: Session, sink: BagSink, path: Path, options: argparse.Namespace, arguments: Sequence[str]) -> None:
    line = ProgressLine()
    node = BagRecorder(sink, options.topics, options.exclude, arguments=arguments)
    session.executor.add_node(node)
    start_s, said = time.monotonic(), False
    try:
        while session.goes_on and not sink.failure and (now_s := time.monotonic()) - start_s < options.duration:
            if _orphaned(options):
                break
            session.spin()
            if not said and (node.listens or now_s - start_s > _FOUND_S):
                # Whoever started this program may send SIGINT from now on.
                print(f"recording to {path}", flush=True)
                said = True
            waiting = f", nobody publishes {', '.join(node.missing)}" if node.missing else ""
            line.show(
                now_s,
                f"recording {now_s - start_s:.1f} s: {len(node.recorded)} topics, {sink.messages} messages, "
                f"{sink.bytes / 1e6:.1f} MB, {sink.dropped} dropped{waiting}",
            )
        if not said:
            print(f"recording to {path}", flush=True)
        if not sink.failure:
            catch_up(node)
    finally:
        line.end()
        session.end(node)


def catch_up(node: BagRecorder) -> None:
    """Take what has come until now: on a busy computer the last seconds before the end still wait."""
    until_s = time.monotonic() + _BEHIND_S
    while node.take() and time.monotonic() < until_s:
        pass


if __name__ == "__main__":
    raise SystemExit(main())
