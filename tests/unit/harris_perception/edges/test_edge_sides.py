"""Measures of the two sides of an edge, on images whose regions are known exactly."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from harris_perception.core.edges import edge_kernels as kernels
from harris_perception.core.edges.edge_sides import Sides
from harris_perception.core.edges.edges import EDGE, EdgeConfig, EdgeDetector


def flow_matrix(right: np.ndarray, down: np.ndarray, axis: int) -> np.ndarray:
    """Return I - time L of one axis for cells in the order of rows: what an implicit step is the solution of."""
    height, width = right.shape
    matrix = np.eye(height * width)
    for y in range(height):
        for x in range(width):
            other = (y, x + 1) if axis else (y + 1, x)
            if other[0] < height and other[1] < width:
                i, j = y * width + x, other[0] * width + other[1]
                share = right[y, x] if axis else down[y, x]
                matrix[[i, j], [i, j]] += share
                matrix[[i, j], [j, i]] -= share
    return matrix


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    height=st.integers(1, 7),
    width=st.integers(1, 7),
    depth=st.integers(1, 5),
    steps=st.integers(1, 3),
)
def test_walk_solves_the_implicit_steps(seed: int, height: int, width: int, depth: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.normal(size=(height, width, depth)).astype(np.float32)
    right, down = (rng.exponential(20.0, (height, width)).astype(np.float32) for _ in range(2))
    right[:, -1] = down[-1] = 0.0
    expected = cells.reshape(-1, depth).astype(np.float64)
    for _ in range(steps):
        for axis in (1, 0):
            expected = np.linalg.solve(flow_matrix(right, down, axis), expected)
    total = cells.sum(axis=(0, 1))
    kernels.walk(cells, right, down, steps)
    np.testing.assert_allclose(cells.reshape(-1, depth), expected, rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(cells.sum(axis=(0, 1)), total, atol=2e-3)


def two_regions() -> tuple[np.ndarray, np.ndarray]:
    """Return two regions of coarse noise, 25 grey levels apart on average, and what parts them, known exactly."""
    seed = 3
    print(f"seed {seed}")
    noise = cv2.resize(
        np.random.default_rng(seed).normal(0.0, 40.0, (20, 30)), (240, 160), interpolation=cv2.INTER_CUBIC
    )
    picture = np.clip(110 + 25 * (np.arange(240) >= 120) + noise, 0, 255).astype(np.uint8)
    between = np.zeros(picture.shape, np.float32)
    between[:, 119] = 10.0
    return picture, between


def test_regions_differ_where_a_closed_edge_parts_them_whatever_lies_beside_it() -> None:
    picture, between = two_regions()
    sides = Sides([picture], texture=0.0, k=0.24)
    apart, beside = sides.of_regions(between, reach_px=40.0), sides.beside(6.0)
    edge, within = np.s_[:, 118:122], np.r_[20:100, 140:220]
    # Noise as large as the image's cells differs next to any position as much as at the edge; regions do not.
    assert np.median(apart[edge]) > 8.0 * np.median(apart[:, within])
    assert np.median(beside[edge]) < 2.0 * np.median(beside[:, within])


def test_regions_run_together_where_nothing_parts_them() -> None:
    picture, between = two_regions()
    sides = Sides([picture], texture=0.0, k=0.24)
    edge = np.s_[:, 118:122]
    parted, open_ = (sides.of_regions(known, reach_px=40.0)[edge] for known in (between, np.zeros_like(between)))
    assert np.median(parted) > 3.0 * np.median(open_)
    between[60:100] = 0.0  # through a gap they run together next to it, and not far from it
    gap = sides.of_regions(between, reach_px=40.0)
    assert np.median(gap[70:90, 118:122]) < 0.6 * np.median(parted)
    assert np.median(gap[:20, 118:122]) > 0.9 * np.median(parted[:20])


def test_an_edge_between_regions_outweighs_one_that_runs_out_within_a_region() -> None:
    y, x = np.indices((240, 320)).astype(np.float64)
    fading = np.exp(-((x - 70) / 30) - ((y - 120) / 40) ** 2) * (x >= 70)  # a step at x = 70 that ends nowhere sharply
    picture = np.rint(100 + 30 * (x >= 200) + 30 * fading).astype(np.uint8)
    without, with_regions = (EdgeDetector(EdgeConfig(region_px=reach)).thinned(picture) for reach in (0.0, 40.0))
    between, within = np.s_[110:130, 197:203], np.s_[110:130, 67:73]
    assert without[within].max() > 0.5 * without[between].max(), "steps as high, seen from near by"

    def advantage(thinned: np.ndarray) -> float:
        return float(thinned[between].max() / thinned[within].max())

    assert advantage(with_regions) > 1.5 * advantage(without)


def test_an_unknown_pixel_hides_its_surroundings_alone() -> None:
    picture = np.full((120, 160), 60, np.float32)
    picture[20:70, 30:80] = 180
    known = EdgeDetector().detect(picture).labels
    picture[20, 50] = np.nan
    found = EdgeDetector().detect(picture).labels
    far = np.hypot(*(np.indices(picture.shape) - np.array([20, 50])[:, None, None])) > 20
    assert np.count_nonzero(known[far]) > 140
    for one, other in ((found, known), (known, found)):  # either of the two pixels next to the step may be the edge
        assert cv2.dilate(other, np.ones((3, 3), np.uint8))[far & (one == EDGE)].all()
