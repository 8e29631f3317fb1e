"""Obstacles to a touch that concern the panel: recognition, age of its pose, and its plane."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import Obstacle
from gantry_driver.core.job.patience import patient_limit_s, since
from icu_common.core.reasons.codes import ControllerCode
from icu_common.core.reasons.message import Message
from icu_common.core.reasons.state_text import because

if TYPE_CHECKING:
    from gantry_driver.core.goals.world import World


def panel_obstacles(world: World, config: ControllerConfig) -> Iterator[Obstacle]:
    """Yield the first obstacle of the panel: not recognised, an old pose, or an unknown plane."""
    pose_age, still = world.age_s(world.panel_stamp_ns), world.panel_is_still(config)
    known = world.camera_from_panel is not None and world.panel is not None
    if not world.confidence >= config.min_confidence:
        yield Obstacle(
            code=ControllerCode.PANEL_NOT_RECOGNISED,
            state=because("waiting", Message("panel.panel_not_recognised")),
            reason=Message(
                "panel.panel_recognised_confidence_least_needed",
                confidence=world.confidence,
                min_confidence=config.min_confidence,
            ),
            every_goal=False,
            passing=known and not still,
        )
    elif not known:
        missing = "pose" if world.camera_from_panel is None else "controls"
        yield Obstacle(
            code=ControllerCode.PANEL_NOT_RECOGNISED,
            state=because("waiting", Message("panel.panel_not_recognised")),
            reason=Message("panel.panel_not_recognised_no_yet", missing=missing),
            every_goal=False,
        )
    elif not still:
        yield Obstacle(
            code=ControllerCode.PANEL_OLD,
            state=because("waiting", Message("panel.panel_pose_old")),
            reason=Message("panel.panel_not_seen_where_cameras", look_timeout_s=config.look_timeout_s),
            every_goal=False,
            passing=True,
        )
    elif pose_age > config.panel_max_age_s:
        yield Obstacle(
            code=ControllerCode.PANEL_OLD,
            state=because("waiting", Message("panel.panel_pose_old")),
            reason=Message(
                "panel.no_pose_panel_most_allowed", since=since(pose_age), panel_max_age_s=config.panel_max_age_s
            ),
            every_goal=False,
            passing=pose_age <= patient_limit_s(config.panel_max_age_s, config),
            delay=world.panel_delay(config),
        )
    elif world.plane_due and not world.unrest():
        yield Obstacle(
            code=ControllerCode.PANEL_PLANE_DUE,
            state=because("waiting", Message("panel.panel_plane_being_measured")),
            reason=Message("panel.panel_plane_being_measured_driver"),
            every_goal=False,
            passing=True,
        )
