"""Selection of the most informative positions, their fastest order, and its duration."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message

_TRAVEL_M_S, _STYLUS_M_S = 0.18, 0.05
"""Speeds of the controller's defaults. They determine only an order and a forecast, so a slower machine may keep
them."""
_HOP_S, _LOWER_S = 0.25, 0.15
"""Seconds that each motion of the carriage and of the stylus takes in addition to its distance: acceleration,
report."""
_LOOK_S = 0.35
_PRIOR = 1e-7
"""Information of each unknown before the first sample: negligible, but it makes the matrix invertible."""
_FAR_M = 100.0
"""Penalty, as a length, for an order that ends at the wrong position."""
_REACH_M = 0.03
"""Extension at which a stylus touches a panel: beyond every sample, so its direction matters most there."""


class Purpose(str, Enum):
    """Why the run goes to a position."""

    ABOVE = "above"
    FIT = "fit"
    CHECK = "check"
    X_BELOW = Message("tour.below")
    X_ABOVE = Message("tour.above")
    Y_BELOW = Message("tour.below_2")
    Y_ABOVE = Message("tour.above_2")
    PARK = "park"


BACKLASH = ((Purpose.X_BELOW, Purpose.X_ABOVE), (Purpose.Y_BELOW, Purpose.Y_ABOVE))
SAMPLED = (Purpose.FIT, Purpose.CHECK, *BACKLASH[0], *BACKLASH[1])
FITTED = (Purpose.FIT, Purpose.X_BELOW, Purpose.Y_BELOW)
"""Purposes from which the calibration is solved: the controller approaches all of them from below."""


class CalibrationStop(NamedTuple):
    """One goal of the run: readings x and y, and the height z in base_link; metres."""

    x: float
    y: float
    z: float
    purpose: Purpose


class Aims:
    """The target points of the stylus, and their uncertainty after a set of samples.

    All samples count as equally accurate in all directions. The uncertainty then depends only on the readings, and is
    known before the first measurement.
    """

    def __init__(self, low_xy: Sequence[float], high_xy: Sequence[float]) -> None:
        corners = itertools.product(*zip(low_xy, high_xy), (0.0, _REACH_M))
        self._aims = np.array([(*corner, 1.0) for corner in corners])

    def variance(self, readings: Sequence[Array] | Array) -> float:
        """Return the targets' mean variance after samples at ``readings`` (N, 3), relative to one sample's."""
        return self._mean(self._information(readings))

    def best(
        self, known: Array, sets: Sequence[Sequence[CalibrationStop]], seconds: Sequence[float] | None = None
    ) -> int:
        """Return the index of the set of stops that reduces the variance most, or most per second.

        Parameters
        ----------
        known
            (N, 3) m, the readings of the existing samples.
        sets
            Candidate sets of stops.
        seconds
            Duration of each set; None: all are equal.
        """
        before = self._information(known)
        now = self._mean(before)
        gains = [now - self._mean(before + self._information(readings_of(stops))) for stops in sets]
        return int(np.argmax(gains if seconds is None else np.array(gains) / np.array(seconds)))

    def _information(self, readings: Sequence[Array] | Array) -> Array:
        rows = np.reshape(np.asarray(readings, dtype=np.float64), (-1, 3))
        design = np.column_stack([rows, np.ones(len(rows))])
        return np.asarray(design.T @ design)

    def _mean(self, information: Array) -> float:
        inverse = np.linalg.inv(information + _PRIOR * np.eye(4))
        return float(np.mean(np.einsum("ai,ij,aj->a", self._aims, inverse, self._aims)))


def readings_of(stops: Sequence[CalibrationStop]) -> Array:
    """Return the readings of stops, (N, 3) m."""
    return np.array([(s.x, s.y, -s.z) for s in stops]).reshape(-1, 3)


def seconds(before: CalibrationStop | None, stops: Sequence[CalibrationStop]) -> float:
    """Return the approximate time to visit ``stops`` in order, coming from ``before``."""
    total = 0.0
    for stop in stops:
        total += _way_s(before, stop) + (_LOOK_S if stop.purpose is not Purpose.PARK else 0.0)
        before = stop
    return total


def _way_s(before: CalibrationStop | None, stop: CalibrationStop) -> float:
    x, y, z = (0.0, 0.0, 0.0) if before is None else before[:3]
    way_m = float(np.hypot(stop.x - x, stop.y - y))
    if way_m == 0.0:
        return abs(stop.z - z) / _STYLUS_M_S + _LOWER_S
    up_s, down_s = (height and abs(height) / _STYLUS_M_S + _LOWER_S for height in (z, stop.z))
    return up_s + way_m / _TRAVEL_M_S + _HOP_S + down_s


def shortest(groups: Sequence[Sequence[CalibrationStop]]) -> list[CalibrationStop]:
    """Return all stops in a short order starting from readings zero: nearest first, then 2-opt.

    Each group keeps its own order. The last stop is a held-out position, from above: it shows a drive that slips late.
    """
    points = np.array([(0.0, 0.0), *((g[0].x, g[0].y) for g in groups)])
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    order, left = [0], set(range(1, len(points)))
    while left:
        order.append(min(left, key=lambda i: apart[order[-1], i]))
        left.remove(order[-1])
    ends = [group[-1].purpose is Purpose.CHECK and not group[-1].z for group in groups]

    def length(order: list[int]) -> float:
        return float(sum(apart[a, b] for a, b in itertools.pairwise(order))) + _FAR_M * (not ends[order[-1] - 1])

    better = True
    while better:
        better = False
        for i, j in itertools.combinations(range(1, len(order) + 1), 2):
            turned = order[:i] + order[i:j][::-1] + order[j:]
            if length(turned) < length(order) - 1e-9:
                order, better = turned, True
    return [stop for i in order[1:] for stop in groups[i - 1]]
