"""The search from nothing: descriptors, their matches against the plain formula, homographies of adversarial points."""

from __future__ import annotations

import numpy as np
import pytest

from harris_perception.core.recognition.panel_search import Describer, SearchConfig, matches, robust_homography
from icu_common.core.geometry.geometry import Array

PIXELS_FROM_MM = np.array([[4.0, 0.3, 50.0], [-0.2, 4.2, 40.0], [1e-4, -2e-4, 1.0]])


def mapped(points_mm: Array) -> Array:
    turned = np.column_stack([points_mm, np.ones(len(points_mm))]) @ PIXELS_FROM_MM.T
    return np.asarray(turned[:, :2] / turned[:, 2:])


def units(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = np.abs(rng.normal(size=(count, 128)))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("descriptor", ["sift", "orb"])
def test_no_corner_has_as_many_numbers_as_one(descriptor: str) -> None:
    """Else a template's levels with and without corners cannot be put together, nor compared with the picture's."""
    describe = Describer(SearchConfig(descriptor=descriptor))
    gray = np.random.default_rng(0).integers(0, 256, (120, 160), np.uint8)
    some, kept = describe(gray, np.array([[60.0, 50.0], [80.5, 61.0]], np.float32))
    none, nobody = describe(gray, np.empty((0, 2), np.float32))
    assert kept.tolist() == [0, 1] and len(nobody) == 0 and none.shape == (0, some.shape[1])
    assert np.linalg.norm(some, axis=1) == pytest.approx(1.0, abs=1e-6)
    assert len(matches(none, some, np.zeros((2, 2)), SearchConfig())[0]) == 0


def test_matches_are_those_of_the_plain_formula() -> None:
    rng, config, count = np.random.default_rng(1), SearchConfig(), 0
    for trial in range(40):
        template = units(rng, int(rng.integers(1, 200)))
        query = units(rng, 12)
        alike = rng.integers(0, len(template), 8)
        query[:8] = template[alike] + rng.normal(0, 0.02, (8, 128))
        query /= np.linalg.norm(query, axis=1, keepdims=True)
        places = rng.uniform(0, 100, (len(template), 2)) // (20 if trial % 2 else 1)  # a grid: several at one place
        expected = []
        for i, likeness in enumerate(query.astype(float) @ template.T.astype(float)):
            best = int(likeness.argmax())
            apart = np.linalg.norm(places - places[best], axis=1) > config.same_place_mm
            other = likeness[apart].max(initial=-1.0)
            if np.sqrt(max(2 - 2 * likeness[best], 0)) < config.ratio * np.sqrt(2 - 2 * other):
                expected.append((i, best))
        found = [part.tolist() for part in matches(query, template, places, config)]
        assert list(zip(*found, strict=True)) == expected
        count += len(expected)
    assert count > 200


def test_points_that_tell_no_homography_give_none() -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform(0, 100, (40, 2))
    line = np.column_stack([np.linspace(0, 100, 40), np.linspace(0, 50, 40)])
    assert robust_homography(line, mapped(line), 3.0, 10) is None
    beside = np.vstack([line, [[20.0, 80.0]]])  # one number of eight stays open
    assert robust_homography(beside, mapped(beside) + rng.normal(0, 0.3, beside.shape), 3.0, 10) is None
    assert robust_homography(np.repeat(places[:3], 12, 0), mapped(np.repeat(places[:3], 12, 0)), 3.0, 10) is None
    assert robust_homography(places, np.tile([[50.0, 60.0]], (40, 1)), 3.0, 10) is None
    assert robust_homography(np.tile(places[:1], (40, 1)), mapped(places), 3.0, 10) is None
    assert robust_homography(places, rng.uniform(0, 500, places.shape), 3.0, 10) is None


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e300])
def test_a_homography_is_found_beside_points_that_are_nowhere(wrong: float) -> None:
    places = np.random.default_rng(3).uniform(0, 100, (40, 2))
    pixels = mapped(places)
    pixels[3] = wrong
    fitted = robust_homography(places, pixels, 3.0, 10)
    assert fitted is not None
    assert fitted[0] / fitted[0][2, 2] == pytest.approx(PIXELS_FROM_MM, abs=1e-3)
    assert fitted[1].tolist() == [i != 3 for i in range(40)]
