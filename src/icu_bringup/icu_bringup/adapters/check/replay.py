"""A replay in step as processes: bring-up with the profile ``replay``, a recorder of the results, and a player."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from icu_bringup.adapters.graph_names import hold, is_held
from icu_bringup.core.check.expectation import Run
from icu_common.adapters.processes.process_identity import is_alive
from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE, StepLedger, ledger_path

DOMAINS = range(40, 100)
"""ROS domains of replays: above 101 their ports may be taken by outgoing connections."""
PROFILE = "replay"
_STARTED_S, _ENDED_S = 120.0, 60.0
_LOOK_S = 0.05
_LAST_LINES = 15
FASTEST = 1000.0
"""Speed of a replay that is limited by the graph alone."""


NOT_COMPARED = ("/rosout", "/parameter_events", "/diagnostics", "/clock")
"""Topics of every node, whose contents depend on the computer or come from the player."""


@dataclass(frozen=True, slots=True)
class Topics:
    """Absolute names of the topics that a graph's programs read and publish."""

    read: frozenset[str]
    published: frozenset[str]


@dataclass(frozen=True, slots=True)
class Played:
    """Bag with the results of a replay, and seconds from the first played message to the results of the last one."""

    results: Path
    playing_s: float


class ReplayError(Exception):
    """A replay could not run; the text states the reason."""


def free_domain() -> int:
    """Return a ROS domain that no other replay or graph on this computer uses, until this process ends.

    The graph of a replay whose bag_check was killed continues for a while.

    Raises
    ------
    ReplayError
        If there is none.
    """
    for domain in DOMAINS:
        if not is_held(f"{domain}/") and hold(f"replay/{domain}"):
            return domain
    raise ReplayError(f"replays run in ROS domains {DOMAINS[0]} to {DOMAINS[-1]}: end one of them")


