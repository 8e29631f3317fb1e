"""Play a rosbag2 bag, of this project or of `ros2 bag`; space pauses, Ctrl-C ends it.

Topics that move a machine are played only with --moving, because a real robot would obey them. Without it, trajectories
are published on gantry/recorded_trajectory, for pages that show them.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Sequence

from rclpy.qos import DurabilityPolicy

from icu_bringup.adapters.bag.bag_pictures import SUFFIX
from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagError, BagTopic
from icu_bringup.cli.progress import ProgressLine
from icu_bringup.core.bag.account import INCOMPLETE, Account
from icu_bringup.core.bag.play_clock import PlayClock, progress_bar
from icu_bringup.nodes.bag_player import ASIDE, MOVING, BagPlayer
from icu_bringup.nodes.bag_qos import playing_qos
from icu_bringup.nodes.bag_types import type_problem
from icu_bringup.nodes.step_player import StepPlayer
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE, ledger_path
from icu_common.adapters.terminal_keys import terminal_keys
from icu_common.core.configuration.option_bounds import check_bounds, named_path
from icu_common.nodes.runtime import RosSession, ros_session
from icu_common.nodes.topic_names import name_problem


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="bag_play", description=__doc__, epilog="--ros-args ... as for every node")
    result.add_argument("bag", type=named_path, help="folder with metadata.yaml, or a .mcap or .db3 file")
    result.add_argument("-r", "--rate", type=float, default=1.0, help="speed (default: %(default)s)")
    result.add_argument("-l", "--loop", action="store_true", help="begin anew at the end")
    result.add_argument("-p", "--start-paused", action="store_true", help="wait for space, or ~/toggle_paused")
    result.add_argument("--topics", nargs="+", metavar="NAME", help="only these")
    result.add_argument("--exclude", nargs="+", default=[], metavar="NAME", help="all but these")
    result.add_argument(
        "--start-offset",
        type=float,
        default=0.0,
        metavar="S",
        help="start S seconds later, with the last latched messages",
    )
    result.add_argument("--clock", type=float, metavar="HZ", help="publish /clock so often (default: not at all)")
    result.add_argument("--keep-compressed", action="store_true", help="do not unpack compressed pictures")
    result.add_argument("--moving", action="store_true", help=f"play also {', '.join(MOVING)}")
    result.add_argument(
        "--in-step",
        type=int,
        metavar="N",
        help="wait for N processes of bring_up --in-step at each message (default: play by the clock)",
    )
    result.add_argument(
        "--wait",
        type=float,
        metavar="S",
        help="longest wait for a subscriber of each topic (default: until all running subscribers are matched, "
        f"at most {_FIRST_SUBSCRIBER_S:g} s for the first)",
    )
    result.add_argument(
        "--allow-missing",
        nargs="+",
        default=[],
        metavar="NAME",
        help=f"topics whose missing messages do not cause exit code {INCOMPLETE}",
    )
    result.add_argument(
        "--patience", type=float, default=60.0, metavar="S", help="at most so long for one message in step"
    )
    result.add_argument("--duration", type=float, default=float("inf"), metavar="S", help="play only so much")
    return result


def chosen(bag: BagReader, options: argparse.Namespace, account: Account) -> list[BagTopic]:
    """Return the topics to play; those that cannot be played are missing in the account.

    Raises
    ------
    BagError
        If a named topic is not in the bag, or its type is not installed here.
    """
    names, in_step = {topic.name for topic in bag.topics}, bool(options.in_step)
    own = {"/clock"} if options.clock or in_step else set()  # published by the player itself
    unknown = {*(options.topics or ()), *options.exclude, *options.allow_missing} - names
    if unknown:
        raise BagError(f"{bag.path} has no {', '.join(sorted(unknown))}; it has {', '.join(sorted(names))}")
    wanted = [
        topic
        for topic in bag.topics
        if (options.topics is None or topic.name in options.topics)
        and topic.name not in {*options.exclude, *own}
        and (options.moving or not topic.name.endswith(MOVING) or (topic.name.endswith(tuple(ASIDE)) and not in_step))
    ]
    playable: dict[str, BagTopic] = {}
    for topic in wanted:
        problem = name_problem(topic.name) or type_problem(bag, topic)
        if topic.name in playable:
            problem = f"type {topic.type} differs from {playable[topic.name].type}: a topic is played with one type"
        if not problem:
            playable[topic.name] = topic
            continue
        if options.topics is not None and topic.name not in options.allow_missing:
            raise BagError(f"{topic.name}: {problem}")
        account.miss(topic.name, f"not played: {problem}", topic.count, topic.count)
    for topic in wanted:
        if topic.announced > topic.count:
            reason = "listed in metadata.yaml, but in no file"
            account.miss(topic.name, reason, topic.announced - topic.count, topic.announced)
    return list(playable.values())


_STAMP_ENDS = 12
"""End of the stamp in a message with a header, after four bytes of CDR."""
_LOOKED_AT = 30
"""Number of first messages to compare: a recorder may receive one of two topics slightly later."""


def recorded_twice(bag: BagReader, names: Collection[str]) -> set[str]:
    """Return the topics whose images, by their stamps, are also compressed in the bag.

    These come from image_transport. This project's recorder keeps each image once: compressed, or raw if that fails.
    """

    def stamps(name: str) -> set[bytes]:
        return {data[:_STAMP_ENDS] for _, _, data in itertools.islice(bag.messages([name]), _LOOKED_AT)}

    pairs = [name for name in names if name + SUFFIX in names]
    return {name for name in pairs if stamps(name) & stamps(name + SUFFIX)}


_DRIVER = "gantry/driver_state"
_FIRST_SUBSCRIBER_S, _QUIET_S = 5.0, 0.5
"""Longest wait for a first subscriber, and seconds without a new one before playback starts."""
_DRIVER_FOUND_S, _LOOK_S = 1.0, 0.5
"""Seconds to search for a running driver before playback, and between later checks: discovery takes time."""


class Playing:
    """One run of ``bag_play``, from the start to the exit code."""

    def __init__(
        self, bag: BagReader, options: argparse.Namespace, session: RosSession, keys: Callable[[], str]
    ) -> None:
        self._bag, self._options, self._session, self._keys = bag, options, session, keys
        self.account = Account(options.allow_missing)
        self._topics = chosen(bag, options, self.account)
        self._names = [topic.name for topic in self._topics]
        self._sent: Counter[str] = Counter()
        self._start_ns = bag.start_ns + round(options.start_offset * 1e9)
        self._begin(paused=options.start_paused)
        self._node = BagPlayer(
            self._topics,
            unpack=not options.keep_compressed,
            twice=recorded_twice(bag, self._names),
            in_step=bool(options.in_step),
            aside=not options.moving,
            toggle=self._toggle,
        )
        self._step = StepPlayer(session, self._node, bag, self._names, options.patience) if options.in_step else None
        session.executor.add_node(self._node)
        self._line = ProgressLine()
        self._next_clock_s = self._next_look_s = 0.0
        self.played = 0

    def run(self) -> None:
        """Play until the end or a signal."""
        try:
            lost = {topic for topic, _ in self.account.missing}
            if left_out := sorted({topic.name for topic in self._bag.topics} - {*self._names, *lost}):
                print(f"not played: {', '.join(left_out)}")
            if self._step is not None:
                self._step.begin(self._options.in_step)
                self._refuse_beside_a_machine()
            else:
                self._wait_for_subscribers()
            while self._session.goes_on:
                self._begin(paused=self._clock.paused)  # a user may have paused meanwhile
                before = self.played
                self._play_latched()
                whole = self._play_once()
                if before == 0 and whole:
                    self._compare()
                if not self._options.loop:
                    break
                if self.played == before:
                    self._serve(0.05, self._start_ns)  # an empty loop must not use a whole core
            self._node.settle()
        finally:
            self._line.end()
            self._session.end(self._node)

    def _begin(self, *, paused: bool) -> None:
        self._clock = PlayClock(self._start_ns, self._options.rate, time.monotonic(), paused=paused)

    def _wait_for_subscribers(self) -> None:
        begun_s = changed_s = time.monotonic()
        least_s = begun_s + (0.0 if self._options.moving else _DRIVER_FOUND_S)
        matched: tuple[int, ...] = ()
        while self._session.goes_on:
            self._session.spin(0.02)
            self._refuse_beside_a_machine()
            now_s = time.monotonic()
            if (now := self._node.matched) != matched:
                matched, changed_s = now, now_s
            if now_s < least_s:
                continue
            if self._options.wait is not None:
                if not self._node.unheard or now_s >= begun_s + self._options.wait:
                    return
            elif (now_s >= begun_s + _FIRST_SUBSCRIBER_S and not any(matched)) or (
                any(matched)
                and (quiet_s := now_s - changed_s) >= max(_QUIET_S, changed_s - begun_s)
                and (
                    not self._node.unmatched or quiet_s >= _FIRST_SUBSCRIBER_S  # an incompatible QoS never matches
                )
            ):
                return

    def _refuse_beside_a_machine(self) -> None:
        """Reject playback next to a controller: it would treat recorded data as that of the machine that it moves."""
        if self._options.moving:
            return
        recorded = [topic.name for topic in self._bag.topics if topic.name.endswith(_DRIVER)]
        # Without a recorded driver state, the topics may belong to any robot that has topics of these names.
        for state in recorded or sorted({str(place / _DRIVER) for place in self._node.places}):
            if found := self._node.others(state):
                raise BagError(
                    f"a driver is running here ({found}), and what was recorded would be taken for what its cameras "
                    "see: play it in another ROS_DOMAIN_ID, or with --moving"
                )

    def _play_latched(self) -> None:
        """Send the messages that a subscriber of a latched topic would have at the start offset."""
        if not self._options.start_offset:
            return
        profiles = {topic.name: playing_qos(topic.qos) for topic in self._topics}
        latched = {n: p.depth for n, p in profiles.items() if p.durability is DurabilityPolicy.TRANSIENT_LOCAL}
        before: dict[str, deque[tuple[int, bytes]]] = {name: deque(maxlen=depth) for name, depth in latched.items()}
        topics = [topic for topic in self._topics if topic.name in latched]
        for topic, stamp_ns, data in self._bag.messages(topics, stop_ns=self._start_ns):
            before[topic].append((stamp_ns, data))
        rows = ((stamp_ns, name, data) for name, kept in before.items() for stamp_ns, data in kept)
        for _, name, data in sorted(rows, key=lambda row: row[0]):
            self._play(name, self._start_ns, data)

    def _play(self, topic: str, stamp_ns: int, data: bytes) -> None:
        if self._step is not None:
            self._step.play(topic, stamp_ns, data)
        else:
            self._node.play(topic, data)
        self.played += 1
        self._sent[topic] += 1

    def _play_once(self) -> bool:
        """Play from the start offset; return whether playback reached the end."""
        # Without an offset there is no time limit, so that no stamp excludes a message.
        start_ns = self._start_ns if self._options.start_offset else 0
        for topic, stamp_ns, data in self._bag.messages(self._topics, start_ns):
            while self._session.goes_on and (wait_s := self._clock.wall_s_until(stamp_ns, time.monotonic())) > 0:
                self._serve(min(wait_s, 0.05), stamp_ns)
            if not self._session.goes_on or stamp_ns > self._start_ns + self._options.duration * 1e9:
                return False
            self._play(topic, stamp_ns, data)
            self._serve(0.0, stamp_ns)
        return not start_ns

    def _compare(self) -> None:
        """Compare the numbers of sent messages with those of the files."""
        for topic in self._topics:
            if (short := topic.count - self._sent[topic.name]) > 0:
                self.account.miss(topic.name, "not reachable by the bag's index", short, topic.count)

    def _serve(self, timeout_s: float, newest_ns: int) -> None:
        self._session.spin(timeout_s)
        now_s = time.monotonic()
        if now_s >= self._next_look_s:
            self._next_look_s = now_s + _LOOK_S
            self._refuse_beside_a_machine()
        bag_ns = self._clock.bag_ns(now_s)
        if self._options.clock and now_s >= self._next_clock_s:
            self._next_clock_s = now_s + 1.0 / self._options.clock
            self._node.show_time(bag_ns)
        for _ in range(self._keys().count(" ")):
            self._toggle()
        # If messages are late, as in step with others, the clock is ahead of playback.
        done_s, whole_s = (min(bag_ns, newest_ns) - self._bag.start_ns) / 1e9, self._bag.duration_ns / 1e9
        state = "  paused" if self._clock.paused else ""
        bar = progress_bar(done_s / whole_s if whole_s else 1.0)
        self._line.show(now_s, f"{bar} {done_s:.1f} of {whole_s:.1f} s, {self.played} messages{state}")

    def _toggle(self) -> bool:
        return self._clock.toggle(time.monotonic())


def _namespace(arguments: Sequence[str]) -> str:
    """Return the namespace in ROS arguments such as ``-r __ns:=/bed_1``."""
    return next((text.removeprefix("__ns:=") for text in arguments if text.startswith("__ns:=")), "")


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 1: an error, INCOMPLETE: messages are missing."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    split = given.index("--ros-args") if "--ros-args" in given else len(given)
    options = parser().parse_args(given[:split])
    most = math.inf
    try:
        check_bounds(options, start_offset=(0, most), duration=(0, most), clock=(0.001, 1e4), wait=(0, most))
        check_bounds(options, in_step=(1, most), patience=(0, most))
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if options.in_step:  # bring-up made the ledger of this ROS domain
        os.environ.setdefault(LEDGER_VARIABLE, str(ledger_path(os.environ.get("ROS_DOMAIN_ID", ""), _namespace(given))))
    try:
        with BagReader(options.bag) as bag:
            if options.start_offset > (whole_s := bag.duration_ns / 1e9):
                raise ValueError(f"--start-offset {options.start_offset:g}: the bag has {whole_s:.2f} s")
            with ros_session(given[split:]) as session, terminal_keys() as keys:
                playing = Playing(bag, options, session, keys)
                playing.run()
    except (BagError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    for line in playing.account.lines():
        print(line)
    print(f"{playing.played} messages played")
    return 0 if playing.account.complete else INCOMPLETE


if __name__ == "__main__":
    raise SystemExit(main())
