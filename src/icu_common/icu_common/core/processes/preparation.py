"""Progress of a preparation, as ``gantry_prepare --json`` prints it and bring-up reads it: one JSON object a line."""

from __future__ import annotations

import dataclasses
import json
import re
from dataclasses import dataclass
from enum import Enum


class PreparationStage(str, Enum):
    """Step of a preparation; ``ready`` and ``failed`` end it."""

    CONNECTING = "connecting"
    ENABLING = "enabling"
    HOMING = "homing"
    CAMERAS = "cameras"
    CALIBRATING = "calibrating"
    CONTROLLER = "controller"
    READY = "ready"
    FAILED = "failed"


class PreparationCause(str, Enum):
    """Cause of a failed preparation; only ``timed_out`` can be caused by slowness alone."""

    NONE = ""
    REFUSED = "refused"
    TIMED_OUT = "timed_out"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparationReport:
    """One line of progress.

    Parameters
    ----------
    stage
        The step.
    text
        State or reason as reported by the node, for logs and for the details of an error.
    done, total, missed
        Positions of the calibration; ``total`` is 0 outside of it.
    left_s
        Remaining seconds as reported by the calibration; None if it reports none.
    failed_at
        The step that failed, in ``failed``.
    cause
        Cause of the failure, in ``failed``.
    """

    stage: PreparationStage
    text: str = ""
    done: int = 0
    total: int = 0
    missed: int = 0
    left_s: float | None = None
    failed_at: PreparationStage | None = None
    cause: PreparationCause = PreparationCause.NONE


_PROGRESS = re.compile(r"calibrating (\d+)/(\d+)")
_MISSED = re.compile(r"(\d+) missed")
_LEFT = re.compile(r"(\d+(?:\.\d+)?) s left")


def calibration_report(state: str) -> PreparationReport:
    """Return the report of a text of ``calibration/state``."""
    found, missed, left = (pattern.search(state) for pattern in (_PROGRESS, _MISSED, _LEFT))
    return PreparationReport(
        stage=PreparationStage.CALIBRATING,
        text=state,
        done=int(found[1]) if found else 0,
        total=int(found[2]) if found else 0,
        missed=int(missed[1]) if missed else 0,
        left_s=float(left[1]) if left else None,
    )


def to_line(report: PreparationReport) -> str:
    """Return a report as one line of JSON; keys with default values are left out."""
    defaults = {f.name: f.default for f in dataclasses.fields(PreparationReport)}
    values = {name: value for name, value in dataclasses.asdict(report).items() if value != defaults[name]}
    return json.dumps(values)


def from_line(line: str) -> PreparationReport:
    """Return the report of a line.

    Raises
    ------
    ValueError
        If the line is no report.
    """
    try:
        values = json.loads(line)
        failed_at = values.pop("failed_at", None)
        return PreparationReport(
            stage=PreparationStage(values.pop("stage")),
            failed_at=None if failed_at is None else PreparationStage(failed_at),
            cause=PreparationCause(values.pop("cause", "")),
            **values,
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{line!r} is no report of a preparation: {error}") from error
