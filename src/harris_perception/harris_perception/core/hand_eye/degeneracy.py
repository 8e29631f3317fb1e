"""Rejection of samples that do not determine the calibration, with the motion that would help."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Sample, reading_design
from icu_common.core.geometry.geometry import Array


class DegenerateError(ValueError):
    """The samples do not determine the calibration; the message says what to add."""


class MisfitError(DegenerateError):
    """The samples disagree; more of them may show which are wrong."""


def checked(samples: Sequence[Sample], what: str, config: HandEyeConfig) -> tuple[Array, Array]:
    """Return readings (N, 3) and points (N, 3) of samples after checking that they are enough, finite and spread.

    Raises
    ------
    DegenerateError
        With the motion that would help.
    """
    if len(samples) < config.min_samples:
        raise DegenerateError(
            f"{len(samples)} samples, {config.min_samples} are needed: move to another place and add one"
        )
    readings = np.array([s.reading for s in samples], dtype=np.float64)
    points = np.array([s.tip for s in samples], dtype=np.float64)
    if not (np.isfinite(readings).all() and np.isfinite(points).all()):
        raise DegenerateError("a sample is not finite")
    check_motion(readings, points, what, config)
    return readings, points


def check_motion(readings: Array, tips: Array, what: str, config: HandEyeConfig) -> None:
    """Reject samples that leave one of the two directions undetermined."""
    centre = readings[:, :2].mean(axis=0)
    _, _, directions = np.linalg.svd(readings[:, :2] - centre)
    along, across = (float(np.ptp(readings[:, :2] @ d)) for d in directions)
    need = config.min_span_m
    if along < 0.001:
        raise DegenerateError(
            f"the readings do not differ ({along * 1e3:.2f} mm): the gantry did not move; move at least "
            f"{need * 1e3:.0f} mm in x and in y"
        )
    if along < need:
        raise DegenerateError(
            f"the samples are too close together ({along * 1e3:.1f} mm): move at least "
            f"{need * 1e3:.0f} mm in x and in y"
        )
    if across < need:
        off = 1.05 * need * directions[1] * np.sign(directions[1][np.argmax(np.abs(directions[1]))])
        x, y = (centre + off) * 1e3
        kind = "lie on one line" if across < 0.1 * need else "hardly leave one line"
        raise DegenerateError(
            f"the samples {kind} ({along * 1e3:.0f} mm long, {across * 1e3:.1f} mm across): add one near "
            f"x = {x:.0f}, y = {y:.0f} mm or at least {need * 1e3:.0f} mm off that line"
        )
    seen = float(np.linalg.norm(tips.max(axis=0) - tips.min(axis=0)))
    if seen < 0.2 * along:
        raise DegenerateError(
            f"the gantry moved {along * 1e3:.0f} mm but {what} that was seen only {seen * 1e3:.1f} mm: what is "
            "tracked is not it, the camera is mounted otherwise, or the drive slips; look at the picture before "
            "moving again"
        )


def check_extensions(readings: Array, config: HandEyeConfig) -> None:
    """Reject extensions that are correlated with x and y, so that their effects cannot be separated."""
    flat = reading_design(readings, False)
    fitted, *_ = np.linalg.lstsq(flat, readings[:, 2], rcond=None)
    own = readings[:, 2] - flat @ fitted
    if np.ptp(own) < 0.5 * config.min_stylus_span_m:
        raise DegenerateError(
            f"the stylus extension changes together with x and y (own part {np.ptp(own) * 1e3:.2f} mm): add a "
            "sample at the same x and y with the stylus "
            f"{config.min_stylus_span_m * 1e3:.0f} mm further in or out"
        )
