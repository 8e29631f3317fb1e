"""Edges on drawings whose edges are known exactly: where they lie, how they are linked, where they end."""

from __future__ import annotations

import doctest
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harris_perception.core.corners.harris import HarrisConfig, HarrisDetector
from harris_perception.core.corners.harris_laplace import HarrisLaplaceConfig, HarrisLaplaceDetector
from harris_perception.core.corners.repeatable import RepeatableDetector
from harris_perception.core.corners.taps import gaussian_taps
from harris_perception.core.edges import edge_kernels as kernels
from harris_perception.core.edges import edges as edges_module
from harris_perception.core.edges.combined_detector import CombinedDetector
from harris_perception.core.edges.edges import CORNER, EDGE, FLAT, EdgeConfig, EdgeDetector
from harris_perception.core.image.noise import noise_above


def halves(angle_deg: float, offset: float, size: int = 90) -> tuple[np.ndarray, np.ndarray]:
    """Return a soft step edge through the picture and each pixel's distance to it, for a line at this angle."""
    y, x = np.indices((size, size)).astype(np.float64)
    t = np.deg2rad(angle_deg)
    distance = (x - size / 2) * np.cos(t) + (y - size / 2) * np.sin(t) - offset
    return (100 + 80 * np.clip(distance, -0.5, 0.5)).astype(np.float32), distance


def closed(mask: np.ndarray) -> np.ndarray:
    """Return a mask (H, W) with its holes closed: pixels between four that are set."""
    sides = np.pad(mask, 1)
    return mask | (sides[:-2, 1:-1] & sides[2:, 1:-1] & sides[1:-1, :-2] & sides[1:-1, 2:])


@settings(max_examples=25, deadline=None)
@given(angle=st.floats(0, 180), offset=st.floats(-8, 8))
def test_straight_edge_is_one_chain_within_a_pixel(angle: float, offset: float) -> None:
    picture, distance = halves(angle, offset)
    found = EdgeDetector().detect(picture)
    inside = [c for c in found.chains if len(c) > 5]
    assert len(inside) == 1
    x, y = inside[0].T
    assert np.abs(distance[y, x]).max() < 1.0
    length = max(np.ptp(x), np.ptp(y)) + 1
    assert length >= 85 or length >= 0.9 * (np.abs(distance) < 0.5).any(axis=int(np.ptp(x) > np.ptp(y)) ^ 1).sum()


def test_strength_is_the_gradient_in_grey_levels_per_pixel() -> None:
    x = np.indices((60, 60))[1].astype(np.float32)
    soft = 100 + 40 * np.tanh((x - 30) / 8)  # slope 5 at x = 30, hardly changed by a blur of 2 px
    alone = EdgeConfig(coarse_sigma_px=0.0, region_px=0.0, surround=0.0)
    thinned = EdgeDetector(alone).thinned(soft.astype(np.float32))
    assert set(np.nonzero(thinned.max(axis=0) > 1)[0].tolist()) <= {29, 30, 31}
    assert thinned[30].max() == pytest.approx(5.0, rel=0.1)


