"""Latest inputs of the controller (machine, cameras, panel and operator), and the faults that follow from them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gantry_driver.core.envelope.plane import PanelPlane
from gantry_driver.core.job import controller_messages as msg
from gantry_driver.core.job.controller_config import ControllerConfig
from gantry_driver.core.job.goal_job import NANO, Fault
from gantry_driver.core.job.patience import camera_delay, joints_delay, patient_limit_s, since
from gantry_driver.core.motion.scene import PanelMap, Scene
from gantry_driver.core.sight.layout_sight import seen_panel
from gantry_driver.core.sight.pair_sight import pair_finding
from gantry_driver.core.sight.stylus_height import StylusHeight
from icu_common.core.admission.rivals import RivalTopics
from icu_common.core.alignment.findings import Finding, FindingCode
from icu_common.core.alignment.layout import ControlDeviation
from icu_common.core.alignment.pair import PairState
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_state import PanelSeen
from icu_common.core.processes.delays import Delay, ResultCode
from icu_common.core.reasons.message import Message, quoted
from icu_common.core.reasons.state_text import as_message, because, state_name

EXTENDED_M = 0.0005
"""Extension above which a stylus that was left behind may be pressing something."""
CROSSED_M = 2e-5
"""Difference of readings in x or y above which the machine counts as moving."""
LIFTS_NOTHING = ("disconnected", "connecting", "unhomed", "mismatch", "alarm")
"""Driver states in which the stylus stays where it was: its position is no longer known, or nothing moves it."""


@dataclass(slots=True, kw_only=True, eq=False)
class World:
    """Latest input of each kind; times are those of reception unless named stamp.

    ``unchecked`` is true until it is known whether a stylus was left extended before the start. ``left_behind`` is a
    text if it was.
    """

    now_ns: int = 0
    wall_ns: int = 0
    """Wall time of the newest event; ``heartbeat_ns`` uses the same clock."""
    wall_held_up_s: float = 0.0
    """The same as ``held_up_s``, in wall time."""
    held_up_s: float = 0.0
    """Seconds by which messages may look too old, because the controller itself was blocked."""
    driver: str = because("disconnected", Message("inputs.nothing_heard_driver"))
    readings: Array | None = None
    readings_ns: int = 0
    crossed_ns: int = 0
    """Time of the last change of x or y, or of the first reading."""
    heartbeat_ns: int | None = None
    camera: CameraModel | None = None
    camera_stamp_ns: int | None = None
    reported_panel: msg.PanelPose | None = None
    camera_from_panel: Transform | None = None
    panel_stamp_ns: int = 0
    resting_base_from_panel: Transform | None = None
    """Panel's pose in base_link, from the last image taken with the cameras at rest."""
    confidence: float = 0.0
    confidence_ns: int = 0
    tracked_ns: int = 0
    """Stamp of the newest image in which the stylus tracker has searched for the tip."""
    panel_alarm: str = ""
    plane: PanelPlane | None = None
    """Panel's plane that was last sent to the driver."""
    plane_due: bool = False
    """Whether the driver still needs the panel's plane, without which it rejects every touch."""
    panel: PanelMap | None = None
    seen: PanelSeen | None = None
    hidden_ns: dict[str, int] = field(default_factory=dict)
    lampless: set[str] = field(default_factory=set)
    """Controls that, when last in view, had no readable lamp."""
    camera_from_base: Transform | None = None
    base_from_reading: Array | None = None
    unchecked: bool = True
    left_behind: str = ""
    height: StylusHeight = field(default_factory=StylusHeight)
    clear_ns: int = 0
    """Stamp of the last image that proved that the stylus presses nothing."""
    pair: PairState | None = None
    """State of the right camera as the stylus tracker reports it, None while no tracker reports."""
    deviations: Mapping[str, ControlDeviation] = field(default_factory=dict)
    rivals: RivalTopics = field(default_factory=RivalTopics)

    @property
    def here(self) -> Array:
        """Newest readings (3,) in metres."""
        assert self.readings is not None
        return self.readings

    def machine_fault(self, config: ControllerConfig, *, pushing: bool, waiting: bool = False) -> Fault | None:
        """Return the fault that ends any goal: a driver that is not running, an absent operator, a panel in doubt.

        ``waiting``: the machine is at rest and has touched nothing, so that late joint_states only cost time.
        """
        if self.rivals.text:
            return Fault(cause=self.rivals.text, stop=True)
        state = state_name(self.driver)
        if state not in ("idle", "moving"):
            return Fault(cause=Message("inputs.driver", driver=quoted(as_message(self.driver))), lift=False)
        joints_s, limit_s = self.age_s(self.readings_ns), config.joints_timeout_s
        if joints_s > (patient_limit_s(limit_s, config) if waiting else limit_s):
            cause = Message("inputs.no_joint_states", since=since(joints_s))
            return Fault(cause=cause, lift=False, stop=not waiting, delay=joints_delay(joints_s, config))
        if self.heartbeat_age_s > config.heartbeat_timeout_s:
            age = since(self.heartbeat_age_s)
            return Fault(cause=Message("inputs.lost_operator_no_heartbeat", age=age))
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
        """Return the fault that ends a touch at ``in_panel`` (3,).

        It is an outdated calibration, a stalled camera, or a panel that has moved since ``scene``.
        ``patient``: nothing has been touched, so that late images only cost time.
        """
        if self.base_from_reading is None:
            return Fault(cause=Message("inputs.calibration_withdrawn"), stop=pushing)
        camera_s, limit_s = self.age_s(self.camera_stamp_ns), config.camera_timeout_s
        if camera_s > (patient_limit_s(limit_s, config) if patient else limit_s):
            cause = Message("inputs.camera_stalled_no_picture", since=since(camera_s))
            return Fault(cause=cause, delay=camera_delay(camera_s, config))
        finding = self.pair_finding(config)
        if finding is not None and finding.code is FindingCode.CAMERA_MOVED:
            return Fault(cause=finding.text(), stop=pushing, delay=finding)
        # Low confidence alone is no fault: the arm hides a part of the panel.
        if self.confidence >= config.min_confidence and self.camera_from_panel is not None:
            before, now = scene.camera_from_panel, self.camera_from_panel
            if config.camera_on_carriage:
                # While the carriage moves, its position and the panel's pose belong to different times.
                if crossing or not self.panel_is_still(config) or self.camera_from_base is None:
                    return None
                before, now = scene.base_from_panel, self.camera_from_base.inverse() @ now
            moved = float(np.linalg.norm(now.apply(in_panel) - before.apply(in_panel)))
            if moved > config.panel_moved_m:
                return Fault(
                    cause=Message(
                        "inputs.panel_moved_target_allowed",
                        moved_mm=1000 * moved,
                        panel_moved_mm=1000 * config.panel_moved_m,
                    ),
                    stop=pushing,
                )
        return None

    def take_readings(self, readings: Array) -> None:
        """Take the machine's position."""
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
        if state_name(self.driver) not in LIFTS_NOTHING:
            return None
        height_m = self.height.at_least_m(self.now_ns)
        return height_m if height_m is not None and height_m >= config.seen_clear_m else None

    def panel_is_still(self, config: ControllerConfig) -> bool:
        """Whether the panel's pose was seen from where the cameras are now."""
        return not config.camera_on_carriage or self.from_here(self.panel_stamp_ns, config)

    def from_here(self, stamp_ns: int, config: ControllerConfig) -> bool:
        """Whether an image was taken after the carriage came to rest."""
        return stamp_ns > self.crossed_ns + round(config.settle_s * NANO)

    def base_from_camera(self, scene: Scene, config: ControllerConfig) -> Transform | None:
        """Return the pose of the camera that sees the tip; None while it is unknown with cameras on the carriage."""
        if not config.camera_on_carriage:
            return scene.camera_from_base.inverse()
        # The tip is at rest in these images; the panel's pose shows the distance of the tip from its target.
        if not self.panel_is_still(config) or self.camera_from_panel is None:
            return None
        return scene.base_from_panel @ self.camera_from_panel.inverse()

    def take_seen(self, seen: PanelSeen) -> None:
        """Take the seen states of the controls, and note since when an unknown object has hidden each of them."""
        self.seen = seen
        hidden = [c.name for c in seen.controls if c.hidden_by == "something"]
        self.hidden_ns = {name: self.hidden_ns.get(name, seen.stamp_ns) for name in hidden}
        for control in (c for c in seen.controls if not c.hidden_by):
            (self.lampless.discard if control.lamp else self.lampless.add)(control.name)

    def recently_seen(self, config: ControllerConfig) -> PanelSeen | None:
        """Return the last seen states of the controls, None if they are too old."""
        fresh = self.seen is not None and self.age_s(self.seen.stamp_ns) <= config.state_max_age_s
        return self.seen if fresh else None

    def pair_finding(self, config: ControllerConfig) -> Finding | None:
        """Return the finding about the camera pair that forbids a touch, None if there is none."""
        age_s = math.inf if self.pair is None else self.age_s(self.pair.stamp_ns)
        return pair_finding(self.pair, age_s, config)

    def height_correction_m(self) -> float:
        """Return the part of the tip's distance that is due to the corrected yaw of the right camera."""
        if self.pair is None or self.camera_from_base is None:
            return 0.0
        distance_m = float(self.camera_from_base.translation[2])
        return float(self.pair.rotation_rad[1]) * distance_m**2 / self.pair.baseline_m

    def view_fault(self, config: ControllerConfig, control: str) -> Fault | None:
        """Return the fault of the view that ends a gesture before the touch: a hidden control, or a hidden panel."""
        since_ns = self.hidden_ns.get(control)
        if since_ns is not None and self.recently_seen(config) is not None:
            assert self.seen is not None
            hidden_s = (self.seen.stamp_ns - since_ns) / NANO
            if hidden_s >= config.hidden_after_s:
                return Fault(cause=Message("inputs.something_hand_hidden", control=control, hidden_s=hidden_s))
        panel_s, delay = self.age_s(self.panel_stamp_ns), self.panel_delay(config)
        if delay is not None and panel_s > patient_limit_s(config.panel_max_age_s, config):
            return Fault(cause=Message("inputs.no_pose_panel_recognition_late", since=since(panel_s)), delay=delay)
        if delay is None and panel_s > config.panel_max_age_s:
            return Fault(
                cause=Message(
                    "inputs.panel_not_recognised_most_allowed",
                    since=since(panel_s),
                    panel_max_age_s=config.panel_max_age_s,
                )
            )
        return None

    def panel_delay(self, config: ControllerConfig) -> Delay | None:
        """Return the delay of the panel's pose; None if it is recent, or if the recognition has no pose.

        A recognition that currently reports an unrecognised panel is not slow.
        """
        panel_s, limit_s = self.age_s(self.panel_stamp_ns), config.panel_max_age_s
        reports_none = self.confidence < config.min_confidence and self.age_s(self.confidence_ns) <= limit_s
        if panel_s <= limit_s or reports_none or not math.isfinite(panel_s):
            return None
        return Delay(code=ResultCode.LATE_IMAGE, what=Message("inputs.pose_panel"), measured_s=panel_s, limit_s=limit_s)

    def delays(self, config: ControllerConfig) -> list[Delay]:
        """Return the delays of the inputs that have arrived before and are now older than their limits."""
        joints_s, camera_s = self.age_s(self.readings_ns), self.age_s(self.camera_stamp_ns)
        found = [joints_delay(joints_s, config), camera_delay(camera_s, config), self.panel_delay(config)]
        return [delay for delay in found if delay is not None]

    def take_confidence(self, value: float, config: ControllerConfig) -> None:
        """Accept the pose that came before a high confidence; discard one that came before a low confidence."""
        self.confidence, self.confidence_ns = value, self.now_ns
        if self.reported_panel is not None and value >= config.min_confidence:
            self.camera_from_panel = self.reported_panel.camera_from_panel
            self.panel_stamp_ns = self.reported_panel.stamp_ns
            if self.camera_from_base is not None and self.panel_is_still(config):
                self.resting_base_from_panel = self.camera_from_base.inverse() @ self.camera_from_panel
        self.reported_panel = None

    def forget_times(self) -> None:
        """Discard all times after the clock was set back."""
        self.heartbeat_ns = None
        self.camera_stamp_ns = None
        self.panel_stamp_ns = self.confidence_ns = self.tracked_ns = 0
        self.reported_panel = None
        self.seen = None
        self.hidden_ns = {}
        self.readings_ns = min(self.readings_ns, self.now_ns)
        self.crossed_ns = min(self.crossed_ns, self.now_ns)

    def age_s(self, when_ns: int | None) -> float:
        """Return the age of a time in seconds, infinite for never.

        Soon after a blockage of the controller, its time does not count, because newer messages still
        wait in its queue.
        """
        if not when_ns:
            return math.inf
        age_s = (self.now_ns - when_ns) / NANO
        return age_s - min(self.held_up_s, max(age_s, 0.0))

    @property
    def heartbeat_age_s(self) -> float:
        """Seconds of wall time since the operator's newest heartbeat, infinite without one."""
        if not self.heartbeat_ns:
            return math.inf
        age_s = (self.wall_ns - self.heartbeat_ns) / NANO
        return age_s - min(self.wall_held_up_s, max(age_s, 0.0))

    def unrest(self) -> str:
        """Return a text if the machine moves or its stylus is extended, else an empty text."""
        if state_name(self.driver) in ("moving", "homing"):
            return Message("inputs.driver", driver=quoted(as_message(self.driver)))
        extended = self.readings is not None and self.readings[2] > EXTENDED_M
        return Message("stylus.extended", extended_mm=1000 * self.here[2]) if extended else ""

    def left_behind_text(self) -> str:
        """Return a text with the extension of the stylus at the start."""
        return Message("inputs.controller_started_stylus_extended", here_mm=1000 * self.here[2])

    def scene(self) -> Scene:
        """Return the scene in which a touch is planned; there must be no :func:`obstacles`."""
        assert self.camera_from_base is not None and self.camera_from_panel is not None
        assert self.base_from_reading is not None and self.camera is not None and self.panel is not None
        return Scene(
            camera_from_base=self.camera_from_base,
            camera_from_panel=self.camera_from_panel,
            base_from_reading=self.base_from_reading,
            panel=seen_panel(self.panel, self.deviations),
            camera=self.camera,
        )
