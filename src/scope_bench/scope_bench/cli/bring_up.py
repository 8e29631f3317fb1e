"""Start the whole graph from config/graph.yaml, with or without the ros2 command; Ctrl-C ends every process."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import re
import signal
import stat
import sys
import tempfile
import threading
import time
from pathlib import Path
from queue import SimpleQueue
from types import FrameType

from icu_common.adapters.executables import find_executable
from icu_common.adapters.hanging_programs import write_hanging
from icu_common.adapters.processor_load import LoadMeter
from icu_common.adapters.program_end import end_signals, ends_quietly
from icu_common.adapters.state_folder import default_state_folder
from icu_common.core.option_bounds import named_path
from icu_common.core.supervision import HANGING_VARIABLE
from icu_common.core.yaml_text import values_of_pairs
from icu_common.nodes import in_step
from icu_common.nodes.runtime import prepare_transport
from scope_bench.adapters.configuration_folder import configuration_folder
from scope_bench.adapters.graph_names import hold_names
from scope_bench.adapters.processes import ProcessGroup
from scope_bench.core.graph_description import GraphError, Program, check_namespace, load_graph

IMPORTANT = ("WARN", "ERROR", "FATAL", "error:", "Traceback", "Fatal Python error", 'File "', "http://", "https://")
"""Lines with one of these are shown without --verbose."""
WAIT_S = 60.0
"""So long a program waits for the simulated device that it belongs to."""
LAST_WORDS_S = 1.0
"""For what is still to be printed at the end."""
_SETTING = re.compile(r"\w+\.[\w.]+=.*", re.DOTALL)


def _folder(text: str) -> Path:
    return named_path(text).expanduser()  # which a shell does not do behind an equals sign


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="bring_up", description=__doc__)
    result.add_argument("--profile", default="bench", help="profile of graph.yaml (default: %(default)s)")
    result.add_argument("--config", type=_folder, help="folder with graph.yaml")
    result.add_argument("--state", type=_folder, help="folder that keeps calibration and sign-in")
    result.add_argument("--run-dir", type=_folder, help="folder for sockets (default: a new temporary one)")
    result.add_argument("--scope", default="", help="model in config/scopes (default: graph.yaml's)")
    result.add_argument("--namespace", default="", help="put every name of the graph under this namespace")
    result.add_argument("--only", action="append", default=[], metavar="PROGRAM", help="start nothing but this")
    result.add_argument("--without", action="append", default=[], metavar="PROGRAM", help="leave a program out")
    result.add_argument("--set", action="append", default=[], metavar="PROGRAM.PARAMETER=VALUE", help="one value more")
    result.add_argument("--composed", action="store_true", help="all nodes but the simulated ones in one process")
    result.add_argument("--in-step", action="store_true", help="let bag_play --in-step wait for every process")
    result.add_argument(
        "--prepare", action="store_true", help="enable, home and calibrate (the simulated machine alone)"
    )
    result.add_argument("--verbose", action="store_true", help="print everything that the programs say")
    return result


def state_folder(given: Path | None, namespace: str = "") -> Path:
    """Return the folder that keeps calibration and sign-in, made if need be, readable by this user alone.

    The rights of a ``given`` folder that is there already, such as one that others use as well, are its owner's
    business.
    """
    folder = given or default_state_folder(namespace)
    if given is None or not folder.is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(stat.S_IRWXU)
    return folder.resolve()


class BringUp:
    """Starts the programs and prints what they say."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.stopping = self.unprinted = False
        self.complete = False
        self.page = ""
        self.serves_page = False
        self._lines: SimpleQueue[str | None] = SimpleQueue()

    def run(self) -> int:
        """Run until a signal comes; return the exit code."""
        for number in end_signals():
            signal.signal(number, self._stop)
        check_namespace(self.options.namespace)
        config = (self.options.config or configuration_folder()).resolve()
        state = state_folder(self.options.state, self.options.namespace)
        with tempfile.TemporaryDirectory(prefix="icu_gantry_") as temporary:
            run = (self.options.run_dir or Path(temporary)).resolve()
            run.mkdir(parents=True, exist_ok=True)
            programs = load_graph(
                config,
                self.options.profile,
                run=run,
                state=state,
                robot_namespace=self.options.namespace,
                scope=self.options.scope,
            )
            self._check_names(programs)
            programs = [self._with_single_values(program) for program in programs]
            self._check_preparation(programs)
            if not self.options.only:  # single programs may come to a graph
                hold_names(self.options.namespace)
            return self._run_programs(programs, Path(temporary))

    def _check_names(self, programs: list[Program]) -> None:
        for text in self.options.set:
            if not _SETTING.fullmatch(text):
                raise GraphError(f"--set {text}: PROGRAM.PARAMETER=VALUE is needed")
        names = {p.name for p in programs}
        given = {*self.options.only, *self.options.without, *(text.partition(".")[0] for text in self.options.set)}
        if given - names:
            raise GraphError(f"no program {', '.join(sorted(given - names))}; there are {', '.join(sorted(names))}")
        if names and not self._chosen(programs):
            which = [f"--{how} {name}" for how in ("only", "without") for name in getattr(self.options, how)]
            raise GraphError(f"nothing is left to start: {', '.join(which)}")

    def _chosen(self, programs: list[Program]) -> list[Program]:
        wanted = {*self.options.only} or {p.name for p in programs}
        return [p for p in programs if p.name in wanted - {*self.options.without}]

    def _check_preparation(self, programs: list[Program]) -> None:
        """Refuse to move what may be a machine with nobody at the page: a board in software is started here, too."""
        if not self.options.prepare:
            return
        if "serial_driver" not in {p.name for p in programs}:
            raise GraphError(f"--prepare moves the machine; profile {self.options.profile} has none")
        chosen = self._chosen(programs)
        ports = [p.parameters.get("port") for p in chosen if p.name == "serial_driver"]
        boards = [p.arguments for p in chosen if p.executable == "mock_grbl"]
        if not any(port in arguments for port in ports for arguments in boards):
            raise GraphError(
                "--prepare moves the machine by itself, so it is for the board in software (mock_grbl) that is started "
                "with it; on hardware use the page"
            )

    def _run_programs(self, programs: list[Program], temporary: Path) -> int:
        prepare_transport()
        here = Path(sys.argv[0])
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        load = LoadMeter()
        hanging_path, hanging = temporary / "hanging.json", frozenset[int]()
        environment[HANGING_VARIABLE] = str(hanging_path)
        if self.options.in_step:
            environment[in_step.VARIABLE] = "1"
        group = ProcessGroup(environment, self._output, self._event)
        printer = threading.Thread(target=self._print_all, name="printer", daemon=True)
        printer.start()
        try:
            waiting = self._chosen(programs)
            self.serves_page = any(p.executable == "ui_bridge" for p in waiting)
            together = [p for p in waiting if self.options.composed and p.is_node and not p.ends_last]
            waiting = [p for p in waiting if p not in together]
            patience = time.monotonic() + WAIT_S
            while not self.stopping and not group.misconfigured:
                late = time.monotonic() > patience
                for program in [p for p in waiting if late or p.waits_for is None or p.waits_for.exists()]:
                    waiting.remove(program)
                    path = find_executable(program.package, program.executable, here)
                    arguments = self._arguments(program, temporary)
                    group.start(
                        program.name,
                        [str(path), *arguments],
                        ends_last=program.ends_last,
                        tells_ready=program.is_node,
                    )
                if together and (late or all(p.waits_for is None or p.waits_for.exists() for p in together)):
                    table = temporary / "composed.json"
                    table.write_text(json.dumps([[p.executable, self._arguments(p, temporary)] for p in together]))
                    composed = [str(find_executable("scope_bench", "composed", here)), str(table)]
                    group.start("composed", composed, tells_ready=True)
                    together = []
                if not waiting and not together and not self.complete:
                    self.complete = True
                    self.say(f"started {len(group.running())} programs of the profile {self.options.profile}")
                    if self.options.prepare:
                        self._start_preparation(group, here)
                group.watch(0.2)
                if group.hanging != hanging:
                    hanging = group.hanging
                    write_hanging(hanging_path, hanging)
                    if hanging:
                        load.describe(lambda text: self.say(f"processor: {text}"))
            why = f", since {', '.join(group.misconfigured)} cannot run" if group.misconfigured else ""
            self.say(f"ending every program{why}")
        finally:
            killed = group.stop()
            if killed:
                self.say(f"had to be killed: {', '.join(killed)}")
            self._lines.put(None)
            printer.join(LAST_WORDS_S)
        return 1 if group.gave_up or killed or self.unprinted else 0

    def _arguments(self, program: Program, temporary: Path) -> list[str]:
        values = temporary / f"{program.name}.yaml"
        values.write_text(program.values_document(), encoding="utf-8")
        return program.ros_arguments(values)

    def _start_preparation(self, group: ProcessGroup, here: Path) -> None:
        path = find_executable("gantry_driver", "gantry_prepare", here)
        namespace = self.options.namespace.strip("/")
        group.start_once("prepare", [str(path), *(["--ros-args", "-r", f"__ns:=/{namespace}"] if namespace else [])])

    def _with_single_values(self, program: Program) -> Program:
        given = [text for text in self.options.set if text.partition(".")[0] == program.name]
        if given and not program.is_node:
            raise GraphError(f"--set {given[0]}: {program.name} is no node and has no parameters")
        try:
            values = values_of_pairs(text.partition(".")[2] for text in given)
        except ValueError as error:
            raise GraphError(f"--set {program.name}: {error}") from error
        for name in (name for name, value in values.items() if value is None):
            raise GraphError(f"--set {program.name}.{name}: a value is needed; \"''\" is the empty text")
        return dataclasses.replace(program, parameters={**program.parameters, **values})

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.stopping = True

    def say(self, text: str) -> None:
        """Print a line, without waiting for a terminal that takes none (Control-S): the programs would wait, too."""
        self._lines.put(text)

    def _print_all(self) -> None:
        """Print line by line; once nobody can read them any more, end as by a signal."""
        for text in iter(self._lines.get, None):
            data = f"{text}\n".encode(errors="backslashreplace")
            try:
                while data:
                    data = data[os.write(sys.stdout.fileno(), data) :]
            except BrokenPipeError:
                self.stopping = True
                return
            except OSError as error:  # a full disk, or the terminal is closed
                self.stopping = self.unprinted = True
                print(f"error: standard output: {error.strerror}; ending every program", file=sys.stderr)
                return

    def _output(self, name: str, line: str) -> None:
        found = re.search(r"https?://\S+\?token=\S+", line)
        self.page = found[0] if found else self.page
        if line and (self.options.verbose or name == "prepare" or any(word in line for word in IMPORTANT)):
            self.say(f"{name:>17} | {line}")

    def _event(self, name: str, text: str) -> None:
        self.say(f"{name:>17} ! {text}")
        if name == "prepare" and text == "done":
            page = f" Open {self.page or 'the operator page'}" if self.serves_page else ""
            self.say(f"\nReady.{page}\nCtrl-C ends every program.\n")


@ends_quietly
def main() -> int:
    """Run the command."""
    bring_up = BringUp(parser().parse_args())
    try:
        return bring_up.run()
    except (GraphError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main())