@pytest.mark.parametrize("shape", [(40, 57), (3, 5), (1, 1)])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_structure_is_that_of_separate_filters(shape: tuple[int, int], dtype: type) -> None:
    picture = np.random.default_rng(5).integers(0, 256, shape).astype(dtype)
    taps = gaussian_taps(1.5)
    margin = 10
    padded = cv2.copyMakeBorder(picture.astype(np.float64), *(margin,) * 4, cv2.BORDER_REPLICATE)
    soft = cv2.sepFilter2D(padded, cv2.CV_64F, taps, taps)
    step, one, window = np.array([-0.5, 0.0, 0.5]), np.ones(1), np.array([0.25, 0.5, 0.25])
    gx, gy = cv2.sepFilter2D(soft, cv2.CV_64F, step, one), cv2.sepFilter2D(soft, cv2.CV_64F, one, step)
    inside = np.s_[margin:-margin, margin:-margin]
    expected = [3.0 * cv2.sepFilter2D(p, cv2.CV_64F, window, window)[inside] for p in (gx * gx, gy * gy, gx * gy)]
    found = [np.zeros(shape, np.float32) for _ in range(3)]
    for weight in (1.0, 2.0):  # two channels add up
        kernels.add_structure(picture, taps[len(taps) // 2 :].copy(), weight, *found)
    for ours, theirs in zip(found, expected):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-2)


def test_edge_between_colors_of_one_lightness_needs_the_colors() -> None:
    lab = np.full((60, 80, 3), 128, np.uint8)
    lab[:, 40:, 1] = 160
    picture = cv2.cvtColor(lab, cv2.COLOR_LAB2BGR)
    found = EdgeDetector().detect(picture)
    assert len(found.chains) == 1 and len(found.chains[0]) == 60
    assert np.abs(found.chains[0][:, 0] - 39.5).max() < 1.0
    assert EdgeDetector(EdgeConfig(color=0.0)).detect(picture).chains == []


def test_texture_counts_less_than_an_outline_of_the_same_contrast() -> None:
    picture = np.full((240, 400), 80, np.uint8)
    picture[60:180, 40:160] = 140  # outline of a lone square
    picture[:, 220:][np.indices((240, 180)).sum(axis=0) % 24 < 12] = 140  # stripes of the same contrast
    strength = EdgeDetector(EdgeConfig(surround_px=20.0)).thinned(picture)
    assert strength[100:140, 30:170].max() > 2.0 * strength[60:180, 280:380].max()


def test_textures_of_the_same_values_are_told_apart() -> None:
    y, x = np.indices((120, 160))
    picture = np.where(np.where(x < 80, x, y) % 4 < 2, 90, 130).astype(np.uint8)  # stripes down, stripes across
    strength, without = (EdgeDetector(EdgeConfig(surround=0.0, texture=t)).thinned(picture) for t in (1.4, 0.0))
    beside, apart = np.s_[20:100, 74:86], np.s_[20:100, 20:50]
    assert strength[beside].max() > 5.0 * strength[apart].max()
    assert strength[beside].max() > 5.0 * without[beside].max()


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    shape=st.tuples(st.integers(1, 9), st.integers(1, 40)),
    way=st.tuples(st.integers(-2, 2), st.integers(-2, 2)),
    most=st.integers(1, 255),
)
def test_bends_are_those_of_the_definition(seed: int, shape: tuple[int, int], way: tuple[int, int], most: int) -> None:
    framed = np.random.default_rng(seed).integers(0, 256, (shape[0] + 4, shape[1] + 4)).astype(np.uint8)
    found = kernels.bends(framed, 2, *way, most)
    assert found.shape == shape and found.dtype == np.uint8
    for (y, x), value in np.ndenumerate(found):
        before, after = framed[y + 2 - way[1], x + 2 - way[0]], framed[y + 2 + way[1], x + 2 + way[0]]
        bend = abs(int(before) + int(after) - 2 * int(framed[y + 2, x + 2]))
        assert value == min(bend, most) * (255 // most)


def square() -> np.ndarray:
    picture = np.full((100, 110), 60, np.uint8)
    picture[25:75, 30:80] = 180
    return picture


def test_square_becomes_sides_that_end_at_its_corners() -> None:
    picture = square()
    corners = HarrisDetector(HarrisConfig(gradient="gaussian", window="gaussian")).detect(picture)
    assert len(corners) == 4
    with_corners = EdgeDetector(EdgeConfig(max_gap_px=8.0)).detect(picture, corners.xy)
    rounded = {(int(x), int(y)) for x, y in np.rint(corners.xy)}
    assert {(int(x), int(y)) for y, x in np.argwhere(with_corners.labels == CORNER)} == rounded
    on_edge = {(int(x), int(y)) for c in with_corners.chains for x, y in c}
    assert rounded <= on_edge, "every corner lies on a chain"
    sides = np.zeros(picture.shape, np.uint8)
    cv2.rectangle(sides, (30, 25), (79, 74), 1)
    far = cv2.distanceTransform(1 - sides, cv2.DIST_L2, 5)
    assert max(far[y, x] for x, y in on_edge) <= 2.0
    reached = cv2.distanceTransform(np.where(with_corners.labels == FLAT, 1, 0).astype(np.uint8), cv2.DIST_L2, 5)
    assert (reached[sides > 0] <= 2.5).mean() > 0.97


@pytest.mark.parametrize("gap_px", [0.0, 6.0, 20.0, 50.0])
def test_lines_without_a_free_end_stay_whole_beside_corners(gap_px: float) -> None:
    picture = np.full((200, 300), 40, np.uint8)
    picture[100:] = 200
    beside = [(x, 70) for x in range(70, 250, 40)]
    found = EdgeDetector(EdgeConfig(max_gap_px=gap_px)).detect(picture, beside)
    assert [len(chain) for chain in found.chains] == [300]
    assert (found.labels[98:102] == EDGE).any(axis=0).all()


@pytest.mark.parametrize("seed", range(4))
def test_precision_and_recall_on_exact_drawings(seed: int) -> None:
    rng = np.random.default_rng(seed)
    factor, size = 8, 160
    big, truth = np.full((size * factor, size * factor), 90, np.uint8), np.zeros((size, size), np.uint8)
    for _ in range(4):
        centre, radius = rng.uniform(35, 125, 2), rng.uniform(14, 32)
        angles = np.sort(rng.uniform(0, 2 * np.pi, 5))
        points = centre + radius * np.column_stack((np.cos(angles), np.sin(angles)))
        cv2.fillPoly(big, [np.rint((points + 0.5) * factor).astype(np.int32)], int(rng.choice([20, 160, 230])))
    labels = big[factor // 2 :: factor, factor // 2 :: factor].astype(int)
    truth[:, 1:] |= (np.diff(labels, axis=1) != 0).astype(np.uint8)
    truth[1:, :] |= (np.diff(labels, axis=0) != 0).astype(np.uint8)
    picture = big.reshape(size, factor, size, factor).mean(axis=(1, 3)) + rng.normal(0, 3, (size, size))
    found = EdgeDetector().detect(np.clip(picture, 0, 255).astype(np.uint8))
    edge = found.labels == EDGE
    to_truth = cv2.distanceTransform(1 - truth, cv2.DIST_L2, 5)
    to_found = cv2.distanceTransform(1 - edge.astype(np.uint8), cv2.DIST_L2, 5)
    print(f"seed {seed}")
    assert (to_truth[edge] <= 2.5).mean() > 0.95
    assert (to_found[truth > 0] <= 3.0).mean() > 0.8


def test_hysteresis_keeps_weak_pixels_only_with_a_strong_one_and_drops_small_pieces() -> None:
    thinned = np.zeros((20, 60), np.float32)
    thinned[5, 5:35] = 3.0
    thinned[5, 20] = 9.0  # strong seed: the whole weak line stays
    thinned[10, 5:35] = 3.0  # weak line without a seed
    thinned[15, 5:12] = 9.0  # strong, but short
    thinned[5, 40:58] = 1.0  # below the low threshold
    expected = np.zeros(thinned.shape, bool)
    expected[5, 5:35] = True

    def kept(weight_px: float) -> np.ndarray:
        config = EdgeConfig(high=8.0, low_of_high=0.25, min_length_px=20, min_weight_px=weight_px, max_spur_px=0)
        return EdgeDetector(config).edges_of(thinned).labels == EDGE

    np.testing.assert_array_equal(kept(10.0), expected)
    # The sum of the piece is 29 * 3 + 9 = 96.
    assert kept(12.0).any()
    assert not kept(12.1).any()


@pytest.mark.parametrize("end", [(100, 20), (100, 0), (100, 40), (64, 0), (65, 40), (63, 0)])
@pytest.mark.parametrize("backwards", [False, True])
def test_one_strong_pixel_keeps_a_weak_line_of_any_direction_whole(end: tuple[int, int], backwards: bool) -> None:
    points = np.linspace((28, 20), end, end[0] - 27).round().astype(int)
    thinned = np.zeros((41, 130), np.float32)
    thinned[points[:, 1], points[:, 0]] = 3.0
    x, y = points[0 if backwards else -1]
    thinned[y, x] = 9.0
    config = EdgeConfig(high=8.0, low_of_high=0.25, min_length_px=len(points), min_weight_px=0.0, max_spur_px=0)
    np.testing.assert_array_equal(EdgeDetector(config).edges_of(thinned).labels == EDGE, thinned > 0)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    density=st.floats(0.02, 0.7),
    length=st.integers(1, 12),
    height=st.integers(1, 30),
    width=st.integers(1, 210),
)
def test_pieces_are_kept_as_connected_components_tell(
    seed: int, density: float, length: int, height: int, width: int
) -> None:
    rng = np.random.default_rng(seed)
    strength = np.where(rng.random((height, width)) < density, rng.uniform(2, 9, (height, width)), 0.0)
    thinned, weight_px = strength.astype(np.float32), float(rng.choice([0.0, rng.uniform(1.0, 6.0)]))
    _, pieces = cv2.connectedComponents((thinned > 0).astype(np.uint8), connectivity=8)
    sizes, sums = np.bincount(pieces.ravel()), np.bincount(pieces.ravel(), thinned.ravel())
    strong = np.isin(np.arange(len(sizes)), pieces[thinned >= 8.0])
    wanted = strong & (sizes >= length) & (sums >= 8.0 * weight_px) & (np.arange(len(sizes)) > 0)

    config = EdgeConfig(high=8.0, low_of_high=0.25, min_length_px=length, min_weight_px=weight_px, max_spur_px=0)
    labels = EdgeDetector(config).edges_of(thinned).labels
    np.testing.assert_array_equal(np.unique(pieces[(labels == EDGE) & (thinned > 0)]), np.flatnonzero(wanted))
    assert (labels == EDGE)[~closed(wanted[pieces])].sum() == 0


@settings(max_examples=60, deadline=None)
@given(
    start=st.integers(60, 90),
    row=st.integers(0, 59),
    x=st.integers(0, 149),
    y=st.integers(0, 59),
    gap=st.floats(3.0, 50.0),
)
def test_free_ends_within_the_gap_are_led_to_the_corner(start: int, row: int, x: int, y: int, gap: float) -> None:
    thinned = np.zeros((60, 150), np.float32)
    thinned[row, start : start + 30] = 9.0
    config = EdgeConfig(high=2.0, min_length_px=1, min_weight_px=0.0, max_spur_px=0, max_gap_px=gap)
    found = EdgeDetector(config).edges_of(thinned, [(x, y)])
    left = np.array([at for at in range(start, start + 30) if np.hypot(at - x, row - y) > min(0.75 * gap, 6.0)])
    ends = [at for at in left if np.hypot(at - x, row - y) <= gap and not {at - 1, at + 1} <= set(left.tolist())]
    _, pieces = cv2.connectedComponents((found.labels != FLAT).astype(np.uint8), connectivity=8)
    assert (found.labels[row, left] != FLAT).all()
    assert [bool(pieces[row, at] == pieces[y, x]) for at in ends] == [True] * len(ends)
    assert ends or (found.labels == EDGE).sum() == len(left) - ((y == row) & (left == x)).sum(), "nothing is drawn"


def test_spur_is_removed_and_the_branch_of_a_t_stays() -> None:
    mask = np.zeros((50, 60), np.float32)
    mask[20, 5:55] = 10.0
    mask[21:24, 15] = 9.0  # spur of three
    mask[21:45, 40] = 9.0  # branch of 24
    found = EdgeDetector(EdgeConfig(max_spur_px=5)).edges_of(mask)
    assert not found.labels[22:24, 15].any() and found.labels[22:45, 40].all()
    assert found.labels[20:22, 5:55].any(axis=0).all()  # the line, which may dip by a pixel where branches leave it
    assert len(found.chains) == 3 and sum(len(c) for c in found.chains) >= 49 + 23


def test_closed_line_is_one_chain_that_ends_where_it_starts() -> None:
    mask = np.zeros((60, 60), np.uint8)
    cv2.circle(mask, (30, 30), 18, 1)
    found = EdgeDetector().edges_of(mask.astype(np.float32) * 10)
    assert len(found.chains) == 1
    np.testing.assert_array_equal(found.chains[0][0], found.chains[0][-1])
    assert len(found.chains[0]) - 1 == (found.labels == EDGE).sum()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), density=st.floats(0.02, 0.6), height=st.integers(1, 25), width=st.integers(1, 150))
