"""Paths of the stylus in readings, for the driver, checked against the machine's limits.

A point is (gantry_x_joint, gantry_y_joint, stylus_joint) in metres; stylus_joint is the extension towards the panel.
The carriage crosses the panel only with the stylus retracted. Every target is approached from the same side (-x, -y),
so that the backlash of both axes is always taken up in the same direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message

STANDSTILL_M = 1e-6
"""Minimum length of a step in metres (a twelfth of a motor step at 80 steps/mm); shorter ones are omitted."""
EDGE_M = 2e-5
"""Maximum distance of a reading outside the limits: at a limit, the report is rounded to motor steps of 12.5 um."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionConfig(Config):
    """Reachable readings and speeds."""

    x_min_m: float = setting(0.0, "Minimum reading of gantry_x_joint", minimum=-2.0, maximum=2.0, unit="m")
    x_max_m: float = setting(0.359, "Maximum reading of gantry_x_joint", minimum=-2.0, maximum=2.0, unit="m")
    y_min_m: float = setting(0.0, "Minimum reading of gantry_y_joint", minimum=-2.0, maximum=2.0, unit="m")
    y_max_m: float = setting(0.219, "Maximum reading of gantry_y_joint", minimum=-2.0, maximum=2.0, unit="m")
    stylus_max_m: float = setting(0.059, "Maximum extension of the stylus", minimum=0.0, maximum=0.5, unit="m")
    stylus_two_positions: bool = setting(
        False, "The stylus (servo, solenoid) has only two positions: up, and down at stylus_max_m"
    )
    travel_speed_m_s: float = setting(0.18, "Speed across the panel", minimum=0.001, maximum=1.0, unit="m/s")
    stylus_speed_m_s: float = setting(0.05, "Speed of the stylus in the air", minimum=0.001, maximum=0.5, unit="m/s")
    touch_speed_m_s: float = setting(0.01, "Speed of the stylus into contact", minimum=0.0005, maximum=0.1, unit="m/s")
    touch_way_m: float = setting(
        0.003,
        "Length of the last part of the descent into contact, at touch_speed_m_s",
        minimum=0.0,
        maximum=0.05,
        unit="m",
    )
    turn_speed_m_s: float = setting(0.015, "Speed along a knob's arc", minimum=0.0005, maximum=0.1, unit="m/s")
    drag_speed_m_s: float = setting(0.06, "Speed of a drag on a screen", minimum=0.0005, maximum=0.5, unit="m/s")
    approach_m: float = setting(
        0.001,
        "Distance in x and y of the final approach to every target, from -x, -y",
        minimum=0.0,
        maximum=0.01,
        unit="m",
    )

    def lower(self) -> Array:
        """Minimum readings (3,) in metres."""
        return np.array([self.x_min_m, self.y_min_m, 0.0])

    def upper(self) -> Array:
        """Maximum readings (3,) in metres."""
        return np.array([self.x_max_m, self.y_max_m, self.stylus_max_m])


