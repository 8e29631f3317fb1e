"""Causes other than delays that forbid a touch, as codes with typed values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from icu_common.core.processes.delays import Delay
from icu_common.core.reasons.message import Message


class FindingCode(str, Enum):
    """Machine-readable cause in ``GoalResult.code``."""

    CAMERA_MOVED = "camera_moved"
    """The right camera has rotated beyond the correctable limit. Values: ``turn_deg``, ``turn_px``, ``limit_deg``."""
    CAMERA_CHANGING = "camera_changing"
    """The rotation of the right camera changes. Values: ``turn_deg``, ``turn_px``."""
    CAMERA_UNCHECKED = "camera_unchecked"
    """The rotation of the right camera has not been measured for too long. Values: ``age_s``, ``limit_s``."""
    LAYOUT_DEVIATES = "layout_deviates"
    """A control is too far from its layout. Values: ``control``, ``x_mm``, ``y_mm``, ``limit_mm``."""
    UNCERTAIN = "uncertain"
    """The position of the touch is not known well enough. Values: ``uncertainty_mm``, ``limit_mm``."""

    def __str__(self) -> str:
        return self.value


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One cause.

    Parameters
    ----------
    code
        Its kind.
    values
        Its values by key, as texts; see :class:`FindingCode`.
    """

    code: FindingCode
    values: tuple[tuple[str, str], ...] = ()

    def text(self) -> str:
        """Return the finding for people."""
        return _text(self.code, dict(self.values))

    def details(self) -> tuple[tuple[str, str], ...]:
        """Return the values as pairs for ``GoalResult.details``."""
        return (("finding", self.code.value), *self.values)


def _text(code: FindingCode, of: dict[str, str]) -> str:
    if code is FindingCode.CAMERA_MOVED:
        turn, limit = Message("alignment.degrees", turn_deg=of["turn_deg"], turn_px=of["turn_px"]), of["limit_deg"]
        return Message("alignment.right_camera_moved_limit_degrees", turn=turn, limit_deg=limit)
    if code is FindingCode.CAMERA_CHANGING:
        turn = Message("alignment.degrees", turn_deg=of["turn_deg"], turn_px=of["turn_px"])
        return Message("alignment.right_camera_moving_calibration_not", turn=turn)
    if code is FindingCode.CAMERA_UNCHECKED:
        age, limit = of["age_s"], of["limit_s"]
        return Message("alignment.cameras_not_compared_limit_both", age_s=age, limit_s=limit)
    if code is FindingCode.LAYOUT_DEVIATES:
        x, y, limit = of["x_mm"], of["y_mm"], of["limit_mm"]
        return Message(
            "alignment.right_above_layout_limit_correct", control=of["control"], x_mm=x, y_mm=y, limit_mm=limit
        )
    return Message("alignment.touch_known_limit", uncertainty_mm=of["uncertainty_mm"], limit_mm=of["limit_mm"])


Cause = Delay | Finding
"""Source of a result's code: a delay or a finding."""
