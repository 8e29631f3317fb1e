"""Start and end of a process of the graph: transport profile, executor, signals, safe exit.

Fast DDS's defaults lose images, so a profile is set before rclpy starts. It uses sockets alone if the system allows
buffers for images, otherwise shared memory with a large enough segment; see docs/decisions/transport.md.
"""

from __future__ import annotations

import contextlib
import faulthandler
import functools
import inspect
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FrameType

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from icu_common.adapters.memory import keep_large_blocks
from icu_common.adapters.processes.program_end import end_signals, ends_quietly, help_text
from icu_common.adapters.processes.sign_of_life import SignsOfLife
from icu_common.adapters.transport_profile import (
    PROFILE_VARIABLE,
    RANGE_VARIABLE,
    check_environment,
    is_users_own,
    keeps_to_this_host,
    profiles_folder,
    sockets_hold_pictures,
)
from icu_common.core.configuration.config import ConfigError
from icu_common.core.processes.supervision import AFTER_CRASH_VARIABLE, DEAF, READY_VARIABLE
from icu_common.nodes.graph_node import GraphLifecycleNode, GraphNode, this_process
from icu_common.nodes.hearing import Hearing
from icu_common.nodes.timers import runs_by_clock_topic

TEARDOWN_S = 4.0
"""Maximum seconds to destroy closed nodes and shut rclpy down; then the process prints where it hangs and ends.

Fast DDS's threads can wait for each other while other participants leave (docs/decisions/processes.md).
"""


def prepare_transport(shared_memory: bool = True) -> None:
    """Choose the transport profile, loopback alone, and a malloc that keeps image-sized blocks.

    Settings of the user in the environment stay. Another discovery range than LOCALHOST, named peers or a discovery
    server open the network; see docs/decisions/several-machines.md.

    Parameters
    ----------
    shared_memory
        False for a program that must not wait for another one: see docs/decisions/transport.md. Otherwise it is used if
        the buffers of sockets are too small for images.

    Raises
    ------
    SystemExit
        With code 2 and one line, if the environment names an invalid domain or peer.
    """
    try:
        check_environment()
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from error
    local = keeps_to_this_host()
    os.environ.setdefault(RANGE_VARIABLE, "LOCALHOST")
    shared_memory = shared_memory and not sockets_hold_pictures()
    name = "fastdds_" + "local_" * local + "sockets_" * (not shared_memory) + "profile.xml"
    if not is_users_own():
        os.environ[PROFILE_VARIABLE] = str(profiles_folder() / name)
        if local and not shared_memory:  # for LOCALHOST rmw adds shared memory; the profile uses the loopback
            os.environ[RANGE_VARIABLE] = "SYSTEM_DEFAULT"
    keep_large_blocks()


_CHECK_S = 0.1
"""Minimum interval between two checks of a process: its publishers' matches, and whether it receives messages."""


class RosSession:
    """rclpy between its start and its end: an executor, and whether a signal to end has arrived."""

    def __init__(self) -> None:
        self.executor = EventsExecutor()
        self.stopping = False
        self._checked_s = 0.0
        for number in end_signals():
            signal.signal(number, self._stop)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self.stopping = True

    @property
    def goes_on(self) -> bool:
        """False after a request to end the process."""
        return rclpy.ok() and not self.stopping

    def spin(self, timeout_s: float = 0.1) -> bool:
        """Serve due callbacks in a short turn, as EventsExecutor.spin() does not react to signals.

        Returns
        -------
        bool
            Whether the costly checks are due, which run ten times a second.
        """
        self.executor.spin_once(timeout_sec=timeout_s)
        now_s = time.monotonic()
        due = now_s - self._checked_s > _CHECK_S
        if due:
            self._checked_s = now_s
            this_process.show_matches()
        return due

    def close(self, node: Node) -> None:
        """Close a node that has ``close``; no callback is served meanwhile."""
        if this_process.ledger is not None:
            this_process.ledger.leave()
        if hasattr(node, "close"):
            node.close()

    def end(self, node: Node) -> None:
        """Close a node that has ``close``, and destroy it."""
        self.close(node)
        node.destroy_node()


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Allow a signal to end a long computation in a node's constructor, which starts no thread."""
    before = {number: signal.getsignal(number) for number in end_signals()}

    def leave(number: int, frame: FrameType | None) -> None:
        raise SystemExit(0)

    for number in before:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _readable() -> Iterator[None]:
    """Raise a ConfigError with rcl's reason for arguments and parameter files that rcl cannot read."""
    try:
        yield
    except RuntimeError as error:  # the base of rclpy's own errors, which it does not export
        if type(error).__name__ == "UnknownROSArgsError":
            raise ConfigError(f"unknown ROS arguments: {error}") from error
        if "Couldn't parse" not in str(error):
            raise
        raise ConfigError(str(error)) from error
    except UnicodeEncodeError as error:  # from an argument in another encoding
        raise ConfigError(f"{error.object!r} is no UTF-8") from error


def own_arguments(arguments: Sequence[str]) -> list[str]:
    """Return a program's own arguments, without its name and ``--ros-args ...``.

    Raises
    ------
    SystemExit
        With code 2 and one line, if the ROS part cannot be read.
    """
    try:
        with _readable():
            return list(remove_ros_args(args=list(arguments)))[1:]
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from error


