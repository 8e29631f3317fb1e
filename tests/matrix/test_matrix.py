"""The matrix of faults without its graph: the order of runs, what counts as wrong, the table, and resuming."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from matrix.cells import BOARD, CLOCK, GRAPH, PHASES, Cell, Record, all_cells, append_record, drawn, read_records, table
from matrix.run import text_of
from matrix.witness import SETTLE_S, Sample, judge


def test_every_program_has_every_fault_in_every_phase() -> None:
    cells = all_cells()
    assert len(cells) == len(set(cells)) == (13 * 6 - 2 + 1) * len(PHASES)
    assert Cell(GRAPH, CLOCK, "rest") in cells and not [cell for cell in cells if cell.program == BOARD]


def test_a_shorter_campaign_is_the_beginning_of_a_longer_one() -> None:
    short, long = drawn(200, 1), drawn(1500, 1)
    assert long[:200] == short and len(set(long[: len(all_cells())])) == len(all_cells())
    assert drawn(200, 2) != short


def record(run: int = 0, **values: object) -> Record:
    given = {"program": "camera", "fault": "kill", "phase": "contact", "answer": "aborted", **values}
    return Record(run=run, seed=1, **given)  # type: ignore[arg-type]


def test_pressing_for_two_seconds_is_wrong_unless_the_goal_goes_on() -> None:
    assert record(pressed_s=2.01, held_s=1.5).wrong() == "pressed until 2.01 s after the cause (limit 2 s)"
    assert record(pressed_s=1.99, held_s=1.5).wrong() == ""
    assert record(pressed_s=5.0, answer="none").wrong() != "", "no answer, no hold"
    assert record(pressed_s=5.0, answer="reached").wrong() == "" and record(answer="reached").goes_on
    assert record(pressed_s=5.0, answer="reached", held_s=1.0).wrong() != ""
    assert record(unasked_mm=0.3, answer="reached").wrong() == "moved 0.30 mm without a person"


def test_a_campaign_goes_on_where_it_was_broken_off(tmp_path: Path) -> None:
    path = tmp_path / "matrix.csv"
    first = record(0, held_s=0.1, lifted_s=0.5, pace=1.0, page="driver stopped, it says; no connection")
    for item in (first, record(1, note="not ready"), record(2)):
        append_record(path, item)
    found = read_records(path, 1)
    assert list(found) == [0, 2] and found[0] == first and math.isnan(found[2].held_s)
    assert read_records(path, 2) == {} and read_records(tmp_path / "none.csv", 1) == {}


def test_the_table_has_the_slowest_run_of_each_cell() -> None:
    records = [
        record(0, held_s=0.1, lifted_s=0.5),
        record(1, held_s=0.3, lifted_s=0.4),
        record(2, phase="rest", answer=""),
        record(3, phase="drag", held_s=0.1, pressed_s=3.0),
        record(4, phase="travel", held_s=0.2),
    ]
    row = table(records).splitlines()[2]
    assert row.split(" | ")[:4] == ["| camera", "kill", "goes on", "0.20 / -"]
    assert "0.30 / 0.50 (2)" in row and "**wrong**" in row
    assert "| - / - |" in table([record(answer="none")]), "without an answer nothing has gone on"


def test_a_record_is_one_line_for_people() -> None:
    assert "hindered: not ready" in text_of(record(note="not ready"))
    assert text_of(record(held_s=0.1, page="driver stopped")).startswith("camera, kill, contact: safe; held 0.10 s")


# --- the judge --------------------------------------------------------------------------------------------------------


def samples(*places: tuple[float, float, float, bool], step_s: float = 0.1) -> list[Sample]:
    """Return samples, one each tenth of a second, of (x, y, extension, contact)."""
    return [Sample(2 * step_s * n, step_s * n, x, y, e, c) for n, (x, y, e, c) in enumerate(places)]


def test_the_judge_finds_the_last_contact_and_the_lift() -> None:
    down, up = (10.0, 5.0, 20.0, True), (10.0, 5.0, 0.0, False)
    seen = judge(samples(down, down, down, (10.0, 5.0, 9.0, False), up, up), 0.1, 0.1)
    assert seen.pressed_s == pytest.approx(0.1) and seen.lifted_s == pytest.approx(0.3)
    assert seen.unasked_mm == 0.0 and seen.pace == pytest.approx(0.5)


def test_a_stylus_that_stays_down_is_not_lifted() -> None:
    seen = judge(samples(*[(10.0, 5.0, 20.0, True)] * 30), 0.0, 0.0)
    assert math.isnan(seen.lifted_s) and seen.pressed_s == pytest.approx(2.9)


def test_a_stylus_that_was_up_has_no_lift() -> None:
    assert math.isnan(judge(samples(*[(10.0, 5.0, 0.0, False)] * 5), 0.0, None).lifted_s)


@pytest.mark.parametrize(("dx", "dz", "counts"), [(1.0, 0.0, True), (0.0, 1.0, True), (0.0, -1.0, False)])
def test_only_motion_upwards_is_allowed_after_a_hold(dx: float, dz: float, counts: bool) -> None:
    rest = round(SETTLE_S / 0.1) + 2
    places = [(10.0, 5.0, 20.0, False)] * rest + [(10.0 + dx, 5.0, 20.0 + dz, False)] * 3
    assert judge(samples(*places), 0.0, 0.0).unasked_mm == (pytest.approx(1.0) if counts else 0.0)
    assert judge(samples(*places), 0.0, None).unasked_mm == 0.0, "a goal that goes on moves as it was asked to"


def test_braking_after_a_hold_is_no_motion_without_a_person() -> None:
    places = [(10.0 + 0.5 * n, 5.0, 0.0, False) for n in range(4)] + [(11.5, 5.0, 0.0, False)] * 10
    assert judge(samples(*places), 0.0, 0.0).unasked_mm == 0.0
