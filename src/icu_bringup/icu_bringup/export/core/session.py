"""Goals with their answers, joint positions and commanded positions of a recorded session."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry.frames import CAMERA_LEFT, CAMERA_RIGHT
from icu_common.core.goals.intent import read_frame
from icu_common.core.goals.results import GoalResult, Outcome

Array = npt.NDArray[np.float64]
POINT, COMMAND, RESULT = "/gantry/goal", "/gantry/command", "/gantry/result"
JOINTS, TRAJECTORY, TRAJECTORY_RESULT = "/joint_states", "/gantry/trajectory", "/gantry/trajectory_result"
ANSWER = "diagnostic_msgs/msg/DiagnosticArray"
TOPICS = {
    POINT: "geometry_msgs/msg/PointStamped",
    COMMAND: "std_msgs/msg/String",
    RESULT: ANSWER,
    JOINTS: "sensor_msgs/msg/JointState",
    TRAJECTORY: "trajectory_msgs/msg/JointTrajectory",
    TRAJECTORY_RESULT: ANSWER,
}
"""Topics of a session and their types."""
GOAL_TOPICS = (POINT, COMMAND, RESULT)
"""Topics that goals and their results come from."""


@dataclass(slots=True, kw_only=True)
class RecordedGoal:
    """One goal and its result.

    Parameters
    ----------
    goal_id
        As in :class:`icu_common.core.goals.results.GoalResult`.
    task
        The command without its id, or the position of a point, as text.
    sent_ns, accepted_ns, ended_ns
        Times of reception; None if the bag has no such message.
    result
        The final answer, None without one.
    """

    goal_id: str
    task: str
    sent_ns: int
    accepted_ns: int | None = None
    ended_ns: int | None = None
    result: GoalResult | None = None

    @property
    def outcome(self) -> str:
        """``reached``, ``aborted``, ``rejected``; ``unanswered`` without a final answer."""
        return "unanswered" if self.result is None else self.result.outcome.value


@dataclass(slots=True, kw_only=True)
class RecordedMotion:
    """One trajectory: positions (N, joints) in metres, due at times (N,) in seconds after ``begun_ns``."""

    goal_id: str
    begun_ns: int
    times_s: Array
    positions_m: Array
    rejected: bool = False
    broken_ns: int | None = None


@dataclass(slots=True)
class RecordedSession:
    """Collects the messages of :data:`TOPICS` in the order of time."""

    joint_names: tuple[str, ...] = ()
    times_ns: list[int] = field(default_factory=list)
    positions_m: list[Array] = field(default_factory=list)
    goals: list[RecordedGoal] = field(default_factory=list)
    motions: list[RecordedMotion] = field(default_factory=list)

    def take(self, topic: str, received_ns: int, message: Any) -> None:
        """Process a message as decoded by rosbags; ``topic`` is without its robot's namespace."""
        match topic:
            case "/gantry/goal":
                stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                task = _place(message.point, message.header.frame_id)
                self.goals.append(RecordedGoal(goal_id=str(stamp_ns), task=task, sent_ns=received_ns))
            case "/gantry/command":
                text, _, goal_id = message.data.partition(" id=")
                self.goals.append(RecordedGoal(goal_id=goal_id or text, task=text, sent_ns=received_ns))
            case "/gantry/result":
                for result in results_of(message):
                    self._answer(result, received_ns)
            case "/joint_states":
                self.joint_names = self.joint_names or tuple(message.name)
                known = dict(zip(message.name, message.position))
                self.times_ns.append(received_ns)
                self.positions_m.append(np.array([known.get(name, math.nan) for name in self.joint_names]))
            case "/gantry/trajectory" if message.points:
                self._begin(message, received_ns)
            case "/gantry/trajectory_result":
                for result in results_of(message):
                    self._end(result, received_ns)

    def _answer(self, result: GoalResult, received_ns: int) -> None:
        # A result follows its goal; commands without an id use their text as id, which can repeat.
        waiting = [goal for goal in self.goals if goal.result is None]
        goal = next((g for g in reversed(waiting) if g.goal_id == result.goal_id), None)
        if goal is None:
            goal = RecordedGoal(goal_id=result.goal_id, task=result.goal, sent_ns=received_ns)
            self.goals.append(goal)
        if result.outcome.final:
            goal.result, goal.ended_ns = result, received_ns
        else:
            goal.accepted_ns = received_ns

    def _begin(self, message: Any, received_ns: int) -> None:
        if set(message.joint_names) != set(self.joint_names):
            return
        order = [list(message.joint_names).index(name) for name in self.joint_names]
        stamp = message.header.stamp
        self.motions.append(
            RecordedMotion(
                goal_id=read_frame(message.header.frame_id, stamp.sec * 10**9 + stamp.nanosec)[0],
                begun_ns=received_ns,
                times_s=np.array([p.time_from_start.sec + p.time_from_start.nanosec / 1e9 for p in message.points]),
                positions_m=np.array([[p.positions[i] for i in order] for p in message.points]),
            )
        )

    def _end(self, result: GoalResult, received_ns: int) -> None:
        for motion in reversed(self.motions):
            if motion.goal_id == result.goal_id:
                motion.rejected |= result.outcome is Outcome.REJECTED
                if result.outcome is Outcome.ABORTED:
                    motion.broken_ns = received_ns
                return

    def state_at(self, time_ns: int) -> Array | None:
        """Return the newest joint positions in metres at a time, None before the first."""
        number = bisect.bisect_right(self.times_ns, time_ns)
        return self.positions_m[number - 1] if number else None

    def target_at(self, time_ns: int) -> Array | None:
        """Return the joint positions in metres that were commanded for a given time.

        During a motion they are on the trajectory, by its own times; afterwards they are its last point. Without a
        command, or after a rejected or aborted motion, they are the measured positions.
        """
        state = self.state_at(time_ns)
        number = bisect.bisect_right(self.motions, time_ns, key=lambda motion: motion.begun_ns)
        motion = next((m for m in reversed(self.motions[:number]) if not m.rejected), None)
        if state is None or motion is None or (motion.broken_ns is not None and motion.broken_ns <= time_ns):
            return state
        start = self.state_at(motion.begun_ns)
        path = np.vstack([self.positions_m[0] if start is None else start, motion.positions_m])
        elapsed_s, times = (time_ns - motion.begun_ns) / 1e9, np.r_[0.0, motion.times_s]
        return np.array([np.interp(elapsed_s, times, column) for column in path.T])


def results_of(message: Any) -> list[GoalResult]:
    """Return the answers in a DiagnosticArray; other statuses are left out."""
    found = []
    for status in message.status:
        values = {pair.key: pair.value for pair in status.values}
        try:
            result = GoalResult(
                goal_id=values["goal_id"],
                goal=values.get("goal", ""),
                outcome=Outcome(values["outcome"]),
                reason=values.get("reason", ""),
                error_m=float(values.get("error_m", math.nan)),
                duration_s=float(values.get("duration_s", math.nan)),
                code=values.get("code", ""),
            )
        except (KeyError, ValueError):
            continue
        found.append(result)
    return found


def _place(point: Any, frame: str) -> str:
    if frame in (CAMERA_LEFT, CAMERA_RIGHT):
        return f"press the point at pixel {point.x:g}, {point.y:g}"
    do = "move to" if frame == "base_link" else "press"
    return f"{do} {point.x:.4f}, {point.y:.4f}, {point.z:.4f} m in {frame}"
