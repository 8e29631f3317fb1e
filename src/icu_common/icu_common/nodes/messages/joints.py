"""Joint positions and trajectories as messages, and back."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.geometry import Array
from icu_common.nodes.messages.heads import MAX_NAME
from icu_common.nodes.messages.results import MAX_PAIRS


def joint_message(
    names: Sequence[str], positions_m: Iterable[float], head: Header, contact: bool | None = None
) -> JointState:
    """Pack joint positions in metres.

    Parameters
    ----------
    contact
        Whether the switch on the last joint acts: its ``effort`` is then 1, otherwise 0. None, without a switch, leaves
        ``effort`` empty.
    """
    effort = [] if contact is None else [0.0] * (len(names) - 1) + [float(contact)]
    return JointState(header=head, name=list(names), position=[float(p) for p in positions_m], effort=effort)


def joint_contact(message: JointState, name: str) -> bool | None:
    """Return whether the switch on a joint acts, None without one.

    Raises
    ------
    ValueError
        If the message has efforts, but not 0 or 1 for this joint.
    """
    if not message.effort:
        return None
    effort = dict(zip(message.name, message.effort)).get(name)
    if effort not in (0.0, 1.0):
        raise ValueError(f"the effort of joint {plain(name, MAX_NAME)} is {effort}: expected 0 or 1")
    return bool(effort)


def _shown(names: Iterable[str]) -> str:
    return plain(", ".join(plain(name, MAX_NAME) for name in itertools.islice(names, MAX_PAIRS)))


def joint_positions(message: JointState, names: Sequence[str]) -> Array:
    """Return the positions (len(names),) in metres in the order of ``names``.

    Raises
    ------
    ValueError
        If a joint is missing or its position is not finite.
    """
    known = dict(zip(message.name, message.position))
    missing = [name for name in names if name not in known]
    if missing:
        raise ValueError(f"joint {', '.join(missing)} is missing; the message has {_shown(known)}")
    for name in names:
        if not math.isfinite(known[name]):
            raise ValueError(f"joint {name} = {known[name]} m is not finite")
    return np.array([known[name] for name in names])


def trajectory_message(
    names: Sequence[str], positions_m: npt.ArrayLike, times_s: npt.ArrayLike, head: Header
) -> JointTrajectory:
    """Pack positions (N, len(names)) in metres with their times (N,) in seconds after the start."""
    points = []
    for position, time_s in zip(np.asarray(positions_m, dtype=np.float64), np.asarray(times_s, dtype=np.float64)):
        nanoseconds = round(float(time_s) * 1e9)
        due = Duration(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)
        points.append(JointTrajectoryPoint(positions=[float(p) for p in position], time_from_start=due))
    return JointTrajectory(header=head, joint_names=list(names), points=points)


def trajectory_array(message: JointTrajectory, names: Sequence[str]) -> Array:
    """Return the positions (N, len(names)) in metres of a trajectory's points, in the order of ``names``.

    Raises
    ------
    ValueError
        If a joint is missing, or a point does not have one finite position for each joint.
    """
    missing = [name for name in names if name not in message.joint_names]
    if missing:
        raise ValueError(f"joint {', '.join(missing)} is missing; the message has {_shown(message.joint_names)}")
    order = [list(message.joint_names).index(name) for name in names]
    count = len(message.joint_names)
    for number, point in enumerate(message.points):
        if len(point.positions) != count or not np.isfinite(point.positions).all():
            found = list(point.positions[: count + 1])
            raise ValueError(f"point {number}: {found}; expected {count} finite positions")
    return np.array([point.positions for point in message.points]).reshape(-1, count)[:, order]
