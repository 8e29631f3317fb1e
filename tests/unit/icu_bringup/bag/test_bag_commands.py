"""Refusals of the bag commands: before a bag is made or a message is played."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import pytest

from icu_bringup.cli import bag_play, bag_record

BAG = Path(__file__).parents[3] / "golden" / "bag"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--duration", "nan"], "--duration nan; expected 0 or more"),
        (["--duration", "-1"], "--duration -1; expected 0 or more"),
        (["--keep-free", "nan"], "--keep-free nan; expected 0 to 1e+09"),
        (["--keep-free", "inf"], "--keep-free inf; expected 0 to 1e+09"),
        (["--keep-free", "-5"], "--keep-free -5; expected 0 to 1e+09"),
        (["--quality", "50"], "--quality 50 is of JPEG; expected --compress jpeg"),
        (["--quality", "50", "--compress", "png"], "--quality 50 is of JPEG; expected --compress jpeg"),
        (["--quality", "0", "--compress", "jpeg"], "quality = 0: 1 to 100 is possible"),
        (["--exclude", "["], "--exclude '[' is no regular expression: unterminated"),
        (["/a//b"], "topic '/a//b': Invalid topic name: topic name must not contain repeated '/'"),
        (["{a}"], "'{a}' is invalid: unknown substitution"),
        (["bad topic!"], "topic 'bad topic!': Invalid topic name"),
    ],
)
def test_what_cannot_be_recorded_leaves_no_bag(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bag_record.main([*arguments, "-o", str(tmp_path / "bag")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and words in error and error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--start-offset", "nan"], "--start-offset nan; expected 0 or more"),
        (["--start-offset", "-1"], "--start-offset -1; expected 0 or more"),
        (["--start-offset", "1e6"], "--start-offset 1e+06: the bag has 32."),
        (["--duration", "-1"], "--duration -1; expected 0 or more"),
        (["--clock", "-5"], "--clock -5; expected 0.001 to 10000"),
        (["--clock", "0"], "--clock 0; expected 0.001 to 10000"),
        (["--clock", "nan"], "--clock nan; expected 0.001 to 10000"),
        (["--in-step", "-1"], "--in-step -1; expected 1 or more"),
        (["--in-step", "0"], "--in-step 0; expected 1 or more"),
        (["--wait", "nan"], "--wait nan; expected 0 or more"),
        (["--patience", "nan"], "--patience nan; expected 0 or more"),
    ],
)
def test_what_cannot_be_played_is_refused(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert bag_play.main([str(BAG), *arguments]) == 1
    shown = capsys.readouterr()
    assert shown.err.startswith("error: ") and words in shown.err and shown.err.count("\n") == 1
    assert "played" not in shown.out


def test_recordings_that_begin_in_the_same_second_have_names_of_their_own() -> None:
    begun = datetime(2026, 3, 7, 14, 5, 9, 41000)
    assert bag_record.default_name(begun) == Path("bag_2026_03_07-14_05_09_041000")
    assert bag_record.default_name(begun + timedelta(milliseconds=1)) != bag_record.default_name(begun)
