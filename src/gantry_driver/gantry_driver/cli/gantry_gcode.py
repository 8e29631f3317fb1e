"""Run a G-code program directly on the board's port, without ROS.

``gantry_gcode settings --params serial_driver.yaml --params hardware.yaml`` compares the board's settings with the
machine that these files configure (without files: the driver's defaults). It can save them in a file, or write those
of the configuration or of a file to the board and read them back. Nothing moves.

``gantry_gcode run FILE`` with the same files checks all of FILE against the machine, prints its duration, opens the
port exclusively (this fails while a driver uses it), homes, and streams. Space pauses (the stylus stays at its
position) and resumes. Ctrl-C, Ctrl-Z or closing the terminal holds, lifts the stylus, keeps the position, and ends.
``--dry-run`` makes the board's own parser check the lines in ``$C`` mode; nothing moves, and a board that was locked is
locked again at the end. ``--check`` does not open the port.
"""

from __future__ import annotations

import argparse
import gc
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from itertools import accumulate
from pathlib import Path
from types import FrameType

import serial

from gantry_driver.adapters.check_mode import CheckFailed, dry_run
from gantry_driver.adapters.serial_link import SerialLink
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.goals.progress import duration_text, progress_text
from gantry_driver.core.grbl.grbl_messages import error_text
from gantry_driver.core.grbl.lines import plain
from gantry_driver.core.grbl.settings_profile import ProfileError, differences, parse_profile, profile_text
from gantry_driver.core.grbl.trajectory_gcode import TrajectoryError
from gantry_driver.core.machine.machine import Machine
from gantry_driver.core.machine.streaming import PROGRAM_MODES
from gantry_driver.core.program.gcode_check import CheckedLine, ProgramChecker
from gantry_driver.core.program.gcode_words import GcodeError
from gantry_driver.core.states.machine_states import Answered, Event, Note, StateChanged
from icu_common.adapters.processes.program_end import end_signals, ends_quietly, help_text
from icu_common.adapters.terminal_keys import terminal_keys
from icu_common.core.configuration.config import ConfigError, from_mapping
from icu_common.core.configuration.option_bounds import named_path
from icu_common.core.configuration.parameter_file import values_for
from icu_common.core.goals.results import GoalResult, Outcome

DONE, FAILED, USAGE = 0, 1, 2
"""Exit codes."""
TURN_S = 0.1
BROKEN = ("stopped", "alarm", "mismatch")


class Failed(Exception):
    """The program cannot continue; the message gives the reason."""


def read_config(params: Sequence[Path], **options: str | bool | None) -> DriverConfig:
    """Return the driver's configuration from ROS parameter files, as its node reads them; later files take precedence.

    Parameters
    ----------
    params
        The files.
    options
        Parameters from the command line, which override the files; None for those not given.

    Raises
    ------
    ConfigError
        Also for a file without ``ros__parameters`` of the driver.
    """
    values = {name: value for path in params for name, value in values_for("serial_driver", path).items()}
    values |= {name: value for name, value in options.items() if value is not None}
    return from_mapping(DriverConfig, {**values, "enabled_at_start": True})


def check(source: Sequence[str], config: DriverConfig) -> list[CheckedLine]:
    """Return the lines to send, checked for a start at the homed position.

    Raises
    ------
    GcodeError
        At the first line that cannot be sent.
    """
    checker = ProgramChecker(Machine(config).bounds(), config.machine.homed_mpos_mm())
    return list(checker.check_all(source))


class Display:
    """One line that is rewritten on a terminal; without a terminal, a line at every tenth of the program."""

    def __init__(self) -> None:
        self._live = sys.stdout.isatty()
        self._shown = ""
        self._tenth = -1

    def show(self, text: str, share: float) -> None:
        """Show the state; ``share`` is the finished fraction, 0 to 1."""
        if self._live:
            if text != self._shown:
                print(f"\r\x1b[K{text}", end="", flush=True)
        elif int(10 * share) != self._tenth:
            self._tenth = int(10 * share)
            print(text, flush=True)
        self._shown = text

    def say(self, text: str) -> None:
        """Print a line that is not overwritten."""
        print(f"\r\x1b[K{text}" if self._live else text, flush=True)


