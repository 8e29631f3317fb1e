"""The program ``mock_grbl``: a GRBL 1.1h board behind a pseudo-terminal, for any G-code sender."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from gantry_driver.mock.firmware.options import RX_BYTES, BoardOptions
from gantry_driver.mock.machine import MAX_MM, MockMachine
from gantry_driver.mock.mechanics import MechanicsOptions
from gantry_driver.mock.service import Service
from gantry_driver.mock.settings import SettingsError, make_eeprom, parse_assignment, read_settings_file

MAX_SCALE = 1000.0
MAX_LATENCY_MS = 1000.0


def _scale(text: str) -> float:
    value = float(text)
    if not 0.0 < value <= MAX_SCALE:
        raise argparse.ArgumentTypeError(f"{text} is not within 0 to {MAX_SCALE:g}")
    return value


def _baud(text: str) -> int:
    value = int(text)
    if value != 0 and not 300 <= value <= 4_000_000:
        raise argparse.ArgumentTypeError(f"{text} is neither 0 nor within 300 to 4000000")
    return value


def _latency(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= MAX_LATENCY_MS:
        raise argparse.ArgumentTypeError(f"{text} is not within 0 to {MAX_LATENCY_MS:g}")
    return value


def _start(text: str) -> tuple[float, float, float]:
    try:
        parts = [float(part) for part in text.split(",")]
    except ValueError:
        parts = []
    if len(parts) != 3 or not all(abs(part) <= MAX_MM for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form X,Y,Z in mm, each within {MAX_MM:g} mm of 0")
    return parts[0], parts[1], parts[2]


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="mock_grbl",
        description="A GRBL 1.1h board behind a pseudo-terminal. Prints the port's path on its first line.",
    )
    parser.add_argument("--link", type=Path, metavar="PATH", help="symbolic link that follows the port")
    parser.add_argument("--time-scale", type=_scale, default=1.0, metavar="F", help="board seconds per second (1)")
    parser.add_argument("--stepped", action="store_true", help="time advances only as the truth socket's client asks")
    parser.add_argument("--settings", type=Path, metavar="FILE", help="text file of $N=VALUE lines")
    parser.add_argument("--set", action="append", default=[], metavar="N=VALUE", help="one setting, after --settings")
    parser.add_argument("--truth-socket", type=Path, metavar="PATH", help="Unix socket with the motors' positions")
    parser.add_argument("--control-socket", type=Path, metavar="PATH", help="Unix socket for faults and counters")
    parser.add_argument("--log", type=Path, metavar="FILE", help="JSON lines of all that is received and done")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of everything random (0)")
    parser.add_argument("--baud", type=_baud, default=115200, metavar="N", help="line speed, 0 = unlimited (115200)")
    parser.add_argument(
        "--latency", type=_latency, default=0.0, metavar="MS", help="delay of all that the host receives, board ms (0)"
    )
    parser.add_argument("--start", type=_start, metavar="X,Y,Z", help="where the axes stand at power-up, mm")
    parser.add_argument("--keep-running", action="store_true", help="opening the port does not reset the board")
    parser.add_argument("--dialect", choices=tuple(RX_BYTES), default="GRBL", help="banner, build, buffer, settings")
    parser.add_argument("--mist", action="store_true", help="built with M7")
    return parser


def _check_folders(options: argparse.Namespace) -> None:
    for name in ("link", "truth_socket", "control_socket", "log"):
        path: Path | None = getattr(options, name)
        if path is not None and not path.parent.is_dir():
            raise NotADirectoryError(f"--{name.replace('_', '-')} {path}: there is no folder {path.parent}")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the board until SIGINT or SIGTERM, or until its log's disk is full; return the exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if "--ros-args" in given:  # bring-up starts the board like a node; it does not use ROS arguments
        begin = given.index("--ros-args")
        end = given.index("--", begin) + 1 if "--" in given[begin:] else len(given)
        del given[begin:end]
    # With a blank in front, argparse does not mistake a start of -180,-110,-5 for an option.
    options = make_parser().parse_args([f" {text}" if re.match("-[0-9.]", text) else text for text in given])
    try:
        return _run(options)
    except OSError as error:  # while it runs, only the log is written to a disk
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        print(f"error: --log {options.log}: {error.strerror}", file=sys.stderr)
        return os.EX_IOERR


def _run(options: argparse.Namespace) -> int:
    with contextlib.ExitStack() as stack:
        try:
            _check_folders(options)
            assignments = read_settings_file(options.settings) if options.settings else {}
            assignments.update(parse_assignment(text) for text in options.set)
            mechanics = MechanicsOptions() if options.start is None else MechanicsOptions(start_mm=options.start)
            machine = MockMachine(
                make_eeprom(assignments),
                board=BoardOptions(
                    baud=options.baud,
                    latency_s=options.latency / 1000.0,
                    mist=options.mist,
                    dialect=options.dialect,
                ),
                mechanics=mechanics,
                seed=options.seed,
            )
            log = stack.enter_context(options.log.open("w", encoding="utf-8")) if options.log else None
            service = Service(
                machine,
                link=options.link,
                time_scale=options.time_scale,
                truth_socket=options.truth_socket,
                control_socket=options.control_socket,
                log=log,
                reset_on_open=not options.keep_running,
                stepped=options.stepped,
            )
        except (SettingsError, OSError, ValueError) as error:
            print(f"error: {error}", file=sys.stderr)
            return 2

        def stop(number: int, frame: FrameType | None) -> None:
            service.stop()

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, stop)
        stack.callback(signal.set_wakeup_fd, signal.set_wakeup_fd(service.wakeup_fd, warn_on_full_buffer=False))
        try:
            print(options.link or service.port.path, flush=True)
        except OSError:  # the reader of the output has ended, as head does
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        service.run()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
