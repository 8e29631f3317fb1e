"""Own a gantry's serial port for the driver's node; hold the machine and lift the stylus when the node ends or hangs.

The node starts this program. It uses neither ROS nor numpy, so nothing that delays the node delays it.
See docs/explanation/guard.md.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import gc
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.adapters.guard.server import Guard
from gantry_driver.adapters.wake_pipe import STOP_SIGNALS, WakePipe
from icu_common.adapters.program_end import ends_quietly
from icu_common.adapters.real_time import DRIVER, ask_for_real_time
from icu_common.adapters.unix_listener import listen_at

SWITCH_S = 0.001
"""Seconds after which a running thread must release the interpreter: the longest wait of the port's thread."""


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="gantry_guard", description=__doc__)
    where = result.add_mutually_exclusive_group(required=True)
    where.add_argument("--socket", type=Path, metavar="PATH", help="path of the socket for the node")
    where.add_argument("--port", metavar="DEVICE", help="serial port; the socket's path follows from it")
    result.add_argument("--stay", action="store_true", help="keep running without a node, for a service manager")
    return result


@ends_quietly
def main() -> int:
    """Run the command."""
    options = parser().parse_args()
    path = options.socket or guard_path(options.port)
    ask_for_real_time(DRIVER)
    sys.setswitchinterval(SWITCH_S)
    signals = WakePipe()
    for number in STOP_SIGNALS:
        signal.signal(number, lambda *_: None)
    signal.signal(signal.SIGTSTP, signal.SIG_IGN)  # A suspended guard (Ctrl-Z) could not hold.
    signal.set_wakeup_fd(signals.write_fd, warn_on_full_buffer=False)
    with _locked(path.with_name(f"{path.name}.lock")) as alone:
        if not alone:
            print(f"error: another guard listens at {path}", file=sys.stderr)
            return 1
        with listen_at(path) as listener:
            gc.collect()
            gc.freeze()
            try:
                Guard(listener, signals.read_fd, stays=options.stay).run()
            finally:
                path.unlink(missing_ok=True)
    path.with_name(f"{path.name}.log").unlink(missing_ok=True)
    return 0


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[bool]:
    """Lock a file, and delete it at the end; yield False if another process has locked it."""
    with path.open("wb") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            held = path.stat().st_ino == os.fstat(lock.fileno()).st_ino  # the last owner may just have deleted it
        except OSError:
            held = False
        try:
            yield held
        finally:
            if held:
                path.unlink(missing_ok=True)


if __name__ == "__main__":
    raise SystemExit(main())
