"""Every setting of the simulated bench: optics, light, panel, hidden mechanical errors, stylus, sockets."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from icu_common.core.configuration.config import Config, ConfigError, nested, setting
from icu_simulator.imaging.configuration import ImagingConfig
from icu_simulator.keys.configuration import KeysConfig
from icu_simulator.manufacture.configuration import ManufactureConfig
from icu_simulator.mechanisms.configuration import MechanismsConfig
from icu_simulator.mechanisms.spring import SpringConfig
from icu_simulator.mechanisms.switch import SwitchConfig


def _check_lengths(config: Config, **lengths: int) -> None:
    for name, count in lengths.items():
        value = getattr(config, name)
        if len(value) != count:
            raise ConfigError(f"{name} = {value!r} has {len(value)} values; expected {count}")


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchCameraConfig(Config):
    """The stereo pair: two equal cameras on a bar, aimed at the panel from below."""

    width_px: int = setting(1280, "Width of one image", minimum=160, maximum=4096, unit="px", read_only=True)
    height_px: int = setting(720, "Height of one image", minimum=120, maximum=3072, unit="px", read_only=True)
    focal_px: float = setting(1700.0, "Focal length", minimum=200.0, maximum=8000.0, unit="px")
    centre_px: tuple[float, ...] = setting(
        (646.3, 354.8, 631.9, 363.1),
        "Principal points, left x y then right x y",
        minimum=0.0,
        maximum=20_000.0,
        unit="px",
    )
    distortion: tuple[float, ...] = setting(
        (-0.081, 0.043, 0.0004, -0.0003, 0.0, -0.079, 0.039, -0.0003, 0.0005, 0.0),
        "Plumb-bob distortion k1 k2 p1 p2 k3, left then right",
        minimum=-1.0,
        maximum=1.0,
    )
    mounting: str = setting(
        "fixed",
        "Mount of the camera bar; with carriage, the other values hold for the homed machine",
        choices=("fixed", "carriage"),
        read_only=True,
    )
    baseline_m: float = setting(0.12, "Distance between the two cameras", minimum=0.01, maximum=1.0, unit="m")
    distance_m: float = setting(
        0.665, "Distance from the middle of the bar to the aim point", minimum=0.2, maximum=3.0, unit="m"
    )
    elevation_deg: float = setting(
        25.0, "Angle between the line of sight and the z axis, towards -y", minimum=0.0, maximum=60.0, unit="deg"
    )
    azimuth_deg: float = setting(0.6, "Rotation of the line of sight about z", minimum=-45.0, maximum=45.0, unit="deg")
    roll_deg: float = setting(
        -0.4, "Rotation of the bar about the line of sight", minimum=-180.0, maximum=180.0, unit="deg"
    )
    toe_in_deg: float = setting(4.0, "Rotation of each camera towards the other", minimum=0.0, maximum=20.0, unit="deg")
    skew_deg: tuple[float, ...] = setting(
        (0.21, -0.14, 0.3),
        "Mounting error of the right camera: rotation about x, y, z",
        minimum=-5.0,
        maximum=5.0,
        unit="deg",
    )
    aim_m: tuple[float, ...] = setting(
        (0.180, 0.108, -0.022), "Aim point of the bar in base_link", minimum=-2.0, maximum=2.0, unit="m"
    )
    rate_hz: float = setting(15.0, "Rate of the stereo pairs", minimum=0.2, maximum=60.0, unit="Hz")

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        _check_lengths(self, centre_px=4, distortion=10, skew_deg=3, aim_m=3)


@dataclass(frozen=True, slots=True, kw_only=True)
class LightConfig(Config):
    """Effects of light, lens and sensor on the image."""

    level: float = setting(1.0, "Brightness of the room light", minimum=0.0, maximum=3.0)
    unevenness: float = setting(0.16, "Share by which the side away from the lamp is darker", minimum=0.0, maximum=0.9)
    vignetting: float = setting(0.22, "Share of the light lost in the image corners", minimum=0.0, maximum=0.9)
    glare: float = setting(0.16, "Strength of the lamp reflection, 1 = full white", minimum=0.0, maximum=3.0)
    glare_at_mm: tuple[float, ...] = setting(
        (62.0, 118.0),
        "Position of the reflection on the panel as seen by the left camera",
        minimum=-500.0,
        maximum=1000.0,
        unit="mm",
    )
    glare_radius_mm: float = setting(26.0, "Radius of the reflection", minimum=1.0, maximum=500.0, unit="mm")
    blur_px: float = setting(0.55, "Standard deviation of the defocus blur", minimum=0.0, maximum=10.0, unit="px")
    noise: float = setting(1.6, "Standard deviation of the sensor noise in grey levels", minimum=0.0, maximum=60.0)

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        _check_lengths(self, glare_at_mm=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelConfig(Config):
    """Pose of the instrument."""

    position_m: tuple[float, ...] = setting(
        (0.020, 0.025, -0.035), "Lower left corner of the face in base_link", minimum=-1.0, maximum=1.0, unit="m"
    )
    yaw_deg: float = setting(1.2, "Rotation about z", minimum=-45.0, maximum=45.0, unit="deg")
    tilt_deg: tuple[float, ...] = setting((0.25, -0.2), "Tilt about x and y", minimum=-30.0, maximum=30.0, unit="deg")

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        _check_lengths(self, position_m=3, tilt_deg=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class MechanicsConfig(Config):
    """Bounds of the hidden errors; the seed draws the errors themselves."""

    backlash_mm: tuple[float, ...] = setting(
        (0.15, 0.25), "Minimum and maximum backlash of x and y", minimum=0.0, maximum=5.0, unit="mm"
    )
    backlash_z_mm: float = setting(0.02, "Maximum backlash of z", minimum=0.0, maximum=2.0, unit="mm")
    scale: float = setting(0.004, "Maximum scale error of an axis", minimum=0.0, maximum=0.1)
    skew_rad: float = setting(
        0.003, "Maximum error of the right angle between x and y", minimum=0.0, maximum=0.1, unit="rad"
    )
    tilt_rad: float = setting(0.002, "Maximum tilt of the z axis", minimum=0.0, maximum=0.1, unit="rad")
    homed_mm: tuple[float, ...] = setting(
        (-359.0, -219.0, -1.0),
        "Position after homing",
        minimum=-2000.0,
        maximum=2000.0,
        unit="mm",
        read_only=True,
    )
    z_offset_mm: float = setting(
        0.0,
        "Height of the ball above its calibrated position, after a bumped stylus or lost steps",
        minimum=-20.0,
        maximum=20.0,
        unit="mm",
    )
    missed_mm: tuple[float, ...] = setting(
        (0.0, 0.0), "Offset of the x and y motors from their step counters", minimum=-20.0, maximum=20.0, unit="mm"
    )

    def __post_init__(self) -> None:
        Config.__post_init__(self)
        _check_lengths(self, backlash_mm=2, homed_mm=3, missed_mm=2)
        if self.backlash_mm[0] > self.backlash_mm[1]:
            raise ConfigError(f"backlash_mm = {self.backlash_mm!r}: the smaller value comes first")

    def still(self) -> MechanicsConfig:
        """Return the part that is drawn or built once: without the errors that a calibrated machine acquires later."""
        return dataclasses.replace(self, z_offset_mm=0.0, missed_mm=(0.0, 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchStylusConfig(Config):
    """Actuator and shape of the stylus."""

    kind: str = setting("z_axis", "Actuator that lowers the stylus", choices=("z_axis", "servo_m3", "solenoid_m8"))
    travel_mm: float = setting(36.0, "Stroke of the servo or solenoid", minimum=1.0, maximum=100.0, unit="mm")
    servo_up: float = setting(200.0, "Spindle value of the raised servo", minimum=0.0, maximum=10000.0)
    servo_down: float = setting(800.0, "Spindle value of the lowered servo", minimum=0.0, maximum=10000.0)
    speed_mm_s: float = setting(150.0, "Speed of the servo or solenoid", minimum=1.0, maximum=5000.0, unit="mm/s")
    ball_diameter_mm: float = setting(4.0, "Diameter of the ball at the tip", minimum=0.5, maximum=20.0, unit="mm")
    stem_diameter_mm: float = setting(
        1.0, "Diameter of the stem that carries the ball", minimum=0.1, maximum=20.0, unit="mm"
    )
    stem_mm: float = setting(16.0, "Distance from the ball centre to the shaft", minimum=0.0, maximum=100.0, unit="mm")
    shaft_diameter_mm: float = setting(
        5.0, "Diameter of the shaft above the stem", minimum=0.5, maximum=30.0, unit="mm"
    )
    shaft_mm: float = setting(
        96.0, "Distance from the ball centre to the top of the shaft", minimum=1.0, maximum=300.0, unit="mm"
    )
    arm_width_mm: float = setting(10.0, "Width of the arm that holds the shaft", minimum=1.0, maximum=100.0, unit="mm")
    arm_height_m: float = setting(
        0.04, "Height z of the underside of the arm in base_link", minimum=0.0, maximum=0.5, unit="m"
    )
    spring: SpringConfig = nested(SpringConfig)
    switch: SwitchConfig = nested(SwitchConfig)

    def still(self) -> BenchStylusConfig:
        """Return the visible and moving part: default spring and switch."""
        return dataclasses.replace(self, spring=SpringConfig(), switch=SwitchConfig())


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchConfig(Config):
    """The whole bench."""

    layout: str = setting("", "Layout file of the panel", read_only=True)
    motion_socket: str = setting("", "Unix socket on which the mock board reports its motor positions", read_only=True)
    frame_socket: str = setting("", "Unix socket on which the stereo pairs are served", read_only=True)
    test_socket: str = setting("", "Unix socket on which tests request the ground truth; empty = none", read_only=True)
    truth_log: str = setting(
        "", "JSON lines file with the physical ground truth for tests; empty = none", read_only=True
    )
    stepped: bool = setting(
        False, "Publish /clock and advance time only when the graph has finished the last step", read_only=True
    )
    step_rate_hz: float = setting(
        60.0,
        "Rate of simulated time steps while the machine moves; at rest one step for each image",
        minimum=10.0,
        maximum=1000.0,
        unit="Hz",
        read_only=True,
    )
    seed: int = setting(1, "Seed of the hidden errors and the noise", minimum=0, maximum=2**31 - 1, read_only=True)
    camera: BenchCameraConfig = nested(BenchCameraConfig)
    light: LightConfig = nested(LightConfig)
    panel: PanelConfig = nested(PanelConfig)
    mechanics: MechanicsConfig = nested(MechanicsConfig)
    stylus: BenchStylusConfig = nested(BenchStylusConfig)
    imaging: ImagingConfig = nested(ImagingConfig)
    keys: KeysConfig = nested(KeysConfig)
    manufacture: ManufactureConfig = nested(ManufactureConfig)
    mechanisms: MechanismsConfig = nested(MechanismsConfig)
