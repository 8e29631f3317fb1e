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
from icu_common.core.reasons.message import Message, joined, quoted
from icu_common.core.reasons.state_text import as_message, because, split_state

_DRIVER_TEXT = {
    "disconnected": Message("hold.driver_disconnected"),
    "connecting": Message("hold.driver_connecting"),
    "unhomed": Message("hold.not_homed"),
    "homing": Message("hold.homing"),
    "moving": Message("hold.driver_moving"),
    "mismatch": Message("hold.settings_mismatch"),
    "disabled": Message("hold.not_enabled"),
}


def obstacles(world: World, config: ControllerConfig) -> Iterator[Obstacle]:
    """Yield the obstacles that keep a goal from starting, the most important first."""
    if text := world.rivals.text:
        yield Obstacle(
            code=ControllerCode.CONFLICT,
            state=because("stopped", text),
            reason=text,
            every_goal=True,
        )
    state, reason = split_state(world.driver)
    silent = world.readings is None or world.age_s(world.readings_ns) > config.joints_timeout_s
    # After a driver has died during a motion, its latched state is still "moving".
    if state != "idle" and not (state == "moving" and silent):
        name, clauses = state, [reason]
        if state not in ("stopped", "alarm"):
            why = _DRIVER_TEXT.get(state, state)
            name, clauses = "waiting", [Message("text.more", first=why, second=reason) if reason else why]
        clauses.append(world.rivals.clause(world.driver))
        if world.left_behind:
            clauses.append(world.left_behind)
        elif not tells_of_stylus(world.driver) and (state in LIFTS_NOTHING or (state == "stopped" and silent)):
            clauses.append(_left_down_text(world))
        shown = because(name, joined(clauses))
        reason = Message("hold.driver_idle_needed", driver=quoted(as_message(world.driver)))
        yield Obstacle(code=_code_of_driver(state), state=shown, reason=reason, every_goal=True)
    elif world.readings is None or silent:
        joints_s = world.age_s(world.readings_ns)
        delay = joints_delay(joints_s, config)
        yield Obstacle(
            code=ControllerCode.NO_READINGS,
            state=because("waiting", joined([Message("hold.no_joint_states"), _left_down_text(world)])),
            reason=Message(
                "hold.no_joint_states_most_allowed", since=since(joints_s), joints_timeout_s=config.joints_timeout_s
            ),
            every_goal=True,
            passing=delay is not None and joints_s <= patient_limit_s(config.joints_timeout_s, config),
            delay=delay,
        )
    elif world.unchecked and world.readings[2] > EXTENDED_M:
        text = world.left_behind_text()
        reason = Message("hold.stop_asked", text=text)
        yield Obstacle(
            code=ControllerCode.STYLUS_LEFT,
            state=because("waiting", text),
            reason=reason,
            every_goal=True,
        )
    heartbeat_age = world.heartbeat_age_s
    if heartbeat_age > config.heartbeat_timeout_s:
        yield Obstacle(
            code=ControllerCode.NO_OPERATOR,
            state=because("waiting", Message("hold.no_operator_heartbeat")),
            reason=Message(
                "hold.no_operator_heartbeat_most_allowed",
                since=since(heartbeat_age),
                heartbeat_timeout_s=config.heartbeat_timeout_s,
            ),
            every_goal=True,
        )
    if world.panel_alarm:
        text = world.panel_alarm
        yield Obstacle(
            code=ControllerCode.PANEL_ALARM,
            state=because("waiting", text),
            reason=text,
            every_goal=True,
        )
    if world.camera_from_base is None or world.base_from_reading is None:
        yield Obstacle(
            code=ControllerCode.NOT_CALIBRATED,
            state=because("waiting", Message("hold.not_calibrated")),
            reason=Message("hold.not_calibrated"),
            every_goal=False,
        )
    camera_age = world.age_s(world.camera_stamp_ns)
    if camera_age > config.camera_timeout_s:
        yield Obstacle(
            code=ControllerCode.NO_IMAGES,
            state=because("waiting", Message("hold.no_picture_left_camera")),
            reason=Message(
                "hold.no_picture_left_camera_most", since=since(camera_age), camera_timeout_s=config.camera_timeout_s
            ),
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
    """Return a clause of a state's reason if nothing has lifted the stylus, else an empty text."""
    if world.readings is None or world.readings[2] <= EXTENDED_M or world.clear_ns > world.readings_ns:
        return ""
    last_mm = 1000 * world.readings[2]
    return Message("hold.stylus_last_extended_may_still", last_mm=last_mm)
