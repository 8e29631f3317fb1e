"""Deriche's recursive filters against the sampled Gaussian and its derivative, applied directly in float64."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.image.deriche import filtered, recursive_filter


def direct(picture: np.ndarray, sigma: float, derivative: bool) -> np.ndarray:
    """Return the picture smoothed, or differentiated along x, with kernels that reach six sigma."""
    radius = int(np.ceil(6 * sigma))
    t = np.arange(-radius, radius + 1)
    weights = np.exp(-0.5 * (t / sigma) ** 2)
    smooth, slope = weights / weights.sum(), t * weights / (t * t * weights).sum()
    padded = cv2.copyMakeBorder(picture.astype(np.float64), *(radius,) * 4, cv2.BORDER_REPLICATE)
    result = cv2.sepFilter2D(padded, cv2.CV_64F, slope if derivative else smooth, smooth)
    return np.asarray(result[radius:-radius, radius:-radius])


@pytest.mark.parametrize("sigma", [0.5, 0.7, 1.0, 2.0, 4.0, 16.0])
@pytest.mark.parametrize("shape", [(150, 201), (3, 5), (1, 1)])
def test_error_is_below_one_part_in_a_thousand_of_the_largest_possible_answer(
    sigma: float, shape: tuple[int, int]
) -> None:
    picture = np.random.default_rng(2).integers(0, 256, shape).astype(np.float32)
    smooth, slope = recursive_filter(sigma, False), recursive_filter(sigma, True)
    error = np.abs(filtered(picture, smooth, smooth) - direct(picture, sigma, False)).max()
    assert error <= 255 * 1e-3
    # A derivative answers most to a step: with its height times the kernel's largest sum, 1 / (sqrt(2 pi) sigma).
    largest = 255 / (np.sqrt(2 * np.pi) * sigma)
    along_x = np.abs(filtered(picture, slope, smooth) - direct(picture, sigma, True)).max()
    along_y = np.abs(filtered(picture, smooth, slope) - direct(picture.T, sigma, True).T).max()
    print(sigma, error / 255, along_x / largest, along_y / largest)
    assert max(along_x, along_y) <= 4e-3 * largest


def test_constant_keeps_its_value_and_ramp_its_slope() -> None:
    x = np.indices((60, 400))[1].astype(np.float32)
    for sigma in (0.5, 3.0, 12.0):
        smooth, slope = recursive_filter(sigma, False), recursive_filter(sigma, True)
        np.testing.assert_allclose(filtered(np.full((9, 7), 77.0, np.float32), smooth, smooth), 77.0, rtol=1e-6)
        assert filtered(x, slope, smooth)[30, 200] == pytest.approx(1.0, abs=1e-4)
        assert np.abs(filtered(x, smooth, slope)).max() < 1e-4
    with pytest.raises(ValueError, match=r"sigma = 0\.3"):
        recursive_filter(0.3, False)


def test_corners_are_those_of_the_direct_gaussians() -> None:
    rng = np.random.default_rng(4)
    blocks = np.kron(rng.integers(0, 256, (12, 15)), np.ones((16, 16)))
    picture = np.clip(cv2.GaussianBlur(blocks, (0, 0), 0.8) + rng.normal(0, 2, blocks.shape), 0, 255).astype(np.uint8)
    settings = {"sigma_d_px": 1.5, "sigma_i_px": 2.5, "relative_threshold": 0.05}
    one = HarrisDetector(HarrisConfig(gradient="gaussian", window="gaussian", **settings)).detect(picture)
    two = HarrisDetector(HarrisConfig(gradient="deriche", window="deriche", **settings)).detect(picture)
    distance = np.linalg.norm(one.xy[:, None] - two.xy[None], axis=2).min(axis=1)
    assert len(one) > 40 and (distance < 0.1).mean() > 0.95
