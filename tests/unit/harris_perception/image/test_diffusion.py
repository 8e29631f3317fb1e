"""Diffusion takes noise away, and keeps edges where they are."""

from __future__ import annotations

import numpy as np
import pytest

from harris_perception.core.image.diffusion import diffused

RNG = np.random.default_rng(5)
NOISY_STEP = np.where(np.arange(60) < 30, 60.0, 180.0) + RNG.normal(0, 4.0, (50, 60))


def test_noise_goes_and_the_edge_stays() -> None:
    result = diffused(NOISY_STEP, 20, 1.0)
    assert result.dtype == np.float32
    for part in (np.s_[:, 4:24], np.s_[:, 36:56]):
        assert result[part].std() < 0.5 * NOISY_STEP[part].std()
    assert result[:, 30].mean() - result[:, 29].mean() > 0.9 * 120


def test_sum_is_kept_and_contrast_has_the_unit_of_the_grey_levels() -> None:
    result = diffused(NOISY_STEP, 7, 1.0)
    assert result.mean() == pytest.approx(NOISY_STEP.mean(), rel=1e-5)
    np.testing.assert_allclose(diffused(200.0 * NOISY_STEP, 7, 200.0), 200.0 * result, rtol=1e-4)


def test_nothing_to_do() -> None:
    for steps, contrast in ((0, 3.0), (3, 0.0)):
        np.testing.assert_array_equal(diffused(NOISY_STEP, steps, contrast), NOISY_STEP.astype(np.float32))
    for shape in ((0, 0), (0, 5), (1, 1)):
        assert diffused(np.zeros(shape, np.uint16), 3, 0.5).shape == shape
    assert np.isnan(diffused(np.full((20, 20), np.nan), 3, 0.5)).all()
