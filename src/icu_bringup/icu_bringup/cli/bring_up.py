"""Start the whole graph from config/graph.yaml, with or without the ros2 command; Ctrl-C ends every process."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import importlib.util
import os
import re
import signal
import stat
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

from icu_bringup.adapters.environment import check_space, free_port
from icu_bringup.adapters.graph_ledger import is_used, new_ledger, path_of_graph
from icu_bringup.adapters.graph_names import hold_another_domain, hold_names
from icu_bringup.adapters.run_log import RunLog
from icu_bringup.adapters.screen import Screen, is_terminal
from icu_bringup.cli.graph_run import GraphRun
from icu_bringup.core.startup.graph_description import (
    GraphDescriptionError,
    Program,
    check_namespace,
    load_graph,
    simulators,
)
from icu_common.adapters.configuration_folder import configuration_folder
from icu_common.adapters.processes.program_end import end_signals, ends_quietly
from icu_common.adapters.state_folder import default_state_folder
from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE
from icu_common.adapters.transport_profile import check_environment
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.configuration.yaml_text import values_of_pairs

_SETTING = re.compile(r"\w+\.[\w.]+=.*", re.DOTALL)


def _folder(text: str) -> Path:
    return named_path(text).expanduser()  # a shell does not expand ~ after an equals sign


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="bring_up", description=__doc__)
    result.add_argument("--profile", default="bench", help="profile of graph.yaml (default: %(default)s)")
    result.add_argument("--config", type=_folder, help="folder with graph.yaml")
    result.add_argument("--state", type=_folder, help="folder that keeps calibration and sign-in")
    result.add_argument("--run-dir", type=_folder, help="folder for sockets (default: a new temporary one)")
    result.add_argument("--scope", default="", help="model in config/scopes (default: graph.yaml's)")
    result.add_argument("--room", default="", help="room in config/rooms of the simulated bench")
    result.add_argument("--namespace", default="", help="put every name of the graph under this namespace")
    result.add_argument("--only", action="append", default=[], metavar="PROGRAM", help="start nothing but this")
    result.add_argument("--without", action="append", default=[], metavar="PROGRAM", help="leave a program out")
    result.add_argument("--set", action="append", default=[], metavar="PROGRAM.PARAMETER=VALUE", help="one value more")
    result.add_argument("--composed", action="store_true", help="all nodes but the simulated ones in one process")
    result.add_argument("--in-step", action="store_true", help="let bag_play --in-step wait for every process")
    result.add_argument(
        "--real-time", action="store_true", help="run a simulated machine by the wall clock, as hardware does"
    )
    result.add_argument(
        "--prepare", action="store_true", help="enable, home and calibrate (the simulated machine alone)"
    )
    result.add_argument("--verbose", action="store_true", help="print everything that the programs say")
    return result


def state_folder(given: Path | None, namespace: str = "") -> Path:
    """Return the folder for calibration and sign-in, created if necessary, readable only by this user.

    The permissions of an existing ``given`` folder, such as a shared one, stay unchanged.
    """
    folder = given or default_state_folder(namespace)
    if given is None or not folder.is_dir():
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(stat.S_IRWXU)
    return folder.resolve()


class BringUp:
    """Checks the command line and this computer, and runs the graph."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.stopping = self.unprinted = False
        self._simulated = False
        self._environment: dict[str, str] = {}
        self._run: GraphRun | None = None
        self._notes: list[str] = []

    def run(self) -> int:
        """Run until a signal arrives; return the exit code."""
        for number in end_signals():
            signal.signal(number, self._stop)
        if importlib.util.find_spec("rclpy") is None:  # the programs need it, bring-up itself does not
            raise ModuleNotFoundError("No module named 'rclpy'", name="rclpy")
        check_namespace(self.options.namespace)
        config = (self.options.config or configuration_folder()).resolve()
        state = state_folder(self.options.state, self.options.namespace)
        check_space(state)
        with tempfile.TemporaryDirectory(prefix="icu_gantry_") as temporary:
            run = (self.options.run_dir or Path(temporary)).resolve()
            run.mkdir(parents=True, exist_ok=True)
            self._simulated = self._runs_by_simulated_time(config)
            programs = self._load(config, run, state)
            self._check_preparation(programs)
            if not self.options.only:  # single programs may be added to a graph
                state = self._hold_names(programs, state)
                programs = self._load(config, run, state)
            programs = self._with_free_port(programs)
            with contextlib.ExitStack() as stack:
                if self._simulated or self.options.in_step:
                    stack.enter_context(self._ledger())
                return self._run_programs(self._chosen(programs), Path(temporary), state)

    @contextlib.contextmanager
    def _ledger(self) -> Iterator[None]:
        """Create the graph's step ledger, unless single programs are added to a graph that has one."""
        path = path_of_graph(self.options.namespace)
        self._environment[LEDGER_VARIABLE] = str(path)
        if self.options.only:
            yield
            return
        with new_ledger(path, simulated=self._simulated):
            yield

    def _runs_by_simulated_time(self, config: Path) -> bool:
        """Whether all hardware is simulated here, or the graph that single programs are added to follows ``/clock``."""
        needed = set(simulators(config, self.options.profile))
        if self.options.real_time or not needed:
            return False
        left = ({*self.options.only} or needed) - {*self.options.without}
        return needed <= left or (bool(self.options.only) and is_used(path_of_graph(self.options.namespace)))

    def _load(self, config: Path, run: Path, state: Path) -> list[Program]:
        programs = load_graph(
            config,
            self.options.profile,
            run=run,
            state=state,
            robot_namespace=self.options.namespace,
            scope=self.options.scope,
            room=self.options.room,
            simulated_time=self._simulated,
        )
        self._check_names(programs)
        return [self._with_single_values(program) for program in programs]

    def _hold_names(self, programs: list[Program], state: Path) -> Path:
        """Reserve the graph's names; return the state folder.

        A second graph gets its own ROS domain and state folder if the user has not chosen the domain and the graph
        moves no real machine. See docs/decisions/start-up.md.
        """
        try:
            hold_names(self.options.namespace)
        except GraphDescriptionError:
            if os.environ.get("ROS_DOMAIN_ID") or not self._is_simulated(programs):
                raise
            domain = hold_another_domain(self.options.namespace)
            os.environ["ROS_DOMAIN_ID"] = domain
            self._notes.append(
                f"Another graph runs in ROS domain 0, this one in {domain}: in a second terminal run "
                f"export ROS_DOMAIN_ID={domain}"
            )
            if self.options.state is None:
                state = state_folder(state / f"domain-{domain}")  # no namespace can have this name
        return state

    def _with_free_port(self, programs: list[Program]) -> list[Program]:
        """Return the programs with a free port for the page."""
        result = []
        for program in programs:
            if program.executable == "ui_bridge" and program in self._chosen(programs):
                host, port = (program.value(name) for name in ("host", "port"))
                if isinstance(host, str) and isinstance(port, int) and port > 0:
                    given = any(text.startswith(f"{program.name}.port=") for text in self.options.set)
                    free = free_port(host, port, may_choose=not given and self._is_simulated(programs))
                    if free != port:
                        self._notes.append(f"Port {port} is in use by another program, so the page has port {free}.")
                        program = dataclasses.replace(program, parameters={**program.parameters, "port": free})
            result.append(program)
        return result

    def _check_names(self, programs: list[Program]) -> None:
        for text in self.options.set:
            if not _SETTING.fullmatch(text):
                raise GraphDescriptionError(f"--set {text}; expected PROGRAM.PARAMETER=VALUE")
        names = {p.name for p in programs}
        given = {*self.options.only, *self.options.without, *(text.partition(".")[0] for text in self.options.set)}
        if given - names:
            raise GraphDescriptionError(
                f"no program {', '.join(sorted(given - names))}; there are {', '.join(sorted(names))}"
            )
        if names and not self._chosen(programs):
            which = [f"--{how} {name}" for how in ("only", "without") for name in getattr(self.options, how)]
            raise GraphDescriptionError(f"nothing is left to start: {', '.join(which)}")

    def _chosen(self, programs: list[Program]) -> list[Program]:
        wanted = {*self.options.only} or {p.name for p in programs}
        return [p for p in programs if p.name in wanted - {*self.options.without}]

    def _is_simulated(self, programs: list[Program]) -> bool:
        """Return whether the driver's board is simulated and started here as well."""
        chosen = self._chosen(programs)
        ports = [p.parameters.get("port") for p in chosen if p.name == "serial_driver"]
        boards = [p.arguments for p in chosen if p.executable == "mock_grbl"]
        return any(port in arguments for port in ports for arguments in boards)

    def _check_preparation(self, programs: list[Program]) -> None:
        """Reject --prepare, which moves a machine unattended, unless the board is simulated and started here."""
        if not self.options.prepare:
            return
        if "serial_driver" not in {p.name for p in programs}:
            raise GraphDescriptionError(f"--prepare moves the machine; profile {self.options.profile} has none")
        if not self._is_simulated(programs):
            raise GraphDescriptionError(
                "--prepare moves the machine by itself, so it is for the board in software (mock_grbl) that is started "
                "with it; on hardware use the page"
            )

    def _run_programs(self, programs: list[Program], temporary: Path, state: Path) -> int:
        try:
            check_environment()
        except ValueError as error:
            raise GraphDescriptionError(str(error)) from error
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        environment |= self._environment
        log = RunLog(state / "logs")
        screen = Screen(log, terminal=is_terminal() and not self.options.verbose, on_broken=self._broken)
        screen.log(f"{' '.join(sys.argv)}, ROS domain {os.environ.get('ROS_DOMAIN_ID') or '0'}")
        for note in () if screen.terminal else (*self._notes, f"The log is {log.path}"):
            screen.say(note)
        self._run = GraphRun(self.options, programs, screen, notes=self._notes, log=log.path)
        self._run.stopping = self.stopping
        try:
            code = self._run.run(temporary, environment)
        finally:
            screen.end()
        return 1 if self.unprinted else code

    def _with_single_values(self, program: Program) -> Program:
        given = [text for text in self.options.set if text.partition(".")[0] == program.name]
        if given and not program.is_node:
            raise GraphDescriptionError(f"--set {given[0]}: {program.name} is no node and has no parameters")
        try:
            values = values_of_pairs(text.partition(".")[2] for text in given)
        except ValueError as error:
            raise GraphDescriptionError(f"--set {program.name}: {error}") from error
        for name in (name for name, value in values.items() if value is None):
            raise GraphDescriptionError(f"--set {program.name}.{name}: a value is needed; \"''\" is the empty text")
        return dataclasses.replace(program, parameters={**program.parameters, **values})

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self._end()

    def _end(self) -> None:
        self.stopping = True
        if self._run is not None:
            self._run.stopping = True

    def _broken(self, reason: str) -> None:
        """End as on a signal when the output has no reader any more."""
        if reason:
            self.unprinted = True
            print(f"error: standard output: {reason}; ending every program", file=sys.stderr)
        self._end()


@ends_quietly
def main() -> int:
    """Run the command."""
    bring_up = BringUp(parser().parse_args())
    try:
        return bring_up.run()
    except (GraphDescriptionError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main())
