"""Texts of bring-up: the moving line, the remaining time, and the next step after a failure."""

from __future__ import annotations

from dataclasses import dataclass

from icu_common.core.processes.preparation import PreparationCause, PreparationReport, PreparationStage

_STEPS = {
    PreparationStage.CONNECTING: "connecting to the driver",
    PreparationStage.ENABLING: "enabling the machine",
    PreparationStage.HOMING: "homing",
    PreparationStage.CAMERAS: "waiting for the cameras",
    PreparationStage.CALIBRATING: "calibrating",
    PreparationStage.CONTROLLER: "waiting for the controller",
    PreparationStage.READY: "ready",
}
AUTOMATIC_REPEATS = 2
"""Maximum number of preparations that bring-up repeats automatically after one that only took too long."""


class RemainingTime:
    """Estimates the remaining seconds; a repeated report of the same count changes nothing."""

    def __init__(self) -> None:
        self._first: tuple[int, float] | None = None
        self._done = 0
        self._end_s: float | None = None

    def progress(self, done: int, total: int, now_s: float, left_s: float | None = None) -> None:
        """Record how many of ``total`` are done; ``left_s`` is the program's own estimate."""
        if left_s is not None:
            self._end_s = now_s + left_s
            return
        if self._first is None or done < self._done:
            self._first, self._done, self._end_s = (done, now_s), done, None
            return
        first, since_s = self._first
        if done > max(first, self._done):
            self._end_s = now_s + (now_s - since_s) / (done - first) * (total - done)
            self._done = done

    def left_s(self, now_s: float) -> int | None:
        """Return the estimate in whole seconds, at least 1; None before there is one."""
        return None if self._end_s is None else max(1, round(self._end_s - now_s))


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """One state of the moving line; ``done`` and ``total`` draw its bar."""

    text: str
    done: int = 0
    total: int = 0


def starting(ready: int, total: int) -> Status:
    """Return the line while programs start."""
    return Status(text=f"starting {ready}/{total}", done=ready, total=total)


def preparing(report: PreparationReport, left_s: int | None) -> Status:
    """Return the line for a report of the preparation."""
    text = _STEPS.get(report.stage, report.stage.value)
    if not report.total:
        return Status(text=text)
    left = "" if left_s is None else f", about {left_s} s left"
    missed = f", {report.missed} missed" if report.missed else ""
    return Status(text=f"{text} {report.done}/{report.total}{missed}{left}", done=report.done, total=report.total)


def failure(report: PreparationReport) -> str:
    """Return the sentence that states what failed."""
    if report.failed_at is None:
        return f"The preparation failed: {report.text}"
    late = "took too long" if report.cause is PreparationCause.TIMED_OUT else "failed"
    return f"The preparation {late} while {_STEPS[report.failed_at]}: {report.text}"


def next_step(*, key: bool, page: bool) -> str:
    """Return the user's next step after a failure: with a key, if bring-up reads keys, or on the page."""
    ways = [*(["type r and Enter here"] if key else []), *(["press Calibrate on the page"] if page else [])]
    what = " or ".join(ways) or "run gantry_prepare in another terminal"
    return f"To repeat it, {what}. All programs keep running."


def repeats_by_itself(report: PreparationReport, repeats: int) -> bool:
    """Return whether bring-up repeats the preparation automatically: it took too long, and no node rejected it."""
    return report.cause is PreparationCause.TIMED_OUT and repeats < AUTOMATIC_REPEATS
