"""Replay bags in step through perception and controller, and compare the results with an expectation.

bag_check BAG --make writes the expectation from repeated replays; bag_check BAG compares with it. A report (table,
Markdown, JUnit XML, JSON, pictures of differences) goes to the folder of --out.

Exit codes: 0 as expected, 1 different, 2 the check could not run.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from icu_bringup.adapters.bag.bag_pictures import IMAGE
from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.adapters.bag.ros1 import is_ros1
from icu_bringup.adapters.check.messages import read_messages, write_expected
from icu_bringup.adapters.check.pictures import draw
from icu_bringup.adapters.check.prepared_bag import converted, played_topics, prepared
from icu_bringup.adapters.check.replay import PROFILE, Replay, ReplayError, Topics, free_domain
from icu_bringup.core.check.comparison import Row, TopicMessages, compare, new_topic, unknown_fields
from icu_bringup.core.check.expectation import Expectation, Run, from_yaml, to_yaml
from icu_bringup.core.check.report import as_json, junit, junit_error, markdown, table, verdict
from icu_bringup.core.startup.graph_description import GraphDescriptionError, load_graph
from icu_bringup.nodes.graph_topics import types_of
from icu_common.adapters.configuration_folder import configuration_folder
from icu_common.adapters.processes.program_end import end_signals, ends_quietly
from icu_common.core.configuration.option_bounds import check_bounds, named_path

AS_EXPECTED, DIFFERENT, COULD_NOT_RUN = 0, 1, 2
EXPECTATION = ".expect.yaml"
_CUE = "/bag/cue"
"""Services that the player calls."""
_MOST_ROWS = 30


class CheckError(Exception):
    """The check could not run; the text states the reason and a remedy."""


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(
        prog="bag_check", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument(
        "bags",
        type=named_path,
        nargs="+",
        metavar="BAG",
        help=f"folder with metadata.yaml, or a .mcap, .db3 or .bag file; or its {EXPECTATION}",
    )
    result.add_argument(
        "--expect", type=named_path, metavar="FILE", help=f"expectation (default: BAG{EXPECTATION} next to the bag)"
    )
    result.add_argument(
        "--make", action="store_true", help="write the expectation; of one that exists, options and tolerances are kept"
    )
    result.add_argument("--runs", type=int, default=2, metavar="N", help="replays for --make (default: %(default)s)")
    result.add_argument("--out", type=named_path, metavar="FOLDER", help="folder for the report (default: bag_check)")
    result.add_argument("-j", "--jobs", type=int, default=1, metavar="N", help="bags at a time (default: %(default)s)")
    result.add_argument("--all", action="store_true", help="print all fields, not only those that differ")
    result.add_argument("--config", type=named_path, metavar="FOLDER", help="folder with graph.yaml")
    result.add_argument(
        "--set", action="append", default=[], metavar="PROGRAM.PARAMETER=VALUE", help="a parameter; --make keeps it"
    )
    made = result.add_argument_group("with --make: how the bag is replayed, kept in the expectation")
    made.add_argument("--nodes", nargs="+", default=[], metavar="NAME", help=f"programs (default: all of {PROFILE})")
    made.add_argument("--scope", default="", help="model in config/scopes (default: graph.yaml's)")
    made.add_argument("--moving", action="store_true", help="play the recorded goals and commands to the controller")
    made.add_argument("--exclude", nargs="+", default=[], metavar="TOPIC", help="do not play these")
    made.add_argument(
        "--topics", nargs="+", default=[], metavar="TOPIC", help="compare these (default: all results but images)"
    )
    made.add_argument(
        "--every", nargs="+", default=[], type=_every, metavar="TOPIC=N", help="keep each N-th message of a topic"
    )
    made.add_argument("--duration", type=float, default=0.0, metavar="S", help="play only the first S seconds")
    made.add_argument("--left", default="", metavar="TOPIC", help="images of the left camera in the bag")
    made.add_argument("--right", default="", metavar="TOPIC", help="images of the right camera in the bag")
    made.add_argument(
        "--camera-info",
        nargs="+",
        default=[],
        metavar="FILE",
        help="calibrations (left, right) of camera_calibration, where the bag has no camera_info",
    )
    return result


def _every(text: str) -> tuple[str, int]:
    topic, _, number = text.rpartition("=")
    if not topic or not number.isdigit() or not int(number):
        raise argparse.ArgumentTypeError(f"{text!r} is not TOPIC=N with N of at least 1")
    return topic, int(number)


@dataclass(frozen=True, slots=True)
class BagJob:
    """One bag and the files that belong to it."""

    bag: Path
    expect: Path
    out: Path

    @property
    def name(self) -> str:
        """Short name in reports."""
        return self.bag.name


class BagCheck:
    """Replays one bag after the other."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self._stop = threading.Event()
        self._config = (options.config or configuration_folder()).resolve()

    def stop(self) -> None:
        """End as soon as possible."""
        self._stop.set()

    def run(self, job: BagJob) -> int:
        """Check one bag, or make its expectation; return the exit code."""
        begun_s = time.monotonic()
        job.out.mkdir(parents=True, exist_ok=True)
        try:
            with tempfile.TemporaryDirectory(prefix="bag_check_") as temporary:
                if self.options.make:
                    self._make(job, Path(temporary))
                    return AS_EXPECTED
                return self._compare(job, Path(temporary), begun_s)
        except (BagError, CheckError, GraphDescriptionError, ReplayError, TimeoutError, ValueError, OSError) as error:
            print(f"error: {job.name}: {error}", file=sys.stderr, flush=True)
            (job.out / "junit.xml").write_text(junit_error(job.name, str(error)), encoding="utf-8")
            (job.out / "summary.md").write_text(f"### ❌ {job.name}: could not run\n\n{error}\n", encoding="utf-8")
            return COULD_NOT_RUN

    # --- making ------------------------------------------------------------------------------------------------------

    def _make(self, job: BagJob, temporary: Path) -> None:
        options = self.options
        old = _read_expectation(job.expect) if job.expect.exists() else None
        run = old.run if old is not None else Run()
        given = _given(options, job.expect.parent)
        run = dataclasses.replace(run, **given, settings=_merged(run.settings, options.set))
        compared = options.topics or (list(old.topics) if old is not None else [])
        results = [self._replay(job, run, temporary / str(n), compared) for n in range(options.runs)]
        runs = [read_messages(result) for result in results]
        every = {name: topic.every for name, topic in old.topics.items()} if old is not None else {}
        every |= dict(options.every)
        if unknown := set(every) - set(runs[0]):
            raise CheckError(f"--every {', '.join(sorted(unknown))}: no such result; there are {', '.join(runs[0])}")
        topics = {}
        for name, first in runs[0].items():
            if not first.messages:
                print(f"{job.name}: {name}: no message, not compared", flush=True)
                continue
            found = [other.get(name, TopicMessages(type=first.type)) for other in runs]
            topics[name] = new_topic(found, every.get(name, 1), old.topics.get(name) if old is not None else None)
        if not topics:
            raise CheckError("the replay has no results: does the bag have what the nodes read?")
        messages = job.expect.with_name(job.expect.name.removesuffix(".yaml") + "_messages")
        write_expected(results[0], messages, {name: topic.every for name, topic in topics.items()})
        expectation = Expectation(bag=job.name, messages=messages.name, run=run, topics=topics)
        job.expect.write_text(to_yaml(expectation), encoding="utf-8")
        count = sum(topic.messages for topic in topics.values())
        print(f"{job.name}: {job.expect} expects {count} messages of {len(topics)} topics ({options.runs} runs)")

    # --- comparing ---------------------------------------------------------------------------------------------------

    def _compare(self, job: BagJob, temporary: Path, begun_s: float) -> int:
        expectation = _read_expectation(job.expect)
        expected = read_messages(job.expect.parent / expectation.messages, expectation.topics)
        if strange := unknown_fields(expectation, expected):
            raise CheckError(f"{job.expect}: no expected message has {', '.join(strange)}")
        run = dataclasses.replace(expectation.run, settings=_merged(expectation.run.settings, self.options.set))
        results = self._replay(job, run, temporary / "run", list(expectation.topics))
        found = read_messages(results, expectation.topics)
        rows = compare(expectation, expected, found)
        bag = self._prepared(job, run, temporary)
        self._report(job, rows, expected, found, bag, time.monotonic() - begun_s)
        return AS_EXPECTED if all(row.passed for row in rows) else DIFFERENT

    def _report(
        self,
        job: BagJob,
        rows: Sequence[Row],
        expected: Mapping[str, TopicMessages],
        found: Mapping[str, TopicMessages],
        bag: Path,
        seconds: float,
    ) -> None:
        pictures = draw(rows, expected, found, bag, job.out)
        (job.out / "junit.xml").write_text(junit(job.name, rows, seconds), encoding="utf-8")
        (job.out / "summary.md").write_text(markdown(job.name, rows, pictures), encoding="utf-8")
        (job.out / "fields.json").write_text(json.dumps(as_json(rows), indent=1), encoding="utf-8")
        (job.out / "table.txt").write_text(table(rows) + "\n", encoding="utf-8")
        shown = [row for row in rows if self.options.all or not row.passed]
        if shown:
            print(table(shown if self.options.all else shown[:_MOST_ROWS]))
        if not self.options.all and len(shown) > _MOST_ROWS:
            print(f"{len(shown) - _MOST_ROWS} more in {job.out / 'table.txt'}")
        for name in pictures:
            print(f"picture: {job.out / name}")
        print(f"{verdict(job.name, rows)}; {seconds:.0f} s, report in {job.out}", flush=True)

    # --- replaying ---------------------------------------------------------------------------------------------------

    def _prepared(self, job: BagJob, run: Run, temporary: Path) -> Path:
        bag = job.bag
        if is_ros1(bag):
            bag = next(iter(temporary.glob("*_ros2")), None) or converted(bag, temporary)
        return next(iter(temporary.glob("*_renamed")), None) or prepared(bag, run, temporary, job.expect.parent)

    def _replay(self, job: BagJob, run: Run, folder: Path, compared: Sequence[str]) -> Path:
        """Replay the bag with a new graph; return the bag with the results."""
        bag = self._prepared(job, run, folder.parent)
        with BagReader(bag) as reader:  # before any program is started
            if not reader.count:
                raise CheckError("the bag has no messages")
            whole_s = min(reader.duration_ns / 1e9, run.duration_s or math.inf)
        count, left_out = self._programs(run, folder)
        domain = free_domain()
        replay = Replay(folder, domain, run, count, left_out, self._config)
        try:
            graph = replay.wait_until_started(self._stop)
            played = played_topics(bag, {*graph.read, _CUE}, graph.published, run.exclude)
            record = self._recorded(graph, compared, domain)
            print(f"{job.name}: playing {len(played)} topics to {count} nodes", flush=True)
            begun_s = time.monotonic()
            done = replay.play(bag, played, record, self._stop)
            begin_and_end_s = time.monotonic() - begun_s - done.playing_s
            print(
                f"{job.name}: {whole_s:.1f} s of recording played in {done.playing_s:.1f} s "
                f"(start and end of player and recorder: {begin_and_end_s:.1f} s more)",
                flush=True,
            )
            return done.results
        except ReplayError:
            shutil.copytree(
                folder, job.out / "logs", dirs_exist_ok=True, ignore=shutil.ignore_patterns("run", "*.mcap")
            )
            raise
        finally:
            replay.stop()

    def _recorded(self, graph: Topics, compared: Sequence[str], domain: int) -> list[str]:
        if unknown := set(compared) - graph.published:
            there = ", ".join(sorted(graph.published)) or "nothing"
            raise CheckError(f"no node publishes {', '.join(sorted(unknown))}; they publish {there}")
        if compared:
            return list(compared)
        types = types_of(graph.published, domain, self._stop)
        return sorted(name for name, kind in types.items() if kind != IMAGE)

    def _programs(self, run: Run, folder: Path) -> tuple[int, list[str]]:
        """Return how many programs run, and the names of those that are left out."""
        every = load_graph(self._config, PROFILE, run=folder / "run", state=folder / "state", scope=run.scope)
        names = [program.name for program in every]
        if unknown := set(run.nodes) - set(names):
            raise CheckError(f"no node {', '.join(sorted(unknown))}; there are {', '.join(names)}")
        left_out = [name for name in names if run.nodes and name not in run.nodes]
        return len(names) - len(left_out), left_out


