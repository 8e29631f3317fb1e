"""Real-time scheduling for the process that stops the machine: beside cameras it must not wait for its turn."""

from __future__ import annotations

import os

PRIORITY = 20
"""Of 1 to 99: above everything ordinary, below what the kernel runs at 50."""


def ask_for_real_time(process: int = 0) -> str:
    """Schedule a process before all ordinary ones, with the threads that it starts from now on.

    It sleeps almost always, and the kernel keeps 5 % of the time for the others whatever it does.

    Parameters
    ----------
    process
        Its number; 0 is the caller.

    Returns
    -------
    str
        Why the system does not allow it; empty when it does.
    """
    try:
        os.sched_setscheduler(process, os.SCHED_RR, os.sched_param(PRIORITY))
    except OSError as error:
        return f"real-time scheduling is not allowed ({os.strerror(error.errno or 0)})"
    return ""


def is_real_time() -> bool:
    """Return whether the calling thread is scheduled before ordinary ones."""
    return os.sched_getscheduler(0) in (os.SCHED_RR, os.SCHED_FIFO)
