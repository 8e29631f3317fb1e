"""Conversion of a goal or a gesture to a job, or to the reason of its rejection.

It is separate from the state machine because it decides whether and where to touch before anything moves, and only
once, except for a knob's next turn.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gantry_driver.core.goals.obstacles import obstacles
from gantry_driver.core.goals.world import World
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.controller_messages import PointGoal
from gantry_driver.core.job.effects import Knob, knob_of
from gantry_driver.core.job.goal_job import NANO, Aim, GoalJob
from gantry_driver.core.job.patience import goal_limit_s, since
from gantry_driver.core.motion import motion_plan, targets
from gantry_driver.core.motion.scene import Scene, TargetRefused
from gantry_driver.core.motion.targets import Touch
from gantry_driver.core.sight.layout_sight import layout_finding
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT
from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.gesture import TURNING, Gesture, Point
from icu_common.core.processes.delays import Delay, ResultCode
from icu_common.core.reasons.message import Message, quoted


def text_of(goal: PointGoal) -> str:
    """Return the goal as text for people."""
    x, y, z = goal.xyz
    if goal.frame == BASE:
        return Message("goal.move", x=x, y=y, z=z, base=BASE)
    unit = "px" if goal.frame == CAMERA_LEFT else "m"
    return Message("goal.press", x=x, y=y, unit=unit, frame=goal.frame)


def point_job(goal: PointGoal, world: World, config: ControllerConfig) -> GoalJob:
    """Return the job of a point: a move only in base_link, a press in the other frames.

    Raises
    ------
    TargetRefused, OutOfReach
        With the value and the limit.
    """
    if not np.isfinite(goal.xyz).all():
        raise TargetRefused(Message("goal.point_not_finite", xyz=", ".join(f"{v:g}" for v in goal.xyz)))
    if goal.frame not in targets.FRAMES:
        raise TargetRefused(Message("goal.frame_none", frame=quoted(goal.frame), frames=", ".join(targets.FRAMES)))
    if goal.stamp_ns != 0:
        age_s, limit_s = (world.now_ns - goal.stamp_ns) / NANO, goal_limit_s(world.held_up_s, config)
        if age_s < -config.goal_max_age_s:
            reason = Message("goal.stale_stamp_old_allowed", age_s=age_s, goal_max_age_s=config.goal_max_age_s)
            raise TargetRefused(Message("goal.stamp_future_clocks_agree", reason=reason))
        if age_s > limit_s:
            delay = Delay(code=ResultCode.STALE, what=Message("goal.goal"), measured_s=age_s, limit_s=limit_s)
            raise TargetRefused(Message("goal.stale_stamp_old_allowed", age_s=age_s, goal_max_age_s=limit_s), delay)
    if goal.frame == BASE:
        return _move_job(goal, world, config)
    x, y, z = (float(v) for v in goal.xyz)
    if z != 0.0:
        raise TargetRefused(Message("goal.z_must_0_surface_found", z=z, frame=goal.frame))
    gesture = Gesture(kind="press", target=Point(x=x, y=y, frame=goal.frame))
    return gesture_job(gesture, text_of(goal), str(goal.stamp_ns), world, config)


def _move_job(goal: PointGoal, world: World, config: ControllerConfig) -> GoalJob:
    if goal.xyz[2] > 0:
        raise TargetRefused(Message("goal.z_above_0_where_stylus", xyz_m=goal.xyz[2]))
    if goal.xyz[2] < 0 and config.motion.stylus_two_positions:
        raise TargetRefused(Message("goal.z_stylus_can_only_up", xyz_m=goal.xyz[2]))
    for obstacle in obstacles(world, config):
        if obstacle.every_goal:
            raise TargetRefused(obstacle.reason, obstacle.delay)
    axes = world.base_from_reading
    aim = Aim(base_from_reading=np.eye(2) if axes is None else axes)
    motion_plan.check_reach(aim.readings_at(goal.xyz[np.newaxis]), config.motion)
    if goal.xyz[2] < 0:
        _check_clear(goal.xyz, world, config)
    return GoalJob(
        goal_id=str(goal.stamp_ns), text=text_of(goal), kind="move", started_ns=world.now_ns, aim=aim, point=goal.xyz
    )


def _check_clear(goal: Array, world: World, config: ControllerConfig) -> None:
    """Reject a point (3,) in base_link at which the stylus would touch the panel, as far as the panel is known."""
    parts = (world.camera_from_base, world.base_from_reading, world.camera_from_panel, world.camera, world.panel)
    if any(part is None for part in parts):
        return
    scene, touch = world.scene(), config.touch
    if config.camera_on_carriage:
        # Until the cameras see the panel from their current position, its last seen pose counts.
        if world.resting_base_from_panel is None:
            return
        scene = replace(scene, camera_from_panel=scene.camera_from_base @ world.resting_base_from_panel)
    elif not world.confidence >= config.min_confidence:
        return
    lowest = targets.highest_near(goal[:2], scene, touch.side_needed_m()) + touch.ball_radius_m
    if goal[2] < lowest:
        raise TargetRefused(Message("goal.z_touch_panel_lowest_use", goal_m=goal[2], lowest_m=lowest))


def gesture_job(gesture: Gesture, text: str, goal_id: str, world: World, config: ControllerConfig) -> GoalJob:
    """Return the job of a gesture, with ``text`` for people; the job is unplanned if the panel is still to be seen.

    Raises
    ------
    TargetRefused, OutOfReach
        With the value and the limit.
    """
    if isinstance(gesture.target, Point) and gesture.target.frame not in targets.FRAMES:
        raise TargetRefused(
            Message("goal.frame_none", frame=quoted(gesture.target.frame), frames=", ".join(targets.FRAMES))
        )
    for obstacle in sorted(obstacles(world, config), key=lambda o: o.passing):
        if not obstacle.passing or _in_picture(gesture):
            raise TargetRefused(obstacle.reason, obstacle.delay)
        aim = Aim(base_from_reading=np.eye(2))
        return GoalJob(goal_id=goal_id, text=text, kind=gesture.kind, started_ns=world.now_ns, aim=aim, gesture=gesture)
    scene, seen = world.scene(), world.recently_seen(config)
    knob = None
    if gesture.kind in TURNING and isinstance(gesture.target, str):
        scene.control(gesture.target)
        if seen is None:
            _check_marker_not_old(gesture.target, gesture.kind, world, config)
        knob = knob_of(gesture, gesture.target, None if seen is None else seen.control(gesture.target))
    elif gesture.kind in ("click", "set"):
        raise TargetRefused(Message("goal.needs_knob_name_found", kind=gesture.kind, gesture=quoted(gesture.text())))
    touch = find_touch(gesture, knob, scene, config)
    if (finding := layout_finding(touch.control, world.deviations)) is not None:
        raise TargetRefused(finding.text(), finding)
    found = None if seen is None else seen.control(touch.control)
    if found is not None and found.hidden_by == "edge" and not config.camera_on_carriage:
        raise TargetRefused(Message("goal.not_picture", control=touch.control))
    if config.require_effect and seen is None and knob is None and touch.control:
        raise TargetRefused(Message("goal.nothing_seen_panel_state_effect", kind=gesture.kind))
    hold_s = {"hold": gesture.argument, "press": config.press_s, "long": config.long_press_s}
    return GoalJob(
        goal_id=goal_id,
        text=text,
        kind=gesture.kind,
        started_ns=world.now_ns,
        aim=Aim(base_from_reading=scene.base_from_reading),
        scene=scene,
        touch=touch,
        gesture=gesture,
        knob=knob,
        before=seen,
        hold_s=hold_s.get(gesture.kind, 0.0),
    )


def _in_picture(gesture: Gesture) -> bool:
    """Whether the gesture names a position by its pixel, which is another position in the next image."""
    return any(isinstance(place, Point) and place.frame == CAMERA_LEFT for place in (gesture.target, gesture.to))


def _check_marker_not_old(name: str, kind: str, world: World, config: ControllerConfig) -> None:
    """Reject a knob whose marker was last read too long ago: turned unseen, its final angle would be unknown."""
    last = None if world.seen is None else world.seen.control(name)
    if world.seen is not None and last is not None and not (kind == "turn" and math.isnan(last.angle_deg)):
        age_s, limit_s = world.age_s(world.seen.stamp_ns), config.state_max_age_s
        raise TargetRefused(
            Message("goal.nothing_seen_most_allowed_try", name=name, since=since(age_s), limit_s=limit_s),
            Delay(code=ResultCode.SLOW, what=Message("goal.marker", name=name), measured_s=age_s, limit_s=limit_s),
        )


def find_touch(gesture: Gesture, knob: Knob | None, scene: Scene, config: ControllerConfig) -> Touch:
    """Return the touch of the gesture, for a knob with its next turn; raises TargetRefused or OutOfReach."""
    way = gesture.argument if knob is None else knob.way_deg
    if gesture.kind in TURNING and not abs(way) > 0:
        way = 1.0  # unknown before the first look at the knob: any turn shows whether the knob is within reach
    stands = math.nan if knob is None else knob.seen_deg
    if knob is not None and math.isnan(stands):
        stands = 0.0  # also unknown; a dimple is not touched before its marker has been seen
    touch = targets.resolve(
        gesture,
        scene,
        config.touch,
        wander_m=config.wander_m(),
        turn_deg=way,
        knob_deg=stands,
        key_travel_m=config.contact.max_travel_m,
    )
    if config.motion.stylus_two_positions:
        touch = targets.with_two_positions(touch, config.motion.stylus_max_m)
    heights = np.array([[*touch.in_base[:2], z] for z in (touch.hover_z, touch.touch_z)])
    aim = Aim(base_from_reading=scene.base_from_reading)
    motion_plan.check_reach(aim.readings_at(np.vstack([heights, touch.arc])), config.motion)
    return touch
