"""Exposures and stamps of free-running cameras, lost and repeated images, rolling shutter, smear."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest

from icu_common.core.configuration.config import from_mapping
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.core.bench import Bench
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.renderer import Renderer
from icu_simulator.imaging.motion import ShutterTimes
from icu_simulator.imaging.stream import CameraStream
from icu_simulator.imaging.timing import Shot, shots

LAYOUT = load_layout(Path(__file__).parents[4] / "config/scopes/dso_bench_4.yaml")
SMALL = {
    "camera.width_px": 640,
    "camera.height_px": 360,
    "camera.focal_px": 850.0,
    "camera.centre_px": (321.2, 177.4, 316.3, 181.9),
    "light.noise": 0.0,
    "mechanics.backlash_mm": (0.0, 0.0),
    "mechanics.backlash_z_mm": 0.0,
    "mechanics.scale": 0.0,
    "mechanics.skew_rad": 0.0,
    "mechanics.tilt_rad": 0.0,
}
TIMES = np.arange(2000) / 15 + 20.0


def config(**values: object) -> BenchConfig:
    return from_mapping(BenchConfig, {**SMALL, **{f"imaging.{name}": value for name, value in values.items()}})


def test_without_effects_both_images_are_of_now() -> None:
    assert shots(config(), 12.5) == [Shot(camera=i, exposure_s=12.5, stamp_s=12.5) for i in (0, 1)]


def test_two_stamps_differ_by_the_phase_which_drifts_within_a_period() -> None:
    free = config(**{"free_running.enabled": True, "free_running.phase_ms": 13.0, "free_running.drift_ppm": 0.0})
    for now_s in TIMES[:20]:
        left, right = shots(free, float(now_s))
        assert left.stamp_s - right.stamp_s == pytest.approx(0.013, abs=1e-9)
        assert (left.exposure_s, right.exposure_s) == (left.stamp_s, right.stamp_s)
    drifting = config(**{"free_running.enabled": True, "free_running.drift_ppm": 1000.0})
    phases = np.array([a.stamp_s - b.stamp_s for a, b in (shots(drifting, float(t)) for t in TIMES)])
    assert (phases >= 0).all() and (phases < 1 / 15).all()
    slope = np.median(np.diff(phases)) * 15
    assert slope == pytest.approx(1e-3, rel=1e-6)


def test_stamps_are_late_and_uneven_as_configured_but_never_from_the_future() -> None:
    uneven = config(**{"stamps.enabled": True, "stamps.offset_ms": 15.0, "stamps.jitter_ms": 2.0})
    found = [(float(t), shot) for t in TIMES for shot in shots(uneven, float(t))]
    delays = np.array([shot.stamp_s - shot.exposure_s for _, shot in found])
    assert delays.mean() == pytest.approx(0.015, abs=2e-4)
    assert delays.std() == pytest.approx(0.002, rel=0.05)
    assert all(shot.stamp_s <= now_s for now_s, shot in found)
    early = config(**{"stamps.enabled": True, "stamps.offset_ms": -5.0, "stamps.jitter_ms": 0.0})
    assert shots(early, 9.0)[0].stamp_s == pytest.approx(shots(early, 9.0)[0].exposure_s - 0.005)


def test_images_are_lost_and_repeated_at_their_rates() -> None:
    losing = config(**{"losses.enabled": True, "losses.dropped": 0.1, "losses.repeated": 0.05})
    found = [shots(losing, float(t)) for t in TIMES]
    lost = 1 - sum(map(len, found)) / (2 * len(TIMES))
    assert lost == pytest.approx(0.1, abs=0.015)
    repeated = np.mean([shot.repeated for pair in found for shot in pair])
    assert repeated == pytest.approx(0.05, abs=0.012)
    assert found == [shots(losing, float(t)) for t in TIMES], "the seed and the time decide"
    both = sum(not pair for pair in found) / len(TIMES)
    assert both == pytest.approx(0.01, abs=0.007), "each camera loses its own"


def moving_bench(settings: BenchConfig, speed_mm_s: tuple[float, float]) -> tuple[Bench, Renderer]:
    """Return a bench whose ball moves evenly, 15 mm below its highest place, at (150, 30) mm at 10.0 s."""
    bench = Bench(LAYOUT, settings)
    for k in range(-60, 61):
        t = 10.0 + 0.004 * k
        x, y = (start + speed * (t - 10.0) for start, speed in zip((150.0, 30.0), speed_mm_s))
        bench.feed((-359.0 + x, -219.0 + y, -16.0), 0.0, False, t)
    return bench, Renderer(LAYOUT, settings, bench.panel_from)


def chroma(picture: np.ndarray) -> np.ndarray:
    blue, green, red = (picture[..., i].astype(float) for i in range(3))
    return np.clip(np.minimum(red, blue) - green, 0, None)


@functools.cache
def background(side: int) -> np.ndarray:
    bench, renderer = moving_bench(config(), (0.0, 0.0))
    away = dataclasses.replace(bench.moment(10.0), tip=(0.34, 0.21, 0.0))
    return chroma(renderer.render(away)[side])


def ball(picture: np.ndarray, side: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return centre and spread (standard deviations) of the magenta ball in pixels, x and y."""
    share = chroma(picture) - background(side)
    share[share < 6] = 0.0
    rows, columns = np.mgrid[0 : share.shape[0], 0 : share.shape[1]]
    at = np.stack([columns, rows])
    centre = (at * share).sum(axis=(1, 2)) / share.sum()
    return centre, np.sqrt((share * (at - centre[:, None, None]) ** 2).sum(axis=(1, 2)) / share.sum())


