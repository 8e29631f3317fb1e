"""All mechanisms between the motors and the ball, each with its own switch; all are off by default."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import ClassVar

from icu_common.core.configuration.config import Config, ConfigError, nested, setting
from icu_simulator.imaging.effect import BenchEffect


@dataclass(frozen=True, slots=True, kw_only=True)
class ScrewConfig(BenchEffect):
    """Lead screw of z: a periodic error, which repeats with each turn, and a lead error."""

    SOURCE: ClassVar[str] = "ISO 3408-3: 0.052 mm on 300 mm for class 7; 0.008 mm in a turn for class 5"
    SCALED: ClassVar[tuple[str, ...]] = ("periodic_mm", "lead_error")

    periodic_mm: float = setting(
        0.012, "Amplitude of the periodic error, which repeats with each turn", minimum=0.0, maximum=1.0, unit="mm"
    )
    lead_mm: float = setting(2.0, "Travel per turn", minimum=0.5, maximum=50.0, unit="mm")
    lead_error: float = setting(0.0005, "Maximum lead error as a share of the travel", minimum=0.0, maximum=0.02)


@dataclass(frozen=True, slots=True, kw_only=True)
class PulleyConfig(BenchEffect):
    """Pulleys and belts of x and y: run-out of each pulley, and an error that repeats with each tooth."""

    SOURCE: ClassVar[str] = "estimate: a pulley with a set screw sits some hundredths of a millimetre off"
    SCALED: ClassVar[tuple[str, ...]] = ("runout_mm", "tooth_mm")

    runout_mm: float = setting(
        0.03, "Eccentricity of each pulley and amplitude of its error", minimum=0.0, maximum=1.0, unit="mm"
    )
    turn_mm: float = setting(40.0, "Travel per turn: 20 teeth of 2 mm", minimum=5.0, maximum=500.0, unit="mm")
    tooth_mm: float = setting(
        0.008, "Amplitude of the error that repeats with each tooth of the belt", minimum=0.0, maximum=0.5, unit="mm"
    )
    pitch_mm: float = setting(2.0, "Pitch of the belt", minimum=0.5, maximum=20.0, unit="mm")


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalConfig(BenchEffect):
    """Thermal expansion of frame and rails while motors and room warm up."""

    SOURCE: ClassVar[str] = "linear expansion of aluminium, 23e-6 per kelvin (handbook value)"
    SCALED: ClassVar[tuple[str, ...]] = ("rise_k",)

    rise_k: float = setting(8.0, "Final rise of temperature", minimum=-50.0, maximum=80.0, unit="K")
    time_constant_s: float = setting(1500.0, "Time to 63 % of the rise", minimum=1.0, maximum=100_000.0, unit="s")
    expansion_per_k: float = setting(23e-6, "Linear expansion of frame and rails per kelvin", minimum=0.0, maximum=1e-3)
    column_mm: float = setting(
        150.0,
        "Length of the column that carries the stylus above the panel and expands upwards",
        minimum=0.0,
        maximum=2000.0,
        unit="mm",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RingingConfig(BenchEffect):
    """Ringing of the carriage on its belts, as a spring and a mass."""

    SOURCE: ClassVar[str] = "Marlin's examples for M593 are 18.4 and 36.2 Hz; Klipper's default damping ratio is 0.1"
    SCALED: ClassVar[tuple[str, ...]] = ()

    frequency_hz: tuple[float, ...] = setting(
        (42.0, 33.0), "Natural frequencies of x and y", minimum=2.0, maximum=300.0, unit="Hz"
    )
    damping: float = setting(0.08, "Damping ratio", minimum=0.005, maximum=0.99)

    def __post_init__(self) -> None:
        BenchEffect.__post_init__(self)
        if len(self.frequency_hz) != 2:
            raise ConfigError(f"frequency_hz = {self.frequency_hz!r}: expected two values, for x and y")

    def scaled(self, factor: float) -> RingingConfig:
        """Return softer belts, which ring ``factor`` times as far: the amplitude grows with the period's square."""
        softer = tuple(value / math.sqrt(factor) for value in self.frequency_hz)
        return dataclasses.replace(self, enabled=True, frequency_hz=softer)


