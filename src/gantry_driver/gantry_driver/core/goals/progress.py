"""Progress of a program as text: a bar, lines done, the time left."""

from __future__ import annotations

from collections.abc import Sequence

BAR = 24


def duration_text(seconds: float) -> str:
    """Return a duration in seconds as text.

    Examples
    --------
    >>> duration_text(4.26), duration_text(75.0), duration_text(3725.0)
    ('4.3 s', '1:15 min', '1:02:05 h')
    """
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d} h" if hours else f"{minutes}:{rest:02d} min"


def progress_text(done: int, ends: Sequence[float], state: str) -> str:
    """Return the line that shows a program's progress; fast, because it is called often, even for long programs.

    Parameters
    ----------
    done
        Number of executed lines.
    ends
        Time at which each line ends at its feed, s from the start.
    state
        Current state of the machine.
    """
    total, whole = len(ends), ends[-1] if ends else 0.0
    left = whole - (ends[min(done, total) - 1] if ends and done else 0.0)
    share = 1.0 - left / whole if whole > 0 else done / max(total, 1)
    full = round(BAR * share)
    bar = "#" * full + "." * (BAR - full)
    return f"[{bar}] {100 * share:3.0f} %  {done}/{total} lines  {duration_text(left)} left  {state}"
