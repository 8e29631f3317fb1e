"""Edges as few straight pieces: small enough to send with each image to a display."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.edges.edges import Edges

COLUMNS = ("u", "v", "line")


def edge_lines(
    edges: Edges, tolerance_px: float = 1.0, shortest_px: int = 12, most_points: int = 3000
) -> npt.NDArray[np.float32]:
    """Return (N, 3) float32: u, v [px] and the number of the line that the point belongs to, the longest line first.

    Parameters
    ----------
    edges
        Chains of one image.
    tolerance_px
        Maximum distance of a chain's pixels from its line (Douglas-Peucker).
    shortest_px
        Minimum number of pixels of a chain.
    most_points
        Maximum number of points; whole lines are omitted, the shortest first.
    """
    chains = sorted((chain for chain in edges.chains if len(chain) >= shortest_px), key=len, reverse=True)
    lines = [_straightened(chain, tolerance_px) for chain in chains]
    counts = np.array([len(line) for line in lines], np.intp)
    kept = int(np.searchsorted(np.cumsum(counts), most_points, side="right"))
    if kept == 0:
        return np.empty((0, 3), np.float32)
    numbers = np.repeat(np.arange(kept), counts[:kept])
    return np.column_stack([np.vstack(lines[:kept]), numbers]).astype(np.float32)


def _straightened(chain: npt.NDArray[np.int32], tolerance_px: float) -> npt.NDArray[np.int32]:
    # OpenCV measures from the line through both ends, which a closed chain does not have.
    if (chain[0] == chain[-1]).all():
        around = cv2.approxPolyDP(chain[:-1, None], tolerance_px, closed=True)[:, 0]
        return np.vstack([around, around[:1]]).astype(np.int32)
    return cv2.approxPolyDP(chain[:, None], tolerance_px, closed=False)[:, 0].astype(np.int32)
