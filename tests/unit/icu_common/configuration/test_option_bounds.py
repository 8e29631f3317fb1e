"""What command lines refuse before they do anything."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

CALIBRATION = "harris_perception.cli.calibrate"


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("gantry_driver.cli.gantry_gcode", ["run", ""]),
        ("gantry_driver.cli.gantry_gcode", ["settings", "--params", ""]),
        ("gantry_driver.cli.gantry_sequence", ["--file", ""]),
        (CALIBRATION, ["mono", ""]),
        (CALIBRATION, ["mono", ".", "-o", ""]),
        (CALIBRATION, ["stereo", ".", ""]),
        ("harris_perception.cli.hand_eye", [""]),
        ("harris_perception.cli.harris", ["detect", ""]),
        ("harris_perception.cli.panel_teach", ["check", ""]),
        ("harris_perception.cli.stereo", [".", "-o", ""]),
        ("icu_bringup.cli.bag_export", [".", "--out", ""]),
        ("icu_bringup.cli.bag_info", [""]),
        ("icu_bringup.cli.bag_play", [""]),
        ("icu_bringup.cli.bag_record", ["-o", ""]),
        ("icu_bringup.cli.bring_up", ["--profile", "none", "--state", ""]),
        ("icu_bringup.cli.bring_up", ["--profile", "none", "--run-dir", ""]),
        ("icu_simulator.cli.render", ["--out", ""]),
        ("scope_ui_bridge.cli.page_admin", ["audit", ""]),
    ],
)
def test_a_variable_that_is_not_set_does_not_mean_the_folder_that_one_is_in(
    module: str,
    arguments: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """``-o "$OUT"`` wrote into the current folder, and pictures of ``""`` were those that lie there."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["program", *arguments])
    with pytest.raises(SystemExit) as ended:
        import_module(module).main()
    shown = capsys.readouterr()
    assert ended.value.code == 2 and shown.out == ""
    assert shown.err.endswith(": '' names no file or folder: is a variable not set?\n"), shown.err
    assert list(tmp_path.iterdir()) == []
