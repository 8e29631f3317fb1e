"""Reports that contradict the counts of lines and answers; no I/O and no clock."""

from __future__ import annotations

from collections.abc import Sequence

from gantry_driver.core.grbl.buffers import BoardBuffers
from gantry_driver.core.grbl.grbl_messages import StatusReport
from gantry_driver.core.grbl.lines import SYNCHRONISE, GrblLine, answers_missing
from icu_common.core.reasons.message import Message, quoted

MISSING_REPORTS = SURPLUS_REPORTS = 2
"""Number of successive reports that must show a missing, or a surplus, answer: one report may be damaged."""
LOST_LINE = Message("board.board_taken_lines_not_answered")
OUT_OF_TURN = Message("board.board_answered_out_turn_line")


class Contradictions:
    """Compares each report with the unanswered lines."""

    def __init__(self) -> None:
        self._surplus_reports = 0
        """Number of successive reports in which the board holds more bytes than were sent and not answered."""
        self._short_reports = 0
        """Number of successive reports of a board that has accepted lines without an answer."""
        self._unanswered_since: float | None = None

    def clear(self) -> None:
        """Start again with another board, or after a reset."""
        self._surplus_reports = self._short_reports = 0
        self.answered()

    def answered(self) -> None:
        """Note an answer, or an interval without reports, in which the board may have been busy."""
        self._unanswered_since = None

    def find(
        self,
        report: StatusReport,
        buffers: BoardBuffers,
        in_flight: Sequence[tuple[GrblLine, float]],
        in_flight_bytes: int,
        now: float,
    ) -> str:
        """Return the contradiction, empty if there is none.

        Parameters
        ----------
        buffers
            State of the board's buffers, including this report.
        in_flight, in_flight_bytes
            Lines sent and not answered, with the times at which they were sent, and their number of bytes.
        """
        held = buffers.rx.held(report.rx_free)
        surplus = report.rx_free >= 0 and held > in_flight_bytes
        self._surplus_reports = self._surplus_reports + 1 if surplus else 0
        if self._surplus_reports == SURPLUS_REPORTS:
            self._surplus_reports = 0
            return Message("board.board_holds_bytes_under_way", held=held, in_flight_bytes=in_flight_bytes)
        short = _lacks_answers(report, buffers, in_flight, now)
        self._short_reports = self._short_reports + 1 if short else 0
        if self._short_reports == MISSING_REPORTS:
            self._short_reports = 0
            return LOST_LINE
        if report.state not in ("Idle", "Check", "Alarm") or not in_flight:
            self._unanswered_since = None
            return ""
        # An idle board with an unanswered line is in a dwell, or line or answer was lost; a locked one answers at once.
        # Only such time counts, so that no time-out expires during a hold.
        if self._unanswered_since is None:
            self._unanswered_since = now
        line = in_flight[0][0]
        if now - self._unanswered_since > line.answer_within_s:
            return Message(
                "board.no_answer_within_although_board", line=quoted(line.text), answer_within_s=line.answer_within_s
            )
        return ""


def _lacks_answers(
    report: StatusReport, buffers: BoardBuffers, in_flight: Sequence[tuple[GrblLine, float]], now: float
) -> bool:
    if not buffers.reported and report.state == "Idle":
        # No line waits in its buffer, except behind a line in execution, such as a dwell.
        works = bool(in_flight) and in_flight[0][0].waits and in_flight[0][0].text != SYNCHRONISE
        return not works and answers_missing(in_flight, 0, now, idle=True, full=False)
    known = min(report.rx_free, report.planner_free) >= 0 and report.rx_free <= buffers.rx.size
    if not known or report.state not in ("Idle", "Run"):
        return False
    held = buffers.rx.held(report.rx_free)
    return answers_missing(in_flight, held, now, idle=report.state == "Idle", full=report.planner_free <= 1)
