"""Conversion of trajectories in metres to G-code in machine coordinates; only here do metres become millimetres.

Each rejection is a :class:`TrajectoryError` that names the point, the joint, the value and the limit; nothing moves.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.lines import SYNCHRONISE, plain
from icu_common.core.geometry.frames import JOINTS
from icu_common.core.reasons.message import Message

_M_WORD, _S_WORD = re.compile(r"M(\d+)"), re.compile(r"S([\d.]+)")
_END_M = 0.0005
"""Distance from an end within which a stylus with two positions is meant to be at that end."""
_ROUNDING_M = 1e-6
"""Distance outside the limits up to which readings are rounding, not intent, and are clipped."""
MODES = "G21G90G94"
"""Millimetres, absolute, feed per minute: a start-up block on the board may have chosen others."""
SAME_FEED = 0.005
"""Relative change of speed that is rounding of positions and times; it needs no new feed, whose line waits for answers.
"""


class TrajectoryError(ValueError):
    """The trajectory cannot be executed; the message names the point, the value and the limit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """One point of a trajectory: readings of the joints in the order of the trajectory's names.

    Parameters
    ----------
    positions_m
        Readings in metres.
    velocities_m_s
        Their magnitude is the speed along the segment that ends here; empty or zero if the point gives none.
    time_s
        Time from the start at which the point is reached; 0 if the point gives none.
    """

    positions_m: tuple[float, ...]
    velocities_m_s: tuple[float, ...] = ()
    time_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class StraightMove:
    """A straight move in machine coordinates, mm, with the feed of its F word, mm/min.

    ``axes`` is 2 if the stylus is not an axis of the board.
    """

    start_mm: tuple[float, float, float]
    end_mm: tuple[float, float, float]
    feed: str
    axes: int = 3

    def part(self, start_mm: tuple[float, float, float], end_mm: tuple[float, float, float]) -> StraightMove:
        """Return a part of the move."""
        return StraightMove(start_mm=start_mm, end_mm=end_mm, feed=self.feed, axes=self.axes)


@dataclass(frozen=True, slots=True, kw_only=True)
class StylusOrder:
    """Order to lower or lift a stylus without a Z axis, with the time that this takes."""

    down: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class TrajectoryMotion:
    """Motion of a trajectory: its parts, the readings at its end (m) and its approximate duration.

    ``start_mm`` and ``end_mm`` are machine positions.
    """

    parts: tuple[StraightMove | StylusOrder, ...]
    start_mm: tuple[float, float, float]
    end_mm: tuple[float, float, float]
    end_m: tuple[float, float, float]
    seconds: float

    @property
    def moves(self) -> list[StraightMove]:
        return [part for part in self.parts if isinstance(part, StraightMove)]


def joint_order(names: Sequence[str]) -> tuple[int, ...]:
    """Return the indices of x, y and stylus in ``names``; -1 for a joint that is not moved.

    Raises
    ------
    TrajectoryError
        For unknown, repeated or missing names.
    """
    unknown = [name for name in names if name not in JOINTS]
    if unknown or not names or len(set(names)) != len(names):
        raise TrajectoryError(Message("path.joint_names_some_each_once", names=list(names), joints=", ".join(JOINTS)))
    return tuple(list(names).index(joint) if joint in names else -1 for joint in JOINTS)


def write_motion(
    names: Sequence[str], points: Sequence[Waypoint], start_m: tuple[float, float, float], config: DriverConfig
) -> TrajectoryMotion:
    """Return the motion of a trajectory that starts at the readings ``start_m``.

    The speed of a segment is the point's speed, else the speed that meets its time, else the configured feed. A speed
    that an axis cannot reach is rejected, not silently reduced, unless it is a configured feed.

    Raises
    ------
    TrajectoryError
        If a value is not finite, outside the limits or too fast, or if the times do not increase.
    """
    order = joint_order(names)
    if not 0 < len(points) <= config.max_points:
        raise TrajectoryError(
            Message("path.trajectory_points_1_needed", points=len(points), max_points=config.max_points)
        )
    parts: list[StraightMove | StylusOrder] = []
    here, clock, total = start_m, 0.0, 0.0
    for number, point in enumerate(points, 1):
        target = _target(number, point, order, here, config)
        seconds = _seconds(number, point, here, target, clock, config)
        clock = point.time_s if point.time_s > 0 else clock + seconds
        parts += _segment(here, target, seconds, config)
        total += seconds + (config.stylus.dwell_s if config.stylus.kind != "z_axis" and target[2] != here[2] else 0.0)
        here = target
    start_mm, end_mm = (_rounded(mpos_mm(place, config)) for place in (start_m, here))
    return TrajectoryMotion(parts=tuple(parts), start_mm=start_mm, end_mm=end_mm, end_m=here, seconds=total)