def test_chains_hold_every_edge_pixel_in_steps_of_one(seed: int, density: float, height: int, width: int) -> None:
    rng = np.random.default_rng(seed)
    thinned = np.where(rng.random((height, width)) < density, rng.uniform(1, 9, (height, width)), 0.0).astype(
        np.float32
    )
    corners = np.column_stack((rng.integers(0, width, 3), rng.integers(0, height, 3)))
    config = EdgeConfig(high=2.0, min_length_px=1, max_spur_px=int(rng.integers(0, 4)))
    found = EdgeDetector(config).edges_of(thinned, corners)
    covered = np.zeros((height, width), bool)
    for chain in found.chains:
        assert len(chain) == 1 or (np.abs(np.diff(chain, axis=0)).max(axis=1) == 1).all()
        covered[chain[:, 1], chain[:, 0]] = True
    assert (covered[found.labels == EDGE]).all()
    assert (found.labels[covered] != FLAT).all()
    assert {(int(x), int(y)) for x, y in corners} == {(int(x), int(y)) for y, x in np.argwhere(found.labels == CORNER)}


Place = tuple[int, int]


def around(place: Place, lines: set[Place]) -> set[Place]:
    x, y = place
    return lines & {(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} - {place}


def ways_on(place: Place, lines: set[Place]) -> int:
    """Return in how many ways a line goes on; a diagonal step between pixels that share a side's neighbour is none."""
    x, y = place
    sides = {(x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)} & lines
    direct = [(x + i, y + j) for i in (-1, 1) for j in (-1, 1) if not {(x + i, y), (x, y + j)} & lines]
    return len(sides) + len(lines.intersection(direct))


def piece_of(place: Place, lines: set[Place]) -> set[Place]:
    """Return the pixels that are connected with one, as long as they are five or fewer."""
    piece = {place}
    for _ in range(5):
        piece = piece.union(*(around(each, lines) for each in piece)) if len(piece) <= 5 else piece
    return piece


def ways_to_corners(lines: set[Place], corners: np.ndarray, gap: float) -> dict[Place, list[np.ndarray]]:
    """Return the straight ways (N, 2) from each free end to the nearest corner, of a pixel alone to the two nearest.

    The rest of a line that passed by a corner is taken from ``lines``: two to four that both start and end there.
    """
    found: dict[Place, list[np.ndarray]] = {}
    for end in sorted(lines):
        beside = around(end, lines)
        away = np.hypot(*(corners - end).T)
        within = [i for i in np.argsort(away, kind="stable") if away[i] <= gap][: 1 if beside else 2]
        ways = [np.linspace(end, corners[i], np.abs(corners[i] - end).max() + 1) for i in within]
        back = [way for way in ways if tuple((end + np.rint(way[1] - end)).tolist()) in beside]
        if len(beside) <= 1 and ways and not back:
            found[end] = ways
    for end in list(found):
        piece = piece_of(end, lines)
        ends = [each for each in piece if each in found]
        targets = {tuple(way[-1].tolist()) for each in ends for way in found[each]}
        one_way = [each for each in piece if ways_on(each, lines) != 2] == ends
        if len(targets) == 1 and len(ends) == 2 and one_way and len(piece) <= min(int(gap), 4):
            lines -= piece
    return {end: ways for end, ways in found.items() if end in lines}


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 100_000), density=st.floats(0.02, 0.4), gap=st.one_of(st.just(0.0), st.floats(0.0, 12.0)))
def test_chains_end_where_lines_end_branch_or_reach_a_corner(seed: int, density: float, gap: float) -> None:
    rng = np.random.default_rng(seed)
    thinned = np.where(rng.random((20, 140)) < density, 9.0, 0.0).astype(np.float32)
    corners = np.unique(np.column_stack((rng.integers(0, 140, 8), rng.integers(0, 20, 8))), axis=0)
    config = EdgeConfig(
        high=2.0, min_length_px=2, min_weight_px=0.0, max_spur_px=int(rng.integers(0, 4)), max_gap_px=gap
    )
    y, x = np.nonzero(EdgeDetector(config).edges_of(thinned).labels == EDGE)
    away = np.hypot(x[:, None] - corners[:, 0], y[:, None] - corners[:, 1]).min(axis=1)
    left = away > min(0.75 * gap, 6.0) if gap > 0.0 else away >= 0.0
    lines: set[Place] = {(int(a), int(b)) for a, b in zip(x[left], y[left], strict=True)}
    led = ways_to_corners(lines, corners, gap) if gap > 0.0 else {}
    at_corners = {tuple(place) for place in corners.tolist()}

    def ways_out(chain: list[Place]) -> list[int]:
        """Return how many steps the last part of a chain may have that goes from a free end to its corner."""
        ways = [way for end in led.keys() & set(chain) for way in led[end] if len(way) <= len(chain)]
        return [len(way) - 1 for way in ways if np.abs(chain[-len(way) :] - way).max() <= 0.5] + [0]

    steps: list[frozenset[Place]] = []
    done: list[Place] = []
    for whole in EdgeDetector(config).edges_of(thinned, corners).chains:
        chain: list[Place] = [(int(a), int(b)) for a, b in whole]
        parts = [chain[i : len(chain) - j] for i in ways_out(chain[::-1]) for j in ways_out(chain)]
        inner = max((part for part in parts if part and lines.issuperset(part)), key=len)
        done += [inner[0]] * (inner[0] != chain[0]) + [inner[-1]] * (inner[-1] != chain[-1])
        for place in inner[1:-1]:
            assert ways_on(place, lines) == 2 and place not in at_corners, place
        steps += [frozenset(pair) for pair in pairwise(inner)]
    assert sorted(done) == sorted(end for end, ways in led.items() for _ in ways), "each is led to its corner"
    assert len(set(steps)) == len(steps), "each step in one chain"
    assert 2 * len(steps) == sum(ways_on(place, lines) for place in lines), (
        "and none left out, also between two corners"
    )


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), density=st.floats(0.1, 0.8))
def test_skeleton_keeps_the_pieces_together(seed: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random((20, 140)) < density
    before = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[0]
    config = EdgeConfig(high=0.1, min_length_px=1, min_weight_px=0.0, max_spur_px=0)
    thin = EdgeDetector(config).edges_of(mask.astype(np.float32)).labels == EDGE
    assert (thin <= closed(mask)).all()
    assert cv2.connectedComponents(thin.astype(np.uint8), connectivity=8)[0] == before


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 100_000), density=st.floats(0.1, 0.8))
def test_no_pixel_is_left_without_which_its_neighbours_stay_together(seed: int, density: float) -> None:
    thinned = np.where(np.random.default_rng(seed).random((20, 140)) < density, 9.0, 0.0).astype(np.float32)
    config = EdgeConfig(high=2.0, min_length_px=1, min_weight_px=0.0, max_spur_px=0)
    lines = {(int(x), int(y)) for y, x in np.argwhere(EdgeDetector(config).edges_of(thinned).labels == EDGE)}
    for x, y in lines:
        if {(x + 1, y), (x, y + 1), (x - 1, y), (x, y - 1)} <= lines:
            continue  # it would leave a hole
        around = lines & {(x + i, y + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} - {(x, y)}
        piece = set(sorted(around)[:1])
        for _ in range(8):
            piece |= {(a, b) for a, b in around for c, d in piece if max(abs(a - c), abs(b - d)) == 1}
        assert len(around) < 2 or piece != around, (x, y)


@pytest.mark.parametrize("turned_deg", [0, 3, 45, 80, 87, 90])
@pytest.mark.parametrize("noise", [1.0, 3.0])
def test_a_straight_edge_under_noise_is_one_chain(turned_deg: int, noise: float) -> None:
    y, x = np.indices((200, 200))
    away = (x - 99.5) * np.cos(np.deg2rad(turned_deg)) + (y - 99.5) * np.sin(np.deg2rad(turned_deg))
    for seed in range(10):
        level = 80 + 100 * np.clip(away, -0.5, 0.5) + np.random.default_rng(seed).normal(0.0, noise, away.shape)
        edges = CombinedDetector().detect(np.rint(np.clip(level, 0, 255)).astype(np.uint8))[1]
        at_edge = [len(chain) for chain in edges.chains if np.abs(away[chain[:, 1], chain[:, 0]]).max() < 4]
        assert len(at_edge) == 1 and at_edge[0] > 180, f"seed {seed}: {at_edge}"


@pytest.mark.parametrize("turned_deg", [0, 20, 45, 90, 135])
@pytest.mark.parametrize("shift", [0.0, 0.2, 0.5])
def test_a_line_of_two_pixels_width_is_one_chain_or_its_two_sides(turned_deg: int, shift: float) -> None:
    y, x = np.indices((100, 100))
    away = (x - 50.3 - shift) * np.cos(np.deg2rad(turned_deg)) + (y - 50.2) * np.sin(np.deg2rad(turned_deg))
    line = (60 + 120 * np.clip(1.5 - np.abs(away), 0.0, 1.0)).astype(np.uint8)
    edges = CombinedDetector().detect(line)[1]
    assert len(edges.chains) <= 2 and min(len(chain) for chain in edges.chains) > 85
    assert np.abs(away[edges.points[:, 1], edges.points[:, 0]]).max() < 1.5


@pytest.mark.parametrize("kind", ["stairs", "ribbon of 2 px", "ribbon of 3 px", "slanting ribbon"])
@pytest.mark.parametrize("mirror", [np.s_[:, :], np.s_[::-1], np.s_[:, ::-1], np.s_[::-1, ::-1]])
@pytest.mark.parametrize("upright", [False, True])
def test_lines_wider_than_a_pixel_keep_their_length(kind: str, mirror: tuple[slice, ...], upright: bool) -> None:
    mask, step = np.zeros((60, 100), np.uint8), np.arange(30)
    if kind == "stairs":
        mask[10 + step, 20 + step] = mask[10 + step, 21 + step] = 1
    elif kind == "slanting ribbon":
        cv2.line(mask, (10, 10), (41, 25), 1, 2)
    else:
        mask[10 : 10 + int(kind[10]), 20:51] = 1
    drawn = (mask.T if upright else mask)[mirror]
    config = EdgeConfig(high=2.0, min_length_px=1, min_weight_px=0.0, max_spur_px=3, max_gap_px=0.0)
    found = EdgeDetector(config).edges_of(np.ascontiguousarray(drawn, np.float32) * 9)
    assert len(found.chains) == 1
    assert np.ptp(found.points, axis=0).max() >= 29
    assert cv2.distanceTransform((found.labels == FLAT).astype(np.uint8), cv2.DIST_L2, 5)[drawn > 0].max() <= 2.0


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (2, 40), (30, 30)])
@pytest.mark.parametrize("value", [0.0, 77.0, np.nan, np.inf])
def test_pictures_without_edges(shape: tuple[int, int], value: float) -> None:
    found = EdgeDetector().detect(np.full(shape, value, np.float32))
    assert found.labels.shape == shape and not found.labels.any() and found.chains == []