class Runner:
    """Runs one program on one port; its own loop sends the operator's heartbeat, so a hang holds the machine."""

    def __init__(self, config: DriverConfig, display: Display) -> None:
        self._display = display
        self._machine = Machine(config)
        self._before_opening = self._machine.state_text
        self._result: GoalResult | None = None
        self._texts: list[str] = []
        self._link = SerialLink(self._machine, config.port, config.baud, self._on_events)
        self._link.start()

    def run(self, source: Sequence[str], lines: Sequence[CheckedLine], key: Callable[[], str]) -> GoalResult:
        """Home, stream, and return the answer; ``key`` returns the keys typed since the last turn.

        Raises
        ------
        Failed, KeyboardInterrupt
        """
        self._connect(key)
        self._need("unhomed")
        if refusal := self._link.call(lambda machine, now: machine.home(now)):
            raise Failed(f"homing was refused: {refusal}")
        self._turn_until(lambda: self._machine.state != "homing", key)
        self._need("idle")
        before = self._machine.counts.executed
        self._start(source)
        ends = list(accumulate(line.seconds for line in lines))

        def over() -> bool:
            done = min(max(self._machine.counts.executed - before, 0), len(lines))
            share = done / max(len(lines), 1)
            self._display.show(progress_text(done, ends, self._machine.state_text), share)
            return self._result is not None

        self._turn_until(over, key)
        assert self._result is not None
        return self._result

    def _start(self, source: Sequence[str]) -> None:
        """Check the program from the current position and start it; a check of seconds does not block the link."""
        try:
            checker = self._link.call(lambda machine, now: machine.program_checker())
            checked = list(checker.check_all(source))
        except (TrajectoryError, GcodeError) as error:
            raise Failed(str(error)) from error

        def start(machine: Machine, now: float) -> None:
            machine.heartbeat(now)
            machine.run_checked("program", checker, checked, now)

        # A garbage collection with a long program in memory can take longer than the heartbeat's time-out.
        gc.collect()
        gc.freeze()
        self._link.call(start)

    def settings(self) -> dict[int, str]:
        """Connect and return the board's settings.

        Raises
        ------
        Failed, KeyboardInterrupt
        """
        self._connect(lambda: "")
        return self._machine.settings

    def expected_settings(self) -> dict[int, float]:
        """Return the required settings of the connected board."""
        return self._machine.expected_settings()

    def write(self, profile: Mapping[int, float]) -> list[str]:
        """Write the settings that differ from a profile and read them back; return those that the board did not keep.

        Raises
        ------
        Failed, KeyboardInterrupt
        """
        if refusal := self._link.call(lambda machine, now: machine.write_settings(now, profile)):
            raise Failed(refusal)
        return differences(self.settings(), profile, "what was written")

    def _connect(self, key: Callable[[], str]) -> None:
        self._turn_until(
            lambda: self._machine.state != "connecting" and self._machine.state_text != self._before_opening, key
        )
        if self._machine.state == "disconnected":
            raise Failed(f"the board is {self._machine.state_text}")

    def close(self) -> None:
        """Hold a moving machine, lift the stylus, and close the port; nothing interrupts this."""
        _on_signals(signal.SIG_IGN)
        self._link.close("interrupted")
        self._turn()

    def _need(self, state: str) -> None:
        if self._machine.state != state:
            raise Failed(f"the board is {self._machine.state_text}, {state!r} is needed")

    def _turn_until(self, condition: Callable[[], bool], key: Callable[[], str]) -> None:
        while not condition():
            if self._machine.state in BROKEN and self._result is None:
                raise Failed(f"the board is {self._machine.state_text}")
            if " " in key() and (refusal := self._link.call(_pause_or_resume)):
                self._display.say(refusal)
            self._turn()
        self._turn()

    def _turn(self) -> None:
        self._link.call(lambda machine, now: machine.heartbeat(now))
        self._link.wait_for(lambda machine: self._result is not None, TURN_S)
        while self._texts:
            self._display.say(self._texts.pop(0))

    def _on_events(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, StateChanged):
                if event.logged:
                    self._texts.append(event.text)
            elif isinstance(event, Note):
                self._texts.append(f"{event.level}: {event.text}")
            elif isinstance(event, Answered) and event.result.outcome is not Outcome.ACCEPTED:
                self._result = event.result


def _pause_or_resume(machine: Machine, now: float) -> str:
    return machine.resume(now) if machine.paused else machine.pause(now)