class Replay:
    """The processes of one graph that replays bags.

    Parameters
    ----------
    folder
        Folder of the logs and the recorded results.
    domain
        Its ROS domain.
    run
        Nodes and settings.
    count, without
        Number of programs that run, and the names of those that are left out.
    config
        Folder with graph.yaml.
    """

    def __init__(self, folder: Path, domain: int, run: Run, count: int, without: Sequence[str], config: Path) -> None:
        self.folder, self._run, self._count = folder, run, count
        self._ledger = ledger_path(str(domain), "")
        self._environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_LOG_DIR": str(folder / "ros_log"),
            "PYTHONUNBUFFERED": "1",
        }
        self._environment[LEDGER_VARIABLE] = str(self._ledger)
        arguments = ["--profile", PROFILE, "--in-step", "--verbose"]
        arguments += ["--state", str(folder / "state"), "--run-dir", str(folder / "run")]
        arguments += ["--config", str(config)]
        arguments += [f"--scope={run.scope}"] if run.scope else []
        arguments += [part for name in without for part in ("--without", name)]
        arguments += [part for text in run.settings for part in ("--set", text)]
        folder.mkdir(parents=True, exist_ok=True)
        self._log = folder / "bring_up.log"
        self._graph = self._start("bring_up", arguments, self._log)

    def _start(self, program: str, arguments: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
        # Bring-up finds the programs of the other packages relative to its own installation.
        with log.open("wb") as output:
            return subprocess.Popen(
                [str(Path(sys.argv[0]).resolve().with_name(program)), *arguments],
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # only this program reacts to Ctrl-C, and ends the others in order
            )

    def wait_until_started(self, stop: threading.Event) -> Topics:
        """Wait until every program of the graph serves its callbacks, and return what they read and publish.

        Raises
        ------
        ReplayError
            If a program ends, or they are not ready in time.
        """
        found: list[Topics] = []

        def started() -> bool:
            if (topics := self._topics()) is not None:
                found.append(topics)
            return bool(found)

        self._wait(started, "programs have not started", stop)
        return found[0]

    def play(
        self,
        bag: Path,
        topics: Sequence[str],
        record: Sequence[str],
        stop: threading.Event,
        *,
        rate: float = FASTEST,
    ) -> Played:
        """Play topics of a bag and record the results.

        Parameters
        ----------
        bag, topics, record
            Bag, its topics that are played, and the topics that are recorded.
        stop
            Ends the replay when it is set.
        rate
            Speed; messages that are still being processed are waited for at any speed.

        Raises
        ------
        ReplayError
            If a program ends with an error, or messages are lost.
        """
        out = self.folder / "results"
        recorder = self._start("bag_record", [*record, "-o", str(out)], self.folder / "record.log")
        try:
            self._wait(
                lambda: self._subscribed(recorder.pid, record), "the recorder has not subscribed", stop, recorder
            )
            arguments = [str(bag), "--in-step", str(self._count + 1), "--rate", f"{rate:g}", "--topics", *topics]
            arguments += ["--moving"] if self._run.moving else []
            arguments += ["--duration", f"{self._run.duration_s:g}"] if self._run.duration_s else []
            player = self._start("bag_play", arguments, self.folder / "play.log")
            begun_s: float | None = None
            try:
                while player.poll() is None:
                    self._check(stop)
                    if begun_s is None and self._has_begun(topics):
                        begun_s = time.monotonic()
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        player.wait(_LOOK_S)
            finally:
                _end(player)
            playing_s = 0.0 if begun_s is None else time.monotonic() - begun_s
            if player.returncode:
                raise ReplayError(f"bag_play ended with {player.returncode}: {last_line(self.folder / 'play.log')}")
        finally:
            code = _end(recorder)
        if code:
            raise ReplayError(f"bag_record ended with {code}: {last_line(self.folder / 'record.log')}")
        return Played(out, playing_s)

    def _has_begun(self, topics: Sequence[str]) -> bool:
        """Return whether a node has finished a message of these topics."""
        with self._counts() as ledger:
            return ledger is not None and any(ledger.finished(name) for name in {*topics} & {*ledger.topics()})

    def _check(self, stop: threading.Event) -> None:
        if stop.is_set():
            raise ReplayError("interrupted")
        if (code := self._graph.poll()) is not None:
            raise ReplayError(f"the graph ended with {code}: {last_line(self._log)}")

    def _wait(
        self,
        done: Callable[[], bool],
        what: str,
        stop: threading.Event,
        process: subprocess.Popen[bytes] | None = None,
    ) -> None:
        end_s = time.monotonic() + _STARTED_S
        while not done():
            self._check(stop)
            if process is not None and process.poll() is not None:
                raise ReplayError(f"{what}: {last_line(self.folder / 'record.log')}")
            if time.monotonic() > end_s:
                raise ReplayError(f"{what} within {_STARTED_S:g} s: {last_line(self._log)}")
            stop.wait(_LOOK_S)

    def _topics(self) -> Topics | None:
        """Return the topics of the programs; None while one of them does not serve its callbacks yet."""
        with self._counts() as ledger:
            if ledger is None:
                return None
            rows = [row for row, process in ledger.processes().items() if is_alive(process)]
            # A program writes the matches of its publishers one by one, after it has begun to serve callbacks.
            if len(rows) < self._count or not all(ledger.is_shown(row) for row in rows):
                return None
            names = np.array(ledger.topics())
            _, subscriptions, matched = ledger.by_process()
        read, published = (names[table[rows].any(axis=0)].tolist() for table in (subscriptions, matched))
        return Topics(read=frozenset(read), published=frozenset(published) - {*NOT_COMPARED})

    def _subscribed(self, pid: int, topics: Sequence[str]) -> bool:
        with self._counts() as ledger:
            if ledger is None:
                return False
            rows = [row for row, process in ledger.processes().items() if process == pid]
            names = ledger.topics()
            if not rows or not set(topics) <= set(names):
                return False
            counts = ledger.by_process()[1][rows[0]]
            return bool(np.all([counts[names.index(topic)] > 0 for topic in topics]))

    @contextlib.contextmanager
    def _counts(self) -> Iterator[StepLedger | None]:
        if not self._ledger.is_file():
            yield None
            return
        with contextlib.closing(StepLedger(self._ledger)) as ledger:
            yield ledger

    def tail(self) -> str:
        """Return the last lines of the graph's log."""
        lines = self._log.read_text(encoding="utf-8", errors="replace").splitlines()
        return "\n".join(lines[-_LAST_LINES:])

    def stop(self) -> int:
        """End all programs and return bring-up's exit code."""
        return _end(self._graph)


def _end(process: subprocess.Popen[bytes]) -> int:
    """End a program as Ctrl-C does, or kill it if that takes too long; return its exit code."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(_ENDED_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    return process.returncode


def last_line(log: Path) -> str:
    """Return the last non-empty line of a log; if it has error lines, the last of these."""
    lines = [line for line in log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower() or line.startswith("missing:")]
    return (errors or lines or ["no output"])[-1].strip()
