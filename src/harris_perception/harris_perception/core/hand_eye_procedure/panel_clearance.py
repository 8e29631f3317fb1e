"""Room between the stylus and the panel: a calibration must not touch anything."""

from __future__ import annotations

import numpy as np

from harris_perception.core.hand_eye_procedure.calibration_tour import CalibrationStop
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.reasons.message import Message

_CLEAR_M = 0.001
"""Minimum clearance of the ball above the highest point of the panel: a calibration must not touch anything."""
_LEAST_PART = 0.5
"""Minimum share of the configured lowering that is still useful if there is no room for all of it."""
_LEAN = 0.1
"""Maximum tilt of a panel (rad): the panel may be nearer by this share of the distance to the last measured
position."""


class PanelClearance:
    """Heights of the tip above the panel where it was measured, and the stops that they allow.

    Parameters
    ----------
    see_panel
        Whether the cameras measure the panel at every stop, because they ride on the carriage.
    """

    def __init__(self, *, see_panel: bool) -> None:
        self._see_panel = see_panel
        self._face: Transform | None = None
        self._proud_m = 0.0
        self._looks: dict[tuple[float, float], tuple[Transform | None, Array, float]] = {}

    def set_face(self, camera_from_panel: Transform | None, proud_m: float) -> None:
        """Set the panel's pose, None while it is unseen, and the room that its tallest control and the ball take."""
        self._face, self._proud_m = camera_from_panel, proud_m

    def measured(self, stop: CalibrationStop, camera_from_panel: Transform | None, tip: Array) -> None:
        """Add the tip (3,) m as seen at a stop, and the panel's pose, if it was measured there."""
        self._looks[stop.x, stop.y] = camera_from_panel, tip, stop.z

    @property
    def known(self) -> bool:
        """Whether the tip was seen at any stop."""
        return bool(self._looks)

    def _height(self, stop: CalibrationStop) -> tuple[float, float]:
        """Return the homed tip's height above the panel at the nearest measured position, and the distance to it."""
        if not self._looks:
            return -np.inf, np.inf
        x, y = min(self._looks, key=lambda place: np.hypot(place[0] - stop.x, place[1] - stop.y))
        seen, tip, z = self._looks[x, y]
        # With fixed cameras the panel may have been recognised, or moved, after the tip was seen there.
        face = self._face if seen is None else seen
        assert face is not None
        return float(face.inverse().apply(tip)[2]) - z, float(np.hypot(x - stop.x, y - stop.y))

    def room(self, stop: CalibrationStop) -> CalibrationStop | str | None:
        """Return the stop, raised if there is less room; None: measure from above first; or why it is forbidden.

        Only known obstacles count: if the panel is not recognised, there is no limit.
        """
        if stop.z == 0 or not (self._see_panel or self._face is not None):
            return stop
        height_m, away_m = self._height(stop)
        free_m = height_m - self._proud_m - _CLEAR_M - _LEAN * away_m
        if free_m >= -stop.z:
            return stop
        if away_m > 0:
            return None
        least_m = -_LEAST_PART * stop.z
        if free_m >= least_m:
            return stop._replace(z=-free_m)
        return Message(
            "calibration.lowered_stylus_could_touch_panel",
            least_mm=least_m * 1000.0,
            height_mm=height_m * 1000.0,
            proud_m=self._proud_m * 1000.0,
            least_2_mm=(least_m - free_m) * 1000.0,
        )
