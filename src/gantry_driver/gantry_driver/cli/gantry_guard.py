"""Own a gantry's serial port for the driver's node; hold the machine and lift the stylus when the node ends or hangs.

The node starts this program, and bring_up when the node was killed. It uses neither ROS nor numpy, so nothing that
delays the node delays it. After a guard was killed, the next one opens the port at once, by the record that it left.
See docs/explanation/guard.md.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import gc
import os
import select
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.adapters.wake_pipe import STOP_SIGNALS, WakePipe
from icu_common.adapters.processes.program_end import ends_quietly
from icu_common.adapters.real_time import DRIVER, ask_for_real_time
from icu_common.adapters.unix_listener import listen_at

SWITCH_S = 0.001
"""Seconds after which a running thread must release the interpreter: the longest wait of the port's thread."""
RECOVER_S = 15.0
"""Seconds for which ``--recover`` waits for a running guard: that one ends, or the next node finds it, before."""
LOCK_INTERVAL_S = 0.01


def parser() -> argparse.ArgumentParser:
    """Return the command line's description."""
    result = argparse.ArgumentParser(prog="gantry_guard", description=__doc__)
    where = result.add_mutually_exclusive_group(required=True)
    where.add_argument("--socket", type=Path, metavar="PATH", help="path of the socket for the node")
    where.add_argument("--port", metavar="DEVICE", help="serial port; the socket's path follows from it")
    result.add_argument(
        "--recover", action="store_true", help="wait for a running guard to end, and end unless that one was killed"
    )
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
    # Imported after the request for real time, so that busy programs do not delay the start.
    from gantry_driver.adapters.guard.port_record import RecordRefused, read_record, record_path
    from gantry_driver.adapters.guard.server import Guard

    with _locked(path.with_name(f"{path.name}.lock"), signals.read_fd, RECOVER_S if options.recover else 0.0) as alone:
        if not alone:
            if options.recover:
                return 0
            print(f"error: another guard listens at {path}", file=sys.stderr)
            return 1
        record, refused = None, ""
        try:
            record = read_record(record_path(path), path)
        except RecordRefused as error:
            record_path(path).unlink(missing_ok=True)
            refused = f"error: the record of a guard that was killed is not used, {error}"
            print(refused, file=sys.stderr)
        if options.recover and record is None:
            return 1 if refused else 0
        with listen_at(path) as listener:
            gc.collect()
            gc.freeze()
            guard = Guard(listener, signals.read_fd, stays=options.stay)
            try:
                if record is not None:
                    guard.recover(record)
                guard.run()
            finally:
                path.unlink(missing_ok=True)
    path.with_name(f"{path.name}.log").unlink(missing_ok=True)
    return 0


@contextlib.contextmanager
def _locked(path: Path, signals: int, within_s: float) -> Iterator[bool]:
    """Lock a file, and delete it at the end; yield False if another process keeps it locked, or a signal arrives."""
    end = time.monotonic() + within_s
    while True:
        with path.open("wb") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                held = path.stat().st_ino == os.fstat(lock.fileno()).st_ino  # the last owner may just have deleted it
            except OSError:
                held = False
            waits = not held and time.monotonic() < end
            if not (waits and not select.select([signals], [], [], LOCK_INTERVAL_S)[0]):
                try:
                    yield held
                finally:
                    if held:
                        path.unlink(missing_ok=True)
                return


if __name__ == "__main__":
    raise SystemExit(main())
