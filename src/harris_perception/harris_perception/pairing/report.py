"""Diagnostics of the pairing: a code with values, and the sentence for people derived from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

from harris_perception.pairing.free_pairs import CameraPhase
from harris_perception.pairing.offset import Offset
from icu_common.core.reasons.message import Message

NO_PAIR = "no_pair"
"""Both cameras send images, but no two of them form a pair."""
INTERPOLATED = "interpolated"
"""The cameras are free-running; the right view is interpolated to the left image's instant."""
TOGETHER = "together"
"""Left and right images have the same instant."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairingReport:
    """A code and its values; differences are in seconds, right minus left.

    Attributes
    ----------
    parameter
        Parameter to change, for ``no_pair``.
    """

    code: str
    difference_s: float
    tolerance_s: float
    parameter: str = ""

    @property
    def text(self) -> str:
        """A sentence for people; empty if there is no parameter to change."""
        if self.code != NO_PAIR:
            return ""
        return Message(
            "tips.left_right_images_differ_tolerance",
            difference_ms=abs(self.difference_s) * 1000.0,
            tolerance_ms=self.tolerance_s * 1000.0,
            parameter=self.parameter,
        )


def pairing_report(
    phase: CameraPhase, tolerance_s: float, *, paired: bool, interpolated: bool, free_running: bool
) -> PairingReport | None:
    """Return how the images of the last second were paired; None while that is unknown.

    Parameters
    ----------
    phase
        Phase of the stamps of the last second.
    tolerance_s
        Maximum difference between the stamps of one instant.
    paired, interpolated
        Whether a pair was found, and whether its images had different instants.
    free_running
        Whether pairs of different instants are allowed.
    """
    if not phase.known:
        return None
    if paired:
        code = INTERPOLATED if interpolated else TOGETHER
        return PairingReport(code=code, difference_s=phase.difference_s, tolerance_s=tolerance_s)
    name = "pair_tolerance_s" if free_running else "free_running"
    return PairingReport(code=NO_PAIR, difference_s=phase.difference_s, tolerance_s=tolerance_s, parameter=name)


def pairing_values(report: PairingReport | None, phase: CameraPhase, offset: Offset) -> list[tuple[str, str]]:
    """Return the typed values of the diagnostics: names with units, numbers as text."""
    if report is None:
        return [("pairing", "unknown")]
    values = [
        ("pairing", report.code),
        ("difference_ms", f"{report.difference_s * 1e3:.2f}"),
        ("tolerance_ms", f"{report.tolerance_s * 1e3:g}"),
        ("left_period_ms", f"{phase.left_period_s * 1e3:.2f}"),
        ("right_period_ms", f"{phase.right_period_s * 1e3:.2f}"),
    ]
    if report.parameter:
        values.append(("parameter", report.parameter))
    if math.isfinite(offset.sigma_s):
        values.append(("right_late_ms", f"{offset.late_s * 1e3:.2f}"))
        values.append(("right_late_sigma_ms", f"{offset.sigma_s * 1e3:.2f}"))
    return values
