"""Sensor and electronics of one camera: from the light on the pixels to the image received over USB.

Values are grey levels as displayed, not photons: gains and noise are those of the encoded image. Disabled effects cost
no time; with a Bayer mosaic, gain and noise apply to one value for each pixel, as in the sensor.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from icu_simulator.imaging.configuration import AutoExposureConfig, JpegConfig
from icu_simulator.imaging.motion import ShutterTimes

if TYPE_CHECKING:
    from icu_simulator.core.configuration import BenchConfig

Picture = npt.NDArray[np.uint8]
_TILE = 256
_UNIT = 64
"""Fixed-point unit of the stored noise."""
_SPARSE = 16
_SAMPLING = {"444": 0x111111, "422": 0x211111, "420": 0x221111}
"""OpenCV's IMWRITE_JPEG_SAMPLING_FACTOR_*."""


class Sensor:
    """Converts light to the images of one camera, in the order of their exposures.

    Exposure and white balance follow the earlier images; everything else depends only on seed, camera and time.

    Parameters
    ----------
    config
        The bench.
    camera
        Index of the camera, 0 is the left one.
    """

    def __init__(self, config: BenchConfig, camera: int) -> None:
        self._seed, self._camera = config.seed, camera
        self._gain: float | None = None
        self._balance: npt.NDArray[np.float64] | None = None
        self._last_s = -math.inf
        self._noise: npt.NDArray[np.int16] | None = None
        self.configure(config)

    def configure(self, config: BenchConfig) -> None:
        """Apply other settings; exposure and white balance keep their states."""
        self._config, self._imaging = config, config.imaging
        self.adds_noise = self._imaging.shot_noise.enabled or self._imaging.bayer.enabled
        """Whether the noise without light is also added here."""
        white = self._imaging.shot_noise.at_white if self._imaging.shot_noise.enabled else 0.0
        sigma = np.sqrt(config.light.noise**2 + white**2 * np.arange(256) / 255)
        self._sigma = np.rint(_UNIT * sigma).astype(np.int16)
        self._noisy = self.adds_noise and bool(sigma.any())
        jpeg = self._imaging.jpeg
        self._jpeg = _jpeg_options(jpeg) if jpeg.enabled else None
        if not self._imaging.auto_exposure.enabled:
            self._gain = None
        if not self._imaging.white_balance.enabled:
            self._balance = None

    def develop(self, light: Picture, exposure_s: float) -> Picture:
        """Return the image, (H, W, 3) BGR, of the light on the pixels; ``light`` may be modified.

        Parameters
        ----------
        light
            (H, W, 3) BGR.
        exposure_s
            Middle of the exposure, seconds of the bench's clock.
        """
        imaging = self._imaging
        rng = np.random.default_rng((self._seed, self._camera, round(exposure_s * 1e6)))
        if imaging.vibration.enabled:
            light = self._shaken(light, exposure_s)
        gains = self._colour_gains(light, exposure_s)
        rows = self._flicker(light.shape[0], exposure_s) if imaging.flicker.enabled else None
        if imaging.bayer.enabled:
            mosaic = _mosaic(light)
            if gains is not None or rows is not None:
                mosaic = _amplified_mosaic(mosaic, gains, rows)
            mosaic = self._with_noise(mosaic, rng)
            light = np.asarray(cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2BGR), np.uint8)
        else:
            if gains is not None or rows is not None:
                light = _amplified(light, gains, rows)
            light = self._with_noise(light, rng)
        if self._jpeg is not None:
            light = _through_jpeg(light, self._jpeg)
        return light

    def _colour_gains(self, light: Picture, now_s: float) -> npt.NDArray[np.float64] | None:
        """Update exposure and white balance; return the gains of B, G, R, or None for no change."""
        exposure, balance = self._imaging.auto_exposure, self._imaging.white_balance
        if not (exposure.enabled or balance.enabled):
            return None
        passed_s = max(now_s - self._last_s, 0.0)
        self._last_s = now_s
        means = light[_SPARSE // 2 :: _SPARSE, _SPARSE // 2 :: _SPARSE].reshape(-1, 3).mean(axis=0) + 1.0
        result = np.ones(3)
        if balance.enabled:
            wanted = (means[1] / means) ** balance.strength
            if self._balance is None:
                self._balance = wanted
            self._balance = self._balance + (wanted - self._balance) * _share(passed_s, balance.lag_s)
            result *= self._balance
        if exposure.enabled:
            self._gain = _followed(self._gain, float(means.mean()), passed_s, exposure)
            result *= (
                (1 + exposure.step) ** round(math.log(self._gain) / math.log1p(exposure.step))
                if (exposure.step > 0)
                else self._gain
            )
        return result

    def _flicker(self, height: int, exposure_s: float) -> npt.NDArray[np.float32]:
        """Return the strength of the light in the exposure of each row, (height,)."""
        flicker, shutter = self._imaging.flicker, ShutterTimes.of(self._imaging)
        times = exposure_s + shutter.row_times(height)
        depth = flicker.depth * float(np.sinc(flicker.frequency_hz * shutter.exposure_s))
        return np.asarray(1 + depth * np.cos(2 * np.pi * (flicker.frequency_hz * times % 1.0)), np.float32)

    def _shaken(self, light: Picture, exposure_s: float) -> Picture:
        vibration = self._imaging.vibration
        height, width = light.shape[:2]
        times = exposure_s + ShutterTimes.of(self._imaging).row_times(height)
        # Both cameras are on one bar, which vibrates more about its own axis than sideways.
        swing = vibration.amplitude_px * np.sin(2 * np.pi * (vibration.frequency_hz * times % 1.0))
        x = np.arange(width, dtype=np.float32)[None, :] + np.asarray(0.5 * swing, np.float32)[:, None]
        y = np.repeat((np.arange(height) + swing).astype(np.float32)[:, None], width, axis=1)
        moved = cv2.remap(light, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(moved, np.uint8)

    def _with_noise(self, values: Picture, rng: np.random.Generator) -> Picture:
        if not self._noisy:
            return values
        shape = (values.shape[0] + _TILE, values.shape[1] + _TILE, *values.shape[2:])
        if self._noise is None or self._noise.shape != shape:
            made = np.random.default_rng((self._seed, self._camera, 7))
            self._noise = np.rint(_UNIT * made.standard_normal(shape, dtype=np.float32)).astype(np.int16)
        r, c = (int(v) for v in rng.integers(0, _TILE, 2))
        tile = self._noise[r : r + values.shape[0], c : c + values.shape[1]]
        sigma = cv2.LUT(values, self._sigma)
        added = cv2.multiply(sigma, tile, scale=1 / _UNIT**2)
        return np.asarray(cv2.add(values, added, dtype=cv2.CV_8U), np.uint8)


def _share(passed_s: float, lag_s: float) -> float:
    return 1.0 if lag_s <= 0 else -math.expm1(-passed_s / lag_s)


def _followed(gain: float | None, mean: float, passed_s: float, config: AutoExposureConfig) -> float:
    wanted = min(max(config.target / mean, 1 / config.reach), config.reach)
    if gain is None:
        return wanted
    # In stops, as exposure controls do: up and down take the same time.
    return float(gain * (wanted / gain) ** _share(passed_s, config.lag_s))


def _mosaic(light: Picture) -> Picture:
    """Return the Bayer colour of each pixel, (H, W), red at the first."""
    mosaic = np.empty(light.shape[:2], np.uint8)
    for r, c, channel in ((0, 0, 2), (0, 1, 1), (1, 0, 1), (1, 1, 0)):
        mosaic[r::2, c::2] = light[r::2, c::2, channel]
    return mosaic


def _amplified_mosaic(
    mosaic: Picture, gains: npt.NDArray[np.float64] | None, rows: npt.NDArray[np.float32] | None
) -> Picture:
    height, width = mosaic.shape
    b, g, r = np.ones(3) if gains is None else gains
    pattern = np.array([[r, g], [g, b]], np.float32)
    column = np.tile(pattern, ((height + 1) // 2, 1))[:height]
    if rows is not None:
        column = column * rows[:, None]
    wide = np.tile(column, (1, (width + 1) // 2))[:, :width]
    return np.asarray(cv2.multiply(mosaic, np.ascontiguousarray(wide), dtype=cv2.CV_8U), np.uint8)


def _amplified(light: Picture, gains: npt.NDArray[np.float64] | None, rows: npt.NDArray[np.float32] | None) -> Picture:
    if rows is None and gains is not None:
        table = np.clip(np.rint(np.arange(256)[:, None] * gains), 0, 255).astype(np.uint8)
        return np.asarray(cv2.LUT(light, table[:, None, :]), np.uint8)
    factor = np.ones(3) if gains is None else gains
    one = np.ones(light.shape[0], np.float32) if rows is None else rows
    wide = np.broadcast_to((one[:, None] * factor)[:, None, :], light.shape)
    return np.asarray(cv2.multiply(light, np.ascontiguousarray(wide, np.float32), dtype=cv2.CV_8U), np.uint8)


def _jpeg_options(config: JpegConfig) -> list[int]:
    factor: Any = getattr(cv2, "IMWRITE_JPEG_SAMPLING_FACTOR", None)
    options = [int(cv2.IMWRITE_JPEG_QUALITY), config.quality]
    if factor is not None:
        return [*options, int(factor), _SAMPLING[config.sampling]]
    if config.sampling != "420":  # older versions of OpenCV always write 4:2:0
        raise ValueError(f"imaging.jpeg.sampling {config.sampling}: OpenCV {cv2.__version__} writes 420 only")
    return options


def _through_jpeg(light: Picture, options: list[int]) -> Picture:
    done, data = cv2.imencode(".jpg", light, options)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if done else None
    if image is None:
        raise ValueError(f"an image of {light.shape} could not be coded as JPEG")
    return np.asarray(image, np.uint8)
