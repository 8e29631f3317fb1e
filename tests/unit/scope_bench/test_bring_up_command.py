"""What bring_up refuses before it starts anything."""

from __future__ import annotations

from pathlib import Path

import pytest

from scope_bench.cli import bring_up

CONFIG = Path(__file__).parents[3] / "config"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--set", "recognition.rate_hz"], "error: --set recognition.rate_hz: PROGRAM.PARAMETER=VALUE is needed"),
        (["--set", "recognition=5"], "error: --set recognition=5: PROGRAM.PARAMETER=VALUE is needed"),
        (["--set", "recognition.rate_hz="], "error: --set recognition.rate_hz: a value is needed"),
        (["--set", "recognition.layout=[1"], "error: --set recognition: 'layout=[1': the value cannot be read"),
        (["--set", "mock_grbl.link=/tmp/b"], "error: --set mock_grbl.link=/tmp/b: mock_grbl is no node"),
        (["--set", "nobody.rate_hz=5"], "error: no program nobody; there are "),
        (["--only", "nobody"], "error: no program nobody; there are "),
        (["--profile", "replay", "--prepare"], "error: --prepare moves the machine; profile replay has none"),
        *(
            (["--namespace", name], f"error: --namespace {name}: ")
            for name in ("a b", "1bed", "a-b", "b\u00e4d", "a//b")
        ),
        (["--namespace", "../../elsewhere"], "error: --namespace ../../elsewhere: names of letters, digits and _"),
    ],
)
def test_what_names_no_setting_or_program_is_refused(
    given: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = ["--config", str(CONFIG), "--state", str(tmp_path / "state"), "--run-dir", str(tmp_path / "run")]
    monkeypatch.setattr("sys.argv", ["bring_up", *folders, *given])
    monkeypatch.setattr("signal.signal", lambda *_: None)  # the test keeps its own
    assert bring_up.main() == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(said) and "started" not in captured.out


def test_a_namespace_that_is_none_makes_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It names one below the state's folder, which is made for this user alone."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr("sys.argv", ["bring_up", "--config", str(CONFIG), "--namespace", "../../elsewhere"])
    monkeypatch.setattr("signal.signal", lambda *_: None)
    assert bring_up.main() == 2 and list(tmp_path.iterdir()) == []


def test_files_that_are_added_to_the_sources_configuration_are_found_without_a_new_build(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``colcon build --symlink-install`` links file by file; what is put beside them, or taught, would not be there."""
    source, built = tmp_path / "config", tmp_path / "install" / "scope_bench" / "share" / "scope_bench" / "config"
    for folder in (source, built):
        folder.mkdir(parents=True)
    (source / "graph.yaml").write_text("programs: {}")
    (built / "graph.yaml").symlink_to(source / "graph.yaml")
    monkeypatch.delenv("ICU_CONFIG", raising=False)
    monkeypatch.setattr("sys.argv", [str(tmp_path / "install" / "scope_bench" / "lib" / "scope_bench" / "bring_up")])
    assert bring_up.configuration_folder() == source.resolve()
    (built / "graph.yaml").unlink()
    (built / "graph.yaml").write_text("programs: {}")  # as without --symlink-install
    assert bring_up.configuration_folder() == built.resolve()
