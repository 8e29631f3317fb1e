"""Diffusion takes noise away, keeps edges where they are, and knows no unit of grey level."""

from __future__ import annotations

import numpy as np
import pytest

from harris_perception.core.diffusion import diffused
from harris_perception.core.harris_laplace import HarrisLaplaceDetector, repeatable

RNG = np.random.default_rng(5)
NOISY_STEP = np.where(np.arange(60) < 30, 60.0, 180.0) + RNG.normal(0, 4.0, (50, 60))


def test_noise_goes_and_the_edge_stays() -> None:
    result = diffused(NOISY_STEP, 20, 0.5)
    assert result.dtype == np.float32
    for part in (np.s_[:, 4:24], np.s_[:, 36:56]):
        assert result[part].std() < 0.5 * NOISY_STEP[part].std()
    assert result[:, 30].mean() - result[:, 29].mean() > 0.9 * 120


def test_sum_is_kept_and_the_contrast_follows_the_grey_levels() -> None:
    result = diffused(NOISY_STEP, 7, 0.5)
    assert result.mean() == pytest.approx(NOISY_STEP.mean(), rel=1e-5)
    np.testing.assert_allclose(diffused(200.0 * NOISY_STEP, 7, 0.5), 200.0 * result, rtol=1e-4)


def test_nothing_to_do() -> None:
    flat = np.full((9, 9), 7, np.uint8)
    flat[4, 4] = 9  # fewer gradients than half of the picture: nothing tells what is weak
    for steps in (0, 3):
        np.testing.assert_array_equal(diffused(np.repeat(flat, 5, axis=0), steps, 0.1), np.repeat(flat, 5, axis=0))
    for shape in ((0, 0), (0, 5), (1, 1)):
        assert diffused(np.zeros(shape, np.uint16), 3, 0.5).shape == shape
    assert np.isnan(diffused(np.full((20, 20), np.nan), 3, 0.5)).all()


def test_one_pixel_that_is_not_finite_takes_its_surroundings_only() -> None:
    picture = np.kron(np.indices((12, 30)).sum(axis=0) % 2 * 100, np.ones((12, 12))).astype(np.float32)
    whole = HarrisLaplaceDetector(repeatable(0)).detect(picture).xy
    picture[70, 20] = np.inf
    left = HarrisLaplaceDetector(repeatable(0)).detect(picture).xy
    far = whole[:, 0] > 120
    assert far.sum() > 100
    assert np.linalg.norm(whole[far, None] - left[None], axis=2).min(axis=1).max() < 0.1
