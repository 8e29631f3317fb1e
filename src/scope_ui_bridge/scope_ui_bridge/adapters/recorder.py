"""Records the session to a bag, by the program bag_record in a process of its own, so that the page never waits."""

from __future__ import annotations

import logging
import os
import secrets
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TextIO

from icu_common.adapters.executables import find_executable
from icu_common.adapters.real_time import give_up_real_time
from scope_ui_bridge.adapters.graph_port import GraphError

_LOG = logging.getLogger(__name__)
_ERROR = "error: "
_INCOMPLETE = 3
"""Exit code of bag_record for a whole bag in which messages are missing; its summary has their number."""
_FOR_VIEWERS = "|".join(
    (
        r"/(disparity|dense_points|points2|panel_plane|panel_plane_estimate)$",
        r"/(left|right)/(corners_image|edges)$",
        r"/panel/points$",
    )
)
"""What is computed from the pictures, only while somebody listens, and not shown by the page."""
Answered = Callable[[bool, str], None]


class Recorder:
    """At most one recording at a time.

    The program takes a while to start, and to write what waits at its end; a signal before it listens would end it
    without a bag. So the answers are given, in a thread, when it says that it records and when it has ended.

    Parameters
    ----------
    folder
        Where the sessions go, each in a folder named by its time; empty = nothing can be recorded.
    program
        What records; bag_record, unless another one is given.
    end_s
        How long the end of the bridge waits for a whole bag.
    ended
        Called, in a thread, when a recording has ended without having been asked to, as before the disk is full.
    """

    def __init__(
        self,
        folder: str,
        program: Path | None = None,
        end_s: float = 10.0,
        ended: Answered = lambda success, text: None,
    ) -> None:
        self._end_s = end_s
        self._ended_alone = ended
        self._folder = Path(folder).expanduser() if folder else None
        self._program = program
        self._change = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._output = Path()
        self._records = False
        self._ended: Answered | None = None
        self._who = ""
        self.node_name = f"bag_recorder_{secrets.token_hex(4)}"
        """Of the program in the graph, where other recorders may be."""
        self.recording: tuple[str, float] | None = None
        """Who has started the recording that runs, and when it began (monotonic); None while there is none."""

    def start(self, answered: Answered, who: str = "") -> None:
        """Begin, and answer where once it records; GraphError when it cannot be."""
        if self._folder is None:
            raise GraphError("record_folder is empty: nothing is recorded here")
        with self._change:
            if self._process is not None and self._process.poll() is None:
                raise GraphError(f"already recording to {self._output}")
            try:
                program = self._program or find_executable("scope_bench", "bag_record", Path(sys.argv[0]))
            except FileNotFoundError as error:
                raise GraphError("bag_record is not installed beside this program") from error
            self._output = self._folder / f"{datetime.now():%Y-%m-%d_%H-%M-%S-%f}"
            command = [str(program), "-o", str(self._output), "--compress", "jpeg", "--exclude", _FOR_VIEWERS]
            command += ["--child-of", str(os.getpid())]  # whoever comes after a killed bridge does not know of it
            command += ["--ros-args", "-r", f"__node:={self.node_name}"]
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                # In memory, as the disk may be full; no pipe, as who outlives a killed bridge must be able to write.
                errors = os.fdopen(os.memfd_create("bag_record"), "w+", errors="replace")
                self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
                give_up_real_time(self._process.pid)  # it compresses pictures, on as many processors as there are
            except OSError as error:
                raise GraphError(f"cannot record to {self._output}: {error}") from error
            self._records, self._ended, self._who = False, None, who
            follow = (self._process, self._output, errors, answered)
            threading.Thread(target=self._follow, args=follow, name="recorder", daemon=True).start()

    def end(self, answered: Answered) -> None:
        """Ask the recording to end, and answer what it holds once the bag is whole; GraphError when there is none."""
        with self._change:
            if self._process is None or self._process.poll() is not None:
                raise GraphError("nothing is being recorded")
            if self._ended is not None:
                raise GraphError(f"{self._output} is being finished already")
            self._ended = answered
            if self._records:
                self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """End with the bridge."""
        with self._change:
            process = self._process
        if process is None:
            return
        process.send_signal(signal.SIGINT)
        try:
            process.wait(self._end_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            _LOG.warning("%s was cut off; save it with: bag_info %s --repair NEW_BAG", self._output, self._output)

    def _follow(self, process: subprocess.Popen[str], output: Path, errors: TextIO, started: Answered) -> None:
        assert process.stdout is not None
        with process.stdout as said:
            records = bool(said.readline())
            with self._change:
                if self._process is process:  # else it has failed, and another one runs already
                    self._records = records
                    self.recording = (self._who, time.monotonic()) if records else None
                if records and self._ended is not None:
                    process.send_signal(signal.SIGINT)
            if records:
                started(True, f"recording to {output}")
            summary = said.read().strip()
        whole = process.wait() in (0, _INCOMPLETE)
        with self._change:
            if self._process is process:
                self.recording = None
        why = "; ".join(filter(None, [f"bag_record ended with {process.returncode}", summary, *_told(errors)]))
        if not records:
            started(False, why)
        with self._change:
            # Another recording may have begun when this one ended by itself.
            ended = self._ended if self._process is process else None
        if ended is None and records:
            ended = self._ended_alone
        if ended is not None:
            ended(whole, f"recorded to {summary}" if whole else why)


def _told(errors: TextIO) -> list[str]:
    """Pass on what the program said to the log, and return its errors."""
    with errors:
        errors.seek(0)
        text = errors.read()
    sys.stderr.write(text)
    return [line.removeprefix(_ERROR) for line in text.splitlines() if line.startswith(_ERROR)]
