"""Obstacles that keep a goal from starting, derived from the controller's inputs."""

from __future__ import annotations

from collections.abc import Iterator

from gantry_driver.core.goals.panel_obstacles import panel_obstacles
from gantry_driver.core.goals.world import EXTENDED_M, LIFTS_NOTHING, World
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import Obstacle
from gantry_driver.core.job.patience import camera_delay, joints_delay, patient_limit_s, since
from gantry_driver.core.sight.pair_sight import pair_obstacles
from gantry_driver.core.states.stylus_state import tells_of_stylus
from icu_common.core.processes.delays import Delay
from icu_common.core.reasons.codes import ControllerCode
from icu_common.core.reasons.state_text import split_state

_DRIVER_TEXT = {
    "disconnected": "driver disconnected",
    "connecting": "driver connecting",
    "unhomed": "not homed",
    "homing": "homing",
    "moving": "the driver is moving",
    "mismatch": "settings mismatch",
    "disabled": "not enabled",
}


def obstacles(world: World, config: ControllerConfig) -> Iterator[Obstacle]:
    """Yield the obstacles that keep a goal from starting, the most important first."""
    if text := world.rivals.text:
        yield Obstacle(code=ControllerCode.CONFLICT, state=f"stopped: {text}", reason=text, every_goal=True)
    state, reason = split_state(world.driver)
    silent = world.readings is None or world.age_s(world.readings_ns) > config.joints_timeout_s
    # After a driver has died during a motion, its latched state is still "moving".
    if state != "idle" and not (state == "moving" and silent):
        shown = world.driver if state in ("stopped", "alarm") else f"waiting: {_DRIVER_TEXT.get(state, state)}"
        if state not in ("stopped", "alarm") and reason:
            shown += f": {reason}"
        shown += world.rivals.clause(world.driver)
        if world.left_behind:
            shown += f"; {world.left_behind}"
        elif not tells_of_stylus(world.driver) and (state in LIFTS_NOTHING or (state == "stopped" and silent)):
            shown += _left_down_text(world)
        reason = f"the driver is {world.driver!r}, 'idle' is needed"
        yield Obstacle(code=_code_of_driver(state), state=shown, reason=reason, every_goal=True)
    elif world.readings is None or silent:
        joints_s = world.age_s(world.readings_ns)
        delay = joints_delay(joints_s, config)
        yield Obstacle(
            code=ControllerCode.NO_READINGS,
            state="waiting: no joint_states" + _left_down_text(world),
            reason=f"no joint_states {since(joints_s)}, at most {config.joints_timeout_s:g} s are allowed",
            every_goal=True,
            passing=delay is not None and joints_s <= patient_limit_s(config.joints_timeout_s, config),
            delay=delay,
        )
    elif world.unchecked and world.readings[2] > EXTENDED_M:
        text = world.left_behind_text()
        reason = f"{text}, a stop is asked for"
        yield Obstacle(code=ControllerCode.STYLUS_LEFT, state=f"waiting: {text}", reason=reason, every_goal=True)
    heartbeat_age = world.heartbeat_age_s
    if heartbeat_age > config.heartbeat_timeout_s:
        yield Obstacle(
            code=ControllerCode.NO_OPERATOR,
            state="waiting: no operator (heartbeat)",
            reason=f"no operator heartbeat {since(heartbeat_age)}, "
            f"at most {config.heartbeat_timeout_s:g} s are allowed",
            every_goal=True,
        )
    if world.panel_alarm:
        text = world.panel_alarm
        yield Obstacle(code=ControllerCode.PANEL_ALARM, state=f"waiting: {text}", reason=text, every_goal=True)
    if world.camera_from_base is None or world.base_from_reading is None:
        yield Obstacle(
            code=ControllerCode.NOT_CALIBRATED,
            state="waiting: not calibrated",
            reason="not calibrated",
            every_goal=False,
        )
    camera_age = world.age_s(world.camera_stamp_ns)
    if camera_age > config.camera_timeout_s:
        yield Obstacle(
            code=ControllerCode.NO_IMAGES,
            state="waiting: no picture from the left camera",
            reason=f"no picture from the left camera {since(camera_age)}, "
            f"at most {config.camera_timeout_s:g} s are allowed",
            every_goal=False,
            passing=camera_age <= patient_limit_s(config.camera_timeout_s, config),
            delay=camera_delay(camera_age, config),
        )
    yield from panel_obstacles(world, config)
    yield from pair_obstacles(world.pair_finding(config))


def _code_of_driver(state: str) -> ControllerCode:
    """Return the code of a driver that is in a state other than idle."""
    if state in ("stopped", "alarm"):
        return ControllerCode.DRIVER_STOPPED
    return ControllerCode.DRIVER_MOVING if state == "moving" else ControllerCode.DRIVER_NOT_READY


def first_delay(world: World, config: ControllerConfig) -> Delay | None:
    """Return the delay for which a goal waits before its start, None if it waits for something else or for nothing."""
    found = list(obstacles(world, config))
    late = bool(found) and all(obstacle.passing for obstacle in found)
    return next((o.delay for o in found if isinstance(o.delay, Delay)), None) if late else None


def _left_down_text(world: World) -> str:
    """Return the end of a state's text if nothing has lifted the stylus, else an empty text."""
    if world.readings is None or world.readings[2] <= EXTENDED_M or world.clear_ns > world.readings_ns:
        return ""
    last_mm = 1000 * world.readings[2]
    text = f"the stylus was last extended by {last_mm:.1f} mm and may still press: homing lifts it"
    return f"; {text}"
