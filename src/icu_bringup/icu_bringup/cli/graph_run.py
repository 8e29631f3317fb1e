"""One run of the graph for bring_up: starts the programs, follows the preparation, and ends all programs."""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from pathlib import Path

from icu_bringup.adapters.fork_server import ForkServer
from icu_bringup.adapters.processes import ProcessGroup
from icu_bringup.adapters.screen import Screen
from icu_bringup.core.startup.graph_description import Program
from icu_bringup.core.startup.qr_code import qr_modules
from icu_bringup.core.startup.run_words import (
    RemainingTime,
    Status,
    failure,
    next_step,
    preparing,
    repeats_by_itself,
    starting,
)
from icu_bringup.core.startup.terminal_layout import Box
from icu_common.adapters.executables import find_executable
from icu_common.adapters.processes.hanging_programs import write_hanging
from icu_common.adapters.processes.processor_load import LoadMeter
from icu_common.adapters.terminal_keys import typed_text
from icu_common.core.processes.preparation import PreparationReport, PreparationStage, from_line
from icu_common.core.processes.supervision import HANGING_VARIABLE

IMPORTANT = ("WARN", "ERROR", "FATAL", "error:", "Traceback", "Fatal Python error", 'File "', "http://", "https://")
"""Texts that mark lines to print without a terminal; all other lines only go to the log."""
ON_TERMINAL = ("error:", "[FATAL]")
"""Texts that mark lines to print above the box on a terminal."""
WAIT_S = 60.0
"""Maximum seconds that a program waits for its simulated device."""
_FORKING_PAYS = 3
"""Minimum number of nodes for which the server that forks them is started."""
_TURN_S, _REST_S = 0.05, 0.2
"""Seconds between two checks for new sockets and keys, which no output announces: during the start, and later."""
_SLOW_END_S = 3.0
"""Seconds after which a program's end is printed, not only logged."""
PREPARE = "prepare"
DRIVER = "gantry_driver", "serial_driver"
"""Package and executable of the program that owns the board's port through a guard."""
_PAGE = re.compile(r"https?://\S+\?token=\S+")


