"""Real-time scheduling for programs that move or stop the machine: they must not wait for camera processes."""

from __future__ import annotations

import os
import time

DRIVER, BRIDGE = 20, 10
"""Priorities from 1 to 99: above ordinary processes, below the kernel's threads at 50, driver above page bridge."""


def steady_s() -> float:
    """Return the seconds of a clock that cannot be set, and that continues while the computer sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def ask_for_real_time(priority: int, process: int = 0) -> str:
    """Schedule a process, and the threads that it starts later, before all ordinary processes.

    The kernel always reserves 5 % of the time for the others. A process with a higher priority keeps that priority.

    Parameters
    ----------
    priority
        1 to 99.
    process
        Process number; 0 is the caller.

    Returns
    -------
    str
        Why the system does not allow it; empty when it does.
    """
    if is_real_time(process) and os.sched_getparam(process).sched_priority >= priority:
        return ""
    try:
        os.sched_setscheduler(process, os.SCHED_RR, os.sched_param(priority))
    except OSError as error:
        return f"real-time scheduling is not allowed ({os.strerror(error.errno or 0)})"
    return ""


def give_up_real_time(process: int) -> None:
    """Schedule a process without other threads as an ordinary one: a child inherits its parent's scheduling."""
    os.sched_setscheduler(process, os.SCHED_OTHER, os.sched_param(0))


def is_real_time(process: int = 0) -> bool:
    """Return whether a process, or the calling thread, is scheduled before ordinary ones."""
    return os.sched_getscheduler(process) in (os.SCHED_RR, os.SCHED_FIFO)
