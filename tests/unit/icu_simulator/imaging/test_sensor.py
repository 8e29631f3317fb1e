"""The sensor and its electronics: noise, mosaic, gains, flicker, JPEG; and that the seed decides."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from icu_common.core.configuration.config import from_mapping
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.imaging.effect import BenchEffect, effects_of
from icu_simulator.imaging.focus import Focus, blurred
from icu_simulator.imaging.sensor import Sensor

SHAPE = (240, 320, 3)


def sensor(camera: int = 0, *, noise: float = 0.0, **values: object) -> Sensor:
    settings = {"light.noise": noise, **{f"imaging.{name}": value for name, value in values.items()}}
    return Sensor(from_mapping(BenchConfig, settings), camera)


def flat(*bgr: int) -> np.ndarray:
    return np.broadcast_to(np.array(bgr, np.uint8), SHAPE).copy()


def test_without_effects_the_sensor_changes_nothing() -> None:
    light = np.random.default_rng(1).integers(0, 256, SHAPE, np.uint8)
    assert np.array_equal(sensor().develop(light.copy(), 1.0), light)


@pytest.mark.parametrize("level", [40, 120, 200])
def test_shot_noise_grows_with_the_light(level: int) -> None:
    made = sensor(noise=1.5, **{"shot_noise.enabled": True, "shot_noise.at_white": 4.0})
    spread = made.develop(flat(level, level, level), 2.0).std()
    assert spread == pytest.approx(np.sqrt(1.5**2 + 4.0**2 * level / 255 + 1 / 12), rel=0.04)


def test_noise_differs_from_image_to_image_and_camera_to_camera_and_comes_back_with_the_seed() -> None:
    settings = {"shot_noise.enabled": True, "bayer.enabled": True, "jpeg.enabled": True}
    one, again, other = (sensor(c, noise=1.5, **settings) for c in (0, 0, 1))
    first = one.develop(flat(90, 120, 150), 3.0)
    assert np.array_equal(first, again.develop(flat(90, 120, 150), 3.0))
    assert not np.array_equal(first, one.develop(flat(90, 120, 150), 3.1))
    assert not np.array_equal(first, other.develop(flat(90, 120, 150), 3.0))


def test_a_mosaic_keeps_even_colours_and_fringes_edges() -> None:
    made = sensor(**{"bayer.enabled": True})
    assert np.array_equal(made.develop(flat(30, 120, 210), 1.0), flat(30, 120, 210))
    edge = flat(20, 20, 20)
    edge[:, 161:] = 220
    seen = made.develop(edge, 1.0).astype(int)
    fringe = np.abs(seen[100:140, 158:164, 2] - seen[100:140, 158:164, 0]).max()
    assert fringe > 40, "red and blue of an edge between two columns are interpolated from different ones"
    assert np.abs(seen[100:140, 170:, 2] - 220).max() <= 1


def test_jpeg_420_halves_the_colour_and_keeps_the_brightness() -> None:
    stripes = flat(128, 128, 128)
    stripes[:, ::2] = (176, 22, 226)
    stripes[:, 1::2] = (40, 150, 60)
    columns = {}
    for sampling in ("444", "420"):
        made = sensor(**{"jpeg.enabled": True, "jpeg.quality": 95, "jpeg.sampling": sampling})
        ycc = cv2.cvtColor(made.develop(stripes.copy(), 1.0), cv2.COLOR_BGR2YCrCb).astype(int)
        columns[sampling] = [np.abs(np.diff(ycc[:, 8:-8, i], axis=1)).mean() for i in (0, 1)]
    assert columns["420"][1] < 0.25 * columns["444"][1], "colour of single columns is lost"
    assert columns["420"][0] > 0.4 * columns["444"][0], "their brightness is not"


def test_jpeg_loses_more_at_a_lower_quality_and_twice_the_effect_is_twice_the_quantisation() -> None:
    rng = np.random.default_rng(4)
    light = cv2.GaussianBlur(rng.integers(0, 256, SHAPE, np.uint8), (0, 0), 1.5)
    error = [
        np.abs(
            sensor(**{"jpeg.enabled": True, "jpeg.quality": q}).develop(light.copy(), 1.0).astype(int) - light
        ).mean()
        for q in (95, 80, 60)
    ]
    assert error[0] < error[1] < error[2]
    jpeg = BenchConfig().imaging.jpeg
    assert (jpeg.scaled(1).quality, jpeg.scaled(2).quality) == (80, 60)


def test_flicker_makes_bands_of_the_mains_period_unless_the_exposure_is_one() -> None:
    values = {"flicker.enabled": True, "flicker.depth": 0.2, "flicker.frequency_hz": 100.0}
    rolling = {"rolling_shutter.enabled": True, "rolling_shutter.row_us": 50.0}
    bands = sensor(**values, **rolling).develop(flat(100, 100, 100), 5.0)[:, 0, 0].astype(float)
    assert np.ptp(bands) == pytest.approx(40, abs=2)
    assert bands[:200].mean() == pytest.approx(100, abs=1), "200 rows of 50 us are one period"
    np.testing.assert_allclose(bands[:40], bands[200:], atol=1)
    whole = {"exposure.enabled": True, "exposure.time_ms": 10.0}
    even = sensor(**values, **rolling, **whole).develop(flat(100, 100, 100), 5.0)
    assert np.ptp(even.astype(int)) == 0
    half = {"exposure.enabled": True, "exposure.time_ms": 5.0}
    damped = sensor(**values, **rolling, **half).develop(flat(100, 100, 100), 5.0)[:, 0, 0].astype(float)
    assert np.ptp(damped) == pytest.approx(40 * 2 / np.pi, abs=2)
    mosaic = sensor(**values, **rolling, **{"bayer.enabled": True}).develop(flat(100, 100, 100), 5.0)
    np.testing.assert_allclose(mosaic[4:-4, 50, 1].astype(float), bands[4:-4], atol=3)


def test_auto_exposure_follows_late_and_ends_at_its_target() -> None:
    made = sensor(**{"auto_exposure.enabled": True, "auto_exposure.target": 100.0, "auto_exposure.lag_s": 1.0})
    assert made.develop(flat(50, 50, 50), 0.0).mean() == pytest.approx(100, abs=3), "settled when it starts"
    levels = [made.develop(flat(100, 100, 100), 0.001 + t).mean() for t in (0.0, 1.0, 2.0, 8.0)]
    # The gain goes from 2 to 1, in stops.
    expected = [100 * 2 ** np.exp(-t) for t in (0.0, 1.0, 2.0, 8.0)]
    assert levels == pytest.approx(expected, rel=0.05)
    limited = sensor(**{"auto_exposure.enabled": True, "auto_exposure.reach": 2.0, "auto_exposure.target": 250.0})
    assert limited.develop(flat(20, 20, 20), 0.0).mean() == pytest.approx(40, abs=2)


def test_white_balance_takes_its_share_of_a_cast_away() -> None:
    made = sensor(**{"white_balance.enabled": True, "white_balance.strength": 1.0, "white_balance.lag_s": 1.0})
    assert np.ptp(made.develop(flat(60, 100, 140), 0.0)[0, 0].astype(int)) <= 2
    blue, green, red = made.develop(flat(100, 100, 100), 0.01)[0, 0].astype(int)
    assert blue > green + 40 and red < green - 15, "the old balance at first"
    assert np.ptp(made.develop(flat(100, 100, 100), 20.0)[0, 0].astype(int)) <= 2


def test_vibration_shifts_the_image_and_bends_it_with_a_rolling_shutter() -> None:
    light = flat(20, 20, 20)
    light[:, 160:] = 220
    light = cv2.GaussianBlur(light, (0, 0), 2.0)
    values = {"vibration.enabled": True, "vibration.amplitude_px": 2.0, "vibration.frequency_hz": 50.0}

    def edge(image: np.ndarray) -> np.ndarray:
        return (image[:, 140:180, 0].astype(float).sum(axis=1) - 20 * 40) / 200

    upright = edge(sensor(**values).develop(light.copy(), 0.005))
    assert np.ptp(upright) < 0.05 and upright[0] - edge(light)[0] == pytest.approx(1.0, abs=0.1)
    rolling = {"rolling_shutter.enabled": True, "rolling_shutter.row_us": 60.0}
    assert np.ptp(edge(sensor(**values, **rolling).develop(light.copy(), 0.0))) > 1.0


def test_the_circle_of_confusion_is_that_of_a_thin_lens() -> None:
    focus = Focus(blur_px=0.5, focal_px=1700.0, aperture_m=0.0025, focused_m=0.6)
    assert focus.circle_px(0.6) == 0.0 and focus.sigma_px(0.6) == 0.5
    assert focus.circle_px(0.5) == pytest.approx(1700 * 0.0025 * (2.0 - 1 / 0.6))
    light = np.zeros((60, 200, 3), np.float32)
    light[30, ::20] = 1000.0
    sigma = np.broadcast_to(np.linspace(0.6, 2.0, 200, dtype=np.float32), (60, 200))
    seen = blurred(light, sigma, sigma)
    for column in (40, 100, 160):
        spot = seen[:, column - 9 : column + 10, 0]
        rows = np.arange(60) - 30
        spread = np.sqrt((spot.sum(axis=1) * rows**2).sum() / spot.sum())
        assert spread == pytest.approx(sigma[0, column], rel=0.08)


def test_every_effect_is_off_has_a_source_and_grows() -> None:
    found = dict(effects_of(BenchConfig()))
    assert len(found) >= 18
    for name, effect in found.items():
        assert not effect.enabled and len(effect.SOURCE) > 20, name
        assert effect.scaled(1).enabled and (effect.scaled(2) != effect.scaled(1) or not effect.SCALED), name
        assert isinstance(effect.scaled(2), BenchEffect)
    assert found["imaging.exposure"].scaled(2).time_ms == 20.0
