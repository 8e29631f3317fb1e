"""Effects at the ball besides the spring: friction, the resistance of a knob, elastic feet, glass."""

from __future__ import annotations

import math

from icu_simulator.mechanisms.configuration import BendingConfig, GlassConfig, KnobConfig, MountConfig
from icu_simulator.mechanisms.spring import SpringConfig

Point = tuple[float, float]


class HeldBall:
    """Position of the ball under friction while the drive moves sideways: it sticks, then slips part of the way."""

    def __init__(self) -> None:
        self.lag_mm: Point = (0.0, 0.0)
        """Vector from the ball to its position with an unbent stylus, in mm."""
        self._at: Point | None = None

    def follow(self, drive: Point, force_n: float, config: BendingConfig) -> Point:
        """Return the position of the ball in mm.

        Parameters
        ----------
        drive
            Position of the ball without friction.
        force_n
            Force on the surface; 0 without contact.
        config
            Stiffness and friction.
        """
        if not config.enabled or force_n <= 0 or self._at is None:
            self._at, self.lag_mm = drive, (0.0, 0.0)
            return drive
        dx, dy = drive[0] - self._at[0], drive[1] - self._at[1]
        lag = math.hypot(dx, dy)
        if lag * config.stiffness_n_mm > config.static_friction * force_n:
            left = config.sliding_friction * force_n / config.stiffness_n_mm / lag
            dx, dy = dx * left, dy * left
            self._at = (drive[0] - dx, drive[1] - dy)
        self.lag_mm = (dx, dy)
        return self._at

    def side_force_n(self, config: BendingConfig) -> float:
        """Return the sideways force on the panel in newtons."""
        return config.stiffness_n_mm * math.hypot(*self.lag_mm)


def knob_turns(force_n: float, arm_mm: float, config: KnobConfig) -> bool:
    """Return whether the ball's friction at a distance from the axis overcomes the knob's torque."""
    return not config.enabled or config.friction * force_n * arm_mm >= config.torque_mn_m


def runs_on_deg(speed_deg_s: float, config: KnobConfig) -> float:
    """Return by how many degrees a knob continues to turn after the ball has left it: J w^2 / 2 = T a."""
    if not config.enabled or config.torque_mn_m <= 0:
        return 0.0
    speed = math.radians(speed_deg_s)
    # g mm^2 / (mN m) = 1e-9 kg m^2 / 1e-3 N m
    angle = 0.5 * config.inertia_g_mm2 * 1e-6 * speed**2 / config.torque_mn_m
    return math.copysign(math.degrees(angle), speed_deg_s)


def stiffness_n_mm(at: Point, size_mm: Point, config: MountConfig) -> float:
    """Return the stiffness at a point of the face: four springs below the corners, sinking and tilt together."""
    half_x, half_y = (max(side / 2 - config.inset_mm, 1.0) for side in size_mm)
    x, y = ((p - side / 2) / half for p, side, half in zip(at, size_mm, (half_x, half_y)))
    return 4 * config.foot_n_mm / (1 + x * x + y * y)


def share_push(pushed_mm: float, stiffness: float, spring: SpringConfig) -> tuple[float, float]:
    """Return the spring's compression and the instrument's sinking in mm; together they are ``pushed_mm``."""
    if pushed_mm <= 0:
        return 0.0, 0.0
    compression = max(0.0, (stiffness * pushed_mm - spring.preload_n) / (spring.rate_n_mm + stiffness))
    return compression, pushed_mm - compression


def contact_diameter_mm(force_n: float, radius_mm: float, config: GlassConfig) -> float:
    """Return the diameter of a ball's flattened contact with glass: Hertz, a^3 = 3 F R / (4 E)."""
    return float(2 * (0.75 * max(force_n, 0.0) * radius_mm / config.tip_mpa) ** (1 / 3))


class GlassSensor:
    """Detects a touch when a contact is wide enough for long enough."""

    def __init__(self) -> None:
        self._since_s: float | None = None
        self.touched = False

    def feel(self, diameter_mm: float, now_s: float, config: GlassConfig) -> bool:
        """Process the contact diameter at a time; return whether a touch has begun with this sample."""
        if diameter_mm < config.contact_mm:
            self._since_s, self.touched = None, False
            return False
        if self._since_s is None:
            self._since_s = now_s
        before, self.touched = self.touched, now_s - self._since_s >= config.dwell_s
        return self.touched and not before