@pytest.mark.parametrize("dtype", [np.float64, np.int32, np.bool_, np.complex64])
def test_types_that_are_not_meant_are_refused(dtype: type) -> None:
    with pytest.raises(ValueError, match=f"expected uint8, uint16 or float32, got {np.dtype(dtype)}"):
        EdgeDetector().detect(np.zeros((9, 9), dtype))


def naive_edge_pixels(picture: np.ndarray, least: float, border: int, k: float = 0.04) -> dict[tuple[int, int], float]:
    """Return the pixels of the paper's definition, written pixel by pixel, with their strengths."""
    height, width = picture.shape
    p = picture.astype(np.float64)
    gx, gy, response = (np.zeros(picture.shape) for _ in range(3))
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            gx[y, x] = (p[y - 1 : y + 2, x + 1] - p[y - 1 : y + 2, x - 1]).sum()
            gy[y, x] = (p[y + 1, x - 1 : x + 2] - p[y - 1, x - 1 : x + 2]).sum()
    for y in range(2, height - 2):
        for x in range(2, width - 2):
            here = np.s_[y - 1 : y + 2, x - 1 : x + 2]
            a, b, c = (gx[here] ** 2).sum(), (gy[here] ** 2).sum(), (gx[here] * gy[here]).sum()
            response[y, x] = a * b - c * c - k * (a + b) ** 2
    found = {}
    for y in range(border, height - border):
        for x in range(border, width - border):
            r = response[y, x]
            along_x = abs(gx[y, x]) >= abs(gy[y, x])
            before, after = (response[y, x - 1], response[y, x + 1]) if along_x else response[[y - 1, y + 1], x]
            strength = (max(-r, 0.0) / k) ** 0.25 / 18.0  # kernels and window of ones answer to a slope of one by 18
            if r < before and r <= after and strength >= least:
                found[x, y] = strength
    return found


