"""Checks of a touch, before and after the contact, from its uncertainty and from the state of the cameras."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.motion.touch_error import TouchError, covariance_at, layout_sigma_m, uncertain
from gantry_driver.core.sight.pair_sight import turned_since
from icu_common.core.alignment.findings import Finding
from icu_common.core.geometry.geometry import Array

if TYPE_CHECKING:
    from gantry_driver.core.goals.world import World
    from gantry_driver.core.job.goal_job import Job


def note_error(job: Job, off: Array, look: Array, world: World, config: ControllerConfig) -> None:
    """Keep the seen offset (2,) of the tip in base_link; ``look`` (2, 2) is the covariance of the looks alone."""
    assert job.touch is not None and job.scene is not None
    named = job.gesture is not None and isinstance(job.gesture.target, str)  # a point needs no layout
    layout = layout_sigma_m(world.deviations.get(job.touch.control) if named else None)
    covariance = covariance_at(job.touch.in_base, job.scene, world.pair, layout, config.touch_error)
    job.touch_error = TouchError(seen=off, covariance=covariance + look)


def touch_finding(job: Job, world: World, config: ControllerConfig) -> Finding | None:
    """Return the finding that forbids a touch although the tip is seen above its target."""
    return world.pair_finding(config) or uncertain(job.touch_error, config.max_uncertainty_m)


def contact_finding(job: Job, world: World, config: ControllerConfig) -> Finding | None:
    """Return the finding for which a touch that was seen at its position is not confirmed."""
    return (
        world.pair_finding(config)
        or turned_since(job.pair, world.pair, config.pair_max_turn_px)
        or uncertain(job.touch_error, config.max_uncertainty_m)
    )
