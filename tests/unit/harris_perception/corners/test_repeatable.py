"""The corners that repeat best do so under every change, stand out from the noise, and keep off straight edges."""

from __future__ import annotations

import doctest

import cv2
import numpy as np
import pytest

from harris_perception.core.corners import repeatable
from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.repeatable import RepeatableConfig, RepeatableDetector
from harris_perception.core.evaluation.repeatability import repeatability, warps
from harris_perception.core.image.noise import noise_above, noise_of
from icu_common.core.configuration.config import ConfigError

ABOVE_NOISE = RepeatableDetector(RepeatableConfig(max_corners=1000, least=0.0))


def rocks(seed: int, size: int = 260) -> np.ndarray:
    """Return a picture with the spectrum of natural ones, which falls with the frequency."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    frequency[0, 0] = 1.0
    field = np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) * frequency**-1.2).real
    return np.clip(128.0 + 45.0 * field / field.std(), 0, 255).astype(np.uint8)


def test_setting_that_repeats_best_does_so_under_every_change() -> None:
    found: dict[str, list[tuple[float, float]]] = {}
    best = RepeatableDetector(RepeatableConfig(max_corners=300))
    fast = HarrisDetector(HarrisConfig(max_corners=300, relative_threshold=0.0))
    for pair in warps(rocks(1), np.random.default_rng(1)):
        rates = [repeatability(pair, d(pair.first).xy, d(pair.second).xy, (1.5,)) for d in (best.detect, fast.detect)]
        assert min(rates[0].count, rates[1].count) > 20
        found.setdefault(pair.change, []).append((rates[0].rates[0], rates[1].rates[0]))
    means = {change: np.mean(rates, axis=0) for change, rates in found.items()}
    print(means)
    assert all(ours > plain + 0.05 for ours, plain in means.values())


@pytest.mark.parametrize("sigma", [0.0, 1.0, 4.0, 15.0])
def test_noise_is_told_beside_texture(sigma: float) -> None:
    rng = np.random.default_rng(3)
    picture = np.full((200, 240), 100.0)
    picture[:, 160:] += np.kron(rng.uniform(-60.0, 60.0, (40, 16)), np.ones((5, 5)))  # a third
    noisy = picture + rng.normal(0.0, sigma, picture.shape)
    found = noise_of(noisy.astype(np.float32))
    print(found)
    assert found == pytest.approx(sigma, rel=0.35, abs=1e-4)
    assert noise_of((noisy * 200.0).astype(np.uint16)) == pytest.approx(200.0 * found, rel=0.01, abs=1.0)
    few = [
        noise_above(part, 0.5) for part in (noisy.astype(np.float32), (noisy + 100.0).astype(np.uint16).astype(">u2"))
    ]
    assert few == pytest.approx(2 * [sigma], rel=0.35, abs=1e-4), "by 512 pixels"
    assert noise_above(noisy.astype(np.float32), 1.5 * sigma) == 0.0


@pytest.mark.parametrize("rows", [0, 60, 140])
def test_what_is_evenly_black_or_white_hides_no_noise(rows: int) -> None:
    """As around a fisheye's image, or where the sensor was blinded."""
    rng = np.random.default_rng(3)
    squares = np.kron(np.indices((12, 16)).sum(axis=0) % 2, np.ones((20, 20)))
    seen = np.rint(60.0 + 90.0 * squares + rng.normal(0.0, 4.0, squares.shape)).astype(np.uint8)
    for value in (0, 255):
        picture = seen.copy()
        picture[:rows] = value
        for told in (noise_of(picture), noise_above(picture, 1.0), noise_of(picture.astype(np.float32))):
            assert told == pytest.approx(4.0, rel=0.25)
        at = ABOVE_NOISE.detect(picture).xy
        off = np.abs((at + 0.5) / 20.0 - np.rint((at + 0.5) / 20.0)).max(axis=1) * 20.0
        assert len(at) > 50 and (off < 3.0).all(), "at the squares' corners alone"
    assert noise_of(np.where(squares > 0, 200, 20).astype(np.uint8)) == 0.0, "a drawing has none"


@pytest.mark.parametrize("shape", [(0, 0), (3, 3), (2, 9), (3, 200), (40, 3)])
def test_noise_of_small_pictures_and_of_those_that_nothing_is_known_of(shape: tuple[int, int]) -> None:
    for value in (np.nan, np.inf, 70.0):
        assert noise_above(np.full(shape, value, np.float32), 0.0) == 0.0