def places_of(bits: np.ndarray, picture: np.ndarray) -> list[set[tuple[int, int]]]:
    """Return x, y of the set pixels of each bitmap, whose pixel 0, 0 is the first bit of the byte 1, 8."""
    height, width = picture.shape
    assert bits.shape[:2] == (2, height + 3)
    single = np.unpackbits(bits, axis=2, bitorder="little")
    inside = single[:, 1 : 1 + height, 64 : 64 + width]
    assert inside.sum() == single.sum(), "nothing is set outside the picture"
    return [{(int(x), int(y)) for y, x in np.argwhere(each)} for each in inside]


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 100_000),
    height=st.integers(1, 30),
    width=st.integers(1, 60),
    least=st.floats(1.0, 30.0),
    border=st.integers(3, 12),
    bands=st.integers(1, 3),
)
def test_edge_pixels_of_the_corners_pass_are_those_of_the_definition(
    seed: int, height: int, width: int, least: float, border: int, bands: int
) -> None:
    rng = np.random.default_rng(seed)
    picture = cv2.blur(rng.integers(0, 256, (height, width)).astype(np.uint8), (3, 3))
    detector = HarrisDetector(HarrisConfig(border_px=border), bands=bands)
    high = 1.7 * least
    corners, bits = detector.detect_with_edges(picture, least, high)
    expected = naive_edge_pixels(picture, 0.99 * least, 3)  # the border is for corners
    for places, limit in zip(places_of(bits, picture), (least, high), strict=True):
        # Float32 may fall on the other side of a threshold.
        assert places >= {place for place, value in expected.items() if value > 1.001 * limit}
        assert places <= {place for place, value in expected.items() if value > 0.999 * limit}
    np.testing.assert_array_equal(corners.xy, detector.detect(picture).xy)


