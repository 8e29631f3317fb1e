"""Records the session to a bag, by the program bag_record in a process of its own, so that the page never waits."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

from scope_ui_bridge.adapters.graph_port import GraphError

_END_S = 10.0


def bag_record() -> Path:
    """Return the program, which is installed beside this one."""
    return Path(sys.argv[0]).resolve().parents[3] / "scope_bench" / "lib" / "scope_bench" / "bag_record"


class Recorder:
    """At most one recording at a time.

    Parameters
    ----------
    folder
        Where the sessions go, each in a folder named by its time; empty = nothing can be recorded.
    """

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder).expanduser() if folder else None
        self._process: subprocess.Popen[bytes] | None = None
        self._output = Path()

    def start(self) -> str:
        """Begin, and return where; GraphError when it cannot be."""
        if self._folder is None:
            raise GraphError("record_folder is empty: nothing is recorded here")
        if self._process is not None and self._process.poll() is None:
            raise GraphError(f"already recording to {self._output}")
        program = bag_record()
        if not program.is_file():
            raise GraphError("bag_record is not installed beside this program")
        self._output = self._folder / time.strftime("%Y-%m-%d_%H-%M-%S")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._process = subprocess.Popen(
                [str(program), "-o", str(self._output), "--compress", "jpeg"], stdout=subprocess.DEVNULL
            )
        except OSError as error:
            raise GraphError(f"cannot record to {self._output}: {error}") from error
        return f"recording to {self._output}"

    def end(self) -> str:
        """Ask the recording to end, which it does by itself with a whole bag; return where it is."""
        if self._process is None or self._process.poll() is not None:
            raise GraphError("nothing is being recorded")
        self._process.send_signal(signal.SIGINT)
        return f"recorded to {self._output}"

    def close(self) -> None:
        """End with the bridge."""
        if self._process is None:
            return
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
