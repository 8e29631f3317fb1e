"""Every setting of the gantry controller; the paths have theirs in motion_plan, the stylus in targets."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gantry_driver.core.motion_plan import MotionConfig
from gantry_driver.core.targets import TouchConfig
from icu_common.core.admission.heartbeats import PROGRAMS as HEARTBEAT_PROGRAMS
from icu_common.core.config import WALL_TIME, Config, ConfigError, nested, setting


@dataclass(frozen=True, slots=True, kw_only=True)
class ControllerConfig(Config):
    """Parameters of the gantry controller."""

    tolerance_m: float = setting(
        0.00015, "Seen error at which no further correction is made", minimum=1e-5, maximum=0.01, unit="m"
    )
    max_error_m: float = setting(
        0.0005,
        "Maximum seen error for a touch",
        minimum=1e-5,
        maximum=0.01,
        unit="m",
        guards="the stylus touches next to the target",
    )
    max_corrections: int = setting(3, "Corrections before the error is judged by max_error_m", minimum=0, maximum=20)
    max_correction_m: float = setting(
        0.005,
        "Seen error, or sum of corrections, that means a wrong calibration or a wrong tip",
        minimum=1e-4,
        maximum=0.05,
        unit="m",
        guards="a wrong calibration is corrected away",
    )
    max_depth_error_m: float = setting(
        0.003,
        "Seen error along base z that means a wrong calibration or a wrong tip",
        minimum=1e-4,
        maximum=0.05,
        unit="m",
        guards="the stylus touches at a wrong depth",
    )
    require_servo: bool = setting(
        True, "Touch only where the cameras see the tip above", guards="the stylus touches unseen"
    )
    tip_count: int = setting(4, "Tip observations averaged in one look", minimum=1, maximum=50)
    tip_spread_m: float = setting(
        0.0006, "Largest distance of one of them from their mean, sideways", minimum=1e-5, maximum=0.01, unit="m"
    )
    settle_s: float = setting(0.1, "Standstill before a picture counts", minimum=0.0, maximum=5.0, unit="s")
    look_timeout_s: float = setting(
        3.0,
        "Time for one look, and for the panel to be seen from where cameras on the carriage have come to",
        minimum=0.1,
        maximum=30.0,
        unit="s",
    )
    beside_m: float = setting(
        0.02,
        "Way beside a target above which the tip is not seen, to look at it from there; 0: it is not touched then",
        minimum=0.0,
        maximum=0.1,
        unit="m",
    )
    press_s: float = setting(0.3, "Time in contact of a press", minimum=0.0, maximum=5.0, unit="s")
    long_press_s: float = setting(1.5, "The same of a long press", minimum=0.0, maximum=30.0, unit="s")
    double_lift_m: float = setting(
        0.004, "Way up between the two contacts of a double press", minimum=0.0005, maximum=0.02, unit="m"
    )
    press_max_s: float = setting(
        0.6,
        "The same while fewer pictures than needed have come; instruments take longer for another gesture",
        minimum=0.0,
        maximum=5.0,
        unit="s",
    )
    picture_wait_s: float = setting(
        1.0, "Time for the pictures of the contact to arrive after the lift", minimum=0.0, maximum=10.0, unit="s"
    )
    contact_tip_count: int = setting(2, "Tip observations needed from the time in contact", minimum=1, maximum=50)
    effect_wait_s: float = setting(
        1.0,
        "Time after the lift, by the pictures' stamps, for lamps and screens to show an effect; 0: none is looked for",
        minimum=0.0,
        maximum=10.0,
        unit="s",
    )
    require_effect: bool = setting(False, "A press without an effect that is seen counts as failed")
    read_timeout_s: float = setting(
        3.0,
        "Time for reading a knob's marker, and for the last picture of effect_wait_s to arrive",
        minimum=0.2,
        maximum=30.0,
        unit="s",
    )
    state_max_age_s: float = setting(
        1.5,
        "Maximum age of the controls' seen states before a gesture",
        minimum=0.1,
        maximum=10.0,
        unit="s",
        guards="a hand may cover the control meanwhile",
    )
    aside_m: float = setting(
        0.025,
        "Way beyond a knob's edge from which on the stylus hides nothing of it",
        minimum=0.0,
        maximum=0.2,
        unit="m",
    )
    set_tolerance_deg: float = setting(2.0, "A set knob may stand so far off", minimum=0.1, maximum=45.0, unit="deg")
    set_tries: int = setting(5, "Turns that a set may take", minimum=1, maximum=20)
    hidden_wait_s: float = setting(
        3.0, "Time for whatever hides the control to go away", minimum=0.0, maximum=60.0, unit="s"
    )
    hidden_after_s: float = setting(
        0.3,
        "Time a control may be hidden before the gesture ends without a touch",
        minimum=0.0,
        maximum=2.0,
        unit="s",
        guards="the stylus moves on towards a hand",
    )
    motion_timeout_s: float = setting(
        6.0,
        "Time beyond the nominal duration for a trajectory's result",
        minimum=0.5,
        maximum=30.0,
        unit="s",
        guards="an endless motion is stopped late",
    )
    arrival_tolerance_m: float = setting(
        0.0002, "Reading against commanded point at the end of a motion", minimum=1e-5, maximum=0.01, unit="m"
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
        "Age at which the operator counts as gone",
        minimum=0.1,
        maximum=2.0,
        unit="s",
        clock=WALL_TIME,
        guards="the machine moves on after the operator has left",
    )
    heartbeat_programs: str = setting(
        HEARTBEAT_PROGRAMS, "Nodes that may send heartbeats side by side, separated by spaces", read_only=True
    )
    joints_timeout_s: float = setting(
        1.0,
        "Age of joint_states at which the driver counts as silent",
        minimum=0.1,
        maximum=5.0,
        unit="s",
        guards="the machine's position is unknown meanwhile",
    )
    camera_timeout_s: float = setting(
        1.0,
        "Age of the newest image at which the camera counts as stalled",
        minimum=0.1,
        maximum=5.0,
        unit="s",
        guards="the stylus touches unseen",
    )
    slow_tries: int = setting(
        3,
        "Tries with doubled limits where only slowness exceeded a limit and nothing has been touched; 1: no retry",
        minimum=1,
        maximum=6,
    )
    slow_limit_max_s: float = setting(
        10.0,
        "Maximum of the lateness limit over all such tries",
        minimum=0.1,
        maximum=30.0,
        unit="s",
        guards="the controller accepts later inputs",
    )
    min_confidence: float = setting(
        0.3,
        "Recognition needed for a touch",
        minimum=0.0,
        maximum=1.0,
        guards="a panel that is hardly recognised may be elsewhere",
    )
    panel_max_age_s: float = setting(
        2.0,
        "Age of the panel's pose for a touch",
        minimum=0.1,
        maximum=20.0,
        unit="s",
        guards="the panel may have moved since",
    )
    seen_clear_m: float = setting(
        0.025,
        "Seen height of the tip above the panel that proves that it presses nothing, also without a position; "
        "above the highest control",
        minimum=0.005,
        maximum=0.2,
        unit="m",
        guards="a stylus that presses a high control counts as up",
    )
    camera_on_carriage: bool = setting(
        False, "The cameras ride on the carriage: the panel is seen anew at each place, and errors are seen in it"
    )
    panel_moved_m: float = setting(
        0.0015,
        "Shift of the target in the picture that ends a goal",
        minimum=1e-4,
        maximum=0.01,
        unit="m",
        guards="the stylus touches next to the target on a moved panel",
    )
    motion: MotionConfig = nested(MotionConfig)
    touch: TouchConfig = nested(TouchConfig)

    def wander_m(self) -> float:
        """Return how far beside its place the tip may be while it hovers, in metres."""
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