def test_wide_pictures_have_the_same_edge_pixels_as_their_transposes() -> None:
    rng = np.random.default_rng(7)
    picture = cv2.GaussianBlur(rng.integers(0, 256, (60, 1300)).astype(np.float32), (0, 0), 2.0) * 3
    places = []
    for p in (picture, np.ascontiguousarray(picture.T)):
        places.append(places_of(HarrisDetector().detect_with_edges(p, 2.0, 20.0)[1], p))
    for wide, high, least in zip(*places, (1000, 500), strict=True):
        assert len(wide) > least
        assert len({(y, x) for x, y in wide} ^ high) <= 0.01 * len(wide)  # ties of the two axes


@pytest.mark.parametrize("config", [HarrisConfig(), HarrisConfig(gradient="gaussian", window="gaussian")])
def test_combined_detector_finds_the_square_with_either_kernels(config: HarrisConfig) -> None:
    picture = square()
    corners, edges = CombinedDetector(config).detect(picture)
    np.testing.assert_array_equal(corners.xy, HarrisDetector(config).detect(picture).xy)
    assert len(corners) == 4 and (edges.labels == CORNER).sum() == 4
    sides = np.zeros(picture.shape, np.uint8)
    cv2.rectangle(sides, (30, 25), (79, 74), 1)
    far = cv2.distanceTransform(1 - sides, cv2.DIST_L2, 5)
    assert max(far[y, x] for chain in edges.chains for x, y in chain) <= 2.0
    reached = cv2.distanceTransform(np.where(edges.labels == FLAT, 1, 0).astype(np.uint8), cv2.DIST_L2, 5)
    assert (reached[sides > 0] <= 2.5).mean() > 0.97
    at = {tuple(place) for place in np.rint(corners.xy).astype(int).tolist()}
    assert [{tuple(c[0].tolist()), tuple(c[-1].tolist())} <= at for c in edges.chains] == [True] * 4, "four sides"


def test_corners_of_noise_cut_no_edges() -> None:
    rng = np.random.default_rng(6)
    disc = np.zeros((480, 480), np.uint8)
    cv2.circle(disc, (240, 240), 160, 120, -1)
    picture = cv2.resize(disc, (120, 120), interpolation=cv2.INTER_AREA) + rng.normal(60, 2, (120, 120))
    corners, edges = CombinedDetector().detect(np.rint(picture).astype(np.uint8))
    assert len(corners) > 300, "a disc has no corner, so the strongest is noise"
    assert [len(chain) > 200 and (chain[0] == chain[-1]).all() for chain in edges.chains] == [True]
    assert np.abs(np.hypot(*(edges.points - 59.6).T) - 40.0).max() < 1.5
    x, y = np.rint(corners.xy).astype(int).T
    assert (edges.labels[y, x] == CORNER).all()
    strengths = HarrisDetector().strengths_of(corners.response)
    outlines = EdgeDetector().detect(np.rint(picture).astype(np.uint8), corners.xy, strengths)
    near = np.abs(np.hypot(*(np.unique(outlines.points, axis=0) - 59.6).T) - 40.0) < 1.5
    assert near.sum() > 210, "of 226; a corner of noise or two may be as strong"
    assert len(EdgeDetector().detect(np.rint(picture).astype(np.uint8), corners.xy).points) < 100
    assert (outlines.labels[y, x] == CORNER).all()