@dataclass(frozen=True, slots=True, kw_only=True)
class BendingConfig(BenchEffect):
    """Bending of the stylus while friction holds the ball, until the ball slips part of the way."""

    SOURCE: ClassVar[str] = "3 E I / L^3 of a steel stem of 1 mm diameter and 16 mm length; friction is an estimate"
    SCALED: ClassVar[tuple[str, ...]] = ("static_friction", "sliding_friction")

    stiffness_n_mm: float = setting(
        7.2, "Sideways stiffness of the stylus at the ball", minimum=0.1, maximum=1000.0, unit="N/mm"
    )
    static_friction: float = setting(
        0.35, "Static friction coefficient between ball and panel", minimum=0.0, maximum=2.0
    )
    sliding_friction: float = setting(
        0.22, "Sliding friction coefficient between ball and panel", minimum=0.0, maximum=2.0
    )

    def __post_init__(self) -> None:
        BenchEffect.__post_init__(self)
        if self.sliding_friction > self.static_friction:
            raise ConfigError(
                f"sliding_friction = {self.sliding_friction:g}: expected at most static_friction "
                f"{self.static_friction:g}"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class KnobConfig(BenchEffect):
    """Resistance of a knob to turning: its torque against the friction of the ball, and its inertia."""

    SOURCE: ClassVar[str] = "datasheets of 11 and 12 mm encoders: 2 to 15 mN m of detent torque"
    SCALED: ClassVar[tuple[str, ...]] = ("torque_mn_m", "inertia_g_mm2")

    torque_mn_m: float = setting(
        4.0, "Torque that turns a knob, detent included", minimum=0.0, maximum=200.0, unit="mN m"
    )
    friction: float = setting(0.6, "Friction coefficient between ball and knob face", minimum=0.0, maximum=2.0)
    inertia_g_mm2: float = setting(
        250.0, "Moment of inertia, which keeps a released knob turning", minimum=0.0, maximum=1e6, unit="g mm^2"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MountConfig(BenchEffect):
    """The instrument on four elastic feet: it sinks and tilts under the stylus, and slides when pushed."""

    SOURCE: ClassVar[str] = "estimate: 3 kg on rubber feet need 12 to 20 N to slide, 0.5 kg on plastic feet 1 N"
    SCALED: ClassVar[tuple[str, ...]] = ()

    foot_n_mm: float = setting(
        25.0, "Stiffness of each of the four feet below the corners", minimum=0.5, maximum=10_000.0, unit="N/mm"
    )
    inset_mm: float = setting(
        25.0, "Distance of the feet from the edges of the face", minimum=0.0, maximum=200.0, unit="mm"
    )
    slide_n: float = setting(
        12.0,
        "Sideways force that moves the instrument",
        minimum=0.05,
        maximum=1000.0,
        unit="N",
    )

    def scaled(self, factor: float) -> MountConfig:
        """Return softer feet that slide more easily."""
        return dataclasses.replace(self, enabled=True, foot_n_mm=self.foot_n_mm / factor, slide_n=self.slide_n / factor)


@dataclass(frozen=True, slots=True, kw_only=True)
class GlassConfig(BenchEffect):
    """A capacitive screen: the soft tip must be flattened (Hertz) for some scans before a touch counts."""

    SOURCE: ClassVar[str] = "Hertz contact; conductive silicone of 40 to 50 Shore A; three scans at 85 Hz (estimate)"
    SCALED: ClassVar[tuple[str, ...]] = ("contact_mm", "dwell_s")

    contact_mm: float = setting(
        1.2, "Contact diameter at which the touch controller detects a touch", minimum=0.1, maximum=10.0, unit="mm"
    )
    tip_mpa: float = setting(
        2.0,
        "Reduced modulus of the tip: conductive silicone of 40 to 50 Shore A",
        minimum=0.05,
        maximum=1e5,
        unit="MPa",
    )
    dwell_s: float = setting(
        0.035, "Minimum duration of the contact: three scans at 85 Hz", minimum=0.0, maximum=2.0, unit="s"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MechanismsConfig(Config):
    """All mechanisms."""

    screw: ScrewConfig = nested(ScrewConfig)
    pulley: PulleyConfig = nested(PulleyConfig)
    thermal: ThermalConfig = nested(ThermalConfig)
    ringing: RingingConfig = nested(RingingConfig)
    bending: BendingConfig = nested(BendingConfig)
    knob: KnobConfig = nested(KnobConfig)
    mount: MountConfig = nested(MountConfig)
    glass: GlassConfig = nested(GlassConfig)
