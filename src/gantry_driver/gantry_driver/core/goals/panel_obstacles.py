"""Obstacles to a touch that concern the panel: recognition, age of its pose, and its plane."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import Obstacle
from gantry_driver.core.job.patience import patient_limit_s, since
from icu_common.core.reasons.codes import ControllerCode

if TYPE_CHECKING:
    from gantry_driver.core.goals.world import World


def panel_obstacles(world: World, config: ControllerConfig) -> Iterator[Obstacle]:
    """Yield the first obstacle of the panel: not recognised, an old pose, or an unknown plane."""
    pose_age, still = world.age_s(world.panel_stamp_ns), world.panel_is_still(config)
    known = world.camera_from_panel is not None and world.panel is not None
    if not world.confidence >= config.min_confidence:
        yield Obstacle(
            code=ControllerCode.PANEL_NOT_RECOGNISED,
            state="waiting: panel not recognised",
            reason=f"the panel is recognised with confidence {world.confidence:.2f}, "
            f"at least {config.min_confidence:g} is needed",
            every_goal=False,
            passing=known and not still,
        )
    elif not known:
        missing = "pose" if world.camera_from_panel is None else "controls"
        yield Obstacle(
            code=ControllerCode.PANEL_NOT_RECOGNISED,
            state="waiting: panel not recognised",
            reason=f"the panel is not recognised: no {missing} yet",
            every_goal=False,
        )
    elif not still:
        yield Obstacle(
            code=ControllerCode.PANEL_OLD,
            state="waiting: panel pose is old",
            reason="the panel has not been seen from where the cameras have come to, "
            f"at most {config.look_timeout_s:g} s are waited for it",
            every_goal=False,
            passing=True,
        )
    elif pose_age > config.panel_max_age_s:
        yield Obstacle(
            code=ControllerCode.PANEL_OLD,
            state="waiting: panel pose is old",
            reason=f"no pose of the panel {since(pose_age)}, at most {config.panel_max_age_s:g} s are allowed",
            every_goal=False,
            passing=pose_age <= patient_limit_s(config.panel_max_age_s, config),
            delay=world.panel_delay(config),
        )
    elif world.plane_due and not world.unrest():
        yield Obstacle(
            code=ControllerCode.PANEL_PLANE_DUE,
            state="waiting: the panel's plane is being measured",
            reason="the panel's plane is being measured, and the driver does not know it yet",
            every_goal=False,
            passing=True,
        )
