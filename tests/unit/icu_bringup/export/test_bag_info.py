"""bag_info shows gaps, goals, what can be checked, and a picture strip."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from unit.icu_bringup.export import recorded_session as recorded

from icu_bringup.cli import bag_info
from icu_bringup.export.core.overview import Gaps, gaps

GOLDEN = Path(__file__).parents[3] / "golden" / "bag"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded.write(tmp_path_factory.mktemp("session") / "bag")


def shown(capsys: pytest.CaptureFixture[str], bag: Path, *more: str, code: int = 0) -> list[str]:
    assert bag_info.main([str(bag), *more]) == code
    return capsys.readouterr().out.splitlines()


def test_gaps_of_a_steady_topic_have_their_place_and_length() -> None:
    times = [round(i * 1e8) for i in range(20)] + [round(2.4e9 + i * 1e8) for i in range(20)]
    assert gaps(times) == Gaps(median_s=0.1, begins_ns=(1_900_000_000,), lengths_s=(0.5,))
    assert gaps(times[:9]) is None, "too few"
    assert gaps([i * i * 10**7 for i in range(30)]) is None, "no steady rate"


def test_a_gap_is_shown_under_its_topic(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, session)
    at = next(i for i, line in enumerate(lines) if line.strip().startswith("/joint_states"))
    assert lines[at].split()[1:4] == ["70", "17.5", "Hz"]
    assert lines[at + 1].strip() == "1 gap over 0.15 s, the longest 0.6 s after 1.00 s"
    assert sum(" gap" in line for line in lines) == 1


def test_goals_are_shown_with_results(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, session)
    at = lines.index("goals: 3, 1 aborted, 1 reached, 1 rejected")
    assert lines[at + 1 : at + 4] == [
        "      0.41 s  move to 0.1100, 0.2200, 0.0000 m in base_link  reached after 1.4 s, 0.21 mm off",
        "      2.00 s  press:RUN_STOP  aborted after 1.0 s: stopped",
        "      3.30 s  press:MENU  rejected: not enabled",
    ]


def test_goals_of_a_bag_without_results_are_not_called_unanswered(capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, GOLDEN)
    at = lines.index("goals: 20, without results: the bag lacks /gantry/result")
    assert lines[at + 18] == "     18.13 s  press:RUN_STOP"
    assert not [line for line in lines if "unanswered" in line]


def test_what_a_replay_can_check_is_shown(tmp_path: Path, session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parts = ["corners and recognition", "stereo and stylus tracker", "hand-eye calibration", "controller"]
    for bag in (session, GOLDEN):
        lines = shown(capsys, bag)
        at = lines.index("can be checked by a replay:")
        assert lines[at + 1 : at + 5] == [f"  {part}: yes" for part in parts]
    without = ("/stereo/right/camera_info", "/gantry/machine_settings")
    lines = shown(capsys, recorded.write(tmp_path / "less", without=without))
    at = lines.index("can be checked by a replay:")
    assert lines[at + 1 : at + 5] == [
        "  corners and recognition: yes",
        "  stereo and stylus tracker: no, the bag lacks /stereo/right/camera_info",
        "  hand-eye calibration: no, the bag lacks /stereo/right/camera_info, /gantry/machine_settings",
        "  controller: no, the bag lacks /stereo/right/camera_info, /gantry/machine_settings",
    ]


def test_a_brief_description_reads_no_message(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = shown(capsys, session, "--brief")
    assert len(lines) == 1 + len(recorded.KINDS)


def test_a_picture_strip_shows_the_images_over_time(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "strip.png"
    assert shown(capsys, session, "--strip", str(file))[-1] == f"thumbnails: {file}"
    read = cv2.imread(str(file))
    assert read.shape == (2 * 120, 8 * 160, 3)
    for row, side in enumerate(("left", "right")):
        for column in range(8):
            seconds = 0.1 + 3.9 * column / 7
            expected = cv2.resize(recorded.picture(int((seconds - 0.1) / 0.2), side), (160, 120))
            cell = read[row * 120 : row * 120 + 120, column * 160 : column * 160 + 160]
            # Below the label; the square has moved by 5 px, or 12 of the thumbnail, since the neighbour.
            assert np.abs(cell[20:].astype(float) - expected[20:]).mean() < 4, (side, column)


@pytest.mark.parametrize(
    ("name", "reason"),
    [("strip.xyz", "its name must end with .png or .jpg"), ("none/strip.png", "No such file or directory")],
)
def test_a_strip_that_cannot_be_saved_is_an_error(
    session: Path, tmp_path: Path, name: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bag_info.main([str(session), "--strip", str(tmp_path / name)]) == 1
    assert capsys.readouterr().err == f"error: {tmp_path / name} cannot be written: {reason}\n"
