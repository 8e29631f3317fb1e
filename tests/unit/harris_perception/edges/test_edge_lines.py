"""Edges as few straight pieces: near to the chains, few, the longest first."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from harris_perception.core.edges.edge_lines import edge_lines
from harris_perception.core.edges.edges import EdgeDetector, Edges

SIZE = (240, 320)


def drawn() -> Edges:
    picture = np.full((*SIZE, 3), 60, np.uint8)
    cv2.rectangle(picture, (40, 30), (200, 150), (220, 220, 220), -1)
    cv2.circle(picture, (260, 180), 30, (200, 200, 40), -1)
    return EdgeDetector().detect(picture)


def lines_of(rows: np.ndarray) -> list[np.ndarray]:
    return [rows[rows[:, 2] == number, :2] for number in np.unique(rows[:, 2])]


@pytest.mark.parametrize("tolerance_px", [0.5, 1.0, 3.0])
def test_no_pixel_of_a_chain_is_far_from_its_line(tolerance_px: float) -> None:
    edges = drawn()
    rows = edge_lines(edges, tolerance_px)
    assert rows.dtype == np.float32
    far = np.full(SIZE, 255, np.uint8)
    for line in lines_of(rows):
        cv2.polylines(far, [line.astype(np.int32)], False, 0)
    distance = cv2.distanceTransform(far, cv2.DIST_L2, 5)
    chains = [chain for chain in edges.chains if len(chain) >= 12]
    assert len(chains) == len(lines_of(rows))
    assert max(distance[chain[:, 1], chain[:, 0]].max() for chain in chains) <= tolerance_px + 0.8  # pixels are drawn
    assert len(rows) < 0.2 * sum(map(len, chains))


def test_the_longest_come_first_and_the_number_of_points_is_bounded() -> None:
    edges = drawn()
    whole = lines_of(edge_lines(edges))
    few = edge_lines(edges, most_points=len(whole[0]) + len(whole[1]))
    assert [line.tolist() for line in lines_of(few)] == [line.tolist() for line in whole[:2]]
    assert edge_lines(edges, most_points=1).shape == (0, 3)


def test_short_chains_and_empty_pictures_give_nothing() -> None:
    assert edge_lines(drawn(), shortest_px=10_000).shape == (0, 3)
    assert edge_lines(EdgeDetector().detect(np.full((*SIZE, 3), 60, np.uint8))).shape == (0, 3)
