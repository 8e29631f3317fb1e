"""The command lines of gestures and sequences: what they ask for, and usage errors that name what is wrong."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from gantry_driver.cli import gantry_goal, gantry_sequence
from gantry_driver.cli.operator_session import Interrupted
from icu_common.core.goals.sequence import parse_file


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--control", "RUN_STOP", "--long"], "long:RUN_STOP"),
        (["--control", "RUN_STOP", "--double"], "double:RUN_STOP"),
        (["--control", "CH1_SCALE", "--click", "-2"], "click:CH1_SCALE:-2.0"),
        (["--control", "MODE", "--set", "AUTO"], "set:MODE:AUTO"),
        (["--control", "MODE", "--set", "-40.5"], "set:MODE:-40.5"),
        (["--control", "MODE", "--set", "-4e1"], "set:MODE:-40.0"),
        (["--control", "CH1_SCALE", "--turn", "-1.5e1"], "turn:CH1_SCALE:-15.0"),
        (["--control", "CH1_SCALE", "--click", "-2."], "click:CH1_SCALE:-2.0"),
        (["-1e-3", "-.5", "--press"], "press:-0.001,-0.5@base_link"),
        (
            ["0.05", "0.06", "--frame", "panel_link", "--drag-to", "0.1", "0.08"],
            "drag:0.05,0.06@panel_link:0.1,0.08@panel_link",
        ),
    ],
)
def test_gestures(arguments: list[str], text: str) -> None:
    gesture = gantry_goal.parse(arguments).gesture
    assert gesture is not None
    assert gesture.text().partition(" id=")[0] == text


@pytest.mark.parametrize(
    ("arguments", "xyz"),
    [
        (["-1e-3", "0.08"], (-0.001, 0.08, 0.0)),
        (["0.1", "-8E-2", "--z", "-5e-3"], (0.1, -0.08, -0.005)),
        (["--z", "-5.", "1", "-.5"], (1.0, -0.5, -5.0)),
    ],
)
def test_negative_numbers_are_no_options(arguments: list[str], xyz: tuple[float, float, float]) -> None:
    assert gantry_goal.parse(arguments).xyz == xyz


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--control", "MODE", "--set", "A B"], "--set 'A B': a mark's name or degrees are needed, without blanks"),
        (["--control", "MODE", "--set", "AUTO id=7"], "--set 'AUTO id=7': a mark's name or degrees are needed"),
        (["--control", "MODE", "--set", ""], "--set '': a mark's name or degrees are needed"),
        (["0.1", "0.1", "--z", "0.02"], "--z 0.02: 0 or below is needed, above it the stylus is retracted"),
        (["--control", "MODE", "--set", "200"], "set needs a marked position's name or degrees from -180 to 180"),
        (["--control", "MODE", "--click", "0.5"], "click needs a whole number"),
        (["--control", "MODE", "--long", "--double"], "not allowed with argument"),
    ],
)
def test_wrong_gestures(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        gantry_goal.parse(arguments)
    assert ended.value.code == 2 and words in capsys.readouterr().err


def test_steps_become_the_text_of_a_file() -> None:
    steps = ["press:AUTO_SET => screen", "click:CH1_SCALE:2"]
    text, timeout_s = gantry_sequence.parse([*steps, "--timeout", "30"])
    sequence = parse_file(text)
    assert [s.gesture for s in sequence.steps] == ["press:AUTO_SET", "click:CH1_SCALE:2.0"] and timeout_s == 30


def test_wrong_sequences(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("steps:\n  - press:A\n  - press:B => smoke\n")
    for arguments, words in (
        (["--file", str(wrong)], "wrong.yaml:3: check 'smoke'"),
        (["--file", str(tmp_path / "none.yaml")], "No such file"),
        (["poke:A"], "step 1: gesture 'poke'"),
        ([], "give either steps or --file"),
        (["press:A", "--timeout", "0"], "--timeout 0; expected above 0"),
        (["press:A", "--timeout", "inf"], "--timeout: 'inf' is not finite"),
    ):
        with pytest.raises(SystemExit) as ended:
            gantry_sequence.parse(arguments)
        assert ended.value.code == 2 and words in capsys.readouterr().err


def test_ctrl_c_before_the_sequence_was_sent_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    class Session:
        node = SimpleNamespace(create_publisher=lambda *_: None)

        def hear(self, topic: str) -> list[Any]:
            return []

        def watch(self, topic: str) -> None: ...

        def wait_until_taken(self, *_: Any) -> None:
            raise Interrupted

    assert gantry_sequence.carry_out(cast("Any", Session()), "steps: [press:A]", 5.0) == 1
    assert capsys.readouterr().out == "interrupted before the sequence was sent\n"