def picture_of(settings: BenchConfig, speed_mm_s: tuple[float, float]) -> np.ndarray:
    bench, renderer = moving_bench(settings, speed_mm_s)
    half_s = ShutterTimes.of(settings.imaging).half_s(settings.camera.height_px)
    return renderer.render(bench.moment(10.0, half_s))[0]


def test_rolling_shutter_shows_a_moving_ball_where_it_was_in_its_row() -> None:
    speed = 200.0
    still = ball(picture_of(config(), (0.0, 0.0)))[0]
    rolling = config(**{"rolling_shutter.enabled": True, "rolling_shutter.row_us": 60.0})
    moved = ball(picture_of(rolling, (speed, 0.0)))[0]
    # Row 360 / 2 is exposed at 10.0 s; a pixel is 0.79 mm here.
    bench, renderer = moving_bench(config(), (0.0, 0.0))
    tip = np.array(bench.moment(10.0).tip)
    per_mm = (renderer.rig.left.project(tip + (0.001, 0, 0)) - renderer.rig.left.project(tip))[0, 0]
    expected = speed * (still[1] - 179.5) * 60e-6 * per_mm
    assert abs(expected) > 0.3, "else the test shows nothing"
    assert moved[0] - still[0] == pytest.approx(expected, abs=0.1)
    assert moved[1] == pytest.approx(still[1], abs=0.3), "drawn coarsely while it travels"
    np.testing.assert_allclose(ball(picture_of(rolling, (0.0, 0.0)))[0], still, atol=0.02)


def test_exposure_smears_a_moving_ball_by_its_speed() -> None:
    exposed = config(**{"exposure.enabled": True, "exposure.time_ms": 20.0})
    (at, spread), (still_at, still_spread) = (ball(picture_of(exposed, (v, 0.0))) for v in (200.0, 0.0))
    # 4 mm of motion are 5 px here; an even smear has a twelfth of its squared length as variance.
    assert spread[0] == pytest.approx(np.sqrt(still_spread[0] ** 2 + (4.0 / 0.79) ** 2 / 12), rel=0.15)
    assert spread[1] == pytest.approx(still_spread[1], rel=0.08)
    assert np.abs(at - still_at).max() < 0.25


def test_each_camera_shows_the_ball_at_its_own_exposure() -> None:
    free = config(**{"free_running.enabled": True, "free_running.phase_ms": 30.0, "free_running.drift_ppm": 0.0})
    bench, renderer = moving_bench(free, (200.0, 0.0))
    images = CameraStream().take(free, bench, renderer, 10.0)
    assert [image.camera for image in images] == [0, 1]
    assert images[0].stamp_s - images[1].stamp_s == pytest.approx(0.030)
    for image, camera in zip(images, (renderer.rig.left, renderer.rig.right)):
        tip = bench.moment(image.stamp_s).tip
        assert np.abs(ball(image.picture, image.camera)[0] - camera.project(tip)[0]).max() < 0.6
    late = renderer.rig.right.project(bench.moment(10.0).tip)[0]
    assert np.abs(ball(images[1].picture, 1)[0] - late)[0] > 5, "else the test shows nothing"


def test_a_repeated_image_is_the_last_one_with_a_new_stamp() -> None:
    repeating = config(**{"losses.enabled": True, "losses.dropped": 0.0, "losses.repeated": 0.9})
    bench, renderer = moving_bench(repeating, (200.0, 0.0))
    stream = CameraStream()
    first = stream.take(repeating, bench, renderer, 9.90)
    later = [stream.take(repeating, bench, renderer, 9.90 + n / 30) for n in range(1, 4)]
    lefts = [images[0] for images in (first, *later)]
    stamps = [image.stamp_s for image in lefts]
    assert stamps == sorted(set(stamps))
    assert len({image.picture.tobytes() for image in lefts}) < len(lefts)
