"""The tip's path as drawn on the image: the present one, or the planned one to the selection."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from icu_common.core.geometry.geometry import Array
from scope_ui_bridge.core.desk.chosen import Chosen
from scope_ui_bridge.core.desk.state import DeskState

_SETS_OUT_S = 1.0
"""How long a published path may precede the `moving` state; the driver rejects it afterwards."""


class TipPath:
    """Keeps the published path until its motion has ended."""

    def __init__(self, state: DeskState, chosen: Chosen) -> None:
        self._state = state
        self._chosen = chosen
        self._sets_out_until_s = -math.inf

    def publish(self, path: Array) -> None:
        """Set the path published for the tip, (N, 3) m in base_link; it starts at the tip's position."""
        start = self._tip()
        self._state.scene.path = path if start is None else np.vstack([start, path])
        self._sets_out_until_s = self._state.now_s + _SETS_OUT_S

    def message(self, camera: str) -> dict[str, Any]:
        """Return the tip's path in pixels: the current one, or the planned one (``planned``) to the selection.

        While a goal waits for its first path, none is shown, not even the last one.
        """
        state = self._state
        if state.moving:
            self._sets_out_until_s = -math.inf
            return {"path": state.scene.base_line(camera, state.scene.path), "planned": False}
        if state.now_s >= self._sets_out_until_s:
            state.scene.path = None
        selection, start, points = self._chosen.selection, self._tip(), None
        if selection is not None and start is not None:
            points = state.scene.way_to(start, selection.anchors)
        return {"path": state.scene.base_line(camera, points), "planned": True}

    def _tip(self) -> Array | None:
        position = self._state.machine.position
        if position is None or not all(math.isfinite(value) for value in position):
            return None
        return np.array([*position[:2], -position[2]])
