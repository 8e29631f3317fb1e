"""Episodes of a dataset: moments at a constant rate between a goal's acceptance and its final answer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from icu_bringup.export.core.session import Array, RecordedGoal, RecordedSession
from icu_common.core.goals.results import Outcome


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """One goal that was accepted and answered, and its moments in ns, ``1 / fps`` apart."""

    goal: RecordedGoal
    times_ns: tuple[int, ...]

    @property
    def success(self) -> bool:
        return self.goal.outcome == Outcome.REACHED.value


def episodes(session: RecordedSession, fps: int) -> list[Episode]:
    """Return the episodes of a session in order of time; rejected and unanswered goals have none."""
    found = []
    for goal in session.goals:
        if goal.accepted_ns is not None and goal.ended_ns is not None:
            count = (goal.ended_ns - goal.accepted_ns) * fps // 10**9 + 1
            times = tuple(goal.accepted_ns + i * 10**9 // fps for i in range(count))
            found.append(Episode(goal=goal, times_ns=times))
    return sorted(found, key=lambda episode: episode.times_ns[0])


def picture_statistics(pictures: Sequence[np.ndarray]) -> dict[str, list[Any]]:
    """Return minimum, maximum, mean and standard deviation of each channel, 0 to 1, as (C, 1, 1)."""
    pixels = np.concatenate([p.reshape(-1, p.shape[2] if p.ndim == 3 else 1) for p in pictures]) / 255.0
    values = statistics(pixels)
    return {key: value if key == "count" else [[[v]] for v in value] for key, value in values.items()} | {
        "count": [len(pictures)]
    }


def statistics(rows: Array) -> dict[str, list[Any]]:
    """Return minimum, maximum, mean, standard deviation and count of the columns of (N, C)."""
    values = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    return {**{key: value.tolist() for key, value in values.items()}, "count": [len(rows)]}


def held(
    moments: Sequence[int], messages: Iterator[tuple[str, int, bytes]], cameras: Mapping[str, str]
) -> Iterator[tuple[int, dict[str, bytes]]]:
    """Yield each moment with the newest message at that time of each camera that has one.

    Parameters
    ----------
    moments
        Times in ns, ascending.
    messages
        (topic, time of reception in ns, CDR) in the order of time.
    cameras
        Name of the camera of each topic.
    """
    newest: dict[str, bytes] = {}
    waiting = iter(moments)
    moment = next(waiting, None)
    for topic, received_ns, data in messages:
        while moment is not None and moment < received_ns:
            yield moment, dict(newest)
            moment = next(waiting, None)
        if moment is None:
            return
        newest[cameras[topic]] = data
    while moment is not None:
        yield moment, dict(newest)
        moment = next(waiting, None)
