"""Errors of the views, outliers among them, and calibration without these."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from harris_perception.core.cameras.calibration_config import CalibrationConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewError:
    """Error of one image or pair, px."""

    name: str
    corners: int
    rms_px: float
    outlier: bool


_V = TypeVar("_V")
_R = TypeVar("_R", bound="_Calibration")


class _Calibration(Protocol):
    @property
    def views(self) -> tuple[ViewError, ...]: ...


def errors_of(names: Sequence[str], counts: Sequence[int], errors: Sequence[float], factor: float) -> list[ViewError]:
    """Return each view's error; an outlier's is above ``factor`` times the median."""
    bound = factor * float(np.median(errors))
    return [
        ViewError(name=n, corners=c, rms_px=float(e), outlier=bool(e > bound)) for n, c, e in zip(names, counts, errors)
    ]


def may_drop(view: ViewError, count: int, config: CalibrationConfig) -> bool:
    """Return whether a view may be removed from ``count`` views."""
    return config.drop_outliers and view.outlier and count > config.min_views


def worst_unfit(rms_px: float, views: Sequence[ViewError], config: CalibrationConfig) -> ViewError | None:
    """Return the worst of the views whose error is too large, unless a view can still be removed."""
    if rms_px <= config.max_rms_px or any(may_drop(view, len(views), config) for view in views):
        return None
    return max(views, key=lambda view: view.rms_px)


def without_outliers(
    views: Sequence[_V],
    once: Callable[[Sequence[_V], tuple[ViewError, ...]], _R | tuple[ViewError, ...]],
    config: CalibrationConfig,
) -> _R:
    """Calibrate; then, if configured, remove the worst outlier and calibrate again, until there is none.

    ``once`` may return only the views' errors while a view is to be removed.
    """
    kept = list(views)
    left_out: list[ViewError] = []
    while True:
        result = once(kept, tuple(left_out))
        errors = result if isinstance(result, tuple) else result.views
        worst = max(errors, key=lambda view: view.rms_px)
        if not (isinstance(result, tuple) or may_drop(worst, len(kept), config)):
            return result
        del kept[errors.index(worst)]
        left_out.append(worst)
