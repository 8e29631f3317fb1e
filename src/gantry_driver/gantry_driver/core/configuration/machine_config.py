"""Settings of the driver: axes and limits, stylus, feeds, times; the only source of its ROS parameters.

A value that is compared with a ``$`` setting keeps GRBL's units (mm, mm/min, mm/s^2), so that the configuration shows
the same number as the board.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from gantry_driver.core.configuration.clearance import stopping_way_mm
from gantry_driver.core.configuration.envelope_config import EnvelopeConfig
from icu_common.core.admission.heartbeats import PROGRAMS as HEARTBEAT_PROGRAMS
from icu_common.core.configuration.config import WALL_TIME, Config, ConfigError, nested, setting

REPORTS_MISSED = 1.5
"""Minimum silence of a board before its link counts as lost, in intervals between status reports."""
STYLUS_KINDS = ("z_axis", "servo_m3", "solenoid_m8")


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineConfig(Config):
    """Required settings of the controller board; three values each, for x, y and z.

    All are fixed while the node runs: since homing, readings, limits and the check of the settings depend on them.
    """

    steps_per_mm: tuple[float, ...] = setting(
        (80.0, 80.0, 400.0), "$100 to $102", minimum=0.01, maximum=1e6, unit="steps/mm", read_only=True
    )
    max_rate_mm_min: tuple[float, ...] = setting(
        (12000.0, 12000.0, 3000.0), "$110 to $112", minimum=1.0, maximum=100_000.0, unit="mm/min", read_only=True
    )
    acceleration_mm_s2: tuple[float, ...] = setting(
        (1500.0, 1500.0, 400.0), "$120 to $122", minimum=1.0, maximum=100_000.0, unit="mm/s^2", read_only=True
    )
    travel_mm: tuple[float, ...] = setting(
        (360.0, 220.0, 60.0), "$130 to $132", minimum=1.0, maximum=5000.0, unit="mm", read_only=True
    )
    homing_direction_mask: int = setting(
        3,
        "$23: a set bit homes that axis at its negative end (1 = x, 2 = y, 4 = z)",
        minimum=0,
        maximum=7,
        read_only=True,
    )
    pull_off_mm: float = setting(
        1.0, "$27: distance from the switch after homing", minimum=0.0, maximum=50.0, read_only=True
    )

    def __post_init__(self) -> None:
        super(MachineConfig, self).__post_init__()
        for name in ("steps_per_mm", "max_rate_mm_min", "acceleration_mm_s2", "travel_mm"):
            if len(getattr(self, name)) != 3:
                raise ConfigError(f"{name} = {getattr(self, name)!r}: three values, for x, y and z, are needed")
        if not self.pull_off_mm < min(self.travel_mm):
            raise ConfigError(f"pull_off_mm = {self.pull_off_mm:g} leaves nothing of travel_mm = {self.travel_mm}")

    def expected_settings(self) -> dict[int, float]:
        """Return number and value of every ``$`` setting on which the axes depend."""
        expected = {13: 0.0, 20: 1.0, 22: 1.0, 23: float(self.homing_direction_mask), 27: self.pull_off_mm}
        for axis in range(3):
            expected[100 + axis] = self.steps_per_mm[axis]
            expected[110 + axis] = self.max_rate_mm_min[axis]
            expected[120 + axis] = self.acceleration_mm_s2[axis]
            expected[130 + axis] = self.travel_mm[axis]
        return expected

    def sign(self, axis: int) -> float:
        """Return +1 if machine coordinates increase away from home, -1 if they decrease."""
        return 1.0 if self.homing_direction_mask >> axis & 1 else -1.0

    def homed_mpos_mm(self) -> tuple[float, float, float]:
        """Return the machine coordinates right after homing (GRBL: 0 is the positive end of each axis)."""
        x, y, z = (
            self.pull_off_mm - t if self.sign(a) > 0 else -self.pull_off_mm for a, t in enumerate(self.travel_mm)
        )
        return x, y, z

    def reading_limits_m(self) -> tuple[float, float, float]:
        """Return the maximum reading of each axis in metres; the minimum is 0."""
        x, y, z = ((travel - self.pull_off_mm) / 1000.0 for travel in self.travel_mm)
        return x, y, z


@dataclass(frozen=True, slots=True, kw_only=True)
class StylusConfig(Config):
    """Settings of the stylus's actuator."""

    kind: str = setting("z_axis", "Actuator of the stylus", choices=STYLUS_KINDS, read_only=True)
    stroke_m: float = setting(
        0.02,
        "Extension of the lowered stylus, for servo and solenoid; a Z axis uses its travel",
        minimum=0.0,
        maximum=0.2,
        unit="m",
        read_only=True,
    )
    servo_up: float = setting(
        200.0, "S value of M3 that lifts the stylus", minimum=0.0, maximum=30000.0, read_only=True
    )
    servo_down: float = setting(
        800.0, "S value of M3 that lowers the stylus", minimum=0.0, maximum=30000.0, read_only=True
    )
    servo_range: tuple[float, ...] = setting(
        (0.0, 1000.0),
        "$31 and $30: minimum and maximum S value",
        minimum=0.0,
        maximum=30000.0,
        read_only=True,
    )
    dwell_s: float = setting(
        0.25, "Time that the servo or solenoid needs to lift or lower the stylus", minimum=0.0, maximum=5.0, unit="s"
    )

    def __post_init__(self) -> None:
        super(StylusConfig, self).__post_init__()
        if len(self.servo_range) != 2 or not self.servo_range[0] < self.servo_range[1]:
            raise ConfigError(f"servo_range = {self.servo_range!r}; expected a lower and a higher value")
        for name in ("servo_up", "servo_down"):
            value = getattr(self, name)
            if not self.servo_range[0] <= value <= self.servo_range[1]:
                raise ConfigError(f"{name} = {value:g} is not within servo_range = {self.servo_range!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class DriverConfig(Config):
    """Parameters of the serial driver."""

    port: str = setting("/dev/ttyUSB0", "Device of the controller board", read_only=True)
    baud: int = setting(
        115200, "Baud rate of the serial line", minimum=9600, maximum=4_000_000, unit="bit/s", read_only=True
    )
    dtr: bool = setting(
        True, "Level of the port's DTR line while it is open; many boards send nothing without it", read_only=True
    )
    rts: bool = setting(
        True, "Level of the port's RTS line while it is open; without DTR, it resets some boards", read_only=True
    )
    stylus_file: str = setting(
        "",
        "File that records, across restarts, that the stylus may be down; empty: a file in the guard's folder",
        read_only=True,
    )
    autostart: bool = setting(
        True,
        "Configure and activate the node at start; if false, the node waits for lifecycle transitions",
        read_only=True,
    )
    enabled_at_start: bool = setting(False, "Allow motion without a call of the enable service", read_only=True)
    trajectory_programs: str = setting(
        "gantry_controller",
        "Nodes whose trajectories the driver follows, one at a time; names separated by spaces, * for any node",
        read_only=True,
    )
    heartbeat_programs: str = setting(
        HEARTBEAT_PROGRAMS, "Nodes that may send heartbeats at the same time; names separated by spaces", read_only=True
    )
    heartbeat_timeout_s: float = setting(
        0.6,
        "Maximum age of the operator's heartbeat; motion stops when it is older",
        minimum=0.1,
        maximum=2.0,
        unit="s",
        clock=WALL_TIME,
        guards="the machine moves on after the operator has left",
    )
    node_silence_s: float = setting(
        0.1,
        "Maximum time without a sign of life from this node to the guard, counted while the node could run; "
        "motion stops after it",
        minimum=0.05,
        maximum=0.5,
        unit="s",
        clock=WALL_TIME,
        guards="a node that hangs stops the machine after it",
    )
    attendance_timeout_s: float = setting(
        0.8,
        "Maximum time without a sign of life from the controller of a goal; motion stops after it",
        minimum=0.3,
        maximum=1.2,
        unit="s",
        guards="the stylus presses on after the controller has ended",
    )
    status_rate_hz: float = setting(
        10.0, "Rate of status reports while nothing moves", minimum=1.0, maximum=50.0, unit="Hz"
    )
    moving_status_rate_hz: float = setting(
        25.0,
        "Rate of status reports while the machine moves",
        minimum=5.0,
        maximum=100.0,
        unit="Hz",
        guards="a fault of the path is seen later",
    )
    touch_status_rate_hz: float = setting(
        50.0,
        "Rate of status reports while the machine follows a path with the stylus extended",
        minimum=10.0,
        maximum=100.0,
        unit="Hz",
        guards="a damaged line is stopped deeper",
    )
    clearance_m: float = setting(
        0.0105,
        "Height above the deepest point of a descent at which the board must report rest before the driver sends "
        "the remaining path: at least the sum of the controller's hover_m and contact.key_travel_m",
        minimum=0.0005,
        maximum=0.2,
        unit="m",
        read_only=True,
    )
    overtravel_m: float = setting(
        0.001,
        "Maximum depth to which a path presses into the panel; equal to the controller's overtravel_m",
        minimum=0.0,
        maximum=0.01,
        unit="m",
        read_only=True,
    )
    status_timeout_s: float = setting(
        1.5,
        "Maximum time without a status report; the link counts as lost after it",
        minimum=0.2,
        maximum=10.0,
        unit="s",
        guards="the stylus's position is unknown meanwhile",
    )
    connect_timeout_s: float = setting(
        6.0,
        "Maximum time for the banner, the build information and the settings to arrive",
        minimum=1.0,
        maximum=60.0,
        unit="s",
    )
    banner_wait_s: float = setting(
        0.5,
        "Time to wait for a banner before the driver requests the state of a running board",
        minimum=0.0,
        maximum=10.0,
        unit="s",
    )
    hold_timeout_s: float = setting(
        2.0,
        "Maximum time for a feed hold to complete; after it the driver resets the board, which loses its homing",
        minimum=0.1,
        maximum=10.0,
        unit="s",
        guards="the stylus is not lifted before the hold has ended",
    )
    homing_timeout_s: float = setting(
        60.0,
        "Maximum time for a homing cycle",
        minimum=10.0,
        maximum=600.0,
        unit="s",
        guards="a machine that does not find its switches runs on",
    )
    answer_timeout_s: float = setting(
        3.0, "Maximum time for an idle board to answer a line", minimum=0.5, maximum=60.0, unit="s"
    )
    goal_max_age_s: float = setting(
        1.0,
        "Maximum age of a trajectory; older ones are rejected",
        minimum=0.05,
        maximum=5.0,
        unit="s",
        guards="an old path may no longer be meant",
    )
    max_points: int = setting(2000, "Maximum number of points in one trajectory", minimum=1, maximum=10_000)
    feed_m_s: float = setting(0.15, "Speed in x and y for points that give none", minimum=1e-4, maximum=1.0, unit="m/s")
    stylus_feed_m_s: float = setting(
        0.03, "Speed of the stylus for points that give none, and of its retreat", minimum=1e-4, maximum=0.5, unit="m/s"
    )
    arrival_tolerance_m: float = setting(
        0.0001,
        "Maximum distance between the reported position and the end of a trajectory that counts as reached; the "
        "rounding to whole motor steps applies where it is larger",
        minimum=1e-6,
        maximum=0.01,
        unit="m",
    )
    max_rest_extended_s: float = setting(
        35.0,
        "Maximum time at rest with the stylus extended; the driver stops the machine after it; the longest hold "
        "is 30 s",
        minimum=1.0,
        maximum=60.0,
        unit="s",
        guards="a forgotten stylus presses on",
    )
    lift_on_stop: bool = setting(
        True,
        "Lift the stylus off the panel after a stop, once the feed hold is complete",
        guards="after a stop the stylus presses on",
    )
    probe: str = setting(
        "none",
        "Device at the board's probe input: none, or a switch in the stylus that closes on contact",
        choices=("none", "stylus_switch"),
        read_only=True,
    )
    envelope: EnvelopeConfig = nested(EnvelopeConfig)
    machine: MachineConfig = nested(MachineConfig)
    stylus: StylusConfig = nested(StylusConfig)

    def __post_init__(self) -> None:
        super(DriverConfig, self).__post_init__()
        if not self.port:
            raise ConfigError("port = '': the path of the board's device is needed")
        slowest = min(self.status_rate_hz, self.moving_status_rate_hz)
        if self.status_timeout_s * slowest < REPORTS_MISSED - 1e-9:
            raise ConfigError(
                f"status_timeout_s = {self.status_timeout_s:g}: a link would be lost between two reports, at least "
                f"{REPORTS_MISSED / slowest:g} s at {slowest:g} Hz are needed"
            )
        self._check_clearance()

    def _check_clearance(self) -> None:
        """Reject a height from which a damaged approach would reach the panel before a hold stops it."""
        if self.stylus.kind != "z_axis":
            return
        machine = self.machine
        needed_m = self.overtravel_m + 0.001 * stopping_way_mm(
            machine.max_rate_mm_min[2],
            machine.acceleration_mm_s2[2],
            machine.travel_mm[2],
            self.touch_status_rate_hz,
        )
        if self.clearance_m < needed_m:
            raise ConfigError(
                f"clearance_m = {self.clearance_m:g}; expected {needed_m:.4f} m to stop a damaged line above the "
                "panel; raise clearance_m and the controller's hover_m, or lower max_rate_mm_min of z, or raise "
                "acceleration_mm_s2 of z or touch_status_rate_hz"
            )

    def expected_settings(self) -> dict[int, float]:
        """Return number and value of every ``$`` setting on which machine and stylus depend."""
        low, high = self.stylus.servo_range
        # In laser mode ($32) M3 has no power until the board has received a G1: after a reset nothing would lift.
        servo = {30: high, 31: low, 32: 0.0} if self.stylus.kind == "servo_m3" else {}
        return {**self.machine.expected_settings(), **servo}

    def stylus_limit_m(self) -> float:
        """Return the maximum extension of the stylus in metres."""
        return self.machine.reading_limits_m()[2] if self.stylus.kind == "z_axis" else self.stylus.stroke_m

    def limits_m(self) -> tuple[float, float, float]:
        """Return the maximum readings of x, y and stylus in metres."""
        x, y, _ = self.machine.reading_limits_m()
        return x, y, self.stylus_limit_m()

    def rounding_m(self) -> float:
        """Return the maximum distance between a commanded and a reported position that is rounding, in metres.

        It is half a motor step of each axis, plus the decimals after the third, which lines and reports omit.
        """
        axes = 3 if self.stylus.kind == "z_axis" else 2
        return math.hypot(*(0.5 / steps + 0.001 for steps in self.machine.steps_per_mm[:axes])) / 1000.0
