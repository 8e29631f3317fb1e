"""Errors of looks at the tip: what readings and repetition reveal of them."""

from __future__ import annotations

import numpy as np
import pytest

from gantry_driver.core.sight.tip_noise import TipNoise, combined, sideways
from icu_common.core.geometry.geometry import Array

SEED = 7
RAY = np.array([0.1, np.sin(np.radians(25.0)), -np.cos(np.radians(25.0))]) / np.hypot(0.1, 1.0)
DEPTH_M, ACROSS_M, OFFSET_M = 0.00028, 0.00004, -0.0005
"""Errors of a look in height and across, and the offset between heights and readings: those of room workshop."""
ELLIPSE = 5.991


def looks(rng: np.random.Generator, count: int) -> Array:
    """Return errors (count, 3) of seen tips."""
    along = rng.normal(0.0, DEPTH_M / abs(RAY[2]), (count, 1)) * RAY
    return np.asarray(along + rng.normal(0.0, ACROSS_M, (count, 3)) * (1.0, 1.0, 0.0))


def test_the_readings_show_the_error_along_the_line_of_sight() -> None:
    print(f"seed {SEED}")
    noise = TipNoise(height_m=0.00006, across_m=0.00001)
    seen = looks(np.random.default_rng(SEED), 300)
    mended = [error[:2] - sideways(RAY, noise.take_height(error[2] + OFFSET_M)) for error in seen]
    before, after = np.linalg.norm(seen[10:, :2], axis=1), np.linalg.norm(mended[10:], axis=1)
    assert np.mean(after) < 0.6 * np.mean(before) and np.quantile(after, 0.95) < 0.6 * np.quantile(before, 0.95)
    assert noise.height_m == pytest.approx(DEPTH_M, rel=0.15), "the looks show their own scatter"


def test_a_stylus_that_has_moved_is_believed_at_once() -> None:
    noise = TipNoise(height_m=0.00006, across_m=0.00001)
    for _ in range(20):
        noise.take_height(0.0001)
    assert abs(noise.take_height(0.0011)) < 0.00001
    assert noise.offset_m == pytest.approx(0.0011, abs=0.00001)
    noise.forget()
    assert abs(noise.take_height(-0.0004)) < 0.00001


def test_the_stated_region_holds_95_percent_of_touches() -> None:
    print(f"seed {SEED}")
    rng = np.random.default_rng(SEED)
    noise = TipNoise(height_m=0.00006, across_m=0.00001)
    inside = []
    for number in range(1500):
        shared = rng.normal(0.0, ACROSS_M / np.sqrt(2.0), 3) * (1.0, 1.0, 0.0)  # of the print
        above, contact = looks(rng, 2) + shared
        above[:2] -= sideways(RAY, noise.take_height(above[2] + OFFSET_M))
        noise.take_gap(contact[:2] - above[:2], RAY)
        error, covariance = combined(above[:2], noise.in_air(RAY, 1), contact[:2], noise.in_contact(RAY))
        if number >= 20:
            inside.append(float(error @ np.linalg.solve(covariance, error)) <= ELLIPSE)
    assert 0.92 <= np.mean(inside) <= 0.98


def test_a_contact_elsewhere_than_above_it_counts_alone() -> None:
    noise = TipNoise(height_m=0.0002, across_m=0.00004)
    noise.take_height(0.0)
    air, contact = np.zeros(2), np.array([0.0006, 0.0])
    covariances = noise.in_air(RAY, 2), noise.in_contact(RAY)
    found, covariance = combined(air, covariances[0], contact, covariances[1])
    np.testing.assert_array_equal(found, contact)
    np.testing.assert_array_equal(covariance, covariances[1])
    near, smaller = combined(air, covariances[0], np.array([0.00005, 0.0]), covariances[1])
    assert 0.0 < near[0] < 0.00005 and np.trace(smaller) < np.trace(covariances[0])
