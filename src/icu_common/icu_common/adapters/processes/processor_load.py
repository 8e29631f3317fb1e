"""Measures with psutil which programs use the processor; only when something is late, as it costs some 10 ms."""

from __future__ import annotations

import contextlib
import math
import os
import threading
import time
from collections.abc import Callable, Iterator

import psutil

from icu_common.core.processes.processor_load import ProcessorLoad, ProgramLoad, is_of_robot, program_name, sorted_loads

PACKAGES = ("gantry_driver", "harris_perception", "icu_bringup", "icu_common", "icu_simulator", "scope_ui_bridge")
OVER_S = 0.5
"""Duration of one measurement in seconds."""
FRESH_S = 3.0
"""Seconds for which a measurement is reused for other messages."""


def measure_processor_load(over_s: float = OVER_S) -> ProcessorLoad:
    """Measure for ``over_s`` seconds; this blocks, so a node uses :class:`LoadMeter`."""
    before, start_s = dict(_processor_times()), time.monotonic()
    time.sleep(over_s)  # the measured interval: no event ends it
    elapsed_s = time.monotonic() - start_s
    loads = []
    for process, used_s in _processor_times():
        # A process that started during the measurement counts from its start.
        percent = 100.0 * (used_s - before.get(process, 0.0)) / elapsed_s
        if percent < 1.0 or (process not in before and used_s > 2 * elapsed_s):
            continue
        with contextlib.suppress(psutil.Error):
            line = process.cmdline()
            name = program_name(process.name(), line)
            loads.append(ProgramLoad(name=name, percent=percent, own=is_of_robot(line, PACKAGES)))
    return ProcessorLoad(
        cores=len(os.sched_getaffinity(0)), load_average=os.getloadavg()[0], programs=sorted_loads(loads)
    )


def _processor_times() -> Iterator[tuple[psutil.Process, float]]:
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            times = process.cpu_times()
            yield process, times.user + times.system


class LoadMeter:
    """Measures in its own thread, so that no callback waits.

    Parameters
    ----------
    measure
        Returns the load; blocks.
    """

    def __init__(self, measure: Callable[[], ProcessorLoad] = measure_processor_load) -> None:
        self._measure: Callable[[], ProcessorLoad] = measure
        self._lock = threading.Lock()
        self._waiting: list[Callable[[ProcessorLoad | None], object]] = []
        self._thread: threading.Thread | None = None
        self._load: ProcessorLoad | None = None
        self._measured_s = -math.inf

    def describe(self, then: Callable[[str], object]) -> None:
        """Call ``then`` with the load as text, as :meth:`measure` does; empty where it cannot be measured."""
        self.measure(lambda load: then("" if load is None else load.text()))

    def measure(self, then: Callable[[ProcessorLoad | None], object]) -> None:
        """Call ``then`` with the load: at once if the last measurement is fresh, else from the thread."""
        with self._lock:
            if time.monotonic() - self._measured_s > FRESH_S:
                self._waiting.append(then)
                if self._thread is None:
                    self._thread = threading.Thread(target=self._run, name="load", daemon=True)
                    self._thread.start()
                return
        then(self._load)

    def finish(self, within_s: float = 2 * OVER_S) -> None:
        """Wait for a running measurement, so that messages that depend on it are still sent."""
        thread = self._thread
        if thread is not None:
            thread.join(within_s)

    def _run(self) -> None:
        load = None
        with contextlib.suppress(OSError, psutil.Error):  # /proc may be closed to this user
            load = self._measure()
        with self._lock:
            self._load, self._measured_s = load, time.monotonic()
            waiting, self._waiting, self._thread = self._waiting, [], None
        for then in waiting:
            then(load)
