"""Measured values of one run of the acceptance test, filled by the program."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gantry_driver.acceptance.axes_fit import AxesFit
from gantry_driver.acceptance.coverage import PanelCoverage
from gantry_driver.acceptance.stops import AcceptanceStop
from icu_common.core.geometry.geometry import Array


@dataclass(slots=True, eq=False, kw_only=True)
class Visit:
    """A stop that was visited: the reading (2,) at rest, the tip (3,) in the panel's frame [m], None if unseen.

    ``problem`` is the answer of the controller if the stop was not reached.
    """

    stop: AcceptanceStop
    reading: Array
    tip: Array | None
    problem: str = ""

    @property
    def error_m(self) -> float:
        """Distance of the reading from the ordered one."""
        return float(np.hypot(*(self.reading - self.stop.reading)))


@dataclass(slots=True, eq=False, kw_only=True)
class Beyond:
    """A goal outside the limits: whether the controller rejected it, its reason, and how far the axes moved."""

    reading: Array
    rejected: bool
    reason: str
    moved_m: float


@dataclass(slots=True, eq=False, kw_only=True)
class MeasuredTouch:
    """A touch of a point (2,) in metres of the panel, and the answer of the controller."""

    point: Array
    touched: bool
    error_m: float
    duration_s: float = math.nan
    reason: str = ""


@dataclass(slots=True, eq=False, kw_only=True)
class CameraSnapshot:
    """The image of one camera, bgr8, and what it shows."""

    name: str
    image: npt.NDArray[np.uint8]
    view: PanelCoverage
    blur_px: float
    touch_px: Array
    """Pixels (N, 2) of the touched points."""


@dataclass(slots=True, eq=False, kw_only=True)
class Measured:
    """Everything that a run has measured; ``wanted_touches`` is the ordered number of touches."""

    low: Array
    high: Array
    outline: Array
    wanted_touches: int
    visits: list[Visit] = field(default_factory=list)
    beyond: list[Beyond] = field(default_factory=list)
    fit: AxesFit | None = None
    fit_problem: str = ""
    cameras: list[CameraSnapshot] = field(default_factory=list)
    touches: list[MeasuredTouch] = field(default_factory=list)

    @property
    def seen(self) -> list[Visit]:
        """Visits at which the tip was seen."""
        return [visit for visit in self.visits if visit.tip is not None]
