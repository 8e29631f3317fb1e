"""Rates, gaps, goals and completeness of a bag, for people."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from icu_bringup.export.core.session import JOINTS, RESULT, TRAJECTORY_RESULT, RecordedGoal
from icu_common.core.configuration.text_bounds import plain

MIN_MESSAGES, STEADY, OFF, LONGEST = 10, 0.8, 0.5, 3.0
"""A topic is steady if it has ``MIN_MESSAGES`` and the share ``STEADY`` of its intervals is off the median
by at most ``OFF`` of it; an interval of more than ``LONGEST`` times the median is a gap."""
MAX_GOALS = 100
IMAGES = tuple((f"/stereo/{side}/image_raw", f"/stereo/{side}/image_raw/compressed") for side in ("left", "right"))
INFO = tuple(f"/stereo/{side}/camera_info" for side in ("left", "right"))
LATCHED = ("/gantry/machine_settings", "/gantry/driver_state")
_LEFT = (IMAGES[0], (INFO[0],))
_BOTH = (*_LEFT, IMAGES[1], (INFO[1],))
_READINGS = (*_BOTH, (JOINTS,), (LATCHED[0],))
CHECKS = (
    ("corners and recognition", _LEFT),
    ("stereo and stylus tracker", _BOTH),
    ("hand-eye calibration", _READINGS),
    ("controller", (*_READINGS, (LATCHED[1],), (TRAJECTORY_RESULT,))),
)
"""Parts of the graph in a replay, and what each needs: one of the topics in each group."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gaps:
    """Intervals of a steady topic that are too long.

    Parameters
    ----------
    median_s
        Median interval between messages.
    begins_ns, lengths_s
        Reception of the message before each gap, and the gap's length.
    """

    median_s: float
    begins_ns: tuple[int, ...]
    lengths_s: tuple[float, ...]


def gaps(times_ns: Sequence[int] | npt.NDArray[np.int64]) -> Gaps | None:
    """Return the gaps of a topic by its times of reception; None for an unsteady topic, whose gaps are undefined."""
    if len(times_ns) < MIN_MESSAGES:
        return None
    times = np.sort(np.asarray(times_ns, np.int64))
    intervals = np.diff(times) / 1e9
    median = float(np.median(intervals))
    if not median or np.mean(np.abs(intervals - median) <= OFF * median) < STEADY:
        return None
    at = np.flatnonzero(intervals > LONGEST * median)
    return Gaps(
        median_s=median,
        begins_ns=tuple(int(times[i]) for i in at),
        lengths_s=tuple(float(intervals[i]) for i in at),
    )


def gap_text(found: Gaps, start_ns: int) -> str:
    """Return one line on the gaps of a topic, "" if there are none."""
    if not found.lengths_s:
        return ""
    longest = int(np.argmax(found.lengths_s))
    count = len(found.lengths_s)
    return (
        f"{count} gap{'s' * (count > 1)} over {LONGEST * found.median_s:.3g} s, "
        f"the longest {found.lengths_s[longest]:.3g} s after {(found.begins_ns[longest] - start_ns) / 1e9:.2f} s"
    )


def goal_lines(goals: Sequence[RecordedGoal], start_ns: int, with_results: bool) -> list[str]:
    """Return a summary of a session's goals, and a line for each of the first :data:`MAX_GOALS`.

    If the bag lacks the topic of the results, no line has an outcome.
    """
    if not goals:
        return ["goals: none"]
    counts = Counter(goal.outcome for goal in goals)
    summary = ", ".join(f"{count} {outcome}" for outcome, count in sorted(counts.items()))
    lines = [f"goals: {len(goals)}, {summary if with_results else f'without results: the bag lacks {RESULT}'}"]
    for goal in goals[:MAX_GOALS]:
        line = f"  {(goal.sent_ns - start_ns) / 1e9:8.2f} s  {plain(goal.task)}"
        lines.append(f"{line}  {_outcome_text(goal)}" if with_results else line)
    if len(goals) > MAX_GOALS:
        lines.append(f"  and {len(goals) - MAX_GOALS} more")
    return lines


def _outcome_text(goal: RecordedGoal) -> str:
    result, text = goal.result, goal.outcome
    if result is None:
        return text
    if math.isfinite(result.duration_s):
        text += f" after {result.duration_s:.1f} s"
    if math.isfinite(result.error_m):
        text += f", {result.error_m * 1e3:.2f} mm off"
    return f"{text}: {plain(result.reason)}" if result.reason else text


def check_lines(topics: Collection[str]) -> list[str]:
    """Return the parts of the graph that a replay of these topics can check, and the topics that others lack."""
    lines = []
    for part, groups in CHECKS:
        missing = [group[0] for group in groups if not set(group) & set(topics)]
        lines.append(f"  {part}: " + (f"no, the bag lacks {', '.join(missing)}" if missing else "yes"))
    return ["can be checked by a replay:", *lines]
