"""Deviation of a control from its layout, as measured by the cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum


class DeviationCode(str, Enum):
    """Treatment of a control's deviation."""

    UNMEASURED = "unmeasured"
    """The control could not be measured: the shift of all controls and the layout's tolerance apply."""
    AS_LAID_OUT = "as_laid_out"
    """No significant deviation."""
    CORRECTED = "corrected"
    """The control deviates significantly from its layout."""
    REFUSED = "refused"
    """The deviation is above the limit: the control is not touched."""

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlDeviation:
    """Deviation of one control from its layout.

    Attributes
    ----------
    name
        The control.
    code
        See :class:`DeviationCode`.
    offset_mm
        Most likely position minus the layout's along the panel's x and y.
    sigma_mm
        Standard deviations of the used position along x and y.
    limit_mm
        Offset above which the control is not touched.

    Raises
    ------
    ValueError
        If a value is not finite, or a deviation negative.
    """

    name: str
    code: DeviationCode
    offset_mm: tuple[float, float]
    sigma_mm: tuple[float, float]
    limit_mm: float

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (*self.offset_mm, *self.sigma_mm, self.limit_mm))) or min(self.sigma_mm) < 0:
            raise ValueError(f"{self.name}: offset {self.offset_mm} mm, deviation {self.sigma_mm} mm")
