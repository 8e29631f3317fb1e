"""Errors of looks at the tip, learned from the looks themselves.

The cameras measure the tip's distance worst, and its error differs from look to look more than within one look. The
readings of the stylus give the tip's height up to one offset, which the mean of all looks measures. So the error of a
look's height is known, and with it the error along the line of sight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from icu_common.core.geometry.geometry import Array

_PRIOR_LOOKS = 4
"""Number of looks that a configured standard deviation counts as."""
_START_M = 0.0005
"""Standard deviation of the offset between seen heights and readings before the first look."""
_DRIFT_M = 0.00003
"""Standard deviation of its drift between two looks."""
_SIGMAS = 4.0
"""Size of a difference from the expected height, in standard deviations, from which the stylus counts as moved."""
_DESCENT_M = 0.00002
"""Standard deviation of the tip's lateral motion during a descent, as of an axis that leans by 2 mm per metre."""
_AGREEING = 13.8
"""Squared Mahalanobis distance up to which a contact may be where the look above it has shown it (99.9 %)."""


@dataclass(slots=True, kw_only=True)
class TipNoise:
    """Errors of looks, in metres: of the height, and across the line of sight.

    Parameters
    ----------
    height_m, across_m
        Expected standard deviations of one look.

    Examples
    --------
    >>> noise = TipNoise(height_m=0.0002, across_m=0.00001)
    >>> for offset_m in (0.0004, 0.0006, 0.0004, 0.0006):
    ...     error_m = noise.take_height(offset_m)
    >>> round(1e3 * error_m, 1)
    0.1
    """

    height_m: float
    across_m: float
    offset_m: float = 0.0
    """Estimated difference between seen heights and readings."""
    offset_sigma_m: float = _START_M
    _looks: int = _PRIOR_LOOKS
    _touches: int = 1
    _correction_m: float | None = None

    def forget(self) -> None:
        """Forget the offset after a calibration; the errors of looks stay."""
        self.offset_m, self.offset_sigma_m, self._correction_m = 0.0, _START_M, None

    def take_height(self, offset_m: float, correction_m: float = 0.0) -> float:
        """Take a ball seen ``offset_m`` above the height of its reading; return the error of the seen height.

        A camera's correction changes seen heights by ``correction_m``; its change counts as uncertainty.
        """
        change_m = 0.0 if self._correction_m is None else correction_m - self._correction_m
        self._correction_m = correction_m
        before = self.offset_sigma_m**2 + _DRIFT_M**2 + change_m**2
        surprise, noise = offset_m - self.offset_m, self.height_m**2
        if surprise**2 > _SIGMAS**2 * (before + noise):
            before = surprise**2  # the stylus has moved, so earlier looks prove nothing
        else:
            self.height_m = _pooled(self.height_m, self._looks, surprise**2 * noise / (before + noise))
            self._looks += 1
        gain = before / (before + noise)
        self.offset_m += gain * surprise
        self.offset_sigma_m = math.sqrt(gain * noise)
        return offset_m - self.offset_m

    def take_gap(self, gap: Array, ray: Array) -> None:
        """Take the difference (2,) between the tip's positions in the look above a touch and in contact."""
        across = float(gap @ _normal(ray))
        # Independent errors of both looks would be half of it; both also share the error of the print's pose.
        self.across_m = _pooled(self.across_m, self._touches, across**2)
        self._touches += 1

    def in_air(self, ray: Array, looks: int) -> Array:
        """Return the covariance (2, 2) of the mean of looks in the air, after the correction by their heights."""
        # The offset is not measured on every machine. The error across is nearly the same in looks at one position.
        height_m = min(self.offset_sigma_m, self.height_m / math.sqrt(max(looks, 1)))
        return _spread(ray, self.across_m, height_m / abs(float(ray[2])))

    def in_contact(self, ray: Array) -> Array:
        """Return the covariance (2, 2) of a look in contact, whose height no reading gives."""
        return _spread(ray, self.across_m, self.height_m / abs(float(ray[2])))


def sideways(ray: Array, height_m: float) -> Array:
    """Return the lateral part (2,) of an error along a ray (3,) that is ``height_m`` high."""
    return np.asarray(ray[:2] / ray[2] * height_m)


def combined(air: Array, air_covariance: Array, contact: Array, contact_covariance: Array) -> tuple[Array, Array]:
    """Return the tip's offset (2,) and covariance (2, 2) from a look in the air and one in contact.

    If they do not agree, the tip has moved in between, and only the contact counts.
    """
    before = air_covariance + _DESCENT_M**2 * np.eye(2)
    gap, both = contact - air, before + contact_covariance
    if float(gap @ np.linalg.solve(both, gap)) > _AGREEING:
        return contact, contact_covariance
    weight = before @ np.linalg.inv(both)
    return np.asarray(air + weight @ gap), np.asarray(before - weight @ before)


def _pooled(sigma: float, count: int, square: float) -> float:
    return math.sqrt((count * sigma**2 + square) / (count + 1))


def _normal(ray: Array) -> Array:
    """Return the horizontal unit vector (2,) across a line of sight; any, if it is vertical."""
    length = math.hypot(*ray[:2])
    return np.array([1.0, 0.0]) if length < 1e-9 else np.array([-ray[1], ray[0]]) / length


def _spread(ray: Array, across_m: float, along_m: float) -> Array:
    outer = np.outer(ray, ray)[:2, :2]
    return np.asarray(across_m**2 * (np.eye(2) - outer) + along_m**2 * outer)
