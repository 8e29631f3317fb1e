"""Settings of the gantry controller; ``motion_plan`` has those of paths, ``targets`` those of the stylus."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gantry_driver.core.contact.config import ContactConfig
from gantry_driver.core.motion.motion_plan import MotionConfig
from gantry_driver.core.motion.targets import TouchConfig
from gantry_driver.core.motion.touch_error import TouchErrorConfig
from icu_common.core.admission.heartbeats import PROGRAMS as HEARTBEAT_PROGRAMS
from icu_common.core.configuration.config import WALL_TIME, Config, ConfigError, nested, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerConfig(Config):
    """Parameters of the gantry controller."""

    tolerance_m: float = setting(
        0.00005, "Seen error up to which no further correction is made", minimum=1e-5, maximum=0.01, unit="m"
    )
    max_error_m: float = setting(
        0.0005,
        "Maximum seen error at which the stylus may touch",
        minimum=1e-5,
        maximum=0.01,
        unit="m",
        guards="the stylus touches next to the target",
    )
    max_corrections: int = setting(3, "Maximum number of corrections before max_error_m decides", minimum=0, maximum=20)
    max_correction_m: float = setting(
        0.005,
        "Seen error, or sum of corrections, above which the calibration or the tip counts as wrong",
        minimum=1e-4,
        maximum=0.05,
        unit="m",
        guards="a wrong calibration is corrected away",
    )
    max_depth_error_m: float = setting(
        0.003,
        "Seen error along base z above which the calibration or the tip counts as wrong",
        minimum=1e-4,
        maximum=0.05,
        unit="m",
        guards="the stylus touches at a wrong depth",
    )
    require_servo: bool = setting(
        True, "Touch only where the cameras see the tip above the panel", guards="the stylus touches unseen"
    )
    tip_count: int = setting(4, "Minimum number of tip observations averaged in one look", minimum=1, maximum=50)
    tip_count_max: int = setting(
        12, "Maximum number of tip observations averaged in one look above a target", minimum=1, maximum=50
    )
    tip_sigma_m: float = setting(
        0.00004,
        "Standard deviation of a look's mean distance up to which no more observations are averaged",
        minimum=1e-6,
        maximum=0.01,
        unit="m",
    )
    look_agreement_m: float = setting(
        0.0003,
        "Maximum difference between the mean of earlier looks above a target and a new one that is averaged with them",
        minimum=0.0,
        maximum=0.01,
        unit="m",
    )
    tip_spread_m: float = setting(
        0.0006,
        "Maximum lateral distance of a tip observation from the mean of its look",
        minimum=1e-5,
        maximum=0.01,
        unit="m",
    )
    settle_s: float = setting(0.1, "Time at rest before an image counts", minimum=0.0, maximum=5.0, unit="s")
    look_timeout_s: float = setting(
        3.0,
        "Maximum time for one look, and for cameras on the carriage to see the panel from a new position",
        minimum=0.1,
        maximum=30.0,
        unit="s",
    )
    beside_m: float = setting(
        0.02,
        "Lateral distance from a target at which to look at the tip if it is not seen above the target; 0: such a "
        "target is not touched",
        minimum=0.0,
        maximum=0.1,
        unit="m",
    )
    press_s: float = setting(0.3, "Contact time of a press", minimum=0.0, maximum=5.0, unit="s")
    long_press_s: float = setting(1.5, "Contact time of a long press", minimum=0.0, maximum=30.0, unit="s")
    double_lift_m: float = setting(
        0.004, "Lift height between the two contacts of a double press", minimum=0.0005, maximum=0.02, unit="m"
    )
    press_max_s: float = setting(
        0.6,
        "Maximum contact time of a press while fewer than contact_tip_count tip observations have arrived; "
        "instruments treat a longer contact as another gesture",
        minimum=0.0,
        maximum=5.0,
        unit="s",
    )
    decide_max_s: float = setting(
        1.0,
        "Maximum contact time of a press, except of a key, while images have not decided whether it touched",
        minimum=0.0,
        maximum=5.0,
        unit="s",
    )
    picture_wait_s: float = setting(
        1.0, "Maximum time after the lift for the images of the contact to arrive", minimum=0.0, maximum=10.0, unit="s"
    )
    contact_tip_count: int = setting(
        3, "Number of tip observations required from the contact time", minimum=1, maximum=50
    )
    effect_wait_s: float = setting(
        1.0,
        "Time after the lift, by the stamps of the images, in which lamps and screens may show an effect; 0: no "
        "effect is looked for",
        minimum=0.0,
        maximum=10.0,
        unit="s",
    )
    require_effect: bool = setting(False, "Count a press without a seen effect as failed")
    read_timeout_s: float = setting(
        3.0,
        "Maximum time to read a knob's marker, and for the last image of effect_wait_s to arrive",
        minimum=0.2,
        maximum=30.0,
        unit="s",
    )
    state_max_age_s: float = setting(
        1.5,
        "Maximum age of the seen states of the controls before a gesture",
        minimum=0.1,
        maximum=10.0,
        unit="s",
        guards="a hand may cover the control meanwhile",
    )
    aside_m: float = setting(
        0.025,
        "Distance beyond a knob's edge at which the stylus hides no part of the knob",
        minimum=0.0,
        maximum=0.2,
        unit="m",
    )
    set_tolerance_deg: float = setting(
        2.0, "Maximum angle error of a knob after a set", minimum=0.1, maximum=45.0, unit="deg"
    )
    set_tries: int = setting(5, "Maximum number of turns in one set", minimum=1, maximum=20)
    hidden_wait_s: float = setting(
        3.0, "Maximum time to wait while something hides the control", minimum=0.0, maximum=60.0, unit="s"
    )
    hidden_after_s: float = setting(
        0.3,
        "Maximum time a control may be hidden before the gesture ends without a touch",
        minimum=0.0,
        maximum=2.0,
        unit="s",
        guards="the stylus moves on towards a hand",
    )
    motion_timeout_s: float = setting(
        6.0,
        "Maximum time beyond a trajectory's nominal duration for its result to arrive",
        minimum=0.5,
        maximum=30.0,
        unit="s",
        guards="an endless motion is stopped late",
    )
    arrival_tolerance_m: float = setting(
        0.0002,
        "Maximum distance between reading and commanded point at the end of a motion",
        minimum=1e-5,
        maximum=0.01,
        unit="m",
    )
    goal_max_age_s: float = setting(
        0.5,
        "Maximum age of a goal; older ones are rejected as stale",
        minimum=0.05,
        maximum=5.0,
        unit="s",
        guards="an old goal may no longer be meant",
    )
    heartbeat_timeout_s: float = setting(
        0.6,
        "Maximum age of the operator's heartbeat; the operator counts as absent when it is older",
        minimum=0.1,
        maximum=2.0,
        unit="s",
        clock=WALL_TIME,
        guards="the machine moves on after the operator has left",
    )
    heartbeat_programs: str = setting(
        HEARTBEAT_PROGRAMS, "Nodes that may send heartbeats at the same time; names separated by spaces", read_only=True
    )
    joints_timeout_s: float = setting(
        1.0,
        "Maximum age of joint_states; the driver counts as silent when they are older",
        minimum=0.1,
        maximum=5.0,
        unit="s",
        guards="the machine's position is unknown meanwhile",
    )
    camera_timeout_s: float = setting(
        1.0,
        "Maximum age of the newest image; the camera counts as stalled when it is older",
        minimum=0.1,
        maximum=5.0,
        unit="s",
        guards="the stylus touches unseen",
    )
    slow_tries: int = setting(
        3,
        "Maximum number of tries, with limits that double each time, if only lateness exceeded a limit and "
        "nothing has been touched; 1: no retry",
        minimum=1,
        maximum=6,
    )
    slow_limit_max_s: float = setting(
        10.0,
        "Maximum lateness limit over all such tries",
        minimum=0.1,
        maximum=30.0,
        unit="s",
        guards="the controller accepts later inputs",
    )
    min_confidence: float = setting(
        0.3,
        "Minimum confidence of the panel's recognition for a touch",
        minimum=0.0,
        maximum=1.0,
        guards="a panel that is hardly recognised may be elsewhere",
    )
    panel_max_age_s: float = setting(
        2.0,
        "Maximum age of the panel's pose for a touch",
        minimum=0.1,
        maximum=20.0,
        unit="s",
        guards="the panel may have moved since",
    )
    seen_clear_m: float = setting(
        0.025,
        "Seen height of the tip above the panel that proves that the stylus presses nothing, even without a known "
        "position; must exceed the highest control",
        minimum=0.005,
        maximum=0.2,
        unit="m",
        guards="a stylus that presses a high control counts as up",
    )
    camera_on_carriage: bool = setting(
        False,
        "The cameras are mounted on the carriage: the panel is located again at each position, and errors are "
        "measured relative to it",
    )
    panel_moved_m: float = setting(
        0.0015,
        "Shift of the target, as seen by the cameras, above which a goal ends",
        minimum=1e-4,
        maximum=0.01,
        unit="m",
        guards="the stylus touches next to the target on a moved panel",
    )
    pair_max_age_s: float = setting(
        10.0,
        "Maximum age of the comparison of both cameras for a touch",
        minimum=0.5,
        maximum=600.0,
        unit="s",
        guards="the right camera may have turned since",
    )
    pair_max_turn_px: float = setting(
        0.15,
        "Maximum rotation of the right camera between the look above a target and the end of the touch",
        minimum=0.01,
        maximum=10.0,
        unit="px",
        guards="the camera turns during the touch",
    )
    max_uncertainty_m: float = setting(
        0.0015,
        "Maximum error bound, with 95 % probability, at which a touch is made and confirmed",
        minimum=1e-5,
        maximum=0.05,
        unit="m",
        guards="a touch counts as made that may have missed",
    )
    motion: MotionConfig = nested(MotionConfig)
    touch: TouchConfig = nested(TouchConfig)
    touch_error: TouchErrorConfig = nested(TouchErrorConfig)
    contact: ContactConfig = nested(ContactConfig)

    def wander_m(self) -> float:
        """Return the maximum lateral distance of the hovering tip from its position, in metres."""
        return self.max_correction_m + self.motion.approach_m * math.sqrt(2)

    def __post_init__(self) -> None:
        super(ControllerConfig, self).__post_init__()
        if self.tolerance_m > self.max_error_m:
            raise ConfigError(
                f"tolerance_m = {self.tolerance_m:g}: an error that is not corrected must not be above "
                f"max_error_m = {self.max_error_m:g}, for it is touched"
            )
        if self.require_effect and not self.effect_wait_s > 0:
            raise ConfigError(f"require_effect needs time to look: effect_wait_s = {self.effect_wait_s:g} is none")