def stylus_dwell(config: DriverConfig) -> str:
    """Return the dwell in which a stylus without a Z axis moves."""
    return f"G4P{plain(config.stylus.dwell_s)}"


def stylus_lines(down: bool, config: DriverConfig) -> tuple[str, str]:
    """Return the lines that lower or lift a stylus without a Z axis, and the dwell in which it moves."""
    stylus = config.stylus
    if stylus.kind == "servo_m3":
        return f"M3S{plain(stylus.servo_down if down else stylus.servo_up)}", stylus_dwell(config)
    return "M8" if down else "M9", stylus_dwell(config)


def lift_lines(config: DriverConfig) -> tuple[str, ...]:
    """Return the lines that take the stylus off the panel and move nothing else."""
    if config.stylus.kind != "z_axis":
        return (MODES, *stylus_lines(False, config), SYNCHRONISE)
    top = config.machine.homed_mpos_mm()[2]
    return (MODES, f"F{plain(config.stylus_feed_m_s * 60_000.0)}Z{plain(top)}G53G1", SYNCHRONISE)


def may_be_down_after(line: str, config: DriverConfig) -> bool | None:
    """Return whether a stylus without a Z axis may be down after a line; None for a line that does not touch it."""
    codes = {int(number) for number in _M_WORD.findall(line)}
    if config.stylus.kind == "solenoid_m8":
        return bool(codes & {7, 8}) if codes & {2, 7, 8, 9, 30} else None
    speed = _S_WORD.search(line)
    if speed is None and not codes & {2, 3, 4, 5, 30}:
        return None
    # Only this line surely lifts it: a servo without power, as after M5, stays where it is pushed.
    up = speed is not None and abs(float(speed[1]) - config.stylus.servo_up) < 1e-3 and bool(codes & {3, 4})
    return not up or bool(codes & {2, 30})


def mpos_mm(reading_m: tuple[float, float, float], config: DriverConfig) -> tuple[float, float, float]:
    """Return the machine coordinates in mm of readings in metres (the third is meaningful only with a Z axis)."""
    home = config.machine.homed_mpos_mm()
    x, y, z = (home[a] + config.machine.sign(a) * reading_m[a] * 1000.0 for a in range(3))
    return x, y, z


def reading_m(mpos: Sequence[float], stylus_down: bool, config: DriverConfig) -> tuple[float, float, float]:
    """Return the readings in metres of machine coordinates in mm; a stylus without a Z axis is where it was ordered."""
    home = config.machine.homed_mpos_mm()
    x, y, z = ((mpos[a] - home[a]) * config.machine.sign(a) / 1000.0 + 0.0 for a in range(3))
    if config.stylus.kind != "z_axis":
        z = config.stylus.stroke_m if stylus_down else 0.0
    return x, y, z


