"""What the controller has heard of the machine, the cameras, the panel and the operator, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from gantry_driver.core import controller_messages as msg
from gantry_driver.core.controller_config import ControllerConfig
from gantry_driver.core.goal_job import NANO, Fault, Obstacle
from gantry_driver.core.patience import camera_delay, joints_delay, patient_limit_s, since
from gantry_driver.core.scene import PanelMap, Scene
from gantry_driver.core.sight.panel_obstacles import panel_obstacles
from gantry_driver.core.sight.stylus_height import StylusHeight
from gantry_driver.core.stylus_state import tells_of_stylus
from icu_common.core.admission.rivals import RivalTopics
from icu_common.core.camera_model import CameraModel
from icu_common.core.delays import Delay, ResultCode
from icu_common.core.geometry import Array, Transform
from icu_common.core.panel_state import PanelSeen

EXTENDED_M = 0.0005
"""Extension above which a stylus that was left behind may be pressing something."""
CROSSED_M = 2e-5
"""Readings of x and y that differ more are motion."""
_DRIVER_TEXT = {
    "disconnected": "driver disconnected",
    "connecting": "driver connecting",
    "unhomed": "not homed",
    "homing": "homing",
    "moving": "the driver is moving",
    "mismatch": "settings mismatch",
    "disabled": "not enabled",
}
_NO_OPERATOR = "waiting: no operator (heartbeat)"
AT_AN_END = ("stopped", "alarm", _NO_OPERATOR, *(f"waiting: {t}" for s, t in _DRIVER_TEXT.items() if s != "moving"))
"""How ``/gantry/state`` begins while the machine cannot go on, or nobody is there who wants it to."""
_LIFTS_NOTHING = ("disconnected", "connecting", "unhomed", "mismatch", "alarm")
"""Driver states in which the stylus stays where it was: its position is not known any more, or nobody moves it."""


@dataclass(slots=True, kw_only=True, eq=False)
class World:
    """The newest of everything heard; times are those of reception unless named stamp.

    ``unchecked`` until it is known whether a stylus was left extended before the start; ``left_behind`` says it was.
    """

    now_ns: int = 0
    wall_ns: int = 0
    """Wall time of the newest event; ``heartbeat_ns`` is of the same clock."""
    wall_held_up_s: float = 0.0
    """The same as ``held_up_s``, in wall time."""
    held_up_s: float = 0.0
    """By how much messages may look too old, because the controller itself was held up."""
    driver: str = "disconnected: nothing heard from the driver"
    readings: Array | None = None
    readings_ns: int = 0
    crossed_ns: int = 0
    """When x or y was last seen to change, or heard of first."""
    heartbeat_ns: int | None = None
    camera: CameraModel | None = None
    camera_stamp_ns: int | None = None
    reported_panel: msg.PanelPose | None = None
    camera_from_panel: Transform | None = None
    panel_stamp_ns: int = 0
    resting_base_from_panel: Transform | None = None
    """By the last pose that was seen from where the cameras stood then."""
    confidence: float = 0.0
    confidence_ns: int = 0
    tracked_ns: int = 0
    """Stamp of the newest image in which the stylus tracker has looked for the tip."""
    panel_alarm: str = ""
    plane_due: bool = False
    """Whether the driver has yet to get the panel's plane, without which it rejects every touch."""
    panel: PanelMap | None = None
    seen: PanelSeen | None = None
    hidden_ns: dict[str, int] = field(default_factory=dict)
    lampless: set[str] = field(default_factory=set)
    """Controls that were in view, last, without a lamp that could be read."""
    camera_from_base: Transform | None = None
    base_from_reading: Array | None = None
    unchecked: bool = True
    left_behind: str = ""
    height: StylusHeight = field(default_factory=StylusHeight)
    clear_ns: int = 0
    """Stamp of the last image that proved that the stylus presses nothing."""
    rivals: RivalTopics = field(default_factory=RivalTopics)

    @property
    def here(self) -> Array:
        """(3,) the newest readings."""
        assert self.readings is not None
        return self.readings

    def machine_fault(self, config: ControllerConfig, *, pushing: bool, waiting: bool = False) -> Fault | None:
        """Return what ends every goal: a driver not at work, an operator who has gone, a panel that is in doubt.

        ``waiting``: the machine stands still and has touched nothing, so that late joint_states only cost time.
        """
        if self.rivals.text:
            return Fault(cause=self.rivals.text, stop=True)
        state = self.driver.partition(":")[0]
        if state not in ("idle", "moving"):
            return Fault(cause=f"the driver is {self.driver!r}", lift=False)
        joints_s, limit_s = self.age_s(self.readings_ns), config.joints_timeout_s
        if joints_s > (patient_limit_s(limit_s, config) if waiting else limit_s):
            cause = f"no joint_states {since(joints_s)}"
            return Fault(cause=cause, lift=False, stop=not waiting, delay=joints_delay(joints_s, config))
        if self.heartbeat_age_s > config.heartbeat_timeout_s:
            age = since(self.heartbeat_age_s)
            return Fault(cause=f"lost the operator: no heartbeat {age}")
        if self.panel_alarm:
            return Fault(cause=self.panel_alarm, stop=pushing)
        return None

    def sight_fault(
        self,
        config: ControllerConfig,
        scene: Scene,
        in_panel: Array,
        *,
        pushing: bool,
        crossing: bool,
        patient: bool = False,
    ) -> Fault | None:
        """Return what ends a touch at ``in_panel`` (3,).

        A calibration that does not fit any more, a stalled camera, or a panel that has moved since ``scene``.
        ``patient``: nothing has been touched, so that late images only cost time.
        """
        if self.base_from_reading is None:
            return Fault(cause="the calibration was withdrawn", stop=pushing)
        camera_s, limit_s = self.age_s(self.camera_stamp_ns), config.camera_timeout_s
        if camera_s > (patient_limit_s(limit_s, config) if patient else limit_s):
            cause = f"the camera has stalled: no picture {since(camera_s)}"
            return Fault(cause=cause, delay=camera_delay(camera_s, config))
        # A dip of the confidence alone means nothing: the arm hides a part of the panel.
        if self.confidence >= config.min_confidence and self.camera_from_panel is not None:
            before, now = scene.camera_from_panel, self.camera_from_panel
            if config.camera_on_carriage:
                # While the carriage moves, what is known of it and of the panel is of different moments.
                if crossing or not self.panel_is_still(config) or self.camera_from_base is None:
                    return None
                before, now = scene.base_from_panel, self.camera_from_base.inverse() @ now
            moved = float(np.linalg.norm(now.apply(in_panel) - before.apply(in_panel)))
            if moved > config.panel_moved_m:
                return Fault(
                    cause=f"the panel has moved by {1000 * moved:.1f} mm at the target, "
                    f"{1000 * config.panel_moved_m:g} mm are allowed",
                    stop=pushing,
                )
        return None

    def first_delay(self, config: ControllerConfig) -> Delay | None:
        """Return what a goal that is to start waits for, None if it waits for something else, or for nothing."""
        obstacles = list(self.obstacles(config))
        late = bool(obstacles) and all(obstacle.passing for obstacle in obstacles)
        return next((o.delay for o in obstacles if o.delay is not None), None) if late else None

    def take_readings(self, readings: Array) -> None:
        """Take where the machine stands."""
        if self.readings is None or np.abs(readings - self.readings)[:2].max() > CROSSED_M:
            self.crossed_ns = self.now_ns
        self.readings, self.readings_ns = readings, self.now_ns

    def take_tip(self, in_camera: Array, stamp_ns: int, config: ControllerConfig) -> None:
        """Note the tip's position (3,) in an image, in metres of the left camera."""
        self.tracked_ns = max(self.tracked_ns, stamp_ns)
        young = self.age_s(self.panel_stamp_ns) <= config.panel_max_age_s
        if young and self.camera_from_panel is not None and self.confidence >= config.min_confidence:
            self.height.take(stamp_ns, float(self.camera_from_panel.inverse().apply(in_camera)[2]))

    def seen_clear_m(self, config: ControllerConfig) -> float | None:
        """Return the tip's height if the position is unknown and images prove that the tip presses nothing."""
        if self.driver.partition(":")[0] not in _LIFTS_NOTHING:
            return None
        height_m = self.height.at_least_m(self.now_ns)
        return height_m if height_m is not None and height_m >= config.seen_clear_m else None

    def panel_is_still(self, config: ControllerConfig) -> bool:
        """Whether the panel's pose was seen from where the cameras are now."""
        return not config.camera_on_carriage or self.from_here(self.panel_stamp_ns, config)

    def from_here(self, stamp_ns: int, config: ControllerConfig) -> bool:
        """Whether a picture was taken since the carriage has come to rest."""
        return stamp_ns > self.crossed_ns + round(config.settle_s * NANO)

    def base_from_camera(self, scene: Scene, config: ControllerConfig) -> Transform | None:
        """Return where the camera that sees the tip is; None while cameras on the carriage have not told."""
        if not config.camera_on_carriage:
            return scene.camera_from_base.inverse()
        # The tip rests in these pictures; it is the panel that shows how far it is from its place.
        if not self.panel_is_still(config) or self.camera_from_panel is None:
            return None
        return scene.base_from_panel @ self.camera_from_panel.inverse()

    def take_seen(self, seen: PanelSeen) -> None:
        """Take what is seen of the controls, and remember since when each is hidden by something strange."""
        self.seen = seen
        hidden = [c.name for c in seen.controls if c.hidden_by == "something"]
        self.hidden_ns = {name: self.hidden_ns.get(name, seen.stamp_ns) for name in hidden}
        for control in (c for c in seen.controls if not c.hidden_by):
            (self.lampless.discard if control.lamp else self.lampless.add)(control.name)

    def recently_seen(self, config: ControllerConfig) -> PanelSeen | None:
        """Return what was last seen of the controls, None when that is too long ago."""
        fresh = self.seen is not None and self.age_s(self.seen.stamp_ns) <= config.state_max_age_s
        return self.seen if fresh else None

    def view_fault(self, config: ControllerConfig, control: str) -> Fault | None:
        """Return what ends a gesture before the touch: something over the control, or over the whole panel."""
        since_ns = self.hidden_ns.get(control)
        if since_ns is not None and self.recently_seen(config) is not None:
            assert self.seen is not None
            hidden_s = (self.seen.stamp_ns - since_ns) / NANO
            if hidden_s >= config.hidden_after_s:
                return Fault(cause=f"something (a hand?) has hidden {control} for {hidden_s:.1f} s")
        panel_s, delay = self.age_s(self.panel_stamp_ns), self.panel_delay(config)
        if delay is not None and panel_s > patient_limit_s(config.panel_max_age_s, config):
            return Fault(cause=f"no pose of the panel {since(panel_s)}: the recognition is late", delay=delay)
        if delay is None and panel_s > config.panel_max_age_s:
            return Fault(
                cause=f"the panel is not recognised {since(panel_s)}, "
                f"at most {config.panel_max_age_s:g} s are allowed: "
                "is something before it, or too little light?"
            )
        return None

    def panel_delay(self, config: ControllerConfig) -> Delay | None:
        """Return by how much the panel's pose is late; None if it is young, or if the recognition has no pose.

        A recognition that reports at present that it does not recognise the panel is not slow.
        """
        panel_s, limit_s = self.age_s(self.panel_stamp_ns), config.panel_max_age_s
        reports_none = self.confidence < config.min_confidence and self.age_s(self.confidence_ns) <= limit_s
        if panel_s <= limit_s or reports_none or not math.isfinite(panel_s):
            return None
        return Delay(code=ResultCode.LATE_IMAGE, what="pose of the panel", measured_s=panel_s, limit_s=limit_s)

    def delays(self, config: ControllerConfig) -> list[Delay]:
        """Return what is older than its limit now, though it came once, by slowness alone."""
        joints_s, camera_s = self.age_s(self.readings_ns), self.age_s(self.camera_stamp_ns)
        found = [joints_delay(joints_s, config), camera_delay(camera_s, config), self.panel_delay(config)]
        return [delay for delay in found if delay is not None]

    def take_confidence(self, value: float, config: ControllerConfig) -> None:
        """Believe the pose that came before a good confidence; forget one that came before a bad one."""
        self.confidence, self.confidence_ns = value, self.now_ns
        if self.reported_panel is not None and value >= config.min_confidence:
            self.camera_from_panel = self.reported_panel.camera_from_panel
            self.panel_stamp_ns = self.reported_panel.stamp_ns
            if self.camera_from_base is not None and self.panel_is_still(config):
                self.resting_base_from_panel = self.camera_from_base.inverse() @ self.camera_from_panel
        self.reported_panel = None

    def forget_times(self) -> None:
        """Believe no time any more, after the clock was set back."""
        self.heartbeat_ns = None
        self.camera_stamp_ns = None
        self.panel_stamp_ns = self.confidence_ns = self.tracked_ns = 0
        self.reported_panel = None
        self.seen = None
        self.hidden_ns = {}
        self.readings_ns = min(self.readings_ns, self.now_ns)
        self.crossed_ns = min(self.crossed_ns, self.now_ns)

    def age_s(self, when_ns: int | None) -> float:
        """Return how long ago that was in seconds, infinite for never.

        Right after a hold-up of the controller that time does not count: newer messages still wait in its queue.
        """
        if not when_ns:
            return math.inf
        age_s = (self.now_ns - when_ns) / NANO
        return age_s - min(self.held_up_s, max(age_s, 0.0))

    @property
    def heartbeat_age_s(self) -> float:
        """Wall seconds since the operator's newest heartbeat, infinite without one."""
        if not self.heartbeat_ns:
            return math.inf
        age_s = (self.wall_ns - self.heartbeat_ns) / NANO
        return age_s - min(self.wall_held_up_s, max(age_s, 0.0))

    def unrest(self) -> str:
        """Return the text that the machine moves or its stylus is extended, empty at rest."""
        if self.driver.partition(":")[0] in ("moving", "homing"):
            return f"the driver is {self.driver!r}"
        extended = self.readings is not None and self.readings[2] > EXTENDED_M
        return f"the stylus is extended by {1000 * self.here[2]:.1f} mm" if extended else ""

    def left_behind_text(self) -> str:
        """Say how far the stylus was extended."""
        return f"the controller started with the stylus extended by {1000 * self.here[2]:.1f} mm"

    def _left_down_text(self) -> str:
        """Say that nobody has lifted the stylus, if so, as the end of a state."""
        if self.readings is None or self.readings[2] <= EXTENDED_M or self.clear_ns > self.readings_ns:
            return ""
        last_mm = 1000 * self.readings[2]
        text = f"the stylus was last extended by {last_mm:.1f} mm and may still press: homing lifts it"
        return f"; {text}"

    def scene(self) -> Scene:
        """Return what a touch is planned with; :meth:`obstacles` must have named nothing."""
        assert self.camera_from_base is not None and self.camera_from_panel is not None
        assert self.base_from_reading is not None and self.camera is not None and self.panel is not None
        return Scene(
            camera_from_base=self.camera_from_base,
            camera_from_panel=self.camera_from_panel,
            base_from_reading=self.base_from_reading,
            panel=self.panel,
            camera=self.camera,
        )

    def obstacles(self, config: ControllerConfig) -> Iterator[Obstacle]:
        """Yield what keeps a goal from starting, the most important first."""
        if text := self.rivals.text:
            yield Obstacle(state=f"stopped: {text}", reason=text, every_goal=True)
        state, _, reason = self.driver.partition(":")
        silent = self.readings is None or self.age_s(self.readings_ns) > config.joints_timeout_s
        # A driver that died in the middle of a motion still "moves" by its latched state.
        if state != "idle" and not (state == "moving" and silent):
            shown = self.driver if state in ("stopped", "alarm") else f"waiting: {_DRIVER_TEXT.get(state, state)}"
            if state not in ("stopped", "alarm") and reason:
                shown += f": {reason.strip()}"
            shown += self.rivals.clause(self.driver)
            if self.left_behind:
                shown += f"; {self.left_behind}"
            elif not tells_of_stylus(self.driver) and (state in _LIFTS_NOTHING or (state == "stopped" and silent)):
                shown += self._left_down_text()
            yield Obstacle(state=shown, reason=f"the driver is {self.driver!r}, 'idle' is needed", every_goal=True)
        elif self.readings is None or silent:
            joints_s = self.age_s(self.readings_ns)
            delay = joints_delay(joints_s, config)
            yield Obstacle(
                state="waiting: no joint_states" + self._left_down_text(),
                reason=f"no joint_states {since(joints_s)}, at most {config.joints_timeout_s:g} s are allowed",
                every_goal=True,
                passing=delay is not None and joints_s <= patient_limit_s(config.joints_timeout_s, config),
                delay=delay,
            )
        elif self.unchecked and self.readings[2] > EXTENDED_M:
            text = self.left_behind_text()
            yield Obstacle(state=f"waiting: {text}", reason=f"{text}, a stop is asked for", every_goal=True)
        heartbeat_age = self.heartbeat_age_s
        if heartbeat_age > config.heartbeat_timeout_s:
            yield Obstacle(
                state=_NO_OPERATOR,
                reason=f"no operator heartbeat {since(heartbeat_age)}, "
                f"at most {config.heartbeat_timeout_s:g} s are allowed",
                every_goal=True,
            )
        if self.panel_alarm:
            yield Obstacle(state=f"waiting: {self.panel_alarm}", reason=self.panel_alarm, every_goal=True)
        if self.camera_from_base is None or self.base_from_reading is None:
            yield Obstacle(state="waiting: not calibrated", reason="not calibrated", every_goal=False)
        camera_age = self.age_s(self.camera_stamp_ns)
        if camera_age > config.camera_timeout_s:
            yield Obstacle(
                state="waiting: no picture from the left camera",
                reason=f"no picture from the left camera {since(camera_age)}, "
                f"at most {config.camera_timeout_s:g} s are allowed",
                every_goal=False,
                passing=camera_age <= patient_limit_s(config.camera_timeout_s, config),
                delay=camera_delay(camera_age, config),
            )
        yield from panel_obstacles(self, config)
