"""Record topics into a standard rosbag2 bag (MCAP or sqlite3); Ctrl-C ends it. `ros2 bag` of Jazzy reads the result."""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
import time
from collections.abc import Iterable, Sequence
from datetime import datetime
from pathlib import Path

from icu_bringup.adapters.bag.bag_pictures import PictureCodec
from icu_bringup.adapters.bag.bag_sink import BagSink
from icu_bringup.adapters.bag.bag_writer import STORAGES, BagWriter
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.cli.progress import ProgressLine
from icu_bringup.core.bag.account import INCOMPLETE, Account
from icu_bringup.nodes.bag_recorder import BagRecorder
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.core.configuration.option_bounds import check_bounds, named_path
from icu_common.nodes.runtime import RosSession, ros_session
from icu_common.nodes.topic_names import check_names

_BEHIND_S = 5.0
"""Maximum seconds at the end to take the messages that arrived before it."""
_QUALITY = 85
_NICENESS = 10
"""Nice value of the recorder: the recorded programs have priority."""
_FOUND_S = 10.0
"""Maximum seconds to wait for topics to be found before the recorder reports that it records them."""


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
    result.add_argument("--zstd", action="store_true", help="compress the chunks of the MCAP file, without loss")
    result.add_argument(
        "--split-size", type=float, metavar="MB", help="start another file after MB megabytes of messages"
    )
    result.add_argument("--split-time", type=float, metavar="S", help="start another file after S seconds")
    result.add_argument(
        "--max-rate",
        nargs="+",
        default=[],
        type=_rate,
        metavar="TOPIC=HZ",
        help="maximum rate of a topic",
    )
    result.add_argument(
        "--allow-missing",
        nargs="+",
        default=[],
        metavar="NAME",
        help=f"topics whose missing messages do not cause exit code {INCOMPLETE}",
    )
    result.add_argument("--keep-free", type=float, default=64.0, metavar="MB", help="end when the disk has less")
    return result


def _rate(text: str) -> tuple[str, float]:
    """Return the topic and the rate of TOPIC=HZ."""
    topic, _, rate = text.rpartition("=")
    if not topic or not 0 < float(rate) < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not TOPIC=HZ with a rate above 0")
    return topic, float(rate)


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 1: the recording ended by an error, INCOMPLETE: messages are missing."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    split = given.index("--ros-args") if "--ros-args" in given else len(given)
    options = parser().parse_args(given[:split])
    path = options.output or default_name(datetime.now())
    try:
        check_bounds(options, duration=(0.0, math.inf), keep_free=(0.0, 1e9))
        check_bounds(options, split_size=(0.001, math.inf), split_time=(0.001, math.inf))
        check_names(options.topics)
        _check_pattern(options.exclude)
        keep_free = round(options.keep_free * 1e6)
        codec = _codec(options)
        if arguments is None:  # a separate program: applies to all threads that it will start
            os.nice(_NICENESS)
        with ros_session(given[split:]) as session:
            sink = BagSink(lambda: _writer(path, options, keep_free), codec, rates_hz=_absolute(options.max_rate))
            account = Account(_absolute((name, 0.0) for name in options.allow_missing))
            try:
                _record(session, sink, path, options, given[split:], account)
            finally:
                sink.close()
    except (BagError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if not _orphaned(options):  # otherwise the output has no reader
        for topic, count in sink.dropped_by_topic.items():
            account.miss(topic, "received, and dropped because the disk or the processor was too slow", count)
        for line in account.lines():
            print(line, file=sys.stderr)
        thinned = f", {sink.thinned} left out by --max-rate" if sink.thinned else ""
        print(f"{path}: {sink.messages} messages, {sink.bytes / 1e6:.1f} MB, {account.count} dropped{thinned}")
    if sink.failure:
        print(f"error: the recording has ended: {sink.failure}", file=sys.stderr)
    if sink.failure:
        return 1
    return 0 if account.complete else INCOMPLETE


def _writer(path: Path, options: argparse.Namespace, keep_free: int) -> BagWriter:
    return BagWriter(
        path,
        options.storage,
        keep_free=keep_free,
        zstd_chunks=options.zstd,
        split_bytes=round(options.split_size * 1e6) if options.split_size else None,
        split_ns=round(options.split_time * 1e9) if options.split_time else None,
    )


def _absolute(rates: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Return the rates by absolute topic name."""
    return {f"/{name.lstrip('/')}": rate for name, rate in rates}


def default_name(begun: datetime) -> Path:
    """Return the default folder of a recording, to the microsecond: two recordings may start at once."""
    return Path(f"bag_{begun:%Y_%m_%d-%H_%M_%S_%f}")


def _codec(options: argparse.Namespace) -> PictureCodec | None:
    if options.quality is not None and options.compress != "jpeg":
        raise ValueError(f"--quality {options.quality} is of JPEG; expected --compress jpeg")
    quality = _QUALITY if options.quality is None else options.quality
    return PictureCodec(options.compress, quality) if options.compress else None


def _orphaned(options: argparse.Namespace) -> bool:
    return options.child_of is not None and os.getppid() != options.child_of


def _check_pattern(exclude: str) -> None:
    try:
        re.compile(exclude)
    except re.error as error:
        raise ValueError(f"--exclude {exclude!r} is no regular expression: {error}") from error


def _record(
    session: RosSession,
    sink: BagSink,
    path: Path,
    options: argparse.Namespace,
    arguments: Sequence[str],
    account: Account,
) -> None:
    line = ProgressLine()
    node = BagRecorder(sink, options.topics, options.exclude, arguments=arguments, account=account)
    session.executor.add_node(node)
    start_s, said = time.monotonic(), False
    try:
        while session.goes_on and not sink.failure and (now_s := time.monotonic()) - start_s < options.duration:
            if _orphaned(options):
                break
            session.spin()
            if not said and (node.listens or now_s - start_s > _FOUND_S):
                # The parent may send SIGINT from now on.
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
        node.account_for_losses()
    finally:
        line.end()
        session.end(node)


def catch_up(node: BagRecorder) -> None:
    """Take the messages received so far: on a busy computer those of the last seconds still wait."""
    until_s = time.monotonic() + _BEHIND_S
    while node.take() and time.monotonic() < until_s:
        pass


if __name__ == "__main__":
    raise SystemExit(main())