class GraphRun:
    """Starts the programs, watches them, and shows the progress.

    Parameters
    ----------
    options
        Options of bring_up's command line.
    programs
        Programs to start.
    screen
        Display of the progress.
    notes
        Sentences for the box.
    log
        Path of the log file, for the box.
    """

    def __init__(
        self,
        options: argparse.Namespace,
        programs: list[Program],
        screen: Screen,
        *,
        notes: list[str],
        log: Path,
    ) -> None:
        self.stopping = False
        self._options = options
        self._programs = programs
        self._screen = screen
        self._notes = notes
        self._log = log
        self._here = Path(sys.argv[0])
        self._serves_page = any(p.executable == "ui_bridge" for p in programs)
        self._page = ""
        self._reads_keys = sys.stdin is not None and sys.stdin.isatty()
        self._complete = self._prepares = False
        self._report: PreparationReport | None = None
        self._remaining = RemainingTime()
        self._repeats = 0
        self._repeat_offered = False
        self._box: tuple[str, ...] = ()
        self._status: Status | None = None
        self._load = LoadMeter()
        self._hanging = frozenset[int]()

    def run(self, temporary: Path, environment: dict[str, str]) -> int:
        """Run until a signal arrives or no program can run; return the exit code."""
        hanging_file = temporary / "hanging.json"
        environment = {**environment, HANGING_VARIABLE: str(hanging_file)}
        nodes = sum(program.is_node for program in self._programs)
        forks = ForkServer(environment) if nodes >= _FORKING_PAYS and not self._options.composed else None
        group = ProcessGroup(environment, self._output, self._event, forks=forks)
        self._group = group
        try:
            self._serve(temporary, hanging_file)
            why = f", since {', '.join(group.misconfigured)} cannot run" if group.misconfigured else ""
            self._screen.clear()
            self._screen.say(f"ending every program{why}")
        finally:
            killed = group.stop(on_ended=self._ended)
            if killed:
                self._screen.say(f"had to be killed: {', '.join(killed)}")
        return 1 if group.gave_up or killed else 0

    def _serve(self, temporary: Path, hanging_file: Path) -> None:
        waiting = list(self._programs)
        together = [p for p in waiting if self._options.composed and p.is_node and not p.ends_last]
        waiting = [p for p in waiting if p not in together]
        total = len(waiting) + bool(together)
        patience = time.monotonic() + WAIT_S
        while not self.stopping and not self._group.misconfigured:
            late = time.monotonic() > patience
            for program in [p for p in waiting if late or p.waits_for is None or p.waits_for.exists()]:
                waiting.remove(program)
                self._start(program, temporary)
            if together and (late or all(p.waits_for is None or p.waits_for.exists() for p in together)):
                self._start_together(together, temporary)
                together = []
            if self._options.prepare and not self._prepares and not any(map(_is_driver, (*waiting, *together))):
                # The preparation waits for the driver itself, and connects while other programs start.
                self._prepares = True
                self._start_preparation()
            if not waiting and not together and not self._complete:
                self._complete = True
                self._screen_started()
            self._show(total)
            self._group.watch(_REST_S if self._box else _TURN_S)
            self._note_hanging(hanging_file)
            self._read_keys()

    def _note_hanging(self, path: Path) -> None:
        """Write the hanging programs to the file for the page bridge, and report what uses the processor then."""
        if self._group.hanging == self._hanging:
            return
        self._hanging = self._group.hanging
        write_hanging(path, self._hanging)
        if self._hanging:
            self._load.describe(lambda text: self._screen.say(f"processor: {text}"))

    def _screen_started(self) -> None:
        text = (
            f"started {len(self._group.running().keys() - {PREPARE})} programs of the profile {self._options.profile}"
        )
        if self._screen.terminal:
            self._screen.log(text)
        else:
            self._screen.say(text)

    def _start(self, program: Program, temporary: Path) -> None:
        path = find_executable(program.package, program.executable, self._here)
        self._group.start(
            program.name,
            [str(path), *self._arguments(program, temporary)],
            ends_last=program.ends_last,
            tells_ready=program.is_node,
            rescue=self._rescue([program]),
        )

    def _rescue(self, programs: list[Program]) -> list[str]:
        """Return the command that lifts a stylus after a kill of driver and guard; empty without a driver."""
        for program in programs:
            if _is_driver(program) and (port := program.value("port")):
                path = find_executable("gantry_driver", "gantry_guard", self._here)
                return [str(path), "--port", str(port), "--recover"]
        return []

    def _start_together(self, programs: list[Program], temporary: Path) -> None:
        table = temporary / "composed.json"
        table.write_text(json.dumps([[p.executable, self._arguments(p, temporary)] for p in programs]))
        composed = [str(find_executable("icu_bringup", "composed", self._here)), str(table)]
        self._group.start("composed", composed, tells_ready=True, rescue=self._rescue(programs))

    def _arguments(self, program: Program, temporary: Path) -> list[str]:
        values = temporary / f"{program.name}.yaml"
        values.write_text(program.values_document(), encoding="utf-8")
        return program.ros_arguments(values)

    # The preparation.

    def _start_preparation(self) -> None:
        self._report, self._remaining, self._repeat_offered = None, RemainingTime(), False
        self._status = None
        self._box = ()
        path = find_executable("gantry_driver", "gantry_prepare", self._here)
        namespace = self._options.namespace.strip("/")
        ros = ["--ros-args", "-r", f"__ns:=/{namespace}"] if namespace else []
        self._group.start_once(PREPARE, [str(path), "--json", *ros])

    def _prepared(self, text: str) -> None:
        """Handle the end of the preparation; ``text`` describes how the process ended."""
        if text == "done":
            page = f" Open {self._page or 'the operator page'}" if self._serves_page else ""
            if not self._screen.terminal:
                self._screen.say(f"\nReady.{page}\nCtrl-C ends every program.\n")
            self._keep_box("Ready: the machine is homed and calibrated.")
            return
        report = self._report or PreparationReport(stage=PreparationStage.FAILED)
        if report.stage is not PreparationStage.FAILED:
            report = PreparationReport(stage=PreparationStage.FAILED, failed_at=report.stage, text=text)
        failed = failure(report)
        if repeats_by_itself(report, self._repeats):
            self._repeats += 1
            self._screen.say(f"{failed}. It starts again by itself (repetition {self._repeats}).")
            self._start_preparation()
            return
        advice = next_step(key=self._reads_keys, page=self._serves_page)
        self._screen.say(failed if self._screen.terminal else f"{failed}\n{advice}")
        self._repeat_offered = True
        self._keep_box(failed, advice)

    def _read_keys(self) -> None:
        if not self._reads_keys:
            return
        text = typed_text()
        if text is None:  # the terminal has been closed
            self._reads_keys = False
        elif text:
            self._screen.typed(text.count("\n"))
            if self._repeat_offered and text.strip().lower() == "r":
                self._repeats = 0
                self._start_preparation()

    # Display.

    def _keep_box(self, *texts: str) -> None:
        self._box = texts
        if not self._screen.terminal:
            return
        address = self._page if self._serves_page else ""
        notes = (*texts, *self._notes, "Ctrl-C ends every program.")
        code = qr_modules(address) if address else ()
        self._screen.box(Box(address=address, notes=notes, footer=f"Log: {self._log}", qr=code))

    def _show(self, total: int) -> None:
        """Show the moving line during a wait."""
        if self._box:
            return
        report, ready = self._report, self._group.ready_count()
        early = report is None or report.stage in (PreparationStage.CONNECTING, PreparationStage.ENABLING)
        if ready < total and early:
            self._show_status(starting(ready, total))
        elif report is not None and report.stage not in (PreparationStage.READY, PreparationStage.FAILED):
            self._show_status(preparing(report, self._remaining.left_s(time.monotonic())))
        elif not self._options.prepare and ready >= total:
            self._keep_box(f"All programs of the profile {self._options.profile} run.")

    def _show_status(self, status: Status) -> None:
        # While the terminal takes no output (Control-S), the screen's queue must not fill with equal lines.
        if status != self._status:
            self._status = status
            self._screen.status(status)

    def _output(self, name: str, line: str) -> None:
        found = _PAGE.search(line)
        if found and found[0] != self._page:
            self._page = found[0]
            if self._box:
                self._keep_box(*self._box)
        if name == PREPARE:
            try:
                self._take(from_line(line))
                return
            except ValueError:
                pass  # a warning of ROS, or the last output of a crash
        if not line:
            return
        words = ON_TERMINAL if self._screen.terminal else IMPORTANT
        text = f"{name:>17} | {line}"
        if self._options.verbose or any(word in line for word in words):
            self._screen.say(text)
        else:
            self._screen.log(text)

    def _take(self, report: PreparationReport) -> None:
        self._report = report
        if report.total:
            self._remaining.progress(report.done, report.total, time.monotonic(), report.left_s)
        text = f"{PREPARE:>17} | {report.stage.value}{f': {report.text}' if report.text else ''}"
        if self._options.verbose:
            self._screen.say(text)
        else:
            self._screen.log(text)

    def _event(self, name: str, text: str) -> None:
        if name == PREPARE:
            self._screen.log(f"{name:>17} ! {text}")
            if not self.stopping:
                self._prepared(text)
        else:
            self._screen.say(f"{name:>17} ! {text}")

    def _ended(self, name: str, after_s: float) -> None:
        show = self._screen.say if after_s > _SLOW_END_S else self._screen.log
        show(f"{name:>17} | ended {after_s:.1f} s after its signal")


def _is_driver(program: Program) -> bool:
    return (program.package, program.executable) == DRIVER
