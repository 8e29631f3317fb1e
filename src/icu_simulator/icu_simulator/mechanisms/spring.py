"""The spring in the stylus: force of the ball at an overtravel of the drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from icu_common.core.configuration.config import Config, setting


class Push(NamedTuple):
    """Force at the beginning of the compression in N, and its increase in N/mm."""

    preload_n: float
    rate_n_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SpringConfig(Config):
    """A sprung plunger, as in a test probe: it rests on a stop until the force exceeds its preload."""

    preload_n: float = setting(
        0.6, "Preload: force at which the spring begins to yield", minimum=0.0, maximum=20.0, unit="N"
    )
    rate_n_mm: float = setting(1.2, "Stiffness of the spring", minimum=0.05, maximum=100.0, unit="N/mm")

    @property
    def push(self) -> Push:
        """Preload and rate."""
        return Push(self.preload_n, self.rate_n_mm)

    def in_series(self, stiffness_n_mm: float) -> Push:
        """Return the behaviour of the yielding spring on a foundation of this stiffness."""
        return Push(self.preload_n, self.rate_n_mm * stiffness_n_mm / (self.rate_n_mm + stiffness_n_mm))

    def force_n(self, compression_mm: float) -> float:
        """Return the force on the ball in newtons, 0 when the spring rests on its stop."""
        return self.preload_n + self.rate_n_mm * compression_mm if compression_mm > 0 else 0.0