@pytest.mark.parametrize("noise", [3.0, 5.0, 8.0])
@pytest.mark.parametrize("color", [False, True])
def test_strong_noise_cuts_no_edges_that_stand_out_from_it(noise: float, color: bool) -> None:
    rng = np.random.default_rng(6)
    disc = np.zeros((480, 480), np.uint8)
    cv2.circle(disc, (240, 240), 160, 160, -1)
    clean = cv2.resize(disc, (160, 160), interpolation=cv2.INTER_AREA)
    picture = np.rint(clean + rng.normal(50, noise, (160, 160))).clip(0, 255).astype(np.uint8)
    corners = HarrisDetector().detect(picture)
    strengths = HarrisDetector().strengths_of(corners.response)
    seen = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR) if color else picture
    for found in (
        CombinedDetector().detect(picture)[1],
        CombinedDetector().detect(picture, corners.xy, strengths)[1],
        EdgeDetector().detect(seen, corners.xy, strengths),
    ):
        near = np.abs(np.hypot(*(np.unique(found.points, axis=0) - 79.67).T) - 53.5) < 1.8
        assert near.sum() > 280, "of 302"
        assert near.mean() > 0.95
        assert len(found.chains) < 4, "a corner of noise or two may be as strong"


EVERY_LEVEL = HarrisLaplaceConfig(detector=HarrisConfig(relative_threshold=0.0), levels=3, select=False)


@pytest.mark.parametrize("detector", [HarrisLaplaceDetector(EVERY_LEVEL), RepeatableDetector()])
def test_corners_of_noise_by_other_detectors_cut_no_edges(
    detector: HarrisLaplaceDetector | RepeatableDetector,
) -> None:
    rng = np.random.default_rng(6)
    disc = np.zeros((480, 480), np.uint8)
    cv2.circle(disc, (240, 240), 160, 120, -1)
    noisy = cv2.resize(disc, (120, 120), interpolation=cv2.INTER_AREA) + rng.normal(60, 2, (120, 120))
    picture = np.rint(noisy).astype(np.uint8)
    corners = detector.detect(picture)
    strengths = detector.strengths_of(corners.response)
    assert len(corners) > 100
    for found, cut in (
        (CombinedDetector().detect(picture, corners.xy, *told)[1] for told in ((strengths,), ())),
        (EdgeDetector().detect(picture, corners.xy, *told) for told in ((strengths,), ())),
    ):
        near = [np.abs(np.hypot(*(np.unique(e.points, axis=0) - 59.6).T) - 40.0) < 1.5 for e in (found, cut)]
        print([each.sum() for each in near])
        assert near[0].sum() > 210 > 2 * near[1].sum(), "of 226"
        x, y = np.rint(corners.xy).astype(int).T
        assert (found.labels[y, x] == CORNER).all()