def start_rclpy(arguments: Sequence[str] | None) -> None:
    """Start rclpy without its signal handlers.

    Raises
    ------
    SystemExit
        With code 2 and one line, if the log file cannot be created.
    """
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        if not any(text in str(error) for text in ("Failed to create log directory", "Failed opening file")):
            raise
        print(f"error: {error}; ROS_LOG_DIR names another folder for logs", file=sys.stderr)
        raise SystemExit(2) from error


@contextlib.contextmanager
def ros_session(arguments: Sequence[str] | None = None, shared_memory: bool = True) -> Iterator[RosSession]:
    """Start rclpy with the graph's transport, and shut it down at the end.

    Raises
    ------
    ConfigError
        If an argument or a parameter file cannot be read.
    """
    prepare_transport(shared_memory)
    try:
        this_process.count_steps()
    except OSError as error:
        raise ConfigError(f"the ledger of steps cannot be opened: {error}") from error
    with _readable():
        start_rclpy(arguments)
    try:
        yield RosSession()
    finally:
        rclpy.shutdown()
        this_process.end()


_collected: list[Callable[..., Node]] | None = None


def run(make_node: Callable[..., Node], arguments: Sequence[str] | None = None, *, shared_memory: bool = True) -> int:
    """Start rclpy, make the node, spin until a signal to end, close it, and return the exit code.

    The node's ``close`` (if it has one) runs while topics still work, so that a last state can be published.
    ``make_node`` takes options for ``rclpy.node.Node``; ``shared_memory`` is for :func:`prepare_transport`.
    """
    if _collected is not None:
        _collected.append(make_node)
        return 0
    if arguments is None and {"-h", "--help"} & set(sys.argv[1:]):
        return _help(make_node)
    if arguments is None and (strange := own_arguments(sys.argv)):
        print(f"error: {strange[0]!r}: a node takes only what follows --ros-args; see --help", file=sys.stderr)
        return 2
    return _run([make_node], arguments, shared_memory)


@ends_quietly
def _help(make_node: Callable[..., Node]) -> int:
    name = Path(sys.argv[0]).name
    text = f"""usage: {name} --ros-args [-p NAME:=VALUE] [--params-file YAML] [-r FROM:=TO]

{help_text(inspect.getdoc(inspect.getmodule(make_node)))}

While it runs, `ros2 param list` names its parameters and `ros2 param describe NODE NAME` tells meaning and range."""
    print(text)
    return 0


def run_together(programs: Sequence[tuple[Callable[[], int], Sequence[str]]]) -> int:
    """Run the nodes of several programs in this process with one executor.

    Parameters
    ----------
    programs
        The ``main`` of each, which calls :func:`run`, and its ROS arguments.
    """
    global _collected
    _collected = []
    try:
        for main, _ in programs:
            main()
        makers = [
            functools.partial(make, cli_args=list(own), use_global_arguments=False)
            for make, (_, own) in zip(_collected, programs, strict=True)
        ]
    finally:
        _collected = None
    return _run(makers, [])


def _run(makers: Sequence[Callable[..., Node]], arguments: Sequence[str] | None, shared_memory: bool = True) -> int:
    faulthandler.enable()  # bring-up aborts a hanging program: its output then shows where
    try:
        with ros_session(arguments, shared_memory) as session:
            return _spin(session, makers)
    except (ConfigError, ParameterException) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    finally:
        faulthandler.cancel_dump_traceback_later()


def _hearing() -> Hearing | None:
    """Return the watch on received messages, None if no program would restart this one."""
    after_crash = bool(os.environ.pop(AFTER_CRASH_VARIABLE, ""))
    if not (after_crash or READY_VARIABLE in os.environ):
        return None
    hearing = Hearing(after_crash=after_crash, others=READY_VARIABLE in os.environ and keeps_to_this_host())
    this_process.observer = hearing.observe
    return hearing


def _seconds_heard_in(node: Node) -> float:
    """Return a time that advances only while others can send: in simulated time they may all be waiting."""
    ledger = this_process.ledger
    return time.monotonic() if ledger is None or not runs_by_clock_topic(node) else ledger.time_ns / 1e9


def _spin(session: RosSession, makers: Sequence[Callable[..., Node]]) -> int:
    nodes: list[Node] = []
    hearing = _hearing()
    try:
        for make in makers:
            with _readable():
                nodes.append(make())
            session.executor.add_node(nodes[-1])
        if hearing is not None and isinstance(nodes[0], GraphNode | GraphLifecycleNode):
            hearing.listen(nodes[0])
        life = SignsOfLife()
        while session.goes_on:
            looks = session.spin()
            life.turn()
            if looks and hearing is not None and (what := hearing.deaf(_seconds_heard_in(nodes[0]))):
                print(f"error: {what}: ending, to be started anew", file=sys.stderr)
                for node in nodes:
                    session.close(node)
                os._exit(DEAF)  # destroying the nodes would wait for the middleware's threads, which hang
    finally:
        for node in nodes:
            session.close(node)
        # Not a timer of Python: the middleware's calls may hold the interpreter's lock while they wait.
        faulthandler.dump_traceback_later(TEARDOWN_S, exit=True)
        for node in nodes:
            node.destroy_node()
    return 0