def run_program(source: Sequence[str], lines: Sequence[CheckedLine], config: DriverConfig) -> int:
    display = Display()
    runner = Runner(config, display)
    try:
        with terminal_keys() as key:
            result = runner.run(source, lines, key)
    except Failed as error:
        print(f"error: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        display.say("interrupted: holding")
        return FAILED
    finally:
        runner.close()
    display.say(result.outcome.value + (f": {result.reason}" if result.reason else f" in {result.duration_s:.1f} s"))
    return DONE if result.outcome is Outcome.REACHED else FAILED


def run_settings(config: DriverConfig, *, save: Path | None, profile: Mapping[int, float] | None) -> int:
    """Compare, save or write the board's settings; ``profile`` has the settings to write."""
    runner = Runner(config, Display())
    try:
        found = runner.settings()
        if not found:
            raise Failed("the board has no settings")
        if save is not None:
            save.write_text(f"; settings of the board at {config.port}\n{profile_text(found)}", encoding="ascii")
            print(f"{save}: {len(found)} settings")
            return DONE
        wanted = runner.expected_settings() if profile is None else profile
        wrong = differences(found, wanted)
        if profile is not None and wrong:
            wrong = runner.write(profile)
    except (Failed, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        return FAILED
    finally:
        runner.close()
    print("\n".join(wrong) or f"all {len(wanted)} settings are as they should be")
    return FAILED if wrong else DONE


def run_dry(name: str, lines: Sequence[CheckedLine], config: DriverConfig) -> int:
    display, refused = Display(), 0
    ends = [0.0] * len(lines)

    def show(done: int) -> None:
        display.show(progress_text(done, ends, "dry run"), done / max(len(lines), 1))

    # A board that is not homed counts from 0; in check mode a move only sets the position of its parser.
    x, y, z = map(plain, config.machine.homed_mpos_mm())
    before = [*PROGRAM_MODES, f"X{x}Y{y}Z{z}G53G0"]
    try:
        texts = [line.text for line in lines]
        checked = dry_run(config.port, config.baud, texts, show, before=before, dtr=config.dtr, rts=config.rts)
        with closing(checked):  # closing leaves check mode
            for index, code in checked:
                refused += 1
                display.say(f"{name}:{lines[index].number}:1: the board answers {error_text(code)}")
    except (CheckFailed, serial.SerialException, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        display.say("interrupted")
        return FAILED
    display.say(f"dry run: {len(lines)} lines, {refused} refused by the board")
    return FAILED if refused else DONE


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(prog="gantry_gcode", description=help_text(__doc__))
    board = argparse.ArgumentParser(add_help=False)
    board.add_argument("--port", help="device of the board (from --params, else /dev/ttyUSB0)")
    board.add_argument(
        "--params",
        type=named_path,
        action="append",
        default=[],
        metavar="YAML",
        help="ROS parameter file of the serial driver; again for another one on top of it",
    )
    for line, name in (("dtr", "DTR"), ("rts", "RTS")):
        board.add_argument(
            f"--{line}",
            action=argparse.BooleanOptionalAction,
            help=f"level of the port's {name} line while it is open (from --params, else on)",
        )
    commands = parser.add_subparsers(required=True, metavar="run | settings", dest="command")
    run = commands.add_parser("run", parents=[board], help="check and run a program")
    run.add_argument("file", type=named_path, metavar="FILE")
    only = run.add_mutually_exclusive_group()
    only.add_argument("--check", action="store_true", help="check the file only; the port is not opened")
    only.add_argument("--dry-run", action="store_true", help="let the board check it in $C mode; nothing moves")
    settings = commands.add_parser("settings", parents=[board], help="compare, keep or write the board's settings")
    what = settings.add_mutually_exclusive_group()
    what.add_argument("--save", type=named_path, metavar="FILE", help="keep the board's settings in a file")
    what.add_argument("--write", action="store_true", help="write the configured machine's, and read them back")
    what.add_argument("--write-file", type=named_path, metavar="FILE", help="write those of a file, and read them back")
    return parser


def _on_signals(what: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for number in (*end_signals(), signal.SIGTSTP):  # a program suspended by Ctrl-Z could not hold the machine
        signal.signal(number, what)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _on_signals(signal.SIG_IGN)  # People press Ctrl-C again while the stylus rises; that must not end its retreat.
    raise KeyboardInterrupt


@ends_quietly
def main(arguments: Sequence[str] | None = None) -> int:
    """Check, then run; exit code 0 done, 1 rejected, stopped or failed, 2 usage."""
    given = make_parser().parse_args(arguments)
    try:
        config = read_config(given.params, port=given.port, dtr=given.dtr, rts=given.rts)
        if given.command == "settings" and given.write and not given.params:
            raise ConfigError("--write: the configured machine is named by --params, once for each of its files")
        name = given.file if given.command == "run" else given.write_file
        # Only these end a line for a board; the other line ends of splitlines() may occur in a comment.
        source = name.read_text(encoding="utf-8-sig", errors="replace").split("\n") if name else []
        profile = parse_profile(source) if given.command == "settings" and name else None
    except ProfileError as error:
        print(f"error: {given.write_file}: {error}", file=sys.stderr)
        return USAGE
    except (ConfigError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return USAGE
    # A shell makes its background programs ignore SIGINT; a program that moves a machine must not ignore it.
    _on_signals(_interrupt)
    if given.command == "settings":
        if not given.params and name is None and given.save is None:
            print("no --params: the machine is that of the driver's defaults", flush=True)
        if given.write:
            profile = config.expected_settings()
        return run_settings(config, save=given.save, profile=profile)
    try:
        lines = check(source, config)
    except GcodeError as error:
        print(f"{given.file}:{error.line}:{error.column}: {error.reason}", file=sys.stderr)
        return FAILED
    if not lines:
        print(f"{given.file}: nothing to send", file=sys.stderr)
        return FAILED
    print(f"{given.file}: {len(lines)} lines, about {duration_text(sum(line.seconds for line in lines))}", flush=True)
    if given.check:
        return DONE
    return run_dry(str(given.file), lines, config) if given.dry_run else run_program(source, lines, config)


if __name__ == "__main__":
    raise SystemExit(main())
