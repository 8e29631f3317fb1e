"""Reports that contradict the counts of lines and answers."""

from __future__ import annotations

from gantry_driver.core.grbl.buffers import BoardBuffers
from gantry_driver.core.grbl.contradictions import LOST_LINE, Contradictions
from gantry_driver.core.grbl.grbl_messages import StatusReport
from gantry_driver.core.grbl.lines import GrblLine

IN_FLIGHT = [(GrblLine.of(1, "G1X-5F1000", 60.0), 0.0)]
IDLE = StatusReport(state="Idle")


def find(found: Contradictions, now: float) -> str:
    return found.find(IDLE, BoardBuffers(), IN_FLIGHT, IN_FLIGHT[0][0].size, now)


def test_a_resting_board_without_buffers_lost_a_line_after_two_reports() -> None:
    found = Contradictions()
    assert [find(found, now) for now in (10.0, 10.1)] == ["", LOST_LINE]


def test_a_report_before_a_reset_does_not_count_after_it() -> None:
    found = Contradictions()
    assert find(found, 10.0) == ""
    found.clear()
    assert [find(found, now) for now in (10.1, 10.2)] == ["", LOST_LINE]
