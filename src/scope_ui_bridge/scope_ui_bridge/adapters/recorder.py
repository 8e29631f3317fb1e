"""Record the session to a bag with bag_record in a separate process, so that the page never waits."""

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
from icu_common.core.reasons.message import Message, joined
from scope_ui_bridge.adapters.graph_port import GraphUnavailable

_LOG = logging.getLogger(__name__)
_ERROR = "error: "
_INCOMPLETE = 3
"""Exit code of bag_record for a complete bag in which messages are missing; its summary has their number."""
_FOR_VIEWERS = "|".join(
    (
        r"/(disparity|dense_points|points2|panel_plane|panel_plane_estimate)$",
        r"/(left|right)/(corners_image|edges)$",
        r"/panel/points$",
    )
)
"""Topics computed from the images only while a node subscribes, and not shown by the page."""
Answered = Callable[[bool, str], None]


class Recorder:
    """At most one recording at a time.

    The program takes time to start, and at its end to write its queue. A signal before its handler is installed would
    end it without a bag. So a thread gives the answers when the program reports that it records and when it has ended.

    Parameters
    ----------
    folder
        Folder for the sessions, each in a subfolder named by its time; empty = no recording.
    program
        Recording program; bag_record by default.
    end_s
        Maximum seconds that the bridge's end waits for a complete bag.
    ended
        Called in a thread when a recording has ended by itself, for example before the disk is full.
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
        """Node name of the program, unique because the graph may have other recorders."""
        self.recording: tuple[str, float] | None = None
        """User who started the current recording, and its start (monotonic); None if there is none."""

    def start(self, answered: Answered, who: str = "") -> None:
        """Start, and answer with the path once it records; GraphUnavailable if it cannot start."""
        if self._folder is None:
            raise GraphUnavailable(Message("record.record_folder_empty_nothing_recorded"))
        with self._change:
            if self._process is not None and self._process.poll() is None:
                raise GraphUnavailable(Message("record.already_recording", output=self._output))
            try:
                program = self._program or find_executable("icu_bringup", "bag_record", Path(sys.argv[0]))
            except FileNotFoundError as error:
                raise GraphUnavailable(Message("record.bag_record_not_installed_beside")) from error
            self._output = self._folder / f"{datetime.now():%Y-%m-%d_%H-%M-%S-%f}"
            command = [str(program), "-o", str(self._output), "--compress", "jpeg", "--exclude", _FOR_VIEWERS]
            command += ["--child-of", str(os.getpid())]  # the next bridge after a killed one has no record of it
            command += ["--ros-args", "-r", f"__node:={self.node_name}"]
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
                # In memory, because the disk may be full; no pipe, because the program must be able to write if the
                # bridge is killed.
                errors = os.fdopen(os.memfd_create("bag_record"), "w+", errors="replace")
                self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True)
                give_up_real_time(self._process.pid)  # it compresses images on all processors
            except OSError as error:
                raise GraphUnavailable(Message("record.cannot_record", output=self._output, error=error)) from error
            self._records, self._ended, self._who = False, None, who
            follow = (self._process, self._output, errors, answered)
            threading.Thread(target=self._follow, args=follow, name="recorder", daemon=True).start()

    def end(self, answered: Answered) -> None:
        """End the recording; answer with its contents once the bag is complete; GraphUnavailable if there is none."""
        with self._change:
            if self._process is None or self._process.poll() is not None:
                raise GraphUnavailable(Message("record.nothing_being_recorded"))
            if self._ended is not None:
                raise GraphUnavailable(Message("record.being_finished_already", output=self._output))
            self._ended = answered
            if self._records:
                self._process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """End the recording at the bridge's end."""
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
                if self._process is process:  # else it has failed and another program runs already
                    self._records = records
                    self.recording = (self._who, time.monotonic()) if records else None
                if records and self._ended is not None:
                    process.send_signal(signal.SIGINT)
            if records:
                started(True, Message("record.recording", output=output))
            summary = said.read().strip()
        whole = process.wait() in (0, _INCOMPLETE)
        with self._change:
            if self._process is process:
                self.recording = None
        why = joined(
            filter(None, [Message("record.bag_record_ended", returncode=process.returncode), summary, *_told(errors)])
        )
        if not records:
            started(False, why)
        with self._change:
            # Another recording may have started after this one ended by itself.
            ended = self._ended if self._process is process else None
        if ended is None and records:
            ended = self._ended_alone
        if ended is not None:
            ended(whole, Message("record.recorded", summary=summary) if whole else why)


def _told(errors: TextIO) -> list[str]:
    """Copy the program's error output to the log, and return its errors."""
    with errors:
        errors.seek(0)
        text = errors.read()
    sys.stderr.write(text)
    return [line.removeprefix(_ERROR) for line in text.splitlines() if line.startswith(_ERROR)]
