"""A sample of the damage campaign; ``make damage`` runs the full one. A failure's number is its seed."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from campaign.damage import CONFIG, NAMES, Case, main, run_case, text_of
from campaign.damage_judge import HARMLESS, VERDICTS, WRONG, Judge
from campaign.damage_phases import carry_out, scene_of
from campaign.damage_rig import DIRECTIONS, FROM_BOARD, TO_BOARD, DamageRig

from gantry_driver.mock.serial_line import Damage

pytestmark = pytest.mark.long

CELLS = len(NAMES) * len(Damage.kinds)
SAMPLE = range(CELLS)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_a_damaged_byte_never_ends_wrong(direction: str) -> None:
    print(f"seeds {SAMPLE.start} to {SAMPLE.stop - 1}")
    wrong = [found for seed in SAMPLE if (found := run_case(Case(direction, seed))).verdict == WRONG]
    assert not wrong, "\n".join(text_of(found) for found in wrong)


@pytest.mark.parametrize("seed", [6917, 7335])
def test_a_question_that_became_an_order_to_home_is_reported_and_reset(seed: int) -> None:
    """One flipped bit makes ``$H`` of ``$I``."""
    found = run_case(Case(TO_BOARD, seed))
    assert "$H" in found.became
    assert found.verdict != WRONG, text_of(found)
    assert any("may be homing: the driver resets it" in text for text in found.told)


def test_a_report_from_ahead_of_the_board_is_not_published() -> None:
    """One flipped bit shows the stylus a millimetre deeper, where its feed cannot have brought it yet."""
    found = run_case(Case(FROM_BOARD, 7789))
    assert found.verdict != WRONG, text_of(found)


def test_the_seeds_cover_each_kind_of_damage_in_each_phase() -> None:
    cases = [Case(TO_BOARD, seed) for seed in range(CELLS)]
    assert {(case.phase, case.kind) for case in cases} == {(phase, kind) for phase in NAMES for kind in Damage.kinds}


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_each_phase_is_damaged_where_it_was_to_be(direction: str) -> None:
    for seed in range(len(NAMES)):
        found = run_case(Case(direction, seed))
        assert found.was and found.was != found.became, text_of(found)


@pytest.mark.parametrize("phase", NAMES)
def test_a_phase_without_damage_is_harmless(phase: str) -> None:
    for seed in range(5 if phase == "path" else 2):
        rng = random.Random(f"{phase} {seed}")
        rig = DamageRig(CONFIG, seed, None, TO_BOARD)
        carry_out(rig, phase, scene_of(rng), rng)
        judge = Judge(rig.story, rig.track)
        judge.check_end(rig)
        assert (judge.verdict(), judge.wrong, judge.deviated) == (HARMLESS, [], []), rig.story.told


def test_one_seed_is_one_run() -> None:
    for seed in range(0, CELLS, 9):
        case = Case(FROM_BOARD, seed)
        assert run_case(case) == run_case(case)


def test_the_campaign_writes_its_findings_and_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["--seeds", "5:38", "--jobs", "2", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "findings.json").read_text())
    assert content["seeds"] == [5, 38]
    assert {name: sum(counts.values()) for name, counts in content["counts"].items()} == dict.fromkeys(DIRECTIONS, 33)
    shown = capsys.readouterr().out
    assert "66 of 66 runs" in shown and "seeds 5 to 37" in shown
    tables = (tmp_path / "table.md").read_text()
    row = next(line for line in tables.splitlines() if line.startswith("| all |"))
    cells = [[int(part) for part in cell.split(" / ")] for cell in row.split("|")[2:-1]]
    assert all(len(cell) == len(VERDICTS) for cell in cells)
    assert sum(cells[-1]) == 33 == sum(sum(cell) for cell in cells[:-1])