class OutOfReach(ValueError):
    """A point is outside the machine's limits; the message names the value and the limit."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Path:
    """Points (N, 3) in readings [m], with the strictly increasing times (N,) [s] after the start at which they are due.

    An empty path means that the machine is already at its target.
    """

    points: Array
    times_s: Array

    @property
    def duration_s(self) -> float:
        """Nominal duration in seconds, without the time for acceleration."""
        return float(self.times_s[-1]) if len(self.times_s) else 0.0


def check_reach(points: npt.ArrayLike, config: MotionConfig) -> None:
    """Raise :class:`OutOfReach` unless all readings (N, 3) are inside the limits."""
    readings = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    for name, column, low, high in zip(JOINTS, readings.T, config.lower(), config.upper()):
        for value in column:
            if not low - EDGE_M <= value <= high + EDGE_M:
                raise OutOfReach(Message("motion.lies_outside", name=name, value_m=value, low=low, high_m=high))


def reaches(points: npt.ArrayLike, config: MotionConfig) -> bool:
    """Whether all readings (N, 3) are inside the limits."""
    try:
        check_reach(points, config)
    except OutOfReach:
        return False
    return True


def is_at(reading: Array, aim: Array) -> bool:
    """Return whether a reading is that of an aim, rounded to motor steps."""
    return bool(np.abs(reading - aim).max() <= EDGE_M)


def travel(
    start: Array, aim_xy: Array, extension_m: float, config: MotionConfig, entered_xy: Array | None = None
) -> Path:
    """Retract, cross to ``aim_xy`` (2,) through the approach point, and lower to ``extension_m``.

    ``entered_xy`` is the position that the carriage entered from the approach side and has not left since. If it is the
    aim, only the stylus moves, as the backlash is taken up already.
    """
    check_reach([*aim_xy, extension_m], config)
    steps = _PathPoints(start)
    steps.to([*start[:2], 0.0], config.stylus_speed_m_s)
    if entered_xy is not None and is_at(start[:2], entered_xy) and np.abs(aim_xy - entered_xy).max() <= STANDSTILL_M:
        steps.to([*start[:2], extension_m], config.stylus_speed_m_s)
        return steps.path(config)
    steps.to([*_approach_point(aim_xy, config), 0.0], config.travel_speed_m_s)
    steps.to([*aim_xy, 0.0], config.travel_speed_m_s)
    steps.to([*aim_xy, extension_m], config.stylus_speed_m_s)
    return steps.path(config)


def shift(start: Array, aim_xy: Array, config: MotionConfig) -> Path:
    """Correct to ``aim_xy`` (2,) at the current height, through the approach point."""
    check_reach([*aim_xy, start[2]], config)
    steps = _PathPoints(start)
    steps.to([*_approach_point(aim_xy, config), start[2]], config.travel_speed_m_s)
    steps.to([*aim_xy, start[2]], config.travel_speed_m_s)
    return steps.path(config)


def plunge(start: Array, extension_m: float, config: MotionConfig) -> Path:
    """Lower into contact, slowly where contact is possible."""
    steps = _PathPoints(start)
    if not config.stylus_two_positions and extension_m - config.touch_way_m > start[2]:
        steps.to([*start[:2], extension_m - config.touch_way_m], config.stylus_speed_m_s)
    steps.to([*start[:2], extension_m], config.touch_speed_m_s)
    return steps.path(config)


def plunge_twice(start: Array, extension_m: float, between_m: float, config: MotionConfig) -> Path:
    """Lower into contact, rise by ``between_m``, and lower again, without a pause."""
    first = plunge(start, extension_m, config)
    steps = _PathPoints(np.array([*start[:2], extension_m]))
    steps.to([*start[:2], extension_m - between_m], config.stylus_speed_m_s)
    steps.to([*start[:2], extension_m], config.stylus_speed_m_s)
    second = steps.path(config)
    times = np.concatenate([first.times_s, first.duration_s + second.times_s])
    return Path(points=np.vstack([first.points, second.points]), times_s=times)


def aside(start: Array, middle: Array, by_m: float, config: MotionConfig) -> Path:
    """Move the retracted stylus ``by_m`` from ``middle`` (2,): beyond it if there is room, else to the outer side.

    The arm comes from +y, so the stylus hides least of the panel in -y of it. Seen from the cameras over the middle of
    the travel, the stylus leans outwards.
    """
    x, y = (float(v) for v in middle)
    if y + by_m <= config.y_max_m:
        place = x, y + by_m
    else:
        outward = 1.0 if 2 * x > config.x_min_m + config.x_max_m else -1.0
        side = outward if config.x_min_m <= x + outward * by_m <= config.x_max_m else -outward
        place = x + side * by_m, y
    steps = _PathPoints(start)
    steps.to([*start[:2], 0.0], config.stylus_speed_m_s)
    steps.to([*place, 0.0], config.travel_speed_m_s)
    return steps.path(config)


def follow(start: Array, points: Array, speed_m_s: float, config: MotionConfig) -> Path:
    """Follow (N, 3) readings in contact."""
    steps = _PathPoints(start)
    for point in points:
        steps.to(point, speed_m_s)
    return steps.path(config)


def lift(start: Array, config: MotionConfig) -> Path:
    """Retract the stylus at its position, even where the limits forbid that position."""
    steps = _PathPoints(start)
    steps.to([*start[:2], 0.0], config.stylus_speed_m_s)
    return steps.unchecked()


def _approach_point(aim_xy: Array, config: MotionConfig) -> Array:
    # At the edge of the travel there is little or no room for the approach.
    result: Array = np.maximum(np.asarray(aim_xy) - config.approach_m, config.lower()[:2])
    return result


class _PathPoints:
    """Collects points, without those that cause no motion."""

    def __init__(self, start: Array) -> None:
        self._at: Array = np.asarray(start, dtype=np.float64)
        self._points: list[Array] = []
        self._times: list[float] = []

    def to(self, point: npt.ArrayLike, speed_m_s: float) -> None:
        goal = np.asarray(point, dtype=np.float64)
        way = float(np.linalg.norm(goal - self._at))
        if not way <= STANDSTILL_M:  # also for NaN, which the limits then reject
            before = self._times[-1] if self._times else 0.0
            self._points.append(goal)
            self._times.append(before + way / speed_m_s)
            self._at = goal

    def path(self, config: MotionConfig) -> Path:
        path = self.unchecked()
        check_reach(path.points, config)
        return Path(points=np.clip(path.points, config.lower(), config.upper()), times_s=path.times_s)

    def unchecked(self) -> Path:
        return Path(points=np.array(self._points).reshape(-1, 3), times_s=np.array(self._times))
