"""Equilibrium of a key and the stylus's spring: stroke of the key for a travel of the drive.

The key's force is piecewise linear in its stroke. Where it falls faster than the spring relaxes, the key snaps through:
the equilibrium jumps, as on a real key.
"""

from __future__ import annotations

import itertools

from icu_simulator.keys.configuration import KeyConfig
from icu_simulator.mechanisms.spring import Push

Point = tuple[float, float]


class ForceCurve:
    """The curve of one key.

    Parameters
    ----------
    key
        Its strokes and forces.
    travel_mm
        Maximum stroke by the key's height; the part of ``key`` beyond it is ignored.
    """

    def __init__(self, key: KeyConfig, travel_mm: float) -> None:
        self.travel_mm = travel_mm
        self.acts_mm = min(key.actuation_mm, travel_mm)
        self.comes_up_mm = key.release_mm * (self.acts_mm / key.actuation_mm)
        self._return_share = key.return_share
        self.free = max(key.start_n, key.peak_n, key.contact_n, key.end_n) == 0
        """Whether the key has no force at any stroke."""
        corners = ((0.0, key.start_n), (key.peak_mm, key.peak_n), (key.actuation_mm, key.contact_n))
        self._points: tuple[Point, ...] = (*corners, (key.travel_mm, key.end_n))

    def force_n(self, stroke_mm: float) -> float:
        """Return the force in newtons at a stroke on the way in."""
        for (x0, f0), (x1, f1) in itertools.pairwise(self._points):
            if stroke_mm < x1:
                return f0 + (f1 - f0) * (stroke_mm - x0) / (x1 - x0)
        return self._points[-1][1]

    def stroke(self, before_mm: float, pushed_mm: float, spring: Push) -> float:
        """Return the key's new stroke in mm.

        Parameters
        ----------
        before_mm
            Previous stroke: a key can rest anywhere between its two curves.
        pushed_mm
            Depth of the key's top below its rest position if the ball followed the drive.
        spring
            Preload and rate of the stylus's spring, which is compressed by the distance that the key does not yield.
        """
        limit = min(pushed_mm, self.travel_mm)
        if limit <= 0 or self.free:
            return max(limit, 0.0)
        now = min(before_mm, limit)
        push = spring.preload_n + spring.rate_n_mm * (pushed_mm - now)
        if push > self.force_n(now):
            return self._advance(now, limit, pushed_mm, spring)
        if push < self.force_n(now) * self._return_share:
            return self._retreat(now, pushed_mm, spring)
        return now

    def _advance(self, now: float, limit: float, pushed_mm: float, spring: Push) -> float:
        corners = [x for x, _ in self._points if now < x < limit]
        left, surplus = now, spring.preload_n + spring.rate_n_mm * (pushed_mm - now) - self.force_n(now)
        for right in (*corners, limit):
            rest = spring.preload_n + spring.rate_n_mm * (pushed_mm - right) - self.force_n(right)
            if rest <= 0:
                return left + (right - left) * surplus / (surplus - rest)
            left, surplus = right, rest
        return limit

    def _retreat(self, now: float, pushed_mm: float, spring: Push) -> float:
        def deficit(stroke: float) -> float:
            back = self.force_n(stroke) * self._return_share
            return back - spring.preload_n - spring.rate_n_mm * (pushed_mm - stroke)

        left, lacking = now, deficit(now)
        for right in (*sorted((x for x, _ in self._points if 0 < x < now), reverse=True), 0.0):
            rest = deficit(right)
            if rest <= 0:
                return left + (right - left) * lacking / (lacking - rest)
            left, lacking = right, rest
        return 0.0