def test_noise_alone_and_a_noisy_straight_edge_have_no_corner() -> None:
    rng = np.random.default_rng(4)
    y, x = np.indices((200, 200))
    for slope in (0.0, 0.4):
        edge = 60.0 + 120.0 / (1.0 + np.exp(2.0 * (120.0 - x - slope * y)))
        for sigma in (2.0, 8.0):
            picture = (edge + rng.normal(0.0, sigma, edge.shape)).clip(0, 255).astype(np.uint8)
            plain = HarrisDetector(HarrisConfig(relative_threshold=0.0)).detect(picture)
            found = ABOVE_NOISE.detect(picture)
            print(slope, sigma, len(plain), len(found))
            assert len(plain) > 500 and len(found) <= 2
            least = RepeatableDetector(RepeatableConfig(max_corners=100, least=0.3)).detect(picture)
            assert len(least) == 30, "however weak"


@pytest.mark.parametrize("gain", [2.0**-100, 0.1, 0.5, 100.0, 2.0**60, 2.0**100])
def test_gain_and_offset_change_nothing(gain: float) -> None:
    rng = np.random.default_rng(2)
    blocks = np.kron(rng.uniform(20.0, 220.0, (20, 22)), np.ones((11, 12)))
    picture = np.asarray(cv2.GaussianBlur(blocks, (0, 0), 0.8) + rng.normal(0.0, 1.0, blocks.shape), np.float32)
    plain, lit = ABOVE_NOISE.detect(picture), ABOVE_NOISE.detect(np.float32(gain) * (picture + np.float32(7.0)))
    assert len(plain) > 50 and abs(len(lit) - len(plain)) <= 1
    distance = np.linalg.norm(plain.xy[:, None] - lit.xy[None], axis=2)
    assert (distance.min(axis=1) < 0.05).sum() >= len(plain) - 1


@pytest.mark.parametrize("seed", [11, 13])
def test_a_lamp_on_one_side_does_not_take_all_corners_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    blocks = cv2.GaussianBlur(np.kron(rng.uniform(20.0, 120.0, (30, 100)), np.ones((12, 12))), (0, 0), 0.8)
    pictures = [np.float32(blocks), np.float32(blocks * np.linspace(0.3, 2.0, 1200)[None])]
    strongest = RepeatableDetector(RepeatableConfig(max_corners=300))
    everything = RepeatableDetector(RepeatableConfig(max_corners=0))
    ranked = [strongest.detect(each).xy for each in pictures]
    largest = [everything.detect(each).xy[:300] for each in pictures]
    again = [(np.linalg.norm(a[:, None] - b[None], axis=2).min(axis=1) < 1.5).mean() for a, b in (ranked, largest)]
    dark = [(lit[:, 0] < 600).mean() for _, lit in (ranked, largest)]
    print(again, dark)
    assert len(ranked[0]) == len(ranked[1]) == len(largest[0]) == len(largest[1]) == 300
    assert again[0] > again[1] + 0.1 and dark[0] > dark[1] + 0.05


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (30, 7), (60, 60)])
def test_pictures_without_corners(shape: tuple[int, int]) -> None:
    for value in (9.0, np.nan):
        picture = np.full(shape, value, np.float32)
        assert noise_of(picture) == 0.0
        assert RepeatableDetector().detect(picture).xy.shape == (0, 2)


def test_corners_may_be_more_than_opencv_takes_at_once() -> None:
    picture = np.random.default_rng(6).integers(0, 256, (1000, 1000), np.uint8)
    everything = RepeatableConfig(max_corners=0, above_noise=0.0, above_around=0.0, diffusion_steps=0)
    assert len(RepeatableDetector(everything).detect(picture)) > 32_768


def test_more_diffusion_than_a_picture_has_time_for_is_refused() -> None:
    """A step takes about 6 ms of 1280 x 720 px; as many as fit into half a second may be asked for."""
    with pytest.raises(ConfigError, match="diffusion_steps = 101 is above its maximum 100"):
        RepeatableConfig(diffusion_steps=101)
    picture = np.kron(np.indices((6, 6)).sum(axis=0) % 2 * 100, np.ones((12, 12))).astype(np.float32)
    noisy = picture + np.random.default_rng(7).normal(0, 1.0, picture.shape).astype(np.float32)
    assert len(RepeatableDetector(RepeatableConfig(diffusion_steps=100)).detect(noisy)) >= 25


def test_colour_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(9, 9, 3\)"):
        ABOVE_NOISE.detect(np.zeros((9, 9, 3), np.uint8))


def test_one_pixel_that_is_not_finite_takes_its_surroundings_only() -> None:
    rng = np.random.default_rng(5)
    picture = np.kron(np.indices((12, 30)).sum(axis=0) % 2 * 100, np.ones((12, 12))) + rng.normal(0, 1.0, (144, 360))
    picture = picture.astype(np.float32)
    whole = ABOVE_NOISE.detect(picture).xy
    picture[70, 20] = np.inf
    left = ABOVE_NOISE.detect(picture).xy
    far = whole[:, 0] > 120
    assert far.sum() > 100
    assert np.linalg.norm(whole[far, None] - left[None], axis=2).min(axis=1).max() < 0.1


def test_examples_in_docstrings_run() -> None:
    result = doctest.testmod(repeatable)
    assert result.attempted > 0 and result.failed == 0