def test_outlines_of_16_bits_are_those_of_8_in_their_grey_levels() -> None:
    rng = np.random.default_rng(8)
    picture = cv2.GaussianBlur(
        np.where(np.indices((120, 160)).sum(axis=0) // 30 % 2, 150, 60).astype(np.uint8), (0, 0), 1
    )
    picture += rng.integers(0, 6, picture.shape).astype(np.uint8)
    corners = HarrisDetector().detect(picture)
    strengths = HarrisDetector().strengths_of(corners.response)
    one = EdgeDetector().detect(picture, corners.xy, strengths)
    deep = picture.astype(np.uint16) * 257
    other = EdgeDetector().detect(deep, corners.xy, strengths * np.float32(257.0), grey_level=257.0)
    assert len(one.chains) == len(other.chains) > 3
    assert (one.labels != other.labels).sum() < 0.03 * (one.labels == EDGE).sum()
    np.testing.assert_allclose(EdgeDetector().thinned(deep, 257.0), EdgeDetector().thinned(deep) / 257.0, rtol=1e-6)


@pytest.mark.parametrize("doublings", [-100, -40, 40, 100])
@pytest.mark.parametrize("config", [HarrisConfig(), HarrisConfig(gradient="gaussian", window="gaussian")])
def test_combined_edges_do_not_depend_on_the_unit_of_the_grey_levels(doublings: int, config: HarrisConfig) -> None:
    picture = np.where(np.indices((120, 160)).sum(axis=0) // 30 % 2, 150, 60).astype(np.float32)
    picture[40:80, 50:110] = 240
    picture += np.random.default_rng(8).integers(0, 6, picture.shape)
    _, one = CombinedDetector(config).detect(picture)
    _, other = CombinedDetector(config).detect(np.ldexp(picture, doublings), grey_level=2.0**doublings)
    assert len(one.chains) > 8 and (one.labels == CORNER).sum() > 4
    np.testing.assert_array_equal(other.labels, one.labels)
    np.testing.assert_array_equal(other.points, one.points)


@pytest.mark.parametrize("doublings", [-100, -40, -20, -16, 16, 30, 100])
def test_outlines_do_not_depend_on_the_unit_of_the_grey_levels(doublings: int) -> None:
    picture = np.where(np.indices((120, 160)).sum(axis=0) // 30 % 2, 150, 60).astype(np.float32)
    picture[40:80, 50:110] = 240
    picture += np.random.default_rng(8).normal(0.0, 4.0, picture.shape).astype(np.float32)
    detector, unit = HarrisDetector(), 2.0**doublings
    corners = detector.detect(picture)
    strengths = detector.strengths_of(corners.response)
    one = EdgeDetector().detect(picture, corners.xy, strengths)
    other = EdgeDetector().detect(np.ldexp(picture, doublings), corners.xy, strengths * np.float32(unit), unit)
    assert len(one.chains) > 8 and (one.labels == EDGE).sum() > 500
    np.testing.assert_array_equal(other.labels, one.labels)
    np.testing.assert_array_equal(other.points, one.points)


def test_noise_is_told_in_any_unit() -> None:
    picture = (100.0 + np.random.default_rng(3).normal(0.0, 4.0, (200, 300))).astype(np.float32)
    assert noise_above(picture, 1.0) == pytest.approx(4.0, rel=0.15)
    assert noise_above(np.ldexp(picture, -30), 2.0**-30) == pytest.approx(2.0**-30 * noise_above(picture, 1.0))


@pytest.mark.parametrize("lowest", [10.0, 1010.0, 10_010.0])
def test_unknown_pixels_change_no_outlines_elsewhere_however_far_from_zero_the_values_lie(lowest: float) -> None:
    rng = np.random.default_rng(9)
    picture = np.full((160, 200), lowest, np.float32)
    for y, x, height, width, value in rng.integers((30, 30, 20, 20, 20), (110, 150, 60, 60, 244), (12, 5)):
        picture[y : y + height, x : x + width] = lowest + value
    picture += rng.normal(0.0, 2.0, picture.shape).astype(np.float32)
    dark, unknown = picture.copy(), picture.copy()
    dark[:12, :12], unknown[:12, :12] = picture.min(), np.nan
    expected, found = (EdgeDetector().detect(p).labels[25:, 25:] == EDGE for p in (dark, unknown))
    assert expected.sum() > 600 and (expected != found).sum() < 0.01 * expected.sum()


@pytest.mark.parametrize("response", ["harris", "shi_tomasi", "noble", "geometric"])
@pytest.mark.parametrize("gradient", ["sobel", "gaussian"])
def test_strengths_of_corners_are_in_grey_levels_per_pixel(response: str, gradient: str) -> None:
    detector = HarrisDetector(HarrisConfig(response=response, gradient=gradient))
    strengths = [
        float(detector.strengths_of(detector.detect(gain * square().astype(np.float32)).response).mean())
        for gain in (1.0, 3.0)
    ]
    assert strengths[1] == pytest.approx(3.0 * strengths[0], rel=1e-4)
    step = float(np.ptp(square()))
    assert 0.1 * step < strengths[0] < 0.7 * step, "as steep as a step is seen by these kernels"


@pytest.mark.parametrize("gradient", ["harris", "gaussian"])
def test_border_without_corners_has_edges(gradient: str) -> None:
    picture = square()
    corners, edges = CombinedDetector(HarrisConfig(gradient=gradient, border_px=35)).detect(picture)
    assert len(corners) == 0
    assert (edges.labels[30:70, 28:32] == EDGE).any(axis=1).all()


@pytest.mark.parametrize(
    ("kind", "lines"), [("T", 3), ("Y", 3), ("X", 4), ("45 degrees", 2), ("60 degrees", 2), ("twice 60 degrees", 3)]
)
@pytest.mark.parametrize("angle_deg", [0.0, 17.0, 40.0, 77.0])
def test_lines_meet_in_the_corner_of_a_junction(kind: str, lines: int, angle_deg: float) -> None:
    y, x = np.indices((640, 640)) - 323.0
    around = np.rad2deg(np.arctan2(y, x)) - angle_deg
    limits, greys = {
        "T": ((90, 180), (40, 120, 200)),
        "Y": ((120, 240), (40, 120, 220)),
        "X": ((90, 180, 270), (40, 200, 40, 200)),
        "45 degrees": ((45,), (180, 60)),
        "60 degrees": ((60,), (180, 60)),
        "twice 60 degrees": ((60, 120), (40, 120, 220)),
    }[kind]
    big = np.array(greys, np.uint8)[np.digitize(around % 360.0, limits)]
    detector = CombinedDetector(HarrisConfig(suppression_radius_px=3.0))
    corners, edges = detector.detect(cv2.resize(big, (80, 80), interpolation=cv2.INTER_AREA))
    assert len(corners) == 1
    centre = np.rint(corners.xy[0])
    assert len(edges.chains) == lines and min(len(chain) for chain in edges.chains) > 30
    assert [bool((chain[[0, -1]] == centre).all(axis=1).any()) for chain in edges.chains] == [True] * lines


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (1, 1), (2, 40), (6, 7), (30, 30)])
@pytest.mark.parametrize("value", [0.0, 77.0, np.nan, np.inf])
@pytest.mark.parametrize("gradient", ["harris", "gaussian"])
def test_combined_detector_on_pictures_without_edges(shape: tuple[int, int], value: float, gradient: str) -> None:
    corners, found = CombinedDetector(HarrisConfig(gradient=gradient)).detect(np.full(shape, value, np.float32))
    assert len(corners) == 0 and found.labels.shape == shape and not found.labels.any() and found.chains == []


def test_combined_detector_refuses_responses_that_know_no_edges() -> None:
    with pytest.raises(ValueError, match="'noble'"):
        CombinedDetector(HarrisConfig(response="noble")).detect(np.zeros((30, 30), np.uint8))


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match=r"\(5, 5, 2\)"):
        EdgeDetector().detect(np.zeros((5, 5, 2), np.uint8))
    with pytest.raises(ValueError, match=r"\(5, 5, 3\)"):
        EdgeDetector().detect(np.zeros((5, 5, 3), np.float32))
    with pytest.raises(ValueError, match="outside the image of 30 x 20"):
        EdgeDetector().detect(np.zeros((20, 30), np.uint8), [(30.0, 4.0)])


def test_examples_in_docstrings_run() -> None:
    result = doctest.testmod(edges_module)
    assert result.attempted > 0 and result.failed == 0
