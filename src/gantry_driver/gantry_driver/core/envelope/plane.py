"""The guard's model of the panel's face: a plane in readings, with its covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

MAX_SLOPE = 0.3
"""Maximum slope of a valid plane: 17 degrees; the controller touches up to 10 (``max_tilt_deg``)."""
FARTHEST_M = 1.0
"""Maximum coordinate of a point on a valid plane, in metres."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelPlane:
    """The extension at which the ball touches the face, for each position in x and y.

    Parameters
    ----------
    at_m
        Readings (x, y, extension) at one point of the plane.
    slope
        Change of the extension along x and along y.
    covariance
        Covariance of the extension at that point and of both slopes: 9 values, row by row.

    Raises
    ------
    ValueError
        If a value is not finite, too large for any panel, or not a valid variance.
    """

    at_m: tuple[float, float, float]
    slope: tuple[float, float]
    covariance: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.at_m) != 3 or len(self.slope) != 2 or len(self.covariance) != 9:
            raise ValueError("a plane has 3 readings, 2 slopes and 9 covariances")
        if not all(map(math.isfinite, (*self.at_m, *self.slope, *self.covariance))):
            raise ValueError(f"the plane at {self.at_m} m is not finite")
        if max(map(abs, self.at_m)) > FARTHEST_M or math.hypot(*self.slope) > MAX_SLOPE:
            raise ValueError(
                f"the plane at {self.at_m} m with slopes {self.slope} is no panel's (limits {FARTHEST_M:g} m and "
                f"{MAX_SLOPE:g})"
            )
        if min(self.covariance[::4]) < 0.0:
            raise ValueError(f"a variance is below zero: {self.covariance}")

    def contact_m(self, x: float, y: float) -> float:
        """Return the extension at which the ball touches the face, in metres."""
        return self.at_m[2] + self.slope[0] * (x - self.at_m[0]) + self.slope[1] * (y - self.at_m[1])

    def sigma_m(self, x: float, y: float) -> float:
        """Return the standard deviation of :meth:`contact_m`, in metres."""
        weights = (1.0, x - self.at_m[0], y - self.at_m[1])
        rows = (self.covariance[0:3], self.covariance[3:6], self.covariance[6:9])
        variance = sum(a * sum(b * c for b, c in zip(weights, row)) for a, row in zip(weights, rows))
        return math.sqrt(max(variance, 0.0))

    def values(self) -> dict[str, Any]:
        """Return the plane as JSON values."""
        return asdict(self)


def plane_of(values: Mapping[str, Any]) -> PanelPlane:
    """Return the plane of :meth:`PanelPlane.values`; it validates itself."""

    def floats(name: str) -> Sequence[float]:
        return tuple(map(float, values[name]))

    at_m, slope = floats("at_m"), floats("slope")
    return PanelPlane(at_m=at_m, slope=slope, covariance=tuple(floats("covariance")))  # type: ignore[arg-type]
