"""All effects of the bench's cameras: switches, sizes, and the sources of the sizes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from icu_common.core.configuration.config import Config, ConfigError, nested, setting
from icu_simulator.imaging.effect import BenchEffect


def _check_lengths(config: Config, **lengths: int) -> None:
    for name, count in lengths.items():
        value = getattr(config, name)
        if len(value) != count:
            raise ConfigError(f"{name} = {value!r}: expected {count} values, got {len(value)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationErrorConfig(BenchEffect):
    """Error of a calibration with a printed board: the cameras differ slightly from the calibration files."""

    SOURCE: ClassVar[str] = (
        "rms 0.20 to 0.25 px on OpenCV's own left/right chessboard images; the sheet's scale and bow are estimates"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("rms_px", "print_scale", "bow_mm")

    rms_px: float = setting(0.23, "RMS error of a corner in an image", minimum=0.0, maximum=5.0, unit="px")
    views: int = setting(20, "Number of board images per camera", minimum=4, maximum=60)
    print_scale: float = setting(0.001, "Share by which the print is too large", minimum=-0.05, maximum=0.05)
    bow_mm: float = setting(
        0.3, "Height of the middle of the sheet above its corners", minimum=-5.0, maximum=5.0, unit="mm"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LensConfig(BenchEffect):
    """Distortion that the five coefficients of the calibration cannot describe; the fit absorbs most of it."""

    SOURCE: ClassVar[str] = (
        "Schoeps et al., CVPR 2020, 'Why Having 10,000 Parameters in Your Camera Model Is Better Than Twelve': "
        "OpenCV's models leave patterns of some hundredths to tenths of a pixel"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("k4", "trefoil")

    k4: float = setting(2.0, "Radial coefficient of the eighth power", minimum=-20.0, maximum=20.0)
    trefoil: tuple[float, ...] = setting(
        (0.0006, -0.0004), "Distortion with threefold symmetry, from tilted lens elements", minimum=-0.1, maximum=0.1
    )

    def __post_init__(self) -> None:
        BenchEffect.__post_init__(self)
        _check_lengths(self, trefoil=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class DefocusConfig(BenchEffect):
    """Circle of confusion by distance: focal length times aperture times the difference of the inverse distances."""

    SOURCE: ClassVar[str] = "thin lens; f = 5 mm at f/2.0 (M12 lenses of 1/3 inch board cameras)"
    SCALED: ClassVar[tuple[str, ...]] = ("aperture_mm",)

    aperture_mm: float = setting(2.5, "Diameter of the lens aperture", minimum=0.0, maximum=50.0, unit="mm")
    focused_m: float = setting(0.6, "Focus distance", minimum=0.05, maximum=100.0, unit="m")


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureConfig(BenchEffect):
    """Exposure time, which causes motion blur of the stylus."""

    SOURCE: ClassVar[str] = "one half-period of 50 Hz mains, the shortest exposure of a UVC camera that avoids flicker"
    SCALED: ClassVar[tuple[str, ...]] = ("time_ms",)

    time_ms: float = setting(10.0, "Exposure time of each row", minimum=0.0, maximum=60.0, unit="ms")


@dataclass(frozen=True, slots=True, kw_only=True)
class RollingShutterConfig(BenchEffect):
    """Rolling shutter: the rows are exposed one after the other, from the top."""

    SOURCE: ClassVar[str] = "SMPTE ST 296: 750 lines a frame, 44 us a line at 30 Hz, 22 us at 60 Hz"
    SCALED: ClassVar[tuple[str, ...]] = ("row_us",)

    row_us: float = setting(22.2, "Time between two rows", minimum=0.0, maximum=60.0, unit="us")


@dataclass(frozen=True, slots=True, kw_only=True)
class AutoExposureConfig(BenchEffect):
    """Auto exposure, which follows the brightness of the image with a lag and in steps."""

    SOURCE: ClassVar[str] = (
        "UVC 1.5, auto exposure mode control; lag and step are estimates: webcams settle in one to two seconds"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("lag_s", "step")

    target: float = setting(62.0, "Target mean grey level", minimum=1.0, maximum=250.0)
    lag_s: float = setting(0.6, "Time constant", minimum=0.0, maximum=30.0, unit="s")
    step: float = setting(0.02, "Smallest relative change of the gain", minimum=0.0, maximum=0.5)
    reach: float = setting(4.0, "Maximum gain, and inverse of the minimum gain", minimum=1.0, maximum=64.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class WhiteBalanceConfig(BenchEffect):
    """Automatic white balance, which shifts the mean of the image towards grey in part and with a lag."""

    SOURCE: ClassVar[str] = (
        "grey world (Buchsbaum 1980); share and lag are estimates: webcams keep large coloured areas"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("strength", "lag_s")

    strength: float = setting(0.3, "Share of the colour cast that is removed", minimum=0.0, maximum=1.0)
    lag_s: float = setting(2.0, "Time constant", minimum=0.0, maximum=60.0, unit="s")


@dataclass(frozen=True, slots=True, kw_only=True)
class FlickerConfig(BenchEffect):
    """Flicker of mains light; with a rolling shutter the image has bands."""

    SOURCE: ClassVar[str] = "percent flicker 20 to 40 of lamps on a magnetic ballast (IEEE Std 1789-2015)"
    SCALED: ClassVar[tuple[str, ...]] = ("depth",)

    depth: float = setting(0.2, "Relative amplitude of the light", minimum=0.0, maximum=1.0)
    frequency_hz: float = setting(
        100.3, "Flicker frequency, twice the mains frequency", minimum=1.0, maximum=1000.0, unit="Hz"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotNoiseConfig(BenchEffect):
    """Noise that grows with the light; ``light.noise`` is the noise without light."""

    SOURCE: ClassVar[str] = (
        "Poisson statistics: 3,000 electrons at white (3 um pixel, 6 dB of gain) are 4.7 grey levels, less by gamma"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("at_white",)

    at_white: float = setting(3.0, "Standard deviation at white in grey levels", minimum=0.0, maximum=60.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class BayerConfig(BenchEffect):
    """Bayer pattern (RGGB): one colour for each pixel, the others by bilinear interpolation."""

    SOURCE: ClassVar[str] = "B. E. Bayer, US patent 3,971,065; every colour webcam"


@dataclass(frozen=True, slots=True, kw_only=True)
class JpegConfig(BenchEffect):
    """MJPEG compression, as in a UVC camera that sends 1280 x 720 over USB 2."""

    SOURCE: ClassVar[str] = "ITU-T T.81; UVC MJPEG payload; webcams send 4:2:2 or 4:2:0 at a quality of 75 to 90"

    quality: int = setting(80, "JPEG quality as defined by libjpeg", minimum=1, maximum=100)
    sampling: str = setting("420", "Chroma subsampling", choices=("444", "422", "420"))

    def scaled(self, factor: float) -> JpegConfig:
        """Return the effect with ``factor`` times the quantisation: libjpeg divides by 50 / (100 - quality)."""
        return dataclasses.replace(self, enabled=True, quality=max(1, round(100 - factor * (100 - self.quality))))


@dataclass(frozen=True, slots=True, kw_only=True)
class StampsConfig(BenchEffect):
    """Stamps after the middle of the exposure, with jitter."""

    SOURCE: ClassVar[str] = (
        "start of transfer, after exposure and readout (uvcvideo, usb_cam issue 75); +-1 to +-3 ms (librealsense 489)"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("offset_ms", "jitter_ms")

    offset_ms: float = setting(15.0, "Mean delay of the stamp", minimum=-200.0, maximum=200.0, unit="ms")
    jitter_ms: float = setting(1.0, "Standard deviation of the delay", minimum=0.0, maximum=50.0, unit="ms")


@dataclass(frozen=True, slots=True, kw_only=True)
class LossesConfig(BenchEffect):
    """Lost images, and images repeated with a new stamp."""

    SOURCE: ClassVar[str] = (
        "lost packets of webcams (raspberrypi/linux issue 238), sporadic drops with several cameras (librealsense "
        "issue 9385); the shares are estimates"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("dropped", "repeated")

    dropped: float = setting(0.01, "Share of lost images, independent for each camera", minimum=0.0, maximum=0.9)
    repeated: float = setting(0.005, "Share of images that repeat the previous one", minimum=0.0, maximum=0.9)


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeRunningConfig(BenchEffect):
    """Cameras without a common trigger: the right camera exposes at its own time, which drifts."""

    SOURCE: ClassVar[str] = "phases and rates of two cameras in picamera2 issue 1050; crystals differ by 20 to 50 ppm"
    SCALED: ClassVar[tuple[str, ...]] = ("phase_ms", "drift_ppm")

    phase_ms: float = setting(
        13.0, "Time by which the right camera exposes before the left one", minimum=-1000.0, maximum=1000.0, unit="ms"
    )
    drift_ppm: float = setting(
        30.0, "Difference between the frame rates", minimum=-10000.0, maximum=10000.0, unit="ppm"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class WarmingConfig(BenchEffect):
    """Warming cameras rotate on their mounts and change their focal length; the ramp begins when it is set."""

    SOURCE: ClassVar[str] = (
        "Elias et al., Sensors 20 (2020) 643: principal distance and point of a self-heating Raspberry Pi camera and "
        "of smartphones move by tenths of a pixel to several pixels in 25 minutes"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("turn_deg", "focal_ppm")
    LATER: ClassVar[bool] = True

    turn_deg: float = setting(
        0.01, "Rotation of each camera, in a direction drawn from the seed", minimum=0.0, maximum=5.0, unit="deg"
    )
    focal_ppm: float = setting(
        200.0, "Relative growth of the focal length", minimum=-50000.0, maximum=50000.0, unit="ppm"
    )
    ramp_s: float = setting(
        1200.0, "Time until rotation and growth are complete", minimum=0.1, maximum=86400.0, unit="s"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class KnockConfig(BenchEffect):
    """A single knock against a camera or its lens."""

    SOURCE: ClassVar[str] = (
        "0.02 degrees are 0.6 px here, the size of a webcam's warm-up (Elias et al., Sensors 20 (2020) 643)"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("turn_deg", "lens_px")
    LATER: ClassVar[bool] = True

    camera: str = setting("right", "Camera that is hit", choices=("left", "right"))
    turn_deg: tuple[float, ...] = setting(
        (0.0, 0.02, 0.0), "Rotation of the mount about the camera's x, y, z", minimum=-5.0, maximum=5.0, unit="deg"
    )
    lens_px: tuple[float, ...] = setting(
        (0.0, 0.0), "Shift of the principal point", minimum=-100.0, maximum=100.0, unit="px"
    )
    after_s: float = setting(0.0, "Delay of the knock after this setting", minimum=0.0, maximum=86400.0, unit="s")

    def __post_init__(self) -> None:
        BenchEffect.__post_init__(self)
        _check_lengths(self, turn_deg=3, lens_px=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class MirrorConfig(BenchEffect):
    """Mirror image of the stylus in the glass of the screen."""

    SOURCE: ClassVar[str] = "Fresnel: 4.3 % of one side of glass with n = 1.52 at right angles"
    SCALED: ClassVar[tuple[str, ...]] = ("reflectance",)

    reflectance: float = setting(0.043, "Share of the light that the glass reflects", minimum=0.0, maximum=1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class VibrationConfig(BenchEffect):
    """Vibration of the camera bar; with a rolling shutter lines bend."""

    SOURCE: ClassVar[str] = (
        "ISO 10816-1, zone A of small machines: 0.71 mm/s rms, at 23 Hz 7 um; over a bracket of 0.1 m 70 urad"
    )
    SCALED: ClassVar[tuple[str, ...]] = ("amplitude_px",)

    amplitude_px: float = setting(0.15, "Maximum shift of the image", minimum=0.0, maximum=20.0, unit="px")
    frequency_hz: float = setting(23.0, "Frequency of the vibration", minimum=0.1, maximum=500.0, unit="Hz")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagingConfig(Config):
    """All camera effects; each is off unless a room or a test enables it."""

    calibration: CalibrationErrorConfig = nested(CalibrationErrorConfig)
    lens: LensConfig = nested(LensConfig)
    defocus: DefocusConfig = nested(DefocusConfig)
    exposure: ExposureConfig = nested(ExposureConfig)
    rolling_shutter: RollingShutterConfig = nested(RollingShutterConfig)
    auto_exposure: AutoExposureConfig = nested(AutoExposureConfig)
    white_balance: WhiteBalanceConfig = nested(WhiteBalanceConfig)
    flicker: FlickerConfig = nested(FlickerConfig)
    shot_noise: ShotNoiseConfig = nested(ShotNoiseConfig)
    bayer: BayerConfig = nested(BayerConfig)
    jpeg: JpegConfig = nested(JpegConfig)
    stamps: StampsConfig = nested(StampsConfig)
    losses: LossesConfig = nested(LossesConfig)
    free_running: FreeRunningConfig = nested(FreeRunningConfig)
    warming: WarmingConfig = nested(WarmingConfig)
    knock: KnockConfig = nested(KnockConfig)
    mirror: MirrorConfig = nested(MirrorConfig)
    vibration: VibrationConfig = nested(VibrationConfig)
