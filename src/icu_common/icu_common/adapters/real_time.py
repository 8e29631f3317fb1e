"""Real-time scheduling for what stops the machine, or lets it move: beside cameras it must not wait for its turn."""

from __future__ import annotations

import os
import time

DRIVER, BRIDGE = 20, 10
"""Of 1 to 99: above everything ordinary, below what the kernel runs at 50; the driver before the page's bridge."""


def steady_s() -> float:
    """Return the seconds of a clock that nobody sets, and that goes on while the computer sleeps."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def ask_for_real_time(priority: int, process: int = 0) -> str:
    """Schedule a process before all ordinary ones, with the threads that it starts from now on.

    The kernel keeps 5 % of the time for the others whatever it does. One that has a higher priority keeps it.

    Parameters
    ----------
    priority
        1 to 99.
    process
        Its number; 0 is the caller.

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
    """Schedule a process, which has no other threads yet, as ordinary ones are: a child has what its parent has."""
    os.sched_setscheduler(process, os.SCHED_OTHER, os.sched_param(0))


def is_real_time(process: int = 0) -> bool:
    """Return whether a process, or the calling thread, is scheduled before ordinary ones."""
    return os.sched_getscheduler(process) in (os.SCHED_RR, os.SCHED_FIFO)
