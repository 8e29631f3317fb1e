"""The monitor's line: newest values, throughput from two counts, and age where something has stopped coming."""

from __future__ import annotations

from gantry_driver.core.goals.progress import progress_text
from gantry_driver.core.machine.monitor import Monitor


def values(sent: int) -> dict[str, str]:
    counts = {"sent": "12", "acknowledged": "10", "executed": "8", "refused": "0", "lost": "1"}
    return {**counts, "bytes_sent": str(sent), "answer_latency_ms": "4.20"}


def test_before_anything_came() -> None:
    assert Monitor().line(5.0) == "?  |  no position  |  no diagnostics"


def test_position_state_counts_and_throughput() -> None:
    monitor = Monitor(state="moving")
    monitor.reading((0.1, 0.05, 0.002), 10.0)
    monitor.diagnostics(values(1000), 9.0)
    assert "- B/s" in monitor.line(10.0), "one count is no throughput"
    monitor.diagnostics(values(12_520), 10.0)
    assert monitor.line(10.2) == (
        "moving  |  x  100.000  y   50.000  stylus    2.000 mm  |  "
        "sent 12  acknowledged 10  executed 8  refused 0  lost 1  |  11520 B/s, answer in 4.20 ms"
    )


def test_old_values_say_so() -> None:
    monitor = Monitor(state="disconnected: the device has gone")
    monitor.reading((0.0, 0.0, 0.0), 1.0)
    monitor.diagnostics(values(5), 1.0)
    assert "mm (7 s old)" in monitor.line(8.0) and "lost 1 (7 s old)" in monitor.line(8.0)


def test_a_driver_that_began_anew_gives_no_negative_throughput() -> None:
    monitor = Monitor()
    monitor.diagnostics(values(5000), 1.0)
    monitor.diagnostics(values(20), 2.0)
    assert "- B/s" in monitor.line(2.0)


def test_a_count_that_is_no_number_gives_no_throughput() -> None:
    monitor = Monitor()
    monitor.diagnostics(values(20), 1.0)
    monitor.diagnostics({**values(0), "bytes_sent": "\u00b2"}, 2.0)  # a digit, but no decimal one
    assert "- B/s" in monitor.line(2.0)


def test_progress_is_by_time_and_counts_lines() -> None:
    assert progress_text(1, [6.0, 8.0], "moving") == "[##################......]  75 %  1/2 lines  2.0 s left  moving"
    assert progress_text(2, [0.0, 0.0], "idle") == "[########################] 100 %  2/2 lines  0.0 s left  idle"