def _read_expectation(file: Path) -> Expectation:
    try:
        return from_yaml(file.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise CheckError(f"{file} does not exist; make it with: bag_check BAG --make") from error
    except (ValueError, UnicodeDecodeError) as error:
        raise CheckError(f"{file}: {error}") from error


def _merged(settings: Sequence[str], given: Sequence[str]) -> tuple[str, ...]:
    """Return settings with those of the command line; the last value of a parameter applies."""
    return tuple({text.partition("=")[0]: text for text in (*settings, *given)}.values())


def _given(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Return the values of a Run that were given on the command line; files are relative to ``folder``."""
    values = {
        "nodes": tuple(options.nodes),
        "scope": options.scope,
        "moving": options.moving,
        "exclude": tuple(options.exclude),
        "left": options.left,
        "right": options.right,
        "camera_info": tuple(os.path.relpath(Path(file).resolve(), folder) for file in options.camera_info),
        "duration_s": options.duration,
    }
    return {name: value for name, value in values.items() if value}


_KEPT = ("nodes", "scope", "moving", "exclude", "topics", "every", "duration", "left", "right", "camera_info")
"""Options that are read from the expectation."""


def _jobs(options: argparse.Namespace) -> list[BagJob]:
    given = [f"--{name.replace('_', '-')}" for name in _KEPT if getattr(options, name)]
    if given and not options.make:
        raise CheckError(f"{', '.join(given)}: the expectation has these; give them with --make")
    if options.expect is not None and len(options.bags) > 1:
        raise CheckError(f"--expect is for one bag; {len(options.bags)} are given, each with BAG{EXPECTATION}")
    out = options.out or Path("bag_check")
    jobs = []
    for bag in options.bags:
        # An expectation stands for its bag: bags/*.expect.yaml selects all bags that can be checked.
        bag = bag.with_name(bag.name.removesuffix(EXPECTATION)).resolve()
        expect = options.expect or bag.with_name(bag.name + EXPECTATION)
        jobs.append(BagJob(bag=bag, expect=expect.resolve(), out=(out if len(options.bags) == 1 else out / bag.name)))
    return jobs


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = parser().parse_args(arguments)
    try:
        check_bounds(options, runs=(2, 20), jobs=(1, 32), duration=(0, math.inf))
        jobs = _jobs(options)
        check = BagCheck(options)
    except (CheckError, FileNotFoundError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return COULD_NOT_RUN

    def stop(number: int, frame: FrameType | None) -> None:
        check.stop()

    for number in end_signals():
        signal.signal(number, stop)
    try:
        with ThreadPoolExecutor(options.jobs) as pool:
            return max(pool.map(check.run, jobs))
    except Exception:
        traceback.print_exc()
        return COULD_NOT_RUN  # 1, Python's own code, would mean that the results differ


if __name__ == "__main__":
    raise SystemExit(main())
