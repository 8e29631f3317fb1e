"""Corners and edges shown over the image, as JSON in raw pixels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

CORNERS, EDGES = "corners", "edges"
LAYERS = (CORNERS, EDGES)
_MAX_CORNERS = 600
_MAX_EDGE_POINTS = 3000
_LIFE_NS = 1_000_000_000  # maximum age of the image in which points were found, for drawing

Points = npt.NDArray[np.float32]


class Layers:
    """Newest points of each layer and camera: corners (N, 2) u, v; edges (N, 3) u, v, line number."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], tuple[int, Points]] = {}

    def take(self, layer: str, camera: str, stamp_ns: int, points: Points) -> None:
        """Set the points found in the image with this stamp."""
        self._found[layer, camera] = (stamp_ns, points)

    def text(self, layer: str, camera: str, stamp_ns: int) -> str:
        """Return JSON for the image with this stamp: ``[u, v, u, v ...]``, for edges a list of such lists."""
        found_ns, points = self._found.get((layer, camera), (0, np.empty((0, 3), np.float32)))
        if abs(stamp_ns - found_ns) > _LIFE_NS:
            return "[]"
        if layer == CORNERS:
            return flat(points[:_MAX_CORNERS])
        points = points[:_MAX_EDGE_POINTS]
        ends = np.flatnonzero(np.diff(points[:, 2])) + 1
        return "[" + ",".join(flat(line[:, :2]) for line in np.split(points, ends) if len(line) > 1) + "]"


def flat(points: Points) -> str:
    """Return a flat JSON list of (N, 2) points with at most one decimal; points that are not finite are left out."""
    finite = points[np.isfinite(points).all(axis=1)]
    return "[" + ",".join(f"{value:.1f}".removesuffix(".0") for value in finite.ravel().tolist()) + "]"