def _target(
    number: int, point: Waypoint, order: tuple[int, ...], here: tuple[float, float, float], config: DriverConfig
) -> tuple[float, float, float]:
    if len(point.positions_m) != sum(place >= 0 for place in order):
        raise TrajectoryError(
            Message(
                "path.point_positions_joints",
                number=number,
                positions_m=len(point.positions_m),
                order=sum(p >= 0 for p in order),
            )
        )
    if not all(math.isfinite(v) for v in (*point.velocities_m_s, point.time_s)):
        raise TrajectoryError(
            Message(
                "path.point_velocities_time_not_finite",
                number=number,
                velocities_m_s=point.velocities_m_s,
                time_s=point.time_s,
            )
        )
    if point.time_s < 0:
        raise TrajectoryError(Message("path.point_time_start_negative", number=number, time_s=point.time_s))
    target = list(here)
    for axis, (place, limit) in enumerate(zip(order, config.limits_m())):
        if place < 0:
            continue
        value = point.positions_m[place]
        if not math.isfinite(value):
            raise TrajectoryError(Message("path.point_not_finite", number=number, joints=JOINTS[axis], value=value))
        # At its end an axis reports the nearest motor step, and a trajectory may keep it there.
        slack = _ROUNDING_M + 1e-3 / config.machine.steps_per_mm[axis]
        if not -slack <= value <= limit + slack:
            raise TrajectoryError(
                Message("path.point_outside_0", number=number, joints=JOINTS[axis], value_m=value, limit_m=limit)
            )
        target[axis] = min(max(value, 0.0), limit)
    x, y, z = target
    if config.stylus.kind != "z_axis":
        down_m = config.stylus.stroke_m
        if min(z, abs(down_m - z)) > _END_M:
            # Rounded to the nearer end, the stylus would press where it should hover.
            raise TrajectoryError(
                Message(
                    "path.point_between_up_0_down",
                    number=number,
                    joints=JOINTS[2],
                    z_m=z,
                    down_m=down_m,
                    kind=config.stylus.kind,
                )
            )
        z = down_m if z > down_m / 2 else 0.0
    return x, y, z


def _seconds(
    number: int,
    point: Waypoint,
    here: tuple[float, float, float],
    target: tuple[float, float, float],
    clock: float,
    config: DriverConfig,
) -> float:
    """Return the duration of the segment that ends at ``point``, in seconds."""
    axes = 3 if config.stylus.kind == "z_axis" else 2
    way = [abs(target[a] - here[a]) for a in range(axes)]
    distance = math.hypot(*way)
    speed = math.hypot(*point.velocities_m_s)
    if speed > 0:
        seconds = distance / speed
    elif point.time_s > 0:
        seconds = point.time_s - clock
        if not seconds > 0 and distance > 0:
            raise TrajectoryError(
                Message("path.point_time_start_not_follow", number=number, time_s=point.time_s, clock_s=clock)
            )
    else:
        stylus = way[2] / config.stylus_feed_m_s if axes == 3 else 0.0
        return max(math.hypot(*way[:2]) / config.feed_m_s, stylus)
    for axis in range(axes):
        rate = way[axis] / seconds * 60_000.0 if seconds else way[axis] and math.inf
        limit = config.machine.max_rate_mm_min[axis]
        if rate > limit * 1.001:
            raise TrajectoryError(
                Message("path.point_min_above_min", number=number, joints=JOINTS[axis], rate=rate, limit=limit)
            )
    return seconds


def _segment(
    here: tuple[float, float, float], target: tuple[float, float, float], seconds: float, config: DriverConfig
) -> list[StraightMove | StylusOrder]:
    start, end = _rounded(mpos_mm(here, config)), _rounded(mpos_mm(target, config))
    axes = 3 if config.stylus.kind == "z_axis" else 2
    if axes == 2:
        end = (*end[:2], start[2])
    move: list[StraightMove | StylusOrder] = []
    if any(plain(end[a]) != plain(start[a]) for a in range(axes)):
        distance = math.hypot(*(end[a] - start[a] for a in range(axes)))
        # Below 1 mm/min GRBL's planner needs minutes for one step; such a segment is rounding.
        feed = max(distance / seconds * 60.0, 1.0) if seconds else config.feed_m_s * 6e4
        move = [StraightMove(start_mm=start, end_mm=end, feed=plain(feed, 1), axes=axes)]
    if config.stylus.kind == "z_axis" or target[2] == here[2]:
        return move
    # Without a Z axis the stylus is up during every move that starts or ends in the air.
    down = target[2] > 0
    return [*move, StylusOrder(down=True)] if down else [StylusOrder(down=False), *move]


def _rounded(place: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a machine position with the decimals that lines have."""
    x, y, z = (round(value, 3) for value in place)
    return x, y, z
