"""Rejection of samples that do not determine the calibration, with the motion that would help."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from harris_perception.core.hand_eye.tip_samples import Sample, reading_design
from icu_common.core.geometry.geometry import Array
from icu_common.core.reasons.message import Message


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
            Message(
                "calibration.samples_needed_move_another_place", samples=len(samples), min_samples=config.min_samples
            )
        )
    readings = np.array([s.reading for s in samples], dtype=np.float64)
    points = np.array([s.tip for s in samples], dtype=np.float64)
    if not (np.isfinite(readings).all() and np.isfinite(points).all()):
        raise DegenerateError(Message("calibration.sample_not_finite"))
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
            Message("calibration.readings_not_differ_gantry_did", along_mm=along * 1000.0, need_mm=need * 1000.0)
        )
    if along < need:
        raise DegenerateError(
            Message("calibration.samples_too_close_together_move", along_mm=along * 1000.0, need_mm=need * 1000.0)
        )
    if across < need:
        off = 1.05 * need * directions[1] * np.sign(directions[1][np.argmax(np.abs(directions[1]))])
        x, y = (centre + off) * 1e3
        kind = (
            Message("calibration.lie_one_line") if across < 0.1 * need else Message("calibration.hardly_leave_one_line")
        )
        raise DegenerateError(
            Message(
                "calibration.samples_long_across_add_one",
                kind=kind,
                along_mm=along * 1000.0,
                across_mm=across * 1000.0,
                x=x,
                y_mm=y,
                need_mm=need * 1000.0,
            )
        )
    seen = float(np.linalg.norm(tips.max(axis=0) - tips.min(axis=0)))
    if seen < 0.2 * along:
        raise DegenerateError(
            Message("calibration.gantry_moved_but_seen_only", along_mm=along * 1000.0, what=what, seen_mm=seen * 1000.0)
        )


def check_extensions(readings: Array, config: HandEyeConfig) -> None:
    """Reject extensions that are correlated with x and y, so that their effects cannot be separated."""
    flat = reading_design(readings, False)
    fitted, *_ = np.linalg.lstsq(flat, readings[:, 2], rcond=None)
    own = readings[:, 2] - flat @ fitted
    if np.ptp(own) < 0.5 * config.min_stylus_span_m:
        raise DegenerateError(
            Message(
                "calibration.stylus_extension_changes_together_own",
                ptp_mm=np.ptp(own) * 1000.0,
                min_stylus_span_mm=config.min_stylus_span_m * 1000.0,
            )
        )
