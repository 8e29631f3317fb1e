"""The controller's estimate of the panel's plane, from the latest poses."""

from __future__ import annotations

from collections import deque

import numpy as np

from gantry_driver.core.contact.heights import HeightEstimate
from gantry_driver.core.envelope.plane import PanelPlane
from icu_common.core.geometry.geometry import Array, Transform

LEAST_POSES, MOST_POSES = 2, 10
WINDOW_S = 8.0
"""Maximum age of a pose relative to the newest one."""
HELD_SIGMA_M = 0.00015
"""Standard deviation that no scatter shows: recognition holds a pose until the next differs by more than that
(``recognition.agreement.tolerance_mm``)."""
NANO = 1_000_000_000


class PlaneEstimate:
    """Collects poses of the panel's face in base_link."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, Transform]] = deque(maxlen=MOST_POSES)

    def forget(self) -> None:
        """Drop all poses: they are in doubt."""
        self._poses.clear()

    def take(self, base_from_panel: Transform, stamp_ns: int) -> None:
        """Add a pose with the stamp of its image; ignore one that is not newer than the last."""
        if self._poses and stamp_ns <= self._poses[-1][0]:
            return
        self._poses.append((stamp_ns, base_from_panel))
        while stamp_ns - self._poses[0][0] > WINDOW_S * NANO:
            self._poses.popleft()

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest pose."""
        return self._poses[-1][0] if self._poses else 0

    def plane(
        self, base_from_reading: Array, middle: Array, ball_radius_m: float, calibration_sigma_m: float
    ) -> PanelPlane | None:
        """Return the plane in readings; None while too few poses have been seen.

        Parameters
        ----------
        base_from_reading
            (2, 2) axes of the machine.
        middle
            (2,) middle of the face in panel_link, m, where its depth is known best.
        ball_radius_m
            Radius of the ball, whose lowest point touches.
        calibration_sigma_m
            Standard deviation of the hand-eye calibration.

        Raises
        ------
        ValueError
            If no panel can have the poses.
        """
        if len(self._poses) < LEAST_POSES:
            return None
        poses = [pose for _, pose in self._poses]
        centre = np.mean([pose.apply(np.array([*middle, 0.0]))[:2] for pose in poses], axis=0)
        rows = np.array([_face(pose, centre, base_from_reading) for pose in poses])
        mean, covariance = rows.mean(axis=0), np.cov(rows.T)
        covariance[0, 0] += HELD_SIGMA_M**2 + calibration_sigma_m**2
        x, y = np.linalg.solve(base_from_reading, centre)
        return PanelPlane(
            at_m=(float(x), float(y), float(mean[0]) - ball_radius_m),
            slope=(float(mean[1]), float(mean[2])),
            covariance=tuple(covariance.ravel().tolist()),
        )


def plane_below(plane: PanelPlane, stylus: HeightEstimate) -> PanelPlane:
    """Return the plane for a stylus that, according to looks, must extend farther than its readings."""
    if not stylus.measured:
        return plane
    x, y, extension = plane.at_m
    first, *rest = plane.covariance
    return PanelPlane(
        at_m=(x, y, extension + stylus.value_m), slope=plane.slope, covariance=(first + stylus.sigma_m**2, *rest)
    )


def _face(base_from_panel: Transform, centre: Array, base_from_reading: Array) -> Array:
    """Return (3,): the depth of the face below z = 0 at a point (2,) of base_link, and its slopes along the axes."""
    normal, origin = base_from_panel.rotation[:, 2], base_from_panel.translation
    slope = normal[:2] / normal[2]  # of the depth, which increases as z decreases
    depth = -origin[2] + slope @ (centre - origin[:2])
    return np.array([depth, *(base_from_reading.T @ slope)])
