"""Heights that looks and touches correct: each is an estimate with its variance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from icu_common.core.reasons.message import Message

SIGMAS = 3.0
"""Minimum reported difference from the expectation, in standard deviations."""
LEAST_M = 0.0003
"""Minimum reported difference from the expectation, in metres."""


class HeightFindingCode(str, Enum):
    """Machine-readable kind of an unexpected height at a look or a touch."""

    STYLUS_OFFSET = "stylus_offset"
    """The ball is seen higher (positive) or lower than its readings: lost steps, or a bumped stylus."""
    PANEL_DEPTH = "panel_depth"
    """The stylus met a surface lower (positive) or higher than the cameras have measured it."""

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class HeightFinding:
    """A height in metres that is more than three standard deviations from its expectation."""

    code: HeightFindingCode
    value_m: float
    sigma_m: float

    def text(self) -> str:
        """Return a text for people."""
        off_mm, positive = 1000.0 * abs(self.value_m), self.value_m > 0
        if self.code is HeightFindingCode.STYLUS_OFFSET and positive:
            return Message("contact.stylus_higher_readings_say", off_mm=off_mm)
        if self.code is HeightFindingCode.STYLUS_OFFSET:
            return Message("contact.stylus_lower_readings_say", off_mm=off_mm)
        if positive:
            return Message("contact.panel_lower_measured", off_mm=off_mm)
        return Message("contact.panel_higher_measured", off_mm=off_mm)

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the values as pairs for ``GoalResult.details``."""
        return (
            ("finding", self.code.value),
            ("finding_m", f"{self.value_m:.6f}"),
            ("finding_sigma_m", f"{self.sigma_m:.6f}"),
        )


@dataclass(slots=True, kw_only=True)
class HeightEstimate:
    """Kalman filter of one height that drifts.

    Parameters
    ----------
    code
        Code of an unexpected height.
    value_m, sigma_m
        Expected value and standard deviation before the first measurement.
    drift_m
        Standard deviation of the drift between two measurements.

    Examples
    --------
    >>> offset = HeightEstimate(code=HeightFindingCode.STYLUS_OFFSET, sigma_m=0.0002, drift_m=0.00005)
    >>> offset.take(0.0008, 0.0001).value_m, round(1000 * offset.value_m, 2)
    (0.0008, 0.79)
    >>> offset.take(0.00085, 0.0001) is None
    True
    """

    code: HeightFindingCode
    value_m: float = 0.0
    sigma_m: float
    drift_m: float
    measured: bool = False

    def take(self, measured_m: float, sigma_m: float) -> HeightFinding | None:
        """Take a measurement and its standard deviation; return the finding, None for an expected value."""
        surprise = measured_m - self.value_m
        before = self.sigma_m**2 + (self.drift_m**2 if self.measured else 0.0)
        expected = math.sqrt(before + sigma_m**2)
        finding = None
        if abs(surprise) > max(SIGMAS * expected, LEAST_M):
            finding = HeightFinding(code=self.code, value_m=surprise, sigma_m=expected)
            before = max(before, surprise**2)  # the expectation is disproved
        gain = before / (before + sigma_m**2)
        self.value_m += gain * surprise
        self.sigma_m, self.measured = math.sqrt((1.0 - gain) * before), True
        return finding
